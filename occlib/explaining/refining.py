"""One prism at a time: what counts as an object, how it is refined, and whether it stands for itself."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from occlib.base.kernels import compiled
from occlib.explaining.candidates import HEIGHTS
from occlib.explaining.evidence import view_at
from occlib.explaining.objective import ADD, TAKE, TINY, abreast, gain, put, supported
from occlib.explaining.prisms import ROUND, Prism, bulk_m, is_body, is_table, plausible, prism_at, resized

COARSE_STEP_M, FINE_STEP_M, LEAST_STEP_M = 0.06, 0.03, 0.004
"""First step in m of refining a candidate (nearly the spacing of the places) or a previous object, and the step below
which refining ends."""

RADIUS_STEP, HEIGHT_STEP, MIN_HEIGHT_STEP = 0.5, 1.67, 0.33
"""Steps of radius and height, over that of the place: of the height so much per m of height, but at least the last."""

ROUNDS = 14
"""A refinement ends after so many rounds; with steps halved when nothing improves, it mostly ends before."""

RISE = 1e-6
"""A value must rise by more than this, in samples: what rises less may be rounding, and the search would not end."""


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
    support
        Share of an object's silhouette that must be foreground in every view that sees it, 0 to 1.
    spare
        Share of the views, rounded down, that may miss an object, but two must show it: it is looked for where all others do.
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
    reshape
        Another shape must explain this share more to take a simpler one's place.
    merge
        One object in the place of several that lie close together must explain this share more than they do.
    divide
        Two objects in the place of a long one must explain this share more than it does.
    keep
        The previous objects stay unless a fresh search explains this share more.
    leftover_share
        No fresh search is made if the previous objects, with those added, leave at most this share of the foreground.
    grid_m
        Spacing of the places tried, in m.
    max_objects
        No more objects than so many.
    budget
        A search ends with the best found so far when it has weighed so many columns of silhouettes.
    """

    cost: float = 0.08
    background: float = 0.6
    least_area_m2: float = 0.012
    least_share: float = 0.15
    fragment_share: float = 0.2
    support: float = 0.18
    spare: float = 0.25
    margin_m: float = 0.05
    margin_share: float = 0.04
    fragment_margin_share: float = 0.12
    low_share: float = 0.6
    beside_m: float = 0.3
    beside_share: float = 0.5
    person_low_m: float = 0.5
    person_tall_m: float = 0.4
    reshape: float = 0.03
    merge: float = 0.02
    divide: float = 0.02
    keep: float = 0.1
    leftover_share: float = 0.1
    grid_m: float = 0.08
    max_objects: int = 32
    budget: int = 20_000_000


DEFAULT = ExplainSettings()
"""Chosen on the rendered recordings and on ufes-lab."""


@compiled
def _moved(prism: Any, field: int, by: float) -> Any:
    """The prism with one of its numbers changed, in the order of :func:`_steps`."""
    return Prism(
        prism.x + by if field == 0 else prism.x,
        prism.y + by if field == 1 else prism.y,
        prism.radius + by if field == 2 else prism.radius,
        prism.height + by if field == 3 else prism.height,
        prism.outline,
        prism.heading + by if field == 4 else prism.heading,
        # the length changes alone: the width stays
        prism.ratio + by if field == 5 else (
            prism.ratio * prism.radius / (prism.radius + by)
            if field == 2 and prism.outline != ROUND and prism.radius + by > 0.0
            else prism.ratio
        ),
        prism.waist + by if field == 6 else prism.waist,
        prism.upper + by if field == 7 else prism.upper,
        min(max(prism.lean + by, -1.0), 1.0) if field == 8 else prism.lean,
    )  # fmt: skip


@compiled
def _steps(prism: Any) -> Any:
    """Step of each number of a prism over the step of its place, in m; 0 for what a prism of its shape does not have."""
    angular = prism.outline != ROUND
    narrower = prism.waist < 1.0 and not is_table(prism)
    return (
        1.0,
        1.0,
        RADIUS_STEP,
        max(MIN_HEIGHT_STEP, HEIGHT_STEP * prism.height),
        0.7 / prism.radius if angular or prism.lean != 0.0 else 0.0,
        RADIUS_STEP / prism.radius if angular else 0.0,
        1.0 / prism.height if prism.waist < 1.0 else 0.0,
        RADIUS_STEP / prism.radius if narrower else 0.0,
        1.0 / prism.radius if narrower and (angular or prism.lean != 0.0) else 0.0,
    )


@compiled
def _upright(prism: Any) -> Any:
    """The same prism with a width no larger than its length."""
    if prism.ratio <= 1.0 or prism.outline == ROUND:
        return prism
    return Prism(
        prism.x, prism.y, prism.radius * prism.ratio, prism.height, prism.outline,
        prism.heading + np.pi / 2, 1.0 / prism.ratio, prism.waist, prism.upper, 0.0,
    )  # fmt: skip


