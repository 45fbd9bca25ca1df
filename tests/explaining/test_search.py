"""Explaining away: silhouettes cast ray by ray, sums sample by sample, and planted objects that come back, without ghosts."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from occlib.explaining.cylinders import (
    CHIN,
    HEAD,
    LEGS,
    PERSON_M,
    Cylinder,
    cover,
    gain,
    plausible,
    room_for_runs,
    silhouette,
)
from occlib.explaining.evidence import PolarEvidence, PolarWarp, running_sums
from occlib.explaining.feet import standing_points
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.search import HEIGHTS, RADII, Explanation, _candidates, _Search, explain, objective
from occlib.lab.scenes import load_scene
from occlib.lab.truth import ground_truth

Array = np.ndarray[Any, Any]
Point = tuple[float, float]
LEFT_RIGHT, THREE, FOUR = ("left", "right"), ("left", "right", "front"), ("left", "right", "front", "back")
BACKGROUND = 0.6  # weight of the background, as the pipeline has it


# --- what the cameras see, ray by ray ------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class Watch:
    """The polar views of some cameras, and the ray of every sample in the world."""

    views: Array
    sizes: Array
    seen: Array
    rays: Array

    @property
    def empty(self) -> PolarEvidence:
        return PolarEvidence(self.views, self.sizes, np.zeros(self.seen.shape, np.int32), self.seen)


@cache
def watch(cameras: tuple[str, ...] = LEFT_RIGHT, scene: str = "four_robots", step_px: float = 2.0) -> Watch:
    rig = load_scene(scene).rig
    polar = [PolarWarp(rig[name], rig.floor, step_px) for name in cameras]
    views, sizes = np.array([p.parameters for p in polar]), np.array([p.shape[::-1] for p in polar], np.int64)
    columns, rows = sizes.max(axis=0)
    seen = np.zeros((len(polar), rows, columns), bool)
    rays = np.zeros((*seen.shape, 3))
    for k, warp in enumerate(polar):
        seen[k, : warp.shape[0], : warp.shape[1]] = warp.visible
        _, _, _, middle, left, top, step, _ = views[k]
        azimuth = middle + left + step * np.arange(columns)[None, :]
        depression = top + step * np.arange(rows)[:, None]
        rays[k, ..., 0] = np.cos(azimuth) * np.cos(depression)
        rays[k, ..., 1] = np.sin(azimuth) * np.cos(depression)
        rays[k, ..., 2] = -np.sin(depression)
    return Watch(views, sizes, seen, rays)


def hit(origin: Array, rays: Array, thing: Cylinder) -> Array:
    """Which rays meet an upright solid cylinder, top disc and all: t within its round wall and between floor and top."""
    o = origin - [thing.x, thing.y, 0]
    a, b = (rays[..., :2] ** 2).sum(-1), rays[..., :2] @ o[:2]
    inside = b * b - a * (o[:2] @ o[:2] - thing.radius**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        near, far = (-b - np.sqrt(inside)) / a, (-b + np.sqrt(inside)) / a
        floor, top = -o[2] / rays[..., 2], (thing.height - o[2]) / rays[..., 2]
    low, high = np.maximum(near, np.minimum(floor, top)), np.minimum(far, np.maximum(floor, top))
    return np.asarray((inside >= 0) & (low <= high) & (high > 0))


def sample_masks(at: Watch, thing: Cylinder) -> Array:
    """The cylinder's samples in every view, bool (K, rows, columns), whether the camera sees them or not."""
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        masks[k, :rows, :columns] = hit(at.views[k, :3], at.rays[k, :rows, :columns], thing)
    return masks


def scratch(at: Watch) -> Array:
    return np.asarray(room_for_runs(at.seen.shape[2]))


def run_masks(at: Watch, thing: Cylinder) -> Array:
    """The same from :func:`silhouette`."""
    masks = np.zeros(at.seen.shape, bool)
    runs = scratch(at)
    for k, (columns, rows) in enumerate(at.sizes):
        first, last = silhouette(
            at.views[k], int(columns), int(rows), thing.x, thing.y, thing.radius, thing.height, runs
        )
        assert 0 <= first <= last <= columns
        for column in range(first, last):
            low, high = runs[column - first, :2]
            assert 0 <= low <= high <= rows
            masks[k, low:high, column] = True
    return masks


def seen_from(cameras: tuple[str, ...], things: Sequence[Cylinder]) -> PolarEvidence:
    """Ideal evidence: surely foreground where a ray meets one of the things, else background."""
    at = watch(cameras)
    foreground = np.any([sample_masks(at, t) for t in things] or [np.zeros(at.seen.shape, bool)], axis=0)
    weights = np.where(foreground, 255, -round(255 * BACKGROUND)) * at.seen
    return PolarEvidence(at.views, at.sizes, weights.astype(np.int32), at.seen)


