"""``occlib run`` on bad input: one line says what is wrong, and nothing is left behind."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.commands import RESULTS, error_lines, fails, run, snapshot
from helpers.damages import Damage, folder_for, gone, lost, picture, rig, text, video
from occlib.cli import main

SMALL = np.zeros((60, 80, 3), np.uint8)
FOOTPRINT = '{"frames": {"4": [{"x": 1, "y": 1, "footprint": %s}]}}'
NO_LENGTH = {"x": [0, 4], "y": [0, 3], "resolution": 1e-320}

BAD_RECORDINGS: dict[str, tuple[Damage, str]] = {
    "no rig": (gone("rig.yaml"), r"rig.yaml: cannot read \(No such file"),
    "rig is a folder": (folder_for("rig.yaml"), r"rig.yaml: cannot read \(Is a directory"),
    "rig empty": (text("rig.yaml", ""), "rig.yaml: expected a mapping with 'units', 'floor' and 'cameras'"),
    "rig is a list": (text("rig.yaml", "- 1"), "rig.yaml: expected a mapping"),
    "rig not YAML": (text("rig.yaml", "a: [1"), "rig.yaml: not valid YAML"),
    "rig too deep": (text("rig.yaml", "[" * 20_000), "rig.yaml: not valid YAML"),
    "rig with an impossible date": (text("rig.yaml", "a: 2001-99-99"), "rig.yaml: not valid YAML"),
    "no cameras": (rig(cameras={}), "rig.yaml: cameras: expected a mapping with one or more cameras, got {}"),
    "fps negative": (rig(fps=-1), "rig.yaml: fps: expected frames a second > 0, got -1"),
    "fps in words": (rig(fps="ten"), "rig.yaml: fps: expected frames a second > 0, got 'ten'"),
    "fps tiny": (rig(fps=1e-300), "rig.yaml: fps: expected"),
    "size of floats": (rig(size=[160.5, 120]), r"rig.yaml: cameras.left.size: expected \[width, height\] in px"),
    "size another": (
        rig(size=[80, 60]),
        r"background/left/0.png: expected uint8 \(60, 80, 3\), got uint8 \(120, 160, 3",
    ),
    "size huge": (rig(size=[1e300, 1]), "rig.yaml: cameras.left.size: expected"),
    "matrix NaN": (rig(matrix=[[float("nan")] * 3] * 3), "rig.yaml: cameras.left.matrix: expected 3x3 finite numbers"),
    "homography singular": (rig(floor_homography=[[0] * 3] * 3), "left.floor_homography: expected an invertible"),
    "homography huge": (rig(floor_homography=(np.eye(3) * 1e200).tolist()), "left.floor_homography: expected an inv"),
    "floor endless": (rig(floor=NO_LENGTH), "rig.yaml: floor: .* cells are too many"),
    "no frames": (gone("frames"), "no frames for camera 'left'"),
    "views of different length": (lost("left", 2, 3, 4), "views of different length or names: left has 2 fr"),
    "the first frame is lost": (lost("left", 0), r"different length or names: left has 4 frames \(1 to 4\)"),
    "frame is a folder": (folder_for("frames/left/0001.png"), r"left/0001.png: cannot read the image \(Is a dir"),
    "frame of the wrong size": (
        picture("frames/left/0003.png", SMALL),
        r"tiny frame 3 of left: expected uint8 \(120, 1",
    ),
    "video of zero bytes": (video(b""), "frames/left.mp4: corrupt or empty video"),
    "video of garbage": (video(b"x" * 1000), "frames/left.mp4: corrupt or empty video"),
    "background corrupt": (picture("background/left/0.png", b"x"), "background/left/0.png: corrupt"),
    "background of the wrong size": (picture("background/left/0.png", SMALL), "background/left/0.png: expected uint8"),
    "truth is a list": (text("truth.json", "[]"), "truth.json: truth: expected a mapping"),
    "truth not JSON": (text("truth.json", "{"), "truth.json: not valid JSON"),
    "truth too deep": (text("truth.json", "[" * 50_000), "truth.json: not valid JSON"),
    "truth is a folder": (folder_for("truth.json"), r"truth.json: cannot read \(Is a directory"),
    "footprint a number": (text("truth.json", FOOTPRINT % 5), r"truth.frames.4\[0\].footprint: expected three or more"),
    "footprint a word": (text("truth.json", FOOTPRINT % '"a"'), r"truth.frames.4\[0\].footprint: expected three"),
    "footprint ragged": (text("truth.json", FOOTPRINT % "[[1, 2], [3]]"), r"frames.4\[0\].footprint: expected three"),
}


@pytest.mark.parametrize("what", BAD_RECORDINGS)
def test_run_says_what_is_wrong_and_leaves_no_trace(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], what: str
) -> None:
    damage, message = BAD_RECORDINGS[what]
    damage(tiny_recording)
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "out", "--maps")
    assert re.search(message, said), said
    assert capfd.readouterr().out == ""
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--cameras", "left", "top"], "camera 'top' is not in the rig; it has left, right"),
        (["--cameras", "left", "left"], "cameras: expected one or more different names, got"),
        (["--frames", "5:1"], "--frames: '5:1' selects none of the frames 0 to 4"),
        (["--frames", "99"], "--frames: '99' selects none of the frames 0 to 4"),
        (["--frames", "abc"], "--frames: expected a number or START:STOP:STEP with STEP > 0, got 'abc'"),
        (["--frames", "::0"], "--frames: expected a number or START:STOP:STEP with STEP > 0, got '::0'"),
        (["--frames", ""], "--frames: expected a number or START:STOP:STEP with STEP > 0, got ''"),
        (["--threshold", "nonsense"], "threshold: expected otsu, .* or grey levels, got 'nonsense'"),
        (["--threshold=-5"], "threshold: expected grey levels >= 0, got -5"),
        (["--threshold", "nan"], "threshold: expected grey levels >= 0, got nan"),
        (["--rule", "xor"], "rule: expected one of and, or.*, got 'xor'"),
        (["--profile", "best"], "profile: expected one of recommended, and, paper, got 'best'"),
    ],
)
def test_run_says_which_option_is_wrong(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "out", *options)
    assert re.search(message, said), said
    assert not (tmp_path / "out").exists()


def test_run_on_no_recording(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = fails(capfd, "run", tmp_path / "nowhere", "--out", tmp_path / "out")
    assert "nowhere: no such recording folder" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_wrong_image_leaves_the_last_results(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    run(tiny_recording, out, "--maps")
    before = snapshot(out)
    picture("frames/left/0003.png", SMALL)(tiny_recording)
    assert "tiny frame 3 of left: expected uint8" in fails(
        capfd, "run", tiny_recording, "--out", out, "--maps", "--rule", "or"
    )
    assert snapshot(out) == before
    assert len(run(tiny_recording, out, "--frames", "0:3")) == 3  # frames that nobody asked for may be broken


@pytest.mark.parametrize("below", ["", "below", "below/deep"])
def test_out_that_is_a_file(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], below: str
) -> None:
    (tmp_path / "file").write_text("keep")
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "file" / below)
    assert re.search(r"file.*: cannot write \((File exists|Not a directory)", said), said
    assert (tmp_path / "file").read_text() == "keep"


def test_out_that_is_read_only(tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    if os.access(locked, os.W_OK):
        pytest.skip("this user may write to read-only folders")
    for out in (locked, locked / "new"):
        assert "cannot write (Permission denied)" in fails(capfd, "run", tiny_recording, "--out", out)
    assert not list(locked.iterdir())


def test_read_only_as_told_by_the_system(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: Any, **options: Any) -> Any:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("occlib.base.files.tempfile.mkdtemp", refuse)
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "out")
    assert said == f"{tmp_path / 'out'}: cannot write (Read-only file system)"
    assert not (tmp_path / "out").exists()


class Full:
    """A file on a full disk: takes the first bytes and then no more."""

    def __init__(self, handle: int) -> None:
        self.handle = handle

    def __enter__(self) -> Full:
        return self

    def __exit__(self, *reason: object) -> None:
        os.close(self.handle)

    def write(self, content: bytes) -> int:
        os.write(self.handle, content[: len(content) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.slow
@pytest.mark.parametrize("how", ["fdopen", "replace"])
@pytest.mark.parametrize("files", range(4))
@pytest.mark.parametrize("fresh", [True, False])
def test_a_disk_that_fills_up(
    tiny_recording: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    how: str,
    files: int,
    fresh: bool,
) -> None:
    """After so many files there is no room for the next: no new file, no temporary one, and the old results stay."""
    out, room = tmp_path / "out", files
    for name in () if fresh else RESULTS:
        out.mkdir(exist_ok=True)
        (out / name).write_text("of the last run")
    before = snapshot(tmp_path)
    real = getattr(os, how)

    def limited(*args: Any, **options: Any) -> Any:
        nonlocal room
        room -= 1
        if room >= 0:
            return real(*args, **options)
        if how == "fdopen":
            return Full(args[0])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(f"occlib.base.files.os.{how}", limited)
        said = fails(capfd, "run", tiny_recording, "--out", out, "--frames", "1:3")
    assert "cannot write (No space left on device)" in said
    assert snapshot(tmp_path) == before
    assert out.exists() == (not fresh)


def test_interrupted_run(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*args: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("occlib.pipeline.Pipeline.process", interrupt)
    assert main(["run", str(tiny_recording), "--out", str(tmp_path / "out")]) == 130
    assert error_lines(capfd) == ["occlib run: interrupted"]
    assert not (tmp_path / "out").exists()
