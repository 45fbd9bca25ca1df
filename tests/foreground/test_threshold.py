"""The threshold: an empty frame stays empty, a planted object is cut out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.filters import threshold_otsu

from helpers.floors import HEIGHT, WIDTH, as_uint8, noisy, relit, textured_floor
from occlib.foreground.background import (
    average_background,
)
from occlib.foreground.difference import foreground_mask, smooth, subtract_background
from occlib.foreground.threshold import THRESHOLDS, otsu_threshold, threshold_level, triangle_threshold


def test_an_empty_noisy_frame_has_no_foreground_but_without_a_noise_floor_it_would() -> None:
    rng = np.random.default_rng(1)
    floor = textured_floor()
    background = average_background([noisy(floor, 2.0, rng) for _ in range(8)])
    frame = noisy(floor, 2.0, rng)
    for threshold in (*THRESHOLDS, "noise"):
        for colour in (True, False):
            assert not foreground_mask(frame, background, threshold=threshold, colour=colour).any()
    difference = smooth(subtract_background(frame, background))
    trap = difference > threshold_level(difference, "otsu")
    assert trap.mean() > 0.1  # Otsu always splits in two


def test_a_planted_object_is_cut_out_under_other_light_and_noise() -> None:
    rng = np.random.default_rng(2)
    floor = textured_floor()
    background = average_background([noisy(floor, 2.0, rng) for _ in range(6)])
    scene = floor.copy()
    scene[30:70, 40:90] = (30, 30, 35)
    planted = np.zeros((HEIGHT, WIDTH), bool)
    planted[30:70, 40:90] = True
    mask = foreground_mask(noisy(relit(scene, 1.15, -10.0), 2.0, rng), background)
    assert mask.dtype == np.bool_
    assert (mask & planted).sum() / (mask | planted).sum() > 0.97


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0.05, 0.6), bright=st.integers(60, 220))
def test_otsu_agrees_with_scikit_image(seed: int, share: float, bright: int) -> None:
    rng = np.random.default_rng(seed)
    picture = as_uint8(
        np.where(rng.random((60, 80)) < share, rng.normal(bright, 12, (60, 80)), rng.gamma(2, 6, (60, 80)))
    )
    assert otsu_threshold(picture) == pytest.approx(threshold_otsu(picture), abs=1)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), side=st.integers(4, 12), bright=st.integers(80, 255))
def test_the_triangle_cuts_a_small_object_out_of_noise(seed: int, side: int, bright: int) -> None:
    picture = as_uint8(np.abs(np.random.default_rng(seed).normal(0, 3, (120, 160))))
    picture[20 : 20 + side, 30 : 30 + side] = bright
    mask = picture > triangle_threshold(picture)
    assert mask[20 : 20 + side, 30 : 30 + side].all()
    assert mask.sum() - side**2 < 0.02 * mask.size


@given(noise_floor=st.floats(0, 80), level=st.floats(0, 255))
def test_no_found_threshold_lies_below_the_noise_floor_and_a_given_one_is_taken_as_it_is(
    noise_floor: float, level: float
) -> None:
    picture = np.repeat(np.array([3, 200], np.uint8), 50).reshape(10, 10)
    for threshold in (*THRESHOLDS, "noise"):
        assert threshold_level(picture, threshold, noise_floor=noise_floor) >= noise_floor
    assert threshold_level(picture, level, noise_floor=noise_floor) == level
    assert threshold_level(picture, "noise", noise_floor=noise_floor) == noise_floor
