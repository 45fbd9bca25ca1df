"""Template matching: planted targets, thresholds, optima, sub-pixel positions, own measures, wrong arguments."""

import pickle
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import cloudpickle
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib.matching import measures
from occlib.matching.measures import METHODS
from occlib.matching.optima import optima, refine
from occlib.matching.registry import matcher
from occlib.matching.search import Match, compare, default_threshold, find, reference_similarity, similarity
from occlib.matching.thresholds import score_threshold

Array = npt.NDArray[Any]
DISTANCES = [name for name, method in METHODS.items() if not method.higher_is_better]
every_method = pytest.mark.parametrize("method", list(METHODS))


def scene(shape: tuple[int, ...] = (90, 120), seed: int = 0) -> Array:
    """A textured but not periodic uint8 picture, smooth enough to have edges."""
    coarse = np.random.default_rng(seed).integers(20, 236, (shape[0] // 6 + 1, shape[1] // 6 + 1, *shape[2:]))
    return np.kron(coarse, np.ones((6, 6) + (1,) * (len(shape) - 2), int))[: shape[0], : shape[1]].astype(np.uint8)


def robot(gain: float = 1.0) -> Array:
    """A 20 x 24 px object with a margin of floor."""
    picture = np.full((20, 24), 120.0)
    picture[5:15, 5:19] = 30
    picture[7:10, 8:16] = 220
    picture[11:13, 6:10] = 170
    return (picture * gain).astype(np.uint8)


def floor_with_robots(*corners: tuple[int, int]) -> Array:
    image = np.full((90, 120), 120, np.uint8)
    for x, y in corners:
        image[y : y + 20, x : x + 24] = robot()
    return image


def best_place(score: Array, method: str) -> tuple[int, int]:
    flat = score.argmax() if METHODS[method].higher_is_better else score.argmin()
    row, column = np.unravel_index(flat, score.shape)
    return int(column), int(row)


# ---------------------------------------------------------------- planted targets


@every_method
@pytest.mark.parametrize("tail", [(), (3,)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_a_planted_target_is_found_at_its_place(method: str, tail: tuple[int, ...], kind: type) -> None:
    image: Array = scene((90, 120, *tail)).astype(kind)
    template = image[31:61, 47:87].copy()
    score = similarity(image, template, method)
    assert best_place(score, method) == (47, 31)
    assert score[31, 47] == pytest.approx(1.0 if METHODS[method].higher_is_better else 0.0, abs=1e-12)
    match = find(image, template, method)[0]
    assert (match.x, match.y, match.width, match.height) == (47, 31, 40, 30)
    assert match.score == score[31, 47]
    assert match.centre_px == (66.5, 45.5)


@every_method
def test_a_mask_hides_what_differs(method: str) -> None:
    image = scene()
    template = image[30:60, 40:80].copy()
    mask = np.ones(template.shape, bool)
    mask[:14, :14] = False
    template[:10, :10] = 255 - template[:10, :10]  # something stood in front
    assert best_place(similarity(image, template, method, mask), method) == (40, 30)
    expected = 1.0 if METHODS[method].higher_is_better else 0.0
    assert similarity(image, template, method, mask)[30, 40] == expected
    assert similarity(image, template, method)[30, 40] != expected


@pytest.mark.parametrize(
    "method, gap", [*((name, gap) for name in METHODS if name != "sed" for gap in (0, 1, 30)), ("sed", 30)]
)
def test_two_targets_give_one_match_each(method: str, gap: int) -> None:
    """Not ``sed`` side by side: halfway between, the edges of both make up a third, false match."""
    image = floor_with_robots((12, 50), (36 + gap, 50))
    matches = find(image, robot(), method)
    assert [(match.x, match.y) for match in matches] == [(12, 50), (36 + gap, 50)]


@every_method
def test_best_first(method: str) -> None:
    image = floor_with_robots((80, 60), (10, 10))
    image[15:18, 20:24] = 90  # the first in row-major order is no longer the better one
    matches = find(image, robot(), method)
    assert [(match.x, match.y) for match in matches] == [(80, 60), (10, 10)]
    costs = [-match.score if METHODS[method].higher_is_better else match.score for match in matches]
    assert costs == sorted(costs) and costs[0] < costs[1]


@every_method
def test_no_target_no_match(method: str) -> None:
    noise = np.random.default_rng(3).normal(120, 3, (90, 120)).round().astype(np.uint8)
    assert find(noise, robot(), method) == []


def test_one_optimum_per_8_connected_component() -> None:
    """A 1 px template makes the similarity image readable: |t - f| of each pixel."""
    image = np.array([[1, 9, 9, 9, 0], [9, 0, 9, 9, 1], [9, 9, 9, 9, 9], [2, 9, 9, 1, 1]])
    found = [(match.x, match.y, match.score) for match in find(image, [[0]], "sad", threshold=2)]
    assert found == [(4, 0, 0.0), (1, 1, 0.0), (3, 3, 1.0), (0, 3, 2.0)]


def test_ties_go_to_the_first_in_row_major_order() -> None:
    assert find(np.full((5, 6), 7), [[7]], "ssd", threshold=0) == [Match(0, 0, 0.0, 1, 1)]


def test_the_threshold_is_inclusive_and_in_units_of_the_score() -> None:
    image = np.array([[5, 0, 8]])
    assert len(find(image, [[3]], "sad", threshold=5)) == 1
    assert [match.x for match in find(image, [[3]], "sad", threshold=2.5)] == [0]
    assert find(image, [[3]], "sad", threshold=1) == []
    assert len(find(scene(), scene()[:20, :20], "zncc", threshold=1)) == 1


@every_method
def test_otsu_finds_the_planted_target(method: str) -> None:
    image = floor_with_robots((40, 30))
    match = find(image, robot(), method, threshold="otsu")[0]
    assert (match.x, match.y) == (40, 30)


@every_method
def test_default_threshold_lies_between_perfect_and_featureless(method: str) -> None:
    image = floor_with_robots((40, 30))
    limit = default_threshold(image, robot(), method)
    featureless = np.full((90, 120), 120, np.uint8)
    away = similarity(featureless, robot(), method)[0, 0]
    perfect = 1.0 if METHODS[method].higher_is_better else 0.0
    assert min(away, perfect) < limit < max(away, perfect)


def test_default_thresholds_by_hand() -> None:
    template = np.array([[0, 4], [0, 4]])
    image = np.zeros((4, 4), int)
    assert default_threshold(image, template, "ssd") == 2.0  # variance 4
    assert default_threshold(image, template, "sad") == 1.0  # mean absolute deviation 2
    assert default_threshold(image, template, "zncc") == pytest.approx(np.sqrt(0.5))
    assert default_threshold(image, template, "ncc") == pytest.approx(np.sqrt(0.75))  # flat scores sqrt(1/2)
    assert default_threshold(image, template, "sed") == (2 / 8) ** 2


# ---------------------------------------------------------------- thresholds


def test_default_thresholds_with_weights_by_hand() -> None:
    """Weighted: mean 4.8, variance 15.36, mean square 38.4, mean absolute deviation 4.8 around the median 0."""
    image, template, weights = np.zeros((4, 4)), [[0.0, 0.0, 8.0]], [[1.0, 1.0, 3.0]]
    assert default_threshold(image, template, "ssd", weights) == pytest.approx(15.36 / 2)
    assert default_threshold(image, template, "sad", weights) == pytest.approx(4.8 / 2)
    assert default_threshold(image, template, "ncc", weights) == pytest.approx(np.sqrt(0.8))


def test_otsu_by_hand() -> None:
    """Between the two groups, whatever the direction."""
    image = np.array([[0, 1, 9, 10, 10, 11, 1]])
    assert 1 <= score_threshold(image, "sad", "otsu") < 9
    assert {match.x for match in find(image, [[0]], "sad", "otsu", rule="nms")} == {0, 1, 6}
    assert {tuple(p) for p in optima(image / 11, "ncc", score_threshold(image / 11, "ncc", "otsu"), "nms")} == {
        (0, 2), (0, 3), (0, 4), (0, 5)}  # fmt: skip


def test_mad_by_hand() -> None:
    """Deviations 2 1 0 1 2, their median 1; of 0 0 0 0 10 the median is 0, the mean 2."""
    assert score_threshold([8, 9, 10, 11, 12], "sad", "mad") == pytest.approx(10 - 5 * 1.4826)
    assert score_threshold([8, 9, 10, 11, 12], "zncc", "mad") == pytest.approx(10 + 5 * 1.4826)
    assert score_threshold([0, 0, 0, 0, 10], "zncc", "mad") == pytest.approx(5 * 1.2533 * 2)
    assert score_threshold([8, 9, np.inf, 10, 11, 12], "sad", "mad") == pytest.approx(10 - 5 * 1.4826)


@pytest.mark.parametrize("rule", ["otsu", "mad"])
def test_a_constant_similarity_image_has_no_threshold(rule: str) -> None:
    for score in ([[3, 3]], [[np.inf, 2.0]], [[np.inf]], [[1, 1 - 2e-16, 1]]):  # the last is rounding
        assert np.isnan(score_threshold(score, "zncc", rule))
    ramp = np.add.outer(3.3 * np.arange(20), 1.7 * np.arange(30))
    assert find(ramp, ramp[3:9, 4:11], "zncc", rule) == []


@pytest.mark.parametrize("threshold", [0, 2, 0.5, np.float32(0.5), np.int64(1)])
def test_a_number_is_the_threshold(threshold: Any) -> None:
    limit = score_threshold([], "ssd", threshold)
    assert limit == threshold and type(limit) is float


@every_method
def test_mad_finds_the_planted_target_in_noise(method: str) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (90, 120))
    image = noise.astype(np.uint8)
    image[30:50, 40:64] = robot()
    match = find(image, robot(), method, threshold="mad")[0]
    assert (match.x, match.y) == (40, 30)


# ---------------------------------------------------------------- optima


def naive_components(score: Array, higher: bool, limit: float) -> list[tuple[int, int]]:
    """Flood every component in turn, and keep its best place."""
    accepted = score >= limit if higher else score <= limit
    left = {(int(r), int(c)) for r, c in np.argwhere(accepted)}
    found = []
    while left:
        front, component = [left.pop()], []
        while front:
            r, c = front.pop()
            component.append((-score[r, c] if higher else score[r, c], r, c))
            near = {(r + i, c + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} & left
            left -= near
            front += near
        found.append(min(component))
    return [(r, c) for _, r, c in sorted(found)]


def naive_suppression(score: Array, higher: bool, limit: float, size: tuple[int, int]) -> list[tuple[int, int]]:
    """Best first: keep an accepted place if it is the best around and no equal one around was kept."""
    cost = -score if higher else score
    order = sorted((cost[r, c], r, c) for r, c in np.ndindex(*score.shape))
    kept: list[tuple[int, int]] = []
    for value, r, c in order:
        around = cost[max(r - size[0] // 2, 0) : r + size[0] // 2 + 1, max(c - size[1] // 2, 0) : c + size[1] // 2 + 1]
        near = [k for k in kept if abs(k[0] - r) <= size[0] // 2 and abs(k[1] - c) <= size[1] // 2]
        if (score[r, c] >= limit if higher else score[r, c] <= limit) and value == around.min() and not near:
            kept.append((r, c))
    return kept


@pytest.mark.parametrize("method", ["sad", "zncc"])
@settings(max_examples=150, deadline=None)
@given(
    score=hnp.arrays(np.float64, st.tuples(st.integers(1, 9), st.integers(1, 9)),
                     elements=st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])),
    limit=st.sampled_from([0.0, 0.3, 0.5, 1.0]),
    size=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    max_count=st.none() | st.integers(1, 5),
)  # fmt: skip
def test_optima_equal_the_naive_loops(
    method: str, score: Array, limit: float, size: tuple[int, int], max_count: int | None
) -> None:
    higher = method == "zncc"
    components = optima(score, method, limit, max_count=max_count)
    assert [tuple(p) for p in components] == naive_components(score, higher, limit)[:max_count]
    suppressed = optima(score, method, limit, "nms", size=size, max_count=max_count)
    assert [tuple(p) for p in suppressed] == naive_suppression(score, higher, limit, size)[:max_count]
    assert components.shape[1:] == suppressed.shape[1:] == (2,)


def test_nothing_accepted_nothing_found() -> None:
    for rule in ("components", "nms"):
        assert optima([[3.0, 4.0]], "sad", 2, rule).shape == (0, 2)
        assert optima([[3.0, 4.0]], "sad", np.nan, rule).shape == (0, 2)


def test_touching_objects_count_once_by_components_and_twice_by_nms() -> None:
    image = np.array([[9, 0, 1, 0, 9]])
    assert [match.x for match in find(image, [[0]], "sad", 1)] == [1]
    assert [match.x for match in find(image, [[0]], "sad", 1, rule="nms")] == [1, 3, 2]  # 1 px reaches 0 px
    score = [[9, 0, 1, 0, 9]]
    assert optima(score, "sad", 1, "nms", size=(1, 2))[:, 1].tolist() == [1, 3]
    assert optima(score, "sad", 1, "nms", size=(1, 4))[:, 1].tolist() == [1]


@every_method
@pytest.mark.parametrize("rule", ["components", "nms"])
def test_at_most_so_many_and_those_are_the_best(method: str, rule: str) -> None:
    image = floor_with_robots((80, 60), (10, 10), (50, 10))
    image[15:18, 20:24] = 90
    every = find(image, robot(), method, rule=rule)
    assert len(every) >= 3
    for count in (1, np.int64(2), 100):
        assert find(image, robot(), method, rule=rule, max_count=count) == every[:count]


# ---------------------------------------------------------------- below the pixel


def test_refine_by_hand() -> None:
    """A parabola's vertex, and no step further than half a pixel, at a border or on a plateau."""
    x, y = np.arange(7.0), np.arange(5.0)[:, None]
    bowl = (x - 3.3) ** 2 + 2 * (y - 1.8) ** 2
    np.testing.assert_allclose(refine(bowl, [[2, 3]]), [[1.8, 3.3]], atol=1e-12)
    np.testing.assert_allclose(refine(-bowl, [[2, 3]]), [[1.8, 3.3]], atol=1e-12)
    np.testing.assert_array_equal(refine(bowl, [[0, 0], [4, 6]]), [[0, 0], [4, 6]])
    np.testing.assert_array_equal(refine(np.ones((3, 3)), [[1, 1]]), [[1, 1]])
    np.testing.assert_array_equal(refine([[9, 1, np.inf]], [[0, 1]]), [[0, 1]])
    np.testing.assert_array_equal(refine([[5, 4, 2]], [[0, 1]]), [[0, 0.5]])
    assert refine(bowl, np.empty((0, 2), int)).shape == refine(bowl, []).shape == (0, 2)


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(np.float64, (4, 5), elements=st.integers(0, 5).map(float)))
def test_refined_optima_stay_within_half_a_pixel(score: Array) -> None:
    places = optima(score, "sad", 5, "nms", size=(3, 3))
    assert np.abs(refine(score, places) - places).max() <= 0.5


def waves(x: Any, y: Any) -> Array:
    """A smooth picture that is known between the pixels."""
    return np.asarray(128 + 45 * np.sin(x / 3.1 + 0.4 * np.cos(y / 5)) + 45 * np.cos(y / 3.7 - 0.5 * np.sin(x / 4.3)))


@pytest.mark.parametrize("method, bound", [("ssd", 0.04), ("sad", 0.12), ("ncc", 0.04), ("zncc", 0.04)])
def test_a_known_shift_is_found_to_a_fraction_of_a_pixel(method: str, bound: float) -> None:
    y, x = np.mgrid[:60, :70].astype(float)
    ty, tx = np.mgrid[:21, :24].astype(float)
    for dx, dy in [(0.0, 0.0), (0.25, -0.4), (-0.3, 0.45), (0.1, 0.2)]:
        template = waves(tx + 27 + dx, ty + 19 + dy)
        for f, t in (
            (waves(x, y), template),
            (waves(x, y).round().astype(np.uint8), template.round().astype(np.uint8)),
        ):
            match = find(f, t, method, subpixel=True)[0]
            assert abs(match.x - 27 - dx) < bound and abs(match.y - 19 - dy) < bound
            whole = find(f, t, method)[0]
            assert (whole.x, whole.y) == (27, 19) and match.score == whole.score


def test_an_edge_distance_is_refined_by_half_a_pixel_at_most() -> None:
    matches = find(floor_with_robots((40, 30)), robot(), "sed", subpixel=True)
    assert abs(matches[0].x - 40) <= 0.5 and abs(matches[0].y - 30) <= 0.5


# ---------------------------------------------------------------- matches and measures side by side


def test_corners_by_hand() -> None:
    """Turned by 90 degrees counter-clockwise as seen, the top-left corner is at the bottom left."""
    match = Match(10, 20, 0.0, 4, 2)
    assert match.centre_px == (11.5, 20.5)
    np.testing.assert_allclose(match.corners_px, [[9.5, 19.5], [13.5, 19.5], [13.5, 21.5], [9.5, 21.5]])
    turned = Match(10, 20, 0.0, 4, 2, angle=90)
    np.testing.assert_allclose(turned.corners_px, [[10.5, 22.5], [10.5, 18.5], [12.5, 18.5], [12.5, 22.5]])


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("rule", ["components", "nms"])
def test_compare_is_similarity_and_find_of_every_measure(rule: str, masked: bool) -> None:
    image = floor_with_robots((12, 50), (70, 20))
    mask = np.random.default_rng(1).random((20, 24)) < 0.7 if masked else None
    results = compare(image, robot(), mask=mask, rule=rule, max_count=2)
    assert list(results) == list(METHODS)
    for name, result in results.items():
        assert result.method is METHODS[name] and result.seconds > 0
        np.testing.assert_array_equal(result.score, similarity(image, robot(), name, mask))
        assert result.matches == find(image, robot(), name, mask=mask, rule=rule, max_count=2)
        assert result.threshold == default_threshold(image, robot(), name, mask)
    assert list(compare(image, robot(), ["zncc", "ssd"])) == ["zncc", "ssd"]
    for rule_of_scores in ("otsu", "mad"):
        result = compare(image, robot(), ["sad"], threshold=rule_of_scores)["sad"]
        assert result.threshold == score_threshold(result.score, "sad", rule_of_scores)
        assert result.matches == find(image, robot(), "sad", rule_of_scores)


# ---------------------------------------------------------------- a measure of one's own


@pytest.fixture(autouse=True)
def built_in_measures_only() -> Iterator[None]:
    yield
    for name in [name for name in METHODS if name not in measures.BUILT_IN]:
        del METHODS[name]


@pytest.fixture
def extreme() -> str:
    @matcher("extreme", higher_is_better=False, default_threshold=lambda f, t, m: 25.0, bounds=(0, np.inf))
    def largest(image: Array, template: Array, mask: Array) -> Array:
        """Largest absolute difference.

        More than one line.
        """
        windows = np.lib.stride_tricks.sliding_window_view(image, template.shape[:2], axis=(0, 1))
        difference = np.abs(np.moveaxis(windows, 2, -1).astype(float) - template)[:, :, mask > 0]
        return np.asarray(difference.max(axis=(2, 3)).astype(np.float32))

    return "extreme"


def test_a_measure_of_ones_own_joins_all_the_others(extreme: str) -> None:
    image = floor_with_robots((12, 50), (70, 20))
    assert list(METHODS)[-1] == extreme and METHODS[extreme].description == "Largest absolute difference."
    score = similarity(image, robot(), extreme)
    assert score.dtype == np.float64 and score.shape == (71, 97) and score[50, 12] == 0
    places = [(12, 50), (70, 20)]
    expected = sorted(places, key=lambda place: place[::-1])
    assert [(match.x, match.y) for match in find(image, robot(), extreme)] == expected
    assert [(match.x, match.y) for match in find(image, robot(), extreme, pyramid=2)] == expected
    assert [(match.x, match.y) for match in compare(image, robot())[extreme].matches] == expected
    assert default_threshold(image, robot(), extreme) == 25
    with pytest.raises(ValueError, match="threshold: expected 0 to inf for extreme, got -1"):
        find(image, robot(), extreme, -1)
    np.testing.assert_array_equal(reference_similarity(image, robot(), extreme), score)


def test_a_measure_of_ones_own_by_default_takes_the_threshold_mad(extreme: str) -> None:
    @matcher("own", higher_is_better=True, description="minus the largest")
    def own(image: Array, template: Array, mask: Array) -> Array:
        return -METHODS[extreme].score(image, template, mask)

    image = floor_with_robots((12, 50))
    score = similarity(image, robot(), "own")
    assert METHODS["own"].description == "minus the largest"
    assert default_threshold(image, robot(), "own") == score_threshold(score, "own", "mad")
    assert [(match.x, match.y) for match in find(image, robot(), "own", -25)] == [(12, 50)]
    assert find(image, robot(), "own") == find(image, robot(), "own", "mad")
    assert own(np.zeros((3, 3, 1)), np.zeros((1, 1, 1)), np.ones((1, 1), bool)).shape == (3, 3)  # still the function

    matcher("own", higher_is_better=False, default_threshold="otsu")(METHODS[extreme].score)  # once more, another
    assert not METHODS["own"].higher_is_better
    assert compare(image, robot(), ["own"])["own"].threshold == score_threshold(-score, "own", "otsu")


def test_own_measures_search_turned_templates_without_the_pyramid(extreme: str) -> None:
    """Nothing is known of what they do with a smaller picture."""
    image = scene()
    image[40:80, 60:90] = np.rot90(image[:30, :40])
    full = find(image, image[:30, :40], extreme, angles=(0, 90), subpixel=True)
    assert [match.angle for match in full] == [0, 90]
    assert find(image, image[:30, :40], extreme, angles=(0, 90), subpixel=True, pyramid=2) == full


@pytest.mark.parametrize(
    "wrong", [np.zeros((2, 2)), np.zeros((4, 5, 1)), np.full((4, 5), np.nan), np.full((4, 5), np.inf), None, 0.0]
)
def test_scores_of_ones_own_are_checked(wrong: Any) -> None:
    matcher("wrong", higher_is_better=False)(lambda image, template, mask: wrong)
    with pytest.raises(
        ValueError, match=r"^wrong: expected (a score for each of \(4, 5\) places .*, got \(|finite scores, got NaN)"
    ):
        similarity(IMAGE, np.ones((2, 2)), "wrong")


@pytest.mark.slow
def test_a_method_survives_the_way_to_another_process(extreme: str) -> None:
    image = floor_with_robots((12, 50))
    script = "import pickle, sys; f, t, m, method = pickle.load(sys.stdin.buffer); sys.stdout.buffer.write(pickle.dumps(method.score(f, t, m)))"
    arrays = image[:, :, None], robot()[:, :, None], np.ones((20, 24), bool)
    for method in METHODS.values():
        copy = cloudpickle.loads(cloudpickle.dumps(method))
        assert (copy.name, copy.bounds, copy.higher_is_better) == (method.name, method.bounds, method.higher_is_better)
        prepared, [pair] = copy.prepare(arrays[0], [arrays[1:]])
        np.testing.assert_array_equal(copy.score(prepared, *pair), similarity(image, robot(), method.name))
    sent = cloudpickle.dumps((*arrays, METHODS[extreme]))
    there = subprocess.run([sys.executable, "-c", script], input=sent, capture_output=True, check=True)
    np.testing.assert_array_equal(pickle.loads(there.stdout), similarity(image, robot(), extreme))


# ---------------------------------------------------------------- wrong arguments

IMAGE = np.arange(30.0).reshape(5, 6)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"template": np.ones((6, 2))}, r"template: expected no larger than the image \(5, 6\), got \(6, 2\)"),
        ({"template": np.ones((2, 7))}, "template: expected no larger"),
        ({"template": np.ones((0, 3))}, "template: expected at least one pixel"),
        ({"image": np.ones((0, 3))}, "image: expected at least one pixel"),
        ({"image": np.where(IMAGE == 3, np.nan, IMAGE)}, "image: expected finite values"),
        ({"template": [[1.0, np.inf]]}, "template: expected finite values"),
        ({"image": IMAGE * 1e120}, "image: expected magnitudes"),
        ({"image": IMAGE > 3}, "image: expected integer or float values, got dtype bool"),
        ({"template": np.ones((2, 2), complex)}, "template: expected integer or float values, got dtype complex"),
        ({"template": np.ones((2, 2), object)}, "template: expected integer or float values, got dtype object"),
        ({"template": np.ones(3)}, r"template: expected shape .*, got \(3,\)"),
        ({"image": np.ones((5, 6, 4))}, r"image: expected shape .*, got \(5, 6, 4\)"),
        ({"template": np.ones((2, 2, 3))}, "template: expected 1 channel"),
        ({"image": np.ones((5, 6, 3))}, "template: expected 3 channel"),
        ({"mask": np.ones((2, 3), bool)}, r"mask: expected bool or weights \(2, 2\), got bool \(2, 3\)"),
        ({"mask": np.ones((2, 2), complex)}, "mask: expected bool or weights .* got complex128"),
        ({"mask": np.zeros((2, 2), bool)}, "mask: expected at least one pixel that counts, got none"),
        ({"mask": np.zeros((2, 2))}, "mask: expected at least one pixel that counts, got none"),
        ({"mask": [[1, -0.5], [1, 1]]}, "mask: expected finite weights >= 0"),
        ({"mask": [[1, np.nan], [1, 1]]}, "mask: expected finite weights >= 0"),
        ({"method": "zssd"}, "method: expected one of ssd, sad, ncc, zncc, sed, got 'zssd'"),
        ({"method": None}, "method: expected one of"),
    ],
)
@pytest.mark.parametrize("function", [similarity, reference_similarity, find, default_threshold])
def test_wrong_arguments(function: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        function(**{"image": IMAGE, "template": np.array([[1.0, 2.0], [3.0, 5.0]]), **arguments})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("threshold", [np.nan, np.inf, True, "triangle", [1], 1j])
def test_wrong_threshold(threshold: Any) -> None:
    with pytest.raises(ValueError, match="threshold: expected a finite number, 'otsu', 'mad' or None, got"):
        find(IMAGE, IMAGE[:2, :2], "ssd", threshold)


@pytest.mark.parametrize("method", DISTANCES)
def test_negative_threshold_of_a_distance(method: str) -> None:
    with pytest.raises(ValueError, match=rf"threshold: expected 0 to inf for {method}, got -0\.5"):
        find(IMAGE, IMAGE[:2, :2], method, -0.5)


def test_threshold_no_correlation_can_reach() -> None:
    with pytest.raises(ValueError, match=r"threshold: expected -1 to 1 for zncc, got 1\.5"):
        find(IMAGE, IMAGE[:2, :2], "zncc", 1.5)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"rule": "peaks"}, "rule: expected one of components, nms, got 'peaks'"),
        *(
            ({"max_count": count}, "max_count: expected a whole number >= 1 or None, got")
            for count in (0, -1, 1.5, True, "2")
        ),
        *(
            ({"pyramid": levels}, "pyramid: expected a whole number from 0 to 8, got")
            for levels in (-1, 9, 1.0, True, None)
        ),
        *(
            ({"angles": a}, "angles: expected one or more finite numbers, got")
            for a in ([], [np.nan], "a", [[1]], [True])
        ),
        *(({"scales": s}, "scales: expected one or more finite numbers, got") for s in ([], [np.inf], None, [1j])),
        ({"scales": [1, 0]}, "scales: expected numbers > 0, got 0"),
        ({"scales": [-2]}, "scales: expected numbers > 0, got -2"),
        (
            {"scales": [9]},
            r"scales: expected a template, turned and scaled, with .* than the image \(5, 6\); none of 1 is",
        ),
    ],
)
def test_wrong_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        find(IMAGE, IMAGE[:2, :2], "ssd", **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("score", [[], [[]], [1.0, 2.0], np.zeros((2, 2, 2))])
def test_optima_want_a_similarity_image(score: Any) -> None:
    with pytest.raises(ValueError, match="score: expected a similarity image"):
        optima(score, "sad", 1)


def test_compare_refuses_what_its_parts_refuse() -> None:
    for options, message in [
        ({"methods": ["ssd", "sift"]}, "method: expected one of ssd, sad, ncc, zncc, sed, got 'sift'"),
        ({"threshold": 7}, "threshold: expected -1 to 1 for ncc, got 7"),
        ({"rule": "x"}, "rule: expected"),
        ({"max_count": 0}, "max_count: expected"),
        ({"mask": np.zeros((2, 2))}, "mask: expected"),
    ]:
        with pytest.raises(ValueError, match=message):
            compare(IMAGE, IMAGE[:2, :2], **options)  # type: ignore[arg-type]


# ---------------------------------------------------------------- what a matcher of one's own may not do


def test_a_matcher_cannot_write_into_the_pictures() -> None:
    image = scene()
    try:

        @matcher("vandal", higher_is_better=False)
        def vandal(image: Array, template: Array, mask: Array) -> Array:
            image[:] = 0
            return image

        with pytest.raises(ValueError, match="vandal: ValueError: assignment destination is read-only"):
            similarity(image, image[:20, :20], "vandal")
    finally:
        METHODS.pop("vandal", None)
    assert image.any()


@pytest.mark.parametrize("name", ["ssd", "sed", "best", "statement", "", "a b", "../x", "1st", None, 3])
def test_names_that_a_matcher_cannot_have(name: Any) -> None:
    with pytest.raises(ValueError, match="name: expected letters, digits, _ and -, and none of ssd, sad"):
        matcher(name, higher_is_better=True)


@pytest.mark.parametrize("threshold", [5, None, "half"])
def test_a_default_threshold_is_a_function_or_a_known_name(threshold: Any) -> None:
    with pytest.raises(ValueError, match="default_threshold: expected a function or one of 'otsu', 'mad', got"):
        matcher("own", higher_is_better=True, default_threshold=threshold)
