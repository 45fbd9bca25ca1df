"""Upright prisms: the shapes that objects are taken to have, and which sizes are plausible.

A prism stands on an outline, round or with corners (:data:`OUTLINES`), and may be narrower above its waist: a seated
person, a robot with a mast. A new outline is one entry of the table. :mod:`occlib.explaining.silhouettes` has what views show of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled

ROUND, BOX = 0, 1

OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "round": (),
    "box": ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)),
}
"""The outlines by name, in the order of their numbers: the corners of a convex polygon, anticlockwise, in units of half
its length and half its width; without corners it is a circle."""

_MOST = max(4, *(len(corners) for corners in OUTLINES.values()))
CORNERS = np.zeros((len(OUTLINES), _MOST, 2))
COUNTS = np.zeros(len(OUTLINES), np.int64)
for _number, _corners in enumerate(OUTLINES.values()):
    CORNERS[_number, : len(_corners)] = np.reshape(_corners, (-1, 2))
    COUNTS[_number] = len(_corners)
"""Their corners, float64 (outlines, corners, 2), and how many each has, as the compiled loops take them."""

PERSON_M = 1.4
"""Prisms of this height in m or more are treated as people: parts of the head and the legs need not be seen."""


# --- plausible sizes: neither a pole nor a sheet nor a wall
MIN_RADIUS_M, MIN_HEIGHT_M, MAX_HEIGHT_M = 0.05, 0.025, 2.0
"""Smallest radius and height, and greatest height, in m: from a toy on the floor to a tall person."""

SLIM_M, SLIM_PER_M = 0.03, 0.065
"""A prism's radius is at least ``SLIM_M + SLIM_PER_M * height``, else it is a pole: 12 cm for a person of 1.4 m."""

FLAT = 0.2
"""A round prism's height is at least this share of its radius, else it is a sheet on the floor."""

LOW_M, WIDE_M, WIDE_TALL_M, NARROWING = 0.7, 0.45, 0.22, 0.46
"""Greatest radius: ``WIDE_M`` (an armchair) for what is ``LOW_M`` high or lower; higher up it falls by ``NARROWING`` m
per m to ``WIDE_TALL_M`` (a person). What is wider is several objects side by side."""

BOX_LONG_M, BOX_THIN_M, BOX_RATIO = 0.85, 0.04, 0.3
"""Half the greatest length and half the least width of a box in m, and its least width over its length."""

MAST_M, MAST_HEIGHT_M = 0.07, 1.25
"""Above its waist something is a mast, no wider than this, half its width, and no higher, in m; or else somebody who sits."""

SEATED_M, SEATED_HIGH_M, TRUNK_M, SEAT_LOW, SEAT_HIGH = 1.05, 1.5, 0.09, 0.28, 0.6
"""Least and greatest height in m of somebody who sits, half the least width of the trunk in m, and the shares of the height
between which the waist lies: what is lower stands beside somebody."""

SEAT_M, SEAT_WIDE_M, SEAT_RATIO = 0.2, 0.5, 0.5
"""Half the least and greatest length, in m, of a chair with somebody's legs in front, and its least width over its length."""

TABLE_LOW_M, TABLE_HIGH_M, TABLE_M, TOP_LOW, TOP_HIGH = 0.3, 1.0, 0.25, 0.75, 0.97
"""Least and greatest height of a table in m, half its least length in m, and the shares of the height between which its top begins."""

WAIST_LOW, WAIST_HIGH, UPPER_THIN, UPPER_WIDE = 0.12, 0.85, 0.1, 0.75
"""A waist lies between these shares of the height, and what is above it is as narrow as these shares of the base."""


class Prism(NamedTuple):
    """An upright object.

    Parameters
    ----------
    x, y
        Where its axis meets the floor, in m.
    radius
        Of a round one; half the length of one with corners, in m.
    height
        In m.
    outline
        Number of its outline in :data:`OUTLINES`.
    heading
        Angle from the x axis to its length, in rad.
    ratio
        Its width over its length.
    waist
        Share of its height from which on it is narrower, 1 if nowhere.
    upper
        Size above the waist over the size below; 1 of a table, which shows the floor between its legs below the waist.
    lean
        Where the upper part stands along the heading: -1 flush with the back, 0 in the middle, 1 flush with the front.
    """

    x: float
    y: float
    radius: float
    height: float
    outline: float = ROUND
    heading: float = 0.0
    ratio: float = 1.0
    waist: float = 1.0
    upper: float = 1.0
    lean: float = 0.0

    @property
    def half_width(self) -> float:
        """Half its width in m."""
        return self.radius * self.ratio


