"""Shortest paths on a map, for one robot: plan, leave a blocked place, cut corners.

Arrays and numbers only: a robot that gets maps through a socket needs nothing else of this library.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Mask
from occlib.base.kernels import compiled
from occlib.geometry import Floor


def plan(
    blocked: Mask, floor: Floor, start_m: npt.ArrayLike, goal_m: npt.ArrayLike, *, clearance_m: float = 0.0
) -> FloatArray | None:
    """The shortest way over free cells, as the metres of their centres, shape (n, 2); ``None`` where there is none.

    Steps go to the eight neighbours (``skimage.graph.MCP_Geometric``). A robot whose own cell is blocked, as one that
    stands too near to an obstacle, may leave: see :func:`free_start`.

    Parameters
    ----------
    blocked
        bool (ny, nx), where the robot's centre must not be: :meth:`occlib.geometry.Floor.near` inflates by its radius.
    start_m, goal_m
        ``(x, y)`` in m on the floor.
    clearance_m
        Prefer to keep this far from what is blocked: a cell beside an obstacle counts as twice as long. 0: shortest.

    Raises
    ------
    ValueError
        A point off the floor, a blocked goal, a negative clearance, a mask of another shape.

    Examples
    --------
    >>> plan(np.zeros((1, 4), bool), Floor((0, 4), (0, 1), 1.0), (0.5, 0.5), (3.2, 0.4)).tolist()
    [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [3.5, 0.5]]
    """
    from skimage.graph import MCP_Geometric

    start, goal = cell_of(floor, start_m, "start_m"), cell_of(floor, goal_m, "goal_m")
    checks.mask("blocked", blocked, floor.shape)
    if blocked[goal]:
        raise ValueError(f"goal_m: expected a free cell, got a blocked one at {np.asarray(goal_m).tolist()}")
    checks.number("clearance_m", clearance_m, least=0, unit="metres")
    blocked = free_start(blocked, floor, start_m)
    costs = np.ones(floor.shape)
    if clearance_m > 0:
        costs += np.clip(1 - floor.distance_m(blocked) / clearance_m, 0, 1)
    costs[blocked] = -1  # never entered
    search = MCP_Geometric(costs, fully_connected=True)
    search.find_costs([start], [goal])
    try:
        cells = np.array(search.traceback(goal))
    except ValueError:
        return None
    return floor.points(cells[:, ::-1])


def free_start(blocked: Mask, floor: Floor, start_m: npt.ArrayLike, *, reach_m: float = 0.0) -> Mask:
    """The mask with a way out for a robot whose own cell is blocked; the same mask if it is not.

    Freed are the cells up to the nearest free one (and ``reach_m`` further) that are no deeper in the blocked area than
    the robot itself: on its way out it comes no nearer to any obstacle than it is.
    """
    checks.mask("blocked", blocked, floor.shape)
    start = cell_of(floor, start_m, "start_m")
    if not blocked[start]:
        return blocked
    depth, here = floor.distance_m(~blocked), np.zeros(floor.shape, bool)
    here[start] = True
    disc = floor.distance_m(here) <= min(depth[start], 1e6) + reach_m + 1e-9
    return blocked & ~(disc & (depth <= depth[start] + 1e-9) if np.isfinite(depth[start]) else here)


def shorten(path_m: npt.ArrayLike, blocked: Mask, floor: Floor) -> FloatArray:
    """The path without the corners that a straight free line makes needless, shape (m, 2); never longer.

    From each kept point on, the first that is out of sight keeps the one before it. Lines are looked at every half a
    cell.
    """
    path = np.asarray(path_m, dtype=np.float64).reshape(-1, 2)
    checks.mask("blocked", blocked, floor.shape)
    kept = [0] if len(path) else []
    for i in range(2, len(path)):
        if not lines_free(blocked, floor, path[kept[-1], None], path[i, None])[0]:
            kept.append(i - 1)
    return path[[*kept, *([len(path) - 1] if len(path) > 1 else [])]]


def path_length_m(path_m: npt.ArrayLike) -> float:
    """Length of a path (n, 2), or of a trajectory of ``(t, x, y)``, in m.

    >>> path_length_m([[0, 0], [3, 4], [3, 5]])
    6.0
    """
    path = np.asarray(path_m, dtype=np.float64)
    return float(np.hypot(*np.diff(path[:, -2:], axis=0).T).sum()) if len(path) else 0.0


def cell_of(floor: Floor, point_m: npt.ArrayLike, name: str) -> tuple[int, int]:
    """Row and column of the cell of a point ``(x, y)`` in m; ``ValueError`` if it is off the floor."""
    point = np.asarray(point_m, dtype=np.float64)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ValueError(f"{name}: expected (x, y) in m, got {point.tolist()}")
    ix, iy = np.rint(floor.cells(point)[0]).astype(int)
    if not (0 <= iy < floor.shape[0] and 0 <= ix < floor.shape[1]):
        raise ValueError(f"{name}: expected a point on the floor, x {floor.x} and y {floor.y}, got {point.tolist()}")
    return int(iy), int(ix)


def lines_free(blocked: Mask, floor: Floor, a: FloatArray, b: FloatArray) -> Mask:
    """Which straight lines from a (n, 2) to b (n, 2) lie on the floor and on free cells, sampled every half a cell."""
    corner = np.array([floor.x[0], floor.y[0]])
    free: Mask = _free_lines(blocked, (a - corner) / floor.resolution, (b - corner) / floor.resolution)
    return free


@compiled
def _free_lines(blocked: Mask, a: FloatArray, b: FloatArray) -> Any:
    """The same for lines in cells, of which the first begins at 0."""
    free = np.ones(len(a), np.bool_)
    for i in range(len(a)):
        dx, dy = b[i, 0] - a[i, 0], b[i, 1] - a[i, 1]
        steps = max(1, int(np.ceil(2 * np.hypot(dx, dy))))
        for k in range(steps + 1):
            x, y = int(np.floor(a[i, 0] + dx * k / steps)), int(np.floor(a[i, 1] + dy * k / steps))
            if x < 0 or y < 0 or y >= blocked.shape[0] or x >= blocked.shape[1] or blocked[y, x]:
                free[i] = False
                break
    return free
