"""Running a recording: what is written, frame by frame, and that a run that fails leaves no trace."""

from __future__ import annotations

import gc
import json
import shutil
import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from occlib.base.files import writing
from occlib.cli import main
from occlib.mapping import load_map
from occlib.pipeline import FrameResult, Pipeline, settings_for
from occlib.recordings import open_recording
from occlib.running import output_folders, run_recording

Draw = Callable[[Sequence[Any]], dict[str, np.ndarray[Any, Any]]]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_the_summary_says_what_was_written(tiny_recording: Path, tmp_path: Path) -> None:
    summary = run_recording(open_recording(tiny_recording), tmp_path / "out", frames=[3, 1, 1])
    assert str(summary) == f"{tmp_path / 'out'}: objects.jsonl (2 frames), map.pgm, map.yaml, overview.png"
    assert (summary.frames, summary.excluded, summary.warnings()) == ([1, 3], {}, [])
    assert sorted(contents(summary.out)) == ["map.pgm", "map.yaml", "objects.jsonl", "overview.png"]
    lines = [json.loads(line) for line in (summary.out / "objects.jsonl").read_text().splitlines()]
    assert [line["frame"] for line in lines] == [1, 3]


def test_it_is_what_the_pipeline_finds(tiny_recording: Path, tmp_path: Path) -> None:
    recording, settings = open_recording(tiny_recording), settings_for("and")
    out = run_recording(recording, tmp_path / "out", settings=settings).out
    backgrounds = {name: pictures[0] for name, pictures in recording.background_images().items()}
    pipeline = Pipeline(recording.rig, backgrounds, settings)
    results = [pipeline.process(images, recording.time(frame)) for frame, images in recording.images()]
    lines = [json.loads(line) for line in (out / "objects.jsonl").read_text().splitlines()]
    found = [[(thing["id"], thing["x"], thing["y"]) for thing in line["objects"]] for line in lines]
    assert found == [[(thing["id"], thing["x"], thing["y"]) for thing in (o.to_dict() for o in result.objects)]
                     for result in results]  # fmt: skip
    assert load_map(out / "map.yaml") == results[-1].map


