"""Places in a similarity image: the best one, all optima that reach a limit, and optima to a fraction of a pixel."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Mask
from occlib.matching.measures import known_method

RULES = ("components", "nms")


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
    best = cv2.erode(cost, np.ones((2 * rows + 1, 2 * columns + 1), np.uint8))
    places = np.flatnonzero(accepted & (cost == best))
    taken = np.zeros(cost.shape, bool)
    kept = []
    for place in places[np.argsort(cost.flat[places], kind="stable")]:
        r, c = divmod(int(place), cost.shape[1])
        if not taken[r, c]:  # only an equal score can have taken it
            taken[max(r - rows, 0) : r + rows + 1, max(c - columns, 0) : c + columns + 1] = True
            kept.append(place)
    return np.array(kept, dtype=np.intp)


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
