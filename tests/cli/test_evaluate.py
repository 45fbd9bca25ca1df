"""``occlib evaluate``: the scores, and one line for whatever is wrong with the files."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from helpers.commands import fails, run
from occlib.cli import main


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