FIELDS = len(Prism._fields)
"""Numbers of a prism: the columns of an array of prisms."""


@compiled
def is_person(prism: Any) -> bool:
    """Whether a prism is treated as a person who stands or walks."""
    return prism.height >= PERSON_M and prism.waist >= 1.0


@compiled
def is_body(prism: Any) -> bool:
    """Whether a prism may be somebody who stands, walks or sits: tall, and above the waist no mere mast."""
    above = prism.upper if prism.waist < 1.0 else 1.0
    return prism.height >= SEATED_M and prism.radius * above >= TRUNK_M


@compiled
def bulk_m(prism: Any) -> float:
    """The height in m up to which a prism is as wide as it is: a mast does not count."""
    return prism.height if prism.waist >= 1.0 or prism.upper >= 1.0 or is_body(prism) else prism.waist * prism.height


@compiled
def is_table(prism: Any) -> bool:
    """Whether a prism stands on legs, between which the floor may show."""
    return prism.waist < 1.0 and prism.upper >= 1.0


@compiled
def plausible_round(radius: float, height: float) -> bool:
    """Whether a cylinder of this size, in m, may stand on the floor: neither a pole nor a sheet nor a wall."""
    wide = WIDE_M if height <= LOW_M else max(WIDE_TALL_M, WIDE_M - NARROWING * (height - LOW_M))
    slim = SLIM_M + SLIM_PER_M * height
    flat = max(MIN_HEIGHT_M, FLAT * radius)
    return slim <= radius <= wide and radius >= MIN_RADIUS_M and flat <= height <= MAX_HEIGHT_M


@compiled
def plausible(prism: Any) -> bool:
    """Whether such a prism may stand on the floor."""
    low = prism.height
    if is_table(prism):
        if (
            prism.outline == ROUND
            or prism.radius < TABLE_M
            or not (TABLE_LOW_M <= prism.height <= TABLE_HIGH_M and TOP_LOW <= prism.waist <= TOP_HIGH)
        ):
            return False
    elif prism.waist < 1.0:
        low = prism.waist * prism.height
        if not (WAIST_LOW <= prism.waist <= WAIST_HIGH and UPPER_THIN <= prism.upper <= UPPER_WIDE):
            return False
        above = prism.radius * prism.upper
        mast = above <= MAST_M and prism.height <= MAST_HEIGHT_M
        sits = (
            is_body(prism)
            and prism.height <= SEATED_HIGH_M
            and SEAT_LOW <= prism.waist <= SEAT_HIGH
            and SEAT_M <= prism.radius <= SEAT_WIDE_M
            and prism.ratio >= SEAT_RATIO
        )
        if abs(prism.lean) > 1.0 or not (mast or sits):
            return False
    if prism.outline == ROUND:
        return plausible_round(prism.radius, low)
    thin = prism.radius * prism.ratio
    return (
        BOX_THIN_M <= thin
        and BOX_RATIO <= prism.ratio <= 1.0
        and prism.radius <= BOX_LONG_M
        and MIN_HEIGHT_M <= low <= MAX_HEIGHT_M
        and SLIM_M + SLIM_PER_M * low <= np.sqrt(thin * prism.radius)
        and (low <= LOW_M or thin <= max(WIDE_TALL_M, WIDE_M - NARROWING * (low - LOW_M)))
    )


@compiled
def prism_at(prisms: Any, i: int) -> Any:
    """Row ``i`` of an array of prisms, float64 (N, 10), as a :class:`Prism`."""
    return Prism(
        prisms[i, 0], prisms[i, 1], prisms[i, 2], prisms[i, 3], prisms[i, 4],
        prisms[i, 5], prisms[i, 6], prisms[i, 7], prisms[i, 8], prisms[i, 9],
    )  # fmt: skip


@compiled
def cylinder(x: float, y: float, radius: float, height: float) -> Any:
    """A round prism without a waist."""
    return Prism(x, y, radius, height, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0)


