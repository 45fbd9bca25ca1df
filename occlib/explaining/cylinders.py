"""Upright cylinders: the shape that every object is taken to have, which sizes are plausible, and their silhouettes.

The silhouettes are those in polar views (:mod:`occlib.explaining.evidence`): a column is an azimuth about the camera, a
row an angle of depression. There an upright cylinder covers one run of rows in each column, from the near edge of its
base (the last row) up to the far edge of its top (the first row), so a few angles describe it, whatever its size.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled

PERSON_M = 1.4
"""Cylinders of this height in m or more are treated as people: parts of the head and the legs need not be seen."""

CHIN = 0.87
"""A person's chin as a share of the height; above it there is only a head (Drillis and Contini 1966: 0.870)."""

LEGS = 0.4
"""Up to this share of the height a person's legs may be apart (Drillis and Contini 1966: knee 0.285, hip 0.530)."""

HEAD = 0.83
"""A column need not show a head where it cuts a person's cylinder along less than this share of the diameter."""

RIM_M = 0.12
"""Height in m of the rim in front of an object's base and above its top. Foreground that goes on there counts against
the object, whose silhouette should end where the foreground ends: a ghost floats in the silhouettes of others."""

BELOW_CAMERA = 1.02
"""A cylinder has no silhouette if its axis is within this many radii of the camera's: the camera hangs above it."""

# --- plausible sizes: neither a pole nor a sheet nor a wall
MIN_RADIUS_M, MIN_HEIGHT_M, MAX_HEIGHT_M = 0.05, 0.025, 2.0
"""Smallest radius and height, and greatest height, in m: from a toy on the floor to a tall person."""

SLIM_M, SLIM_PER_M = 0.03, 0.065
"""A cylinder's radius is at least ``SLIM_M + SLIM_PER_M * height``, else it is a pole: 12 cm for a person of 1.4 m."""

FLAT = 0.2
"""A cylinder's height is at least this share of its radius, else it is a sheet on the floor."""

LOW_M, WIDE_M, WIDE_TALL_M, NARROWING = 0.7, 0.45, 0.22, 0.46
"""Greatest radius: ``WIDE_M`` (an armchair) for what is ``LOW_M`` high or lower; higher up it falls by ``NARROWING`` m
per m to ``WIDE_TALL_M`` (a person). What is wider is several objects side by side."""


class Cylinder(NamedTuple):
    """An upright object.

    Parameters
    ----------
    x, y
        Where its axis meets the floor, in m.
    radius, height
        In m.
    """

    x: float
    y: float
    radius: float
    height: float


class Span(NamedTuple):
    """Where a disc on the floor lies in a polar view.

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
    """The rows of a cylinder in one column of a polar view, all within the picture.

    Parameters
    ----------
    low, high
        First row and the one after the last: the rows ``low:high`` are the silhouette, from its top down to its base.
    above, below
        The same for silhouette and rim: the rows ``above:low`` and ``high:below`` should hold no foreground.
    trunk, legs
        Of a person, the first row below the head and the first row of the legs; else ``low`` and ``high``.
    """

    low: int
    high: int
    above: int
    below: int
    trunk: int
    legs: int


class Silhouette(NamedTuple):
    """A cylinder's silhouette in a polar view: in column ``first + i`` the rows ``low[i]:high[i]``."""

    first: int
    low: Any
    high: Any


@compiled
def plausible(radius: float, height: float) -> bool:
    """Whether something of this size, in m, may stand on the floor: neither a pole nor a sheet nor a wall."""
    wide = WIDE_M if height <= LOW_M else max(WIDE_TALL_M, WIDE_M - NARROWING * (height - LOW_M))
    slim = SLIM_M + SLIM_PER_M * height
    flat = max(MIN_HEIGHT_M, FLAT * radius)
    return slim <= radius <= wide and radius >= MIN_RADIUS_M and flat <= height <= MAX_HEIGHT_M


@compiled
def cylinder_at(cylinders: Any, i: int) -> Any:
    """Row ``i`` of an array of cylinders, float64 (N, 4), as a :class:`Cylinder`."""
    return Cylinder(cylinders[i, 0], cylinders[i, 1], cylinders[i, 2], cylinders[i, 3])


@compiled
def span_of(view: Any, columns: int, x: float, y: float, radius: float) -> Any:
    """:class:`Span` of a disc on the floor, whose tangents lie ``arcsin(radius / distance)`` to either side of its centre."""
    dx, dy = x - view.x, y - view.y
    distance = np.hypot(dx, dy)
    azimuth = (np.arctan2(dy, dx) - view.middle + np.pi) % (2 * np.pi) - np.pi
    first, last = 0, 0
    if distance > radius * BELOW_CAMERA:
        half = np.arcsin(radius / distance)
        first = max(int(np.ceil((azimuth - half - view.left) / view.step)), 0)
        last = max(first, min(int(np.floor((azimuth + half - view.left) / view.step)) + 1, columns))
    return Span(first, last, distance, azimuth)


@compiled
def edges(view: Any, column: int, span: Any, radius: float) -> Any:
    """Distances in m along the floor at which a column's ray enters and leaves a disc."""
    turn = view.left + column * view.step - span.azimuth
    chord = np.sqrt(max(radius * radius - (span.distance * np.sin(turn)) ** 2, 0.0))
    return span.distance * np.cos(turn) - chord, span.distance * np.cos(turn) + chord


@compiled
def foot(view: Any, near: float) -> Any:
    """The row after the last of what stands at a distance in m, and how many rows the rim, :data:`RIM_M`, has there."""
    last = int(np.floor((np.arctan2(view.height, near) - view.top) / view.step)) + 1
    return last, int(RIM_M / np.hypot(near, view.height) / view.step)


@compiled
def _top(view: Any, near: float, far: float, height: float) -> int:
    """First row of a cylinder: the far edge of its top, or the near edge where the top is above the camera."""
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
def run_of(view: Any, rows: int, cylinder: Any, span: Any, column: int) -> Any:
    """:class:`Run` of a cylinder in one of the columns of its span."""
    near, far = edges(view, column, span, cylinder.radius)
    base, rim = foot(view, near)
    return run_between(view, rows, near, far, base, rim, cylinder.radius, cylinder.height)


@compiled
def silhouette(view: Any, columns: int, rows: int, cylinder: Any) -> Any:
    """:class:`Silhouette` of a cylinder in a polar view of so many columns and rows."""
    span = span_of(view, columns, cylinder.x, cylinder.y, cylinder.radius)
    low, high = np.empty(span.last - span.first, np.int64), np.empty(span.last - span.first, np.int64)
    for i in range(len(low)):
        run = run_of(view, rows, cylinder, span, span.first + i)
        low[i], high[i] = run.low, run.high
    return Silhouette(span.first, low, high)


def as_array(cylinders: Sequence[Cylinder], name: str) -> FloatArray:
    """Cylinders as float64 (N, 4); a number that is not finite or a size that is not positive is a ValueError."""
    array = np.array(cylinders, dtype=np.float64).reshape(-1, 4)
    if not (np.isfinite(array).all() and (array[:, 2:] > 0).all()):
        raise ValueError(f"{name}: expected finite places and sizes > 0, got {list(cylinders)}")
    return array
