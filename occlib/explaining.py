"""Explaining away: the fewest upright objects of plausible size that explain all silhouettes (section 5, beyond AND).

AND asks of each cell of the floor whether every view *could* have an object there. The shadows of n objects from two cameras
then cross in up to n (n - 1) / 2 places where nothing stands. Here the question is turned round: which objects, put on the floor, would
have cast the silhouettes that the cameras see? A ghost explains nothing that the real objects do not explain already, so it
is never needed; an object that one view hides is, because the other view's silhouette would stay unexplained.

An object is an upright cylinder: place, radius, height. In a polar view (:class:`occlib.registration.PolarWarp`: a column
is an azimuth, a row an angle of depression) it covers one run of rows in each column, from its near edge on the floor to the
far edge of its top. With running sums down the columns, a cylinder is weighed in a few look-ups, whatever its size.

The objective of a set of cylinders, summed over the views' samples, is

    sum over covered samples of w  -  cost * (samples that each cylinder covers),    w in [-1, 1]

where ``w`` > 0 is evidence of foreground and ``w`` < 0 of background, and a sample that several cylinders cover counts once;
foreground that goes on right beyond a base or a top is subtracted (:data:`RIM_M`). What is as tall as a person is a body: in a column of samples that
shows no head, or no leg, these parts are not covered. But for that it is the log-likelihood of a probabilistic occupancy map (Fleuret et al. 2008, doi:10.1109/TPAMI.2007.1174) up to scale,
maximised as marked point processes are (Utasi and Benedek 2011, doi:10.1109/CVPR.2011.5995699), but greedily: the best
cylinder first, then each refined beside the others, then those dropped that the others explain as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.geometry import FloatArray, Image, Mask, as_points
from occlib.kernels import compiled

RADII = np.array([0.06, 0.085, 0.12, 0.16, 0.21, 0.28, 0.36])
HEIGHTS = np.array([0.04, 0.06, 0.09, 0.13, 0.18, 0.24, 0.32, 0.42, 0.55, 0.72, 0.95, 1.2, 1.45, 1.7, 1.9])
"""Sizes tried at first, in m; the best are then refined freely between the limits of :func:`plausible`."""


PERSON_M = 1.4
"""What is as tall is a body. It has arms, legs and bags: nothing low within 0.5 m of its axis, nor anything tall within 0.3 m, is
an object of its own."""
CHIN, LEGS, HEAD = 0.87, 0.4, 0.83
"""A body's shares of its height from which there is only a head, and up to which legs may be apart (Drillis and Contini 1966 have
the chin at 0.870, knee and hip at 0.285 and 0.530); where its chord is shorter than this share of its width, there need be no head."""
FEET_M, SPREAD_M, LEGS_M2, FEET_TRUST = 0.35, 0.4, 0.08, 4.0
"""Where a body's feet are looked for: so high above the floor and so far to the sides of its axis, in m; what two legs show there, in
m2; and by how much a view that shows them is trusted more than the axis (8 cm against 4 cm)."""
LEAN_M = 0.15
"""No body's feet are further from its axis, in m: then the views show something else."""
MEAN_SHARE = 0.02
"""A place that explains this share less counts 1/e in the mean."""
RIM_M = 0.12
"""Foreground that goes on within so many m in front of an object's base or above its top counts against the object: it begins
where its silhouette begins. A ghost floats in the silhouettes of others."""


@dataclass(frozen=True)
class Cylinder:
    """An upright object: ``x``, ``y`` of its axis, ``radius`` and ``height``, all in m."""

    x: float
    y: float
    radius: float
    height: float


class Explanation(NamedTuple):
    """How hard the silhouettes are to be explained.

    Parameters
    ----------
    cost
        Share of its own silhouette that an object must explain before it counts: the price of one object more.
    background
        Weight of a covered background sample against a covered foreground sample.
    least_area_m2
        An object that explains less silhouette, in m2 at its own distance, is noise.
    least_share
        Share of its silhouette, in its best view, that no other object may explain.
    fragment_share
        The same for what stands beside something much taller, such as an arm or a bag: it must stand clear of it.
    margin_m, reach
        What an object explains is enlarged by ``margin_m + reach * height`` when others are judged, and for
        fragments by ``margin_m + fragment_reach * height``.
    keep
        The last instant's objects stay unless a fresh search explains this share more.
    grid_m
        Spacing of the places tried.
    most
        No more objects than so many.
    """

    cost: float = 0.15
    background: float = 0.6
    least_area_m2: float = 0.006
    least_share: float = 0.15
    fragment_share: float = 0.3
    margin_m: float = 0.05
    reach: float = 0.04
    fragment_reach: float = 0.12
    keep: float = 0.1
    grid_m: float = 0.08
    most: int = 32


DEFAULT = Explanation()
"""Chosen on the rendered recordings and on ufes-lab."""


