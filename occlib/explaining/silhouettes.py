"""The silhouettes of upright prisms in polar views (:mod:`occlib.explaining.evidence`).

A column of a polar view is an azimuth about the camera, a row an angle of depression. There an upright prism covers one run of rows in each
column, from the near edge of its base (the last row) up to the far edge of its top (the first row), so a few angles describe it, whatever its
size.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from occlib.base.kernels import compiled
from occlib.explaining.prisms import CORNERS, COUNTS, PERSON_M, ROUND, is_table, reach, upper_part

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

WHOLE, PART = np.bool_(False), np.bool_(True)
"""For :func:`outline_edges`: typed, as the loops are compiled anew for each plain value."""


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
def span_of(view: Any, columns: int, prism: Any) -> Any:
    """:class:`Span` of a prism: from the tangent on one side, ``arcsin(radius / distance)``, to that on the other."""
    dx, dy = prism.x - view.x, prism.y - view.y
    distance = np.hypot(dx, dy)
    azimuth = (np.arctan2(dy, dx) - view.middle + np.pi) % (2 * np.pi) - np.pi
    first, last = 0, 0
    if distance > reach(prism) * BELOW_CAMERA:
        corners = COUNTS[int(prism.outline)]
        if corners == 0:
            right = np.arcsin(prism.radius / distance)
            left = -right
        else:
            left, right = np.inf, -np.inf
            turn = prism.heading - np.arctan2(dy, dx)  # the outline, seen along the line of sight to its axis
            cosine, sine = np.cos(turn), np.sin(turn)
            for i in range(corners):
                u = CORNERS[int(prism.outline), i, 0] * prism.radius
                v = CORNERS[int(prism.outline), i, 1] * prism.radius * prism.ratio
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
    corners = COUNTS[int(prism.outline)]
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
        u, v = CORNERS[int(prism.outline), i, 0] * a, CORNERS[int(prism.outline), i, 1] * b
        du, dv = CORNERS[int(prism.outline), j, 0] * a - u, CORNERS[int(prism.outline), j, 1] * b - v
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
