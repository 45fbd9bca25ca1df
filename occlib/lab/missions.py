"""Robots that drive by the broadcast map: does occlusion still matter for path planning? (section 6.1 of the paper)

Two wall cameras watch a floor with obstacles and robots. A station turns the silhouettes into a map, by one of
:data:`MAPS`, and broadcasts it; every robot is a process of its own that receives the maps through a real socket, plans
with :class:`occlib.robots.Navigator` and drives. The same missions are driven on every map, and what happens
is scored against what really stands on the floor. Silhouettes come from geometry (:mod:`occlib.lab.simulation`):
whatever goes wrong is the map's doing.

Each robot knows where it is itself, as by its wheels. Time is that of the simulation, so that the results do not depend
on the machine: each step waits for every robot's answer. Orders and answers are JSON, a line each, on the robots'
standard input and output.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from tqdm import tqdm

from occlib.base.arrays import FloatArray, Mask
from occlib.base.extras import pandas as pd
from occlib.base.intervals import t_interval
from occlib.explaining import Explainer, Explanation, footprints
from occlib.geometry import Floor
from occlib.lab.crowds import base_m, random_crowd, upright, wall_rig
from occlib.lab.scenes import SceneObject
from occlib.lab.simulation import Simulation, evidence_of, union
from occlib.live import Listener, Publisher
from occlib.mapping import MapData, occupancy_map
from occlib.robots import Navigator, Point, Reservations, Trajectory, path_length_m, plan, position_at, shorten

MAPS = ("truth", "one view", "and", "explain", "explain, unknown free")
"""What is broadcast: the true footprints; what the left camera alone cannot see as floor; AND; the objects that explain
both views, where what both see as foreground and no object explains is unknown. In the last, robots may enter unknown
cells."""


MISSION_FLOOR = Floor((-2.0, 2.0), (-1.5, 1.5), 0.04)
"""The lab's floor in cells of 4 cm, twice the usual: a map is sent and planned on at every step of every robot."""


RADIUS_M, HEIGHT_M, SPEED_MPS = 0.12, 0.3, 0.4
"""A robot is an upright cylinder."""


STEP_S = 0.5
"""Between two maps."""


TIME_LIMIT_S = 30.0
"""When a mission is given up, unless told otherwise."""


STANDSTILL_S = 2.0
"""When nobody has moved for so long, maps and announcements repeat, and a mission is given up."""


_ANSWER_S = 60.0


@dataclass(frozen=True)
class Mission:
    """Obstacles, and for each robot a start and a goal, ``(x, y)`` in m."""

    seed: int
    obstacles: tuple[SceneObject, ...]
    starts: tuple[Point, ...]
    goals: tuple[Point, ...]


@dataclass
class Outcome:
    """What became of a mission on one kind of map.

    Parameters
    ----------
    seed, map
        Which mission, on which of :data:`MAPS`.
    robots, finished
        How many there were, and how many got to their goals.
    collisions
        Robots that touched an obstacle, and pairs of robots that touched.
    length_ratio
        Driven by the robots that finished, over the shortest ways on the true map; NaN if none did.
    blocked_m2
        Free floor, without that under the robots, that the map called occupied or, unless robots may enter it, unknown;
        mean.
    time_s
        Simulated, until the end.
    paths
        For each robot where it was at each step, (n, 2) in m.
    first_map
        The first map that was broadcast, int8 (ny, nx).
    """

    seed: int
    map: str
    robots: int
    finished: int
    collisions: int
    length_ratio: float
    blocked_m2: float
    time_s: float
    paths: list[FloatArray] = field(repr=False)
    first_map: MapData = field(repr=False)


def random_mission(seed: int, *, robots: int = 3, obstacles: int = 5) -> Mission:
    """Random obstacles and missions that can be driven on the true map: starts and goals apart, 1.5 m or more to go.

    >>> random_mission(3) == random_mission(3)
    True
    """
    if robots < 1 or obstacles < 0 or seed < 0:
        raise ValueError(f"robots, obstacles, seed: expected >= 1, 0 and 0, got {robots}, {obstacles} and {seed}")
    rng = np.random.default_rng([seed, robots, obstacles])
    for _ in range(1000):
        crowd = random_crowd(obstacles, rng, floor=MISSION_FLOOR, gap=0.1)
        inner = np.add([MISSION_FLOOR.x, MISSION_FLOOR.y], [0.3, -0.3])
        ends = rng.uniform(inner[:, 0], inner[:, 1], (2 * robots, 2))
        cells = np.rint(MISSION_FLOOR.cells(ends)).astype(int)
        apart = [
            math.dist(a, b) for group in (ends[:robots], ends[robots:]) for i, a in enumerate(group) for b in group[:i]
        ]
        far = np.linalg.norm(ends[:robots] - ends[robots:], axis=1)
        if min(apart, default=1.0) < 0.6 or far.min() < 1.5:
            continue
        blocked = MISSION_FLOOR.near(_footprints(crowd), RADIUS_M + 0.15)
        if blocked[cells[:, 1], cells[:, 0]].any():
            continue
        ways = [plan(blocked, MISSION_FLOOR, a, b) for a, b in zip(ends[:robots], ends[robots:], strict=True)]
        if all(way is not None for way in ways):
            points = [(float(x), float(y)) for x, y in ends]
            return Mission(seed, crowd, tuple(points[:robots]), tuple(points[robots:]))
    raise ValueError(f"robots, obstacles: no room for {robots} and {obstacles}")


