"""The objective: how well a set of prisms explains the silhouettes.

Summed over the samples of all polar views, a set of prisms is worth

    sum over covered samples of w  -  cost * (samples that each prism covers),    w in [-1, 1]

where ``w`` > 0 is evidence of foreground and ``w`` < 0 of background, and a sample that several prisms cover counts
once. Foreground that goes on in the rim below a base or above a top is subtracted
(:data:`occlib.explaining.silhouettes.RIM_M`). Of a person, columns in which the head or the legs show no foreground are
not covered there. But for these two terms it is, up to scale, the log-likelihood of a probabilistic occupancy map
(Fleuret et al. 2008, doi:10.1109/TPAMI.2007.1174).

What an object may show beyond its prism is *absorbed*: it is worth nothing to it, and little to others. That is where a
person's legs may be apart (:data:`STRIDE_M`), and where a glossy floor mirrors the object (:attr:`Workspace.gloss`).

With running sums of the weights down the columns, a prism is weighed in a few look-ups a column, whatever its size.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from occlib.base.kernels import compiled
from occlib.explaining.evidence import PolarEvidence, view_at
from occlib.explaining.prisms import cylinder, is_body, is_person, larger, prism_at
from occlib.explaining.silhouettes import LEGS, WHOLE, outline_edges, run_of, span_of

FULL = 255.0
"""Weight of a sample that is surely foreground."""

TINY = 1e-9
"""Stands for an area, a distance or a gain of 0, so that nothing is divided by 0."""

ADD, TAKE, NOBODY = np.int64(1), np.int64(-1), np.int64(-1)
"""Signs for :func:`put`, and no prism for :func:`put_all`: typed, as loops are compiled anew for each plain number."""

STRIDE_M, STRIDE_SHARE = 0.25, 0.75
"""Within so many m of a person's prism, up to its hip, this share of the foreground is absorbed: legs that are apart, or
stretched out in front of a chair."""


LEGS_SHOWN = 0.08
"""Share of a person's legs that a view shows at least, if it does not take them for floor."""


class Cover(NamedTuple):
    """What some prisms cover, and the evidence that they leave.

    Parameters
    ----------
    counts
        Prisms that cover each sample, int16 (K, rows, columns).
    absorbed
        Percent of its foreground that they absorb, summed over the prisms, int16 (K, rows, columns).
    sums
        Running sums of what is left of the weights, int32 (K, rows + 1, columns).
    """

    counts: Any
    absorbed: Any
    sums: Any


class Workspace(NamedTuple):
    """What all steps of a search share.

    Parameters
    ----------
    views, sizes, weights, sums, seen_sums
        As in :class:`occlib.explaining.evidence.PolarEvidence`.
    gloss
        For each view the share of the foreground that the floor's mirror images show, float64 (K,), 0 to 1.
    spent
        Columns weighed so far, int64 (1,).
    scratch
        A cover by nothing; whoever puts prisms on it takes them away again.
    """

    views: Any
    sizes: Any
    weights: Any
    sums: Any
    seen_sums: Any
    gloss: Any
    spent: Any
    scratch: Cover


class Gain(NamedTuple):
    """What a prism explains.

    Parameters
    ----------
    value
        Weight explained less the rim's and the cost, in samples of the reference camera: what the search maximises.
    explained_m2
        Area of silhouette explained, in m2 at the prism's own distance, summed over the views.
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


def workspace(evidence: PolarEvidence, gloss: Any = None) -> Workspace:
    """The evidence as the compiled loops take it; without ``gloss``, of a floor that mirrors nothing."""
    gloss = np.zeros(len(evidence.views)) if gloss is None else np.asarray(gloss, np.float64)
    shape, sums = evidence.weights.shape, evidence.sums
    scratch = Cover(np.zeros(shape, np.int16), np.zeros(shape, np.int16), sums.copy())
    spent = np.zeros(1, np.int64)
    return Workspace(evidence.views, evidence.sizes, evidence.weights, sums, evidence.seen_sums, gloss, spent, scratch)


@compiled
def weigh_column(sums: Any, seen_sums: Any, k: int, column: int, run: Any, gloss: float) -> Any:
    """:class:`_Column` of a prism's run in view ``k``. Of a person, a head or legs without foreground are left out."""
    low, high, above = run.low, run.high, run.above
    beyond = int((1.0 - gloss) * max(sums[k, run.below, column] - sums[k, high, column], 0))
    if sums[k, run.trunk, column] <= sums[k, low, column]:  # no head here
        low, above = run.trunk, above + run.trunk - low
    if sums[k, high, column] <= sums[k, run.legs, column]:  # no leg here
        high = run.legs
    beyond += max(sums[k, low, column] - sums[k, above, column], 0)
    explained = sums[k, high, column] - sums[k, low, column]
    return _Column(explained, seen_sums[k, high, column] - seen_sums[k, low, column], beyond)


