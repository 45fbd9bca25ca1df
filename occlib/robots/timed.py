"""The quickest trajectory among robots that move: prioritised planning in space and time.

Windowed as in WHCA* (Silver 2005, "Cooperative Pathfinding", doi:10.1609/aiide.v1i1.18726). What robots announce to each
other are trajectories: see :mod:`occlib.robots.reservations`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from occlib.base import checks
from occlib.base.arrays import FloatArray, Mask
from occlib.base.kernels import compiled
from occlib.geometry import Floor
from occlib.robots.paths import cell_of, free_start, lines_free
from occlib.robots.reservations import Reservations, Trajectory, pieces_of, stands_clear

_LENGTH_WEIGHT = 1e-3  # of two plans that take equally long the shorter one


def plan_timed(
    blocked: Mask,
    floor: Floor,
    start_m: npt.ArrayLike,
    goal_m: npt.ArrayLike,
    *,
    speed_mps: float,
    dt_s: float,
    radius_m: float,
    reservations: Reservations | None = None,
    horizon_s: float = 12.0,
    start_time_s: float = 0.0,
    cell_m: float = 0.1,
) -> Trajectory | None:
    """The quickest trajectory among robots, or as much of it as the horizon shows.

    At each step of ``dt_s`` the robot waits or goes straight to a cell of ``cell_m`` that it can reach in that time.
    Every cell that it can be on at every step is looked at, which for a floor of a few metres is as quick as A* and
    gives the same plan. What lies beyond the horizon counts as if no robot were there, by the true distance to the goal
    (the heuristic of HCA*). Between the steps discs are kept apart, too, so robots cannot change places.

    Parameters
    ----------
    blocked
        bool (ny, nx), where the centre must not be. A blocked start is left as :func:`free_start` says.
    start_m, goal_m
        ``(x, y)`` in m on the floor. Towards a goal that is blocked or out of reach the robot does not move.
    speed_mps
        At most; ``speed_mps * dt_s`` must be ``cell_m`` or more. From 1.42 ``cell_m`` on there are diagonal steps.
    dt_s
        Of a step.
    radius_m
        Of the robot's disc.
    reservations
        The other robots, with their intentions. A disc that already touches the robot's must not come closer.
    horizon_s
        How far the robots look ahead, rounded up to whole steps.
    start_time_s
        When the robot is at its start, on the clock of the reservations.
    cell_m
        Side of the cells of this search.

    Returns
    -------
    list of (t, x, y), or None
        It ends where the robot would stand, clear of all others for ever: at the goal, or on the way to it. ``None`` if
        it cannot even keep clear of the others by standing still or moving off.

    Raises
    ------
    ValueError
        A point off the floor, a length, time or speed that is not positive, steps shorter than a cell.
    """
    numbers = {"speed_mps": speed_mps, "dt_s": dt_s, "radius_m": radius_m, "horizon_s": horizon_s, "cell_m": cell_m}
    for name, value in numbers.items():
        checks.number(name, value, above=0)
    if speed_mps * dt_s < cell_m - 1e-9:
        raise ValueError(f"speed_mps: expected at least a cell of {cell_m} m in {dt_s} s, got {speed_mps} m/s")
    goal = cell_of(floor, goal_m, "goal_m")
    blocked = free_start(blocked, floor, start_m, reach_m=cell_m)
    ends = np.array([start_m, goal_m], dtype=np.float64)
    xy, graph = _graph(blocked, floor, ends, speed_mps * dt_s, cell_m)
    steps = math.ceil(horizon_s / dt_s - 1e-9)
    others = [] if reservations is None else reservations.gaps(ends[0], start_time_s, radius_m)
    pieces, first_piece = pieces_of(others, start_time_s, dt_s, steps)
    cost, parent = _search(graph.indptr, graph.indices, graph.data, xy, steps, pieces, first_piece)
    to_go = np.full(len(xy), np.inf) if blocked[goal] else dijkstra(graph, indices=len(xy) - 1)
    final = cost[steps] + np.where(stands_clear(xy, others, start_time_s + steps * dt_s), 0, np.inf)
    total = final + to_go
    if not np.isfinite(total).any():  # no way: wait, or make room for others
        total = final
    node = int(np.argmin(total))
    if not np.isfinite(total[node]):
        return None
    nodes = [node]
    for step in range(steps, 0, -1):
        nodes.append(int(parent[step, nodes[-1]]))
    nodes.reverse()
    while len(nodes) > 1 and (xy[nodes[-1]] == xy[nodes[-2]]).all():
        nodes.pop()
    return [(start_time_s + k * dt_s, float(xy[n, 0]), float(xy[n, 1])) for k, n in enumerate(nodes)]


def _graph(blocked: Mask, floor: Floor, ends: FloatArray, reach_m: float, cell_m: float) -> tuple[FloatArray, Any]:
    """Places that a robot may be at after a step, (n, 2) in m, and the free straight ways between them.

    The last but one place is the start, the last the goal. A way weighs 1, for the step, and a little for its length.
    """
    inner, pairs = _lattice(floor, reach_m, cell_m)
    xy, n, ways = np.vstack([inner, ends]), len(inner), [pairs]
    for k in (n, n + 1):
        near = np.flatnonzero(np.hypot(*(xy[:k] - xy[k]).T) <= reach_m + 1e-9)
        ways.append(np.column_stack([near, np.full(len(near), k)]))
    a, b = np.vstack(ways).T
    usable = lines_free(blocked, floor, xy, xy)
    both = usable[a] & usable[b]
    a, b = a[both], b[both]
    free = lines_free(blocked, floor, xy[a], xy[b])
    a, b = a[free], b[free]
    weight = 1 + _LENGTH_WEIGHT * np.hypot(*(xy[a] - xy[b]).T) / reach_m
    shape = (len(xy), len(xy))
    graph = csr_array((np.tile(weight, 2), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=shape)
    graph.sort_indices()
    return xy, graph


@lru_cache(maxsize=8)
def _lattice(floor: Floor, reach_m: float, cell_m: float) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Middles of the cells of a floor, (n, 2) in m, and the pairs of them within reach, (m, 2); read-only, made once."""
    (left, right), (low, high) = floor.x, floor.y
    nx, ny = (max(1, int((b - a) / cell_m + 1e-9)) for a, b in (floor.x, floor.y))
    xs = (left + right - (nx - 1) * cell_m) / 2 + cell_m * np.arange(nx)
    ys = (low + high - (ny - 1) * cell_m) / 2 + cell_m * np.arange(ny)
    xy, index = np.column_stack([np.tile(xs, ny), np.repeat(ys, nx)]), np.arange(nx * ny).reshape(ny, nx)
    far, found = int(reach_m / cell_m + 1e-9), [np.empty((0, 2), np.int64)]
    for dy in range(min(far, ny - 1) + 1):
        for dx in range(-far, far + 1):
            if (dy > 0 or dx > 0) and math.hypot(dx, dy) * cell_m <= reach_m + 1e-9 and abs(dx) < nx:
                a, b = index[: ny - dy, max(0, -dx) : nx - max(0, dx)], index[dy:, max(0, dx) : nx + min(0, dx)]
                found.append(np.column_stack([a.ravel(), b.ravel()]))
    pairs = np.vstack(found)
    for kept in (xy, pairs):
        kept.setflags(write=False)
    return xy, pairs


