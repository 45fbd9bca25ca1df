"""What a cylinder explains, and a set of them, is the plain sum over the samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.cylinders import (
    THREE,
    Array,
    Watch,
    gain_of,
    plausible_cylinders,
    random_weights,
    run_masks,
    station,
    watch,
)
from occlib.explaining.cylinders import CHIN, HEAD, LEGS, PERSON_M, Cylinder, as_array, run_of, span_of
from occlib.explaining.evidence import running_sums
from occlib.explaining.objective import cover, objective, workspace


def counted(at: Watch, weights: Array, cylinder: Cylinder) -> tuple[Array, list[float]]:
    """The samples by which a cylinder is judged, and for each view the foreground right beyond its base and top.

    All samples of its silhouette; of a person, head and legs only in columns that show more foreground there.
    """
    masks, beyond = np.zeros(at.seen.shape, bool), [0.0] * len(at.views)
    to_chin = cylinder._replace(height=CHIN * cylinder.height)
    for k, (columns, rows) in enumerate(at.sizes.tolist()):
        view = at.views[k]
        span = span_of(view, columns, cylinder.x, cylinder.y, cylinder.radius)
        to_axis = np.array([cylinder.x, cylinder.y]) - station(view)[:2]
        for column in range(span.first, span.last):
            low, high, above, below, _, _ = run_of(view, rows, cylinder, span, column)
            evidence = weights[k, :, column].astype(int)
            beyond[k] += max(evidence[high:below].sum(), 0) / 255
            azimuth = view.middle + view.left + column * view.step
            sight = np.array([np.cos(azimuth), np.sin(azimuth)])
            chord = np.sqrt(max(cylinder.radius**2 - (to_axis @ [-sight[1], sight[0]]) ** 2, 0))  # half of it
            if cylinder.height >= PERSON_M:
                chin = run_of(view, rows, to_chin, span, column).low
                trunk = chin if chord < HEAD * cylinder.radius else low
                if evidence[low:trunk].sum() <= 0:
                    low, above = trunk, above + trunk - low
                drop = np.arctan2(view.height - LEGS * cylinder.height, to_axis @ sight - chord)
                legs = int(np.clip(np.ceil((drop - view.top) / view.step), trunk, high))
                high = legs if evidence[legs:high].sum() <= 0 else high
            beyond[k] += max(evidence[above:low].sum(), 0) / 255
            masks[k, low:high, column] = True
    return masks, beyond


@settings(max_examples=30, deadline=None)
@given(cylinder=plausible_cylinders, seed=st.integers(0, 99), cost=st.floats(0, 0.5))
def test_the_gain_is_the_plain_sum_over_the_samples(cylinder: Cylinder, seed: int, cost: float) -> None:
    """Half of the time for a person, at whose head and legs there is foreground in some columns only."""
    at = watch(THREE, step_px=6.0)
    weights = random_weights(at, seed)
    if seed % 2:
        cylinder = cylinder._replace(height=1.4 + 0.3 * cylinder.height)
        weights[:, :, seed % 7 :: 3] = -abs(weights[:, :, seed % 7 :: 3])
    masks, beyond = counted(at, weights, cylinder)
    total = area = square = share = 0.0
    for k, view in enumerate(at.views):
        covered = int((masks[k] & at.seen[k]).sum())
        explained = float(weights[k][masks[k]].sum()) / 255
        slant = np.linalg.norm([cylinder.x - view.x, cylinder.y - view.y, cylinder.height / 2 - view.height])
        total += (explained - beyond[k]) * view.weight
        area += covered * view.weight
        square += explained * (view.step * slant) ** 2
        share = max(share, explained / max(covered, 1))
    found = gain_of(at, weights, cylinder, cost)
    assert found.value == pytest.approx(total - cost * area, abs=1e-6)
    assert found.explained_m2 == pytest.approx(square, abs=1e-6)
    assert found.best_share == pytest.approx(share, abs=1e-6)
    assert found.net_share == pytest.approx(total / max(area, 1e-9), abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(cylinder=plausible_cylinders, seed=st.integers(0, 99), margin=st.sampled_from([0.0, 0.05, 0.2]))
def test_covering_takes_the_samples_out_and_keeps_the_sums_right(cylinder: Cylinder, seed: int, margin: float) -> None:
    at = watch(step_px=6.0)
    before = random_weights(at, seed)
    work = workspace(at.evidence(before))
    cover(work, work.left, work.left_sums, cylinder, margin)
    inside = run_masks(at, cylinder._replace(radius=cylinder.radius + margin, height=cylinder.height + margin))
    assert inside.any() and not work.left[inside].any()
    np.testing.assert_array_equal(work.left[~inside], before[~inside])
    np.testing.assert_array_equal(work.weights, before)  # the evidence stays as it is
    for k, rows in enumerate(at.sizes[:, 1]):  # padding below a view is never looked at
        np.testing.assert_array_equal(work.left_sums[k, : rows + 1], running_sums(work.left)[k, : rows + 1])


@settings(max_examples=20, deadline=None)
@given(cylinders=st.lists(plausible_cylinders, max_size=4), seed=st.integers(0, 99), cost=st.floats(0, 0.5))
def test_the_objective_counts_what_several_cover_once(cylinders: list[Cylinder], seed: int, cost: float) -> None:
    at = watch(step_px=6.0)
    weights = random_weights(at, seed)
    cylinders = [*cylinders, *cylinders[:1]]  # the first one twice: pays its price twice and explains once
    expected, left = 0.0, weights.copy()
    for cylinder in cylinders:
        masks, beyond = counted(at, left, cylinder)
        for k, view in enumerate(at.views):
            covered, explained = int((masks[k] & at.seen[k]).sum()), float(left[k][masks[k]].sum()) / 255
            expected += (explained - beyond[k] - cost * covered) * view.weight
        left[run_masks(at, cylinder)] = 0
    work = workspace(at.evidence(weights))
    value = objective(work, as_array(cylinders, "cylinders"), len(cylinders), cost)
    assert value == pytest.approx(expected, abs=1e-6)
    np.testing.assert_array_equal(work.weights, weights)