def floor_places(evidence: PolarEvidence, step: float = 0.08) -> Array:
    """Where something may stand: floor points that no view calls bare at the floor and at all of three heights."""
    x, y = np.meshgrid(np.arange(-1.96, 2, step), np.arange(-1.46, 1.5, step))
    possible = np.zeros(x.shape, bool)
    for height in (0.0, 0.1, 0.3):
        here = np.ones(x.shape, bool)
        for view, weights, seen in zip(evidence.views, evidence.weights, evidence.seen, strict=True):
            azimuth = (np.arctan2(y - view[1], x - view[0]) - view[3] + np.pi) % (2 * np.pi) - np.pi
            depression = np.arctan2(view[2] - height, np.hypot(x - view[0], y - view[1]))
            column = np.clip(np.rint((azimuth - view[4]) / view[6]), 0, weights.shape[1] - 1).astype(int)
            row = np.clip(np.rint((depression - view[5]) / view[6]), 0, weights.shape[0] - 1).astype(int)
            here &= (weights[row, column] >= 0) | ~seen[row, column]
        possible |= here
    return np.column_stack([x[possible], y[possible]])


def cylinder_at(x: float, y: float, radius: float, height: float) -> Cylinder:
    assume(plausible(radius, height))
    return Cylinder(x, y, radius, height)


cylinders = st.builds(
    cylinder_at,
    x=st.floats(-1.7, 1.7),
    y=st.floats(-1.2, 1.2),
    radius=st.floats(0.06, 0.4),
    height=st.floats(0.05, 1.9),
)


@settings(max_examples=25, deadline=None)
@given(thing=cylinders)
def test_a_silhouette_is_what_the_rays_meet(thing: Cylinder) -> None:
    at = watch()
    truth, found = sample_masks(at, thing), run_masks(at, thing)
    assert truth.any(axis=(1, 2)).all()
    differ = truth != found
    assert differ.sum(axis=1).max() <= 1  # a row at the rims
    assert differ.sum() <= 4  # and only where rounding decides


@pytest.mark.parametrize("height", [2.5, 2.6, 2.9])
def test_something_higher_than_the_camera_is_seen_up_to_its_near_edge(height: float) -> None:
    at = watch()
    thing = Cylinder(-1.5, 0.2, 0.3, height)
    differ = sample_masks(at, thing) != run_masks(at, thing)
    assert differ.sum(axis=1).max() <= 1 and differ.sum() <= 4


def test_no_silhouette_outside_the_picture_and_none_from_within() -> None:
    at = watch()
    behind = Cylinder(-6.0, 0.0, 0.3, 1.0)  # behind the left camera, far off for the right one
    masks = run_masks(at, behind)
    assert not masks[0].any()
    station = Cylinder(float(at.views[0, 0]) + 0.2, float(at.views[0, 1]), 0.3, 1.0)  # around the left camera's mast
    assert not run_masks(at, station)[0].any()


RIM = 1.0


def counted(at: Watch, weights: Array, thing: Cylinder) -> tuple[Array, list[float]]:
    """The samples by which a cylinder is judged, and for each view the foreground right beyond its base and top.

    All samples of its silhouette; of a body, columns of the head and of the legs only where they show more foreground.
    """
    masks, beyond, runs = np.zeros(at.seen.shape, bool), [0.0] * len(at.views), scratch(at)
    for k, (columns, rows) in enumerate(at.sizes.tolist()):
        station, left, top, step = at.views[k, :3], at.views[k, 3] + at.views[k, 4], at.views[k, 5], at.views[k, 6]
        first, last = silhouette(at.views[k], columns, rows, *as_row(thing), runs)
        chin = runs.copy()
        silhouette(at.views[k], columns, rows, thing.x, thing.y, thing.radius, CHIN * thing.height, chin)
        to_axis = np.array([thing.x, thing.y]) - station[:2]
        for column in range(first, last):
            low, high, above, below = runs[column - first, :4].tolist()
            evidence = weights[k, :, column].astype(int)
            beyond[k] += max(evidence[high:below].sum(), 0) / 255
            sight = np.array([np.cos(left + column * step), np.sin(left + column * step)])
            chord = np.sqrt(max(thing.radius**2 - (to_axis @ [-sight[1], sight[0]]) ** 2, 0))  # half of it
            if thing.height >= PERSON_M:
                trunk = int(chin[column - first, 0]) if chord < HEAD * thing.radius else low
                if evidence[low:trunk].sum() <= 0:
                    low, above = trunk, above + trunk - low
                drop = np.arctan2(station[2] - LEGS * thing.height, to_axis @ sight - chord)
                legs = int(np.clip(np.ceil((drop - top) / step), trunk, high))
                high = legs if evidence[legs:high].sum() <= 0 else high
            beyond[k] += max(evidence[above:low].sum(), 0) / 255
            masks[k, low:high, column] = True
    return masks, beyond


