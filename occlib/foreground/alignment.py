"""Has the camera been bumped? By how much the background has to be moved to lie on the frame.

Some hundred of the background's steepest px, spread over the picture, are looked up in the frame: where the direction of the gradient
is the same, they agree. The light does not matter, and an object hides only some of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base.kernels import compiled

Float32Array = npt.NDArray[np.float32]

REACH = 6
"""Px of the halved picture up to which a shift is looked for: 12 px."""

SPACING = 16
"""Px of the halved picture between the points, about."""

LEAST_GRADIENT = 8.0
"""Grey levels over two px of a point's gradient at least."""

ALIGNED = 0.9
"""Mean agreement of the points, -1 to 1, from which on nothing is looked for."""

GAIN = 0.1
"""By which a shift has to better the agreement."""

LEAST_POINTS = 20
"""Fewer points say nothing."""


@compiled
def edge_points(grey: Any) -> Any:
    """Row and column of the steepest px of each square of the picture, (N, 2), of those that are steep."""
    rows, columns = grey.shape
    points, count = np.empty((rows * columns // SPACING**2 + rows + columns, 2), np.int32), 0
    for top in range(REACH + 1, rows - REACH - 1, SPACING):
        for left in range(REACH + 1, columns - REACH - 1, SPACING):
            best = LEAST_GRADIENT**2
            for y in range(top, min(top + SPACING, rows - REACH - 1)):
                for x in range(left, min(left + SPACING, columns - REACH - 1)):
                    energy = (grey[y, x + 1] - grey[y, x - 1]) ** 2 + (grey[y + 1, x] - grey[y - 1, x]) ** 2
                    if energy > best:
                        best = energy
                        points[count, 0], points[count, 1] = y, x
            if best > LEAST_GRADIENT**2:
                count += 1
    return points[:count].copy()


@compiled
def _agreement(background: Any, frame: Any, points: Any, by_y: Any, by_x: Any) -> Any:
    """Mean cosine between the gradients of the background at the points and of the frame at the points moved."""
    total = 0.0
    for k in range(len(points)):
        y, x = points[k, 0], points[k, 1]
        px, py = background[y, x + 1] - background[y, x - 1], background[y + 1, x] - background[y - 1, x]
        y, x = y + by_y, x + by_x
        fx, fy = frame[y, x + 1] - frame[y, x - 1], frame[y + 1, x] - frame[y - 1, x]
        total += (px * fx + py * fy) / np.sqrt((px * px + py * py) * (fx * fx + fy * fy) + 1)
    return total / max(len(points), 1)


@compiled
def _search(background: Any, frame: Any, points: Any) -> Any:
    size = 2 * REACH + 1
    scores = np.empty((size, size))
    scores[REACH, REACH] = _agreement(background, frame, points, 0, 0)
    best = (REACH, REACH)
    for v in range(size):
        for u in range(size):
            scores[v, u] = _agreement(background, frame, points, v - REACH, u - REACH)
            if scores[v, u] > scores[best]:
                best = (v, u)
    return scores, best


def _peak(before: float, at: float, after: float) -> float:
    """Where the parabola through three values has its top, -0.5 to 0.5."""
    bend = 2 * at - before - after
    return float(np.clip((after - before) / (2 * bend), -0.5, 0.5)) if bend > 0 else 0.0


def shift_between(background: Float32Array, frame: Float32Array, points: npt.NDArray[np.int32]) -> tuple[float, float]:
    """The frame's shift (x, y) against the background in px of the whole picture, to half a px; (0, 0) if they agree as they are.

    Both are grey, float32, at half size; the points are those of :func:`edge_points`.
    """
    if len(points) < LEAST_POINTS or _agreement(background, frame, points, 0, 0) >= ALIGNED:
        return 0.0, 0.0
    scores, (v, u) = _search(background, frame, points)
    if scores[v, u] < scores[REACH, REACH] + GAIN:
        return 0.0, 0.0
    y = v - REACH + (_peak(*scores[v - 1 : v + 2, u]) if 0 < v < 2 * REACH else 0.0)
    x = u - REACH + (_peak(*scores[v, u - 1 : u + 2]) if 0 < u < 2 * REACH else 0.0)
    return round(4 * x) / 2, round(4 * y) / 2
