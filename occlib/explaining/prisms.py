"""Upright prisms: the shapes that objects are taken to have, which sizes are plausible, and their silhouettes.

A prism stands on an outline, round or with corners (:data:`OUTLINES`), and may be narrower above its waist: a seated
person, a robot with a mast. A new outline is one entry of the table.

The silhouettes are those in polar views (:mod:`occlib.explaining.evidence`): a column is an azimuth about the camera, a
row an angle of depression. There an upright prism covers one run of rows in each column, from the near edge of its base
(the last row) up to the far edge of its top (the first row), so a few angles describe it, whatever its size.
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

_MOST_CORNERS = max(4, *(len(corners) for corners in OUTLINES.values()))
_CORNERS = np.zeros((len(OUTLINES), _MOST_CORNERS, 2))
_COUNTS = np.zeros(len(OUTLINES), np.int64)
for _number, _corners in enumerate(OUTLINES.values()):
    _CORNERS[_number, : len(_corners)] = np.reshape(_corners, (-1, 2))
    _COUNTS[_number] = len(_corners)

PERSON_M = 1.4
"""Prisms of this height in m or more are treated as people: parts of the head and the legs need not be seen."""

CHIN = 0.87
"""A person's chin as a share of the height; above it there is only a head (Drillis and Contini 1966: 0.870)."""

LEGS = 0.4
"""Up to this share of the height a person's legs may be apart (Drillis and Contini 1966: knee 0.285, hip 0.530)."""

HEAD = 0.83
"""A column need not show a head where it cuts a person's prism along less than this share of the diameter."""

RIM_M = 0.12
"""Height in m of the rim in front of an object's base and above its top. Foreground that goes on there counts against
the object, whose silhouette should end where the foreground ends: a ghost floats in the silhouettes of others."""

BELOW_CAMERA = 1.02
"""A prism has no silhouette if its axis is within this many radii of the camera's: the camera hangs above it."""

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


WHOLE, PART = np.bool_(False), np.bool_(True)
"""For :func:`outline_edges`: typed, as the loops are compiled anew for each plain value."""

FIELDS = len(Prism._fields)
"""Numbers of a prism: the columns of an array of prisms."""


class Span(NamedTuple):
    """Where an outline on the floor lies in a polar view.

    Parameters
    ----------
    first, last
        Its first column and the one after its last; the same if the view does not show it.
    distance
        Of its centre from the camera along the floor, in m.
    azimuth
        Of its centre relative to the middle of the view, in rad.
    """

    first: int
    last: int
    distance: float
    azimuth: float


class Run(NamedTuple):
    """The rows of a prism in one column of a polar view, all within the picture.

    Parameters
    ----------
    low, high
        First row and the one after the last: the rows ``low:high`` are the silhouette, from its top down to its base.
    above, below
        The same for silhouette and rim: the rows ``above:low`` and ``high:below`` should hold no foreground.
    trunk, legs
        Of a person, the first row below the head and the first row of the legs, of a table too; else ``low`` and ``high``.
    """

    low: int
    high: int
    above: int
    below: int
    trunk: int
    legs: int


class Silhouette(NamedTuple):
    """A prism's silhouette in a polar view: in column ``first + i`` the rows ``low[i]:high[i]``."""

    first: int
    low: Any
    high: Any


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
    corners = _COUNTS[int(prism.outline)]
    if corners == 0:
        return prism.radius
    farthest = 0.0
    for i in range(corners):
        u, v = _CORNERS[int(prism.outline), i, 0], _CORNERS[int(prism.outline), i, 1] * prism.ratio
        farthest = max(farthest, u * u + v * v)
    return prism.radius * np.sqrt(farthest)


@compiled
def span_of(view: Any, columns: int, prism: Any) -> Any:
    """:class:`Span` of a prism: from the tangent on one side, ``arcsin(radius / distance)``, to that on the other."""
    dx, dy = prism.x - view.x, prism.y - view.y
    distance = np.hypot(dx, dy)
    azimuth = (np.arctan2(dy, dx) - view.middle + np.pi) % (2 * np.pi) - np.pi
    first, last = 0, 0
    if distance > reach(prism) * BELOW_CAMERA:
        corners = _COUNTS[int(prism.outline)]
        if corners == 0:
            right = np.arcsin(prism.radius / distance)
            left = -right
        else:
            left, right = np.inf, -np.inf
            turn = prism.heading - np.arctan2(dy, dx)  # the outline, seen along the line of sight to its axis
            cosine, sine = np.cos(turn), np.sin(turn)
            for i in range(corners):
                u = _CORNERS[int(prism.outline), i, 0] * prism.radius
                v = _CORNERS[int(prism.outline), i, 1] * prism.radius * prism.ratio
                angle = np.arctan2(u * sine + v * cosine, distance + u * cosine - v * sine)
                left, right = min(left, angle), max(right, angle)
        first = max(int(np.ceil((azimuth + left - view.left) / view.step)), 0)
        last = max(first, min(int(np.floor((azimuth + right - view.left) / view.step)) + 1, columns))
    return Span(first, last, distance, azimuth)


