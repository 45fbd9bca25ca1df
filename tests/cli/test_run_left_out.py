"""``occlib run`` where a camera is missing, black, covered or frozen in some frames."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from helpers.commands import RESULTS, run, snapshot
from helpers.damages import Damage, lost, paint, repeat
from occlib.cli import main
from occlib.formats import load_objects
from occlib.recordings import LAB, open_recording
from occlib.running import frame_ranges

LEFT_OUT: dict[str, tuple[Damage, dict[int, str], str]] = {
    "missing at the end": (lambda f: lost("right", 2, 4)(f), {2: "missing", 4: "missing"},
                           "right: missing in frames 2 and 4"),
    "missing": (lambda f: lost("right", 1, 2)(f), {1: "missing", 2: "missing"},
                "right: missing in frames 1 to 2"),
    "black": (lambda f: paint(f, "right", [3], np.zeros_like), {3: "black"}, "right: black in frame 3"),
    "frozen": (lambda f: repeat(f, "right", range(5)), {3: "frozen", 4: "frozen"}, "right: frozen in frames 3 to 4"),
    "always black": (lambda f: paint(f, "right", range(5), np.zeros_like), dict.fromkeys(range(5), "black"),
                     "right: black in all frames"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("what", LEFT_OUT)
def test_run_goes_on_without_a_camera_and_says_so(
    tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    damage, expected, warning = LEFT_OUT[what]
    damage(tiny_recording)
    lines = run(tiny_recording, tmp_path / "out")
    said = capsys.readouterr()
    assert said.err == f"occlib run: warning: {warning}, left out\n"
    assert said.out.count("\n") == 1 and "5 frames" in said.out
    assert {line["frame"]: line["excluded"] for line in lines if "excluded" in line} == {
        frame: {"right": reason} for frame, reason in expected.items()
    }
    for line in lines:
        assert list(line) == ["frame", "time", "objects", *(["excluded"] if line["frame"] in expected else [])]
        assert len(line["objects"]) == (0 if what == "always black" else 2)  # one view of two begins no object
    assert sorted(snapshot(tmp_path / "out")) == sorted(RESULTS)  # the last frame is drawn with and without a picture
    files = [str(tmp_path / "out/objects.jsonl"), str(tiny_recording / "truth.json")]
    assert list(load_objects(files[0])) == list(range(5))
    assert main(["evaluate", *files, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["moda"] == (0 if what == "always black" else 1)


def test_a_line_for_each_camera_and_reason_in_the_order_of_their_beginning(
    tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paint(tiny_recording, "right", [0], np.zeros_like)
    lost("left", 2)(tiny_recording)
    lost("right", 4)(tiny_recording)
    with pytest.raises(ValueError, match="different length"):
        open_recording(tiny_recording)
    (tiny_recording / "frames/right/0004.png").write_bytes((tiny_recording / "frames/right/0003.png").read_bytes())
    paint(tiny_recording, "right", [2], np.zeros_like)
    lines = run(tiny_recording, tmp_path / "out", "--frames", "0::2")
    assert [line.get("excluded") for line in lines] == [
        {"right": "black"},
        {"left": "missing", "right": "black"},
        None,
    ]
    assert lines[1]["objects"] == []
    assert capsys.readouterr().err.splitlines() == [
        "occlib run: warning: right: black in frames 0 to 2, left out",
        "occlib run: warning: left: missing in frame 2, left out",
    ]


@pytest.mark.slow
def test_four_cameras_one_missing_one_covered_one_frozen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not (LAB / "four_robots/truth.json").is_file():
        pytest.skip(f"four_robots is not rendered in {LAB}")
    folder = tmp_path / "four"
    shutil.copytree(LAB / "four_robots/background", folder / "background")
    for name in ("rig.yaml", "truth.json"):
        shutil.copyfile(LAB / "four_robots" / name, folder / name)
    recording = open_recording("four_robots")
    for name, source in recording.sources.items():
        assert isinstance(source.files, tuple)
        (folder / "frames" / name).mkdir(parents=True)
        for frame in range(40, 46):
            path = source.files[recording.frames.index(frame)]
            shutil.copyfile(path, folder / "frames" / name / f"{frame:04d}{path.suffix}")
    next((folder / "frames/front").glob("0043.*")).unlink()
    paint(folder, "back", [41, 44, 45], lambda image: np.full_like(image, (60, 130, 150)))
    repeat(folder, "left", range(42, 46))
    lines = run(folder, tmp_path / "out", "--maps", "--cameras", "left", "right", "front", "back")
    assert [line.get("excluded") for line in lines] == [
        None,
        {"back": "covered"},
        None,
        {"front": "missing"},
        {"back": "covered"},
        {"left": "frozen", "back": "covered"},
    ]
    assert [len(line["objects"]) for line in lines] == [4] * 6
    assert capsys.readouterr().err.splitlines() == [
        "occlib run: warning: back: covered in frames 41 and 44 to 45, left out",
        "occlib run: warning: front: missing in frame 43, left out",
        "occlib run: warning: left: frozen in frame 45, left out",
    ]


@pytest.mark.parametrize(
    ("some", "expected"),
    [
        ([40], "frame 40"),
        ([40, 44], "frames 40 to 44"),
        ([40, 48, 52], "frames 40 and 48 to 52"),
        ([40, 48, 56], "frames 40, 48 and 56"),
        (range(40, 100, 4), "all frames"),
        (range(40, 96, 8), "frames 40, 48, 56, 64, 72 and 2 more up to 88"),
    ],
)
def test_frames_as_ranges_of_those_that_were_run(some: Sequence[int], expected: str) -> None:
    assert frame_ranges(list(some), range(40, 100, 4)) == expected