# --- sums ----------------------------------------------------------------------------------------------------
def random_weights(at: Watch, seed: int) -> Array:
    weights = np.random.default_rng(seed).integers(-255, 256, at.seen.shape)
    return np.asarray(weights * at.seen, np.int32)


def as_row(thing: Cylinder) -> Array:
    return np.array([thing.x, thing.y, thing.radius, thing.height])


def gain_of(at: Watch, weights: Array, thing: Cylinder, cost: float) -> tuple[float, Array]:
    found = np.empty(3)
    runs = scratch(at)
    sums, seen = running_sums(weights), running_sums(at.seen)
    return gain(at.views, at.sizes, sums, seen, as_row(thing), cost, runs, found), found


def test_running_sums_hold_what_lies_above_each_row() -> None:
    values = np.random.default_rng(0).integers(-9, 10, (2, 5, 3)).astype(np.int32)
    sums = running_sums(values)
    assert sums.shape == (2, 6, 3) and sums.dtype == np.int32
    for row in range(6):
        np.testing.assert_array_equal(sums[:, row], values[:, :row].sum(axis=1))
    assert running_sums(np.ones((1, 4, 2), bool))[0, :, 0].tolist() == [0, 1, 2, 3, 4]


@settings(max_examples=30, deadline=None)
@given(thing=cylinders, seed=st.integers(0, 99), cost=st.floats(0, 0.5))
def test_the_gain_is_the_plain_sum_over_the_samples(thing: Cylinder, seed: int, cost: float) -> None:
    """Half of the time for a body, at whose head and legs there is foreground in some columns only."""
    at = watch(THREE, step_px=6.0)
    weights = random_weights(at, seed)
    if seed % 2:
        thing = dataclasses.replace(thing, height=1.4 + 0.3 * thing.height)
        weights[:, :, seed % 7 :: 3] = -abs(weights[:, :, seed % 7 :: 3])
    masks, beyond = counted(at, weights, thing)
    total = area = square = share = 0.0
    for k in range(len(at.views)):
        covered = int((masks[k] & at.seen[k]).sum())
        explained = float(weights[k][masks[k]].sum()) / 255
        distance = np.hypot(thing.x - at.views[k, 0], thing.y - at.views[k, 1])
        slant = np.hypot(distance, at.views[k, 2] - thing.height / 2)
        total += (explained - beyond[k]) * at.views[k, 7]
        area += covered * at.views[k, 7]
        square += explained * (at.views[k, 6] * slant) ** 2
        share = max(share, explained / max(covered, 1))
    value, found = gain_of(at, weights, thing, cost)
    assert value == pytest.approx(total - cost * area, abs=1e-6)
    assert found == pytest.approx([square, share, total / max(area, 1e-9)], abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(thing=cylinders, seed=st.integers(0, 99), margin=st.sampled_from([0.0, 0.05, 0.2]))
def test_covering_takes_the_samples_out_and_keeps_the_sums_right(thing: Cylinder, seed: int, margin: float) -> None:
    at = watch(step_px=6.0)
    weights = random_weights(at, seed)
    before, sums = weights.copy(), running_sums(weights)
    runs = scratch(at)
    cover(at.views, at.sizes, weights, sums, as_row(thing), margin, runs)
    inside = run_masks(at, Cylinder(thing.x, thing.y, thing.radius + margin, thing.height + margin))
    assert inside.any() and not weights[inside].any()
    np.testing.assert_array_equal(weights[~inside], before[~inside])
    for k, rows in enumerate(at.sizes[:, 1]):  # padding below a view is never looked at
        np.testing.assert_array_equal(sums[k, : rows + 1], running_sums(weights)[k, : rows + 1])


@settings(max_examples=20, deadline=None)
@given(things=st.lists(cylinders, max_size=4), seed=st.integers(0, 99), cost=st.floats(0, 0.5))
def test_the_objective_counts_what_several_cover_once(things: list[Cylinder], seed: int, cost: float) -> None:
    at = watch(step_px=6.0)
    weights = random_weights(at, seed)
    things = [*things, *things[:1]]  # the first one twice: pays its price twice and explains once
    expected, left = 0.0, weights.copy()
    for thing in things:
        masks, beyond = counted(at, left, thing)
        for k, scale in enumerate(at.views[:, 7]):
            covered, explained = int((masks[k] & at.seen[k]).sum()), float(left[k][masks[k]].sum()) / 255
            expected += (explained - beyond[k] - cost * covered) * scale
        left[run_masks(at, thing)] = 0
    array = np.array([as_row(t) for t in things]).reshape(-1, 4)
    sums, kept = running_sums(weights), weights.copy()
    value = objective(at.views, at.sizes, weights, sums, running_sums(at.seen), array, len(array), cost)
    assert value == pytest.approx(expected, abs=1e-6)
    np.testing.assert_array_equal(weights, kept)


# --- sizes -----------------------------------------------------------------------------------------------------
def test_what_may_stand_on_a_floor() -> None:
    for radius, height in [(0.2, 1.75), (0.2, 1.6), (0.1, 0.1), (0.25, 0.4), (0.39, 0.72), (0.06, 0.05), (0.3, 0.6)]:
        assert plausible(radius, height), (radius, height)
    pole, sheet, wall, crumb, giant, carpet = (0.05, 1.5), (0.4, 0.03), (0.45, 1.5), (0.03, 0.1), (0.2, 2.1), (0.6, 0.3)
    for radius, height in [pole, sheet, wall, crumb, giant, carpet]:
        assert not plausible(radius, height), (radius, height)


@given(radius=st.floats(0, 1), height=st.floats(0, 3))
def test_plausible_sizes_have_bounds_and_no_gaps(radius: float, height: float) -> None:
    if plausible(radius, height):
        assert 0.05 <= radius <= 0.45 and 0.025 <= height <= 2.0
        assert 0.3 < height / radius * 1.5 and height / radius < 15
        # nothing between two plausible radii of one height is refused
        widest = max(r for r in np.linspace(radius, 0.45, 20) if plausible(r, height))
        assert all(plausible(r, height) for r in np.linspace(radius, widest, 7))


def test_every_size_that_is_tried_has_a_plausible_partner() -> None:
    assert all(any(plausible(r, h) for h in HEIGHTS) for r in RADII)
    assert all(any(plausible(r, h) for r in RADII) for h in HEIGHTS)


# --- planted scenes ------------------------------------------------------------------------------------------
def assert_found(
    found: Sequence[Cylinder], planted: Sequence[Cylinder], *, metres: float = 0.02, size: float = 0.15
) -> None:
    """Each planted thing is found, once, and nothing else is."""
    assert len(found) == len(planted), f"{len(found)} for {len(planted)}: {found}"
    left = list(found)
    for thing in planted:
        nearest = min(left, key=lambda c: float(np.hypot(c.x - thing.x, c.y - thing.y)))
        left.remove(nearest)
        assert np.hypot(nearest.x - thing.x, nearest.y - thing.y) < metres, (thing, nearest)
        assert nearest.radius == pytest.approx(thing.radius, rel=size), (thing, nearest)
        assert nearest.height == pytest.approx(thing.height, rel=size), (thing, nearest)


def explained(evidence: PolarEvidence, **options: Any) -> list[Cylinder]:
    return explain(evidence, floor_places(evidence), **options)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    thing=st.builds(
        cylinder_at,
        x=st.floats(-1.2, 1.2),
        y=st.floats(-0.9, 0.9),
        radius=st.floats(0.08, 0.35),
        height=st.floats(0.1, 0.9),
    ),
    cameras=st.sampled_from([LEFT_RIGHT, THREE]),
)
def test_one_object_comes_back(thing: Cylinder, cameras: tuple[str, ...]) -> None:
    assert_found(explained(seen_from(cameras, [thing])), [thing])