# --- kernels ---------------------------------------------------------------------------------------
# ``views`` (K, 8): station x, y, height in m; azimuth of the middle, of column 0 relative to it, depression of row 0, step in
# rad; weight of a sample. ``sizes`` (K, 2): columns and rows of a view. ``sums`` (K, rows + 1, columns): running sums.


@compiled
def plausible(radius: float, height: float) -> bool:
    """Whether something of this size may stand on the floor: neither a pole nor a sheet, nor a wide wall."""
    wide = 0.45 if height <= 0.7 else max(0.22, 0.45 - 0.46 * (height - 0.7))
    return 0.03 + 0.065 * height <= radius <= wide and radius >= 0.05 and max(0.025, 0.2 * radius) <= height <= 2.0


@compiled
def _span(view: Any, columns: int, x: float, y: float, radius: float) -> Any:
    """First and last + 1 column of a disc on the floor, its distance and azimuth; no column if the camera hangs above it."""
    dx, dy = x - view[0], y - view[1]
    distance = np.hypot(dx, dy)
    azimuth = (np.arctan2(dy, dx) - view[3] + np.pi) % (2 * np.pi) - np.pi
    if distance <= radius * 1.02:
        return 0, 0, distance, azimuth
    half = np.arcsin(radius / distance)
    first = max(int(np.ceil((azimuth - half - view[4]) / view[6])), 0)
    last = min(int(np.floor((azimuth + half - view[4]) / view[6])) + 1, columns)
    return first, max(first, last), distance, azimuth


@compiled
def _edges(view: Any, column: int, distance: float, azimuth: float, radius: float) -> Any:
    """How far in m the near and the far edge of the disc are in a column."""
    turn = view[4] + column * view[6] - azimuth
    chord = np.sqrt(max(radius * radius - (distance * np.sin(turn)) ** 2, 0.0))
    return distance * np.cos(turn) - chord, distance * np.cos(turn) + chord


@compiled
def _foot(view: Any, near: float) -> Any:
    """Last + 1 row of what stands at the near edge, and how many rows 12 cm are there."""
    return int(np.floor((np.arctan2(view[2], near) - view[5]) / view[6])) + 1, int(
        RIM_M / np.hypot(near, view[2]) / view[6]
    )


@compiled
def _top(view: Any, near: float, far: float, height: float) -> int:
    """First row: the far edge of the top, or the near one above the camera."""
    above = view[2] - height
    return int(np.ceil((np.arctan2(above, far if above > 0 else near) - view[5]) / view[6]))


@compiled
def room_for_runs(columns: int) -> Any:
    """Memory for what :func:`silhouette` writes in a view of so many columns, int64 (columns + 1, 6)."""
    return np.empty((columns + 1, 6), np.int64)


@compiled
def silhouette(view: Any, columns: int, rows: int, x: float, y: float, radius: float, height: float, out: Any) -> Any:
    """First and last + 1 column of a cylinder, and in ``out`` rows of each: the first and last + 1, the same of what
    is near it, the first below a head and the first of legs."""
    first, last, distance, azimuth = _span(view, columns, x, y, radius)
    for column in range(first, last):
        near, far = _edges(view, column, distance, azimuth, radius)
        foot, nearby = _foot(view, near)
        low = min(max(_top(view, near, far, height), 0), rows)
        high = max(min(max(foot, 0), rows), low)
        out[column - first, 0], out[column - first, 1] = low, high
        # what lies in front of the base and above the top, a hand's breadth: 12 cm, seen at this distance
        out[column - first, 2], out[column - first, 3] = max(low - nearby, 0), min(high + nearby, rows)
        out[column - first, 4], out[column - first, 5] = _limbs(view, near, far, radius, height, low, high)
    return first, last


@compiled
def _limbs(view: Any, near: float, far: float, radius: float, height: float, low: int, high: int) -> Any:
    """In a column of a cylinder, rows ``low`` to ``high``, the first row of its trunk and of its legs, if it is a body."""
    if height < PERSON_M:
        return low, high
    trunk = low
    if far - near < HEAD * 2 * radius:
        trunk = min(max(_top(view, near, far, CHIN * height), low), high)
    return trunk, min(max(_top(view, near, near, LEGS * height), trunk), high)


@compiled
def _column(
    sums: Any, seen: Any, k: int, column: int, low: int, high: int, above: int, below: int, trunk: int, legs: int
) -> Any:
    """What a column of a cylinder explains, the samples that it covers, and the foreground that goes on beyond it."""
    beyond = max(sums[k, below, column] - sums[k, high, column], 0)
    if sums[k, trunk, column] <= sums[k, low, column]:  # no head here
        low, above = trunk, above + trunk - low
    if sums[k, high, column] <= sums[k, legs, column]:  # no leg
        high = legs
    beyond += max(sums[k, low, column] - sums[k, above, column], 0)
    return sums[k, high, column] - sums[k, low, column], seen[k, high, column] - seen[k, low, column], beyond


