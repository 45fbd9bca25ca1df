"""Where an object stands: people between their feet, all else at the mean of what explains nearly as much."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.cylinders import (
    BACKGROUND,
    LEFT_RIGHT,
    THREE,
    Array,
    Point,
    Watch,
    floor_places,
    gain_of,
    hit,
    plausible_cylinders,
    run_masks,
    sample_masks,
    seen_from,
    station,
    watch,
)
from occlib.explaining.cylinders import PERSON_M, Cylinder, plausible
from occlib.explaining.evidence import PolarEvidence, PolarView
from occlib.explaining.feet import standing_points
from occlib.explaining.search import explain


def person(feet: tuple[Point, Point], lean: Point) -> Array:
    """Samples of two legs and of a trunk and head above them, moved by ``lean``, bool (K, rows, columns)."""
    at = watch(THREE)
    x, y = np.mean(feet, axis=0) + lean
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        origin, rays = station(at.views[k]), at.rays[k, :rows, :columns]
        parts = [(0.0, Cylinder(*foot, 0.07, 0.8)) for foot in feet]
        parts += [(0.75, Cylinder(x, y, 0.2, 0.7)), (1.4, Cylinder(x, y, 0.1, 0.28))]
        for z, part in parts:
            masks[k, :rows, :columns] |= hit(origin - [0, 0, z], rays, part)
    return masks


def mean_naive(at: Watch, weights: Array, cylinders: Sequence[Cylinder], i: int) -> Array:
    """The weighted mean of the places near the ``i``-th cylinder, the others' samples taken out."""
    cylinder, left = cylinders[i], weights.copy()
    for other in [*cylinders[:i], *cylinders[i + 1 :]]:
        left[run_masks(at, other)] = 0
    best = max(gain_of(at, left, cylinder, 0.15).value, 1e-9)
    weighed, places = [], []
    nearest = np.argsort([np.hypot(cylinder.x - view.x, cylinder.y - view.y) for view in at.views])[:2]
    for k, step, wider, higher in itertools.product(nearest, np.arange(-4, 5) / 100, (-1, 0, 1), (-1, 0, 1)):
        sight = np.array([cylinder.x, cylinder.y]) - station(at.views[k])[:2]
        away = np.linalg.norm(sight)
        height = cylinder.height + 0.015 * higher - step * (at.views[k].height - cylinder.height) / away
        place, radius = [cylinder.x, cylinder.y] + step * sight / away, cylinder.radius + 0.015 * wider
        if plausible(radius, height):
            value = gain_of(at, left, Cylinder(*place, radius, height), 0.15).value
            weighed.append(np.exp(min((value / best - 1) / 0.02, 50)))
            places.append(place)
    return np.average(places, axis=0, weights=weighed) if sum(weighed) else np.array([cylinder.x, cylinder.y])


def points_naive(at: Watch, weights: Array, cylinders: Sequence[Cylinder]) -> Array:
    """:func:`standing_points` sample by sample, and solved by ``lstsq``."""
    points = np.array([[cylinder.x, cylinder.y] for cylinder in cylinders])
    for i, cylinder in enumerate(cylinders):
        if cylinder.height < PERSON_M:
            points[i] = mean_naive(at, weights, cylinders, i)
            continue
        left = weights.copy()
        for j, other in enumerate(cylinders):
            if j != i:
                left[run_masks(at, Cylinder(other.x, other.y, other.radius + 0.05, other.height + 0.05))] = 0
        for _ in range(3):
            rows, values = [np.array([1.0, 0]), np.array([0, 1.0])], [cylinder.x, cylinder.y]
            for k, view in enumerate(at.views):
                offset = points[i] - station(view)[:2]
                away = max(float(np.hypot(*offset)), 0.8)
                turn = (np.arctan2(offset[1], offset[0]) - view.middle + np.pi) % (2 * np.pi) - np.pi
                turns = view.left + view.step * np.arange(at.sizes[k, 0])
                drops = view.top + view.step * np.arange(at.sizes[k, 1])
                low, high = np.arctan2(view.height - 0.35, away), np.arctan2(view.height, away - 0.4)
                window = np.ix_((drops >= low) & (drops <= high), np.abs(turns - turn) <= 0.4 / away)
                legs = np.maximum(left[k, : len(drops), : len(turns)][window], 0).sum(axis=0) / 255
                if not legs.any():
                    continue
                ends = np.concatenate([[0], np.cumsum(legs) / legs.sum()])
                edges = np.append(turns[window[1][0]] - view.step / 2, turns[window[1][0]][-1] + view.step / 2)
                turn = view.middle + np.interp([1 / 14, 13 / 14], ends, edges).mean()
                share = legs.sum() * (view.step * np.hypot(away, view.height)) ** 2 / 0.08
                share = min(share, 1, max(2.6 - share, 0))
                normal = 2 * share * np.array([-np.sin(turn), np.cos(turn)])
                rows.append(normal)
                values.append(normal @ station(view)[:2])
            points[i] = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
        lean = points[i] - [cylinder.x, cylinder.y]
        points[i] -= lean * max(1 - 0.15 / max(float(np.hypot(*lean)), 0.15), 0)
    return points


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(
    cylinders=st.lists(plausible_cylinders, min_size=2, max_size=3),
    seed=st.integers(0, 99),
    off=st.tuples(*[st.floats(-0.3, 0.3)] * 2),
    noise=st.sampled_from([0.02, 0.1, 1.0]),
)
def test_the_standing_points_are_the_least_squares_and_the_weighted_means(
    cylinders: list[Cylinder], seed: int, off: Point, noise: float
) -> None:
    """Of a body whose legs are not where they are expected, and of what is low, beside it."""
    at, rng = watch(THREE, step_px=6.0), np.random.default_rng(seed)
    shown = [cylinders[0]._replace(height=0.6), *cylinders[1:]]
    cylinders = [
        cylinders[0]._replace(x=cylinders[0].x + off[0], y=cylinders[0].y + off[1], height=1.7),
        *cylinders[1:],
    ]
    weights = np.where(np.any([run_masks(at, cylinder) for cylinder in shown], axis=0), 255, -150)
    random = rng.random(at.seen.shape) < noise
    weights[random] = rng.integers(-255, 256, random.sum())
    evidence = at.evidence(weights)
    weights = evidence.weights.copy()
    np.testing.assert_allclose(standing_points(evidence, cylinders), points_naive(at, weights, cylinders), atol=1e-9)
    np.testing.assert_array_equal(evidence.weights, weights)


