"""Explaining away: the fewest upright objects of plausible size that explain all silhouettes (section 5, beyond AND).

AND asks of each cell of the floor whether every view *could* have an object there. The shadows of n objects from two cameras
then cross in up to n (n - 1) / 2 places where nothing stands. Here the question is turned round: which objects, put on the floor, would
have cast the silhouettes that the cameras see? A ghost explains nothing that the real objects do not explain already, so it
is never needed; an object that one view hides is, because the other view's silhouette would stay unexplained.

An object is an upright cylinder: place, radius, height. In a polar view (:class:`occlib.explaining.evidence.PolarWarp`: a column
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
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import as_points
from occlib.base.kernels import compiled
from occlib.explaining.cylinders import (
    PERSON_M,
    Cylinder,
    _as_array,
    _column,
    _edges,
    _foot,
    _limbs,
    _span,
    _top,
    cover,
    gain,
    plausible,
    room_for_runs,
)
from occlib.explaining.evidence import PolarEvidence

RADII = np.array([0.06, 0.085, 0.12, 0.16, 0.21, 0.28, 0.36])


HEIGHTS = np.array([0.04, 0.06, 0.09, 0.13, 0.18, 0.24, 0.32, 0.42, 0.55, 0.72, 0.95, 1.2, 1.45, 1.7, 1.9])
"""Sizes tried at first, in m; the best are then refined freely between the limits of :func:`plausible`."""


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
        Floor points (N, 2) in m where something may stand; see :func:`occlib.explaining.explainer.standing_places`.
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
