"""What a robot does with the map that it receives: plan, give way, drive (section 6.1 of the paper).

The paper leaves planning to the robots: "these parametric vectors are used by the robot of the environment in their
path planning and obstacle avoidance algorithms". Here: shortest paths on the inflated map (:mod:`occlib.robots.paths`),
and for several robots prioritised planning in space and time (:mod:`occlib.robots.timed`).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import Mask
from occlib.geometry import Floor
from occlib.robots.paths import free_start, lines_free
from occlib.robots.reservations import Point, Reservations, Trajectory, position_at
from occlib.robots.timed import plan_timed


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
        Planned to be free around the disc, so that a robot that is a little off its trajectory need not stop. To
        obstacles half a cell's diagonal comes on top.
    smear_m
        So much further than their discs the robots themselves may show on the map: there it is taken to be free.
    unknown_free
        Whether the robot may go where nothing is known. By default not: what no camera sees may be occupied. It may
        always leave such a place.
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
    Two robots whose trajectories are clear of each other stay apart if each updates on the others' newest
    announcements and drives as announced; before its first update a robot announces that it stands. A robot that stops
    at once, because an obstacle has come up, breaks its word; the others learn it at their next update.

    Safety does not depend on the priorities, so these may change at any time. Rank robots that have :attr:`arrived`
    below those that have not: one of the highest priority that stands at its goal in a corridor would never make way.
    Even so, prioritised planning is not complete: there are crowds that could pass each other and do not.
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
        return [here, later[0]] if lines_free(free_start(blocked, floor, here[1:]), floor, a, b)[0] else [here]

    def _rest(self, blocked: Mask, floor: Floor, here: tuple[float, float, float]) -> Trajectory | None:
        """What is left of the last trajectory, if the map allows it."""
        rest = [here, *(point for point in self.trajectory if point[0] > here[0] + 1e-9)]
        points = np.array(rest)[:, 1:]
        blocked = free_start(blocked, floor, here[1:])
        return rest if lines_free(blocked, floor, points[:-1], points[1:]).all() else None
