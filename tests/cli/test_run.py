"""``occlib run``: what it writes."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from helpers.commands import RESULTS, Array, run, snapshot
from occlib.cli import main
from occlib.pipeline import PROFILES


def read_pgm(path: Path) -> Array:
    magic, size, depth, pixels = path.read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    assert (magic, depth, len(pixels)) == (b"P5", b"255", width * height)
    return np.frombuffer(pixels, np.uint8).reshape(height, width)


@pytest.mark.slow
def test_a_terminal_gets_a_progress_bar(
    tiny_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    run(tiny_recording, tmp_path / "out")
    assert "100%" in capsys.readouterr().err


def test_run_writes_the_contract(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = run(tiny_recording, tmp_path / "out")
    said = capsys.readouterr()
    assert "5 frames" in said.out
    assert said.err == ""  # no progress bar where nobody watches
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(RESULTS)
    assert [(line["frame"], line["time"]) for line in lines] == [(i, pytest.approx(i / 10)) for i in range(5)]
    for i, line in enumerate(lines):
        assert list(line) == ["frame", "time", "objects"]
        assert len(line["objects"]) == 2
        for thing in line["objects"]:
            assert list(thing) == ["id", "x", "y", "vx", "vy", "area", "colour", "label", "hidden_in", "size"]
            assert isinstance(thing["id"], int)
            assert all(isinstance(thing[key], float) for key in ("x", "y", "vx", "vy", "area"))
            assert len(thing["colour"]) == 3
            assert all(isinstance(level, int) and 0 <= level <= 255 for level in thing["colour"])
            assert thing["label"] is None
            assert thing["hidden_in"] == []
            assert thing["area"] > 0.14  # the footprint's is 0.16
        a, b = sorted(line["objects"], key=lambda thing: thing["y"])
        assert np.hypot(a["x"] - (1.2 + 0.1 * i), a["y"] - 0.9) < 0.05
        assert np.hypot(b["x"] - 2.6, b["y"] - 2.1) < 0.05
        assert a["colour"][0] > a["colour"][2] + 50  # A is red, B is blue: RGB
        assert b["colour"][2] > b["colour"][0] + 20
    reds = [max(line["objects"], key=lambda thing: thing["colour"][0]) for line in lines]
    assert len({red["id"] for red in reds}) == 1
    assert reds[-1]["vx"] == pytest.approx(1.0, abs=0.2)  # 0.1 m a frame at 10 fps


def test_run_writes_a_map_for_map_server(tiny_recording: Path, tmp_path: Path) -> None:
    run(tiny_recording, tmp_path / "out")
    fields = yaml.safe_load((tmp_path / "out/map.yaml").read_text())
    assert fields["image"] == "map.pgm"
    assert fields["resolution"] == 0.05
    assert fields["origin"] == [0, 0, 0]
    grey = read_pgm(tmp_path / "out/map.pgm")
    assert grey.shape == (60, 80)
    for x, y, occupied in [(1.6, 0.9, True), (2.6, 2.1, True), (1.6, 2.1, False), (2.6, 0.9, False), (0.3, 0.3, False)]:
        assert (grey[59 - int(y / 0.05), int(x / 0.05)] < 50) == occupied  # row 0 is the largest y
    assert (grey < 50).mean() < 0.2


def test_run_draws_an_overview(tiny_recording: Path, tmp_path: Path) -> None:
    run(tiny_recording, tmp_path / "out")
    picture = cv2.imread(str(tmp_path / "out/overview.png"))
    assert picture is not None
    assert min(picture.shape[:2]) > 200
    assert picture.std() > 10


def test_maps_of_every_frame(tiny_recording: Path, tmp_path: Path) -> None:
    run(tiny_recording, tmp_path / "out", "--maps")
    names = sorted(p.name for p in (tmp_path / "out/maps").iterdir())
    assert names == [f"{i:06d}.{suffix}" for i in range(5) for suffix in ("pgm", "yaml")]
    assert yaml.safe_load((tmp_path / "out/maps/000003.yaml").read_text())["image"] == "000003.pgm"
    assert (tmp_path / "out/maps/000004.pgm").read_bytes() == (tmp_path / "out/map.pgm").read_bytes()
    assert (tmp_path / "out/maps/000000.pgm").read_bytes() != (tmp_path / "out/map.pgm").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(("text", "frames"), [("1:4:2", [1, 3]), ("2", [2]), ("3:", [3, 4]), (":", [0, 1, 2, 3, 4])])
def test_frames_chosen(tiny_recording: Path, tmp_path: Path, text: str, frames: list[int]) -> None:
    lines = run(tiny_recording, tmp_path / "out", "--frames", text)
    assert [line["frame"] for line in lines] == frames
    assert lines[0]["time"] == pytest.approx(frames[0] / 10)


@pytest.mark.slow
def test_cameras_chosen(tiny_recording: Path, tmp_path: Path) -> None:
    both = run(tiny_recording, tmp_path / "both", "--profile", "and", "--cameras", "right", "left")
    one = run(tiny_recording, tmp_path / "one", "--profile", "and", "--cameras", "right")
    areas = [sum(thing["area"] for thing in lines[0]["objects"]) for lines in (both, one)]
    assert areas[1] > 1.5 * areas[0]  # one lamp's shadow is far larger than the object


@pytest.mark.slow
def test_rule_or_claims_all_shadows(tiny_recording: Path, tmp_path: Path) -> None:
    maps = []
    for rule in ("and", "or"):
        run(tiny_recording, tmp_path / rule, "--rule", rule, "--threshold", "half-otsu")
        maps.append(read_pgm(tmp_path / rule / "map.pgm") < 50)
    assert maps[1].sum() > 1.5 * maps[0].sum()
    assert (maps[1] | ~maps[0]).all()


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["and", "or", "most", "product", "log-odds", "explain"])
def test_every_rule_is_named_in_the_help_and_runs(
    tiny_recording: Path, tmp_path: Path, rule: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert all(line["objects"] for line in run(tiny_recording, tmp_path / "out", "--rule", rule, "--frames", "3:"))
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    said = "".join(capsys.readouterr().out.split())  # lines break at hyphens, too
    assert "and,or,most,product,log-odds,explain" in said
    assert "evidence,otsu,half-otsu,triangle,noiseorgreylevels" in said


@pytest.mark.slow
def test_profile_paper_is_another_chain(tiny_recording: Path, tmp_path: Path) -> None:
    found = [run(tiny_recording, tmp_path / name, "--profile", name) for name in PROFILES]
    assert found[0] != found[1]
    for lines in found:
        for line in lines:
            nearest = [min(np.hypot(t["x"] - 2.6, t["y"] - 2.1) for t in line["objects"])]
            assert max(nearest) < 0.1


@pytest.mark.slow
def test_threshold_by_name_and_by_number(tiny_recording: Path, tmp_path: Path) -> None:
    areas = {}
    for threshold in ("20", "90", "evidence", "otsu", "half-otsu", "triangle", "noise", "1e9"):
        lines = run(tiny_recording, tmp_path / threshold, "--threshold", threshold, "--frames", "0")
        areas[threshold] = sum(thing["area"] for thing in lines[0]["objects"])
    assert areas["20"] > areas["90"] > areas["1e9"] == 0
    assert all(area > 0 for threshold, area in areas.items() if threshold != "1e9")
    assert areas["otsu"] != areas["20"]
    assert (tmp_path / "1e9/map.pgm").is_file()  # nothing found is a result


def test_the_hidden_object_says_where_it_is_hidden(tiny_recording: Path, tmp_path: Path, draw: Any, box: Any) -> None:
    # B stands in A's shadow as seen from the left; from the right it stands free, before A.
    a, b = box("A", 1.6, 1.5, side=0.5, height=0.8), box("B", 2.6, 1.5, side=0.2, height=0.2)
    assert np.array_equal(draw([b, a])["left"], draw([a])["left"])
    for name, image in draw([b, a]).items():
        for path in (tiny_recording / "frames" / name).iterdir():
            assert cv2.imwrite(str(path), image[..., ::-1])
    for line in run(tiny_recording, tmp_path / "out"):
        hidden = {thing["hidden_in"] == ["left"]: thing for thing in line["objects"]}
        assert len(line["objects"]) == len(hidden) == 2
        for found, true in ((hidden[True], b), (hidden[False], a)):  # pulled towards the shadow, but not far
            assert np.hypot(found["x"] - true.x, found["y"] - true.y) < 0.2


@pytest.mark.slow
def test_the_same_run_twice_gives_the_same_bytes(tiny_recording: Path, tmp_path: Path) -> None:
    for name in ("first", "second"):
        run(tiny_recording, tmp_path / name, "--maps")
    first, second = snapshot(tmp_path / "first"), snapshot(tmp_path / "second")
    assert list(first) == list(second)
    for name in first:
        assert first[name] == second[name], name


@pytest.mark.slow
def test_a_second_run_replaces_the_first(tiny_recording: Path, tmp_path: Path) -> None:
    run(tiny_recording, tmp_path / "out", "--frames", "0")
    assert len(run(tiny_recording, tmp_path / "out")) == 5
    assert sorted(snapshot(tmp_path / "out")) == sorted(RESULTS)


def test_run_learns_a_background_that_is_missing(tiny_recording: Path, tmp_path: Path) -> None:
    shutil.rmtree(tiny_recording / "background")
    (tiny_recording / "truth.json").unlink()
    assert len(run(tiny_recording, tmp_path / "out")) == 5
