"""DOC"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled

PERSON_M = 1.4
"""What is as tall is a body. It has arms, legs and bags: nothing low within 0.5 m of its axis, nor anything tall within 0.3 m, is
an object of its own."""


CHIN, LEGS, HEAD = 0.87, 0.4, 0.83
"""A body's shares of its height from which there is only a head, and up to which legs may be apart (Drillis and Contini 1966 have
the chin at 0.870, knee and hip at 0.285 and 0.530); where its chord is shorter than this share of its width, there need be no head."""


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


def _as_array(things: Sequence[Cylinder], name: str) -> FloatArray:
    array = np.array([[c.x, c.y, c.radius, c.height] for c in things], dtype=np.float64).reshape(-1, 4)
    if not (np.isfinite(array).all() and (array[:, 2:] > 0).all()):
        raise ValueError(f"{name}: expected finite places and sizes > 0, got {list(things)}")
    return array
