"""The memory in the map: an object that nobody sees now keeps its cells until it is seen elsewhere, has left, or is gone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib import formats
from occlib.geometry import Floor, Rig
from occlib.mapping import (
    BLIND,
    DISAGREE,
    EDGE,
    EDGE_M,
    FREE,
    NOT_SEEN,
    OCCUPIED,
    ONE_VIEW,
    REASONS,
    UNKNOWN,
    Remembered,
    instant_map,
)
from occlib.memory import FootprintMemory
from occlib.pipeline import FrameResult, Pipeline, Settings, backgrounds_of, settings_for
from occlib.recordings import LAB, open_recording
from occlib.tracking import ObjectVector

Array = np.ndarray[Any, Any]
Draw = Callable[[Sequence[Any]], dict[str, Array]]
AND, RECOMMENDED = settings_for("and"), settings_for()
BLUE = (20, 20, 60)
FLOOR = Floor((0.0, 2.0), (0.0, 1.0), 0.1)  # 10 x 20 cells


def square(x: float, y: float, colour: tuple[int, int, int] = (120, 20, 20), side: float = 0.4) -> SimpleNamespace:
    """An upright box for the ``draw`` fixture."""
    half = side / 2
    footprint = [[x + half * i, y + half * j] for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return SimpleNamespace(x=x, y=y, height=0.3, colour=colour, footprint=footprint)


def under(floor: Floor, box: Any) -> Array:
    """Cells whose centre a box stands on."""
    return floor.polygon_mask(box.footprint)


def play(pipeline: Pipeline, draw: Draw, instants: Sequence[Sequence[Any]]) -> list[FrameResult]:
    """The results of boxes drawn one instant after the other, ten a second."""
    return [pipeline.process(draw(boxes), k / 10) for k, boxes in enumerate(instants)]


def ids(objects: Sequence[Any]) -> list[int]:
    return sorted(one.id for one in objects)


# --- footprints remembered --------------------------------------------------------------------------------
def labelled(*boxes: tuple[slice, slice]) -> Array:
    labels = np.zeros(FLOOR.shape, np.int32)
    for number, (rows, columns) in enumerate(boxes, start=1):
        labels[rows, columns] = number
    return labels


def at(identity: int, x: float, y: float) -> ObjectVector:
    return ObjectVector(identity, (x, y), (0.0, 0.0), 0.06, (0, 0, 0))


BOX = labelled((slice(4, 6), slice(2, 5)))  # the middle is at (0.35, 0.5) m
NOBODY = np.zeros(FLOOR.shape, np.int32)


def test_the_footprint_of_what_coasts_is_where_it_is_expected_and_on_the_way_there() -> None:
    memory = FootprintMemory(FLOOR)
    assert memory.update(BOX, [at(7, 0.35, 0.5)], []) is None
    for shift in (1, 2, 5):  # cells along x
        held = memory.update(NOBODY, [], [at(7, 0.35 + 0.1 * shift, 0.5)])
        assert held is not None
        np.testing.assert_array_equal(held.expected, np.roll(BOX, shift, axis=1) > 0)
        np.testing.assert_array_equal(held.way, labelled((slice(4, 6), slice(2, 5 + shift))) > 0)
    assert memory.update(NOBODY, [], []) is None  # seen again, or gone
    assert memory.update(NOBODY, [], [at(7, 0.35, 0.5)]) is None


def test_a_footprint_moves_across_both_axes_and_ends_at_the_edge_of_the_floor() -> None:
    memory = FootprintMemory(FLOOR)
    memory.update(BOX, [at(1, 0.35, 0.5)], [])
    held = memory.update(NOBODY, [], [at(1, 0.15, 0.1)])  # 2 cells to the left, 4 down
    assert held is not None
    np.testing.assert_array_equal(held.expected, labelled((slice(0, 2), slice(0, 3))) > 0)
    assert held.way[held.expected].all() and held.way[BOX > 0].all()
    for (x, y), cells in {(0.05, 0.0): (1, 2), (1.95, 0.5): (2, 2), (0.35, 1.0): (1, 3), (0.35, 1.4): (0, 0)}.items():
        cut = memory.update(NOBODY, [], [at(1, x, y)])
        assert cut is not None and cut.expected.sum() == cells[0] * cells[1] and cut.way[BOX > 0].all()


def test_each_object_has_its_own_footprint_and_the_last_one_that_was_seen() -> None:
    two = labelled((slice(0, 2), slice(0, 2)), (slice(6, 9), slice(10, 14)))
    memory = FootprintMemory(FLOOR)
    memory.update(BOX, [at(5, 0.35, 0.5)], [])
    memory.update(two, [at(3, 0.1, 0.1), at(5, 1.2, 0.75)], [])
    held = memory.update(BOX, [at(3, 0.35, 0.5)], [at(5, 1.2, 0.75)])  # the other one is seen, elsewhere
    assert held is not None
    np.testing.assert_array_equal(held.expected, two == 2)
    held = memory.update(NOBODY, [], [at(5, 1.2, 0.75), at(3, 0.35, 0.5)])
    assert held is not None
    np.testing.assert_array_equal(held.expected, (two == 2) | (BOX > 0))


def test_an_object_without_a_footprint_has_none_to_remember() -> None:
    memory = FootprintMemory(FLOOR)
    memory.update(NOBODY, [at(1, 0.3, 0.3)], [])
    assert memory.update(NOBODY, [], [at(1, 0.3, 0.3), at(2, 0.5, 0.5)]) is None  # 2 has never been seen


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.tuples(st.floats(0, 2), st.floats(0, 1)))
def test_the_way_joins_where_it_was_to_where_it_is_expected(seed: int, to: tuple[float, float]) -> None:
    """Cell by cell against a footprint moved by hand, at every point of a fine sampling of the way."""
    iy, ix = np.nonzero(cells(seed, 0.03))
    labels = np.zeros(FLOOR.shape, np.int32)
    labels[iy, ix] = 1
    memory = FootprintMemory(FLOOR)
    memory.update(labels, [at(1, 1.0, 0.5)], [])
    held = memory.update(NOBODY, [], [at(1, *to)])
    if held is None:
        assert not len(iy)
        return
    shift = np.rint([(to[0] - 1.0) / 0.1, (to[1] - 0.5) / 0.1])
    for part in np.linspace(0, 1, 101):
        x, y = ix + shift[0] * part, iy + shift[1] * part
        inside = (x > -0.5) & (x < FLOOR.shape[1] - 0.5) & (y > -0.5) & (y < FLOOR.shape[0] - 0.5)
        rows, columns = np.rint(y[inside]).astype(int), np.rint(x[inside]).astype(int)
        places = set(zip(rows.tolist(), columns.tolist(), strict=True))
        assert all(held.way[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2].any() for r, c in places)
        if part == 1:
            assert set(zip(*np.nonzero(held.expected), strict=True)) == places
            assert held.way[held.expected].all()


# --- the map of one instant -------------------------------------------------------------------------------
def cells(seed: int, share: float) -> Array:
    return np.random.default_rng(seed).random(FLOOR.shape) < share


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sets(st.sampled_from(["left", "right"])))
def test_no_cell_of_what_coasts_or_is_seen_is_free_and_nothing_else_changes(seed: int, trusted: set[str]) -> None:
    """Whatever the views say, wherever they look, and whichever of them can be trusted."""
    views = {name: cells(seed + i, 0.3) for i, name in enumerate(sorted(trusted))}
    visible = {name: cells(seed + 5 + i, 0.8) for i, name in enumerate(("left", "right"))}
    labels = np.where(cells(seed + 10, 0.1), 1, 0).astype(np.int32)
    new, fused = cells(seed + 11, 0.1) & (labels == 0), cells(seed + 12, 0.2)
    way = cells(seed + 13, 0.2)
    held = Remembered(way & cells(seed + 14, 0.6), way)
    given_ = (labels, new, fused, views, visible, 2, FLOOR)
    (before, why), (grid, reason) = instant_map(*given_), instant_map(*given_, held)
    assert not (grid.data[way] == FREE).any() and (grid.data[labels > 0] == OCCUPIED).all()
    np.testing.assert_array_equal(grid.data == UNKNOWN, reason > 0)
    beside = (reason == EDGE) & (why != EDGE)  # floor beside what coasts is the only other that changes
    assert FLOOR.near(way, EDGE_M)[beside].all() and not (way & beside).any() and (why[beside] == 0).all()
    np.testing.assert_array_equal(grid.data[~way & ~beside], before.data[~way & ~beside])
    np.testing.assert_array_equal(reason[~way & ~beside], why[~way & ~beside])
    kept = way & (why > 0) & (why != EDGE) & (grid.data == UNKNOWN)
    assert (reason[kept] == why[kept]).all()
    bare = np.any([visible[name] & ~views[name] for name in views], axis=0) if views else np.zeros(FLOOR.shape, bool)
    np.testing.assert_array_equal(grid.data == OCCUPIED, (labels > 0) | (held.expected & ~bare))


def test_what_coasts_is_occupied_where_no_view_sees_bare_floor_and_else_not_seen_now() -> None:
    everywhere, nothing = np.ones(FLOOR.shape, bool), np.zeros(FLOOR.shape, bool)
    left = nothing.copy()
    left[:, :3] = True  # foreground of the left view
    expected = BOX > 0  # columns 2 to 4
    both = {"left": everywhere, "right": everywhere}
    views = {"left": left, "right": left}
    grid, reason = instant_map(NOBODY, nothing, nothing, views, both, 2, FLOOR, Remembered(expected, expected))
    assert grid.data[4, 2:7].tolist() == [OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN, FREE]
    assert reason[4, 1:7].tolist() == [DISAGREE, 0, NOT_SEEN, NOT_SEEN, EDGE, 0]
    views = {"left": left, "right": nothing}  # one view that sees bare floor may be the one that is wrong
    grid, reason = instant_map(NOBODY, nothing, nothing, views, both, 2, FLOOR, Remembered(expected, expected))
    assert reason[4, :7].tolist() == [0, EDGE, NOT_SEEN, NOT_SEEN, NOT_SEEN, EDGE, 0]
    assert REASONS[NOT_SEEN] == "not seen now"


def test_without_any_view_what_coasts_is_occupied_and_all_else_is_blind() -> None:
    expected, nothing = BOX > 0, np.zeros(FLOOR.shape, bool)
    way = labelled((slice(4, 6), slice(0, 5))) > 0
    visible = {"left": np.ones(FLOOR.shape, bool)}
    grid, reason = instant_map(NOBODY, nothing, nothing, {}, visible, 1, FLOOR, Remembered(expected, way))
    np.testing.assert_array_equal(grid.data == OCCUPIED, expected)
    assert (reason[~expected] == BLIND).all()


# --- sequences --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("settings", [RECOMMENDED, AND], ids=["recommended", "and"])
@pytest.mark.parametrize("blink", [1, 3])
@pytest.mark.parametrize("alone", [False, True])
def test_an_object_that_blinks_is_never_free_floor(
    tiny_rig: Rig, draw: Draw, settings: Settings, blink: int, alone: bool
) -> None:
    """Another one goes on moving, or the floor is bare but for it."""
    stands = square(2.6, 2.1, BLUE)

    def instant(k: int) -> list[Any]:
        others = [] if alone else [square(0.8 + 0.05 * k, 0.9)]
        return [*others, stands] if not 4 <= k < 4 + blink else others

    results = play(Pipeline(tiny_rig, draw([]), settings), draw, [instant(k) for k in range(6 + blink)])
    own = ids(results[3].objects)[-1]
    place = under(tiny_rig.floor, stands)
    for k, result in enumerate(results):
        gone = 4 <= k < 4 + blink
        assert own in ids(result.coasting if gone else result.objects)
        assert len(result.objects) == (0 if alone else 1) + (not gone) and len(result.coasting) == gone
        assert (result.map.data[place] != FREE).mean() > 0.9 if not gone else not (result.map.data[place] == FREE).any()
        np.testing.assert_array_equal(result.map.data == UNKNOWN, result.reason > 0)
        if gone:  # both views say that there is nothing but floor: they are not believed
            assert (result.reason[results[3].labels == ids(results[3].objects).index(own) + 1] == NOT_SEEN).all()
            (coasting,) = result.coasting
            assert np.hypot(coasting.x - 2.6, coasting.y - 2.1) < 0.1 and coasting.area_m2 > 0
        else:
            assert not (result.reason == NOT_SEEN).any()


@pytest.mark.parametrize("settings", [RECOMMENDED, AND], ids=["recommended", "and"])
def test_what_moves_on_unseen_is_looked_for_on_its_way(tiny_rig: Rig, draw: Draw, settings: Settings) -> None:
    """It drives on at 1 m/s; the place where it was seen last is not free either, as it may have stopped there."""
    boxes = [square(0.8 + 0.1 * k, 1.5) for k in range(14)]
    shown = [[box] if not 8 <= k < 11 else [] for k, box in enumerate(boxes)]
    results = play(Pipeline(tiny_rig, draw([]), settings), draw, shown)
    for k in (8, 9, 10):
        for there in boxes[7 : k + 1]:
            covered = results[k].map.data[under(tiny_rig.floor, there)] != FREE
            assert covered.mean() > 0.9
    assert not (results[11].reason == NOT_SEEN).any()  # seen elsewhere: all of the way is free at once
    behind = under(tiny_rig.floor, square(1.5, 1.5, side=0.2)) & ~tiny_rig.floor.near(results[11].labels > 0, EDGE_M)
    assert behind.sum() > 8
    assert (results[10].reason[behind] == NOT_SEEN).all() and (results[11].map.data[behind] == FREE).all()
    assert ids(results[11].objects) == [1] and results[11].coasting == []


def test_an_object_seen_elsewhere_frees_its_cells_at_once(tiny_rig: Rig, draw: Draw) -> None:
    moved = [square(1.0, 1.5), square(1.0, 1.5), square(1.0, 1.5), square(1.45, 1.5)]
    results = play(Pipeline(tiny_rig, draw([])), draw, [[box] for box in moved])
    assert ids(results[-1].objects) == [1] and results[-1].coasting == []
    left_behind = under(tiny_rig.floor, square(0.95, 1.5, side=0.2))
    assert (results[-2].map.data[left_behind] == OCCUPIED).all() and (results[-1].map.data[left_behind] == FREE).all()


@pytest.mark.parametrize("settings", [RECOMMENDED, AND], ids=["recommended", "and"])
def test_an_object_that_leaves_the_floor_is_forgotten_there(tiny_rig: Rig, draw: Draw, settings: Settings) -> None:
    shown: list[list[Any]] = [[square(2.6 + 0.15 * k, 1.5)] for k in range(9)]  # up to 3.8 m; the floor ends at 4 m
    results = play(Pipeline(tiny_rig, draw([]), settings), draw, [*shown, [], [], [], []])
    beyond = [k for k in range(9, 13) if not results[k].coasting]
    assert beyond and beyond == list(range(beyond[0], 13))  # 4 m are passed soon, not after a second
    for k in beyond:
        assert (results[k].map.data == FREE).all() and not results[k].reason.any()


def test_the_memory_ends(tiny_rig: Rig, draw: Draw) -> None:
    settings = settings_for(max_missed_s=0.45)
    shown = [[square(1.2, 1.5)]] * 4 + [[]] * 7
    results = play(Pipeline(tiny_rig, draw([]), settings), draw, shown)
    there = under(tiny_rig.floor, square(1.2, 1.5))
    assert [bool(result.coasting) for result in results] == [False] * 4 + [True] * 4 + [False] * 3
    assert [bool((result.map.data[there] == FREE).any()) for result in results[4:]] == [False] * 4 + [True] * 3
    for result in results[-3:]:
        assert (result.map.data == FREE).all() and not result.reason.any()


def test_a_tracker_that_never_waits_leaves_the_map_without_a_memory(tiny_rig: Rig, draw: Draw) -> None:
    shown = [[square(1.2, 1.5)]] * 4 + [[]]
    result = play(Pipeline(tiny_rig, draw([]), settings_for(max_missed_s=0.0)), draw, shown)[-1]
    assert result.coasting == [] and (result.map.data == FREE).all()


def test_where_the_only_view_left_sees_something_what_coasts_is_occupied(tiny_rig: Rig, draw: Draw) -> None:
    """AND finds nothing with one view; before, all of the floor became unknown."""
    boxes = [square(1.0, 0.8), square(2.9, 2.2, BLUE)]
    pipeline = Pipeline(tiny_rig, draw([]), AND)
    first = pipeline.process(draw(boxes), 0.0)
    result = pipeline.process({**draw(boxes), "right": None}, 0.1)
    assert result.objects == [] and ids(result.coasting) == ids(first.objects)
    np.testing.assert_array_equal(result.map.data == OCCUPIED, first.labels > 0)
    assert (result.reason[first.labels == 0] == ONE_VIEW).all()


def test_what_is_hidden_from_every_view_stays_occupied(tiny_rig: Rig, draw: Draw) -> None:
    """A low box that the view on the left sees behind a high one: with that view alone nobody sees its floor."""
    low, high = square(2.6, 1.5, BLUE, side=0.25), square(1.6, 1.5, side=0.5)
    low.height, high.height = 0.1, 0.9
    images = draw([low, high])
    images["right"] = draw([high, low])["right"]
    pipeline = Pipeline(tiny_rig, draw([]))
    first = pipeline.process(images, 0.0)
    assert len(first.objects) == 2
    result = pipeline.process({**draw([high]), "right": None}, 0.1)
    hidden = min(first.objects, key=lambda one: one.area_m2)
    assert ids(result.coasting) == [hidden.id]
    assert (result.map.data[first.labels == 1 + first.objects.index(hidden)] == OCCUPIED).all()


def test_candidates_leave_nothing_behind(tiny_rig: Rig, draw: Draw) -> None:
    known = square(0.8, 0.8)
    shown = [[known]] * 3 + [[known, square(2.8, 2.0, BLUE)]] + [[known]] * 2
    results = play(Pipeline(tiny_rig, draw([])), draw, shown)
    for result in results[4:]:
        assert result.coasting == [] and not (result.reason == NOT_SEEN).any()
        assert (result.map.data[under(tiny_rig.floor, square(2.8, 2.0))] == FREE).all()


def test_the_same_blink_gives_the_same_map(tiny_rig: Rig, draw: Draw) -> None:
    shown = [[square(0.8 + 0.1 * k, 1.2), square(2.6, 2.1, BLUE)] if k not in (5, 6) else [] for k in range(9)]
    first, second = (play(Pipeline(tiny_rig, draw([])), draw, shown) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert one.map == other.map and one.coasting == other.coasting
        np.testing.assert_array_equal(one.reason, other.reason)


# --- the rendered laboratory ------------------------------------------------------------------------------
def without(rig: Rig, images: Mapping[str, Array], empty: Mapping[str, Array], true: Any, height: float) -> Any:
    """The pictures with the empty floor where an object is: as if it had the colour of the floor for once."""
    erased = {}
    for name, camera in rig.cameras.items():
        middle = np.mean(true.footprint, axis=0)
        outline = [middle + 1.6 * (np.array(corner) - middle) for corner in true.footprint]
        corners = [[x, y, z] for x, y in outline for z in (0.0, height)]
        hull = cv2.convexHull(np.rint(camera.project(corners)).astype(np.int32))
        mask = np.zeros(images[name].shape[:2], np.uint8)
        cv2.fillConvexPoly(mask, hull, 1)
        erased[name] = np.where(mask[..., None] > 0, empty[name], images[name])
    return erased


@pytest.mark.parametrize("settings", [RECOMMENDED, AND], ids=["recommended", "and"])
@pytest.mark.parametrize(("name", "lost"), [("drum", range(24, 25)), ("pack", range(23, 26))])
def test_a_robot_whose_evidence_is_erased_for_a_moment_is_not_driven_over(
    settings: Settings, name: str, lost: range
) -> None:
    recording = open_recording(LAB / "four_robots", ["left", "right"])
    truth = formats.load_truth(recording.path / "truth.json").frames
    backgrounds = backgrounds_of(recording)
    empty = {name: background.image for name, background in backgrounds.items()}
    usual, pipeline = (Pipeline(recording.rig, backgrounds, settings) for _ in range(2))
    for frame, images in recording.images(range(18, 28)):
        robot = next(true for true in truth[frame] if true.id == name)
        shown = without(recording.rig, images, empty, robot, 0.5) if frame in lost else images
        expected, result = (each.process(p, recording.time(frame)) for each, p in ((usual, images), (pipeline, shown)))
        for true in truth[frame]:  # as in every frame, no more than a rim is missing of any footprint
            assert (result.map.data[recording.rig.floor.polygon_mask(true.footprint)] == FREE).mean() <= 0.02
        assert ids([*result.objects, *result.coasting]) == ids(expected.objects)
        assert len(result.coasting) == (frame in lost) == (result.reason == NOT_SEEN).any()
        for one in result.coasting:
            assert np.hypot(one.x - robot.x, one.y - robot.y) < 0.1
