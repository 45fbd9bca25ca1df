"""Where the search begins: for every place the best of some radii and heights."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from occlib.base.kernels import compiled
from occlib.explaining.evidence import view_at
from occlib.explaining.objective import FULL, weigh_column
from occlib.explaining.prisms import FIELDS, PERSON_M, cylinder, plausible_round
from occlib.explaining.silhouettes import edges, foot, run_between, span_of

RADII = np.array([0.06, 0.085, 0.12, 0.16, 0.21, 0.28, 0.36])
"""Radii tried at first, in m, each a third larger than the one before; the best are then refined freely."""

HEIGHTS = np.array([0.04, 0.06, 0.09, 0.13, 0.18, 0.24, 0.32, 0.42, 0.55, 0.72, 0.95, 1.2, 1.45, 1.7, 1.9])
"""Heights tried at first, in m, from low to high."""

FEW_RADII = RADII[::2].copy()
"""Those tried where objects are known and little is left."""

PATIENCE = 4
"""So many heights in a row that are worse than the best end the search for a better one."""

ROUNDING = 1e-9
"""A bound is raised by this share of itself, so that rounding does not make it smaller than what it bounds."""


class _Disc(NamedTuple):
    """What does not depend on a cylinder's height.

    Parameters
    ----------
    first, last
        In each view its first column and the one after the last, int64 (K,).
    near, far
        In each column the distances to the edges of its base, see :func:`edges`, float64 (K, columns).
    base, rim
        In each column the row after the last and the rim in rows, see :func:`foot`, int64 (K, columns).
    """

    first: Any
    last: Any
    near: Any
    far: Any
    base: Any
    rim: Any


@compiled
def candidates(work: Any, sums: Any, places: Any, cost: float, budget: int, radii: Any = RADII) -> Any:
    """For each place the best radius and height, if any is worth its cost: cylinders (N, 10) and their values (N,).

    What does not depend on the height is worked out once; the values are those of :func:`occlib.explaining.objective.gain`.
    The search goes up until the most that the columns hold would no longer pay for what is covered.
    """
    most = _most(work, sums)
    found, values, n = np.ones((len(places), FIELDS)), np.zeros(len(places)), 0
    found[:, 4:6] = 0.0  # round, without heading
    found[:, 9] = 0.0
    disc = _room(len(work.views), work.weights.shape[2])
    for i in range(len(places)):
        if work.spent[0] >= budget:
            break
        most_here = 0.0
        for radius in radii:
            bound = _fill(work, disc, most, places[i, 0], places[i, 1], radius) * (1 + ROUNDING)
            best, worse, least = 0.0, 0, 0.0
            for height in HEIGHTS:
                if bound <= best or bound <= most_here:
                    break
                if height < least or not plausible_round(radius, height):
                    continue
                value, area = _value_and_area(work, sums, disc, radius, height, cost)
                if value > best:
                    best, worse = value, 0
                    if value > most_here:
                        most_here = value
                        found[n, 0], found[n, 1] = places[i, 0], places[i, 1]
                        found[n, 2], found[n, 3] = radius, height
                        values[n] = value
                elif best > 0:
                    worse += 1
                    if worse >= PATIENCE:
                        break
                # what is higher covers and costs more, unless it is a person, who may cover less
                if bound - cost * area <= best:
                    least = PERSON_M
        if most_here > 0.0:
            n += 1
    return found[:n], values[:n]


@compiled
def _most(work: Any, sums: Any) -> Any:
    """The most that any run of rows explains in each column, (K, columns)."""
    most = np.zeros(work.weights.shape[::2])
    for k in range(len(most)):
        for column in range(work.sizes[k, 0]):
            least = sums[k, 0, column]
            for row in range(1, work.sizes[k, 1] + 1):
                least = min(least, sums[k, row, column])
                most[k, column] = max(most[k, column], (sums[k, row, column] - least) / FULL)
    return most


@compiled
def _room(views: int, columns: int) -> Any:
    """Memory for a :class:`_Disc`."""
    shape = (views, columns)
    return _Disc(
        np.empty(views, np.int64),
        np.empty(views, np.int64),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape, np.int64),
        np.empty(shape, np.int64),
    )


@compiled
def _fill(work: Any, disc: Any, most: Any, x: float, y: float, radius: float) -> float:
    """Fill ``disc`` for a place and radius; returns the most that its columns can explain, whatever the height."""
    bound = 0.0
    for k in range(len(work.views)):
        view = view_at(work.views, k)
        span = span_of(view, work.sizes[k, 0], cylinder(x, y, radius, 1.0))
        disc.first[k], disc.last[k] = span.first, span.last
        for column in range(span.first, span.last):
            near, far = edges(view, column, span, radius)
            disc.near[k, column], disc.far[k, column] = near, far
            disc.base[k, column], disc.rim[k, column] = foot(view, near)
            bound += most[k, column] * view.weight
    return bound


@compiled
def _value_and_area(work: Any, sums: Any, disc: Any, radius: float, height: float, cost: float) -> Any:
    """The ``value`` of :func:`gain` for one height, and the samples covered, which the cost is for."""
    total, area = 0.0, 0.0
    for k in range(len(work.views)):
        view = view_at(work.views, k)
        explained, covered, beyond = 0, 0, 0
        for column in range(disc.first[k], disc.last[k]):
            run = run_between(
                view, work.sizes[k, 1], disc.near[k, column], disc.far[k, column], disc.base[k, column],
                disc.rim[k, column], radius, height,
            )  # fmt: skip
            weighed = weigh_column(sums, work.seen_sums, k, column, run, work.gloss[k])
            explained += weighed.explained
            covered += weighed.covered
            beyond += weighed.beyond
        work.spent[0] += disc.last[k] - disc.first[k]
        total += (explained / FULL - beyond / FULL) * view.weight
        area += covered * view.weight
    return total - cost * area, area