BIG, SMALL = Cylinder(-0.3, 0.05, 0.27, 0.9), Cylinder(0.45, 0.06, 0.11, 0.16)
LOW = Cylinder(0.2, 0.06, 0.11, 0.16)  # so near that from the right it stands before BIG


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


def crowd(count: int, seed: int) -> list[Cylinder]:
    """Things of many sizes, 15 cm apart or more."""
    rng = np.random.default_rng(seed)
    things: list[Cylinder] = []
    while len(things) < count:
        x, y, radius, height = rng.uniform([-1.6, -1.1, 0.08, 0.1], [1.6, 1.1, 0.25, 0.5])
        apart = all(np.hypot(x - t.x, y - t.y) > radius + t.radius + 0.15 for t in things)
        if apart and plausible(radius, height):
            things.append(Cylinder(x, y, radius, height))
    return things


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
    """Two things abreast: the lines from left to one and from right to the other cross where nothing stands."""
    planted = [Cylinder(0.0, 0.35, 0.12, 0.3), Cylinder(0.0, -0.35, 0.12, 0.3), Cylinder(-0.9, 0.02, 0.1, 0.3)]
    evidence = seen_from(LEFT_RIGHT, planted)
    places = floor_places(evidence)
    away = np.min([np.hypot(*(places - [t.x, t.y]).T) - t.radius for t in planted], axis=0)
    assert (away > 0.1).any()  # AND alone would not know better
    assert_found(explain(evidence, places), planted)


