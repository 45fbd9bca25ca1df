"""Planning: paths as short as a naive search finds, robots that never touch, and a stop when something is in the way."""

from __future__ import annotations

import heapq
import itertools
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib.geometry import Floor
from occlib.robots.navigation import Navigator
from occlib.robots.paths import free_start, path_length_m, plan, shorten
from occlib.robots.reservations import Point, Reservations, Trajectory, position_at
from occlib.robots.timed import plan_timed

Array = np.ndarray[Any, Any]
UNIT = Floor((10.0, 18.0), (-3.0, 3.0), 1.0)  # 6 x 8 cells whose metres are not their numbers
ROOM = Floor((-2.0, 2.0), (-1.5, 1.5), 0.05)
EMPTY = np.zeros(ROOM.shape, bool)


def mask(*rows: str) -> Array:
    """A mask as it looks on a map with y up: ``#`` is blocked."""
    return np.array([[c == "#" for c in row] for row in rows])[::-1].copy()


def centre(floor: Floor, iy: int, ix: int) -> Point:
    return floor.x[0] + (ix + 0.5) * floor.resolution, floor.y[0] + (iy + 0.5) * floor.resolution


# --- paths on one map ------------------------------------------------------------------------------------
def naive_length(blocked: Array, start: tuple[int, int], goal: tuple[int, int]) -> float:
    """Dijkstra's algorithm over the eight neighbours, in cells."""
    best, queue = {start: 0.0}, [(0.0, start)]
    while queue:
        length, (iy, ix) = heapq.heappop(queue)
        if (iy, ix) == goal:
            return length
        for dy, dx in itertools.product((-1, 0, 1), repeat=2):
            cell = iy + dy, ix + dx
            inside = 0 <= cell[0] < blocked.shape[0] and 0 <= cell[1] < blocked.shape[1]
            if inside and not blocked[cell] and length + math.hypot(dy, dx) < best.get(cell, math.inf):
                best[cell] = length + math.hypot(dy, dx)
                heapq.heappush(queue, (best[cell], cell))
    return math.inf


@settings(max_examples=100, deadline=None)
@given(hnp.arrays(bool, UNIT.shape), st.integers(0, 47), st.integers(0, 47))
def test_paths_are_as_short_as_dijkstras(blocked: Array, start: int, goal: int) -> None:
    (sy, sx), (gy, gx) = divmod(start, 8), divmod(goal, 8)
    blocked[sy, sx] = blocked[gy, gx] = False
    before, expected = blocked.copy(), naive_length(blocked, (sy, sx), (gy, gx))
    path = plan(blocked, UNIT, centre(UNIT, sy, sx), centre(UNIT, gy, gx))
    assert np.array_equal(blocked, before)
    if path is None:
        assert expected == math.inf
        return
    assert path_length_m(path) == pytest.approx(expected)
    assert path[0].tolist() == [*centre(UNIT, sy, sx)] and path[-1].tolist() == [*centre(UNIT, gy, gx)]
    ix, iy = UNIT.cells(path).round().astype(int).T
    assert not blocked[iy, ix].any() and (np.abs(np.diff(path, axis=0)).max(axis=1, initial=1.0) == 1.0).all()


def test_the_way_through_a_planted_maze() -> None:
    blocked = mask(
        "..#.....",
        "#.#.###.",
        "..#...#.",
        ".##.#.#.",
        "....#.#.",
        "####..#.",
    )
    path = plan(blocked, UNIT, (10.5, 2.5), (17.5, -2.5))
    assert path is not None and path_length_m(path) == pytest.approx(naive_length(blocked, (5, 0), (0, 7)))
    blocked[5, 4] = True  # the top is the only way round
    assert plan(blocked, UNIT, (10.5, 2.5), (17.5, -2.5)) is None


def test_clearance_prefers_the_middle() -> None:
    blocked = np.zeros((21, 40), bool)
    blocked[[0, -1]] = True
    floor = Floor((0.0, 4.0), (0.0, 2.1), 0.1)
    ends = (0.05, 0.15), (3.95, 0.15)
    hugging, clear = plan(blocked, floor, *ends), plan(blocked, floor, *ends, clearance_m=0.5)
    assert hugging is not None and clear is not None
    assert np.ptp(hugging[:, 1]) == 0 and clear[:, 1].max() >= 0.5
    assert path_length_m(clear) > path_length_m(hugging)


