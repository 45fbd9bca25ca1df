"""Missions: real processes on a real socket, scored against what really stands on the floor."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from occlib import geometry
from occlib.lab import missions
from occlib.lab.crowds import upright
from occlib.lab.missions import MISSION_FLOOR, RADIUS_M, Mission, drive_together, random_mission, run_missions, summary

pytestmark = pytest.mark.slow

WALL = upright("box", (0.0, 0.0), (0.3, 0.8), 0.4, name="wall")
CROSSING = Mission(0, (WALL,), ((-1.0, 0.0), (1.0, 0.1)), ((1.2, 0.0), (-1.2, 0.1)))


@pytest.fixture(scope="module")
def outcomes() -> dict[str, missions.Outcome]:
    found = {outcome.map: outcome for outcome in run_missions([CROSSING])}
    assert robots_running() == []
    return found


def robots_running() -> list[psutil.Process]:
    """The processes of robots below this one, whatever else other tests have left."""
    found = []
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):  # ended, or a zombie: no robot that drives on
            if "occlib.lab.missions" in " ".join(child.cmdline()):
                found.append(child)
    return found


def test_what_other_tests_leave_is_no_robot() -> None:
    with subprocess.Popen([sys.executable, "-c", "pass"]) as zombie:
        while psutil.Process(zombie.pid).status() != psutil.STATUS_ZOMBIE:
            time.sleep(0.01)
        assert robots_running() == []


def test_two_robots_cross_behind_a_wall_on_the_maps_of_two_views(outcomes: dict[str, missions.Outcome]) -> None:
    assert list(outcomes) == list(missions.MAPS)
    for kind in ("truth", "and", "explain", "explain, unknown free"):
        outcome = outcomes[kind]
        assert (outcome.finished, outcome.robots, outcome.collisions) == (2, 2, 0), kind
        assert 0.95 < outcome.length_ratio < 1.3
        for path, start, goal in zip(outcome.paths, CROSSING.starts, CROSSING.goals, strict=True):
            assert tuple(path[0]) == start and math.dist(path[-1], goal) < 0.1


def test_one_view_crashes_nobody_and_refuses_floor(outcomes: dict[str, missions.Outcome]) -> None:
    assert outcomes["one view"].collisions == 0
    assert outcomes["one view"].blocked_m2 > 3 * outcomes["and"].blocked_m2 > 0
    assert outcomes["truth"].blocked_m2 == 0


def test_every_map_holds_the_wall(outcomes: dict[str, missions.Outcome]) -> None:
    wall = MISSION_FLOOR.polygon_mask(WALL.footprint(0))
    for outcome in outcomes.values():
        assert (outcome.first_map[MISSION_FLOOR.distance_m(~wall) > 1.5 * MISSION_FLOOR.resolution] != 0).all()
        assert (outcome.first_map[wall] != 0).mean() > 0.7  # the rim is a matter of pixels
        assert set(np.unique(outcome.first_map)) <= {-1, 0, 100}


def test_the_same_mission_ends_the_same(outcomes: dict[str, missions.Outcome]) -> None:
    (again,) = run_missions([CROSSING], ["and"])
    assert again.time_s == outcomes["and"].time_s
    assert all(np.array_equal(a, b) for a, b in zip(again.paths, outcomes["and"].paths, strict=True))


def test_collisions_are_seen_between_two_maps() -> None:
    outline = WALL.footprint(0)
    through = [(0.0, -0.4, 0.0), (0.5, 0.4, 0.0)]
    past = [(0.0, -0.4, 0.4 + RADIUS_M), (0.5, 0.4, 0.4 + RADIUS_M)]
    assert missions._touching([outline], [through, past], 0.0) == {(0, -1)}
    meeting = [(0.0, 0.4, 0.8), (0.5, -0.4, 0.8)]
    assert missions._touching([], [[(0.0, -0.4, 0.8), (0.5, 0.4, 0.8)], meeting], 0.0) == {(1, 0)}
    assert missions._gaps([(0.0, 0.0), (0.45, 0.0), (0.45, 0.8)], outline) == pytest.approx([0.0, 0.3, 0.5])


def test_random_missions_have_room() -> None:
    for seed in range(3):
        mission = random_mission(seed, robots=2, obstacles=4)
        assert len(mission.obstacles) == 4 and len(mission.starts) == len(mission.goals) == 2
        for start, goal in zip(mission.starts, mission.goals, strict=True):
            assert math.dist(start, goal) >= 1.5
            assert all((missions._gaps((start, goal), o.footprint(0)) > RADIUS_M).all() for o in mission.obstacles)
    with pytest.raises(ValueError, match="no room for 60 objects"):
        random_mission(0, obstacles=60)


def test_who_is_named_first_goes_first() -> None:
    floor = geometry.Floor((0.0, 4.0), (0.0, 1.2), 0.05)
    walls = np.full(floor.shape, 100, np.int8)
    walls[6:14] = 0
    walls[14:, 16:28] = walls[14:, 52:64] = 0
    ends = {"A": ((0.2, 0.5), (3.8, 0.5)), "B": ((3.8, 0.5), (0.2, 0.5))}
    for first, second in (("A", "B"), ("B", "A")):
        tracks = drive_together(walls, floor, {name: ends[name] for name in (first, second)})
        assert tracks[first][:, 1].max() < 0.65 < tracks[second][:, 1].max()  # the second turns into a bay
        assert np.linalg.norm(tracks["A"] - tracks["B"], axis=1).min() >= 2 * RADIUS_M
        assert all(math.dist(tracks[name][-1], ends[name][1]) < 0.05 for name in ends)


def test_summary_counts_and_averages(outcomes: dict[str, missions.Outcome]) -> None:
    one = outcomes["and"]
    other = missions.Outcome(1, "and", 2, 1, 3, math.nan, 0.5, 9.0, [], one.first_map)
    row = summary([one, other]).loc["and"]
    assert (row["collisions"], row["arrive"], row["way"]) == (3, 0.75, one.length_ratio)
    assert row["refused (m²), low"] < row["refused (m²)"] == (one.blocked_m2 + 0.5) / 2 < row["refused (m²), high"]


def test_wrong_arguments() -> None:
    with pytest.raises(ValueError, match="maps: expected some of truth, one view"):
        run_missions([CROSSING], ["two views"])
    with pytest.raises(ValueError, match="missions: expected one or more, with equally many robots"):
        run_missions([])
    for wrong in (
        Mission(0, (), (), ()),
        Mission(0, (), ((0.0, 0.0),), ()),
        Mission(0, (), ((9.0, 0.0),), ((0.0, 0.0),)),
    ):
        with pytest.raises(ValueError, match="missions: expected a start and a goal on the floor for each robot"):
            run_missions([wrong])
    with pytest.raises(ValueError, match="robots, obstacles, seed: expected"):
        random_mission(0, robots=0)
    with pytest.raises(ValueError, match="outcomes: expected one or more"):
        summary([])


def test_a_robot_that_dies_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    real = missions._Robot.ask

    def killed(self: missions._Robot, order: dict[str, object]) -> dict[str, object]:
        self._process.kill()
        return real(self, order)

    monkeypatch.setattr(missions._Robot, "ask", killed)
    with pytest.raises(ValueError, match="robot: expected an answer, but its process ended"):
        run_missions([CROSSING], ["truth"])