@pytest.mark.parametrize(("seed", "share"), [(0, 0.5), (1, 0.2), (2, 0.05), (3, 0.0)])
def test_the_candidates_are_those_of_the_plain_search(seed: int, share: float) -> None:
    """Every height of every place and radius by ``gain``, from low to high until four in a row were worse than the best."""
    here, rng = watch(THREE), np.random.default_rng(seed)
    noise = np.stack([cv2.GaussianBlur(rng.normal(size=seen.shape), (0, 0), 9) for seen in here.seen])
    weights = np.where(noise > np.quantile(noise, 1 - share), 255, -150).astype(np.int32) * here.seen
    sums, seen = running_sums(weights), running_sums(here.seen)
    runs, found = scratch(here), np.empty(3)
    at = _Search(here.views, here.sizes, weights, sums, seen, weights.copy(), sums.copy(), runs, found)
    places = rng.uniform((-2, -1.5), (2, 1.5), (25, 2))
    plain = []
    for (x, y), radius in itertools.product(places, RADII):
        tried, best = [], 0.0
        for height in (h for h in HEIGHTS if plausible(radius, h)):
            thing = np.array([x, y, radius, height])
            tried.append((gain(here.views, here.sizes, sums, seen, thing, 0.15, runs, found), *thing))
            best = max(best, tried[-1][0])
            if best > 0 and len(tried) > 4 and best not in [value for value, *_ in tried[-4:]]:
                break
        if best > 0:
            plain.append(max(tried, key=lambda one: one[0]))
    things, values = _candidates(at, sums, places, 0.15)
    assert len(plain) == len(values) and (len(plain) > 5 or share < 0.1)
    np.testing.assert_allclose(things, np.array([thing for _, *thing in plain]).reshape(-1, 4))
    np.testing.assert_allclose(values, [value for value, *_ in plain], rtol=1e-9)


def test_nothing_seen_is_nothing_there() -> None:
    at = watch()
    everywhere = np.array([[x, y] for x in np.arange(-1.9, 2, 0.2) for y in np.arange(-1.4, 1.5, 0.2)])
    assert explain(seen_from(LEFT_RIGHT, []), everywhere) == []
    assert explain(at.empty, everywhere) == []  # nobody says anything
    assert explain(seen_from(LEFT_RIGHT, [BIG]), np.empty((0, 2))) == []  # and no place to stand
    assert explain(seen_from(LEFT_RIGHT, []), everywhere, before=[BIG, SMALL]) == []


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
    assert_found(explain(evidence, places, before=planted), planted)
    assert_found(
        explain(evidence, planted_places := np.empty((0, 2)), before=planted), planted
    )  # with no search at all
    assert len(planted_places) == 0
    near = [Cylinder(t.x + 0.06, t.y - 0.05, 1.15 * t.radius, 0.85 * t.height) for t in planted]
    assert_found(explain(evidence, places, before=near), planted)
    wrong = [Cylinder(-t.x, -t.y, t.radius, t.height) for t in planted] + [Cylinder(1.5, 1.0, 0.4, 0.5)]
    assert_found(explain(evidence, places, before=wrong), planted)
    assert_found(explain(evidence, places, before=[*planted, planted[0]]), planted)  # twice the same: once


def test_no_more_than_asked_for() -> None:
    evidence = seen_from(LEFT_RIGHT, crowd(4, 0))
    assert len(explained(evidence, how=Explanation(most=2))) == 2
    assert len(explained(evidence, how=Explanation(most=2), before=crowd(4, 0))) == 2


# --- who hides whom --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["four_robots", "long_occlusion"])
def test_hidden_fractions_are_near_those_of_ray_casting(name: str) -> None:
    scene = load_scene(name)
    cameras = tuple(scene.rig.cameras)
    at = watch(cameras, name)
    differences = []
    for frame in range(0, scene.frames, 25):
        things = []
        for thing in scene.objects:
            (x, y), radius = cv2.minEnclosingCircle(thing.footprint(frame).astype(np.float32))
            things.append(Cylinder(float(x), float(y), float(radius), thing.height))
        truth = [true.hidden_fraction for true in ground_truth(scene, frames=[frame]).frames[frame]]
        expected = np.array([[entry.get(camera, np.nan) for camera in cameras] for entry in truth])
        found, by = occlusion_state(at.empty, things)
        np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
        assert (by[expected > 0.05] >= 0).all()
        differences.append(np.abs(found - expected))
    assert np.nanmean(differences) < 0.03
    assert np.nanmax(differences) < 0.45  # a bounding cylinder hides more than a rover does