@compiled
def gain(views: Any, sizes: Any, sums: Any, seen: Any, thing: Any, cost: float, runs: Any, found: Any) -> float:
    """What a cylinder explains less its cost; ``found``: m2 explained, largest share in a view, share in all views."""
    total, area, square, share = 0.0, 0.0, 0.0, 0.0
    for k in range(len(views)):
        first, last = silhouette(views[k], sizes[k, 0], sizes[k, 1], thing[0], thing[1], thing[2], thing[3], runs)
        explained, covered, beyond = 0, 0, 0
        for column in range(first, last):
            run = runs[column - first]
            evidence, samples, more = _column(sums, seen, k, column, run[0], run[1], run[2], run[3], run[4], run[5])
            explained += evidence
            covered += samples
            beyond += more
        distance = np.hypot(thing[0] - views[k, 0], thing[1] - views[k, 1])
        part = explained / 255.0
        total += (part - beyond / 255.0) * views[k, 7]
        area += covered * views[k, 7]
        square += part * (views[k, 6] * np.hypot(distance, views[k, 2] - thing[3] / 2)) ** 2
        if covered > 0:
            share = max(share, part / covered)
    found[0], found[1], found[2] = square, share, total / max(area, 1e-9)
    return total - cost * area


@compiled
def cover(views: Any, sizes: Any, weights: Any, sums: Any, thing: Any, margin: float, runs: Any) -> None:
    """Take out of ``weights`` and their running ``sums`` what a cylinder, enlarged by a margin in m, covers."""
    for k in range(len(views)):
        columns, rows = sizes[k]
        first, last = silhouette(
            views[k], columns, rows, thing[0], thing[1], thing[2] + margin, thing[3] + margin, runs
        )
        for column in range(first, last):
            for row in range(runs[column - first, 0], runs[column - first, 1]):
                weights[k, row, column] = 0
            total = sums[k, runs[column - first, 0], column]
            for row in range(runs[column - first, 0], rows):
                total += weights[k, row, column]
                sums[k, row + 1, column] = total


class _Search(NamedTuple):
    """What all steps of a search share: the evidence, which stays, and memory to work in."""

    views: Any
    sizes: Any
    weights: Any
    sums: Any
    seen: Any
    spare: Any
    spare_sums: Any
    runs: Any
    found: Any


@compiled
def _gain(at: Any, sums: Any, thing: Any, cost: float) -> float:
    return gain(at.views, at.sizes, sums, at.seen, thing, cost, at.runs, at.found)


@compiled
def _cover(at: Any, thing: Any, margin: float) -> None:
    cover(at.views, at.sizes, at.spare, at.spare_sums, thing, margin, at.runs)


@compiled
def _cover_all(at: Any, weights: Any, sums: Any, things: Any, count: int, but: int, margin: float) -> None:
    """Fill ``weights`` and ``sums`` with the evidence that the cylinders, without one, leave unexplained."""
    weights[:], sums[:] = at.weights, at.sums
    for j in range(count):
        if j != but:
            cover(at.views, at.sizes, weights, sums, things[j], margin, at.runs)


@compiled
def _refined(at: Any, sums: Any, thing: Any, cost: float, step0: float) -> Any:
    """The cylinder moved and sized, in steps of ``step0`` m and ever smaller ones, to where it explains most."""
    best = _gain(at, sums, thing, cost)
    # the height has far optima: a body is cut at the belt, or goes on in one that stands behind
    for height in HEIGHTS if step0 > 0.03 else HEIGHTS[:0]:
        if plausible(thing[2], height):
            other = thing.copy()
            other[3] = height
            value = _gain(at, sums, other, cost)
            if value > best + 1e-6:
                best, thing = value, other
    step = step0 * np.array([1.0, 1.0, 0.5, max(0.33, 1.67 * thing[3])])
    for _ in range(14):
        improved = False
        for i in range(4):
            for sign in (1.0, -1.0):
                other = thing.copy()
                other[i] += sign * step[i]
                if plausible(other[2], other[3]):
                    value = _gain(at, sums, other, cost)
                    if value > best + 1e-6:
                        best, thing, improved = value, other, True
        for k in range(len(at.views)):  # along the sight-line of one view: farther and lower looks the same to it
            dx, dy = thing[0] - at.views[k, 0], thing[1] - at.views[k, 1]
            distance = max(np.hypot(dx, dy), 1e-9)
            for sign in (1.0, -1.0):
                other = thing.copy()
                other[0] += sign * step[0] * dx / distance
                other[1] += sign * step[0] * dy / distance
                other[3] -= sign * step[0] * (at.views[k, 2] - thing[3]) / distance
                if plausible(other[2], other[3]):
                    value = _gain(at, sums, other, cost)
                    if value > best + 1e-6:
                        best, thing, improved = value, other, True
        if not improved:
            step /= 2
            if step[0] < 0.004:
                break
    return thing