def test_what_coasts_is_listed_beside_the_objects_and_is_not_scored(
    tiny_recording: Path, tmp_path: Path, draw: Draw, capsys: pytest.CaptureFixture[str]
) -> None:
    """In frame 3 the floor is bare: both boxes, seen before and after, are expected where they were going."""
    for name, image in draw([]).items():
        assert cv2.imwrite(str(tiny_recording / f"frames/{name}/0003.png"), image[..., ::-1])
    out = run_recording(open_recording(tiny_recording), tmp_path / "out").out
    lines = [json.loads(line) for line in (out / "objects.jsonl").read_text().splitlines()]
    assert [list(line) for line in lines] == [["frame", "time", "objects", *["coasting"] * (k == 3)] for k in range(5)]
    assert (
        lines[3]["objects"] == []
        and [list(each) for each in lines[3]["coasting"]] == [list(lines[0]["objects"][0])] * 2
    )
    for listed in (lines[3]["coasting"], lines[4]["objects"]):
        assert sorted(each["id"] for each in listed) == [1, 2]
    assert main(["evaluate", str(out / "objects.jsonl"), str(tiny_recording / "truth.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fn"] == 2


@pytest.mark.slow
@pytest.mark.parametrize("bag", [None, "mcap"])
def test_no_frame_stays_in_memory(
    tiny_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bag: str | None
) -> None:
    process, made, alive = Pipeline.process, list[weakref.ref[FrameResult]](), list[int]()

    def watched(self: Pipeline, images: Mapping[str, Any], time: float) -> FrameResult:
        gc.collect()
        alive.append(sum(reference() is not None for reference in made))
        result = process(self, images, time)
        made.append(weakref.ref(result))
        return result

    monkeypatch.setattr(Pipeline, "process", watched)
    run_recording(open_recording(tiny_recording), tmp_path / "out", maps=True, bag=bag)
    assert alive == [0, 1, 1, 1, 1]  # the previous one


@pytest.mark.slow
@pytest.mark.parametrize("bag", [None, "mcap", "ros2"])
def test_a_run_that_fails_leaves_what_was_there(
    tiny_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bag: str | None
) -> None:
    out, recording = tmp_path / "out", open_recording(tiny_recording)
    run_recording(recording, out, frames=[0], bag=bag)
    before, process = contents(out), Pipeline.process

    def failing(self: Pipeline, images: Mapping[str, Any], time: float) -> FrameResult:
        if time > 0.25:
            raise ValueError("the third frame is too much")
        return process(self, images, time)

    monkeypatch.setattr(Pipeline, "process", failing)
    with pytest.raises(ValueError, match="third frame"):
        run_recording(recording, out, maps=True, bag=bag)
    assert contents(out) == before
    with pytest.raises(ValueError, match="third frame"):
        run_recording(recording, tmp_path / "new", maps=True, bag=bag)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"map_mode": "grey"}, "map_mode: expected one of trinary, scale, raw, got 'grey'"),
        ({"frames": []}, "frames: expected one or more, got none"),
        ({"frames": [4, 5]}, "frames: 5 is not in tiny, which has 0 to 4"),
        ({"bag": "csv"}, "format: expected one of mcap, ros2, ros1, got 'csv'"),
    ],
)
def test_wrong_arguments(tiny_recording: Path, tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run_recording(open_recording(tiny_recording), tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


# --- several recordings ------------------------------------------------------------------------------
@pytest.fixture
def two(tiny_recording: Path) -> list[Path]:
    """The recording and a copy, in which the right camera sees nothing in frame 3."""
    copy = tiny_recording.with_name("dark")
    shutil.copytree(tiny_recording, copy)
    (copy / "frames/right/0003.png").unlink()
    return [tiny_recording, copy]


@pytest.mark.slow
def test_each_of_several_gets_a_folder_of_its_name(
    two: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["run", *map(str, two), "--out", str(out), "--frames", "1:4"]) == 0
    said = capsys.readouterr()
    files = "objects.jsonl (3 frames), map.pgm, map.yaml, overview.png"
    assert said.out.splitlines() == [f"{out / name}: {files}" for name in ("tiny", "dark")]
    assert said.err == "occlib run: warning: dark: right: missing in frame 3, left out\n"
    assert sorted(path.name for path in out.iterdir()) == ["dark", "tiny"]
    for path in two:
        alone = tmp_path / "alone" / path.name
        assert main(["run", str(path), "--out", str(alone), "--frames", "1:4"]) == 0
        assert contents(alone) == contents(out / path.name)


def test_what_is_wrong_with_one_of_several_is_found_out_before_the_work(
    two: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "below").mkdir()
    namesake = shutil.copytree(two[0], tmp_path / "below" / two[0].name)
    for paths, message in [
        ([*two, tmp_path / "nowhere"], f"{tmp_path / 'nowhere'}: no such recording folder"),
        ([*two, namesake], f"recordings: expected different names, got {two[0]} and {namesake}"),
    ]:
        assert main(["run", *map(str, paths), "--out", str(tmp_path / "out")]) == 2
        assert capsys.readouterr().err.startswith(f"occlib run: {message}")
        assert not (tmp_path / "out").exists()


def test_output_folders(two: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recordings = [open_recording(path) for path in two]
    assert output_folders(recordings[:1], tmp_path) == [tmp_path]
    assert output_folders(recordings, tmp_path) == [tmp_path / "tiny", tmp_path / "dark"]
    monkeypatch.chdir(two[0])
    assert output_folders([open_recording("."), recordings[1]], tmp_path)[0] == tmp_path / "tiny"


# --- a file written piece by piece -------------------------------------------------------------------
def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "file"
    with writing(path) as write:
        write("a µ\n")
        write(b"b")
        assert not path.exists()
    assert path.read_bytes() == "a µ\nb".encode()
    with pytest.raises(OSError, match="not about this file"), writing(path) as write:
        write(bytes(np.arange(256, dtype=np.uint8)) * 1000)
        raise OSError("not about this file")
    assert path.read_bytes() == "a µ\nb".encode()
    assert [p.name for p in path.parent.iterdir()] == ["file"]


def test_what_is_written_late_may_fail_late(tmp_path: Path) -> None:
    """What a buffer holds back is written at the end: a disk that is full then is reported as it is at the start."""
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    with pytest.MonkeyPatch.context() as patch:
        import os

        real = os.fdopen

        def to_full(handle: int, mode: str) -> Any:
            os.close(handle)
            return real(os.open(full, os.O_WRONLY), mode)

        patch.setattr("occlib.base.files.os.fdopen", to_full)
        for size in (1, 100_000):
            with (
                pytest.raises(ValueError, match=r"file: cannot write \(No space left on device\)"),
                writing(tmp_path / "file") as write,
            ):
                write(size * b"x")
    assert not list(tmp_path.iterdir())
