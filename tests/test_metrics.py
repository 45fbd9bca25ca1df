"""Scores: planted matches, bounds, the naive reference, and every malformed file named in one line."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib import metrics
from occlib.geometry import Floor
from occlib.metrics import evaluate, inside_polygon, match_points, match_points_naive

UFES = Path(__file__).parents[2] / "shared/data" / "ufes-lab"
SQUARE: list[list[float]] = [[0, 0], [1, 0], [1, 1], [0, 1]]
POINTS = st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), max_size=4)


def truth_of(*frames: list[tuple[float, float]]) -> dict[str, Any]:
    return {"units": "m", "frames": {str(i): [{"x": x, "y": y} for x, y in f] for i, f in enumerate(frames)}}


# --- matching --------------------------------------------------------------------------------------
@settings(max_examples=200, deadline=None)
@given(POINTS, POINTS)
def test_matching_agrees_with_brute_force(detected: list[tuple[float, float]], true: list[tuple[float, float]]) -> None:
    fast, naive = match_points(detected, true, 0.5), match_points_naive(detected, true, 0.5)
    assert len(fast) == len(naive)
    assert sum(d for *_, d in fast) == pytest.approx(sum(d for *_, d in naive), abs=1e-9)
    assert len({i for i, _, _ in fast}) == len({j for _, j, _ in fast}) == len(fast)
    assert all(d < 0.5 for *_, d in fast)


def test_matching_prefers_two_matches_to_one_near_one() -> None:
    # The greedy nearest pair (0.0 to 0.1) would leave the other two 0.8 m apart.
    pairs = match_points([[0.0, 0], [0.5, 0]], [[0.1, 0], [-0.3, 0]], 0.5)
    assert [(i, j) for i, j, _ in pairs] == [(0, 1), (1, 0)]


def test_distance_exactly_the_radius_is_a_miss() -> None:
    assert match_points([[0.5, 0]], [[0, 0]], 0.5) == []
    assert len(match_points([[np.nextafter(0.5, 0), 0]], [[0, 0]], 0.5)) == 1


# --- scores ----------------------------------------------------------------------------------------
def test_planted_score_by_hand() -> None:
    truth = truth_of([(0, 0), (2, 0)], [(0, 0)], [])
    score = evaluate({0: [[0.1, 0], [5, 5]], 1: [[0, 0.3]], 2: [[1, 1]]}, truth, radius=0.5)
    assert (score.tp, score.fp, score.fn, score.truth_count, score.frames) == (2, 2, 1, 3, 3)
    assert score.moda == pytest.approx(1 - 3 / 3)
    assert score.modp == pytest.approx((0.8 + 0.4) / 2)
    assert (score.precision, score.recall) == (pytest.approx(2 / 4), pytest.approx(2 / 3))
    assert score.f1 == pytest.approx(2 * 0.5 * (2 / 3) / (0.5 + 2 / 3))
    assert score.error_mean_m == pytest.approx(0.2)
    assert evaluate({0: [[0.1, 0]]}, truth_of([(0, 0)])).error_median_m == pytest.approx(0.1)


def test_truth_frames_without_detections_count_and_moda_goes_below_zero() -> None:
    truth = truth_of([(0, 0)], [(0, 0)])
    score = evaluate({0: [[0, 0]]}, truth)
    assert (score.moda, score.moda_public) == (0.5, 1.0)
    ghosts = evaluate({0: [[5, 5], [6, 6], [7, 7]]}, truth)
    assert (ghosts.moda, ghosts.moda_public) == (-1.5, 0.0)


def test_detections_in_frames_without_truth_are_ignored() -> None:
    assert evaluate({0: [[0, 0]], 7: [[1, 1]]}, truth_of([(0, 0)])).fp == 0


def test_undefined_scores_are_none_and_json_has_no_nan() -> None:
    for truth, detections in [(truth_of([]), {}), (truth_of([]), {0: [[1, 1]]}), (truth_of([(0, 0)]), {})]:
        score = evaluate(detections, truth)
        text = json.dumps(score.to_dict(), allow_nan=False)
        assert json.loads(text)["modp"] is None
    assert evaluate({}, truth_of([])).moda is None
    assert evaluate({}, truth_of([(0, 0)])).moda == 0.0


def test_roi_keeps_truth_and_detections_inside_only() -> None:
    truth = {**truth_of([(0.5, 0.5), (3, 3)]), "roi": {"square": SQUARE}}
    score = evaluate({0: [[0.5, 0.6], [2, 2]]}, truth, roi="square")
    assert (score.tp, score.fp, score.fn) == (1, 0, 0)
    assert evaluate({0: [[0.5, 0.6], [2, 2]]}, truth).fp == 1


def test_points_on_the_boundary_are_inside() -> None:
    edge = np.array([[0, 0.5], [1, 0.5], [0.5, 0], [0.5, 1], *SQUARE])
    assert inside_polygon(edge, SQUARE).all() and inside_polygon(edge, SQUARE[::-1]).all()
    assert not inside_polygon(np.array([[1.001, 0.5], [-1, 0], [2, 1], [0.5, -0.001]]), SQUARE).any()
    assert inside_polygon(np.empty((0, 2)), SQUARE).shape == (0,)


@settings(max_examples=100, deadline=None)
@given(st.floats(-2, 2), st.floats(-2, 2))
def test_inside_agrees_with_the_analytic_l_shape(x: float, y: float) -> None:
    shape = [[-1, -1], [1, -1], [1, 0], [0, 0], [0, 1], [-1, 1]]
    analytic = -1 <= x <= 1 and -1 <= y <= 1 and not (x > 0 and y > 0)
    if min(abs(abs(v) - k) for v in (x, y) for k in (0, 1)) > 1e-8:
        assert inside_polygon([[x, y]], shape)[0] == analytic


def test_id_switches_are_counted_over_gaps() -> None:
    truth = {"frames": {str(i): [{"id": "A", "x": 0, "y": 0}] for i in range(4)}}
    seen = {i: [{"id": n, "x": 0, "y": 0}] for i, n in ((0, 1), (1, 1), (3, 2))}
    assert evaluate(seen, truth).id_switches == 1
    assert evaluate({0: [[0, 0]]}, truth).id_switches is None


def test_recall_by_hidden_fraction_uses_the_worst_view() -> None:
    truth = {
        "frames": {
            "0": [
                {"x": 0, "y": 0, "hidden_fraction": {"left": 1.0, "right": 0.1}},
                {"x": 2, "y": 0, "hidden_fraction": {"left": 0.5}},
                {"x": 4, "y": 0},
            ]
        }
    }
    detections = {0: [[0, 0], [4, 0]]}
    rows = metrics.recall_by_hidden_fraction(detections, truth, edges=(0, 0.5, 1.0))
    assert [(r["count"], r["recall"]) for r in rows] == [(1, 1.0), (2, 0.5)]
    right = metrics.recall_by_hidden_fraction(detections, truth, cameras=["right"], edges=(0, 0.5, 1.0))
    assert [(r["count"], r["recall"]) for r in right] == [(3, 2 / 3), (0, None)]
    with pytest.raises(ValueError, match="edges: expected two or more increasing"):
        metrics.recall_by_hidden_fraction(detections, truth, edges=(1, 0))


def test_inputs_are_unchanged_and_the_result_repeats() -> None:
    truth = {**truth_of([(0.2, 0.2), (2, 0)]), "roi": {"square": SQUARE}}
    detections = {0: np.array([[0.1, 0.0], [3, 3]])}
    before = copy.deepcopy((truth, detections[0].tolist()))
    assert evaluate(detections, truth, roi="square") == evaluate(detections, truth, roi="square")
    assert (truth, detections[0].tolist()) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"roi": "hall"}, "roi: 'hall' is not in the truth, which has none"),
        ({"radius": 0.0}, "radius: expected metres > 0, got 0.0"),
        ({"radius": float("nan")}, "radius: expected metres > 0"),
        ({"truth": []}, "truth: expected a mapping with 'units' and 'frames'"),
        ({"truth": {"units": "mm", "frames": {}}}, "truth.units: expected 'm', got 'mm'"),
        ({"truth": {"frames": {"one": []}}}, "expected whole numbers as keys, got 'one'"),
        ({"truth": {"frames": {"1": [], "01": []}}}, "frame 1 comes twice"),
        (
            {"truth": {"frames": {"0": [{"x": 1}]}}},
            r"truth.frames.0\[0\].y: expected finite metres, got None",
        ),
        ({"detections": {0: [[1, 2, 3]]}}, r"detections\[0\]: expected shape \(N, 2\)"),
        ({"detections": {0: [[np.nan, 0]]}}, r"detections\[0\]\[0\].x: expected finite metres, got nan"),
        ({"detections": {0: [{"x": 0, "y": 0}, 5]}}, r"detections\[0\]\[1\]: expected a mapping"),
    ],
)
def test_wrong_arguments(change: dict[str, Any], message: str) -> None:
    arguments = {"detections": {}, "truth": truth_of([(0, 0)]), **change}
    with pytest.raises(ValueError, match=message):
        evaluate(arguments.pop("detections"), arguments.pop("truth"), **arguments)


def test_unknown_region_lists_those_there_are() -> None:
    truth = {**truth_of([]), "roi": {"west": SQUARE, "east": SQUARE}}
    with pytest.raises(ValueError, match="roi: 'hall' is not in the truth, which has west, east"):
        evaluate({}, truth, roi="hall")


# --- maps ------------------------------------------------------------------------------------------
def test_coverage_and_claimed_area_of_a_planted_map() -> None:
    floor = Floor((0, 1), (0, 1), 0.1)
    occupied = np.zeros(floor.shape, bool)
    occupied[:, :5] = True  # x < 0.5
    left = np.array([[0, 0], [0.3, 0], [0.3, 1], [0, 1]])
    half, away = np.array([[0.4, 0], [0.6, 0], [0.6, 1], [0.4, 1]]), left + 5
    covered = metrics.footprint_coverage(occupied, floor, [left, half, away])
    assert covered[:2] == pytest.approx([1.0, 0.5]) and np.isnan(covered[2])
    assert metrics.claimed_area_ratio(occupied, floor, [left, left]) == pytest.approx(5 / 3)
    assert metrics.claimed_area_ratio(occupied, floor, []) is None
    with pytest.raises(ValueError, match=r"occupied: expected bool \(10, 10\), got int64"):
        metrics.footprint_coverage(occupied.astype(np.int64), floor, [left])  # type: ignore[arg-type]


# --- files -----------------------------------------------------------------------------------------
def test_objects_file_reads_back(tmp_path: Path) -> None:
    lines = [
        {"frame": 3, "time": 0.3, "objects": [{"id": 1, "x": 1.0, "y": 2.0}]},
        {"frame": 4, "objects": []},
    ]
    path = tmp_path / "objects.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)) + "\n\n")
    assert metrics.load_objects(path) == {3: lines[0]["objects"], 4: []}


GOOD = b'{"frame": 1, "objects": []}\n'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (GOOD + b"{nope", r":2: not valid JSON \(Expecting property name"),
        (GOOD + b"[" * 100_000, r":2: not valid JSON"),
        (GOOD + b"\xff\xfe", r":2: not UTF-8 text"),
        (GOOD + GOOD, r":2: frame 1 comes twice"),
        (GOOD + b'{"frame": ' + b"9" * 5000 + b"}", r":2: not valid JSON"),
        (GOOD + b"[]", r":2: expected an object with an integer 'frame'"),
        (b'{"frame": true, "objects": []}', r":1: expected an object with an integer 'frame'"),
        (b'{"frame": 1}', r":1: objects: expected a list, got NoneType"),
        (b'{"frame": 1, "objects": [{"x": 1}]}', r":1: objects\[0\].y: expected finite metres, got None"),
        (
            b'{"frame": 1, "objects": [{"x": NaN, "y": 0}]}',
            r":1: objects\[0\].x: expected finite metres, got nan",
        ),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": "2"}]}',
            r":1: objects\[0\].y: expected finite metres, got 2",
        ),
        (b'{"frame": 1, "objects": [7]}', r":1: objects\[0\]: expected a mapping"),
    ],
)
def test_malformed_objects_name_the_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "objects.jsonl"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"objects.jsonl{message}"):
        metrics.load_objects(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "expected a mapping"),
        ('{"frames": {"0": {}}}', "truth.frames.0: expected a list, got dict"),
        ('{"frames": {}, "roi": {"a": [[0, 0], [1, 1]]}}', "roi 'a': expected three or more finite points"),
        ('{"frames": {}, "roi": {"a": "hall"}}', "roi 'a': expected three or more finite points"),
    ],
)
def test_malformed_truth_names_the_field(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "truth.json"
    path.write_text(content)
    with pytest.raises(ValueError, match=f"truth.json: .*{message}"):
        metrics.load_truth(path)


def test_missing_files_are_one_line_errors(tmp_path: Path) -> None:
    for load in (metrics.load_objects, metrics.load_truth):
        with pytest.raises(ValueError, match=r"none.json: cannot read .No such file"):
            load(tmp_path / "none.json")


@pytest.mark.skipif(not UFES.is_dir(), reason=f"real recording not at {UFES}")
def test_real_truth_scores_itself_perfectly() -> None:
    truth = metrics.load_truth(UFES / "truth.json")
    detections = {int(frame): things for frame, things in truth["frames"].items()}
    for roi in (None, *truth["roi"]):
        score = evaluate(detections, truth, roi=roi)
        assert (score.moda, score.modp, score.frames) == (1.0, 1.0, 28)
    assert evaluate(detections, truth).truth_count == 56
