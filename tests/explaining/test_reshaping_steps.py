"""The steps of reshaping one by one: tables around what is explained badly, one prism for several, two for one."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from helpers.prisms import (
    LEFT_RIGHT,
    THREE,
    Array,
    assert_found,
    floor_places,
    leg_masks,
    sample_masks,
    seen_from,
    shown,
    watch,
)
from occlib.explaining.evidence import PolarEvidence
from occlib.explaining.objective import gain, workspace
from occlib.explaining.prisms import BOX, ROUND, Prism, as_array, is_table, plausible, prism_at
from occlib.explaining.refining import COARSE_STEP_M, DEFAULT, refined
from occlib.explaining.reshaping import (
    AROUND,
    AROUND_STEP_M,
    TABLES,
    TABLES_M,
    TOP,
    WELL_SHAPED,
    _better_shape,
    _divided,
    _merged,
    _table,
    reshaped,
)
from occlib.explaining.search import explain


def typed(prism: Prism) -> Prism:
    """Of plain floats, as the compiled loops take it."""
    return Prism(*map(float, prism))


def room(prisms: Sequence[Prism], spare: int = 4) -> Array:
    """Prisms as an array with so many free rows."""
    return np.vstack([as_array(prisms, "prisms"), np.zeros((spare, 10))])


def listed(array: Array, count: int) -> list[Prism]:
    return [prism_at(array, i) for i in range(count)]


def on_legs(cameras: tuple[str, ...], table: Prism, legs: float = 0.0) -> PolarEvidence:
    """What shows its top, and of the legs this share of the columns."""
    at = watch(cameras)
    floor = leg_masks(at, table)
    columns = np.arange(floor.shape[2])
    floor[:, :, columns % 20 < 20 * legs] = False
    return shown(at, sample_masks(at, table) & ~floor)


# --- tables ----------------------------------------------------------------------------------------------------
DESK = Prism(0.1, 0.1, 0.5, 0.7, BOX, 0.4, 0.65, 0.92)


@pytest.mark.parametrize("form", [(0, 0), (0, 1), (1, 0), (1, 1), (1, 2), (1, 3)])
@pytest.mark.parametrize(("height", "i", "j"), [(0, 3, -3), (1, 0, 1), (2, -2, 0)])
def test_a_table_that_is_tried_is_found_where_it_stands(form: tuple[int, int], height: int, i: int, j: int) -> None:
    (half, ratio, turns), turn = TABLES[form[0]], form[1]
    assert turn < turns
    near = Prism(0.1, 0.1, 0.1, 0.2)
    table = Prism(
        near.x + i * AROUND_STEP_M,
        near.y + j * AROUND_STEP_M,
        half,
        TABLES_M[height],
        BOX,
        turn * np.pi / 4,
        ratio,
        TOP,
    )
    work = workspace(on_legs(THREE, table))
    assert tuple(_table(work, work.sums, typed(near), DEFAULT)) == pytest.approx(tuple(table))


@pytest.mark.parametrize("seed", [0, 1])
def test_the_table_around_a_prism_is_that_of_a_plain_search(seed: int) -> None:
    at, rng = watch(THREE), np.random.default_rng(seed)
    noise = np.stack([cv2.GaussianBlur(rng.normal(size=seen.shape), (0, 0), 15) for seen in at.seen])
    work = workspace(shown(at, noise > np.quantile(noise, 0.4)))
    prism = typed(Prism(*rng.uniform(-0.5, 0.5, 2), 0.2, 0.5))
    steps = AROUND_STEP_M * np.arange(-AROUND, AROUND + 1)
    most, best = 0.0, prism
    for height in TABLES_M:
        for half, ratio, turns in TABLES:
            for heading in np.arange(turns) * np.pi / 4:
                for x in prism.x + steps:
                    for y in prism.y + steps:
                        table = typed(Prism(x, y, half, height, BOX, heading, ratio, TOP))
                        value = gain(work, work.sums, table, DEFAULT.cost).value
                        if value > most:
                            most, best = value, table
    assert most > 0
    assert tuple(_table(work, work.sums, prism, DEFAULT)) == pytest.approx(tuple(best))


def test_where_no_table_explains_anything_the_prism_stays() -> None:
    work, prism = workspace(seen_from(THREE, [])), typed(Prism(0.1, 0.1, 0.1, 0.2))
    assert _table(work, work.sums, prism, DEFAULT) == prism


def test_only_what_is_explained_badly_becomes_a_table_and_only_where_they_are_tried() -> None:
    for legs, tables, becomes in ((0.3, True, True), (0.3, False, False), (0.85, True, False)):
        work, box = workspace(on_legs(THREE, DESK, legs)), typed(DESK._replace(waist=1.0))
        other = _better_shape(work, work.sums, box, DEFAULT, tables)
        assert bool(is_table(other)) is becomes, (legs, tables, other)
        explained = gain(work, work.sums, typed(DESK), DEFAULT.cost)
        assert explained.value > gain(work, work.sums, box, DEFAULT.cost).value  # a table would be better each time


@pytest.mark.parametrize("waist", [0.8, 0.95])
def test_a_table_is_refined_to_where_it_stands_and_stays_one(waist: float) -> None:
    planted = DESK._replace(waist=waist)
    work = workspace(on_legs(THREE, planted))
    start = typed(DESK._replace(x=0.13, y=0.07, radius=0.47, height=0.66, heading=0.45))
    found = refined(work, work.sums, start, DEFAULT.cost, COARSE_STEP_M)
    assert is_table(found) and plausible(found)
    assert found[:4] == pytest.approx(planted[:4], abs=0.02)
    assert (found.heading, found.ratio) == pytest.approx((planted.heading, planted.ratio), abs=0.06)
    assert found.waist == pytest.approx(waist, abs=0.03)


@pytest.mark.parametrize("cameras", [LEFT_RIGHT, THREE], ids=len)
@pytest.mark.parametrize("heading", [0.0, 0.5, 1.2])
def test_a_table_comes_back_as_one_table(heading: float, cameras: tuple[str, ...]) -> None:
    table = DESK._replace(heading=heading)
    evidence = on_legs(cameras, table, 0.1)
    (found,) = explain(evidence, floor_places(evidence, heights=(0.0, 0.1, 0.3, 0.6))).prisms
    assert is_table(found), found
    assert found[:4] == pytest.approx(table[:4], abs=0.1)


# --- two in the place of one -----------------------------------------------------------------------------------
def two(heading: float, gap: float = 0.2, outline: int = ROUND) -> list[Prism]:
    """Two robots, end to end along a heading."""
    away = (0.17 + gap / 2) * np.array([np.cos(heading), np.sin(heading)])
    return [Prism(*(sign * away + [0.1, 0.1]).tolist(), 0.17, 0.28, outline, heading) for sign in (1, -1)]


def around_both(heading: float, gap: float = 0.2) -> Prism:
    half = 0.34 + gap / 2
    return Prism(0.1, 0.1, half, 0.28, BOX, heading, 0.17 / half)


@pytest.mark.parametrize("heading", [0.0, 0.8, np.pi / 2, 2.5])
def test_a_long_prism_where_two_stand_becomes_two(heading: float) -> None:
    far = Prism(-0.9, 0.6, 0.15, 0.3)
    work = workspace(seen_from(THREE, [*two(heading), far]))
    prisms = room([around_both(heading), far])
    assert _divided(work, prisms, 2, DEFAULT) == 3
    assert_found(listed(prisms, 3), [*two(heading), far], metres=0.03)


@pytest.mark.parametrize(
    ("planted", "start", "spare", "changes"),
    [
        ([around_both(0.8)], around_both(0.8), 4, {}),  # one that is one
        (two(0.8), around_both(0.8), 0, {}),  # no room for another
        (two(0.8), around_both(0.8), 4, {"divide": 100.0}),  # not a hundred times as much
        (two(0.8), around_both(0.8), 4, {"budget": 0}),
        (two(0.8, 0.0), Prism(0.1, 0.1, 0.24, 0.28, BOX, 0.8, 0.7), 4, {}),  # too short for two
        (two(0.8), around_both(0.8), 4, {"least_area_m2": 1.0}),  # neither would stand alone
    ],
)
def test_else_a_prism_stays_as_it_is(planted: list[Prism], start: Prism, spare: int, changes: dict[str, float]) -> None:
    prisms = room([start], spare)
    kept = prisms.copy()
    assert _divided(workspace(seen_from(THREE, planted)), prisms, 1, DEFAULT._replace(**changes)) == 1
    np.testing.assert_array_equal(prisms[0], kept[0])


@pytest.mark.parametrize("heading", [0.0, 0.4, 0.8])
def test_what_was_divided_is_shaped(heading: float) -> None:
    """Two boxes under one: each of the two is a box again, no drum."""
    planted = two(heading, 0.5, BOX)
    work, prisms = workspace(seen_from(THREE, planted)), room([around_both(heading, 0.5)])
    assert reshaped(work, prisms, 1, DEFAULT, WELL_SHAPED) == 2
    assert [one.outline for one in listed(prisms, 2)] == [BOX, BOX]
    assert_found(listed(prisms, 2), planted, metres=0.03)


def test_shapes_come_before_merging() -> None:
    """Two cartons, each begun as a drum: drums would be worth less than one box around both."""
    planted = [Prism(0.1, y, 0.2, 0.25, BOX, 0.2, 0.75) for y in (-0.21, 0.21)]
    work = workspace(seen_from(THREE, planted))
    drums = [one._replace(outline=ROUND, radius=0.18, heading=0.0, ratio=1.0) for one in planted]
    prisms = room(drums)
    assert reshaped(work, prisms, 2, DEFAULT, WELL_SHAPED) == 2
    assert [one.outline for one in listed(prisms, 2)] == [BOX, BOX]
    prisms = room(drums)
    assert _merged(work, prisms, 2, DEFAULT) == 1  # as they would be, not shaped first


# --- one in the place of several -------------------------------------------------------------------------------
SEATED = Prism(0.1, 0.1, 0.34, 1.42, BOX, 0.5, 0.7, 0.38, 0.5, -1.0)


def trunk_and_seat(height: float) -> list[Prism]:
    """Somebody of that height at the back, the seat and legs in front."""
    ahead = np.array([np.cos(SEATED.heading), np.sin(SEATED.heading)])
    x, y = ([0.1, 0.1] - 0.17 * ahead).tolist()
    u, v = ([0.1, 0.1] + 0.14 * ahead).tolist()
    return [Prism(x, y, 0.15, height), Prism(u, v, 0.18, 0.52)]


@pytest.mark.parametrize(("height", "count"), [(1.2, 1), (1.49, 1), (1.51, 2), (1.7, 2)])
def test_only_who_is_low_enough_sits_on_what_stands_before_him(height: float, count: int) -> None:
    work = workspace(seen_from(THREE, [SEATED]))
    prisms = room(trunk_and_seat(height))
    assert _merged(work, prisms, 2, DEFAULT._replace(merge=0.0)) == count
    if count == 1:
        found = prism_at(prisms, 0)
        assert found.waist < 1 and plausible(found) and found.height == pytest.approx(SEATED.height, abs=0.1)
        assert found[:2] == pytest.approx(SEATED[:2], abs=0.1)
    else:
        assert listed(prisms, 2) == [typed(one) for one in trunk_and_seat(height)]