def hidden_naive(at: Watch, things: Sequence[Cylinder], k: int) -> tuple[list[float], list[int]]:
    masks = [run_masks(at, thing)[k] & at.seen[k] for thing in things]
    distance = [np.hypot(t.x - at.views[k, 0], t.y - at.views[k, 1]) for t in things]
    fractions, by = [], []
    for i, mask in enumerate(masks):
        nearer = [j for j in range(len(things)) if distance[j] < distance[i]]
        hidden = np.any([mask & masks[j] for j in nearer] or [np.zeros_like(mask)], axis=0)
        overlap = {j: int((mask & masks[j]).sum()) for j in nearer}
        fractions.append(hidden.sum() / mask.sum() if mask.any() else np.nan)
        most = max(overlap, key=lambda j: (overlap[j], -j), default=-1)
        by.append(most if most >= 0 and overlap[most] else -1)
    return fractions, by


@settings(max_examples=20, deadline=None)
@given(things=st.lists(cylinders, min_size=1, max_size=5))
def test_the_occlusion_state_is_the_share_of_samples_that_nearer_ones_cover(things: list[Cylinder]) -> None:
    at = watch(THREE, step_px=6.0)
    fractions, by = occlusion_state(at.empty, things)
    assert fractions.shape == by.shape == (len(things), 3)
    for k in range(3):
        expected, hider = hidden_naive(at, things, k)
        np.testing.assert_allclose(fractions[:, k], expected)
        assert by[:, k].tolist() == hider
    assert ((fractions >= 0) & (fractions <= 1)).all()


def test_the_nearer_hides_the_farther_and_the_right_one_is_named() -> None:
    at = watch()
    beside = Cylinder(0.4, 1.0, 0.1, 0.2)
    fractions, by = occlusion_state(at.empty, [SMALL, beside, BIG])
    assert fractions[0].tolist() == [1, 0] and by[0].tolist() == [2, -1]  # behind BIG from the left only
    assert fractions[1].tolist() == [0, 0] and by[1].tolist() == [-1, -1]
    assert fractions[2, 0] == 0 and by[2, 0] == -1  # the small one hides nothing that is nearer
    fractions, by = occlusion_state(at.empty, [BIG, LOW])
    assert fractions[1].tolist() == [1, 0] and by.tolist() == [[-1, 1], [0, -1]]
    assert fractions[0, 0] == 0 and 0 < fractions[0, 1] < 0.5  # from the right it hides some of BIG, which is farther


def test_outside_the_picture_is_nan_and_nobody_hides_it() -> None:
    at = watch()
    fractions, by = occlusion_state(at.empty, [Cylinder(-6.0, 0.0, 0.2, 0.5), BIG])
    assert np.isnan(fractions[0, 0]) and by[0, 0] == -1
    assert (fractions[1] == 0).all()
    fractions, by = occlusion_state(at.empty, [])
    assert fractions.shape == by.shape == (0, 2)


# --- feet ------------------------------------------------------------------------------------------------------
def person(feet: tuple[Point, Point], lean: Point) -> Array:
    """Samples of two legs and of a trunk and head above them, moved by ``lean``, bool (K, rows, columns)."""
    at = watch(THREE)
    x, y = np.mean(feet, axis=0) + lean
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        origin, rays = at.views[k, :3], at.rays[k, :rows, :columns]
        parts = [(0.0, Cylinder(*foot, 0.07, 0.8)) for foot in feet]
        parts += [(0.75, Cylinder(x, y, 0.2, 0.7)), (1.4, Cylinder(x, y, 0.1, 0.28))]
        for z, part in parts:
            masks[k, :rows, :columns] |= hit(origin - [0, 0, z], rays, part)
    return masks


def mean_naive(at: Watch, weights: Array, things: Sequence[Cylinder], i: int) -> Array:
    """The weighted mean of the places near the ``i``-th cylinder, the others' samples taken out."""
    thing, left = things[i], weights.copy()
    for other in [*things[:i], *things[i + 1 :]]:
        left[run_masks(at, other)] = 0
    best = max(gain_of(at, left, thing, 0.15)[0], 1e-9)
    weighed, places = [], []
    nearest = np.argsort(np.hypot(thing.x - at.views[:, 0], thing.y - at.views[:, 1]))[:2]
    for k, step, wider, higher in itertools.product(nearest, np.arange(-4, 5) / 100, (-1, 0, 1), (-1, 0, 1)):
        sight = np.array([thing.x, thing.y]) - at.views[k, :2]
        away = np.linalg.norm(sight)
        height = thing.height + 0.015 * higher - step * (at.views[k, 2] - thing.height) / away
        place, radius = [thing.x, thing.y] + step * sight / away, thing.radius + 0.015 * wider
        if plausible(radius, height):
            value = gain_of(at, left, Cylinder(*place, radius, height), 0.15)[0]
            weighed.append(np.exp(min((value / best - 1) / 0.02, 50)))
            places.append(place)
    return np.average(places, axis=0, weights=weighed) if sum(weighed) else np.array([thing.x, thing.y])


