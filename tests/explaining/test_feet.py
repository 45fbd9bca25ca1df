"""Where an object stands: people between their feet, all else at the mean of what explains nearly as much."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.prisms import (
    LEFT_RIGHT,
    THREE,
    Array,
    Point,
    Watch,
    any_prisms,
    floor_places,
    gain_of,
    person,
    run_masks,
    sample_masks,
    seen_from,
    shown,
    station,
    watch,
)
from occlib.explaining.evidence import PolarEvidence, PolarView
from occlib.explaining.feet import standing_points
from occlib.explaining.prisms import PERSON_M, Prism, is_body, is_person, larger, plausible
from occlib.explaining.search import DEFAULT, explain


def left_by(at: Watch, weights: Array, others: Sequence[Prism], margin: float) -> Array:
    """What others, enlarged, leave of the weights: nothing where they stand, a quarter where a person's legs may be."""
    counts, absorbed = np.zeros(at.seen.shape, int), np.zeros(at.seen.shape, int)
    for other in others:
        counts += run_masks(at, larger(other, margin))
        if is_body(other):
            absorbed += 75 * run_masks(at, Prism(other.x, other.y, other.radius + 0.25, 0.4 * other.height))
    left = np.where(weights > 0, weights * np.maximum(100 - absorbed, 0) // 100, weights)
    return np.where(counts > 0, 0, left)


def mean_naive(at: Watch, left: Array, prism: Prism) -> Array:
    """The weighted mean of the places near the prism, of what others leave."""
    best = gain_of(at, left, prism, DEFAULT.cost).value
    if best < 1:  # it explains nothing: where rounding says
        return np.full(2, np.nan)
    weighed, places = [], []
    nearest = np.argsort([np.hypot(prism.x - view.x, prism.y - view.y) for view in at.views])[:2]
    for k, step, wider, higher in itertools.product(nearest, np.arange(-4, 5) / 100, (-1, 0, 1), (-1, 0, 1)):
        sight = np.array([prism.x, prism.y]) - station(at.views[k])[:2]
        away = np.linalg.norm(sight)
        height = prism.height + 0.015 * higher - step * (at.views[k].height - prism.height) / away
        x, y = [prism.x, prism.y] + step * sight / away
        other = prism._replace(x=x, y=y, radius=prism.radius + 0.015 * wider, height=height)
        if plausible(other):
            value = gain_of(at, left, other, DEFAULT.cost).value
            weighed.append(np.exp(min((value / best - 1) / 0.02, 50)))
            places.append([x, y])
    return np.average(places, axis=0, weights=weighed) if sum(weighed) else np.array([prism.x, prism.y])


def points_naive(at: Watch, weights: Array, prisms: Sequence[Prism]) -> Array:
    """:func:`standing_points` sample by sample, and solved by ``lstsq``."""
    points = np.array([[prism.x, prism.y] for prism in prisms])
    for i, prism in enumerate(prisms):
        others = [*prisms[:i], *prisms[i + 1 :]]
        if not is_person(prism):
            points[i] = mean_naive(at, left_by(at, weights, others, 0.0), prism)
            continue
        left = left_by(at, weights, others, 0.05)
        for _ in range(3):
            rows, values = [np.array([1.0, 0]), np.array([0, 1.0])], [prism.x, prism.y]
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
        lean = points[i] - [prism.x, prism.y]
        points[i] -= lean * max(1 - 0.15 / max(float(np.hypot(*lean)), 0.15), 0)
    return points


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(
    prisms=st.lists(any_prisms, min_size=2, max_size=3),
    seed=st.integers(0, 99),
    off=st.tuples(*[st.floats(-0.3, 0.3)] * 2),
    noise=st.sampled_from([0.02, 0.1, 1.0]),
)
def test_the_standing_points_are_the_least_squares_and_the_weighted_means(
    prisms: list[Prism], seed: int, off: Point, noise: float
) -> None:
    """Of a body whose legs are not where they are expected, and of what is low, beside it."""
    at, rng = watch(THREE, step_px=6.0), np.random.default_rng(seed)
    body = Prism(prisms[0].x + off[0], prisms[0].y + off[1], max(prisms[0].radius, 0.15), 1.7)
    shown = [body._replace(x=prisms[0].x, y=prisms[0].y, height=0.6), *prisms[1:]]
    prisms = [body, *prisms[1:]]
    weights = np.where(np.any([run_masks(at, prism) for prism in shown], axis=0), 255, -150)
    random = rng.random(at.seen.shape) < noise
    weights[random] = rng.integers(-255, 256, random.sum())
    evidence = at.evidence(weights)
    weights = evidence.weights.copy()
    found, expected = standing_points(evidence, prisms), points_naive(at, weights, prisms)
    known = np.isfinite(expected)
    np.testing.assert_allclose(found[known], expected[known], atol=1e-9)
    np.testing.assert_array_equal(evidence.weights, weights)


@pytest.mark.parametrize("stride", [(0.0, 0.16), (0.12, -0.1), (-0.2, -0.05)])
@pytest.mark.parametrize("lean", [(0.12, 0.0), (-0.05, 0.1)])
def test_somebody_who_leans_stands_on_his_feet(stride: Point, lean: Point) -> None:
    middle = np.array([0.1, 0.2])
    at = watch(THREE)
    evidence = shown(at, person(at, (middle - stride, middle + stride), lean))
    (body,) = explain(evidence, floor_places(evidence)).prisms
    assert body.height > PERSON_M
    point = standing_points(evidence, [body])[0]
    off_axis = np.hypot(*(np.array([body.x, body.y]) - middle))
    assert np.hypot(*(point - middle)) < min(0.035, off_axis), (point, body)


@pytest.mark.parametrize("spot", [(0.45, 0.0), (0.0, -0.45), (0.3, 0.3)])
def test_what_lies_beside_somebody_does_not_move_him_far(spot: Point) -> None:
    at, feet = watch(THREE), ((0.1, 0.08), (0.1, 0.32))
    box = sample_masks(at, Prism(0.1 + spot[0], 0.2 + spot[1], 0.12, 0.25))
    evidence = shown(at, person(at, feet) | box)
    body = Prism(0.1, 0.2, 0.17, 1.67)
    assert np.hypot(*(standing_points(evidence, [body])[0] - [0.1, 0.2])) < 0.1501


def test_a_place_right_below_a_camera_is_no_trouble() -> None:
    evidence = seen_from(LEFT_RIGHT, [Prism(0.1, 0.2, 0.2, 0.5)])
    above = PolarView(*evidence.views[0])._replace(x=0.1, y=0.2, height=2.5)
    blind = np.zeros_like(evidence.weights[:1])
    evidence = PolarEvidence(
        np.vstack([evidence.views, above]),
        np.vstack([evidence.sizes, evidence.sizes[:1]]),
        np.concatenate([evidence.weights, blind]),
        np.concatenate([evidence.seen, blind.astype(bool)]),
    )
    (drum,) = explain(evidence, [[0.1, 0.2]]).prisms
    assert np.hypot(*(standing_points(evidence, [drum])[0] - [0.1, 0.2])) < 0.05


@pytest.mark.slow
def test_the_mean_of_what_explains_nearly_as_much_is_nearer_than_the_best() -> None:
    """Where only the right camera sees something flat, a little farther and lower looks the same to it."""
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        wall = Prism(rng.uniform(-0.3, -0.2), rng.uniform(-0.1, 0.1), 0.3, 0.65)
        flat = Prism(wall.x + 0.6, wall.y, rng.uniform(0.09, 0.14), rng.uniform(0.05, 0.1))
        evidence = seen_from(LEFT_RIGHT, [wall, flat])
        first = explain(evidence, floor_places(evidence))
        prisms = explain(evidence, floor_places(evidence), previous=first).prisms
        points = standing_points(evidence, prisms)
        i = int(np.argmax([prism.x for prism in prisms]))
        errors.append([np.hypot(x - flat.x, y - flat.y) for x, y in (prisms[i][:2], points[i])])
    best, mean = np.mean(errors, axis=0)
    assert mean < 0.9 * best and mean < 0.015, errors
    assert standing_points(evidence, []).shape == (0, 2)


def test_what_is_no_prism_is_named() -> None:
    with pytest.raises(ValueError, match="prisms: expected finite places, sizes > 0 and a known outline, got"):
        standing_points(seen_from(LEFT_RIGHT, []), [Prism(np.nan, 0, 0.1, 0.1)])