@compiled
def _candidates(at: Any, sums: Any, places: Any, cost: float) -> Any:
    """For each place and radius the best height, where there is one: cylinders (N, 4) and what they explain (N,).

    What does not depend on the height is worked out once; the values are those of :func:`gain`. The search goes up until
    what the columns hold at most would no longer pay for what is covered.
    """
    most = _most(at, sums)
    things, values, n = np.empty((len(places) * len(RADII), 4)), np.empty(len(places) * len(RADII)), 0
    spans = np.empty((len(at.views), 2), np.int64)
    edges = np.empty((len(at.views), at.weights.shape[2], 2))
    feet = np.empty((len(at.views), at.weights.shape[2], 2), np.int64)
    for i in range(len(places)):
        for radius in RADII:
            bound = 0.0
            for k in range(len(at.views)):
                first, last, distance, azimuth = _span(at.views[k], at.sizes[k, 0], places[i, 0], places[i, 1], radius)
                spans[k] = first, last
                for column in range(first, last):
                    edges[k, column] = _edges(at.views[k], column, distance, azimuth, radius)
                    feet[k, column] = _foot(at.views[k], edges[k, column, 0])
                    bound += most[k, column] * at.views[k, 7]
            bound *= 1 + 1e-9  # rounding
            best, falling, least = 0.0, 0, 0.0
            for height in HEIGHTS:
                if bound <= best:
                    break
                if height < least or not plausible(radius, height):
                    continue
                value, area = _gain_at(at, sums, spans, edges, feet, radius, height, cost)
                if value > best:
                    if best == 0.0:
                        n += 1
                    best, falling = value, 0
                    things[n - 1, 0], things[n - 1, 1] = places[i, 0], places[i, 1]
                    things[n - 1, 2], things[n - 1, 3] = radius, height
                    values[n - 1] = value
                elif best > 0:
                    falling += 1
                    if falling >= 4:
                        break
                if bound - cost * area <= best:  # nor does it pay for what is higher, but a body may cover less
                    least = PERSON_M
    return things[:n], values[:n]


@compiled
def _most(at: Any, sums: Any) -> Any:
    """The most that any run of rows explains in each column, (K, columns)."""
    most = np.zeros(at.weights.shape[::2])
    for k in range(len(most)):
        for column in range(at.sizes[k, 0]):
            least = sums[k, 0, column]
            for row in range(1, at.sizes[k, 1] + 1):
                least = min(least, sums[k, row, column])
                most[k, column] = max(most[k, column], (sums[k, row, column] - least) / 255.0)
    return most


@compiled
def _gain_at(at: Any, sums: Any, spans: Any, edges: Any, feet: Any, radius: float, height: float, cost: float) -> Any:
    """:func:`gain` of a cylinder of which only the height is new, and the area that it covers."""
    total, area = 0.0, 0.0
    for k in range(len(at.views)):
        rows = at.sizes[k, 1]
        explained, covered, beyond = 0, 0, 0
        for column in range(spans[k, 0], spans[k, 1]):
            near, far = edges[k, column]
            low = min(max(_top(at.views[k], near, far, height), 0), rows)
            high = max(min(max(feet[k, column, 0], 0), rows), low)
            trunk, legs = _limbs(at.views[k], near, far, radius, height, low, high)
            above, below = max(low - feet[k, column, 1], 0), min(high + feet[k, column, 1], rows)
            evidence, samples, more = _column(sums, at.seen, k, column, low, high, above, below, trunk, legs)
            explained += evidence
            covered += samples
            beyond += more
        total += (explained / 255.0 - beyond / 255.0) * at.views[k, 7]
        area += covered * at.views[k, 7]
    return total - cost * area, area


@compiled
def _stands_alone(at: Any, things: Any, count: int, but: int, thing: Any, how: Any) -> bool:
    """Whether enough of a cylinder is explained by none of the others; a fragment must stand clear of what towers over it."""
    at.spare[:], at.spare_sums[:] = at.weights, at.sums
    towered = False
    for j in range(count):
        if j != but:
            _cover(at, things[j], how.margin_m + how.reach * things[j, 3])
            apart = np.hypot(things[j, 0] - thing[0], things[j, 1] - thing[1])
            if things[j, 3] >= PERSON_M and apart < (0.5 if thing[3] < 0.6 * things[j, 3] else 0.3):
                return False
            towered = towered or (thing[3] < 0.6 * things[j, 3] and apart < 0.3 + 0.5 * things[j, 3])
    _gain(at, at.spare_sums, thing, 0.0)
    if at.found[0] < how.least_area_m2 or at.found[1] < how.least_share:
        return False
    if towered:
        for j in range(count):
            if j != but and thing[3] < 0.6 * things[j, 3]:
                _cover(at, things[j], how.margin_m + how.fragment_reach * things[j, 3])
        _gain(at, at.spare_sums, thing, 0.0)
    return at.found[0] >= how.least_area_m2 and (not towered or at.found[1] >= how.fragment_share)


