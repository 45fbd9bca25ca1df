"""Thresholds: numbers, rules that read the similarity image, and the default ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib.matching.measures import METHODS
from occlib.matching.optima import optima
from occlib.matching.search import default_threshold, find, similarity
from occlib.matching.thresholds import score_threshold

Array = npt.NDArray[Any]
DISTANCES = [name for name, method in METHODS.items() if not method.higher_is_better]
IMAGE = np.arange(30.0).reshape(5, 6)
every_method = pytest.mark.parametrize("method", list(METHODS))


def test_the_threshold_is_inclusive_and_in_units_of_the_score(textured: Callable[..., Array]) -> None:
    image = np.array([[5, 0, 8]])
    assert len(find(image, [[3]], "sad", threshold=5)) == 1
    assert [match.x for match in find(image, [[3]], "sad", threshold=2.5)] == [0]
    assert find(image, [[3]], "sad", threshold=1) == []
    assert len(find(textured(), textured()[:20, :20], "zncc", threshold=1)) == 1


@every_method
def test_otsu_finds_the_planted_target(robot: Array, floor_with_robots: Callable[..., Array], method: str) -> None:
    image = floor_with_robots((40, 30))
    match = find(image, robot, method, threshold="otsu")[0]
    assert (match.x, match.y) == (40, 30)


@every_method
def test_default_threshold_lies_between_perfect_and_featureless(
    robot: Array, floor_with_robots: Callable[..., Array], method: str
) -> None:
    image = floor_with_robots((40, 30))
    limit = default_threshold(image, robot, method)
    featureless = np.full((90, 120), 120, np.uint8)
    away = similarity(featureless, robot, method)[0, 0]
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
def test_mad_finds_the_planted_target_in_noise(robot: Array, method: str) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (90, 120))
    image = noise.astype(np.uint8)
    image[30:50, 40:64] = robot
    match = find(image, robot, method, threshold="mad")[0]
    assert (match.x, match.y) == (40, 30)


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


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(np.float64, st.integers(2, 400), elements=st.floats(-1e6, 1e6)), st.booleans())
def test_otsu_and_mad_are_those_of_scikit_image_and_numpy(values: Array, skewed: bool) -> None:
    from skimage.filters import threshold_otsu

    values = values**3 if skewed else values
    if np.ptp(values) <= 1e-6 * np.abs(values).max():
        return
    assert score_threshold(values, "sad", "otsu") == threshold_otsu(values)
    middle = np.median(values)
    spread = 1.4826 * np.median(np.abs(values - middle)) or 1.2533 * np.abs(values - middle).mean()
    assert score_threshold(values, "sad", "mad") == middle - 5 * spread
    assert score_threshold([*values, np.inf], "sad", "mad") == middle - 5 * spread
