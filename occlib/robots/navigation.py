"""What a robot does with the map that it receives: plan, give way, drive (section 6.1 of the paper).

The paper leaves planning to the robots: "these parametric vectors are used by the robot of the environment in their path
planning and obstacle avoidance algorithms". Here: shortest paths on the inflated map, and for several robots prioritised
planning in space and time, windowed as in WHCA* (Silver 2005, "Cooperative Pathfinding", doi:10.1609/aiide.v1i1.18726).

Arrays and numbers only: a robot that gets maps through a socket needs nothing else of this library. What robots announce to
each other are trajectories: see :mod:`occlib.robots.reservations`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from occlib.base import checks
from occlib.base.arrays import FloatArray, Mask
from occlib.base.kernels import compiled
from occlib.geometry import Floor
from occlib.robots.reservations import Point, Reservations, Trajectory, pieces_of, position_at, stands_clear

_LENGTH_WEIGHT = 1e-3  # of two plans that take equally long the shorter one


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

    start, goal = _cell(floor, start_m, "start_m"), _cell(floor, goal_m, "goal_m")
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

    Freed are the cells up to the nearest free one (and ``reach_m`` further) that are no deeper in the blocked area than the
    robot itself: on its way out it comes no nearer to any obstacle than it is.
    """
    checks.mask("blocked", blocked, floor.shape)
    start = _cell(floor, start_m, "start_m")
    if not blocked[start]:
        return blocked
    depth, here = floor.distance_m(~blocked), np.zeros(floor.shape, bool)
    here[start] = True
    disc = floor.distance_m(here) <= min(depth[start], 1e6) + reach_m + 1e-9
    return blocked & ~(disc & (depth <= depth[start] + 1e-9) if np.isfinite(depth[start]) else here)


def shorten(path_m: npt.ArrayLike, blocked: Mask, floor: Floor) -> FloatArray:
    """The path without the corners that a straight free line makes needless, shape (m, 2); never longer.

    From each kept point on, the first that is out of sight keeps the one before it. Lines are looked at every half a cell.
    """
    path = np.asarray(path_m, dtype=np.float64).reshape(-1, 2)
    checks.mask("blocked", blocked, floor.shape)
    kept = [0] if len(path) else []
    for i in range(2, len(path)):
        if not _lines_free(blocked, floor, path[kept[-1], None], path[i, None])[0]:
            kept.append(i - 1)
    return path[[*kept, *([len(path) - 1] if len(path) > 1 else [])]]


def path_length_m(path_m: npt.ArrayLike) -> float:
    """Length of a path (n, 2), or of a trajectory of ``(t, x, y)``, in m.

    >>> path_length_m([[0, 0], [3, 4], [3, 5]])
    6.0
    """
    path = np.asarray(path_m, dtype=np.float64)
    return float(np.hypot(*np.diff(path[:, -2:], axis=0).T).sum()) if len(path) else 0.0


def _cell(floor: Floor, point_m: npt.ArrayLike, name: str) -> tuple[int, int]:
    point = np.asarray(point_m, dtype=np.float64)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ValueError(f"{name}: expected (x, y) in m, got {point.tolist()}")
    ix, iy = np.rint(floor.cells(point)[0]).astype(int)
    if not (0 <= iy < floor.shape[0] and 0 <= ix < floor.shape[1]):
        raise ValueError(f"{name}: expected a point on the floor, x {floor.x} and y {floor.y}, got {point.tolist()}")
    return int(iy), int(ix)


