"""Simulated crowds: shadows, ghosts and votes agree with what can be worked out by hand."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib.explaining import appearance
from occlib.geometry import Floor
from occlib.lab import colours, crowds, ghosts
from occlib.lab import simulation as simulation_module
from occlib.lab.crowds import random_crowd, random_crowds, upright, wall_rig
from occlib.lab.ghosts import crossings
from occlib.lab.simulation import Simulation, votes_needed
from occlib.metrics import footprint_coverage
from occlib.occlusion import fuse
from occlib.registration import FloorWarp


# --- rigs and crowds ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("height", [1.2, 2.5, 4.0])
def test_every_camera_hangs_on_a_wall_and_sees_the_whole_floor(height: float) -> None:
    rig = wall_rig(8, height=height)
    assert len(rig.cameras) == 8
    for camera in rig.cameras.values():
        x, y, z = camera.centre_m
        assert z == pytest.approx(height)
        assert abs(x) == pytest.approx(crowds.ROOM_M[0]) or abs(y) == pytest.approx(crowds.ROOM_M[1])
        assert FloorWarp(camera, rig.floor).visible.all() and FloorWarp(camera, rig.floor, 0.6).visible.all()


def test_the_angle_between_two_cameras_is_the_one_asked_for() -> None:
    a, b = (c.centre_m[:2] for c in wall_rig({"a": 180, "b": 240}).cameras.values())
    assert np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))) == pytest.approx(60)


def test_impossible_rigs_are_refused() -> None:
    with pytest.raises(ValueError, match="expected 1 to 8, got 9"):
        wall_rig(9)
    with pytest.raises(ValueError, match=r"above 0\.7 m"):
        wall_rig(2, height=0.5)
    with pytest.raises(ValueError, match="floor: expected it between walls"):
        wall_rig(2, floor=Floor((-4, 4), (-1, 1), 0.05))


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 10), st.integers(0, 99))
def test_a_crowd_stands_on_the_floor_apart_and_within_its_sizes(count: int, seed: int) -> None:
    crowd = random_crowd(count, np.random.default_rng(seed))
    circles = [np.append(place, np.hypot(*t.parts[0].size[:2]) / 2 if t.label == "box" else t.parts[0].size[0] / 2)
               for place, t in zip(crowds.places_m(crowd), crowd, strict=True)]  # fmt: skip
    for a, b in combinations(circles, 2):
        assert np.hypot(*(a - b)[:2]) >= a[2] + b[2] + 0.05 - 1e-12
    for thing in crowd:
        outline = thing.footprint(0)
        assert (np.abs(outline) <= [2.0, 1.5]).all()
        assert 0.15 <= thing.height <= 0.5 and all(0.2 <= side <= 0.4 for side in thing.parts[0].size[:2])


def test_the_seed_decides_and_a_longer_series_begins_like_a_shorter_one() -> None:
    assert random_crowds(2, 5, 1) == random_crowds(4, 5, 1)[:2]
    assert random_crowds(1, 5, 1) != random_crowds(1, 5, 2)


def test_no_room_and_unknown_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="no room for 200"):
        random_crowd(200, np.random.default_rng(0))
    with pytest.raises(ValueError, match="shape: expected one of"):
        upright("torus", (0, 0), 0.3, 0.3)


# --- shadows -----------------------------------------------------------------------------------------------
def test_a_shadow_by_rays_is_the_outline_by_similar_triangles() -> None:
    rig = wall_rig(3)
    for thing in random_crowd(4, np.random.default_rng(5)):
        for camera in rig.cameras.values():
            cast = ghosts.shadow_mask(camera, thing, rig.floor)
            drawn = rig.floor.polygon_mask(ghosts.shadow_outline_m(camera, thing))
            assert (cast != drawn).sum() < 0.03 * cast.sum()


def test_silhouettes_warped_to_the_floor_are_the_shadows_but_for_a_rim() -> None:
    rig, crowd = wall_rig(2), random_crowd(3, np.random.default_rng(6))
    simulation = Simulation(rig)
    for name, mask in simulation.on_floor(simulation.masks(crowd)).items():
        exact = np.any([ghosts.shadow_mask(rig[name], thing, rig.floor) for thing in crowd], axis=0)
        assert (mask != exact).sum() < 0.05 * exact.sum()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 999), st.floats(1.2, 4.0), st.integers(1, 4))
def test_and_of_exact_shadows_covers_every_base(seed: int, height: float, cameras: int) -> None:
    rig, crowd = wall_rig(cameras, height=height), random_crowd(3, np.random.default_rng(seed))
    shadows = [np.any([ghosts.shadow_mask(c, t, rig.floor) for t in crowd], axis=0) for c in rig.cameras.values()]
    assert footprint_coverage(fuse(shadows), rig.floor, [thing.footprint(0) for thing in crowd]).min() == 1


def test_the_projection_of_a_ball_is_not_covered() -> None:
    rig, ball = wall_rig(2), upright("ellipsoid", (0.0, 0.0), 0.6, 0.6)
    shadows = [ghosts.shadow_mask(camera, ball, rig.floor) for camera in rig.cameras.values()]
    assert footprint_coverage(fuse(shadows), rig.floor, [ball.footprint(0)])[0] < 0.3


@pytest.mark.parametrize(("distance", "tall", "high"), [(2.0, 0.2, 2.5), (3.5, 0.6, 2.5), (2.5, 0.4, 1.5)])
def test_the_smear_is_measured_as_predicted(distance: float, tall: float, high: float) -> None:
    simulation = Simulation(wall_rig(1, height=high))
    measured = simulation_module.measured_smear_m(
        simulation, upright("cylinder", (-3.05 + distance - 0.15, 0.0), 0.3, tall)
    )
    assert measured == pytest.approx(float(ghosts.smear_m(distance, tall, high)), abs=0.03)


def test_a_camera_no_higher_than_the_object_smears_without_end() -> None:
    assert ghosts.smear_m(3.0, 2.5, 2.5) == np.inf
    with pytest.raises(ValueError, match="below the camera"):
        ghosts.shadow_outline_m(wall_rig(1, height=1.0)["left"], upright("box", (0.0, 0.0), 0.3, 1.2))


# --- ghosts ------------------------------------------------------------------------------------------------
FALLING = [upright("box", at, 0.2, 0.9) for at in [(-0.6, 0.3), (0.0, -0.4)]]
RISING = [upright("box", at, 0.2, 0.9) for at in [(-0.6, -0.4), (0.0, 0.3)]]


def test_a_ghost_is_predicted_where_the_simulation_finds_it() -> None:
    rig = wall_rig({"left": 180, "front": 270})
    simulation = Simulation(rig)
    ((pair, polygon),) = crossings(rig, FALLING).items()
    occupied = simulation.occupied(simulation.masks(FALLING))
    assert pair == (0, 1) and ghosts.ghost_regions(occupied, FALLING, rig.floor) == 1
    assert occupied[rig.floor.polygon_mask(polygon)].mean() > 0.9
    assert not crossings(rig, RISING)
    assert ghosts.ghost_regions(simulation.occupied(simulation.masks(RISING)), RISING, rig.floor) == 0


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 999), st.sampled_from([30, 90, 150, 180]))
def test_of_the_two_crossings_of_a_pair_at_most_one_exists(seed: int, angle: int) -> None:
    crowd = random_crowd(8, np.random.default_rng(seed), width=(0.1, 0.2), height=(0.3, 1.0))
    found = crossings(wall_rig({"a": 180, "b": 180 + angle}, height=1.5), crowd)
    assert not any((j, i) in found for i, j in found)


@pytest.mark.slow
def test_prediction_and_measurement_agree_on_average() -> None:
    study = simulation_module.two_view_study(wall_rig(2), random_crowds(20, 8, 3))
    assert study["predicted"] > 0.1 and study["measured"] == pytest.approx(study["predicted"], abs=0.2)
    assert study["claimed / true"] >= 1 and 0 < study["MODA"] <= 1


def test_the_law_scales_with_pairs_heights_and_cameras() -> None:
    rig, law = wall_rig(2), ghosts.expected_crossings
    assert law(rig, 1, 0.4) == 0
    assert law(rig, 4, 0.4) == pytest.approx(6 * law(rig, 2, 0.4)) == pytest.approx(24 * law(rig, 2, 0.2))
    assert law(wall_rig(2, height=5.0), 4, 0.4) == pytest.approx(law(rig, 4, 0.4) / 4)


def test_the_law_agrees_with_random_sticks() -> None:
    """Thin objects thrown at random: the exact crossings of their shadows' axes, but for the objects beyond the floor's rim."""
    rig, rng, tall = wall_rig(2), np.random.default_rng(0), 0.4
    a, b = (camera.centre_m for camera in rig.cameras.values())
    places, others = (rng.uniform([-2, -1.5], [2, 1.5], (200_000, 2)) for _ in range(2))
    u, v = places - a[:2], others - b[:2]
    across = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    gap = others - places
    s = (gap[:, 0] * v[:, 1] - gap[:, 1] * v[:, 0]) / across
    t = (gap[:, 0] * u[:, 1] - gap[:, 1] * u[:, 0]) / across
    reach = tall / (2.5 - tall)
    landing = np.abs(places + s[:, None] * u) <= [2, 1.5]
    crossed = ((s > 0) & (s < reach) & (t > 0) & (t < reach) & landing.all(axis=1)).mean()
    assert 2 * crossed == pytest.approx(ghosts.expected_crossings(rig, 2, tall), rel=0.3)


def test_ghosts_are_predicted_for_two_cameras_only() -> None:
    for call in (lambda: crossings(wall_rig(3), FALLING), lambda: ghosts.expected_crossings(wall_rig(1), 2, 0.4)):
        with pytest.raises(ValueError, match="expected two cameras"):
            call()


# --- votes and misses --------------------------------------------------------------------------------------
def test_votes_of_the_rules() -> None:
    for cameras in range(1, 9):
        assert votes_needed("and", cameras) == cameras and votes_needed("or", cameras) == 1
        assert votes_needed("most", cameras) == max(cameras - 1, 1)
        assert votes_needed("log-odds", cameras) <= votes_needed("product", cameras) <= cameras
    assert votes_needed("log-odds", 4, (0.9, 0.3)) < votes_needed("log-odds", 4, (0.6, 0.05))


@pytest.mark.slow
def test_recall_follows_the_binomial_law() -> None:
    settings = {"cameras": (3,), "recalls": (0.8,), "rules": ("and", "log-odds"), "rng": np.random.default_rng(2)}
    rows = simulation_module.recall_study(wall_rig(4), random_crowds(40, 3, 9), **settings)
    assert [row["expected"] for row in rows] == pytest.approx([0.8**3, 0.8**3 + 3 * 0.2 * 0.8**2])
    for row in rows:
        assert row["found"] == pytest.approx(row["expected"], abs=0.1)


def test_shadows_cast_once_are_those_of_any_choice_of_objects() -> None:
    simulation, crowd = Simulation(wall_rig(3)), random_crowd(3, np.random.default_rng(5))
    kept = {name: np.array([name != "front", True, True]) for name in simulation.rig.cameras}
    masks = simulation.masks(crowd, kept)
    views = simulation_module.union(simulation.shadows(crowd), kept)
    for name, view in simulation.on_floor(masks).items():
        np.testing.assert_array_equal(views[name], view)
    for rule in ("and", "most", "log-odds"):
        np.testing.assert_array_equal(simulation.fused(views, rule), simulation.occupied(masks, rule))
    with pytest.raises(ValueError, match="planes"):
        simulation.fused(views, "planes")


def test_an_object_that_a_view_misses_leaves_its_mask_alone() -> None:
    simulation, crowd = Simulation(wall_rig(2)), [upright("box", at, 0.3, 0.4) for at in [(-1.0, 0.8), (1.0, -0.8)]]
    alone = simulation.masks(crowd[:1])
    kept = {"left": np.array([True, False]), "right": np.array([True, True])}
    masks = simulation.masks(crowd, kept)
    np.testing.assert_array_equal(masks["left"], alone["left"])
    assert masks["right"].sum() > alone["right"].sum()
    assert len(simulation.places(masks)) == 1
    with pytest.raises(ValueError, match="recall: expected a probability"):
        simulation_module.misses(["left"], 2, 1.5, np.random.default_rng(0))


@pytest.mark.slow
def test_explaining_finds_what_one_view_missed_only_with_a_spare_view() -> None:
    simulation, crowd = Simulation(wall_rig(4)), random_crowd(3, np.random.default_rng(4))
    masks = simulation.masks(crowd, {n: np.array([n != "front", True, True]) for n in simulation.rig.cameras})
    truth = crowds.places_m(crowd)
    strict, spared = (simulation.places(masks, rule) for rule in simulation_module.EXPLAIN)
    assert len(strict) == 2 and len(spared) == 3
    assert np.linalg.norm(truth[:, None] - spared, axis=2).min(axis=1).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["and", "product", "log-odds", "planes", "explain"])
def test_every_rule_finds_two_objects_apart(rule: str) -> None:
    simulation, crowd = Simulation(wall_rig(4)), random_crowd(2, np.random.default_rng(7))
    result = simulation_module.score(simulation, [simulation.masks(crowd)], [crowd], rule)
    assert result["MODA"] == 1 and result["median error (cm)"] < 3
    assert simulation.cost_ms([simulation.masks(crowd)], rule, repeats=1) > 0


def test_nobody_there_and_an_unknown_rule() -> None:
    simulation = Simulation(wall_rig(2))
    empty = simulation.masks(())
    for rule in ("and", "planes", "explain"):
        assert simulation.places(empty, rule).shape == (0, 2)
    with pytest.raises(ValueError, match="rule: expected one of"):
        simulation.places(empty, "nor")


# --- colour ------------------------------------------------------------------------------------------------
def test_a_ghost_disagrees_and_a_plain_object_agrees() -> None:
    rig = wall_rig({"left": 180, "front": 270})
    images = {name: np.full((480, 640, 3), 200, np.uint8) for name in rig.cameras}
    for name, masks in Simulation(rig).silhouettes(FALLING).items():
        for mask, colour in zip(masks, [(200, 30, 30), (30, 30, 200)], strict=True):
            images[name][mask] = colour
    ghost = next(iter(crossings(rig, FALLING).values())).mean(axis=0)
    found = appearance.colour_agreement([*crowds.places_m(FALLING), ghost], 0.05, images, rig)
    np.testing.assert_allclose(found[:2], 0)
    assert found[2] == pytest.approx(np.hypot(170, 170))
    assert np.isnan(appearance.colour_agreement([[50.0, 50.0]], 0.1, images, rig)).all()
    with pytest.raises(ValueError, match="two or more, got 1"):
        appearance.colour_agreement([[0, 0]], 0.1, {"left": images["left"]}, rig)


@pytest.mark.slow
def test_the_recording_has_real_objects_and_ghosts_to_be() -> None:
    rows = colours.colour_study("four_robots", [82])
    kinds = {row["kind"] for row in rows}
    assert {"real, in plain view", "ghost to be", "ghost"} <= kinds
    assert all(0 <= row["disagreement"] <= 442 for row in rows)
    assert {row["object"] for row in rows if row["kind"] == "ghost"} == {""}
