"""Explaining away: the fewest upright objects of plausible size that explain all silhouettes (section 5, beyond AND).

AND asks of each cell of the floor whether every view *could* have an object there. The shadows of n objects from two
cameras then cross in up to n (n - 1) / 2 places where nothing stands. Here the question is turned round: which objects,
put on the floor, would have cast the silhouettes that the cameras see? A ghost explains nothing that the real objects
do not explain already, so it is never needed; an object that one view hides is, because the other view's silhouette
would stay unexplained.

An object is an upright cylinder, and :mod:`occlib.explaining.objective` says what a set of them is worth. It is
maximised as marked point processes are (Utasi and Benedek 2011, doi:10.1109/CVPR.2011.5995699), but greedily:

1. :func:`occlib.explaining.candidates.candidates` weighs every place and radius at the best of some heights;
2. the best candidate is refined and added, again and again, as long as one pays for itself (``_fill_up``);
3. each cylinder is refined beside the others, then those are dropped that the others explain as well (``_settle``);
4. where one wide cylinder explains its silhouettes badly, others are tried in its place (``_replaced``).

The objects of the previous instant are a second start of the search, and stay unless a fresh one is clearly better.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import as_points
from occlib.base.kernels import compiled
from occlib.explaining.candidates import HEIGHTS, candidates
from occlib.explaining.cylinders import PERSON_M, Cylinder, as_array, cylinder_at, plausible
from occlib.explaining.evidence import PolarEvidence, view_at
from occlib.explaining.objective import TINY, cover, cover_all, gain, objective, workspace

COARSE_STEP_M, FINE_STEP_M, LEAST_STEP_M = 0.06, 0.03, 0.004
"""First step in m of refining a candidate (nearly the spacing of the places) or a previous object, and the step below
which refining ends."""

RADIUS_STEP, HEIGHT_STEP, MIN_HEIGHT_STEP = 0.5, 1.67, 0.33
"""Steps of radius and height, over that of the place: of the height so much per m of height, but at least the last."""

ROUNDS = 14
"""A refinement ends after so many rounds; with steps halved when nothing improves, it mostly ends before."""

RISE = 1e-6
"""A value must rise by more than this, in samples: what rises less may be rounding, and the search would not end."""

RETRY = 1e-9
"""A candidate whose value fell by more than this, in samples, since it was last weighed goes back into the queue."""

WELL_EXPLAINED, SPLIT_RADIUS_M = 0.8, 0.12
"""A cylinder of a net share below the first and a radius in m above the second may stand for two objects abreast."""

REPLACED, REPLACEMENTS, REPLACEMENT_SPACING_M = 4, 6, 0.3
"""At most so many cylinders are replaced on trial, each by up to so many others, so far apart in m."""


class ExplainSettings(NamedTuple):
    """Settings of the search: what counts as an object.

    Parameters
    ----------
    cost
        Share of its own silhouette, 0 to 1, that an object must explain before it counts: the price of one object more.
    background
        Weight of a covered background sample against a covered foreground sample, 0 to 1.
    least_area_m2
        An object that explains less silhouette, in m2 at its own distance, is noise.
    least_share
        Share of its silhouette, in its best view, that no other object may explain, 0 to 1.
    fragment_share
        The same for a fragment: something low beside something much taller, such as an arm or a bag.
    margin_m, margin_share
        What an object explains is enlarged by ``margin_m + margin_share * height``, in m, when others are judged.
    fragment_margin_share
        The same share when fragments are judged.
    low_share
        An object lower than this share of another's height counts as low beside it, 0 to 1.
    beside_m, beside_share
        What is low within ``beside_m + beside_share * height``, in m, of a taller one's axis is a fragment.
    person_low_m, person_tall_m
        Within ``person_low_m`` of a person's axis, in m, what is low beside it is part of the person, and within
        ``person_tall_m`` all else is: arms, legs, bags.
    keep
        The previous objects stay unless a fresh search explains this share more.
    leftover_share
        No fresh search is made if the previous objects, with those added, leave at most this share of the foreground.
    grid_m
        Spacing of the places tried, in m.
    max_objects
        No more objects than so many.
    """

    cost: float = 0.15
    background: float = 0.6
    least_area_m2: float = 0.006
    least_share: float = 0.15
    fragment_share: float = 0.3
    margin_m: float = 0.05
    margin_share: float = 0.04
    fragment_margin_share: float = 0.12
    low_share: float = 0.6
    beside_m: float = 0.3
    beside_share: float = 0.5
    person_low_m: float = 0.5
    person_tall_m: float = 0.3
    keep: float = 0.1
    leftover_share: float = 0.1
    grid_m: float = 0.08
    max_objects: int = 32


DEFAULT = ExplainSettings()
"""Chosen on the rendered recordings and on ufes-lab."""


@compiled
def _moved(cylinder: Any, field: int, by: float) -> Any:
    """The cylinder with one of its numbers changed: 0 is x, 1 y, 2 the radius, 3 the height."""
    return Cylinder(
        cylinder.x + by if field == 0 else cylinder.x,
        cylinder.y + by if field == 1 else cylinder.y,
        cylinder.radius + by if field == 2 else cylinder.radius,
        cylinder.height + by if field == 3 else cylinder.height,
    )


@compiled
def _refined(work: Any, sums: Any, cylinder: Any, cost: float, step: float) -> Any:
    """The cylinder moved and sized to where it explains most: coordinate ascent from ``step`` m to ever smaller steps."""
    best = gain(work, sums, cylinder, cost).value
    # the height has far optima: a person is cut at the belt, or goes on in one that stands behind
    for height in HEIGHTS if step > FINE_STEP_M else HEIGHTS[:0]:
        if plausible(cylinder.radius, height):
            other = Cylinder(cylinder.x, cylinder.y, cylinder.radius, height)
            value = gain(work, sums, other, cost).value
            if value > best + RISE:
                best, cylinder = value, other
    scales = (1.0, 1.0, RADIUS_STEP, max(MIN_HEIGHT_STEP, HEIGHT_STEP * cylinder.height))
    for _ in range(ROUNDS):
        improved = False
        for field in range(len(scales)):
            for sign in (1.0, -1.0):
                other = _moved(cylinder, field, sign * step * scales[field])
                if plausible(other.radius, other.height):
                    value = gain(work, sums, other, cost).value
                    if value > best + RISE:
                        best, cylinder, improved = value, other, True
        for k in range(len(work.views)):  # along the sight-line of one view: farther and lower looks the same to it
            view = view_at(work.views, k)
            dx, dy = cylinder.x - view.x, cylinder.y - view.y
            distance = max(np.hypot(dx, dy), TINY)
            for sign in (1.0, -1.0):
                other = Cylinder(
                    cylinder.x + sign * step * dx / distance,
                    cylinder.y + sign * step * dy / distance,
                    cylinder.radius,
                    cylinder.height - sign * step * (view.height - cylinder.height) / distance,
                )
                if plausible(other.radius, other.height):
                    value = gain(work, sums, other, cost).value
                    if value > best + RISE:
                        best, cylinder, improved = value, other, True
        if not improved:
            step /= 2
            if step < LEAST_STEP_M:
                break
    return cylinder


@compiled
def _stands_alone(work: Any, cylinders: Any, count: int, left_out: int, cylinder: Any, settings: Any) -> bool:
    """Whether enough of a cylinder is explained by none of the others, but for the one left out (which may be itself).

    Nothing right beside a person stands alone, and a fragment must stand clear of all that is much taller.
    """
    work.left[:], work.left_sums[:] = work.weights, work.sums
    fragment = False
    for j in range(count):
        if j != left_out:
            other = cylinder_at(cylinders, j)
            cover(work, work.left, work.left_sums, other, settings.margin_m + settings.margin_share * other.height)
            apart, low = np.hypot(other.x - cylinder.x, other.y - cylinder.y), _is_low(cylinder, other, settings)
            if other.height >= PERSON_M and apart < (settings.person_low_m if low else settings.person_tall_m):
                return False
            fragment = fragment or (low and apart < settings.beside_m + settings.beside_share * other.height)
    own = gain(work, work.left_sums, cylinder, 0.0)
    if own.explained_m2 < settings.least_area_m2 or own.best_share < settings.least_share:
        return False
    if fragment:
        for j in range(count):
            other = cylinder_at(cylinders, j)
            if j != left_out and _is_low(cylinder, other, settings):
                margin = settings.margin_m + settings.fragment_margin_share * other.height
                cover(work, work.left, work.left_sums, other, margin)
        own = gain(work, work.left_sums, cylinder, 0.0)
    return own.explained_m2 >= settings.least_area_m2 and (not fragment or own.best_share >= settings.fragment_share)


@compiled
def _is_low(cylinder: Any, other: Any, settings: Any) -> bool:
    """Whether a cylinder is much lower than another."""
    return cylinder.height < settings.low_share * other.height


@compiled
def _fill_up(work: Any, tried: Any, values: Any, cylinders: Any, count: int, settings: Any) -> int:
    """Add the candidate that explains most of what is left, again and again; returns the new count.

    ``values`` are what the candidates tried explained at first. Now they explain no more, so few are weighed anew.
    """
    weights, sums, bound = work.weights.copy(), work.sums.copy(), values.copy()
    cover_all(work, weights, sums, cylinders, count, -1, 0.0)
    while count < len(cylinders) and len(bound):
        best = bound.argmax()
        if bound[best] <= 0:
            break
        candidate = cylinder_at(tried, best)
        value = gain(work, sums, candidate, settings.cost).value
        if value < bound[best] - RETRY:
            bound[best] = value
            continue
        bound[best] = -1.0
        cylinder = _refined(work, sums, candidate, settings.cost, COARSE_STEP_M)
        if _stands_alone(work, cylinders, count, -1, cylinder, settings):
            cylinders[count] = cylinder
            count += 1
            cover(work, weights, sums, cylinder, 0.0)
    return count


@compiled
def _settle(work: Any, cylinders: Any, count: int, settings: Any, step: float) -> int:
    """Refine each cylinder beside the others, then drop, the weakest first, those that the others explain as well."""
    weights, sums = work.weights.copy(), work.sums.copy()
    for k in range(count):
        cover_all(work, weights, sums, cylinders, count, k, 0.0)
        cylinders[k] = _refined(work, sums, cylinder_at(cylinders, k), settings.cost, step)
    while count:
        worst, least = -1, np.inf
        for k in range(count):
            cylinder = cylinder_at(cylinders, k)
            cover_all(work, weights, sums, cylinders, count, k, 0.0)
            value = gain(work, sums, cylinder, settings.cost).value
            if value < least and (value <= 0 or not _stands_alone(work, cylinders, count, k, cylinder, settings)):
                worst, least = k, value
        if worst < 0:
            break
        for j in range(worst, count - 1):
            cylinders[j] = cylinders[j + 1]
        count -= 1
    return count


@compiled
def _continued(work: Any, places: Any, cylinders: Any, count: int, settings: Any) -> Any:
    """The previous objects, refined, and others for what they leave: count, objective, whether little is left over."""
    count = _settle(work, cylinders, count, settings, FINE_STEP_M)
    cover_all(work, work.left, work.left_sums, cylinders, count, -1, settings.margin_m)
    tried, values = candidates(work, work.left_sums, places, settings.cost)
    known = count
    count = _fill_up(work, tried, values, cylinders, count, settings)
    if count > known:
        count = _settle(work, cylinders, count, settings, COARSE_STEP_M)
    value = objective(work, cylinders, count, settings.cost)
    cover_all(work, work.left, work.left_sums, cylinders, count, -1, settings.margin_m)
    leftover = np.maximum(work.left, 0).sum()
    return count, value, leftover <= settings.leftover_share * np.maximum(work.weights, 0).sum()


@compiled
def _replaced(work: Any, tried: Any, best: Any, count: int, total: float, chosen: int, settings: Any) -> Any:
    """The cylinders with another one first in the place of one chosen, if that explains more; else as they are."""
    weights, sums = work.weights.copy(), work.sums.copy()
    cover_all(work, weights, sums, best, count, chosen, 0.0)
    values = np.empty(len(tried))
    for i in range(len(tried)):
        values[i] = gain(work, sums, cylinder_at(tried, i), settings.cost).value
    free = values.copy()
    last = cylinder_at(best, chosen)
    for _ in range(REPLACEMENTS):
        for i in range(len(tried)):
            candidate = cylinder_at(tried, i)
            if np.hypot(candidate.x - last.x, candidate.y - last.y) < REPLACEMENT_SPACING_M:
                free[i] = -1.0
        first = free.argmax() if len(free) else 0
        if len(free) == 0 or free[first] <= 0:
            break
        last = cylinder_at(tried, first)
        cylinders, n = np.zeros_like(best), 0
        for j in range(count):
            if j != chosen:
                cylinders[n] = best[j]
                n += 1
        cylinders[n] = last
        n = _fill_up(work, tried, values, cylinders, n + 1, settings)
        n = _settle(work, cylinders, n, settings, COARSE_STEP_M)
        value = objective(work, cylinders, n, settings.cost)
        if value > total + RISE:
            return cylinders, n, value
    return best, count, total


@compiled
def _solve(work: Any, places: Any, previous: Any, settings: Any) -> Any:
    """The cylinders, float64 (N, 4): the previous ones continued or a fresh search, whichever explains more."""
    best, n, total = np.zeros((settings.max_objects, 4)), 0, 0.0
    if len(previous):
        n = min(len(previous), settings.max_objects)
        best[:n] = previous[:n]
        n, value, done = _continued(work, places, best, n, settings)
        total = value * (1 + settings.keep)
        if done:
            return best[:n]
    tried, values = candidates(work, work.sums, places, settings.cost)
    cylinders = np.zeros((settings.max_objects, 4))
    count = _settle(work, cylinders, _fill_up(work, tried, values, cylinders, 0, settings), settings, COARSE_STEP_M)
    value = objective(work, cylinders, count, settings.cost)
    if value > total:
        best, n, total = cylinders, count, value
    for attempt in range(REPLACED):
        chosen = -1
        for k in range(attempt, n):
            cylinder = cylinder_at(best, k)
            if (
                gain(work, work.sums, cylinder, settings.cost).net_share < WELL_EXPLAINED
                and cylinder.radius > SPLIT_RADIUS_M
            ):
                chosen = k
                break
        if chosen < 0:
            break
        best, n, total = _replaced(work, tried, best, n, total, chosen, settings)
    return best[:n]


def explain(
    evidence: PolarEvidence,
    places_m: npt.ArrayLike,
    *,
    previous: Sequence[Cylinder] = (),
    settings: ExplainSettings = DEFAULT,
) -> list[Cylinder]:
    """The fewest plausible cylinders that explain the silhouettes of all views.

    Parameters
    ----------
    evidence
        What the views say.
    places_m
        Floor points (N, 2) in m where something may stand; see :func:`occlib.explaining.explainer.standing_places`.
    previous
        The cylinders of the previous instant, as a second start of the search.
    settings
        What counts as an object.

    Returns
    -------
    The cylinders, those that explain most first. The same evidence gives the same cylinders.

    Raises
    ------
    ValueError
        Places of another shape or not finite, a previous cylinder whose place is not finite or whose size not positive,
        or a setting that is negative or not finite.

    Examples
    --------
    Two cameras see the silhouette of a box, 0.5 m high, and background all around it:

    >>> from occlib.explaining import PolarWarp, silhouette
    >>> from occlib.geometry import Rig
    >>> from occlib.recordings import LAB
    >>> rig, box, views = Rig.load(LAB / "robot" / "rig.yaml"), Cylinder(0.2, 0.1, 0.2, 0.5), []
    >>> for warp in (PolarWarp(rig[name], rig.floor) for name in ("left", "right")):
    ...     weights, (rows, columns) = np.full(warp.shape, -150), warp.shape
    ...     first, low, high = silhouette(warp.parameters, columns, rows, box)
    ...     for column, (top, base) in enumerate(zip(low, high, strict=True), start=first):
    ...         weights[top:base, column] = 255
    ...     views.append((warp.parameters, weights * warp.visible, warp.visible))
    >>> (found,) = explain(PolarEvidence.of(views), [[0.0, 0.0], [0.2, 0.16]])
    >>> [round(number, 1) for number in found]
    [0.2, 0.1, 0.2, 0.5]
    """
    places, start = as_points(places_m, name="places_m"), as_array(previous, "previous")
    if not np.isfinite(places).all():
        raise ValueError("places_m: expected finite numbers, got NaN or infinity")
    for name, value in settings._asdict().items():
        if not 0 <= value < np.inf:
            raise ValueError(f"settings.{name}: expected a finite number of 0 or more, got {value}")
    # an int where the loops were compiled for a float would have them compiled anew
    typed = ExplainSettings._make(type(usual)(value) for usual, value in zip(DEFAULT, settings, strict=True))
    return [Cylinder(*map(float, row)) for row in _solve(workspace(evidence), places, start, typed)]