@compiled
def edges(view: Any, column: int, span: Any, radius: float) -> Any:
    """Distances in m along the floor at which a column's ray enters and leaves a disc."""
    turn = view.left + column * view.step - span.azimuth
    chord = np.sqrt(max(radius * radius - (span.distance * np.sin(turn)) ** 2, 0.0))
    return span.distance * np.cos(turn) - chord, span.distance * np.cos(turn) + chord


@compiled
def outline_edges(view: Any, column: int, span: Any, prism: Any, part: bool) -> Any:
    """Distances in m at which a column's ray enters and leaves a prism's outline, from its :class:`Span`.

    The first is larger than the second if the ray misses it, which only a ``part`` of what the columns belong to can be.
    """
    corners = _COUNTS[int(prism.outline)]
    if corners == 0:
        radius = prism.radius
        turn = view.left + column * view.step - span.azimuth
        square = radius * radius - (span.distance * np.sin(turn)) ** 2
        if square < 0.0 and part:
            return 1.0, 0.0
        chord = np.sqrt(max(square, 0.0))
        return span.distance * np.cos(turn) - chord, span.distance * np.cos(turn) + chord
    azimuth = view.middle + view.left + column * view.step - prism.heading
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    towards = view.middle + span.azimuth - prism.heading
    x, y = -span.distance * np.cos(towards), -span.distance * np.sin(towards)  # the camera, from the axis
    near, far = 0.0, np.inf
    a, b = prism.radius, prism.radius * prism.ratio
    for i in range(corners):  # cut the ray at each side of the polygon
        j = (i + 1) % corners
        u, v = _CORNERS[int(prism.outline), i, 0] * a, _CORNERS[int(prism.outline), i, 1] * b
        du, dv = _CORNERS[int(prism.outline), j, 0] * a - u, _CORNERS[int(prism.outline), j, 1] * b - v
        outside = (x - u) * dv - (y - v) * du  # > 0 on the outer side
        slope = cosine * dv - sine * du
        if slope == 0.0:
            if outside > 0.0:
                return 1.0, 0.0
        elif slope < 0.0:
            near = max(near, -outside / slope)
        else:
            far = min(far, -outside / slope)
    if near > far and not part:  # a column at the rim, by rounding
        return far, far
    return near, far


@compiled
def foot(view: Any, near: float) -> Any:
    """The row after the last of what stands at a distance in m, and how many rows the rim, :data:`RIM_M`, has there."""
    last = int(np.floor((np.arctan2(view.height, near) - view.top) / view.step)) + 1
    return last, int(RIM_M / np.hypot(near, view.height) / view.step)


@compiled
def _top(view: Any, near: float, far: float, height: float) -> int:
    """First row of a prism: the far edge of its top, or the near edge where the top is above the camera."""
    above = view.height - height
    return int(np.ceil((np.arctan2(above, far if above > 0 else near) - view.top) / view.step))


@compiled
def run_between(
    view: Any, rows: int, near: float, far: float, base: int, rim: int, radius: float, height: float
) -> Any:
    """:class:`Run` of a cylinder in a column, from its :func:`edges` (near, far) and its :func:`foot` (base, rim)."""
    low = min(max(_top(view, near, far, height), 0), rows)
    high = max(min(max(base, 0), rows), low)
    trunk, legs = low, high
    if height >= PERSON_M:
        if far - near < HEAD * 2 * radius:
            trunk = min(max(_top(view, near, far, CHIN * height), low), high)
        legs = min(max(_top(view, near, near, LEGS * height), trunk), high)
    return Run(low, high, max(low - rim, 0), min(high + rim, rows), trunk, legs)


@compiled
def run_of(view: Any, rows: int, prism: Any, span: Any, column: int) -> Any:
    """:class:`Run` of a prism in one of the columns of its span."""
    near, far = outline_edges(view, column, span, prism, WHOLE)
    base, rim = foot(view, near)
    if prism.waist >= 1.0:
        if prism.outline == ROUND:
            return run_between(view, rows, near, far, base, rim, prism.radius, prism.height)
        top = _top(view, near, far, prism.height)
    elif is_table(prism):
        low = min(max(_top(view, near, far, prism.height), 0), rows)
        high = max(min(max(base, 0), rows), low)
        legs = min(max(_top(view, near, near, prism.waist * prism.height), low), high)
        return Run(low, high, max(low - rim, 0), min(high + rim, rows), low, legs)
    else:
        top = _top(view, near, far, prism.waist * prism.height)
        above = upper_part(prism)
        near, far = outline_edges(view, column, span_of(view, 0, above), above, PART)
        if near <= far:
            top = min(top, _top(view, near, far, prism.height))
    low = min(max(top, 0), rows)
    high = max(min(max(base, 0), rows), low)
    return Run(low, high, max(low - rim, 0), min(high + rim, rows), low, high)


@compiled
def silhouette(view: Any, columns: int, rows: int, prism: Any) -> Any:
    """:class:`Silhouette` of a prism in a polar view of so many columns and rows."""
    span = span_of(view, columns, prism)
    low, high = np.empty(span.last - span.first, np.int64), np.empty(span.last - span.first, np.int64)
    for i in range(len(low)):
        run = run_of(view, rows, prism, span, span.first + i)
        low[i], high[i] = run.low, run.high
    return Silhouette(span.first, low, high)


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