@compiled
def _fill_up(at: Any, candidates: Any, values: Any, things: Any, count: int, how: Any) -> int:
    """Add the candidate that explains most of what is left, again and again. Values only fall, so few are looked at anew."""
    weights, sums, bound = at.weights.copy(), at.sums.copy(), values.copy()
    _cover_all(at, weights, sums, things, count, -1, 0.0)
    while count < len(things) and len(bound):
        best = bound.argmax()
        if bound[best] <= 0:
            break
        value = _gain(at, sums, candidates[best], how.cost)
        if value < bound[best] - 1e-9:
            bound[best] = value
            continue
        bound[best] = -1.0
        thing = _refined(at, sums, candidates[best].copy(), how.cost, 0.06)
        if _stands_alone(at, things, count, -1, thing, how):
            things[count] = thing
            count += 1
            cover(at.views, at.sizes, weights, sums, thing, 0.0, at.runs)
    return count


@compiled
def _settle(at: Any, things: Any, count: int, how: Any, step0: float) -> int:
    """Refine each cylinder beside the others, then drop, the weakest first, those that the others explain as well."""
    weights, sums = at.weights.copy(), at.sums.copy()
    for k in range(count):
        _cover_all(at, weights, sums, things, count, k, 0.0)
        things[k] = _refined(at, sums, things[k].copy(), how.cost, step0)
    while count:
        worst, least = -1, np.inf
        for k in range(count):
            _cover_all(at, weights, sums, things, count, k, 0.0)
            value = _gain(at, sums, things[k], how.cost)
            if value < least and (value <= 0 or not _stands_alone(at, things, count, k, things[k], how)):
                worst, least = k, value
        if worst < 0:
            break
        for j in range(worst, count - 1):
            things[j] = things[j + 1]
        count -= 1
    return count


@compiled
def objective(
    views: Any, sizes: Any, weights0: Any, sums0: Any, seen: Any, things: Any, count: int, cost: float
) -> float:
    """The objective of a set of cylinders; a sample that several cover counts once."""
    weights, sums, total = weights0.copy(), sums0.copy(), 0.0
    runs, found = room_for_runs(weights.shape[2]), np.empty(3)
    for k in range(count):
        total += gain(views, sizes, sums, seen, things[k], cost, runs, found)
        cover(views, sizes, weights, sums, things[k], 0.0, runs)
    return total


@compiled
def _continued(at: Any, places: Any, things: Any, count: int, how: Any) -> Any:
    """The last instant's objects and what they leave: their number, their value, and whether nothing of weight is left."""
    count = _settle(at, things, count, how, 0.03)
    _cover_all(at, at.spare, at.spare_sums, things, count, -1, how.margin_m)
    candidates, values = _candidates(at, at.spare_sums, places, how.cost)
    known = count
    count = _fill_up(at, candidates, values, things, count, how)
    if count > known:
        count = _settle(at, things, count, how, 0.06)
    value = objective(at.views, at.sizes, at.weights, at.sums, at.seen, things, count, how.cost)
    _cover_all(at, at.spare, at.spare_sums, things, count, -1, how.margin_m)
    return count, value, np.maximum(at.spare, 0).sum() <= 0.1 * np.maximum(at.weights, 0).sum()


@compiled
def _replaced(at: Any, candidates: Any, best: Any, n: int, total: float, chosen: int, how: Any) -> Any:
    """The objects with others tried first in the place of one, wherever that explains more; else as they are."""
    weights, sums = at.weights.copy(), at.sums.copy()
    _cover_all(at, weights, sums, best, n, chosen, 0.0)
    left = np.empty(len(candidates))
    for i in range(len(candidates)):
        left[i] = _gain(at, sums, candidates[i], how.cost)
    free = left.copy()
    centre_x, centre_y = best[chosen, 0], best[chosen, 1]
    for _ in range(6):
        for i in range(len(candidates)):
            if np.hypot(candidates[i, 0] - centre_x, candidates[i, 1] - centre_y) < 0.3:
                free[i] = -1.0
        first = free.argmax() if len(free) else 0
        if len(free) == 0 or free[first] <= 0:
            break
        centre_x, centre_y = candidates[first, 0], candidates[first, 1]
        things, count = np.zeros_like(best), 0
        for j in range(n):
            if j != chosen:
                things[count] = best[j]
                count += 1
        things[count] = candidates[first]
        count = _fill_up(at, candidates, left, things, count + 1, how)
        count = _settle(at, things, count, how, 0.06)
        value = objective(at.views, at.sizes, at.weights, at.sums, at.seen, things, count, how.cost)
        if value > total + 1e-6:
            return things, count, value
    return best, n, total