@compiled
def _is_clear(ax: float, ay: float, bx: float, by: float, pieces: FloatArray, begin: int, end: int) -> bool:
    """Whether an even motion from a to b over one step keeps its gap to every piece of that step."""
    for i in range(begin, end):
        s0, s1, gap = pieces[i, 0], pieces[i, 1], pieces[i, 6]
        x = ax + s0 * (bx - ax) - pieces[i, 2]
        y = ay + s0 * (by - ay) - pieces[i, 3]
        dx = ax + s1 * (bx - ax) - pieces[i, 4] - x
        dy = ay + s1 * (by - ay) - pieces[i, 5] - y
        length2 = dx * dx + dy * dy
        s = 0.0 if length2 < 1e-300 else min(1.0, max(0.0, -(x * dx + y * dy) / length2))
        if (x + s * dx) ** 2 + (y + s * dy) ** 2 < gap * gap:
            return False
    return True


@compiled
def _search(
    indptr: Any, indices: Any, weights: FloatArray, xy: FloatArray, steps: int, pieces: FloatArray, first_piece: Any
) -> Any:
    """Least cost of being at each place after each step, (steps + 1, n), and the place before it.

    A step costs 1, and nothing once the robot stands at the goal, the last place. The start is the last but one.
    """
    n = len(xy)
    cost, parent = np.full((steps + 1, n), np.inf), np.full((steps + 1, n), -1, np.int32)
    cost[0, n - 2] = 0.0
    for t in range(steps):
        begin, end = first_piece[t], first_piece[t + 1]
        for u in range(n):
            if cost[t, u] == np.inf:
                continue
            ux, uy = xy[u, 0], xy[u, 1]
            stay = cost[t, u] + (0.0 if u == n - 1 else 1.0)
            if stay < cost[t + 1, u] and _is_clear(ux, uy, ux, uy, pieces, begin, end):
                cost[t + 1, u], parent[t + 1, u] = stay, u
            for e in range(indptr[u], indptr[u + 1]):
                v = indices[e]
                move = cost[t, u] + weights[e]
                if move < cost[t + 1, v] and _is_clear(ux, uy, xy[v, 0], xy[v, 1], pieces, begin, end):
                    cost[t + 1, v], parent[t + 1, v] = move, u
    return cost, parent