@pytest.mark.parametrize("stride", [(0.0, 0.16), (0.12, -0.1), (-0.2, -0.05)])
@pytest.mark.parametrize("lean", [(0.12, 0.0), (-0.05, 0.1)])
def test_somebody_who_leans_stands_on_his_feet(stride: Point, lean: Point) -> None:
    middle = np.array([0.1, 0.2])
    at = watch(THREE)
    weights = np.where(person((middle - stride, middle + stride), lean), 255, -round(255 * BACKGROUND))
    evidence = at.evidence(weights)
    cylinders = explain(evidence, floor_places(evidence))
    assert len(cylinders) == 1 and cylinders[0].height > PERSON_M
    point = standing_points(evidence, cylinders)[0]
    off_axis = np.hypot(*(np.array([cylinders[0].x, cylinders[0].y]) - middle))
    assert np.hypot(*(point - middle)) < min(0.035, off_axis), (point, cylinders)


@pytest.mark.parametrize("spot", [(0.45, 0.0), (0.0, -0.45), (0.3, 0.3)])
def test_what_lies_beside_somebody_does_not_move_him_far(spot: Point) -> None:
    at, feet = watch(THREE), ((0.1, 0.08), (0.1, 0.32))
    box = sample_masks(at, Cylinder(0.1 + spot[0], 0.2 + spot[1], 0.12, 0.25))
    weights = np.where(person(feet, (0, 0)) | box, 255, -round(255 * BACKGROUND))
    evidence = at.evidence(weights)
    body = Cylinder(0.1, 0.2, 0.17, 1.67)
    assert np.hypot(*(standing_points(evidence, [body])[0] - [0.1, 0.2])) < 0.1501


def test_a_place_right_below_a_camera_is_no_trouble() -> None:
    evidence = seen_from(LEFT_RIGHT, [Cylinder(0.1, 0.2, 0.2, 0.5)])
    above = PolarView(*evidence.views[0])._replace(x=0.1, y=0.2, height=2.5)
    blind = np.zeros_like(evidence.weights[:1])
    evidence = PolarEvidence(
        np.vstack([evidence.views, above]),
        np.vstack([evidence.sizes, evidence.sizes[:1]]),
        np.concatenate([evidence.weights, blind]),
        np.concatenate([evidence.seen, blind.astype(bool)]),
    )
    cylinders = explain(evidence, [[0.1, 0.2]])
    assert len(cylinders) == 1 and np.hypot(*(standing_points(evidence, cylinders)[0] - [0.1, 0.2])) < 0.05


@pytest.mark.slow
def test_the_mean_of_what_explains_nearly_as_much_is_nearer_than_the_best() -> None:
    """Where only the right camera sees something flat, a little farther and lower looks the same to it."""
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        wall = Cylinder(rng.uniform(-0.3, -0.2), rng.uniform(-0.1, 0.1), 0.3, 0.65)
        flat = Cylinder(wall.x + 0.6, wall.y, rng.uniform(0.09, 0.14), rng.uniform(0.05, 0.1))
        evidence = seen_from(LEFT_RIGHT, [wall, flat])
        cylinders = explain(evidence, floor_places(evidence))
        points = standing_points(evidence, cylinders)
        i = int(np.argmax([cylinder.x for cylinder in cylinders]))
        errors.append([np.hypot(x - flat.x, y - flat.y) for x, y in ((cylinders[i].x, cylinders[i].y), points[i])])
    best, mean = np.mean(errors, axis=0)
    assert mean < 0.9 * best and mean < 0.015, errors
    assert standing_points(evidence, []).shape == (0, 2)


def test_a_cylinder_that_is_none_is_named() -> None:
    with pytest.raises(ValueError, match="cylinders: expected finite places and sizes > 0, got"):
        standing_points(seen_from(LEFT_RIGHT, []), [Cylinder(np.nan, 0, 0.1, 0.1)])