@compiled
def _solve(at: Any, places: Any, before: Any, how: Any) -> Any:
    best, n, total = np.zeros((how.most, 4)), 0, 0.0
    if len(before):
        for thing in before[: how.most]:
            best[n] = thing
            n += 1
        n, value, done = _continued(at, places, best, n, how)
        total = value * (1 + how.keep)
        if done:
            return best[:n]  # no need to begin anew
    candidates, values = _candidates(at, at.sums, places, how.cost)
    things = np.zeros((how.most, 4))
    count = _settle(at, things, _fill_up(at, candidates, values, things, 0, how), how, 0.06)
    value = objective(at.views, at.sizes, at.weights, at.sums, at.seen, things, count, how.cost)
    if value > total:
        best, n, total = things, count, value
    for attempt in range(4):  # one wide object may stand for two
        chosen = -1
        for k in range(attempt, n):
            _gain(at, at.sums, best[k], how.cost)
            if at.found[2] < 0.8 and best[k, 2] > 0.12:
                chosen = k
                break
        if chosen < 0:
            break
        best, n, total = _replaced(at, candidates, best, n, total, chosen, how)
    return best[:n]


@compiled
def _hidden(views: Any, sizes: Any, seen: Any, things: Any, out: Any, by: Any) -> None:
    runs = room_for_runs(seen.shape[2])
    for k in range(len(views)):
        columns, rows = sizes[k]
        for i in range(len(things)):
            first, last = silhouette(
                views[k], columns, rows, things[i, 0], things[i, 1], things[i, 2], things[i, 3], runs
            )
            mine = runs[: last - first].copy()
            covered = np.zeros((last - first, rows), np.bool_)
            area = 0
            for c in range(last - first):
                area += seen[k, mine[c, 1], first + c] - seen[k, mine[c, 0], first + c]
            distance = np.hypot(things[i, 0] - views[k, 0], things[i, 1] - views[k, 1])
            most = 0
            for j in range(len(things)):
                if j == i or np.hypot(things[j, 0] - views[k, 0], things[j, 1] - views[k, 1]) >= distance:
                    continue
                start, stop = silhouette(
                    views[k], columns, rows, things[j, 0], things[j, 1], things[j, 2], things[j, 3], runs
                )
                own = 0
                for column in range(max(first, start), min(last, stop)):
                    for row in range(
                        max(mine[column - first, 0], runs[column - start, 0]),
                        min(mine[column - first, 1], runs[column - start, 1]),
                    ):
                        if seen[k, row + 1, column] > seen[k, row, column]:
                            covered[column - first, row] = True
                            own += 1
                if own > most:
                    most, by[i, k] = own, j
            out[i, k] = covered.sum() / area if area else np.nan


@compiled
def _between_feet(view: Any, size: Any, weights: Any, x: float, y: float) -> Any:
    """Azimuth in rad halfway between the outer edges of the foreground around the feet, and how much of two legs it shows, 0 to 1."""
    distance = max(np.hypot(x - view[0], y - view[1]), 2 * SPREAD_M)
    azimuth = (np.arctan2(y - view[1], x - view[0]) - view[3] + np.pi) % (2 * np.pi) - np.pi
    half = SPREAD_M / distance
    first = max(int(np.ceil((azimuth - half - view[4]) / view[6])), 0)
    last = min(int(np.floor((azimuth + half - view[4]) / view[6])) + 1, size[0])
    top = max(int(np.ceil((np.arctan2(view[2] - FEET_M, distance) - view[5]) / view[6])), 0)
    foot = min(int(np.floor((np.arctan2(view[2], distance - SPREAD_M) - view[5]) / view[6])) + 1, size[1])
    legs = np.zeros(max(last - first, 0))
    for column in range(first, last):
        for row in range(top, foot):
            legs[column - first] += max(weights[row, column], 0) / 255.0
    total, below, left, right = legs.sum(), 0.0, 0.0, 0.0
    for i in range(len(legs)):  # the outer edges, but for a fourteenth on either side
        if legs[i] > 0:
            if below < total / 14 <= below + legs[i]:
                left = i - 0.5 + (total / 14 - below) / legs[i]
            if below < total * 13 / 14 <= below + legs[i]:
                right = i - 0.5 + (total * 13 / 14 - below) / legs[i]
            below += legs[i]
    shown = total * (view[6] * np.hypot(distance, view[2])) ** 2 / LEGS_M2
    shown = min(shown, 1.0, max(2.6 - shown, 0.0))  # what shows more than legs shows something else, too
    return view[3] + view[4] + (first + (left + right) / 2) * view[6], shown


