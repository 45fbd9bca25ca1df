"""The command line: what ``run`` writes, what ``evaluate`` prints, and one line for whatever is wrong with the input."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from occlib import __version__
from occlib.cli import _spans, build_parser, main
from occlib.formats import load_objects
from occlib.live.broadcast import Publisher
from occlib.pipeline import PROFILES
from occlib.recordings import LAB, open_recording

Array = np.ndarray[Any, Any]
Damage = Callable[[Path], object]
RESULTS = ("objects.jsonl", "map.pgm", "map.yaml", "overview.png")


def error_lines(capture: pytest.CaptureFixture[str]) -> list[str]:
    """What a command said on stderr, progress bars aside."""
    lines = re.split(r"[\r\n]+", capture.readouterr().err)
    return [line for line in lines if line.strip() and not re.search(r"\d+%\||frame/s|file/s", line)]


def fails(capture: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line on stderr of a command that must fail, without its ``occlib COMMAND: ``."""
    capture.readouterr()
    assert main([str(a) for a in arguments]) not in (0, None)
    lines = error_lines(capture)
    assert len(lines) == 1, lines
    start = f"occlib {arguments[0]}: "
    assert lines[0].startswith(start)
    assert len(lines[0]) < 400
    assert not re.search("Traceback|Errno", lines[0])
    return lines[0].removeprefix(start)


def run(recording: Path, out: Path, *options: object) -> list[dict[str, Any]]:
    """``occlib run`` that must succeed: the lines of objects.jsonl."""
    assert main(["run", str(recording), "--out", str(out), *map(str, options)]) == 0
    return [json.loads(line) for line in (out / "objects.jsonl").read_text(encoding="utf-8").splitlines()]


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def read_pgm(path: Path) -> Array:
    magic, size, depth, pixels = path.read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    assert (magic, depth, len(pixels)) == (b"P5", b"255", width * height)
    return np.frombuffer(pixels, np.uint8).reshape(height, width)


# --- help ------------------------------------------------------------------------------------------
def commands() -> list[str]:
    return list(next(a for a in build_parser()._actions if isinstance(a.choices, dict)).choices)  # type: ignore[arg-type]


def test_the_commands_of_the_contract_are_there() -> None:
    assert {"reproduce", "run", "broadcast", "listen", "evaluate", "calibrate", "render", "data"} <= set(commands())


