"""Explaining away: planted objects come back, without ghosts."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.prisms import (
    BIG,
    FOUR,
    LEFT_RIGHT,
    SMALL,
    THREE,
    assert_found,
    crowd,
    floor_places,
    plausible_prism,
    seen_from,
    watch,
)
from occlib.explaining.evidence import PolarEvidence
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.objective import ADD, NOBODY, gain, objective, put, put_all, supported, uncovered, workspace
from occlib.explaining.prisms import BOX, Prism, as_array, plausible, prism_at
from occlib.explaining.refining import DEFAULT, FINE_STEP_M, ExplainSettings, stands_alone
from occlib.explaining.reshaping import STILL_WELL_SHAPED, reshaped
from occlib.explaining.search import Explanation, _continued, _replaced, _settle, _solve, _without_needless, explain


def explained(evidence: PolarEvidence, **options: Any) -> list[Prism]:
    return explain(evidence, floor_places(evidence), **options).prisms


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    prism=st.builds(
        plausible_prism,
        x=st.floats(-1.2, 1.2),
        y=st.floats(-0.9, 0.9),
        radius=st.floats(0.08, 0.35),
        height=st.floats(0.1, 0.9),
    ),
    cameras=st.sampled_from([LEFT_RIGHT, THREE]),
)
def test_one_object_comes_back(prism: Prism, cameras: tuple[str, ...]) -> None:
    assert_found(explained(seen_from(cameras, [prism])), [prism], metres=0.03)


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
    planted = [Prism(0.0, 0.35, 0.12, 0.3), Prism(0.0, -0.35, 0.12, 0.3), Prism(-0.9, 0.02, 0.1, 0.3)]
    evidence = seen_from(LEFT_RIGHT, planted)
    places = floor_places(evidence)
    away = np.min([np.hypot(*(places - [t.x, t.y]).T) - t.radius for t in planted], axis=0)
    assert (away > 0.1).any()  # AND alone would not know better
    assert_found(explain(evidence, places).prisms, planted)


def test_nothing_seen_is_nothing_there() -> None:
    at = watch()
    everywhere = np.array([[x, y] for x in np.arange(-1.9, 2, 0.2) for y in np.arange(-1.4, 1.5, 0.2)])
    for found in (
        explain(seen_from(LEFT_RIGHT, []), everywhere),
        explain(at.evidence(), everywhere),  # nobody says anything
        explain(seen_from(LEFT_RIGHT, []), everywhere, previous=Explanation([BIG, SMALL])),
    ):
        assert found.prisms == [] and found.left == 0 and found.complete
    nowhere = explain(seen_from(LEFT_RIGHT, [BIG]), np.empty((0, 2)))  # no place to stand
    assert nowhere.prisms == [] and nowhere.left == 1


def test_what_is_too_small_to_matter_is_noise() -> None:
    evidence = seen_from(LEFT_RIGHT, [BIG])
    weights = evidence.weights.copy()
    rng = np.random.default_rng(3)
    for k in range(2):  # specks of up to 3 x 3 samples anywhere
        for row, column in zip(rng.integers(60, 200, 40), rng.integers(100, 450, 40), strict=True):
            weights[k, row : row + 3, column : column + 3] = 255 * evidence.seen[k, row : row + 3, column : column + 3]
    found = explain(dataclasses.replace(evidence, weights=weights), floor_places(seen_from(LEFT_RIGHT, [BIG, SMALL])))
    assert_found(found.prisms, [BIG])
    assert 0 < found.left < 0.2


def test_a_view_that_says_nothing_changes_nothing() -> None:
    planted = crowd(4, 0)
    two, three = seen_from(LEFT_RIGHT, planted), seen_from(THREE, planted)
    places = floor_places(two)
    alone = explain(two, places).prisms
    weights, seen = three.weights.copy(), three.seen.copy()
    weights[2], seen[2] = 0, False
    absent = explain(PolarEvidence(three.views, three.sizes, weights, seen), places).prisms
    assert_found(absent, alone, metres=0.01, size=0.05)  # the same, but for the path of the search


def test_a_view_that_sees_all_and_shows_nothing_objects_unless_it_may_be_spared() -> None:
    planted = crowd(4, 0)
    three = seen_from(THREE, planted)
    places = floor_places(seen_from(LEFT_RIGHT, planted))
    weights = three.weights.copy()
    weights[2] = 0
    silent = dataclasses.replace(three, weights=weights)
    assert explain(silent, places).prisms == []
    spared = explain(silent, places, settings=DEFAULT._replace(spare=0.34, reshape=0.06))
    assert_found(spared.prisms, planted, metres=0.04, size=0.5)  # only the price rises, and with it that of a bad shape


def test_the_same_evidence_gives_the_same_prisms_and_is_left_alone() -> None:
    evidence = seen_from(LEFT_RIGHT, crowd(4, 1))
    places = floor_places(evidence)
    kept = [a.copy() for a in (evidence.views, evidence.sizes, evidence.weights, evidence.seen, places)]
    first = explain(evidence, places, gloss=[0.3, 0.1])
    assert explain(evidence, places, gloss=[0.3, 0.1]) == first
    assert explain(evidence, places.tolist(), gloss=np.array([0.3, 0.1])) == first
    second = explain(evidence, places, previous=first)
    assert explain(evidence, places, previous=first) == second
    for now, then in zip((evidence.views, evidence.sizes, evidence.weights, evidence.seen, places), kept, strict=True):
        np.testing.assert_array_equal(now, then)


def test_the_order_of_the_places_does_not_matter() -> None:
    planted = crowd(4, 2)
    evidence = seen_from(THREE, planted)
    places = floor_places(evidence)
    shuffled = np.random.default_rng(0).permutation(places)
    assert_found(explain(evidence, shuffled).prisms, explain(evidence, places).prisms, metres=0.005, size=0.05)


def test_what_stood_there_before_stays_if_it_is_right_and_goes_if_it_is_wrong() -> None:
    planted = crowd(4, 0)
    evidence = seen_from(LEFT_RIGHT, planted)
    places, nowhere = floor_places(evidence), np.empty((0, 2))

    def then(previous: list[Prism], places: Any = places) -> list[Prism]:
        return explain(evidence, places, previous=Explanation(previous)).prisms

    assert_found(then(planted), planted)
    assert_found(then(planted, nowhere), planted)  # with no search at all
    near = [Prism(t.x + 0.06, t.y - 0.05, 1.15 * t.radius, 0.85 * t.height) for t in planted]
    assert_found(then(near), planted)
    wrong = [Prism(-t.x, -t.y, t.radius, t.height) for t in planted] + [Prism(1.5, 1.0, 0.4, 0.5)]
    assert_found(then(wrong), planted)
    assert_found(then([*planted, planted[0]]), planted)  # twice the same: once


def test_no_more_than_asked_for() -> None:
    evidence = seen_from(LEFT_RIGHT, crowd(4, 0))
    assert len(explained(evidence, settings=ExplainSettings(max_objects=2))) == 2
    assert len(explained(evidence, settings=ExplainSettings(max_objects=2), previous=Explanation(crowd(4, 0)))) == 2
    assert explained(evidence, settings=ExplainSettings(max_objects=0)) == []


@pytest.mark.parametrize("cameras", [LEFT_RIGHT, THREE], ids=len)
def test_what_one_view_alone_shows_is_no_object(cameras: tuple[str, ...]) -> None:
    """A stain on a lens, a light, a shadow: the right camera sees the place and shows the floor."""
    evidence = seen_from(cameras, [BIG])
    weights = evidence.weights.copy()
    weights[1] = seen_from(cameras, []).weights[1]
    places = np.vstack([floor_places(seen_from(cameras, [BIG])), floor_places(seen_from(cameras, [BIG, SMALL]))])
    found = explain(dataclasses.replace(evidence, weights=weights), places)
    assert found.prisms == []
    assert found.left == 1
    stubborn = explain(dataclasses.replace(evidence, weights=weights), places, previous=Explanation([BIG]))
    assert stubborn.prisms == []


# --- what is needless ------------------------------------------------------------------------------------------
def needed(evidence: PolarEvidence, prisms: list[Prism]) -> list[Prism]:
    """Without the one that explains least beside the others, as long as one explains nothing or does not stand alone."""
    work, prisms = workspace(evidence), [Prism(*map(float, prism)) for prism in prisms]
    while prisms:
        worth = []
        for k, prism in enumerate(prisms):
            cover = uncovered(work)
            for other in prisms[:k] + prisms[k + 1 :]:
                put(work, cover, other, 0.0, 1)
            value = gain(work, cover.sums, prism, DEFAULT.cost).value
            alone = stands_alone(work, as_array(prisms, "prisms"), len(prisms), k, prism, DEFAULT)
            worth.append(np.inf if value > 0 and alone else value)
        if min(worth) == np.inf:
            break
        del prisms[int(np.argmin(worth))]
    return prisms


@pytest.mark.parametrize("cameras", [LEFT_RIGHT, THREE], ids=len)
@pytest.mark.parametrize("seed", range(4))
def test_what_the_others_explain_is_dropped_the_weakest_first(seed: int, cameras: tuple[str, ...]) -> None:
    """Each is there twice, once a little beside its place, and there are some where nothing is."""
    planted, rng = crowd(4, seed), np.random.default_rng(seed)
    beside = [p._replace(x=p.x + rng.uniform(-0.04, 0.04), radius=0.9 * p.radius) for p in planted]
    prisms = [*planted, *beside, *crowd(3, 10 + seed)]
    prisms = [prisms[i] for i in rng.permutation(len(prisms))]
    evidence, array = seen_from(cameras, planted), as_array(prisms, "prisms")
    work = workspace(evidence)
    cover = uncovered(work)
    put_all(work, cover, array, len(prisms), NOBODY, 0.0, ADD)
    count = _without_needless(work, cover, array, len(prisms), DEFAULT)
    left = [prism_at(array, i) for i in range(count)]
    assert left == needed(evidence, prisms)
    assert 2 <= count < len(prisms)
    assert all(any(np.hypot(one.x - p.x, one.y - p.y) < 0.05 for p in planted) for one in left)


@pytest.mark.parametrize(
    ("cameras", "drums"),
    [
        (THREE, [Prism(0.2, 0.23, 0.17, 0.25), Prism(-0.26, 0.13, 0.09, 0.33)]),
        (LEFT_RIGHT, [Prism(0.29, 0.23, 0.21, 0.23), Prism(0.36, 0.08, 0.1, 0.21)]),
        (LEFT_RIGHT, [Prism(0.37, 0.29, 0.1, 0.24), Prism(0.26, 0.23, 0.1, 0.26)]),
    ],
)
def test_what_another_explains_after_a_change_of_shape_is_dropped(cameras: tuple[str, ...], drums: list[Prism]) -> None:
    """Two drums for a carton, until one of them becomes the carton."""
    carton = Prism(0.1, 0.1, 0.4, 0.3, BOX, 0.3, 0.5)
    evidence, apart = seen_from(cameras, [carton]), DEFAULT._replace(merge=100.0)
    prisms = np.vstack([as_array(drums, "drums"), np.zeros((4, 10))])
    work, shaped = workspace(evidence), prisms.copy()
    assert _settle(work, shaped, 2, apart, FINE_STEP_M) == 2
    assert reshaped(work, shaped, 2, apart, STILL_WELL_SHAPED) == 2
    (left,) = needed(evidence, [prism_at(shaped, i) for i in range(2)])
    count, *_ = _continued(work, np.empty((0, 2)), prisms, 2, apart)
    assert count == 1 and prism_at(prisms, 0) == left
    assert left.outline == BOX and left[:4] == pytest.approx(carton[:4], abs=0.06)


def test_what_replaces_is_shaped_and_none_of_it_is_needless() -> None:
    """Two cartons for one wide drum."""
    cartons = [Prism(0.1, y, 0.2, 0.3, BOX, 0.2, 0.6) for y in (-0.3, 0.3)]
    evidence = seen_from(THREE, cartons)
    tried = as_array([Prism(one.x, one.y, 0.16, 0.3) for one in cartons], "tried")
    wide = np.vstack([as_array([Prism(0.1, 0.0, 0.4, 0.3)], "wide"), np.zeros((5, 10))])
    work = workspace(evidence)
    before = objective(work, wide, 1, DEFAULT.cost)
    prisms, count, value = _replaced(work, tried, wide, 1, before, 0, DEFAULT)
    found = [prism_at(prisms, i) for i in range(count)]
    assert count == 2 and [one.outline for one in found] == [BOX, BOX]
    assert_found(found, cartons)
    assert value == objective(work, prisms, count, DEFAULT.cost) > before
    kept, count, value = _replaced(work, tried, wide, 1, 1e9, 0, DEFAULT)  # none explains so much
    assert kept is wide and (count, value) == (1, 1e9)


# --- budget ----------------------------------------------------------------------------------------------------
def columns_weighed(evidence: PolarEvidence, places: Any, budget: int = DEFAULT.budget) -> int:
    work = workspace(evidence)
    _solve(work, places, as_array([], "none"), DEFAULT.leftover_share, DEFAULT._replace(budget=budget))
    return int(work.spent[0])


NOTHING_LEFT = "a budget that ends among the candidates leaves nothing to make objects of them: none at all"


@pytest.mark.parametrize(
    "share",
    [
        0.0,
        0.1,
        pytest.param(0.4, marks=pytest.mark.xfail(strict=True, reason=NOTHING_LEFT)),
        0.7,
        0.9,
        0.97,
    ],
)
def test_with_too_small_a_budget_the_best_found_so_far_is_told(share: float) -> None:
    planted = crowd(8, 1)
    evidence = seen_from(LEFT_RIGHT, planted)
    places = floor_places(evidence)
    few = ExplainSettings(budget=int(share * columns_weighed(evidence, places)))
    found = explain(evidence, places, settings=few)
    assert not found.complete and 0 <= found.left <= 1
    assert explain(evidence, places, settings=few) == found
    work, prisms = workspace(evidence), as_array(found.prisms, "found")
    assert len(prisms) > 0 or share < 0.3
    for k, prism in enumerate(found.prisms):
        assert plausible(prism) and supported(work, prism, DEFAULT.support, DEFAULT.spare)
        assert stands_alone(work, prisms, len(prisms), k, prism, DEFAULT)
        assert min(np.hypot(prism.x - one.x, prism.y - one.y) for one in planted) < 0.1
    whole = explain(evidence, places)
    assert whole.complete and len(whole.prisms) >= len(found.prisms) and whole.left <= found.left


def test_a_budget_is_kept_but_for_the_step_at_which_it_ends() -> None:
    evidence = seen_from(LEFT_RIGHT, crowd(8, 1))
    assert columns_weighed(evidence, floor_places(evidence), 100_000) < 200_000


def test_what_was_known_survives_a_small_budget() -> None:
    planted = crowd(8, 1)
    evidence = seen_from(LEFT_RIGHT, planted)
    known = Explanation(planted)
    found = explain(evidence, floor_places(evidence), previous=known, settings=ExplainSettings(budget=1000))
    assert not found.complete
    assert_found(found.prisms, planted, metres=0.03, size=0.25)


# --- wrong arguments -------------------------------------------------------------------------------------------
def test_wrong_places_and_prisms_are_named() -> None:
    evidence = seen_from(LEFT_RIGHT, [BIG])
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="places_m: expected finite numbers, got NaN or infinity"):
            explain(evidence, [[0.0, bad]])
    for places in (np.zeros((4, 3)), np.zeros(3), 5.0):
        with pytest.raises(ValueError, match=r"places_m: expected shape \(N, 2\), got"):
            explain(evidence, places)
    for prism in (
        Prism(np.nan, 0, 0.1, 0.1),
        Prism(0, 0, 0, 0.1),
        Prism(0, 0, 0.1, -1),
        Prism(0, 0, np.inf, 1),
        Prism(0, 0, 0.1, 0.1, outline=2),
    ):
        with pytest.raises(ValueError, match="previous: expected finite places, sizes > 0 and a known outline, got"):
            explain(evidence, [[0.0, 0.0]], previous=Explanation([BIG, prism]))


@pytest.mark.parametrize("gloss", [[0.5], [0.5, 0.5, 0.5], [0.5, np.nan], [0.5, 1.5], [-0.1, 0.5]])
def test_a_gloss_that_none_can_be_is_named(gloss: list[float]) -> None:
    with pytest.raises(ValueError, match="gloss: expected"):
        explain(seen_from(LEFT_RIGHT, [BIG]), [[0.0, 0.0]], gloss=gloss)


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_a_setting_that_no_search_can_use_is_named(value: float) -> None:
    with pytest.raises(ValueError, match=rf"settings.cost: expected a finite number of 0 or more, got {value}"):
        explain(seen_from(LEFT_RIGHT, [BIG]), [[0.0, 0.0]], settings=ExplainSettings(cost=value))


# --- settings --------------------------------------------------------------------------------------------------
TOWER, PERSON = Prism(-0.3, 0.05, 0.25, 1.04), Prism(-0.3, 0.05, 0.2, 1.7)
NEAR, BESIDE = Prism(0.2, 0.05, 0.1, 0.3), Prism(0.1, 0.05, 0.1, 0.3)  # 0.5 and 0.4 m from their axes
ROBOT = Prism(-0.3, 0.05, 0.25, 1.04, waist=0.3, upper=0.2)  # a base of 0.31 m, and a mast
COMPANION, FRIEND = Prism(-0.05, 0.05, 0.15, 1.5), Prism(0.05, 0.05, 0.15, 1.5)  # 0.25 and 0.35 m from a person's axis


@pytest.mark.parametrize(
    ("tall", "prism", "changes", "alone"),
    [
        (TOWER, NEAR, {}, True),
        (TOWER, NEAR, {"least_area_m2": 1.0}, False),
        (TOWER, NEAR, {"least_share": 1.1}, False),
        (TOWER, NEAR, {"support": 1.1}, False),
        (TOWER, NEAR, {"support": 1.1, "spare": 1.0}, False),  # two at least must show it
        (TOWER, NEAR, {"margin_m": 0.6}, False),
        (TOWER, NEAR, {"margin_share": 0.5}, False),
        (TOWER, NEAR, {"fragment_margin_share": 0.5}, False),
        (TOWER, NEAR, {"fragment_share": 0.99}, False),
        (TOWER, NEAR, {"fragment_share": 0.99, "low_share": 0.2}, True),  # no fragment, for it is not low
        (TOWER, NEAR, {"fragment_share": 0.99, "beside_m": 0.0}, False),  # nor is it one further off
        (TOWER, NEAR, {"fragment_share": 0.99, "beside_m": 0.0, "beside_share": 0.4}, True),
        (ROBOT, NEAR, {"fragment_share": 1.1, "beside_m": 0.5}, True),  # as high as the base: not low beside a mast
        (ROBOT, NEAR, {"fragment_share": 1.1, "low_share": 1.1, "beside_m": 0.5}, False),
        (ROBOT, NEAR, {"fragment_share": 1.1, "low_share": 1.1, "beside_m": 0.34}, True),  # + 0.5 * 0.31 < 0.5 m
        (ROBOT, NEAR, {"margin_share": 0.5}, True),  # of the base
        (PERSON, BESIDE, {}, False),
        (PERSON, BESIDE, {"person_low_m": 0.39, "beside_m": 0.0, "beside_share": 0.2}, True),
        (PERSON, BESIDE, {"low_share": 0.1}, True),
        (PERSON, BESIDE, {"low_share": 0.1, "person_tall_m": 0.41}, False),
        (PERSON, COMPANION, {}, False),
        (PERSON, COMPANION, {"person_tall_m": 0.24}, True),
        (PERSON, FRIEND, {}, False),
        (PERSON, FRIEND, {"person_tall_m": 0.34}, True),
    ],
)
def test_what_stands_beside_something_tall_is_an_object_of_its_own_as_the_settings_say(
    tall: Prism, prism: Prism, changes: dict[str, float], alone: bool
) -> None:
    work, others = workspace(seen_from(THREE, [tall, prism])), as_array([tall], "others")
    assert bool(stands_alone(work, others, 1, -1, prism, DEFAULT._replace(**changes))) is alone
    np.testing.assert_array_equal(work.scratch.sums, work.sums)  # the scratch is left as it was


def test_a_fresh_search_is_made_and_wins_as_the_settings_say() -> None:
    """One wide prism stands where there are two, and a third is new: without a place it can only be found afresh."""
    planted, wide = [Prism(0.0, 0.16, 0.1, 0.3), Prism(0.0, -0.16, 0.1, 0.3)], [Prism(0.0, 0.0, 0.26, 0.3)]
    far = Prism(0.9, 0.5, 0.1, 0.1)
    evidence = seen_from(THREE, [*planted, far])
    places = floor_places(seen_from(THREE, planted))

    def found(leftover_share: float, keep: float) -> int:
        settings = ExplainSettings(leftover_share=leftover_share, keep=keep, divide=100.0)
        return len(explain(evidence, places, previous=Explanation(wide), settings=settings).prisms)

    assert len(explain(evidence, places).prisms) == 2
    assert found(leftover_share=1.0, keep=0.0) == 1  # what is left is never too much: no fresh search
    assert found(leftover_share=0.0, keep=100.0) == 1  # it is made, but explains no hundred times as much
    assert found(leftover_share=0.0, keep=0.0) == 2


def test_what_is_always_left_is_no_reason_for_a_fresh_search_at_every_instant() -> None:
    """The share left fades, so that one is made now and then, and one that has grown is one at once."""
    planted, stain = [Prism(0.0, 0.16, 0.1, 0.3), Prism(0.0, -0.16, 0.1, 0.3)], Prism(0.9, 0.5, 0.2, 0.5)
    evidence = seen_from(THREE, [*planted, stain])
    places = floor_places(seen_from(THREE, planted))
    first = explain(evidence, places)
    assert len(first.prisms) == 2 and first.left > 0.2
    now, shares = first, []
    for _ in range(12):
        now = explain(evidence, places, previous=now)
        shares.append(now.left)
        assert_found(now.prisms, planted)
    fading = [b / a for a, b in zip([first.left, *shares], shares, strict=False)]
    assert fading[:6] == pytest.approx([0.98] * 6)
    assert max(shares[6:9]) == pytest.approx(first.left, rel=0.05)  # a fresh search: the share that it left
    assert explain(evidence, places, previous=first._replace(left=0.1)).left == pytest.approx(first.left, rel=0.05)


def test_whole_numbers_do_for_settings() -> None:
    evidence = seen_from(LEFT_RIGHT, [BIG])
    places = floor_places(evidence)
    whole = explain(evidence, places, settings=ExplainSettings(cost=0, keep=1))
    assert whole == explain(evidence, places, settings=ExplainSettings(cost=0.0, keep=1.0))
    assert len(_solve.signatures) == 1  # not compiled anew