def run_missions(
    missions: Sequence[Mission],
    maps: Sequence[str] = MAPS,
    *,
    time_limit_s: float = TIME_LIMIT_S,
    progress: bool = False,
) -> list[Outcome]:
    """Drive every mission on every kind of map, robots as processes that listen to a real socket.

    A mission that takes longer than ``time_limit_s`` is given up; so is one in which nobody has moved for 2 s.

    Raises
    ------
    ValueError
        An unknown kind of map, or missions with different numbers of robots.
    """
    if unknown := [kind for kind in maps if kind not in MAPS]:
        raise ValueError(f"maps: expected some of {', '.join(MAPS)}, got {unknown[0]!r}")
    if len({len(mission.starts) for mission in missions}) != 1:
        raise ValueError("missions: expected one or more, with equally many robots")
    for mission in missions:
        ends = np.array([*mission.starts, *mission.goals], dtype=np.float64).reshape(-1, 2)
        inside = (
            (ends > (MISSION_FLOOR.x[0], MISSION_FLOOR.y[0])) & (ends < (MISSION_FLOOR.x[1], MISSION_FLOOR.y[1]))
        ).all()
        if not mission.starts or len(mission.starts) != len(mission.goals) or not inside:
            raise ValueError(f"missions: expected a start and a goal on the floor for each robot, got {ends.tolist()}")
    station = _Station()
    with Publisher() as publisher, _robots(len(missions[0].starts), publisher.address) as robots:
        jobs = [(mission, kind) for mission in missions for kind in maps]
        bar = tqdm(jobs, unit="drive", disable=None if progress else True)
        return [_drive(mission, kind, station, publisher, robots, time_limit_s) for mission, kind in bar]


