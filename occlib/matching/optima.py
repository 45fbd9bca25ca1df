"""Places in a similarity image: the best one, all optima that reach a limit, and optima to a fraction of a pixel."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Mask
from occlib.base.kernels import compiled
from occlib.matching.measures import known_method

RULES = ("components", "nms")

CROWDED = 4
"""Equally good places in a block, on the average, above which non-maximum suppression filters the whole image."""


def best(score: npt.ArrayLike, method: str) -> tuple[int, int]:
    """The place of the best score: the lowest of a distance, the highest of a correlation.

    Parameters
    ----------
    score
        Similarity image (M, N) of ``method``; infinite where there is no score.
    method
        One of :data:`METHODS`.

    Returns
    -------
    tuple
        Row and column. Equal scores: the first in row-major order.

    Raises
    ------
    ValueError
        Unknown method; scores that are no similarity image.

    Examples
    --------
    >>> best([[5, 1, 5], [1, 9, 9]], "sad")
    (0, 1)
    >>> best([[5, 1, 5], [1, 9, 9]], "ncc")
    (1, 1)
    """
    cost = _costs(score, method)
    row, column = np.unravel_index(cost.argmin(), cost.shape)
    return int(row), int(column)


def _costs(score: npt.ArrayLike, method: str) -> FloatArray:
    """The similarity image turned so that less is better."""
    higher_is_better = known_method(method).higher_is_better
    values = np.asarray(score, dtype=np.float64)
    if values.ndim != 2 or values.size == 0:
        raise ValueError(f"score: expected a similarity image (rows, columns), got shape {values.shape}")
    return -values if higher_is_better else values


def optima(
    score: npt.ArrayLike,
    method: str,
    limit: float,
    rule: str = "components",
    *,
    size: tuple[int, int] = (1, 1),
    max_count: int | None = None,
) -> npt.NDArray[np.intp]:
    """Places of the optima in a similarity image, best first.

    Parameters
    ----------
    score
        Similarity image (M, N) of ``method``; infinite where there is no score.
    method
        One of :data:`METHODS`.
    limit
        The worst score to accept.
    rule
        ``"components"``, the paper's: one optimum in each 8-connected component of the accepted places. Two
        objects whose components touch count once, and a ragged component that falls apart counts more than once.
        ``"nms"``, non-maximum suppression: every accepted place that nothing within half a template, in both
        directions, beats.
    size
        ``(h, w)`` of the template, for ``"nms"``.
    max_count
        Keep at most this many, the best; all by default.

    Returns
    -------
    ndarray
        (K, 2) rows and columns. Equal scores: the first in row-major order.

    Examples
    --------
    >>> optima([[5, 1, 5, 2, 9]], "sad", 2)
    array([[0, 1],
           [0, 3]])
    >>> optima([[5, 1, 5, 2, 9]], "sad", 2, "nms", size=(1, 4))
    array([[0, 1]])
    """
    check_search(rule, max_count)
    cost = _costs(score, method)
    accepted = cost <= (-limit if known_method(method).higher_is_better else limit)
    if rule == "components":
        count, labels = cv2.connectedComponents(accepted.astype(np.uint8), connectivity=8)
        places = np.flatnonzero(accepted)
        least = np.full(count, np.inf)
        np.minimum.at(least, np.asarray(labels.flat[places], np.intp), cost.flat[places])
        places = places[cost.flat[places] == least[labels.flat[places]]]  # only equals are left to be sorted
        places = places[np.argsort(cost.flat[places], kind="stable")]
        _, first = np.unique(labels.flat[places], return_index=True)
        places = places[np.sort(first)]
    else:
        places = _unsuppressed(cost, accepted, size[0] // 2, size[1] // 2)
    return np.stack(np.unravel_index(places[:max_count], cost.shape), axis=1)


def refine(score: npt.ArrayLike, places: npt.ArrayLike) -> FloatArray:
    """Optima to a fraction of a pixel: the vertices of the parabolas through each place and its neighbours.

    Parameters
    ----------
    score
        Similarity image (M, N).
    places
        (K, 2) whole rows and columns of optima, as from :func:`optima`.

    Returns
    -------
    ndarray
        float64 (K, 2) rows and columns, moved by at most half a pixel; not at all at a border or on a plateau.

    Examples
    --------
    >>> refine([[9, 1, 5]], [[0, 1]])
    array([[0.        , 1.16666667]])
    """
    values = np.asarray(score, dtype=np.float64)
    moved = [(r + _vertex(values[:, c], r), c + _vertex(values[r], c)) for r, c in np.reshape(places, (-1, 2))]
    return np.reshape(moved, (-1, 2)).astype(np.float64)


def _unsuppressed(cost: FloatArray, accepted: Mask, rows: int, columns: int) -> npt.NDArray[np.intp]:
    """Flat indices of the accepted places that are the best within so many rows and columns, best first."""
    places = _best_of_blocks(cost, accepted, rows, columns)
    blocks = max(cost.size // ((rows + 1) * (columns + 1)), 1)
    if len(places) > CROWDED * blocks:  # on plateaus, each would be looked at
        around = cv2.erode(cost, np.ones((2 * rows + 1, 2 * columns + 1), np.uint8))
        places = np.flatnonzero(accepted & (cost == around))
    else:
        places = places[_are_best_around(cost, places, rows, columns)]
    costs = cost.flat[places]
    order = np.argsort(costs, kind="stable")
    places = places[order]
    if (np.diff(costs[order]) > 0).all():
        return places
    taken = np.zeros(cost.shape, bool)
    kept = []
    for place in places:
        r, c = divmod(int(place), cost.shape[1])
        if not taken[r, c]:  # only an equal score can have taken it
            taken[max(r - rows, 0) : r + rows + 1, max(c - columns, 0) : c + columns + 1] = True
            kept.append(place)
    return np.array(kept, dtype=np.intp)


@compiled
def _best_of_blocks(cost: Any, accepted: Any, rows: int, columns: int) -> Any:  # pragma: no cover
    """Flat indices, rising, of the accepted places that are the best of their block of so many rows and columns, and one.

    Every place that is the best around is among them, as its block lies within what is around it.
    """
    height, width = rows + 1, columns + 1
    least = np.full((cost.shape[0] // height + 1, cost.shape[1] // width + 1), np.inf)
    for r in range(cost.shape[0]):
        line = least[r // height]
        for start in range(0, cost.shape[1], width):
            value = line[start // width]
            for c in range(start, min(start + width, cost.shape[1])):
                value = min(value, cost[r, c])
            line[start // width] = value
    places = np.empty(cost.size, np.intp)
    count = 0
    for r in range(cost.shape[0]):
        line = least[r // height]
        for start in range(0, cost.shape[1], width):
            value = line[start // width]
            for c in range(start, min(start + width, cost.shape[1])):
                if cost[r, c] == value and accepted[r, c]:
                    places[count] = r * cost.shape[1] + c
                    count += 1
    return places[:count].copy()


@compiled
def _are_best_around(cost: Any, places: Any, rows: int, columns: int) -> Any:  # pragma: no cover
    """Whether nothing within so many rows and columns beats a place, for each."""
    best = np.ones(len(places), np.bool_)
    for i in range(len(places)):
        r, c = places[i] // cost.shape[1], places[i] % cost.shape[1]
        for y in range(max(r - rows, 0), min(r + rows + 1, cost.shape[0])):
            for x in range(max(c - columns, 0), min(c + columns + 1, cost.shape[1])):
                if cost[y, x] < cost[r, c]:
                    best[i] = False
                    break
            if not best[i]:
                break
    return best


def check_search(rule: str, max_count: Any, pyramid: Any = 0) -> None:
    if rule not in RULES:
        raise ValueError(f"rule: expected one of {', '.join(RULES)}, got {rule!r}")
    if max_count is not None and (
        isinstance(max_count, bool) or not isinstance(max_count, Integral) or int(max_count) < 1
    ):
        raise ValueError(f"max_count: expected a whole number >= 1 or None, got {max_count!r}")
    if isinstance(pyramid, bool) or not isinstance(pyramid, Integral) or not 0 <= int(pyramid) <= 8:
        raise ValueError(f"pyramid: expected a whole number from 0 to 8, got {pyramid!r}")


def _vertex(score: FloatArray, place: int) -> float:
    """Offset in px, -0.5 to 0.5, of the vertex of the parabola through a place and its two neighbours."""
    if not 0 < place < len(score) - 1:
        return 0.0
    before, here, after = score[place - 1 : place + 2]
    bend = before - 2 * here + after
    if not np.isfinite(bend) or bend == 0:
        return 0.0
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5))
