"""The objective: how well a set of cylinders explains the silhouettes.

Summed over the samples of all polar views, a set of cylinders is worth

    sum over covered samples of w  -  cost * (samples that each cylinder covers),    w in [-1, 1]

where ``w`` > 0 is evidence of foreground and ``w`` < 0 of background, and a sample that several cylinders cover counts
once. Foreground that goes on in the rim below a base or above a top is subtracted
(:data:`occlib.explaining.cylinders.RIM_M`). Of a person, columns in which the head or the legs show no foreground are
not covered there. But for these two terms it is, up to scale, the log-likelihood of a probabilistic occupancy map
(Fleuret et al. 2008, doi:10.1109/TPAMI.2007.1174).

With running sums of the weights down the columns, a cylinder is weighed in a few look-ups a column, whatever its size.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from occlib.base.kernels import compiled
from occlib.explaining.cylinders import Cylinder, cylinder_at, run_of, span_of
from occlib.explaining.evidence import PolarEvidence, view_at

FULL = 255.0
"""Weight of a sample that is surely foreground."""

TINY = 1e-9
"""Stands for an area, a distance or a gain of 0, so that nothing is divided by 0."""


class Workspace(NamedTuple):
    """What all steps of a search share: the evidence, which stays as it is, and memory to work in.

    Parameters
    ----------
    views, sizes, weights, sums, seen_sums
        As in :class:`occlib.explaining.evidence.PolarEvidence`.
    left, left_sums
        As weights and sums: for the evidence that some cylinders leave unexplained.
    """

    views: Any
    sizes: Any
    weights: Any
    sums: Any
    seen_sums: Any
    left: Any
    left_sums: Any


class Gain(NamedTuple):
    """What a cylinder explains.

    Parameters
    ----------
    value
        Weight explained less the rim's and the cost, in samples of the reference camera: what the search maximises.
    explained_m2
        Area of silhouette explained, in m2 at the cylinder's own distance, summed over the views.
    best_share
        Share of its silhouette that it explains in the view where that is largest, 0 to 1.
    net_share
        Share of its silhouettes in all views that it explains, the rim's foreground subtracted; at most 1.
    """

    value: float
    explained_m2: float
    best_share: float
    net_share: float


class _Column(NamedTuple):
    """Of one column: weight explained, samples covered, and the weight of the foreground that goes on in the rim."""

    explained: int
    covered: int
    beyond: int


def workspace(evidence: PolarEvidence) -> Workspace:
    """The evidence as the compiled loops take it, with memory of its own to work in."""
    weights, sums = evidence.weights, evidence.sums
    return Workspace(evidence.views, evidence.sizes, weights, sums, evidence.seen_sums, weights.copy(), sums.copy())


@compiled
def weigh_column(sums: Any, seen_sums: Any, k: int, column: int, run: Any) -> Any:
    """:class:`_Column` of a cylinder's run in view ``k``. Of a person, a head or legs without foreground are left out."""
    low, high, above = run.low, run.high, run.above
    beyond = max(sums[k, run.below, column] - sums[k, high, column], 0)
    if sums[k, run.trunk, column] <= sums[k, low, column]:  # no head here
        low, above = run.trunk, above + run.trunk - low
    if sums[k, high, column] <= sums[k, run.legs, column]:  # no leg here
        high = run.legs
    beyond += max(sums[k, low, column] - sums[k, above, column], 0)
    explained = sums[k, high, column] - sums[k, low, column]
    return _Column(explained, seen_sums[k, high, column] - seen_sums[k, low, column], beyond)


@compiled
def gain(work: Any, sums: Any, cylinder: Any, cost: float) -> Any:
    """:class:`Gain` of a cylinder from the evidence of which ``sums`` are the running sums.

    ``value`` is its term of the objective, ``explained - beyond - cost * covered``; samples weigh their solid angle.
    """
    total, area, square, share = 0.0, 0.0, 0.0, 0.0
    for k in range(len(work.views)):
        view = view_at(work.views, k)
        span = span_of(view, work.sizes[k, 0], cylinder.x, cylinder.y, cylinder.radius)
        explained, covered, beyond = 0, 0, 0
        for column in range(span.first, span.last):
            run = run_of(view, work.sizes[k, 1], cylinder, span, column)
            weighed = weigh_column(sums, work.seen_sums, k, column, run)
            explained += weighed.explained
            covered += weighed.covered
            beyond += weighed.beyond
        part = explained / FULL
        total += (part - beyond / FULL) * view.weight
        area += covered * view.weight
        square += part * (view.step * np.hypot(span.distance, view.height - cylinder.height / 2)) ** 2
        if covered > 0:
            share = max(share, part / covered)
    return Gain(total - cost * area, square, share, total / max(area, TINY))


@compiled
def cover(work: Any, weights: Any, sums: Any, cylinder: Any, margin: float) -> None:
    """Set to 0 in ``weights``, and in their running ``sums``, what a cylinder covers when enlarged by a margin in m."""
    larger = Cylinder(cylinder.x, cylinder.y, cylinder.radius + margin, cylinder.height + margin)
    for k in range(len(work.views)):
        columns, rows = work.sizes[k]
        view = view_at(work.views, k)
        span = span_of(view, columns, larger.x, larger.y, larger.radius)
        for column in range(span.first, span.last):
            run = run_of(view, rows, larger, span, column)
            for row in range(run.low, run.high):
                weights[k, row, column] = 0
            total = sums[k, run.low, column]
            for row in range(run.low, rows):
                total += weights[k, row, column]
                sums[k, row + 1, column] = total


@compiled
def cover_all(work: Any, weights: Any, sums: Any, cylinders: Any, count: int, left_out: int, margin: float) -> None:
    """Fill ``weights`` and ``sums`` with what the first ``count`` cylinders, but for one, leave unexplained."""
    weights[:], sums[:] = work.weights, work.sums
    for j in range(count):
        if j != left_out:
            cover(work, weights, sums, cylinder_at(cylinders, j), margin)


@compiled
def objective(work: Any, cylinders: Any, count: int, cost: float) -> float:
    """The objective of the first ``count`` cylinders: each one's gain from what those before it leave."""
    weights, sums, total = work.weights.copy(), work.sums.copy(), 0.0
    for j in range(count):
        cylinder = cylinder_at(cylinders, j)
        total += gain(work, sums, cylinder, cost).value
        cover(work, weights, sums, cylinder, 0.0)
    return total