@pytest.mark.parametrize("command", [[], *([name] for name in commands())])
def test_help(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main([*command, "--help"])
    assert leave.value.code == 0
    assert capsys.readouterr().out.startswith(" ".join(["usage: occlib", *command]))


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main(["--version"])
    assert leave.value.code == 0
    assert capsys.readouterr().out == f"occlib {__version__}\n"


@pytest.mark.parametrize("arguments", [[], ["fly"], ["run"], ["run", "x"], ["evaluate", "x"], ["run", "x", "--out"]])
def test_wrong_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main(arguments)
    assert leave.value.code == 2
    assert "occlib" in capsys.readouterr().err.splitlines()[-1]


# --- run -------------------------------------------------------------------------------------------
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
            assert list(thing) == ["id", "x", "y", "vx", "vy", "area", "colour", "label", "hidden_in"]
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
    assert len({line["objects"][0]["id"] for line in lines}) == 1
    assert lines[-1]["objects"][0]["vx"] == pytest.approx(1.0, abs=0.2)  # 0.1 m a frame at 10 fps


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


@pytest.mark.parametrize(("text", "frames"), [("1:4:2", [1, 3]), ("2", [2]), ("3:", [3, 4]), (":", [0, 1, 2, 3, 4])])
def test_frames_chosen(tiny_recording: Path, tmp_path: Path, text: str, frames: list[int]) -> None:
    lines = run(tiny_recording, tmp_path / "out", "--frames", text)
    assert [line["frame"] for line in lines] == frames
    assert lines[0]["time"] == pytest.approx(frames[0] / 10)


def test_cameras_chosen(tiny_recording: Path, tmp_path: Path) -> None:
    both = run(tiny_recording, tmp_path / "both", "--profile", "and", "--cameras", "right", "left")
    one = run(tiny_recording, tmp_path / "one", "--profile", "and", "--cameras", "right")
    areas = [sum(thing["area"] for thing in lines[0]["objects"]) for lines in (both, one)]
    assert areas[1] > 1.5 * areas[0]  # one lamp's shadow is far larger than the object


def test_rule_or_claims_all_shadows(tiny_recording: Path, tmp_path: Path) -> None:
    maps = []
    for rule in ("and", "or"):
        run(tiny_recording, tmp_path / rule, "--rule", rule, "--threshold", "half-otsu")
        maps.append(read_pgm(tmp_path / rule / "map.pgm") < 50)
    assert maps[1].sum() > 1.5 * maps[0].sum()
    assert (maps[1] | ~maps[0]).all()


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


def test_profile_paper_is_another_chain(tiny_recording: Path, tmp_path: Path) -> None:
    found = [run(tiny_recording, tmp_path / name, "--profile", name) for name in PROFILES]
    assert found[0] != found[1]
    for lines in found:
        for line in lines:
            nearest = [min(np.hypot(t["x"] - 2.6, t["y"] - 2.1) for t in line["objects"])]
            assert max(nearest) < 0.1


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


def test_the_same_run_twice_gives_the_same_bytes(tiny_recording: Path, tmp_path: Path) -> None:
    for name in ("first", "second"):
        run(tiny_recording, tmp_path / name, "--maps")
    first, second = snapshot(tmp_path / "first"), snapshot(tmp_path / "second")
    assert list(first) == list(second)
    for name in first:
        assert first[name] == second[name], name


def test_a_second_run_replaces_the_first(tiny_recording: Path, tmp_path: Path) -> None:
    run(tiny_recording, tmp_path / "out", "--frames", "0")
    assert len(run(tiny_recording, tmp_path / "out")) == 5
    assert sorted(snapshot(tmp_path / "out")) == sorted(RESULTS)


def test_run_learns_a_background_that_is_missing(tiny_recording: Path, tmp_path: Path) -> None:
    shutil.rmtree(tiny_recording / "background")
    (tiny_recording / "truth.json").unlink()
    assert len(run(tiny_recording, tmp_path / "out")) == 5


# --- cameras that are left out ---------------------------------------------------------------------
def paint(folder: Path, camera: str, frames: Sequence[int], change: Callable[[Array], Array]) -> None:
    for frame in frames:
        path = next((folder / "frames" / camera).glob(f"*{frame:04d}.*"))
        assert cv2.imwrite(str(path), change(cv2.imread(str(path))))


def repeat(folder: Path, camera: str, frames: Sequence[int]) -> None:
    """The first of the frames in the place of all."""
    old = next((folder / "frames" / camera).glob(f"*{frames[0]:04d}.*"))
    for frame in frames[1:]:
        shutil.copyfile(old, next((folder / "frames" / camera).glob(f"*{frame:04d}.*")))


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


def test_four_cameras_one_missing_one_covered_one_frozen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not (LAB / "four_robots/truth.json").is_file():
        pytest.skip(f"four_robots is not rendered in {LAB}")
    folder = tmp_path / "four"
    shutil.copytree(LAB / "four_robots/background", folder / "background")
    for name in ("rig.yaml", "truth.json"):
        shutil.copyfile(LAB / "four_robots" / name, folder / name)
    recording = open_recording("four_robots")
    for name, source in recording.sources.items():
        assert isinstance(source, tuple)
        (folder / "frames" / name).mkdir(parents=True)
        for frame in range(40, 46):
            path = source[recording.frames.index(frame)]
            assert path is not None
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
    assert _spans(list(some), range(40, 100, 4)) == expected


# --- evaluate --------------------------------------------------------------------------------------
def test_evaluate_as_json(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tiny_recording, tmp_path / "out")
    files = [str(tmp_path / "out/objects.jsonl"), str(tiny_recording / "truth.json")]
    scores = {}
    for name, options in {"all": [], "roi": ["--roi", "south"], "near": ["--radius", "0.001"]}.items():
        capsys.readouterr()
        assert main(["evaluate", *files, "--json", *options]) == 0
        said = capsys.readouterr()
        assert said.err == ""
        scores[name] = json.loads(said.out)
    keys = {"moda", "modp", "precision", "recall", "error_mean_m", "error_median_m"}
    assert all(keys <= set(score) for score in scores.values())
    assert scores["all"]["moda"] == scores["all"]["precision"] == scores["all"]["recall"] == 1
    assert scores["all"]["error_median_m"] < 0.05
    assert (scores["all"]["truth_count"], scores["roi"]["truth_count"]) == (10, 5)
    assert scores["near"]["moda"] < 0


def test_evaluate_as_a_table(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "objects.jsonl").write_text('{"frame": 0, "objects": []}\n')
    assert main(["evaluate", str(tmp_path / "objects.jsonl"), str(tiny_recording / "truth.json")]) == 0
    table = dict(line.split() for line in capsys.readouterr().out.splitlines())
    assert table["recall"] == "0"
    assert table["error_mean_m"] == "-"  # undefined, not NaN
    assert {"ghosts_per_frame", "hidden_precision", "hidden_recall"} <= set(table)


@pytest.mark.parametrize(
    ("fractions", "options", "expected"),
    [
        (({"left": 1.0, "right": 0.9}, {"left": 0.89}), [], (0.5, 0.5)),
        (({"left": 1.0, "right": 0.9}, {"left": 0.89}), ["--roi", "west"], (1.0, 0.5)),
        (({"left": 1.0, "right": 0.9}, {"left": 0.89}), ["--radius", "0.05"], (None, 0.0)),
        (({}, {}), [], (None, None)),
    ],
)
def test_evaluate_scores_who_is_said_to_be_hidden(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    fractions: Sequence[dict[str, float]],
    options: Sequence[str],
    expected: tuple[float | None, float | None],
) -> None:
    objects = [{"id": i, "x": 2 * i + 0.1, "y": 0, "hidden_in": ["left"]} for i in range(3)]
    true = [{"id": i, "x": 2 * i, "y": 0, "hidden_fraction": known} for i, known in enumerate(fractions)]
    west = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    (tmp_path / "objects.jsonl").write_text(json.dumps({"frame": 0, "objects": objects}))
    (tmp_path / "truth.json").write_text(json.dumps({"frames": {"0": true}, "roi": {"west": west}}))
    assert main(["evaluate", str(tmp_path / "objects.jsonl"), str(tmp_path / "truth.json"), "--json", *options]) == 0
    score = json.loads(capsys.readouterr().out)
    assert (score["hidden_precision"], score["hidden_recall"]) == expected
    assert score["ghosts_per_frame"] == score["fp"]


GOOD = '{"frame": 0, "objects": [{"id": 1, "x": 1, "y": 1}]}\n'
TRUTH = '{"frames": {"0": [{"id": "A", "x": 1, "y": 1}]}, "roi": {"all": [[0, 0], [2, 0], [2, 2]]}}'


@pytest.mark.parametrize(
    ("objects", "truth", "options", "message"),
    [
        (None, TRUTH, [], r"objects.jsonl: cannot read \(No such file"),
        (GOOD, None, [], r"truth.json: cannot read \(No such file"),
        ("{", TRUTH, [], "objects.jsonl:1: not valid JSON"),
        (GOOD + "[]", TRUTH, [], "objects.jsonl:2: expected an object with an integer 'frame'"),
        (GOOD + GOOD, TRUTH, [], "objects.jsonl:2: frame 0 comes twice"),
        ('{"frame": 0}', TRUTH, [], "objects.jsonl:1: objects: expected a list, got None"),
        ("[" * 50_000, TRUTH, [], "objects.jsonl:1: not valid JSON"),
        ("\x89PNG\r\n", TRUTH, [], "objects.jsonl:1: not valid JSON"),
        (
            GOOD.replace('"id": 1', '"id": [1]'),
            TRUTH,
            [],
            r"objects.jsonl:1: objects\[0\].id: expected a name or number",
        ),
        (GOOD.replace('"x": 1', '"x": NaN'), TRUTH, [], r"objects.jsonl:1: objects\[0\].x: expected finite metres"),
        (GOOD, "[]", [], "truth.json: truth: expected a mapping with 'units' and 'frames'"),
        (GOOD, "null", [], "truth.json: truth: expected a mapping"),
        (GOOD, "", [], "truth.json: not valid JSON"),
        (GOOD, '{"frames": []}', [], "truth.json: truth: expected a mapping"),
        (GOOD, '{"frames": {"a": []}}', [], "truth.json: truth.frames: expected whole numbers as keys, got 'a'"),
        (GOOD, '{"frames": {}, "roi": 5}', [], "truth.json: truth.roi: expected a mapping of names to polygons, got 5"),
        (GOOD, '{"frames": {}, "roi": {"a": 5}}', [], "truth.json: truth.roi.a: expected three or more finite points"),
        (GOOD, TRUTH.replace('"A"', "{}"), [], r"truth.json: truth.frames.0\[0\].id: expected a name or number"),
        (GOOD, TRUTH, ["--roi", "none"], "roi: 'none' is not in the truth, which has all"),
        (GOOD, TRUTH, ["--radius", "0"], "radius: expected metres > 0, got 0"),
        (GOOD, TRUTH, ["--radius", "nan"], "radius: expected metres > 0, got nan"),
    ],
)
def test_evaluate_says_what_is_wrong(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    objects: str | None,
    truth: str | None,
    options: Sequence[str],
    message: str,
) -> None:
    for name, content in {"objects.jsonl": objects, "truth.json": truth}.items():
        if content is not None:
            (tmp_path / name).write_text(content, encoding="utf-8")
    assert re.search(message, fails(capsys, "evaluate", tmp_path / "objects.jsonl", tmp_path / "truth.json", *options))
    assert capsys.readouterr().out == ""


# --- run on bad input ------------------------------------------------------------------------------
def picture(name: str, content: bytes | Array) -> Damage:
    """Put something else in the place of a picture."""

    def change(folder: Path) -> None:
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            assert cv2.imwrite(str(folder / name), content)

    return change


def cut(name: str) -> Damage:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:150])


