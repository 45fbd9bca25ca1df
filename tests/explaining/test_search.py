"""Explaining away: planted objects come back, without ghosts."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.cylinders import (
    BIG,
    FOUR,
    LEFT_RIGHT,
    SMALL,
    THREE,
    assert_found,
    crowd,
    floor_places,
    plausible_cylinder,
    seen_from,
    watch,
)
from occlib.explaining.cylinders import Cylinder, as_array
from occlib.explaining.evidence import PolarEvidence
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.objective import workspace
from occlib.explaining.search import DEFAULT, ExplainSettings, _solve, _stands_alone, explain


def explained(evidence: PolarEvidence, **options: Any) -> list[Cylinder]:
    return explain(evidence, floor_places(evidence), **options)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    cylinder=st.builds(
        plausible_cylinder,
        x=st.floats(-1.2, 1.2),
        y=st.floats(-0.9, 0.9),
        radius=st.floats(0.08, 0.35),
        height=st.floats(0.1, 0.9),
    ),
    cameras=st.sampled_from([LEFT_RIGHT, THREE]),
)
def test_one_object_comes_back(cylinder: Cylinder, cameras: tuple[str, ...]) -> None:
    assert_found(explained(seen_from(cameras, [cylinder])), [cylinder])


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [LEFT_RIGHT, THREE, FOUR], ids=len)
def test_a_small_object_entirely_hidden_from_one_camera_comes_back(cameras: tuple[str, ...]) -> None:
    evidence = seen_from(cameras, [BIG, SMALL])
    np.testing.assert_array_equal(evidence.weights[0], seen_from(cameras, [BIG]).weights[0])  # left learns nothing
    found = explained(evidence)
    if len(cameras) == 2:  # one view alone: distance and height are traded for each other
        assert_found(found, [BIG, SMALL], metres=0.03, size=0.25)
    else:
        assert_found(found, [BIG, SMALL])
    fractions, by = occlusion_state(evidence, found)
    assert fractions[1, 0] == 1 and by[1, 0] == 0 and fractions[1, 1] == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cameras", "count", "seed"),
    [
        (LEFT_RIGHT, 4, 0),
        (LEFT_RIGHT, 4, 1),
        (LEFT_RIGHT, 8, 1),
        (LEFT_RIGHT, 8, 3),
        (THREE, 4, 2),
        (THREE, 8, 0),
        (FOUR, 8, 2),
    ],
)
def test_a_crowd_comes_back_without_ghosts(cameras: tuple[str, ...], count: int, seed: int) -> None:
    planted = crowd(count, seed)
    rough = {"metres": 0.03, "size": 0.25} if len(cameras) == 2 else {}  # some are seen by one camera alone
    assert_found(explained(seen_from(cameras, planted)), planted, **rough)


def test_two_cameras_and_crossing_sight_lines_give_no_ghost() -> None:
    """Two cylinders abreast: the lines from left to one and from right to the other cross where nothing stands."""
    planted = [Cylinder(0.0, 0.35, 0.12, 0.3), Cylinder(0.0, -0.35, 0.12, 0.3), Cylinder(-0.9, 0.02, 0.1, 0.3)]
    evidence = seen_from(LEFT_RIGHT, planted)
    places = floor_places(evidence)
    away = np.min([np.hypot(*(places - [t.x, t.y]).T) - t.radius for t in planted], axis=0)
    assert (away > 0.1).any()  # AND alone would not know better
    assert_found(explain(evidence, places), planted)


def test_nothing_seen_is_nothing_there() -> None:
    at = watch()
    everywhere = np.array([[x, y] for x in np.arange(-1.9, 2, 0.2) for y in np.arange(-1.4, 1.5, 0.2)])
    assert explain(seen_from(LEFT_RIGHT, []), everywhere) == []
    assert explain(at.evidence(), everywhere) == []  # nobody says anything
    assert explain(seen_from(LEFT_RIGHT, [BIG]), np.empty((0, 2))) == []  # and no place to stand
    assert explain(seen_from(LEFT_RIGHT, []), everywhere, previous=[BIG, SMALL]) == []


def test_what_is_too_small_to_matter_is_noise() -> None:
    evidence = seen_from(LEFT_RIGHT, [BIG])
    weights = evidence.weights.copy()
    rng = np.random.default_rng(3)
    for k in range(2):  # specks of up to 3 x 3 samples anywhere
        for row, column in zip(rng.integers(60, 200, 40), rng.integers(100, 450, 40), strict=True):
            weights[k, row : row + 3, column : column + 3] = 255 * evidence.seen[k, row : row + 3, column : column + 3]
    found = explain(dataclasses.replace(evidence, weights=weights), floor_places(seen_from(LEFT_RIGHT, [BIG, SMALL])))
    assert_found(found, [BIG])


def test_a_view_that_says_nothing_changes_nothing() -> None:
    planted = crowd(4, 0)
    two, three = seen_from(LEFT_RIGHT, planted), seen_from(THREE, planted)
    places = floor_places(two)
    alone = explain(two, places)
    weights = three.weights.copy()
    weights[2] = 0
    seen = three.seen.copy()
    seen[2] = False
    absent = explain(PolarEvidence(three.views, three.sizes, weights, seen), places)
    assert_found(absent, alone, metres=0.01, size=0.05)  # the same, but for the path of the search
    silent = explain(PolarEvidence(three.views, three.sizes, weights, three.seen), places)
    assert_found(silent, planted, metres=0.04, size=0.2)  # sees all and says nothing: only the price rises


def test_the_same_evidence_gives_the_same_cylinders_and_is_left_alone() -> None:
    evidence = seen_from(LEFT_RIGHT, crowd(4, 1))
    places = floor_places(evidence)
    kept = [a.copy() for a in (evidence.views, evidence.sizes, evidence.weights, evidence.seen, places)]
    first = explain(evidence, places)
    assert explain(evidence, places) == first
    assert explain(evidence, places.tolist()) == first
    for now, then in zip((evidence.views, evidence.sizes, evidence.weights, evidence.seen, places), kept, strict=True):
        np.testing.assert_array_equal(now, then)


def test_the_order_of_the_places_does_not_matter() -> None:
    planted = crowd(4, 2)
    evidence = seen_from(THREE, planted)
    places = floor_places(evidence)
    shuffled = np.random.default_rng(0).permutation(places)
    assert_found(explain(evidence, shuffled), explain(evidence, places), metres=0.005, size=0.05)


def test_what_stood_there_before_stays_if_it_is_right_and_goes_if_it_is_wrong() -> None:
    planted = crowd(4, 0)
    evidence = seen_from(LEFT_RIGHT, planted)
    places = floor_places(evidence)
    assert_found(explain(evidence, places, previous=planted), planted)
    assert_found(
        explain(evidence, planted_places := np.empty((0, 2)), previous=planted), planted
    )  # with no search at all
    assert len(planted_places) == 0
    near = [Cylinder(t.x + 0.06, t.y - 0.05, 1.15 * t.radius, 0.85 * t.height) for t in planted]
    assert_found(explain(evidence, places, previous=near), planted)
    wrong = [Cylinder(-t.x, -t.y, t.radius, t.height) for t in planted] + [Cylinder(1.5, 1.0, 0.4, 0.5)]
    assert_found(explain(evidence, places, previous=wrong), planted)
    assert_found(explain(evidence, places, previous=[*planted, planted[0]]), planted)  # twice the same: once


def test_no_more_than_asked_for() -> None:
    evidence = seen_from(LEFT_RIGHT, crowd(4, 0))
    assert len(explained(evidence, settings=ExplainSettings(max_objects=2))) == 2
    assert len(explained(evidence, settings=ExplainSettings(max_objects=2), previous=crowd(4, 0))) == 2


# --- wrong arguments -------------------------------------------------------------------------------------------
def test_wrong_places_and_cylinders_are_named() -> None:
    evidence = seen_from(LEFT_RIGHT, [BIG])
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="places_m: expected finite numbers, got NaN or infinity"):
            explain(evidence, [[0.0, bad]])
    for places in (np.zeros((4, 3)), np.zeros(3), 5.0):
        with pytest.raises(ValueError, match=r"places_m: expected shape \(N, 2\), got"):
            explain(evidence, places)
    for cylinder in (
        Cylinder(np.nan, 0, 0.1, 0.1),
        Cylinder(0, 0, 0, 0.1),
        Cylinder(0, 0, 0.1, -1),
        Cylinder(0, 0, np.inf, 1),
    ):
        with pytest.raises(ValueError, match="previous: expected finite places and sizes > 0, got"):
            explain(evidence, [[0.0, 0.0]], previous=[BIG, cylinder])


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_a_setting_that_no_search_can_use_is_named(value: float) -> None:
    with pytest.raises(ValueError, match=rf"settings.cost: expected a finite number of 0 or more, got {value}"):
        explain(seen_from(LEFT_RIGHT, [BIG]), [[0.0, 0.0]], settings=ExplainSettings(cost=value))


# --- settings --------------------------------------------------------------------------------------------------
TOWER, PERSON = Cylinder(-0.3, 0.05, 0.25, 1.2), Cylinder(-0.3, 0.05, 0.2, 1.7)
NEAR, BESIDE = Cylinder(0.2, 0.05, 0.1, 0.3), Cylinder(0.1, 0.05, 0.1, 0.3)  # 0.5 and 0.4 m from their axes
COMPANION = Cylinder(-0.05, 0.05, 0.15, 1.5)  # as tall as a person, 0.25 m from another one's axis


@pytest.mark.parametrize(
    ("tall", "cylinder", "changes", "alone"),
    [
        (TOWER, NEAR, {}, True),
        (TOWER, NEAR, {"least_area_m2": 1.0}, False),
        (TOWER, NEAR, {"least_share": 1.1}, False),
        (TOWER, NEAR, {"margin_m": 0.6}, False),
        (TOWER, NEAR, {"margin_share": 0.5}, False),
        (TOWER, NEAR, {"fragment_margin_share": 0.5}, False),
        (TOWER, NEAR, {"fragment_share": 0.99}, False),
        (TOWER, NEAR, {"fragment_share": 0.99, "low_share": 0.2}, True),  # no fragment, for it is not low
        (TOWER, NEAR, {"fragment_share": 0.99, "beside_m": 0.0}, False),  # nor is it one further off
        (TOWER, NEAR, {"fragment_share": 0.99, "beside_m": 0.0, "beside_share": 0.4}, True),
        (PERSON, BESIDE, {}, False),
        (PERSON, BESIDE, {"person_low_m": 0.39, "beside_m": 0.0, "beside_share": 0.2}, True),
        (PERSON, BESIDE, {"low_share": 0.1}, True),
        (PERSON, BESIDE, {"low_share": 0.1, "person_tall_m": 0.41}, False),
        (PERSON, COMPANION, {}, False),
        (PERSON, COMPANION, {"person_tall_m": 0.24}, True),
    ],
)
def test_what_stands_beside_something_tall_is_an_object_of_its_own_as_the_settings_say(
    tall: Cylinder, cylinder: Cylinder, changes: dict[str, float], alone: bool
) -> None:
    work, others = workspace(seen_from(THREE, [tall, cylinder])), as_array([tall], "others")
    assert bool(_stands_alone(work, others, 1, -1, cylinder, DEFAULT._replace(**changes))) is alone


def test_a_fresh_search_is_made_and_wins_as_the_settings_say() -> None:
    """One wide cylinder stands where there are two, and explains nearly as much."""
    planted, wide = [Cylinder(0.0, 0.16, 0.1, 0.3), Cylinder(0.0, -0.16, 0.1, 0.3)], [Cylinder(0.0, 0.0, 0.26, 0.3)]
    evidence = seen_from(THREE, planted)
    places = floor_places(evidence)

    def found(leftover_share: float, keep: float) -> int:
        settings = ExplainSettings(leftover_share=leftover_share, keep=keep)
        return len(explain(evidence, places, previous=wide, settings=settings))

    assert len(explain(evidence, places)) == 2
    assert found(leftover_share=1.0, keep=0.0) == 1  # what is left is never too much: no fresh search
    assert found(leftover_share=0.0, keep=100.0) == 1  # it is made, but explains no hundred times as much
    assert found(leftover_share=0.0, keep=0.0) == 2


def test_whole_numbers_do_for_settings() -> None:
    evidence = seen_from(LEFT_RIGHT, [BIG])
    places = floor_places(evidence)
    whole = explain(evidence, places, settings=ExplainSettings(cost=0, keep=1))
    assert whole == explain(evidence, places, settings=ExplainSettings(cost=0.0, keep=1.0))
    assert len(_solve.signatures) == 1  # not compiled anew