@compiled
def resized(prism: Any, x: float, y: float, radius: float, height: float) -> Any:
    """A prism of the same form elsewhere, of another size."""
    return Prism(x, y, radius, height, prism.outline, prism.heading, prism.ratio, prism.waist, prism.upper, prism.lean)


@compiled
def larger(prism: Any, margin: float) -> Any:
    """The prism, wider by a margin in m on all sides, and higher."""
    radius = prism.radius + margin
    return Prism(
        prism.x, prism.y, radius, prism.height + margin, prism.outline, prism.heading,
        (prism.radius * prism.ratio + margin) / radius,
        prism.waist, (prism.radius * prism.upper + margin) / radius if prism.waist < 1.0 else 1.0, prism.lean,
    )  # fmt: skip


@compiled
def upper_part(prism: Any) -> Any:
    """What stands above the waist, as a prism that reaches down to the floor."""
    away = prism.lean * (1.0 - prism.upper) * prism.radius
    return Prism(
        prism.x + away * np.cos(prism.heading), prism.y + away * np.sin(prism.heading), prism.radius * prism.upper,
        prism.height, prism.outline, prism.heading, prism.ratio, 1.0, 1.0, 0.0,
    )  # fmt: skip


@compiled
def reach(prism: Any) -> float:
    """Distance in m from the axis to the farthest point of the outline."""
    corners = COUNTS[int(prism.outline)]
    if corners == 0:
        return prism.radius
    farthest = 0.0
    for i in range(corners):
        u, v = CORNERS[int(prism.outline), i, 0], CORNERS[int(prism.outline), i, 1] * prism.ratio
        farthest = max(farthest, u * u + v * v)
    return prism.radius * np.sqrt(farthest)


def outline_points(prism: Prism, *, around: int = 24) -> FloatArray:
    """Corners of a prism's outline on the floor, (N, 2) in m; of a round one so many points around it."""
    corners = list(OUTLINES.values())[int(prism.outline)]
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
    unit = np.array(corners) if corners else np.column_stack([np.cos(turn), np.sin(turn)])
    u, v = (unit * [prism.radius, prism.half_width]).T
    cosine, sine = np.cos(prism.heading), np.sin(prism.heading)
    return np.column_stack([prism.x + u * cosine - v * sine, prism.y + u * sine + v * cosine])


def beyond_outline_m(prism: Prism, x: FloatArray, y: FloatArray) -> FloatArray:
    """How far floor points lie beyond a prism's outline, in m, negative inside it; along a corner's sides, not round it."""
    corners = list(OUTLINES.values())[int(prism.outline)]
    dx, dy = x - prism.x, y - prism.y
    if not corners:
        return np.asarray(np.hypot(dx, dy) - prism.radius)
    cosine, sine = np.cos(prism.heading), np.sin(prism.heading)
    u, v = dx * cosine + dy * sine, dy * cosine - dx * sine
    polygon = np.array(corners) * [prism.radius, prism.half_width]
    sides = np.roll(polygon, -1, axis=0) - polygon
    beyond = [((u - a) * dv - (v - b) * du) / np.hypot(du, dv) for (a, b), (du, dv) in zip(polygon, sides, strict=True)]
    return np.asarray(np.max(beyond, axis=0))


def parts(prism: Prism) -> list[Prism]:
    """The prism up to its waist, and what stands above it, each without a waist; a table is one part."""
    if prism.waist >= 1.0 or prism.upper >= 1.0:
        return [prism._replace(waist=1.0, upper=1.0)]
    below = prism._replace(height=prism.waist * prism.height, waist=1.0, upper=1.0, lean=0.0)
    return [below, Prism(*upper_part(prism))]


def as_array(prisms: Sequence[Prism], name: str) -> FloatArray:
    """Prisms as float64 (N, 10); a number that is not finite or a size that is not positive is a ValueError."""
    array = np.array(prisms, dtype=np.float64).reshape(-1, FIELDS)
    sizes = array[:, [2, 3, 6, 7, 8]]  # all but places, outline, heading and lean
    known = np.isin(array[:, 4], range(len(OUTLINES)))
    if not (np.isfinite(array).all() and (sizes > 0).all() and known.all()):
        raise ValueError(f"{name}: expected finite places, sizes > 0 and a known outline, got {list(prisms)}")
    return array
