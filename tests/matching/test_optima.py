"""Places in a similarity image: the best, all optima against naive loops, and positions between pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib.matching.measures import METHODS
from occlib.matching.optima import best, optima, refine
from occlib.matching.search import Match, find

Array = npt.NDArray[Any]
every_method = pytest.mark.parametrize("method", list(METHODS))


def test_one_optimum_per_8_connected_component() -> None:
    """A 1 px template makes the similarity image readable: |t - f| of each pixel."""
    image = np.array([[1, 9, 9, 9, 0], [9, 0, 9, 9, 1], [9, 9, 9, 9, 9], [2, 9, 9, 1, 1]])
    found = [(match.x, match.y, match.score) for match in find(image, [[0]], "sad", threshold=2)]
    assert found == [(4, 0, 0.0), (1, 1, 0.0), (3, 3, 1.0), (0, 3, 2.0)]


def test_ties_go_to_the_first_in_row_major_order() -> None:
    assert find(np.full((5, 6), 7), [[7]], "ssd", threshold=0) == [Match(0, 0, 0.0, 1, 1)]


@every_method
def test_the_best_place_is_the_first_of_the_best_scores(method: str) -> None:
    score = np.array([[3.0, 7, 1, 7], [1, 3, 7, 1]])
    assert best(score, method) == ((0, 1) if METHODS[method].higher_is_better else (0, 2))
    assert best(score[1:], method) == ((0, 2) if METHODS[method].higher_is_better else (0, 0))
    unknown = np.where(
        score == score[best(score, method)], -np.inf if METHODS[method].higher_is_better else np.inf, score
    )
    assert unknown[best(unknown, method)] == 3  # where there is no score there is no best one


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(np.float64, (4, 5), elements=st.integers(0, 5).map(float)), st.sampled_from(["sad", "ncc"]))
def test_the_best_place_is_the_first_optimum(score: Array, method: str) -> None:
    everything = 0.0 if METHODS[method].higher_is_better else 5.0
    assert best(score, method) == tuple(optima(score, method, everything)[0])


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


@pytest.mark.parametrize("score", [[], [[]], [1.0, 2.0], np.zeros((2, 2, 2))])
def test_optima_and_the_best_place_want_a_similarity_image(score: Any) -> None:
    with pytest.raises(ValueError, match="score: expected a similarity image"):
        optima(score, "sad", 1)
    with pytest.raises(ValueError, match="score: expected a similarity image"):
        best(score, "sad")


# ---------------------------------------------------------------- between the pixels


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