def _lines_free(blocked: Mask, floor: Floor, a: FloatArray, b: FloatArray) -> Mask:
    """Which of the straight lines from a (n, 2) to b (n, 2) lie on the floor and on free cells; looked at every half a cell."""
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

    At each step of ``dt_s`` the robot waits or goes straight to a cell of ``cell_m`` that it can reach in that time. Every
    cell that it can be on at every step is looked at, which for a floor of a few metres is as quick as A* and gives the
    same plan. What lies beyond the horizon counts as if no robot were there, by the true distance to the goal (the
    heuristic of HCA*). Between the steps discs are kept apart, too, so robots cannot change places.

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
        It ends where the robot would stand, clear of all others for ever: at the goal, or on the way to it. ``None`` if it
        cannot even keep clear of the others by standing still or moving off.

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
    goal = _cell(floor, goal_m, "goal_m")
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
    (left, right), (low, high) = floor.x, floor.y
    nx, ny = (max(1, int((b - a) / cell_m + 1e-9)) for a, b in (floor.x, floor.y))
    xs = (left + right - (nx - 1) * cell_m) / 2 + cell_m * np.arange(nx)
    ys = (low + high - (ny - 1) * cell_m) / 2 + cell_m * np.arange(ny)
    xy = np.vstack([np.column_stack([np.tile(xs, ny), np.repeat(ys, nx)]), ends])
    index, n = np.arange(nx * ny).reshape(ny, nx), nx * ny
    far, pairs = int(reach_m / cell_m + 1e-9), []
    for dy in range(min(far, ny - 1) + 1):
        for dx in range(-far, far + 1):
            if (dy > 0 or dx > 0) and math.hypot(dx, dy) * cell_m <= reach_m + 1e-9 and abs(dx) < nx:
                a, b = index[: ny - dy, max(0, -dx) : nx - max(0, dx)], index[dy:, max(0, dx) : nx + min(0, dx)]
                pairs.append(np.column_stack([a.ravel(), b.ravel()]))
    for k in (n, n + 1):
        near = np.flatnonzero(np.hypot(*(xy[:k] - xy[k]).T) <= reach_m + 1e-9)
        pairs.append(np.column_stack([near, np.full(len(near), k)]))
    a, b = np.vstack(pairs).T
    usable = _lines_free(blocked, floor, xy, xy)
    both = usable[a] & usable[b]
    a, b = a[both], b[both]
    free = _lines_free(blocked, floor, xy[a], xy[b])
    a, b = a[free], b[free]
    weight = 1 + _LENGTH_WEIGHT * np.hypot(*(xy[a] - xy[b]).T) / reach_m
    shape = (len(xy), len(xy))
    graph = csr_array((np.tile(weight, 2), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=shape)
    graph.sort_indices()
    return xy, graph


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


class Navigator:
    """The brain of one robot: maps and the others' announcements in, its own trajectory out.

    The same inputs give the same trajectory. A step that has begun is finished before a new plan starts, unless the map
    now says that something is in the way: then the robot plans from where it is, or stops.

    Parameters
    ----------
    goal_m
        ``(x, y)`` in m. May be changed at any time.
    radius_m
        Of the robot's disc.
    speed_mps
        At most.
    margin_m
        Planned to be free around the disc, so that a robot that is a little off its trajectory need not stop. To obstacles
        half a cell's diagonal comes on top.
    smear_m
        So much further than their discs the robots themselves may show on the map: there it is taken to be free.
    unknown_free
        Whether the robot may go where nothing is known. By default not: what no camera sees may be occupied. It may always
        leave such a place.
    occupied_from
        Values of the map from here on are obstacles, 1 to 100.
    cell_m, dt_s, horizon_s
        As for :func:`plan_timed`. By default a step is as long as a knight's move of cells takes, so that there are 16
        directions.

    Attributes
    ----------
    trajectory : list of (t, x, y)
        What the robot will do: for everybody to reserve. Empty before the first update.
    intention : list of (t, x, y)
        What it would do if those of lower priority were not there: for these to reserve, too.
    stopped : bool
        Whether it had to stop at once, as its way is blocked and there is no other.
    arrived : bool
        Whether it has been at the present goal, even if it has made way since.

    Notes
    -----
    Two robots whose trajectories are clear of each other stay apart if each updates on the others' newest announcements
    and drives as announced; before its first update a robot announces that it stands. A robot that stops at once, because an obstacle has come up, breaks its word; the others learn
    it at their next update.

    Safety does not depend on the priorities, so these may change at any time. Rank robots that have :attr:`arrived` below
    those that have not: one of the highest priority that stands at its goal in a corridor would never make way. Even so,
    prioritised planning is not complete: there are crowds that could pass each other and do not.
    """

    def __init__(
        self,
        goal_m: Point,
        *,
        radius_m: float,
        speed_mps: float,
        margin_m: float = 0.03,
        smear_m: float = 0.1,
        unknown_free: bool = False,
        occupied_from: int = 50,
        cell_m: float = 0.1,
        dt_s: float | None = None,
        horizon_s: float = 12.0,
    ) -> None:
        for name, value in (("radius_m", radius_m), ("speed_mps", speed_mps), ("cell_m", cell_m)):
            checks.number(name, value, above=0)
        for name, value in (("margin_m", margin_m), ("smear_m", smear_m)):
            checks.number(name, value, least=0, unit="metres")
        if not 1 <= occupied_from <= 100:
            raise ValueError(f"occupied_from: expected 1 to 100, got {occupied_from}")
        self.goal_m, self.radius_m, self.margin_m, self.smear_m = goal_m, radius_m, margin_m, smear_m
        self.unknown_free, self.occupied_from = unknown_free, occupied_from
        self._options = {
            "speed_mps": speed_mps,
            "dt_s": (5**0.5 + 1e-6) * cell_m / speed_mps if dt_s is None else dt_s,
            "radius_m": radius_m + margin_m,
            "horizon_s": horizon_s,
            "cell_m": cell_m,
        }
        self.trajectory: Trajectory = []
        self.intention: Trajectory = []
        self.stopped = False
        self._reached: Point | None = None

    @property
    def arrived(self) -> bool:
        return self._reached is not None and math.dist(self._reached, self.goal_m) == 0

    def update(
        self, data: npt.NDArray[np.int8], floor: Floor, position_m: Point, others: Reservations, time_s: float
    ) -> Trajectory:
        """Plan anew on a map.

        Parameters
        ----------
        data
            int8 (ny, nx), the newest map: -1 unknown, 0 free to 100 occupied. Left as it is.
        floor
            Where it lies.
        position_m
            Where the robot is.
        others
            What the other robots have announced.
        time_s
            Now; not before the last update.

        Returns
        -------
        list of (t, x, y)
            The new :attr:`trajectory`, from now on.

        Raises
        ------
        ValueError
            The robot or its goal is off the floor, or the map has another shape than the floor.
        """
        blocked = self.blocked(data, floor, position_m, others, time_s)
        here = (float(time_s), float(position_m[0]), float(position_m[1]))
        if math.dist(here[1:], self.goal_m) < self._options["cell_m"] / 2:
            self._reached = self.goal_m
        begun = self._begun_step(blocked, floor, here)
        start = begun[-1]

        def find(reservations: Reservations) -> Trajectory | None:
            made = plan_timed(
                blocked,
                floor,
                start[1:],
                self.goal_m,
                start_time_s=start[0],
                reservations=reservations,
                **self._options,
            )
            return None if made is None else begun[:-1] + made

        wish = find(others.higher())
        self.intention = [here] if wish is None else wish
        choices = (
            lambda: wish,
            lambda: find(others),
            lambda: find(others.firm()),
            lambda: self._rest(blocked, floor, here),
        )
        for choice in choices:
            made = choice()
            if made is not None and others.clear(made, self.radius_m):
                self.trajectory, self.stopped = made, False
                return self.trajectory
        self.trajectory, self.stopped = [here], True
        return self.trajectory

    def position_at(self, time_s: float) -> Point:
        """Where the robot will be, ``(x, y)`` in m."""
        return position_at(self.trajectory, time_s)

    def blocked(
        self, data: npt.NDArray[np.int8], floor: Floor, position_m: Point, others: Reservations, time_s: float
    ) -> Mask:
        """Where the robot's centre must not be, bool (ny, nx): the map without robots, inflated."""
        if data.shape != floor.shape or data.dtype != np.int8:
            raise ValueError(f"data: expected int8 {floor.shape}, got {data.dtype} {data.shape}")
        obstacles = data >= self.occupied_from
        if not self.unknown_free:
            obstacles |= data < 0
        y, x = np.ogrid[: floor.shape[0], : floor.shape[1]]
        for robot_x, robot_y, radius in [(*position_m, self.radius_m), *others.discs(time_s)]:
            ix, iy = floor.cells((robot_x, robot_y))[0]
            obstacles &= (x - ix) ** 2 + (y - iy) ** 2 > ((radius + self.smear_m) / floor.resolution) ** 2
        return floor.near(obstacles, self.radius_m + self.margin_m + 0.71 * floor.resolution)

    def _begun_step(self, blocked: Mask, floor: Floor, here: tuple[float, float, float]) -> Trajectory:
        """From now to the end of the step that the robot is in; only now, if there is none or it cannot be finished."""
        later = [point for point in self.trajectory if point[0] > here[0] + 1e-9]
        if not later or math.dist(self.position_at(here[0]), here[1:]) > self._options["cell_m"] / 2:
            return [here]
        a, b = np.array([here[1:]]), np.array([later[0][1:]])
        return [here, later[0]] if _lines_free(free_start(blocked, floor, here[1:]), floor, a, b)[0] else [here]

    def _rest(self, blocked: Mask, floor: Floor, here: tuple[float, float, float]) -> Trajectory | None:
        """What is left of the last trajectory, if the map allows it."""
        rest = [here, *(point for point in self.trajectory if point[0] > here[0] + 1e-9)]
        points = np.array(rest)[:, 1:]
        blocked = free_start(blocked, floor, here[1:])
        return rest if _lines_free(blocked, floor, points[:-1], points[1:]).all() else None