def folder_for(name: str) -> Damage:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).mkdir()

    return change


def text(name: str, content: str) -> Damage:
    return lambda folder: (folder / name).write_text(content, encoding="utf-8")


def rig(**fields: Any) -> Damage:
    """Change fields of the left camera, or of the rig itself."""

    def change(folder: Path) -> None:
        content = yaml.safe_load((folder / "rig.yaml").read_text())
        for name, value in fields.items():
            (content["cameras"]["left"] if name in content["cameras"]["left"] else content)[name] = value
        (folder / "rig.yaml").write_text(yaml.safe_dump(content))

    return change


def video(content: bytes) -> Damage:
    def change(folder: Path) -> None:
        shutil.rmtree(folder / "frames/left")
        (folder / "frames/left.mp4").write_bytes(content)

    return change


def gone(name: str) -> Damage:
    return lambda f: shutil.rmtree(f / name) if (f / name).is_dir() else (f / name).unlink()


def lost(camera: str, *frames: int) -> Damage:
    def change(folder: Path) -> None:
        for frame in frames:
            (folder / f"frames/{camera}/{frame:04d}.png").unlink()

    return change


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
    "frame of zero bytes": (picture("frames/left/0002.png", b""), "left/0002.png: corrupt or not an image"),
    "frame of text": (picture("frames/left/0002.png", b"hello"), "left/0002.png: corrupt or not an image"),
    "frame cut short": (cut("frames/right/0002.png"), "right/0002.png: corrupt or not an image"),
    "frame is a folder": (folder_for("frames/left/0001.png"), r"left/0001.png: cannot read the image \(Is a dir"),
    "frame of the wrong size": (
        picture("frames/left/0003.png", SMALL),
        r"tiny frame 3 of left: expected uint8 \(120, 1",
    ),
    "last frame corrupt": (picture("frames/right/0004.png", b"x" * 500), "right/0004.png: corrupt"),
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