@compiled
def _mean_place(at: Any, sums: Any, thing: Any, cost: float) -> Any:
    """The mean of the places along the sight-lines of the two nearest views, each by how nearly a cylinder there explains as much."""
    best = max(_gain(at, sums, thing, cost), 1e-9)
    total, x, y = 0.0, 0.0, 0.0
    for k in np.argsort(np.hypot(thing[0] - at.views[:, 0], thing[1] - at.views[:, 1]))[:2]:
        dx, dy = thing[0] - at.views[k, 0], thing[1] - at.views[k, 1]
        distance = max(np.hypot(dx, dy), 1e-9)
        slope = (at.views[k, 2] - thing[3]) / distance
        for step in range(-4, 5):
            for wider in range(-1, 2):
                for higher in range(-1, 2):
                    other = thing.copy()
                    other[0] += 0.01 * step * dx / distance
                    other[1] += 0.01 * step * dy / distance
                    other[2] += 0.015 * wider
                    other[3] += 0.015 * higher - 0.01 * step * slope  # farther and lower looks the same
                    if plausible(other[2], other[3]):
                        weight = np.exp(min((_gain(at, sums, other, cost) / best - 1) / MEAN_SHARE, 50.0))
                        total, x, y = total + weight, x + weight * other[0], y + weight * other[1]
    if total == 0:
        return thing[0], thing[1]
    return x / total, y / total


@compiled
def _feet(at: Any, weights: Any, thing: Any) -> Any:
    """The point that agrees best with a body's axis and with the bearings between its feet, no further than it may lean."""
    x, y = thing[0], thing[1]
    for _ in range(3):
        a, b, c, u, v = 1.0, 0.0, 1.0, thing[0], thing[1]
        for k in range(len(at.views)):
            azimuth, shown = _between_feet(at.views[k], at.sizes[k], weights[k], x, y)
            p, q, trust = -np.sin(azimuth), np.cos(azimuth), FEET_TRUST * shown * shown
            off = p * at.views[k, 0] + q * at.views[k, 1]
            a, b, c = a + trust * p * p, b + trust * p * q, c + trust * q * q
            u, v = u + trust * off * p, v + trust * off * q
        x, y = (c * u - b * v) / (a * c - b * b), (a * v - b * u) / (a * c - b * b)
    share = min(LEAN_M / max(np.hypot(x - thing[0], y - thing[1]), 1e-9), 1.0)
    return thing[0] + share * (x - thing[0]), thing[1] + share * (y - thing[1])


@compiled
def _stand(at: Any, things: Any, cost: float, out: Any) -> None:
    for i in range(len(things)):
        body = things[i, 3] >= PERSON_M
        _cover_all(at, at.spare, at.spare_sums, things, len(things), i, 0.05 if body else 0.0)
        if body:
            out[i] = _feet(at, at.spare, things[i])
        else:
            out[i] = _mean_place(at, at.spare_sums, things[i], cost)


# --- the stage -------------------------------------------------------------------------------------
@dataclass(frozen=True)
class PolarEvidence:
    """The polar views of one instant.

    Parameters
    ----------
    views
        float64 (K, 8), from :attr:`occlib.registration.PolarWarp.parameters`.
    sizes
        int64 (K, 2), columns and rows of each view.
    weights
        int32 (K, rows, columns), -255 surely background to 255 surely foreground; 0 says nothing.
    seen
        Bool (K, rows, columns), samples that the camera sees.
    """

    views: FloatArray
    sizes: npt.NDArray[np.int64]
    weights: npt.NDArray[np.int32]
    seen: Mask

    def __post_init__(self) -> None:
        shape = self.weights.shape  # the compiled loops look up without checking
        if self.weights.ndim != 3 or self.weights.dtype != np.int32:
            raise ValueError(f"weights: expected int32 (K, rows, columns), got {self.weights.dtype} {shape}")
        if self.seen.shape != shape or self.seen.dtype != np.bool_:
            raise ValueError(f"seen: expected bool {shape}, got {self.seen.dtype} {self.seen.shape}")
        if self.views.shape != (shape[0], 8) or not np.isfinite(self.views).all():
            raise ValueError(f"views: expected {(shape[0], 8)} finite numbers, got {self.views.shape}")
        if self.sizes.shape != (shape[0], 2) or not ((self.sizes >= 0) & (self.sizes <= shape[:0:-1])).all():
            raise ValueError(
                f"sizes: expected {shape[0]} times columns, rows up to {shape[:0:-1]}, got {self.sizes.tolist()}"
            )

    @classmethod
    def of(cls, views: Sequence[tuple[FloatArray, Image, Mask]]) -> PolarEvidence:
        """Views of different size side by side: for each its parameters, weights and samples seen, (rows, columns) each."""
        sizes = np.array([seen.shape[::-1] for _, _, seen in views], np.int64)
        columns, rows = sizes.max(axis=0)
        weights, seen = np.zeros((len(views), rows, columns), np.int32), np.zeros((len(views), rows, columns), bool)
        for k, (_, own, samples) in enumerate(views):
            window = np.s_[k, : samples.shape[0], : samples.shape[1]]
            weights[window], seen[window] = own, samples
        return cls(np.array([parameters for parameters, _, _ in views]), sizes, weights, seen)

    @cached_property
    def sums(self) -> npt.NDArray[np.int32]:
        """Running sums of the weights down the columns, int32 (K, rows + 1, columns)."""
        return running_sums(self.weights)

    @cached_property
    def seen_sums(self) -> npt.NDArray[np.int32]:
        """Running sums of the samples seen down the columns, int32 (K, rows + 1, columns)."""
        return running_sums(self.seen)


