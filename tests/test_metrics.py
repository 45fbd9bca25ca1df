"""Scores: planted matches, bounds, the naive reference, and wrong arguments named in one line."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib import formats, metrics
from occlib.formats import DetectedObject, TrueObject, Truth
from occlib.geometry import Floor
from occlib.metrics import (
    evaluate,
    evaluate_hidden,
    foreground_scores,
    inside_polygon,
    match_points,
)
from occlib.tracking import ObjectVector

UFES = Path(__file__).parents[2] / "shared/data" / "ufes-lab"
SQUARE: list[list[float]] = [[0, 0], [1, 0], [1, 1], [0, 1]]
POINTS = st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), max_size=4)


def truth_of(*frames: list[tuple[float, float]], roi: dict[str, Any] | None = None) -> Truth:
    return Truth({i: [TrueObject(x=x, y=y) for x, y in places] for i, places in enumerate(frames)}, roi or {})


# --- matching --------------------------------------------------------------------------------------
def match_points_naive(detected: Any, true: Any, radius: float) -> list[tuple[int, int, float]]:
    """The same as :func:`match_points` by trying every assignment; only for a handful of points."""
    distance = [[math.dist(a, b) for b in true] for a in detected]

    def best(i: int, free: frozenset[int]) -> list[tuple[int, int, float]]:
        if i == len(distance):
            return []
        options = [best(i + 1, free)]
        for j in sorted(free):
            if distance[i][j] < radius:
                options.append([(i, j, distance[i][j]), *best(i + 1, free - {j})])
        return min(options, key=lambda pairs: (-len(pairs), sum(d for _, _, d in pairs)))

    return best(0, frozenset(range(len(true))))


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
    assert score.ghosts_per_frame == pytest.approx(2 / 3)  # the empty third frame counts
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
    assert (evaluate({}, truth_of([])).ghosts_per_frame, evaluate({}, truth_of()).ghosts_per_frame) == (0.0, None)
    assert evaluate({}, truth_of([(0, 0)])).moda == 0.0


def test_roi_keeps_truth_and_detections_inside_only() -> None:
    truth = truth_of([(0.5, 0.5), (3, 3)], roi={"square": SQUARE})
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
    truth = Truth({i: [TrueObject(id="A", x=0, y=0)] for i in range(4)})
    seen = {i: [DetectedObject(id=n, x=0, y=0)] for i, n in ((0, 1), (1, 1), (3, 2))}
    assert evaluate(seen, truth).id_switches == 1
    assert evaluate({0: [[0, 0]]}, truth).id_switches is None


def test_recall_by_hidden_fraction_uses_the_worst_view() -> None:
    truth = Truth(
        {
            0: [
                TrueObject(x=0, y=0, hidden_fraction={"left": 1.0, "right": 0.1}),
                TrueObject(x=2, y=0, hidden_fraction={"left": 0.5}),
                TrueObject(x=4, y=0),
            ]
        }
    )
    detections = {0: [[0, 0], [4, 0]]}
    rows = metrics.recall_by_hidden_fraction(detections, truth, edges=(0, 0.5, 1.0))
    assert [(r["count"], r["recall"]) for r in rows] == [(1, 1.0), (2, 0.5)]
    right = metrics.recall_by_hidden_fraction(detections, truth, cameras=["right"], edges=(0, 0.5, 1.0))
    assert [(r["count"], r["recall"]) for r in right] == [(3, 2 / 3), (0, None)]
    with pytest.raises(ValueError, match="edges: expected two or more increasing"):
        metrics.recall_by_hidden_fraction(detections, truth, edges=(1, 0))


def test_best_below_keeps_what_one_view_lost_and_another_sees() -> None:
    states: list[dict[str, float]] = [
        {"left": 1.0, "right": 0.0},  # lost by one, seen by the other
        {"left": 0.2, "right": 0.9},  # at the threshold: lost
        {"left": 1.0, "right": 0.9},  # lost by both
        {"left": 1.0},  # outside the right picture: not seen there
        {"left": 0.0, "right": 0.0},  # plain
        {},  # nothing known
    ]
    truth = Truth({0: [TrueObject(x=2 * i, y=0, hidden_fraction=s) for i, s in enumerate(states)]})
    detections = {0: [[0, 0], [4, 0], [6, 0], [8, 0]]}

    def lost_by_one(**options: Any) -> tuple[Any, Any]:
        (row,) = metrics.recall_by_hidden_fraction(detections, truth, edges=(0.9, 1.0), **options)
        return row["count"], row["recall"]

    assert lost_by_one() == (4, 3 / 4)
    assert lost_by_one(best_below=0.9) == (2, 1 / 2)
    assert lost_by_one(best_below=0.9, cameras=["left", "right"]) == (2, 1 / 2)
    assert lost_by_one(best_below=0.9, cameras=["left"]) == (0, None)
    assert lost_by_one(best_below=0.2) == (1, 1.0)  # strictly below
    (seen,) = metrics.recall_by_hidden_fraction(detections, truth, edges=(0, 1), best_below=0.9)
    assert seen["count"] == 3  # without a known fraction no view is known to see it
    for wrong in (0.0, 1.1, float("nan")):
        with pytest.raises(ValueError, match=r"best_below: expected a fraction in \(0, 1\], got"):
            lost_by_one(best_below=wrong)
    with pytest.raises(ValueError, match="cameras: expected a sequence of names, got 'left'"):
        lost_by_one(cameras="left")


# --- occlusion state -------------------------------------------------------------------------------
CAMERAS = ("left", "right", "third")
FRACTIONS = st.dictionaries(st.sampled_from(CAMERAS), st.sampled_from([0.0, 0.5, 0.9, 1.0]))
REPORTS = st.one_of(st.none(), st.sets(st.sampled_from(CAMERAS)))  # None: the object was lost


def hidden_case(*objects: tuple[dict[str, float], Any]) -> tuple[dict[int, list[DetectedObject]], Truth]:
    """Objects 2 m apart as (hidden fractions, cameras reported or None for a lost one) -> detections, truth."""
    truth = [TrueObject(x=2 * i, y=0, hidden_fraction=fractions) for i, (fractions, _) in enumerate(objects)]
    found = [
        DetectedObject(x=2 * i + 0.1, y=0, hidden_in=tuple(sorted(r)))
        for i, (_, r) in enumerate(objects)
        if r is not None
    ]
    return {0: found[::-1]}, Truth({0: truth})


def test_planted_hidden_score_by_hand() -> None:
    detections, truth = hidden_case(
        ({"left": 1.0, "right": 0.0}, {"left"}),  # tp, true negative
        ({"left": 0.9, "right": 0.89}, {"right"}),  # fn: from the threshold on; fp: just below it
        ({"left": 1.0, "right": 0.0}, None),  # lost: fn, and nothing to compare
        ({"left": 0.0}, {"left", "right"}),  # fp; right is unknown
        ({}, {"left"}),  # unknown altogether
    )
    detections[0].append(DetectedObject(x=50, y=0, hidden_in=("left",)))  # a ghost has no true state
    score = evaluate_hidden(detections, truth)
    assert (score.tp, score.fp, score.fn, score.compared) == (1, 2, 2, 5)
    assert (score.precision, score.recall, score.f1) == (1 / 3, 1 / 3, 1 / 3)
    left = evaluate_hidden(detections, truth, cameras=["left"])
    assert (left.tp, left.fp, left.fn, left.compared) == (1, 1, 2, 3)
    assert (left.precision, left.recall, left.f1) == (1 / 2, 1 / 3, 2 / 5)
    strict = evaluate_hidden(detections, truth, hidden=0.95)
    assert (strict.tp, strict.fp, strict.fn) == (1, 2, 1)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(FRACTIONS, REPORTS), max_size=5), st.sets(st.sampled_from(CAMERAS)))
def test_hidden_score_agrees_with_sets(objects: list[tuple[dict[str, float], Any]], cameras: set[str]) -> None:
    known = {(i, name) for i, (fractions, _) in enumerate(objects) for name in fractions if name in cameras}
    hidden = {(i, name) for i, name in known if objects[i][0][name] >= 0.9}
    reported = {(i, name) for i, name in known if name in (objects[i][1] or ())}
    score = evaluate_hidden(*hidden_case(*objects), cameras=sorted(cameras))
    assert (score.tp, score.fp, score.fn) == (
        len(hidden & reported),
        len(reported - hidden),
        len(hidden - reported),
    )
    assert score.compared == sum(objects[i][1] is not None for i, _ in known)
    assert score.precision == (len(hidden & reported) / len(reported) if reported else None)
    assert score.recall == (len(hidden & reported) / len(hidden) if hidden else None)


def test_hidden_score_is_none_where_undefined() -> None:
    plain = evaluate_hidden(*hidden_case(({"left": 0.0}, set())))
    assert (plain.precision, plain.recall, plain.f1, plain.compared) == (None, None, None, 1)
    detections, truth = {0: [DetectedObject(x=0, y=0, hidden_in=("left",))]}, truth_of([(0, 0)])
    unknown = evaluate_hidden(detections, truth)
    assert (unknown.precision, unknown.recall, unknown.f1, unknown.compared) == (None, None, None, 0)
    silent = evaluate_hidden({0: [[0, 0]]}, hidden_case(({"left": 1.0}, None))[1])  # points say nothing
    assert (silent.precision, silent.recall, silent.f1, silent.compared) == (None, 0.0, 0.0, 1)


def test_hidden_score_respects_region_and_radius() -> None:
    detections, truth = hidden_case(({"left": 1.0}, {"left"}), ({"left": 1.0}, {"left"}))
    truth = Truth(truth.frames, {"square": ((-1, -1), (1, -1), (1, 1), (-1, 1))})
    assert evaluate_hidden(detections, truth).tp == 2
    assert evaluate_hidden(detections, truth, roi="square").tp == 1
    near = evaluate_hidden(detections, truth, radius=0.05)
    assert (near.tp, near.fn, near.compared) == (0, 2, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hidden": 0.0}, r"hidden: expected a fraction in \(0, 1\], got 0.0"),
        ({"hidden": 90}, r"hidden: expected a fraction in \(0, 1\], got 90"),
        ({"hidden": float("nan")}, r"hidden: expected a fraction in \(0, 1\], got nan"),
        ({"cameras": "left"}, "cameras: expected a sequence of names, got 'left'"),
        ({"roi": "hall"}, "roi: 'hall' is not in the truth, which has none"),
        ({"radius": 0}, "radius: expected metres > 0, got 0"),
    ],
)
def test_hidden_score_names_wrong_arguments(change: dict[str, Any], message: str) -> None:
    arguments = {"detections": {}, "truth": truth_of([(0, 0)]), **change}
    with pytest.raises(ValueError, match=message):
        evaluate_hidden(arguments.pop("detections"), arguments.pop("truth"), **arguments)


def test_inputs_are_unchanged_and_the_result_repeats() -> None:
    truth = truth_of([(0.2, 0.2), (2, 0)], roi={"square": SQUARE})
    detections = {0: np.array([[0.1, 0.0], [3, 3]])}
    before = copy.deepcopy((truth, detections[0].tolist()))
    assert evaluate(detections, truth, roi="square") == evaluate(detections, truth, roi="square")
    assert (truth, detections[0].tolist()) == before


def test_hidden_scores_leave_their_inputs_unchanged() -> None:
    detections, truth = hidden_case(({"left": 1.0, "right": 0.0}, {"left"}), ({"left": 0.0}, None))
    before = copy.deepcopy((detections, truth))
    for score in (evaluate_hidden, lambda d, t: metrics.recall_by_hidden_fraction(d, t, best_below=0.9)):
        assert score(detections, truth) == score(detections, truth)  # type: ignore[operator]
        assert (detections, truth) == before


def test_object_vectors_and_objects_of_a_file_score_alike() -> None:
    vector = ObjectVector(3, (0.1, 0.0), (0.0, 0.0), 0.04, (1, 2, 3), hidden_in=("left",))
    read = formats.convert(vector.to_dict(), DetectedObject)
    truth = Truth({0: [TrueObject(id="A", x=0, y=0, hidden_fraction={"left": 1.0})]})
    assert evaluate({0: [vector]}, truth) == evaluate({0: [read]}, truth)
    assert evaluate({0: [vector]}, truth).id_switches == 0
    assert evaluate_hidden({0: [vector]}, truth) == evaluate_hidden({0: [read]}, truth)
    assert evaluate_hidden({0: [vector]}, truth).tp == 1


def test_frames_of_the_truth_are_scored_in_order() -> None:
    truth = Truth({i: [TrueObject(id="A", x=0, y=0)] for i in (0, 2, 1)})
    seen = {i: [DetectedObject(id=n, x=0, y=0)] for i, n in ((0, 1), (1, 1), (2, 2))}
    assert evaluate(seen, truth).id_switches == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"roi": "hall"}, "roi: 'hall' is not in the truth, which has none"),
        ({"radius": 0.0}, "radius: expected metres > 0, got 0.0"),
        ({"radius": float("nan")}, "radius: expected metres > 0"),
        ({"truth": {"frames": {}}}, "truth: expected a Truth, as load_truth gives it, got dict"),
        ({"truth": Truth({4: [TrueObject(x=np.inf, y=0)]})}, r"truth.frames.4\[0\].x: expected finite metres, got inf"),
        ({"detections": {0: [[1, 2, 3]]}}, r"detections\[0\]: expected shape \(N, 2\)"),
        ({"detections": {0: [[np.nan, 0]]}}, r"detections\[0\]\[0\].x: expected finite metres, got nan"),
        (
            {"detections": {0: [DetectedObject(x=0, y=np.nan)]}},
            r"detections\[0\]\[0\].y: expected finite metres, got nan",
        ),
        (
            {"detections": {0: [DetectedObject(x=0, y=0), 5]}},
            r"detections\[0\]\[1\]: expected an object with x and y, got int",
        ),
        (
            {"detections": {0: [{"x": 0, "y": 0}]}},
            r"detections\[0\]: expected objects with x and y, or points .N, 2., got .* dict",
        ),
    ],
)
def test_wrong_arguments(change: dict[str, Any], message: str) -> None:
    arguments = {"detections": {}, "truth": truth_of([(0, 0)]), **change}
    with pytest.raises(ValueError, match=message):
        evaluate(arguments.pop("detections"), arguments.pop("truth"), **arguments)


def test_unknown_region_lists_those_there_are() -> None:
    truth = truth_of([], roi={"west": SQUARE, "east": SQUARE})
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


@pytest.mark.skipif(not UFES.is_dir(), reason=f"real recording not at {UFES}")
def test_real_truth_scores_itself_perfectly() -> None:
    truth = formats.load_truth(UFES / "truth.json")
    detections = {k: [DetectedObject(id=t.id, x=t.x, y=t.y) for t in true] for k, true in truth.frames.items()}
    for roi in (None, *truth.roi):
        score = evaluate(detections, truth, roi=roi)
        assert (score.moda, score.modp, score.frames) == (1.0, 1.0, 28)
    assert evaluate(detections, truth).truth_count == 56


def test_foreground_scores_count_what_they_say() -> None:
    truth = np.zeros((40, 40), bool)
    truth[10:20, 10:20] = True
    difference = np.zeros((40, 40))
    difference[10:20, 10:20] = 80
    difference[12:18, 10:20] = 10  # camouflage: it cannot be told from the floor, and does not count as missed object
    difference[20:30, 10:20] = 40  # shadow, of which the first two rows are too near to be judged
    scores = foreground_scores(truth.copy(), truth, difference)
    assert scores == {"f_measure": 1.0, "shadow_detection": 1.0, "shadow_discrimination": 1.0}
    mask = truth.copy()
    mask[10:12, 10:20] = False  # half of what differs
    mask[20:24, 10:20] = True  # two rows of eight that count
    scores = foreground_scores(mask, truth, difference)
    assert scores["shadow_detection"] == 0.75 and scores["shadow_discrimination"] == 0.5
    assert scores["f_measure"] == pytest.approx(2 * 80 / (100 + 120))
    nothing = foreground_scores(np.zeros((4, 4), bool), np.zeros((4, 4), bool), np.zeros((4, 4)))
    assert all(math.isnan(value) for value in nothing.values())
    with pytest.raises(ValueError, match="mask, truth, difference: expected bool, bool and numbers of one shape"):
        foreground_scores(mask, truth[:5], difference)


# --- identity ------------------------------------------------------------------------------------------------
def test_labels_are_right_wrong_or_missing_and_sizes_are_ratios() -> None:
    square = [(0.0, 0.0), (0.5, 0.0), (0.5, 0.4), (0.0, 0.4)]
    truth = Truth({f: [TrueObject(id="A", x=0, y=0, footprint=square), TrueObject(id="B", x=2, y=0)] for f in range(4)})
    labels = [("x", "y"), ("x", "y"), ("y", "x"), (None, "y")]
    found = {
        f: [DetectedObject(x=0, y=0, label=a, size=0.4), DetectedObject(x=2, y=0.1, label=b, size=0.3)]
        for f, (a, b) in enumerate(labels)
    }
    score = metrics.evaluate_identity(found, truth)
    assert (score.right, score.wrong, score.unlabelled) == (5, 2, 1)
    assert score.label_of == {"A": "x", "B": "y"}
    assert score.size_ratio == {"A": pytest.approx(2.0)}
    nothing = metrics.evaluate_identity({}, truth)
    assert (nothing.right, nothing.wrong, nothing.unlabelled, nothing.label_of) == (0, 0, 0, {})


def test_identity_needs_ids_and_skips_footprints_without_area() -> None:
    line = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]
    found = {0: [DetectedObject(x=0, y=0, label="x", size=0.4)]}
    assert metrics.evaluate_identity(found, Truth({0: [TrueObject(id="A", x=0, y=0, footprint=line)]})).size_ratio == {}
    with pytest.raises(ValueError, match="truth: expected objects with an id, got one without"):
        metrics.evaluate_identity(found, Truth({0: [TrueObject(x=0, y=0)]}))
