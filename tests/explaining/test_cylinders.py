"""Silhouettes of upright cylinders are what rays meet, and sizes that may stand on a floor have bounds and no gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.cylinders import plausible_cylinders, run_masks, sample_masks, watch
from occlib.explaining.cylinders import Cylinder, as_array, cylinder_at, plausible


@settings(max_examples=25, deadline=None)
@given(cylinder=plausible_cylinders)
def test_a_silhouette_is_what_the_rays_meet(cylinder: Cylinder) -> None:
    at = watch()
    truth, found = sample_masks(at, cylinder), run_masks(at, cylinder)
    assert truth.any(axis=(1, 2)).all()
    differ = truth != found
    assert differ.sum(axis=1).max() <= 1  # a row at the rims
    assert differ.sum() <= 4  # and only where rounding decides


@pytest.mark.parametrize("height", [2.5, 2.6, 2.9])
def test_something_higher_than_the_camera_is_seen_up_to_its_near_edge(height: float) -> None:
    at = watch()
    cylinder = Cylinder(-1.5, 0.2, 0.3, height)
    differ = sample_masks(at, cylinder) != run_masks(at, cylinder)
    assert differ.sum(axis=1).max() <= 1 and differ.sum() <= 4


def test_no_silhouette_outside_the_picture_and_none_from_within() -> None:
    at = watch()
    behind = Cylinder(-6.0, 0.0, 0.3, 1.0)  # behind the left camera, far off for the right one
    masks = run_masks(at, behind)
    assert not masks[0].any()
    around = Cylinder(at.views[0].x + 0.2, at.views[0].y, 0.3, 1.0)  # around the left camera's mast
    assert not run_masks(at, around)[0].any()


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


# --- arrays of them --------------------------------------------------------------------------------------------
def test_cylinders_become_an_array_and_come_back() -> None:
    cylinders = [Cylinder(0.5, -1.0, 0.2, 0.4), Cylinder(1.5, 0.0, 0.3, 1.7)]
    array = as_array(cylinders, "cylinders")
    assert array.shape == (2, 4) and array.dtype == np.float64
    assert [cylinder_at(array, i) for i in range(2)] == cylinders
    assert as_array([], "cylinders").shape == (0, 4)