@compiled
def gain(work: Any, sums: Any, prism: Any, cost: float) -> Any:
    """:class:`Gain` of a prism from the evidence of which ``sums`` are the running sums.

    ``value`` is its term of the objective, ``explained - beyond - cost * covered``; samples weigh their solid angle.
    """
    total, area, square, share = 0.0, 0.0, 0.0, 0.0
    for k in range(len(work.views)):
        view = view_at(work.views, k)
        span = span_of(view, work.sizes[k, 0], prism)
        explained, covered, beyond = 0, 0, 0
        for column in range(span.first, span.last):
            run = run_of(view, work.sizes[k, 1], prism, span, column)
            weighed = weigh_column(sums, work.seen_sums, k, column, run, work.gloss[k])
            explained += weighed.explained
            covered += weighed.covered
            beyond += weighed.beyond
        work.spent[0] += span.last - span.first
        part = explained / FULL
        total += (part - beyond / FULL) * view.weight
        area += covered * view.weight
        square += part * (view.step * np.hypot(span.distance, view.height - prism.height / 2)) ** 2
        if covered > 0:
            share = max(share, part / covered)
    return Gain(total - cost * area, square, share, total / max(area, TINY))


@compiled
def supported(work: Any, prism: Any, least: float, spare: float) -> bool:
    """Whether every view that sees a prism, but for the share ``spare`` of them, shows foreground there.

    At least the share ``least`` of its silhouette must be more likely foreground than background, as it is also where
    another object hides it. A view sees a prism if its silhouette lies in the picture for more than half; two views at
    least must support it, if as many see it. Of a person, half of the views that see the legs must show that share of them:
    furniture and the floor's colour hide legs, but not from everywhere.
    """
    seeing, showing = 0, 0
    person, legs_seeing, legs_showing = is_person(prism), 0, 0
    for k in range(len(work.views)):
        view = view_at(work.views, k)
        span = span_of(view, work.sizes[k, 0], prism)
        rows = work.sizes[k, 1]
        silhouette, seen, foreground = 0, 0, 0
        legs, legs_seen, legs_foreground = 0, 0, 0
        for column in range(span.first, span.last):
            run = run_of(view, rows, prism, span, column)
            if person:
                legs += run.high - run.legs
                legs_seen += work.seen_sums[k, run.high, column] - work.seen_sums[k, run.legs, column]
                for row in range(run.legs, run.high):
                    if work.weights[k, row, column] > 0:
                        legs_foreground += 1
            silhouette += run.high - run.low
            seen += work.seen_sums[k, run.high, column] - work.seen_sums[k, run.low, column]
            for row in range(run.low, run.high):
                if work.weights[k, row, column] > 0:
                    foreground += 1
        if 2 * seen > silhouette:
            seeing += 1
            if foreground >= least * seen:
                showing += 1
        if 2 * legs_seen > legs:
            legs_seeing += 1
            if legs_foreground >= LEGS_SHOWN * legs_seen:
                legs_showing += 1
    if 2 * legs_showing < legs_seeing:
        return False
    return showing >= seeing - int(spare * seeing) and (showing >= 2 or showing == seeing)


# --- covering -----------------------------------------------------------------------------------------------
@compiled
def uncovered(work: Any) -> Any:
    """A :class:`Cover` by nothing."""
    shape = work.weights.shape
    return Cover(np.zeros(shape, np.int16), np.zeros(shape, np.int16), work.sums.copy())