def points_naive(at: Watch, weights: Array, things: Sequence[Cylinder]) -> Array:
    """:func:`standing_points` sample by sample, and solved by ``lstsq``."""
    points = np.array([[thing.x, thing.y] for thing in things])
    for i, thing in enumerate(things):
        if thing.height < PERSON_M:
            points[i] = mean_naive(at, weights, things, i)
            continue
        left = weights.copy()
        for j, other in enumerate(things):
            if j != i:
                left[run_masks(at, Cylinder(other.x, other.y, other.radius + 0.05, other.height + 0.05))] = 0
        for _ in range(3):
            rows, values = [np.array([1.0, 0]), np.array([0, 1.0])], [thing.x, thing.y]
            for k, view in enumerate(at.views):
                offset = points[i] - view[:2]
                away = max(float(np.hypot(*offset)), 0.8)
                turn = (np.arctan2(offset[1], offset[0]) - view[3] + np.pi) % (2 * np.pi) - np.pi
                turns = view[4] + view[6] * np.arange(at.sizes[k, 0])
                drops = view[5] + view[6] * np.arange(at.sizes[k, 1])
                low, high = np.arctan2(view[2] - 0.35, away), np.arctan2(view[2], away - 0.4)
                window = np.ix_((drops >= low) & (drops <= high), np.abs(turns - turn) <= 0.4 / away)
                legs = np.maximum(left[k, : len(drops), : len(turns)][window], 0).sum(axis=0) / 255
                if not legs.any():
                    continue
                ends = np.concatenate([[0], np.cumsum(legs) / legs.sum()])
                edges = np.append(turns[window[1][0]] - view[6] / 2, turns[window[1][0]][-1] + view[6] / 2)
                turn = view[3] + np.interp([1 / 14, 13 / 14], ends, edges).mean()
                share = legs.sum() * (view[6] * np.hypot(away, view[2])) ** 2 / 0.08
                share = min(share, 1, max(2.6 - share, 0))
                normal = 2 * share * np.array([-np.sin(turn), np.cos(turn)])
                rows.append(normal)
                values.append(normal @ view[:2])
            points[i] = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
        lean = points[i] - [thing.x, thing.y]
        points[i] -= lean * max(1 - 0.15 / max(float(np.hypot(*lean)), 0.15), 0)
    return points


@settings(max_examples=30, deadline=None)
@given(
    things=st.lists(cylinders, min_size=2, max_size=3),
    seed=st.integers(0, 99),
    off=st.tuples(*[st.floats(-0.3, 0.3)] * 2),
    noise=st.sampled_from([0.02, 0.1, 1.0]),
)
def test_the_standing_points_are_the_least_squares_and_the_weighted_means(
    things: list[Cylinder], seed: int, off: Point, noise: float
) -> None:
    """Of a body whose legs are not where they are expected, and of what is low, beside it."""
    at, rng = watch(THREE, step_px=6.0), np.random.default_rng(seed)
    shown = [dataclasses.replace(things[0], height=0.6), *things[1:]]
    things = [dataclasses.replace(things[0], x=things[0].x + off[0], y=things[0].y + off[1], height=1.7), *things[1:]]
    weights = np.where(np.any([run_masks(at, thing) for thing in shown], axis=0), 255, -150)
    random = rng.random(at.seen.shape) < noise
    weights[random] = rng.integers(-255, 256, random.sum())
    weights = (weights * at.seen).astype(np.int32)
    evidence = PolarEvidence(at.views, at.sizes, weights, at.seen)
    np.testing.assert_allclose(standing_points(evidence, things), points_naive(at, weights, things), atol=1e-9)
    np.testing.assert_array_equal(evidence.weights, weights)


@pytest.mark.parametrize("stride", [(0.0, 0.16), (0.12, -0.1), (-0.2, -0.05)])
@pytest.mark.parametrize("lean", [(0.12, 0.0), (-0.05, 0.1)])
def test_somebody_who_leans_stands_on_his_feet(stride: Point, lean: Point) -> None:
    middle = np.array([0.1, 0.2])
    at = watch(THREE)
    weights = np.where(person((middle - stride, middle + stride), lean), 255, -round(255 * BACKGROUND)) * at.seen
    evidence = PolarEvidence(at.views, at.sizes, weights.astype(np.int32), at.seen)
    things = explain(evidence, floor_places(evidence))
    assert len(things) == 1 and things[0].height > PERSON_M
    point = standing_points(evidence, things)[0]
    off_axis = np.hypot(*(np.array([things[0].x, things[0].y]) - middle))
    assert np.hypot(*(point - middle)) < min(0.035, off_axis), (point, things)