def test_a_robot_too_near_to_an_obstacle_may_leave() -> None:
    blocked = np.zeros(ROOM.shape, bool)
    blocked[20:40, 30:50] = True
    start, goal = centre(ROOM, 30, 48), (1.5, 0.0)  # two cells inside
    path = plan(blocked, ROOM, start, goal)
    assert path is not None and path_length_m(path) <= math.dist(start, goal) + 0.1
    freed = free_start(blocked, ROOM, start)
    depth = ROOM.distance_m(~blocked)
    changed = blocked & ~freed
    assert changed[30, 48] and 1 < changed.sum() < 12
    assert depth[changed].max() <= depth[30, 48] + 1e-9 and not (freed & ~blocked).any()
    assert free_start(blocked, ROOM, (1.5, 0.0)) is blocked
    everything = np.ones(ROOM.shape, bool)
    assert (~free_start(everything, ROOM, start)).sum() == 1
    inside = (0.0, 0.0)
    with pytest.raises(ValueError, match=r"goal_m: expected a free cell, got a blocked one at \[0.0, 0.0\]"):
        plan(blocked, ROOM, (1.5, 0.0), inside)


def line_free(a: Array, b: Array, blocked: Array, floor: Floor, per_cell: int) -> bool:
    """Whether the straight line is free where it is looked at, so many times a cell."""
    (ax, ay), (bx, by) = ((point - (floor.x[0], floor.y[0])) / floor.resolution for point in (a, b))
    steps = max(1, math.ceil(per_cell * math.hypot(bx - ax, by - ay)))
    return not any(
        blocked[math.floor(ay + (by - ay) * k / steps), math.floor(ax + (bx - ax) * k / steps)]
        for k in range(steps + 1)
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_shortened_paths_are_shorter_and_free(seed: int) -> None:
    rng = np.random.default_rng(seed)
    floor = Floor((-1.0, 2.0), (0.0, 2.0), 0.125)  # of which every cell has an exact centre
    walls = np.zeros(floor.shape, bool)
    for y, x in rng.integers(0, (12, 20), (5, 2)):
        walls[y : y + 4, x : x + 3] = True
    grown = floor.near(walls, 0.13)  # lines are looked at every half a cell: they may cut a corner, not a cell
    start, goal = rng.choice(np.argwhere(~grown), 2).tolist()
    path = plan(grown, floor, centre(floor, *start), centre(floor, *goal))
    if path is None:
        return
    short = shorten(path, grown, floor)
    assert path_length_m(short) <= path_length_m(path) + 1e-9 and len(short) <= len(path)
    assert np.array_equal(short[[0, -1]], path[[0, -1]])
    for a, b in itertools.pairwise(short):
        assert line_free(a, b, walls, floor, 10)
        assert np.abs(b - a).max() < 0.13 or line_free(a, b, grown, floor, 2)  # a step of the path, or in sight


def test_shortening_an_octile_path_makes_it_straight() -> None:
    path = plan(EMPTY, ROOM, (-1.5, -1.0), (1.5, 0.2))
    assert path is not None
    assert shorten(path, EMPTY, ROOM).tolist() == path[[0, -1]].tolist()
    assert shorten(path[:1], EMPTY, ROOM).tolist() == path[:1].tolist()
    assert len(shorten(np.empty((0, 2)), EMPTY, ROOM)) == 0
    assert path_length_m([]) == path_length_m([(1, 2)]) == 0


# --- other robots ----------------------------------------------------------------------------------------
def distance_kept(one: Sequence[Any], other: Sequence[Any], start: float, end: float, samples: int = 4000) -> float:
    """Least distance of two centres, by looking often."""
    times = np.linspace(start, end, samples)
    (x1, y1), (x2, y2) = ([np.interp(times, *np.array(path).T[[0, k]]) for k in (1, 2)] for path in (one, other))
    return float(np.hypot(x1 - x2, y1 - y2).min())


def random_trajectory(rng: np.random.Generator, points: int) -> Trajectory:
    times = np.cumsum(rng.uniform(0.2, 1.5, points)) - 1.0
    return [(float(t), *rng.uniform(-1, 1, 2).tolist()) for t in times]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_clear_is_exact_between_the_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    own, other = random_trajectory(rng, 4), random_trajectory(rng, 5)
    kept = distance_kept(own, other, own[0][0], 9.0)
    now = math.dist(own[0][1:], position_at(other, own[0][0]))
    assume(kept > 0.03 and not 1e-9 < now - kept < 0.01)
    others = Reservations()
    others.reserve("B", other, kept / 2)
    assert others.clear(own, kept / 2 - 0.01)
    assert others.clear(own, kept / 2 + 0.01) == (now - kept < 1e-8)  # who is too close already may stay as close


def test_reservations_are_replaced_released_and_sorted() -> None:
    others = Reservations()
    others.reserve("B", [(0, 0, 0)], 0.2, intention=[(0, 0, 0), (1, 1, 0)])
    others.reserve("C", [(0, 5, 0)], 0.3)
    others.reserve("C", [(0, 1, 1), (2, 3, 1)], 0.3)
    assert others.discs(1.0) == [(0.0, 0.0, 0.2), (2.0, 1.0, 0.3)]
    assert others.higher().discs(0.0) == [(0.0, 0.0, 0.2)]
    count = [len(group.gaps((9, 9), 0.0, 0.1)) for group in (others, others.higher(), others.firm())]
    assert count == [3, 2, 2]
    others.release("B")
    others.release("nobody")
    assert others.discs(0.0) == [(1.0, 1.0, 0.3)]


# --- space and time --------------------------------------------------------------------------------------
SMALL = Floor((0.0, 0.8), (0.0, 0.6), 0.02)
STEP: dict[str, Any] = {"speed_mps": 0.15, "dt_s": 1.0, "cell_m": 0.1}


def naive_places(blocked: Array, start: Point, goal: Point) -> tuple[list[Point], dict[int, list[int]]]:
    """Centres of free 0.1 m cells, then start and goal; and which of them a free line of 0.15 m or less joins."""
    places = [(0.05 + 0.1 * i, 0.05 + 0.1 * j) for j in range(6) for i in range(8)] + [start, goal]

    def free(a: Point, b: Point) -> bool:
        steps = max(1, math.ceil(2 * math.dist(a, b) / 0.02))
        cells = [[math.floor((a[k] + (b[k] - a[k]) * s / steps) / 0.02) for k in (1, 0)] for s in range(steps + 1)]
        return not any(blocked[iy, ix] for iy, ix in cells)

    near = {
        i: [j for j, b in enumerate(places) if j != i and math.dist(a, b) <= 0.15 + 1e-9 and free(a, b)]
        for i, a in enumerate(places)
    }
    return places, near


def weight(places: list[Point], i: int, j: int) -> float:
    """A step costs 1 and a little for its length; standing at the goal, the last place, costs nothing."""
    return (0.0 if i == len(places) - 1 else 1.0) if i == j else 1 + 1e-3 * math.dist(places[i], places[j]) / 0.15


def naive_to_go(places: list[Point], near: dict[int, list[int]]) -> dict[int, float]:
    """Cost to the goal from wherever there is a way, by Dijkstra's algorithm."""
    goal = len(places) - 1
    to_go, queue = {goal: 0.0}, [(0.0, goal)]
    while queue:
        cost, i = heapq.heappop(queue)
        for j in near[i]:
            if cost + weight(places, i, j) < to_go.get(j, math.inf):
                to_go[j] = cost + weight(places, i, j)
                heapq.heappush(queue, (to_go[j], j))
    return to_go


def naive_cost(places: list[Point], near: dict[int, list[int]], other: Trajectory, gap: float, steps: int) -> float:
    """A* in space and time with a priority queue; what is beyond the last step as if nobody were there."""
    start, to_go = len(places) - 2, naive_to_go(places, near)
    best, states = {(0, start): 0.0}, [(to_go.get(start, math.inf), 0, start)]
    while states:
        estimate, step, i = heapq.heappop(states)
        if step == steps or estimate == math.inf:
            return estimate
        for j in [i, *near[i]]:
            own = [(step, *places[i]), (step + 1, *places[j])]
            cost = best[step, i] + weight(places, i, j)
            if cost < best.get((step + 1, j), math.inf) and distance_kept(own, other, step, step + 1, 41) >= gap:
                best[step + 1, j] = cost
                heapq.heappush(states, (cost + to_go.get(j, math.inf), step + 1, j))
    return math.inf


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_timed_plans_cost_what_a_naive_a_star_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocked, steps = np.zeros(SMALL.shape, bool), 12
    for y, x in rng.integers(0, (24, 30), (3, 2)):
        blocked[y : y + 7, x : x + 10] = True
    free = [centre(SMALL, *cell) for cell in np.argwhere(~blocked).tolist()]
    start, goal, *way = (free[k] for k in rng.choice(len(free), 5, replace=False))
    other: Trajectory = [(2.5 * k, *place) for k, place in enumerate(way) if k or math.dist(start, place) > 0.11]
    others = Reservations()
    others.reserve("B", other, 0.05)
    assume_apart = math.dist(start, position_at(other, 0.0)) > 0.1
    places, near = naive_places(blocked, start, goal)
    expected = naive_cost(places, near, other, 0.1 - 1e-6, steps) if assume_apart else math.inf
    made = plan_timed(blocked, SMALL, start, goal, radius_m=0.05, reservations=others, horizon_s=steps, **STEP)
    if made is None or expected == math.inf:
        assert expected == math.inf
        return
    assert others.clear(made, 0.05)
    last_first = range(len(places) - 1, -1, -1)  # the start and the goal may be centres of cells, too
    indices = [min(last_first, key=lambda i: math.dist(places[i], point[1:])) for point in made]
    indices += [indices[-1]] * (steps + 1 - len(indices))
    total = sum(weight(places, i, j) for i, j in itertools.pairwise(indices)) + naive_to_go(places, near)[indices[-1]]
    assert total == pytest.approx(expected, abs=1e-9)
    assert all(j == i or j in near[i] for i, j in itertools.pairwise(indices))


def alone(blocked: Array, start: Point, goal: Point, others: Reservations | None = None, **more: Any) -> Any:
    options = {"speed_mps": 0.3, "dt_s": 0.5, "radius_m": 0.2, **more}
    return plan_timed(blocked, ROOM, start, goal, reservations=others, **options)


def test_a_timed_plan_is_quick_and_within_the_speed() -> None:
    before = EMPTY.copy()
    made = alone(EMPTY, (-1.53, 0.02), (1.5, 0.0), start_time_s=7.25, dt_s=1.0, horizon_s=20.0)
    t, x, y = np.array(made).T
    assert made[0] == (7.25, -1.53, 0.02) and made[-1][1:] == (1.5, 0.0)
    assert np.allclose(np.diff(t), 1.0) and len(made) - 1 == math.ceil(3.03 / 0.3)
    assert np.hypot(np.diff(x), np.diff(y)).max() <= 0.3 + 1e-9
    assert np.array_equal(EMPTY, before)


def test_beyond_the_horizon_the_true_distance_leads() -> None:
    """A wall with the gap far off: going straight at it would look good to the eye."""
    blocked = EMPTY.copy()
    blocked[10:, 40:44] = True  # the only gap is at the bottom
    made = alone(blocked, (-0.3, 1.0), (0.6, 1.0), horizon_s=4.0)
    assert made[-1][2] < 0.4 and len(made) == 9


def test_two_may_not_change_places() -> None:
    """Points on the same two cells at the same two times, apart at each, would meet in the middle."""
    corridor = np.ones(ROOM.shape, bool)
    corridor[29:31] = False
    others = Reservations()
    others.reserve("B", [(0.0, 0.25, 0.0), (0.5, 0.15, 0.0), (20.0, 0.15, 0.0)], 0.01)
    made = alone(corridor, (0.15, 0.0), (1.5, 0.0), others, radius_m=0.01)
    assert made is None or others.clear(made, 0.01)
    assert made is None or made[1][1:] != (0.25, 0.0)
    free = alone(EMPTY, (0.15, 0.0), (1.5, 0.0), others, radius_m=0.01)
    assert free is not None and others.clear(free, 0.01) and free[-1][1:] == (1.5, 0.0)


def test_who_cannot_get_there_waits() -> None:
    ring = EMPTY.copy()
    ring[20:40, 50] = ring[20:40, 70] = ring[20, 50:71] = ring[40, 50:71] = True
    assert alone(ring, (-1.0, 0.0), (1.0, 0.0)) == [(0.0, -1.0, 0.0)]  # walled in
    inside = ring.copy()
    inside[20:40, 50:70] = True
    assert alone(inside, (-1.0, 0.0), (1.0, 0.0)) == [(0.0, -1.0, 0.0)]  # blocked


def test_who_is_in_the_way_steps_aside_and_comes_back() -> None:
    others = Reservations()
    others.reserve("B", [(0.0, -1.5, 0.0), (10.0, 1.5, 0.0)], 0.2)
    made = alone(EMPTY, (0.0, 0.0), (0.0, 0.0), others, horizon_s=15.0)
    assert max(abs(y) for _, _, y in made) >= 0.3 and made[-1][1:] == (0.0, 0.0)
    assert others.clear(made, 0.2)


def test_visits_between_two_steps_are_seen() -> None:
    others = Reservations()
    others.reserve("B", [(0.0, 0.0, 1.2), (3.0, 0.0, 1.2), (3.25, 0.0, 0.0), (3.5, 0.0, 1.2)], 0.2)
    made = alone(EMPTY, (0.1, 0.0), (0.1, 0.0), others)
    assert made is not None and len(made) > 1 and others.clear(made, 0.2)


def test_none_if_there_is_no_escape() -> None:
    cell = np.ones(ROOM.shape, bool)
    cell[29:31, 39:41] = False
    others = Reservations()
    others.reserve("B", [(0.0, -1.5, 0.0), (10.0, 1.5, 0.0)], 0.2)
    assert alone(cell, (0.0, 0.0), (0.0, 0.0), others) is None


def test_who_touches_already_may_only_move_away() -> None:
    others = Reservations()
    others.reserve("B", [(0.0, 0.3, 0.0)], 0.2)
    made = alone(EMPTY, (0.0, 0.0), (-1.0, 0.0), others)
    assert made is not None and made[-1][1:] == (-1.0, 0.0)
    across = alone(EMPTY, (0.0, 0.0), (1.0, 0.0), others)
    assert across is not None and distance_kept(across, [(0.0, 0.3, 0.0)], 0, 12) >= 0.3 - 1e-6


def test_nobody_stops_where_another_will_pass_after_the_horizon() -> None:
    others = Reservations()
    others.reserve("B", [(0.0, 0.0, 1.2), (30.0, 0.0, 1.2), (40.0, 0.0, -1.2)], 0.2)
    made = alone(EMPTY, (-1.0, 0.0), (0.0, 0.0), others, horizon_s=10.0)
    assert made is not None and others.clear(made, 0.2) and math.hypot(*made[-1][1:]) >= 0.35


# --- one robot -------------------------------------------------------------------------------------------
def picture(walls: Array, robots: Sequence[Point], radius: float = 0.2) -> Array:
    """The map that shows walls and robots alike."""
    y, x = np.mgrid[: ROOM.shape[0], : ROOM.shape[1]]
    data = np.where(walls, 100, 0).astype(np.int8)
    for place in robots:
        px, py = ((place[k] - (ROOM.x[0], ROOM.y[0])[k]) / 0.05 - 0.5 for k in (0, 1))
        data[np.hypot(x - px, y - py) * 0.05 < radius + 0.05] = 100
    return data


def robot(goal: Point, **more: Any) -> Navigator:
    return Navigator(goal, **{"radius_m": 0.2, "speed_mps": 0.3, **more})


def test_one_robot_drives_to_its_goal_at_a_fair_speed() -> None:
    walls = EMPTY.copy()
    walls[25:60, 38:42] = True
    navigator, place, way = robot((1.4, 0.8)), (-1.4, 0.8), []
    for k in range(400):
        data = picture(walls, [place])
        before = data.copy()
        trajectory = navigator.update(data, ROOM, place, Reservations(), 0.1 * k)
        assert np.array_equal(data, before) and not navigator.stopped
        way.append(place)
        if navigator.arrived and place == (1.4, 0.8):
            break
        place = navigator.position_at(0.1 * (k + 1))
    shortest = plan(ROOM.near(walls, 0.27), ROOM, (-1.4, 0.8), (1.4, 0.8))
    assert shortest is not None and place == (1.4, 0.8)
    assert path_length_m(way) < 1.1 * path_length_m(shorten(shortest, ROOM.near(walls, 0.27), ROOM)) + 0.1
    assert 0.1 * k < path_length_m(way) / 0.3 / 0.75  # three quarters of the speed that it may have
    assert ROOM.distance_m(walls)[tuple(ROOM.cells(way).round().astype(int).T[::-1])].min() >= 0.2
    assert json.loads(json.dumps(trajectory)) == [list(point) for point in trajectory]


def test_unknown_is_blocked_unless_allowed() -> None:
    data = np.zeros(ROOM.shape, np.int8)
    data[:, 38:42] = -1
    for allowed, end in ((False, -1.0), (True, 1.0)):
        navigator = robot((1.0, 0.0), unknown_free=allowed)
        made = navigator.update(data, ROOM, (-1.0, 0.0), Reservations(), 0.0)
        assert made[-1][1:] == (end, 0.0)
    navigator = robot((1.0, 0.0))
    made = navigator.update(data, ROOM, (0.0, 0.0), Reservations(), 0.0)  # it may leave what is unknown
    assert made[-1][1:] == (1.0, 0.0)


def test_values_in_between_count_from_a_threshold() -> None:
    data = np.zeros(ROOM.shape, np.int8)
    data[:, 38:42] = 60
    ends = [
        robot((1.0, 0.0), occupied_from=k).update(data, ROOM, (-1.0, 0.0), Reservations(), 0.0)[-1][1] for k in (60, 61)
    ]
    assert ends == [-1.0, 1.0]


def test_an_obstacle_that_comes_up_is_driven_round_or_stopped_at_once() -> None:
    navigator = robot((1.5, 0.0))
    navigator.update(picture(EMPTY, []), ROOM, (-1.5, 0.0), Reservations(), 0.0)
    place = navigator.position_at(1.0)
    walls = EMPTY.copy()
    walls[25:35, 30:33] = True  # in the way
    made = navigator.update(picture(walls, [place]), ROOM, place, Reservations(), 1.0)
    assert made[-1][1:] == (1.5, 0.0) and max(abs(y) for _, _, y in made) > 0.4
    walls[:, 20:23] = True  # from wall to wall, and where the step that it is in would end
    place = navigator.position_at(1.2)
    made = navigator.update(picture(walls, [place]), ROOM, place, Reservations(), 1.2)
    assert made == [(1.2, *place)]
    walls[:] = False
    assert navigator.update(picture(walls, [place]), ROOM, place, Reservations(), 1.4)[-1][1:] == (1.5, 0.0)


def test_when_nothing_is_clear_it_says_that_it_stopped() -> None:
    cell = np.ones(ROOM.shape, bool)
    cell[24:36, 34:46] = False
    others = Reservations()
    others.reserve("B", [(0.0, -1.5, 0.0), (10.0, 1.5, 0.0)], 0.2)
    navigator = robot((1.0, 0.0))
    made = navigator.update(picture(cell, []), ROOM, (0.0, 0.0), others, 0.0)
    assert made == [(0.0, 0.0, 0.0)] == navigator.intention and navigator.stopped


def test_other_robots_on_the_map_are_no_obstacles_but_reservations() -> None:
    others = Reservations()
    others.reserve("B", [(0.0, 0.0, 0.0), (4.0, 0.0, 1.2)], 0.2)  # about to leave the way
    corridor = np.ones(ROOM.shape, bool)
    corridor[22:38] = False
    corridor[22:, 32:48] = False
    data = picture(corridor, [(-1.5, 0.0), (0.0, 0.0)])
    made = robot((1.5, 0.0)).update(data, ROOM, (-1.5, 0.0), others, 0.0)
    assert made[-1][1:] == (1.5, 0.0) or made[-1][1] > 0.5
    assert others.clear(made, 0.2)
    alone_on_it = robot((1.5, 0.0)).update(data, ROOM, (-1.5, 0.0), Reservations(), 0.0)
    assert alone_on_it[-1][1] < -0.2  # nobody announced it: an obstacle


def test_it_makes_way_for_the_higher_where_the_lower_does_not_stand() -> None:
    walls = EMPTY.copy()
    walls[:22] = True  # there is room on one side only
    wanted = [(0.0, -1.5, 0.0), (10.0, 1.5, 0.0)]
    others = Reservations()
    others.reserve("higher", wanted[:1], 0.2, intention=wanted)
    others.reserve("lower", [(0.0, 0.0, 0.8)], 0.2)
    navigator = robot((0.0, 0.0), horizon_s=15.0)
    made = navigator.update(picture(walls, [(-1.5, 0.0), (0.0, 0.0), (0.0, 0.8)]), ROOM, (0.0, 0.0), others, 0.0)
    assert not others.clear(navigator.intention, 0.2)  # were the lower not there
    assert others.clear(made, 0.2) and distance_kept(made, wanted, 0.0, 15.0) >= 0.4 - 1e-5


def test_the_same_inputs_give_the_same_trajectory() -> None:
    def drive() -> list[Trajectory]:
        return run([((-1.5, 0.0), (1.5, 0.1)), ((1.5, 0.0), (-1.5, 0.0))], EMPTY, seconds=3.0).trajectories

    assert drive() == drive()


# --- several robots --------------------------------------------------------------------------------------
class Run:
    """Robots that drive as they announce, one update after the other, on a map that shows them all."""

    def __init__(self, robots: Sequence[tuple[Point, Point]]) -> None:
        self.places = [start for start, _ in robots]
        self.trajectories: list[Trajectory] = [[(0.0, *start)] for start in self.places]
        self.intentions = list(self.trajectories)
        self.closest = math.inf
        self.far = [0.0] * len(robots)  # greatest |y|
        self.seconds = 0.0
        self.arrived = False


def run(
    robots: Sequence[tuple[Point, Point]],
    walls: Array,
    *,
    seconds: float,
    tick: float = 0.3,
    noise: float = 0.0,
) -> Run:
    """``noise``: standard deviation in m of where a robot gets to, seen from where it announced to be."""
    rng = np.random.default_rng(0)
    navigators, state = [robot(goal) for _, goal in robots], Run(robots)
    while state.seconds < seconds and not all(navigator.arrived for navigator in navigators):
        data = picture(walls, state.places)
        ranks = sorted(range(len(robots)), key=lambda i: (navigators[i].arrived, i))
        for rank, i in enumerate(ranks):
            others = Reservations()
            for other_rank, j in enumerate(ranks):
                if i != j:
                    wish = state.intentions[j] if other_rank < rank else None
                    others.reserve(str(j), state.trajectories[j], 0.2, intention=wish)
            state.trajectories[i] = navigators[i].update(data, ROOM, state.places[i], others, state.seconds)
            state.intentions[i] = navigators[i].intention
            assert not navigators[i].stopped
        end = state.seconds + tick
        for one, other in itertools.combinations(state.trajectories, 2):
            state.closest = min(state.closest, distance_kept(one, other, state.seconds, end, 13))
        exact = [position_at(trajectory, end) for trajectory in state.trajectories]
        state.places = [(x + noise * rng.normal(), y + noise * rng.normal()) for x, y in exact]
        state.far = [max(far, abs(y)) for far, (_, y) in zip(state.far, state.places, strict=True)]
        state.seconds = end
    state.arrived = all(navigator.arrived for navigator in navigators)
    return state


def with_bay() -> Array:
    """A corridor too narrow for two, with one bay in the middle."""
    walls = np.ones(ROOM.shape, bool)
    walls[23:37] = False
    walls[37:52, 30:50] = False
    return walls


@pytest.mark.parametrize("other", [0.3, 1.5])
def test_robots_that_meet_in_a_corridor_use_the_bay(other: float) -> None:
    robots = [((-1.5, 0.0), (1.5, 0.0)), ((other, 0.0), (-1.5, 0.0))]
    state = run(robots, with_bay(), seconds=60.0)
    assert state.arrived
    assert max(state.far) > 0.3 and state.closest >= 0.4 - 1e-5
    if other == 0.3:  # the bay is near to the robot of lower priority: the other one drives straight on
        assert state.far[0] < 0.1


@pytest.mark.slow
def test_four_robots_cross_at_a_square() -> None:
    robots = [
        ((-1.5, 0.0), (1.5, 0.0)),
        ((1.5, 0.0), (-1.5, 0.0)),
        ((0.0, -1.2), (0.0, 1.2)),
        ((0.0, 1.2), (0.0, -1.2)),
    ]
    state = run(robots, EMPTY, seconds=40.0)
    assert state.arrived and state.seconds < 20.0
    assert 0.4 - 1e-5 <= state.closest < 0.5
    noisy = run(robots, EMPTY, seconds=40.0, noise=0.005)  # never stops, and keeps its distance but for the noise
    assert noisy.arrived and noisy.closest > 0.385


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_two_discs_ever_touch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walls = EMPTY.copy()
    for y, x in rng.integers((10, 15), (45, 60), (2, 2)):
        walls[y : y + 5, x : x + 4] = True
    places = np.argwhere(ROOM.distance_m(walls) > 0.4)
    starts, goals = (pick(rng, places), pick(rng, places))
    assume(starts is not None and goals is not None)
    assert starts is not None and goals is not None
    state = run(list(zip(starts, goals, strict=True)), walls, seconds=12.0, tick=0.47)
    assert state.closest >= 0.4 - 1e-5


def pick(rng: np.random.Generator, places: Array) -> list[Point] | None:
    """Four places at least 0.45 m apart, none nearer than 0.25 m to the rim."""
    chosen: list[Point] = []
    for iy, ix in rng.permutation(places).tolist():
        point = centre(ROOM, iy, ix)
        if abs(point[0]) < 1.75 and abs(point[1]) < 1.25 and all(math.dist(point, p) > 0.45 for p in chosen):
            chosen.append(point)
        if len(chosen) == 4:
            return chosen
    return None


# --- wrong arguments -------------------------------------------------------------------------------------
def test_wrong_points_masks_and_numbers_are_named() -> None:
    ends: Any = (0.0, 0.0), (1.0, 0.0)
    with pytest.raises(ValueError, match=r"blocked: expected bool \(60, 80\), got bool \(6, 8\)"):
        plan(np.zeros((6, 8), bool), ROOM, *ends)
    with pytest.raises(ValueError, match=r"blocked: expected bool \(60, 80\), got int8 \(60, 80\)"):
        shorten([(0, 0)], np.zeros(ROOM.shape, np.int8), ROOM)  # type: ignore[arg-type]
    call: Any
    for call in (plan, alone):
        first: Any = (EMPTY, ROOM) if call is plan else (EMPTY,)
        with pytest.raises(ValueError, match=r"start_m: expected a point on the floor, x \(-2.0, 2.0\)"):
            call(*first, (-2.1, 0.0), (1.0, 0.0))
        with pytest.raises(ValueError, match="goal_m: expected a point on the floor"):
            call(*first, (0.0, 0.0), (1.0, 1.6))
        with pytest.raises(ValueError, match=r"goal_m: expected \(x, y\) in m"):
            call(*first, (0.0, 0.0), (1.0, math.nan))
    with pytest.raises(ValueError, match="clearance_m: expected metres >= 0, got -1"):
        plan(EMPTY, ROOM, *ends, clearance_m=-1)
    for name in ("speed_mps", "dt_s", "radius_m", "horizon_s", "cell_m"):
        with pytest.raises(ValueError, match=f"{name}: expected a number > 0, got 0.0"):
            call(EMPTY, *ends, **{name: 0.0})
    with pytest.raises(ValueError, match=r"speed_mps: expected at least a cell of 0.1 m in 0.5 s, got 0.1 m/s"):
        alone(EMPTY, *ends, speed_mps=0.1)


def test_wrong_trajectories_are_named() -> None:
    others = Reservations()
    for points in ([], [(0, 0)], [(0, math.nan, 0)]):
        with pytest.raises(ValueError, match=r"trajectory: expected one or more \(t, x, y\)"):
            others.reserve("B", points, 0.2)
    with pytest.raises(ValueError, match="trajectory: expected times that rise"):
        others.reserve("B", [(0, 0, 0), (0, 1, 0)], 0.2)
    with pytest.raises(ValueError, match="radius_m: expected metres > 0, got 0"):
        others.reserve("B", [(0, 0, 0)], 0)
    assert not others.discs(0.0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("radius_m", 0.0, "expected a number > 0, got 0.0"),
        ("speed_mps", math.inf, "expected a number > 0, got inf"),
        ("margin_m", -0.1, "expected metres >= 0, got -0.1"),
        ("smear_m", math.nan, "expected metres >= 0, got nan"),
        ("occupied_from", 0, "expected 1 to 100, got 0"),
    ],
)
def test_wrong_settings_of_a_navigator_are_named(name: str, value: float, message: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: {message}"):
        robot((0.0, 0.0), **{name: value})


def test_a_navigator_names_what_does_not_fit() -> None:
    navigator = robot((1.0, 0.0))
    with pytest.raises(ValueError, match=r"data: expected int8 \(60, 80\), got int8 \(6, 8\)"):
        navigator.update(np.zeros((6, 8), np.int8), ROOM, (0.0, 0.0), Reservations(), 0.0)
    with pytest.raises(ValueError, match="start_m: expected a point on the floor"):
        navigator.update(picture(EMPTY, []), ROOM, (9.0, 0.0), Reservations(), 0.0)


@pytest.mark.parametrize("sides", [(3.0, 0.5), (0.5, 3.0)])
def test_a_step_may_be_longer_than_the_floor_is_wide(sides: tuple[float, float]) -> None:
    floor = Floor((0.0, sides[0]), (0.0, sides[1]), 0.05)
    start, goal = (0.25, 0.25), (sides[0] - 0.25, sides[1] - 0.25)
    found = plan_timed(np.zeros(floor.shape, bool), floor, start, goal, speed_mps=0.6, dt_s=1.0, radius_m=0.1)
    assert found is not None and found[-1][1:] == pytest.approx(goal)