def summary(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """A row for each kind of map: collisions in all, and means over the missions with the ends of their 95 % intervals.

    Columns: ``collisions``; ``arrive``, the share of robots that arrive; ``way``, over the shortest; ``refused (m²)``;
    and of the last three ``, low`` and ``, high``.
    """
    if not outcomes:
        raise ValueError("outcomes: expected one or more, got none")
    rows = {}
    for kind in dict.fromkeys(o.map for o in outcomes):
        own = [o for o in outcomes if o.map == kind]
        row: dict[str, float] = {"collisions": sum(o.collisions for o in own)}
        values = {
            "arrive": [o.finished / o.robots for o in own],
            "way": [o.length_ratio for o in own],
            "refused (m²)": [o.blocked_m2 for o in own],
        }
        for name, numbers in values.items():
            row[name], row[f"{name}, low"], row[f"{name}, high"] = t_interval(numbers)
        rows[kind] = row
    return pd.DataFrame(rows).T.astype({"collisions": int})


def drive_together(
    data: MapData, floor: Floor, ends_m: Mapping[str, tuple[Point, Point]], *, time_limit_s: float = TIME_LIMIT_S
) -> dict[str, FloatArray]:
    """Robots on one map that does not change, without sockets: where each is at every step, ``{name: (n, 2) in m}``.

    Parameters
    ----------
    data, floor
        int8 (ny, nx), without the robots on it.
    ends_m
        For each robot its start and its goal; the first has priority over the second, and so on.
    """
    brains = {name: Navigator(goal, radius_m=RADIUS_M, speed_mps=SPEED_MPS) for name, (_, goal) in ends_m.items()}
    tracks = {name: [start] for name, (start, _) in ends_m.items()}
    said: dict[str, dict[str, Any]] = {name: {"trajectory": [(0.0, *start)]} for name, (start, _) in ends_m.items()}
    for now in np.arange(0, time_limit_s, STEP_S).tolist():
        for name, brain in brains.items():
            others = _reservations(_announced(said, list(brains), name))
            trajectory = brain.update(data, floor, tracks[name][-1], others, now)
            said[name] = {"trajectory": trajectory, "intention": brain.intention}
        for name, track in tracks.items():
            track.append(position_at(said[name]["trajectory"], now + STEP_S))
    return {name: np.array(track) for name, track in tracks.items()}


class _Station:
    """Two cameras, and what each kind of map makes of their silhouettes."""

    def __init__(self) -> None:
        self.rig = wall_rig(2, floor=MISSION_FLOOR, size=(320, 240))
        self.simulation = Simulation(self.rig)
        self.explainer = Explainer(self.rig, self.simulation.settings)
        self.everywhere = np.ones(MISSION_FLOOR.shape, bool)
        self.explanation: Explanation | None = None

    def masks(self, crowd: Sequence[SceneObject]) -> dict[str, Mask]:
        return union(self.simulation.silhouettes(crowd))

    def map(self, kind: str, masks: dict[str, Mask], true: Mask) -> MapData:
        known = self.everywhere
        if kind == "truth":
            occupied = true
        elif kind == "one view":
            occupied = self.simulation.on_floor(masks)["left"]
        else:
            occupied = self.simulation.occupied(masks, "and")
        if kind.startswith("explain"):
            self.explanation = self.explainer.explain(evidence_of(masks), self.explanation)
            known, occupied = ~occupied, footprints(self.explanation.prisms, occupied, MISSION_FLOOR) > 0
        return occupancy_map(occupied, known, MISSION_FLOOR).data


def _footprints(crowd: Sequence[SceneObject]) -> Mask:
    """Cells under the objects."""
    return np.any(
        [np.zeros(MISSION_FLOOR.shape, bool), *(MISSION_FLOOR.polygon_mask(base_m(each)) for each in crowd)],
        axis=0,
    )


def _bodies(positions: Sequence[Point]) -> list[SceneObject]:
    return [upright("cylinder", at, 2 * RADIUS_M, HEIGHT_M, name=f"robot{i}") for i, at in enumerate(positions)]


def _drive(
    mission: Mission,
    kind: str,
    station: _Station,
    publisher: Publisher,
    robots: Sequence[_Robot],
    limit_s: float = TIME_LIMIT_S,
) -> Outcome:
    """One mission on one kind of map."""
    names, daring = list(range(len(mission.starts))), kind.endswith("unknown free")
    for k in names:
        robots[k].ask({"goal": mission.goals[k], "unknown_free": daring})
    station.explanation = None
    outlines = [each.footprint(0) for each in mission.obstacles]
    still, under = station.masks(mission.obstacles), _footprints(mission.obstacles)
    plans: list[dict[str, Any]] = [{"trajectory": [(0.0, *at)], "arrived": False} for at in mission.starts]
    positions, paths, blocked, now, moved = list(mission.starts), [[at] for at in mission.starts], [], 0.0, 0.0
    touched, first = set[tuple[int, int]](), None
    while now < limit_s and now - moved <= STANDSTILL_S and not all(p["arrived"] for p in plans):
        bodies = _bodies(positions)
        moving, true = station.masks(bodies), under | _footprints(bodies)
        data = station.map(kind, {name: still[name] | moving[name] for name in still}, true)
        wrong = (data > 0) | (data < 0) & (not daring)
        first = data if first is None else first
        blocked.append(float((wrong & ~true).sum()) * MISSION_FLOOR.cell_area)
        sequence = publisher.send(data, MISSION_FLOOR, [], time.time()).sequence
        rank = sorted(names, key=lambda k: plans[k]["arrived"])  # who has arrived makes way
        for k in rank:
            others = _announced(plans, rank, k)
            plans[k] = robots[k].ask({"sequence": sequence, "time": now, "position": positions[k], "others": others})
        touched |= _touching(outlines, [p["trajectory"] for p in plans], now)
        now += STEP_S
        ahead = [position_at(p["trajectory"], now) for p in plans]
        if any(math.dist(a, b) > 1e-6 for a, b in zip(ahead, positions, strict=True)):
            moved = now
        positions = ahead
        for path, at in zip(paths, positions, strict=True):
            path.append(at)
    done = [math.dist(at, goal) < 0.1 for at, goal in zip(positions, mission.goals, strict=True)]
    assert first is not None
    return Outcome(
        mission.seed,
        kind,
        len(names),
        sum(done),
        len(touched),
        _detour(mission, paths, done),
        float(np.mean(blocked)),
        now,
        [np.array(path) for path in paths],
        first,
    )


def _announced(said: Any, rank: Sequence[Any], own: Any) -> list[dict[str, Any]]:
    """What the other robots have said, for one of them: intentions only of those of higher rank."""
    place = rank.index(own)
    return [
        {
            "name": str(other),
            "trajectory": said[other]["trajectory"],
            "intention": said[other].get("intention") if i < place else None,
        }
        for i, other in enumerate(rank)
        if i != place
    ]


def _touching(outlines: Sequence[FloatArray], plans: Sequence[Trajectory], now: float) -> set[tuple[int, int]]:
    """Pairs that touch within the step: (robot, robot), or (robot, -1 - obstacle)."""
    found, ways = set(), [list[Point]() for _ in plans]
    for t in np.linspace(now, now + STEP_S, 11):
        places = [position_at(path, float(t)) for path in plans]
        for i, at in enumerate(places):
            found |= {(i, j) for j in range(i) if math.dist(at, places[j]) < 2 * RADIUS_M - 1e-3}
            ways[i].append(at)
    for i, way in enumerate(ways):
        found |= {(i, -1 - j) for j, outline in enumerate(outlines) if (_gaps(way, outline) < RADIUS_M - 1e-3).any()}
    return found


def _gaps(points: Sequence[Point], polygon: FloatArray) -> FloatArray:
    """Distance in m from each point to a convex polygon, (N,), 0 inside."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    to = np.asarray(points, dtype=float)[:, None] - polygon
    side = edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0]
    along = np.clip((to * edge).sum(axis=2) / (edge**2).sum(axis=1), 0, 1)
    gaps = np.linalg.norm(to - along[..., None] * edge, axis=2).min(axis=1)
    return np.where((side >= 0).all(axis=1) | (side <= 0).all(axis=1), 0.0, gaps)


def _detour(mission: Mission, paths: Sequence[Sequence[Point]], done: Sequence[bool]) -> float:
    """Length driven over the shortest on the true map, corners cut, of the robots that finished."""
    free = MISSION_FLOOR.near(_footprints(mission.obstacles), RADIUS_M)
    ways = [plan(free, MISSION_FLOOR, a, b) for a, b in zip(mission.starts, mission.goals, strict=True)]
    shortest = sum(
        path_length_m(shorten(way, free, MISSION_FLOOR))
        for way, ok in zip(ways, done, strict=True)
        if ok and way is not None
    )
    driven = sum(path_length_m(np.array(path)) for path, ok in zip(paths, done, strict=True) if ok)
    return driven / shortest if shortest else math.nan


class _Robot:
    """A robot's process: orders in, answers out."""

    def __init__(self, address: str) -> None:
        code = "import sys; from occlib.lab.missions import _robot; _robot(sys.argv[1])"
        command = [sys.executable, "-c", code, address]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8"
        )

    def ask(self, order: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(order) + "\n")
            self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise ValueError(f"robot: expected an answer, but its process ended ({self._process.wait()})")
        return dict(json.loads(answer))

    def close(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(BrokenPipeError):
                if pipe is not None:
                    pipe.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextmanager
def _robots(count: int, address: str) -> Iterator[list[_Robot]]:
    with ExitStack() as stack:
        robots = []
        for _ in range(count):
            robots.append(_Robot(address))
            stack.callback(robots[-1].close)
        yield robots


def _robot(address: str) -> None:
    """What a robot's process does until its standard input ends."""
    with Listener(address) as listener:
        message, navigator = None, None
        for line in sys.stdin:
            order = json.loads(line)
            if "goal" in order:
                navigator = Navigator(
                    tuple(order["goal"]), radius_m=RADIUS_M, speed_mps=SPEED_MPS, unknown_free=order["unknown_free"]
                )
                answer: dict[str, Any] = {}
            else:
                while message is None or message.sequence < order["sequence"]:
                    message = listener.receive(_ANSWER_S)
                    if message is None:
                        raise ValueError(f"no map for {_ANSWER_S} s")
                assert navigator is not None
                answer = _answer(navigator, message.data, message.floor, order)
            print(json.dumps(answer), flush=True)


def _reservations(announced: Sequence[dict[str, Any]]) -> Reservations:
    others = Reservations()
    for other in announced:
        others.reserve(other["name"], other["trajectory"], RADIUS_M, intention=other["intention"])
    return others


def _answer(navigator: Navigator, data: MapData, floor: Floor, order: dict[str, Any]) -> dict[str, Any]:
    others = _reservations(order["others"])
    navigator.update(data, floor, tuple(order["position"]), others, order["time"])
    return {"trajectory": navigator.trajectory, "intention": navigator.intention, "arrived": navigator.arrived}