@pytest.mark.parametrize("spot", [(0.45, 0.0), (0.0, -0.45), (0.3, 0.3)])
def test_what_lies_beside_somebody_does_not_move_him_far(spot: Point) -> None:
    at, feet = watch(THREE), ((0.1, 0.08), (0.1, 0.32))
    box = sample_masks(at, Cylinder(0.1 + spot[0], 0.2 + spot[1], 0.12, 0.25))
    weights = np.where(person(feet, (0, 0)) | box, 255, -round(255 * BACKGROUND)) * at.seen
    evidence = PolarEvidence(at.views, at.sizes, weights.astype(np.int32), at.seen)
    body = Cylinder(0.1, 0.2, 0.17, 1.67)
    assert np.hypot(*(standing_points(evidence, [body])[0] - [0.1, 0.2])) < 0.1501


def test_a_place_right_below_a_camera_is_no_trouble() -> None:
    evidence = seen_from(LEFT_RIGHT, [Cylinder(0.1, 0.2, 0.2, 0.5)])
    above = np.array([0.1, 0.2, 2.5, *evidence.views[0, 3:]])
    blind = np.zeros_like(evidence.weights[:1])
    evidence = PolarEvidence(
        np.vstack([evidence.views, above]),
        np.vstack([evidence.sizes, evidence.sizes[:1]]),
        np.concatenate([evidence.weights, blind]),
        np.concatenate([evidence.seen, blind.astype(bool)]),
    )
    things = explain(evidence, [[0.1, 0.2]])
    assert len(things) == 1 and np.hypot(*(standing_points(evidence, things)[0] - [0.1, 0.2])) < 0.05


def test_the_mean_of_what_explains_nearly_as_much_is_nearer_than_the_best() -> None:
    """Where the left camera sees nothing of a flat thing, a little farther and lower looks the same to the right one."""
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        wall = Cylinder(rng.uniform(-0.3, -0.2), rng.uniform(-0.1, 0.1), 0.3, 0.65)
        flat = Cylinder(wall.x + 0.6, wall.y, rng.uniform(0.09, 0.14), rng.uniform(0.05, 0.1))
        evidence = seen_from(LEFT_RIGHT, [wall, flat])
        things = explain(evidence, floor_places(evidence))
        points = standing_points(evidence, things)
        i = int(np.argmax([thing.x for thing in things]))
        errors.append([np.hypot(x - flat.x, y - flat.y) for x, y in ((things[i].x, things[i].y), points[i])])
    best, mean = np.mean(errors, axis=0)
    assert mean < 0.9 * best and mean < 0.015, errors
    assert standing_points(evidence, []).shape == (0, 2)


# --- wrong arguments -------------------------------------------------------------------------------------------
def test_wrong_evidence_is_named() -> None:
    good = seen_from(LEFT_RIGHT, [])
    shape = good.weights.shape
    wrong: list[tuple[str, Any, str]] = [
        ("weights", good.weights.astype(np.float64), r"weights: expected int32 \(K, rows, columns\), got float64"),
        ("weights", good.weights[0], "weights: expected int32"),
        ("weights", good.weights[:, :-1], r"seen: expected bool \(2, "),
        ("seen", good.seen.astype(np.uint8), "seen: expected bool .* got uint8"),
        ("seen", good.seen[:1], "seen: expected bool"),
        ("views", good.views[:, :7], r"views: expected \(2, 8\) finite numbers, got \(2, 7\)"),
        ("views", good.views[:1], r"views: expected \(2, 8\)"),
        ("views", np.where(np.arange(8) == 2, np.nan, good.views), r"views: expected \(2, 8\) finite"),
        ("sizes", good.sizes[:1], "sizes: expected 2 times columns, rows up to"),
        ("sizes", good.sizes[:, ::-1], f"sizes: .*up to .{shape[2]}, {shape[1]}., got"),
        ("sizes", -good.sizes, "sizes: expected"),
    ]
    for field, value, message in wrong:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(good, **{field: value})


def test_wrong_places_and_cylinders_are_named() -> None:
    evidence = seen_from(LEFT_RIGHT, [BIG])
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="places_m: expected finite numbers, got NaN or infinity"):
            explain(evidence, [[0.0, bad]])
    for places in (np.zeros((4, 3)), np.zeros(3), 5.0):
        with pytest.raises(ValueError, match=r"places_m: expected shape \(N, 2\), got"):
            explain(evidence, places)
    for thing in (
        Cylinder(np.nan, 0, 0.1, 0.1),
        Cylinder(0, 0, 0, 0.1),
        Cylinder(0, 0, 0.1, -1),
        Cylinder(0, 0, np.inf, 1),
    ):
        with pytest.raises(ValueError, match="before: expected finite places and sizes > 0, got"):
            explain(evidence, [[0.0, 0.0]], before=[BIG, thing])
        with pytest.raises(ValueError, match="things: expected finite places and sizes > 0, got"):
            occlusion_state(evidence, [thing])
        with pytest.raises(ValueError, match="things: expected finite places and sizes > 0, got"):
            standing_points(evidence, [thing])