@compiled
def refined(work: Any, sums: Any, prism: Any, cost: float, step: float) -> Any:
    """The prism moved and sized to where it explains most: coordinate ascent from ``step`` m to ever smaller steps."""
    best = gain(work, sums, prism, cost).value
    # the height has far optima: a person is cut at the belt, or goes on in one that stands behind
    for height in HEIGHTS if step > FINE_STEP_M else HEIGHTS[:0]:
        other = resized(prism, prism.x, prism.y, prism.radius, height)
        if plausible(other):
            value = gain(work, sums, other, cost).value
            if value > best + RISE:
                best, prism = value, other
    scales = _steps(prism)
    for _ in range(ROUNDS):
        improved = False
        for field in range(len(scales)):
            if scales[field] == 0.0:
                continue
            for sign in (1.0, -1.0):
                other = _upright(_moved(prism, field, sign * step * scales[field]))
                if plausible(other):
                    value = gain(work, sums, other, cost).value
                    if value > best + RISE:
                        best, prism, improved = value, other, True
        for k in range(len(work.views)):  # along the sight-line of one view: farther and lower looks the same to it
            view = view_at(work.views, k)
            dx, dy = prism.x - view.x, prism.y - view.y
            distance = max(np.hypot(dx, dy), TINY)
            for sign in (1.0, -1.0):
                other = resized(
                    prism,
                    prism.x + sign * step * dx / distance,
                    prism.y + sign * step * dy / distance,
                    prism.radius,
                    prism.height - sign * step * (view.height - prism.height) / distance,
                )
                if plausible(other):
                    value = gain(work, sums, other, cost).value
                    if value > best + RISE:
                        best, prism, improved = value, other, True
        if not improved:
            step /= 2
            if step < LEAST_STEP_M:
                break
    return prism


@compiled
def stands_alone(work: Any, prisms: Any, count: int, left_out: int, prism: Any, settings: Any) -> bool:
    """Whether enough of a prism is explained by none of the others, but for the one left out (which may be itself).

    Nothing right beside a person stands alone, and a fragment must stand clear of all that is much taller.
    """
    if not supported(work, prism, settings.support, settings.spare):
        return False
    fragment, beside = False, np.zeros(len(prisms), np.bool_)
    for j in range(count):
        if j != left_out:
            other = prism_at(prisms, j)
            apart, low = np.hypot(other.x - prism.x, other.y - prism.y), _is_low(prism, other, settings)
            if is_body(other) and apart < (settings.person_low_m if low else settings.person_tall_m):
                return False
            fragment = fragment or (low and apart < settings.beside_m + settings.beside_share * bulk_m(other))
            beside[j] = abreast(work, prism, other, settings.margin_m + settings.fragment_margin_share * bulk_m(other))
    own = _alone(work, prisms, count, beside, prism, settings.margin_m, settings.margin_share, 0.0, 0.0)
    if own.explained_m2 < settings.least_area_m2 or own.best_share < settings.least_share:
        return False
    if fragment:
        share, wide = settings.margin_share, settings.fragment_margin_share
        own = _alone(work, prisms, count, beside, prism, settings.margin_m, share, wide, settings.low_share)
    return own.explained_m2 >= settings.least_area_m2 and (not fragment or own.best_share >= settings.fragment_share)


@compiled
def _alone(
    work: Any, prisms: Any, count: int, beside: Any, prism: Any, margin: float, share: float, wide: float, low: float
) -> Any:
    """What a prism explains beyond those beside it, enlarged by a margin and a share of their height.

    The share is ``wide`` for those of which the prism is lower than ``low`` times the height."""
    cover = work.scratch
    _put_beside(work, cover, prisms, count, beside, prism, margin, share, wide, low, ADD)
    own = gain(work, cover.sums, prism, 0.0)
    _put_beside(work, cover, prisms, count, beside, prism, margin, share, wide, low, TAKE)
    return own


@compiled
def _put_beside(
    work: Any, cover: Any, prisms: Any, count: int, beside: Any, prism: Any,
    margin: float, share: float, wide: float, low: float, sign: int,
) -> None:  # fmt: skip
    for j in range(count):
        if beside[j]:
            other = prism_at(prisms, j)
            of_height = wide if prism.height < low * bulk_m(other) else share
            put(work, cover, other, margin + of_height * bulk_m(other), sign)


@compiled
def _is_low(prism: Any, other: Any, settings: Any) -> bool:
    """Whether a prism is much lower than another."""
    return prism.height < settings.low_share * bulk_m(other)
