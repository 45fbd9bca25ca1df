"""Explaining away: the fewest upright objects of plausible size that explain all silhouettes (section 5, beyond AND).

AND asks of each cell of the floor whether every view *could* have an object there. The shadows of n objects from two
cameras then cross in up to n (n - 1) / 2 places where nothing stands. Here the question is turned round: which objects,
put on the floor, would have cast the silhouettes that the cameras see? A ghost explains nothing that the real objects
do not explain already, so it is never needed; an object that one view hides is, because the other view's silhouette
would stay unexplained.

An object is an upright prism, and :mod:`occlib.explaining.objective` says what a set of them is worth. It is
maximised as marked point processes are (Utasi and Benedek 2011, doi:10.1109/CVPR.2011.5995699), but greedily:

1. :func:`occlib.explaining.candidates.candidates` weighs cylinders of every place and radius at the best of some heights;
2. the best candidate is refined and added, again and again, as long as one pays for itself (``_fill_up``);
3. each prism is refined beside the others, then those are dropped that the others explain as well (``_settle``);
4. other shapes are tried where a cylinder explains badly, and one shape for what lies close together
   (:mod:`occlib.explaining.reshaping`): the simplest that explains wins;
5. where one wide prism still explains its silhouettes badly, others are tried in its place (``_replaced``).

The objects of the previous instant are a second start of the search, and stay unless a fresh one is clearly better.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import as_points
from occlib.base.kernels import compiled
from occlib.explaining.candidates import FEW_RADII, RADII, candidates
from occlib.explaining.evidence import PolarEvidence
from occlib.explaining.objective import (
    ADD,
    NOBODY,
    TAKE,
    gain,
    left_over,
    objective,
    put,
    put_all,
    uncovered,
    workspace,
)
from occlib.explaining.prisms import Prism, as_array, prism_at
from occlib.explaining.refining import COARSE_STEP_M, DEFAULT, FINE_STEP_M, RISE, ExplainSettings, refined, stands_alone
from occlib.explaining.reshaping import STILL_WELL_SHAPED, WELL_SHAPED, reshaped

NONE = np.int64(0)
"""No prism yet: typed, as the loops are compiled anew for each plain number."""

RETRY = 1e-9
"""A candidate whose value fell by more than this, in samples, since it was last weighed goes back into the queue."""

WELL_EXPLAINED, SPLIT_RADIUS_M = 0.8, 0.12
"""A prism of a net share below the first and a radius in m above the second may stand for two objects abreast."""

REPLACED, REPLACEMENTS, REPLACEMENT_SPACING_M = 4, 6, 0.3
"""At most so many prisms are replaced on trial, each by up to so many others, so far apart in m."""

GROWN, FADE = 1.15, 0.98
"""No fresh search is made either if the share left has grown by no more than the first factor since the last one; what the last
one left fades by the second at every instant, so that after seven a fresh one is made."""


@compiled
def _fill_up(work: Any, tried: Any, values: Any, prisms: Any, count: int, settings: Any) -> int:
    """Add the candidate that explains most of what is left, again and again; returns the new count.

    ``values`` are what the candidates tried explained at first. Now they explain no more, so few are weighed anew.
    """
    cover, bound = uncovered(work), values.copy()
    put_all(work, cover, prisms, count, NOBODY, 0.0, ADD)
    while count < len(prisms) and len(bound) and work.spent[0] < settings.budget:
        best = bound.argmax()
        if bound[best] <= 0:
            break
        candidate = prism_at(tried, best)
        value = gain(work, cover.sums, candidate, settings.cost).value
        if value < bound[best] - RETRY:
            bound[best] = value
            continue
        bound[best] = -1.0
        prism = refined(work, cover.sums, candidate, settings.cost, COARSE_STEP_M)
        if stands_alone(work, prisms, count, NOBODY, prism, settings):
            prisms[count] = prism
            count += 1
            put(work, cover, prism, 0.0, ADD)
    return count


@compiled
def _settle(work: Any, prisms: Any, count: int, settings: Any, step: float) -> int:
    """Refine each prism beside the others, then drop, the weakest first, those that the others explain as well."""
    cover = uncovered(work)
    put_all(work, cover, prisms, count, NOBODY, 0.0, ADD)
    for k in range(count):
        put(work, cover, prism_at(prisms, k), 0.0, TAKE)
        prisms[k] = refined(work, cover.sums, prism_at(prisms, k), settings.cost, step)
        put(work, cover, prism_at(prisms, k), 0.0, ADD)
    return _without_needless(work, cover, prisms, count, settings)


@compiled
def _in_other_shapes(work: Any, prisms: Any, count: int, settings: Any, well: float) -> int:
    """Give them other shapes (:func:`reshaped`), then drop what the others explain as well; returns the new count."""
    count = reshaped(work, prisms, count, settings, well)
    cover = uncovered(work)
    put_all(work, cover, prisms, count, NOBODY, 0.0, ADD)
    return _without_needless(work, cover, prisms, count, settings)


@compiled
def _without_needless(work: Any, cover: Any, prisms: Any, count: int, settings: Any) -> int:
    """Drop, the weakest first, the prisms that the others explain as well, also from their cover; returns the new count."""
    while count:
        worst, least = -1, np.inf
        for k in range(count):
            prism = prism_at(prisms, k)
            put(work, cover, prism, 0.0, TAKE)
            value = gain(work, cover.sums, prism, settings.cost).value
            put(work, cover, prism, 0.0, ADD)
            if value < least and (value <= 0 or not stands_alone(work, prisms, count, k, prism, settings)):
                worst, least = k, value
        if worst < 0:
            break
        put(work, cover, prism_at(prisms, worst), 0.0, TAKE)
        for j in range(worst, count - 1):
            prisms[j] = prisms[j + 1]
        count -= 1
    return count


@compiled
def _continued(work: Any, places: Any, prisms: Any, count: int, settings: Any) -> Any:
    """The previous objects, refined, and others for what they leave: count, objective, share of the foreground left over."""
    count = _settle(work, prisms, count, settings, FINE_STEP_M)
    cover = uncovered(work)
    put_all(work, cover, prisms, count, NOBODY, settings.margin_m, ADD)
    tried, values = candidates(work, cover.sums, places, settings.cost, settings.budget, FEW_RADII)
    known = count
    count = _fill_up(work, tried, values, prisms, count, settings)
    if count > known:
        count = _settle(work, prisms, count, settings, COARSE_STEP_M)
    count = _in_other_shapes(work, prisms, count, settings, STILL_WELL_SHAPED)
    value = objective(work, prisms, count, settings.cost)
    cover = uncovered(work)
    put_all(work, cover, prisms, count, NOBODY, settings.margin_m, ADD)
    return count, value, left_over(work, cover)


@compiled
def _replaced(work: Any, tried: Any, best: Any, count: int, total: float, chosen: int, settings: Any) -> Any:
    """The prisms with another one first in the place of one chosen, if that explains more; else as they are."""
    cover = uncovered(work)
    put_all(work, cover, best, count, chosen, 0.0, ADD)
    values = np.empty(len(tried))
    for i in range(len(tried)):
        values[i] = gain(work, cover.sums, prism_at(tried, i), settings.cost).value
    free = values.copy()
    last = prism_at(best, chosen)
    for _ in range(REPLACEMENTS):
        for i in range(len(tried)):
            candidate = prism_at(tried, i)
            if np.hypot(candidate.x - last.x, candidate.y - last.y) < REPLACEMENT_SPACING_M:
                free[i] = -1.0
        first = free.argmax() if len(free) else 0
        if len(free) == 0 or free[first] <= 0 or work.spent[0] >= settings.budget:
            break
        last = prism_at(tried, first)
        prisms, n = np.zeros_like(best), 0
        for j in range(count):
            if j != chosen:
                prisms[n] = best[j]
                n += 1
        prisms[n] = last
        n = _fill_up(work, tried, values, prisms, n + 1, settings)
        n = _settle(work, prisms, n, settings, COARSE_STEP_M)
        value = objective(work, prisms, n, settings.cost)
        if value > total + RISE:
            n = _in_other_shapes(work, prisms, n, settings, WELL_SHAPED)
            return prisms, n, objective(work, prisms, n, settings.cost)
    return best, count, total


@compiled
def _solve(work: Any, places: Any, previous: Any, expected: float, settings: Any) -> Any:
    """The prisms, float64 (N, 10), and what they leave: the previous ones continued or a fresh search, whichever explains more.

    ``expected`` is the share of the foreground that may be left before a fresh search is made.
    """
    best, n, total = np.zeros((settings.max_objects, previous.shape[1])), 0, 0.0
    if len(previous):
        n = min(len(previous), settings.max_objects)
        best[:n] = previous[:n]
        n, value, left = _continued(work, places, best, n, settings)
        total = value * (1 + settings.keep)
        if left <= expected or work.spent[0] >= settings.budget:
            return best[:n], left
    tried, values = candidates(work, work.sums, places, settings.cost, settings.budget, RADII)
    prisms = np.zeros_like(best)
    count = _settle(work, prisms, _fill_up(work, tried, values, prisms, NONE, settings), settings, COARSE_STEP_M)
    count = _in_other_shapes(work, prisms, count, settings, WELL_SHAPED)
    value = objective(work, prisms, count, settings.cost)
    if value > total:
        best, n, total = prisms, count, value
    for attempt in range(REPLACED):
        chosen = -1
        for k in range(attempt, n):
            prism = prism_at(best, k)
            if gain(work, work.sums, prism, settings.cost).net_share < WELL_EXPLAINED and prism.radius > SPLIT_RADIUS_M:
                chosen = k
                break
        if chosen < 0 or work.spent[0] >= settings.budget:
            break
        best, n, total = _replaced(work, tried, best, n, total, chosen, settings)
    # once more among what is left: what is small was outweighed in its place by what is not there
    n, _, left = _continued(work, places, best, n, settings)
    return best[:n], left


class Explanation(NamedTuple):
    """What explains an instant.

    Parameters
    ----------
    prisms
        In no order.
    left
        Share of the foreground that the last fresh search left unexplained, 0 to 1; it fades from instant to instant.
    complete
        Whether the search came to its end within its budget; else this is the best found so far.
    """

    prisms: list[Prism]
    left: float = 0.0
    complete: bool = True


def explain(
    evidence: PolarEvidence,
    places_m: npt.ArrayLike,
    *,
    previous: Explanation | None = None,
    gloss: Sequence[float] | None = None,
    settings: ExplainSettings = DEFAULT,
) -> Explanation:
    """The fewest plausible prisms that explain the silhouettes of all views.

    Parameters
    ----------
    evidence
        What the views say.
    places_m
        Floor points (N, 2) in m where something may stand; see :func:`occlib.explaining.explainer.standing_places`.
    previous
        What explained the previous instant, as a second start of the search.
    gloss
        For each view how much of an object the floor mirrors, 0 to 1; see :func:`occlib.explaining.mirror.mirrored_share`.
    settings
        What counts as an object.

    Returns
    -------
    The prisms, and what they leave. The same evidence gives the same prisms.

    Raises
    ------
    ValueError
        Places of another shape or not finite, a previous prism whose place is not finite or whose size not positive,
        or a setting that is negative or not finite.

    Examples
    --------
    Two cameras see the silhouette of a cylinder, 0.5 m high, and background all around it:

    >>> from occlib.explaining import PolarWarp, silhouette
    >>> from occlib.geometry import Rig
    >>> from occlib.recordings import LAB
    >>> rig, drum, views = Rig.load(LAB / "robot" / "rig.yaml"), Prism(0.2, 0.1, 0.2, 0.5), []
    >>> for warp in (PolarWarp(rig[name], rig.floor) for name in ("left", "right")):
    ...     weights, (rows, columns) = np.full(warp.shape, -150), warp.shape
    ...     first, low, high = silhouette(warp.parameters, columns, rows, drum)
    ...     for column, (top, base) in enumerate(zip(low, high, strict=True), start=first):
    ...         weights[top:base, column] = 255
    ...     views.append((warp.parameters, weights * warp.visible, warp.visible))
    >>> (found,) = explain(PolarEvidence.of(views), [[0.0, 0.0], [0.2, 0.16]]).prisms
    >>> [round(number, 1) for number in found[:4]]
    [0.2, 0.1, 0.2, 0.5]
    """
    places, start = as_points(places_m, name="places_m"), as_array(previous.prisms if previous else [], "previous")
    if not np.isfinite(places).all():
        raise ValueError("places_m: expected finite numbers, got NaN or infinity")
    if gloss is not None and not (
        np.shape(gloss) == (len(evidence.views),) and (np.abs(np.asarray(gloss) - 0.5) <= 0.5).all()
    ):
        raise ValueError(f"gloss: expected {len(evidence.views)} shares from 0 to 1, got {gloss}")
    for name, value in settings._asdict().items():
        if not 0 <= value < np.inf:
            raise ValueError(f"settings.{name}: expected a finite number of 0 or more, got {value}")
    # an int where the loops were compiled for a float would have them compiled anew
    typed = ExplainSettings._make(type(usual)(value) for usual, value in zip(DEFAULT, settings, strict=True))
    work, expected = (
        workspace(evidence, gloss),
        max(settings.leftover_share, GROWN * previous.left if previous else 0.0),
    )
    found, left = _solve(work, places, start, float(expected), typed)
    complete = bool(work.spent[0] < settings.budget)
    if previous is not None and left <= expected:
        left = FADE * previous.left  # so that a fresh search is made now and then
    return Explanation([Prism(*map(float, row)) for row in found], float(left), complete)