def running_sums(values: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    """Sums of what lies above each row, int32 (K, rows + 1, columns)."""
    sums = np.zeros((values.shape[0], values.shape[1] + 1, values.shape[2]), np.int32)
    _accumulate(values, sums)
    return sums


@compiled
def _accumulate(values: Any, sums: Any) -> None:
    for k in range(values.shape[0]):
        for row in range(values.shape[1]):
            for column in range(values.shape[2]):
                sums[k, row + 1, column] = sums[k, row, column] + values[k, row, column]


def _as_array(things: Sequence[Cylinder], name: str) -> FloatArray:
    array = np.array([[c.x, c.y, c.radius, c.height] for c in things], dtype=np.float64).reshape(-1, 4)
    if not (np.isfinite(array).all() and (array[:, 2:] > 0).all()):
        raise ValueError(f"{name}: expected finite places and sizes > 0, got {list(things)}")
    return array


def explain(
    evidence: PolarEvidence,
    places_m: npt.ArrayLike,
    *,
    before: Sequence[Cylinder] = (),
    how: Explanation = DEFAULT,
) -> list[Cylinder]:
    """The fewest plausible cylinders that explain the silhouettes of all views.

    Parameters
    ----------
    evidence
        What the views say.
    places_m
        Floor points (N, 2) in m where something may stand; see :func:`occlib.occlusion.standing_places`.
    before
        The last instant's cylinders, as a second start of the search.
    how
        Thresholds.

    Returns
    -------
    The cylinders, those that explain most first. The same evidence gives the same cylinders.

    Raises
    ------
    ValueError
        Places of another shape or not finite, or a cylinder of before that is none.
    """
    places, last = as_points(places_m, name="places_m"), _as_array(before, "before")
    if not np.isfinite(places).all():
        raise ValueError("places_m: expected finite numbers, got NaN or infinity")
    things = _solve(_search(evidence), places, last, how)
    return [Cylinder(*map(float, thing)) for thing in things]


def _search(evidence: PolarEvidence) -> _Search:
    weights, sums = evidence.weights, evidence.sums
    runs, found = room_for_runs(weights.shape[2]), np.empty(3)
    return _Search(
        evidence.views, evidence.sizes, weights, sums, evidence.seen_sums, weights.copy(), sums.copy(), runs, found
    )


def standing_points(evidence: PolarEvidence, things: Sequence[Cylinder], *, how: Explanation = DEFAULT) -> FloatArray:
    """Where on the floor each object stands.

    The cylinder that explains most is one of many that explain nearly as much, above all where only one view sees the object: a
    little farther and lower looks the same. Its point is the mean over those within 4 cm along the sight-lines of the two nearest views, with weights
    ``exp((gain / largest - 1) / 0.02)``, other objects left as they are.

    A body leans, and its feet are where its legs are: its point is the one that agrees best with its axis ``p`` and with
    the bearing ``a_k`` halfway between its feet in each view,

        argmin |x - p|^2 + sum over views of 4 s_k^2 (n_k . (x - c_k))^2,    n_k = (-sin a_k, cos a_k)

    where ``c_k`` is the camera's station and ``s_k`` the share of two legs that it shows, other objects left out; none, if it shows
    far more than legs. It lies within 0.15 m of the axis.

    Parameters
    ----------
    evidence
        What the views say.
    things
        What :func:`explain` found in it.
    how
        Thresholds, of which the cost counts.

    Returns
    -------
    Floor points (N, 2) in m.

    Raises
    ------
    ValueError
        A place or size that is not finite, or a size that is not positive.
    """
    array = _as_array(things, "things")
    points = array[:, :2].copy()
    if len(array):
        _stand(_search(evidence), array, how.cost, points)
    return points


def occlusion_state(evidence: PolarEvidence, things: Sequence[Cylinder]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """How much of each object nearer objects hide from each camera, from geometry.

    Returns
    -------
    fractions
        (N, K): 0 plain, 1 entirely hidden; NaN where the object lies outside the picture.
    by
        (N, K): index of the object that hides most of it, -1 if none does.

    Raises
    ------
    ValueError
        A place or size that is not finite, or a size that is not positive.
    """
    array = _as_array(things, "things")
    fractions = np.zeros((len(array), len(evidence.views)))
    by = np.full(fractions.shape, -1, np.int64)
    if len(array):
        _hidden(evidence.views, evidence.sizes, evidence.seen_sums, array, fractions, by)
    return fractions, by