@compiled
def mirrored(view: Any, rows: int, near: float, height: float) -> int:
    """The row after the last of the mirror image of what stands ``near`` m away: it seems to hang below the floor."""
    return min(int(np.floor((np.arctan2(view.height + height, near) - view.top) / view.step)) + 1, rows)


@compiled
def put(work: Any, cover: Any, prism: Any, margin: float, sign: int) -> None:
    """Add a prism, enlarged by a margin in m, to a cover (``sign`` 1), or take it away again (-1)."""
    body = larger(prism, margin) if margin > 0.0 else prism
    person = is_body(prism)
    wide = cylinder(prism.x, prism.y, prism.radius + STRIDE_M, LEGS * prism.height)
    for k in range(len(work.views)):
        columns, rows = work.sizes[k]
        view = view_at(work.views, k)
        span = span_of(view, columns, body)
        stride = span_of(view, columns, wide) if person else span
        mirror = int(100 * work.gloss[k])
        first, last = min(span.first, stride.first), min(max(span.last, stride.last), columns)
        work.spent[0] += 8 * (last - first)  # a column covered takes about so many times as long as one weighed
        for column in range(first, last):
            start = rows
            if span.first <= column < span.last:
                run = run_of(view, rows, body, span, column)
                start = run.low
                for row in range(run.low, run.high):
                    cover.counts[k, row, column] += sign
                if mirror > 0:
                    near, _ = outline_edges(view, column, span, body, WHOLE)
                    for row in range(run.high, mirrored(view, rows, near, body.height)):
                        cover.absorbed[k, row, column] += sign * mirror
            if person and stride.first <= column < stride.last:
                run = run_of(view, rows, wide, stride, column)
                start = min(start, run.low)
                for row in range(run.low, run.high):
                    cover.absorbed[k, row, column] += sign * int(100 * STRIDE_SHARE)
            total = cover.sums[k, start, column]
            for row in range(start, rows):
                weight = work.weights[k, row, column]
                if cover.counts[k, row, column] > 0:
                    weight = 0
                elif weight > 0 and cover.absorbed[k, row, column] > 0:
                    weight = weight * max(100 - cover.absorbed[k, row, column], 0) // 100
                total += weight
                cover.sums[k, row + 1, column] = total


@compiled
def abreast(work: Any, prism: Any, other: Any, margin: float) -> bool:
    """Whether another prism, enlarged by a margin in m, has columns in common with a prism in some view."""
    body = larger(other, margin + (STRIDE_M if is_body(other) else 0.0))
    for k in range(len(work.views)):
        view = view_at(work.views, k)
        own, its = span_of(view, work.sizes[k, 0], prism), span_of(view, work.sizes[k, 0], body)
        if own.first < its.last and its.first < own.last:
            return True
    return False


@compiled
def put_all(work: Any, cover: Any, prisms: Any, count: int, left_out: int, margin: float, sign: int) -> None:
    """:func:`put` for the first ``count`` prisms, but for one."""
    for j in range(count):
        if j != left_out:
            put(work, cover, prism_at(prisms, j), margin, sign)


@compiled
def left_over(work: Any, cover: Any) -> float:
    """Share of the foreground that a cover leaves, 0 to 1."""
    left, whole = 0, 0
    for k in range(len(work.views)):
        for row in range(work.sizes[k, 1]):
            for column in range(work.sizes[k, 0]):
                weight = work.weights[k, row, column]
                if weight > 0:
                    whole += weight
                    left += 0 if cover.counts[k, row, column] > 0 else (
                        weight * max(100 - cover.absorbed[k, row, column], 0) // 100
                    )  # fmt: skip
    return left / max(whole, 1)


@compiled
def objective(work: Any, prisms: Any, count: int, cost: float) -> float:
    """The objective of the first ``count`` prisms: each one's gain from what those before it leave."""
    cover, total = work.scratch, 0.0
    for j in range(count):
        prism = prism_at(prisms, j)
        total += gain(work, cover.sums, prism, cost).value
        put(work, cover, prism, 0.0, ADD)
    put_all(work, cover, prisms, count, NOBODY, 0.0, TAKE)
    return total