def test_a_corrupt_image_leaves_the_last_results(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    run(tiny_recording, out, "--maps")
    before = snapshot(out)
    picture("frames/left/0003.png", b"")(tiny_recording)
    assert "left/0003.png: corrupt" in fails(capfd, "run", tiny_recording, "--out", out, "--maps", "--rule", "or")
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


def test_a_reader_that_leaves_is_no_error() -> None:
    command = [
        sys.executable,
        "-c",
        "import sys; from occlib.cli import main; input(); sys.exit(main(['data', 'list']))",
    ]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        assert process.stdin and process.stdout and process.stderr
        process.stdout.close()
        process.stdin.write("\n")
        process.stdin.close()
        assert process.stderr.read() == ""
        assert process.wait(30) == 141


# --- the other commands ----------------------------------------------------------------------------
def test_calibrate_on_real_photographs(
    shared_data: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = sorted(map(str, shared_data("opencv-checkerboard").glob("left*.jpg")))
    out = tmp_path / "camera.yaml"
    assert main(["calibrate", *images, "--pattern", "9x6", "--square", "0.025", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"{len(images)} of {len(images)} pictures used" in said
    fields = yaml.safe_load(out.read_text())
    assert {"size", "matrix", "distortion", "rms_px", "views_used"} <= set(fields)
    assert fields["size"] == [640, 480]
    assert fields["rms_px"] <= 0.41
    assert abs(fields["matrix"][0][0] - 535.9) <= 2
    assert len(fields["distortion"]) == 5
    assert fields["views_used"] == len(images)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--pattern", "9"], "pattern: expected COLUMNSxROWS of inner corners, such as 9x6, got '9'"),
        (["--pattern", "9x6x2"], "pattern: expected COLUMNSxROWS"),
        (["--pattern", "²x6"], "pattern: expected COLUMNSxROWS"),
        (["--pattern", "1x1"], "pattern: expected .* 3 or more each, got .1, 1"),
        (["--square", "0"], "square: expected metres > 0, got 0"),
        (["--square", "nan"], "square: expected metres > 0, got nan"),
        (["--square", "1e308"], r"square: expected metres > 0.*, got 1e\+308"),
    ],
)
def test_calibrate_says_what_is_wrong(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    image = tmp_path / "grey.png"
    assert cv2.imwrite(str(image), np.full((60, 80), 128, np.uint8))
    given = {"--pattern": "9x6", "--square": "0.025"} | dict([options])
    flat = [part for pair in given.items() for part in pair]
    assert re.search(message, fails(capfd, "calibrate", image, *flat, "--out", tmp_path / "camera.yaml"))
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.parametrize("content", [None, b"", b"hello"])
def test_calibrate_on_a_picture_that_is_none(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], content: bytes | None
) -> None:
    if content is not None:
        (tmp_path / "board.png").write_bytes(content)
    said = fails(capfd, "calibrate", tmp_path / "board.png", "--pattern", "9x6", "--square", "0.025")
    assert re.search(r"board.png: (cannot read the image|corrupt or not an image)", said)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["data", "fetch"], "data fetch: expected a name, one of ufes-lab, opencv-checkerboard"),
        (["data", "fetch", "nothing"], "nothing: not a public recording; there are ufes-lab, opencv-checkerboard"),
        (["render", "nothing"], "nothing: cannot read"),
        (["reproduce", "nothing"], "notebook 'nothing': expected one of|no notebook"),
    ],
)
def test_other_commands_say_what_is_wrong(
    capfd: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert re.search(message, fails(capfd, *arguments))


def test_data_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "list"]) == 0
    names = [line.partition(":")[0] for line in capsys.readouterr().out.splitlines()]
    assert {"ufes-lab", "opencv-checkerboard"} <= set(names)


# ---------------------------------------------------------------- compare


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """A picture with a blob pattern twice, once at half the light, and the pattern as the template."""
    rng = np.random.default_rng(0)
    image = rng.integers(90, 110, (120, 160)).astype(np.uint8)
    pattern = np.kron(rng.integers(0, 2, (6, 6)), np.ones((4, 4))) * 160 + 40
    image[20:44, 30:54], image[80:104, 110:134] = pattern, pattern / 2
    paths = tmp_path / "image.png", tmp_path / "template.png"
    for path, picture in zip(paths, (image, image[20:44, 30:54]), strict=True):
        cv2.imwrite(str(path), picture)
    return paths


def test_compare_prints_a_table_and_draws_a_picture(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new folder" / "picture.png"
    assert main(["compare", *map(str, pair), "--out", str(out)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0].split() == ["best", "x", "y", "threshold", "matches", "ms"]
    rows = {line.split()[0]: line.split()[1:] for line in table[2:7]}
    assert list(rows) == ["ssd", "sad", "ncc", "zncc", "sed"]
    assert [rows["ssd"][i] for i in (0, 1, 2, 4)] == ["0", "30", "20", "1"]
    assert [rows["zncc"][i] for i in (0, 1, 2, 4)] == ["1", "30", "20", "2"]  # the dark one, too
    picture = cv2.imread(str(out))
    assert picture is not None and picture.shape[1] > 1000


def test_compare_as_json_with_a_rule_a_threshold_and_a_mask(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), np.pad(np.full((12, 24), 255, np.uint8), ((0, 12), (0, 0))))
    options = ["--methods", "zncc", "ncc", "--threshold", "0.99", "--rule", "nms", "--mask", str(mask), "--json"]
    assert main(["compare", *map(str, pair), *options, "--out", str(tmp_path / "a.png")]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert list(rows) == ["zncc", "ncc"] and rows["zncc"]["threshold"] == 0.99
    assert [match["centre_px"] for match in rows["zncc"]["found"]] == [[41.5, 31.5], [121.5, 91.5]]
    assert rows["zncc"]["found"][0]["score"] == 1.0


def test_compare_a_template_without_contrast(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flat = tmp_path / "flat.png"
    cv2.imwrite(str(flat), np.full((20, 20), 100, np.uint8))
    options = ["--methods", "sad", "zncc", "sed", "--out", str(tmp_path / "a.png")]
    assert main(["compare", str(pair[0]), str(flat), *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].split()[:4] == ["zncc", "-", "-", "-"] and lines[2].split()[1] != "-"
    assert lines[5].startswith("zncc, sed: the same score everywhere")
    assert main(["compare", str(pair[0]), str(flat), *options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["zncc"]["best"] is None


def test_compare_with_a_matcher_of_ones_own(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from occlib.matching.measures import METHODS

    own = tmp_path / "own.py"
    own.write_text(
        "from occlib import matching\n"
        "@matching.matcher('half', higher_is_better=False)\n"
        "def half(image, template, mask):\n"
        "    return matching.METHODS['ssd'].score(image, template, mask) / 2\n"
    )
    try:
        options = ["--matchers", str(own), "--methods", "ssd", "half", "--out", str(tmp_path / "a.png")]
        assert main(["compare", *map(str, pair), *options]) == 0
    finally:
        METHODS.pop("half", None)
    assert capsys.readouterr().out.splitlines()[3].split()[:4] == ["half", "0", "30", "20"]


@pytest.mark.parametrize(
    "options, message",
    [
        (["--methods", "zssd"], "method: expected one of ssd, sad, ncc, zncc, sed, got 'zssd'"),
        (["--threshold", "-1"], "threshold: expected 0 to inf for ssd, got -1.0"),
        (["--threshold", "half"], "threshold: expected a finite number, 'otsu', 'mad' or None, got 'half'"),
        (["--rule", "best"], "rule: expected one of components, nms, got 'best'"),
        (["--out", "picture.jpg"], "--out: expected a file name that ends in .png, got picture.jpg"),
        (["--mask", "nowhere.png"], "nowhere.png: cannot read the image"),
        (["--matchers", "nowhere.py"], "nowhere.py"),
    ],
)
def test_compare_says_what_is_wrong(
    pair: tuple[Path, Path], options: list[str], message: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, "compare", *pair, *options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["image.png", "template.png"]


def test_compare_template_larger_than_the_image_or_no_picture(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, template = pair
    out = tmp_path / "a.png"
    message = fails(capsys, "compare", template, image, "--out", out)
    assert message == "template: expected no larger than the image (24, 24), got (120, 160)"
    template.write_text("no picture")
    assert "template.png" in fails(capsys, "compare", image, template, "--out", out)
    assert not out.exists()


# --- broadcast and listen --------------------------------------------------------------------------------
@contextmanager
def broadcasting(*arguments: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """``occlib broadcast`` in a process of its own, and where it publishes."""
    command = [sys.executable, "-m", "occlib.cli", "broadcast", "--address", "tcp://127.0.0.1:*", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout and process.stderr
    try:
        first = process.stderr.readline()
        assert first.startswith("publishing at tcp://127.0.0.1:"), first + process.stderr.read()
        yield process, first.split()[-1]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def stopped(process: subprocess.Popen[str], how: signal.Signals) -> str:
    """What a command that is interrupted says last; it must leave in peace."""
    process.send_signal(how)
    assert process.wait(5) == 0
    assert process.stdout and process.stderr
    assert process.stderr.read() == ""
    (line,) = process.stdout.read().splitlines()
    return line


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_broadcast_and_listen(
    how: signal.Signals, tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with broadcasting(tiny_recording, "--loop") as (process, address):
        assert main(["listen", address, "--count", "3", "--timeout", "5", "--json", "--maps"]) == 0
        said = capsys.readouterr()
        assert said.err.splitlines() == [f"listening to {address}", "3 maps received, 0 missed, 0 rejected"]
        lines = [json.loads(line) for line in said.out.splitlines()]
        assert [line["sequence"] for line in lines] == [lines[0]["sequence"] + i for i in range(3)]
        for line in lines:
            assert line["t_capture"] <= line["t_sent"] <= time.time()
            assert 0 < line["latency_ms"] < 5000
            assert len(line["objects"]) == 2 and list(line["objects"][0])[:3] == ["id", "x", "y"]
            grid = np.array(line["map"].pop("data")).reshape(60, 80)
            counts = {
                name: int((grid == value).sum()) for name, value in (("free", 0), ("occupied", 100), ("unknown", -1))
            }
            assert line["map"] == {
                "width": 80,
                "height": 60,
                "resolution": 0.05,
                "origin": [0.0, 0.0],
                "counts": counts,
            }
            assert counts["occupied"] > 100
        plot = tmp_path / "map.png"
        assert main(["listen", address, "--count", "2", "--timeout", "5", "--plot", str(plot)]) == 0
        assert cv2.imread(str(plot)) is not None
        assert [line.split()[3:5] for line in capsys.readouterr().out.splitlines()] == [["2", "objects"]] * 2
        assert re.match(r"\d+ maps published; frames dropped: \d+ of left, \d+ of right$", stopped(process, how))
    assert main(["listen", address, "--count", "1", "--timeout", "0.1"]) == 1
    assert capsys.readouterr().err.endswith("\n0 maps received, 0 missed, 0 rejected\n")


def test_listen_is_interrupted(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "occlib.cli", "listen", f"ipc://{tmp_path}/nobody"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr and process.stdout
    try:
        assert process.stderr.readline() == f"listening to ipc://{tmp_path}/nobody\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(5) == 0
        assert (process.stdout.read(), process.stderr.read()) == ("", "0 maps received, 0 missed, 0 rejected\n")
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def test_broadcast_of_live_cameras(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    videos = []
    for name in ("left", "right"):
        videos.append(str(tmp_path / f"{name}.avi"))
        writer = cv2.VideoWriter(videos[-1], cv2.VideoWriter.fourcc(*"MJPG"), 10, (160, 120))
        if not writer.isOpened():
            pytest.skip("this OpenCV cannot write MJPG")
        for frame in [0] * 14 + [0, 1, 2, 3, 4] + [4] * 4:
            writer.write(cv2.imread(str(tiny_recording / f"frames/{name}/{frame:04d}.png")))
        writer.release()
    rig = ["--rig", tiny_recording / "rig.yaml", "--background", tiny_recording / "background"]
    with broadcasting("--device", *videos, *rig) as (process, address):
        assert main(["listen", address, "--count", "2", "--timeout", "5", "--json"]) == 0
        for line in capsys.readouterr().out.splitlines():
            assert len(json.loads(line)["objects"]) == 2
        assert process.wait(8) == 0
        assert process.stdout
        said = process.stdout.read()
        assert re.match(
            r"\d+ maps published; frames dropped: \d+ of left, \d+ of right, skew at most \d+\.\d ms\n$", said
        )


def test_cameras_that_fail_are_named(
    tiny_recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Broken:
        def __init__(self, device: str, *, size: tuple[int, int]) -> None:
            assert (device, size) == ("0", (160, 120))

        def read(self) -> None:
            raise RuntimeError("the driver fell over")

        def release(self) -> None:
            pass

    monkeypatch.setattr("occlib.live.capture.Device", Broken)
    rig = ["--rig", str(tiny_recording / "rig.yaml"), "--background", str(tiny_recording / "background")]
    assert main(["broadcast", "--device", "0", "0", "--address", "tcp://127.0.0.1:*", *rig]) == 0
    said = capsys.readouterr()
    assert said.out == "0 maps published; frames dropped: 0 of left, 0 of right, skew at most 0.0 ms\n"
    for name in ("left", "right"):
        assert f"occlib broadcast: warning: {name}: RuntimeError: the driver fell over\n" in said.err


def test_keys_and_their_use(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("server", "robot"):
        assert main(["broadcast", "keygen", name, "--out", str(tmp_path / name)]) == 0
        assert capsys.readouterr().out.splitlines()[1] == f"{tmp_path / name / name}.key_secret: secret"
    secret, public = tmp_path / "server/server.key_secret", tmp_path / "server/server.key"
    with broadcasting(tiny_recording, "--loop", "--keys", secret, "--allow", tmp_path / "robot") as (_, address):
        keys = ["--keys", str(tmp_path / "robot/robot.key_secret"), "--server-key", str(public)]
        assert main(["listen", address, "--count", "1", "--timeout", "5", *keys]) == 0
        assert main(["listen", address, "--count", "1", "--timeout", "0.3"]) == 1
    assert "is not overwritten" in fails(capsys, "broadcast", "keygen", "robot", "--out", tmp_path / "robot")
    assert fails(capsys, "broadcast", "keygen").startswith("keygen: expected a name")


def test_wrong_broadcasts(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = ("--rig", tiny_recording / "rig.yaml", "--background", tiny_recording / "background")
    cases: list[tuple[list[object], str]] = [
        (["nowhere"], "nowhere: no such recording folder"),
        ([], "expected either a recording, or --device"),
        ([tiny_recording, "x"], "expected either a recording, or --device"),
        ([tiny_recording, "--device", "97"], "expected either a recording, or --device"),
        ([tiny_recording, "--rate", "-1"], "rate: expected instants a second >= 0, got -1.0"),
        ([tiny_recording, "--rule", "x"], "rule: expected one of"),
        ([tiny_recording, "--address", "tcp://0.0.0.0:*"], "address: expected 127.0.0.1 without keys"),
        ([tiny_recording, "--keys", tmp_path / "no"], "keys, allowed (--keys, --allow): expected both or neither"),
        (
            [tiny_recording, "--keys", tmp_path / "no", "--allow", tiny_recording],
            "allowed: expected at least one public key",
        ),
        (["--device", "97", "98"], "--device: expected --rig and --background"),
        (["--device", "97", *rig], "--device: expected one for each of left, right, got 1"),
        (["--device", "97", "98", *rig], "device 97: cannot be opened"),
        (["--device", "97", "98", *rig[:3], tmp_path], f"--background: {tmp_path} has no pictures of left, right"),
    ]
    for arguments, said in cases:
        assert fails(capsys, "broadcast", *arguments).startswith(said), arguments
    with Publisher() as publisher:
        error = fails(capsys, "broadcast", tiny_recording, "--address", publisher.address)
        assert error.startswith("address: cannot publish at") and "in use" in error
    assert fails(capsys, "listen", "here").startswith("address: expected tcp://HOST:PORT")
    assert fails(capsys, "listen", "--plot", "map.jpg").startswith("--plot: expected a file name that ends in .png")
    assert fails(capsys, "listen", "--count", "0").startswith("--count: expected a number > 0")
    assert fails(capsys, "listen", "--timeout", "nan").startswith("--timeout: expected seconds > 0")
