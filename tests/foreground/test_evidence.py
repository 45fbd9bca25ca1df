"""The foreground of one view: planted light changes are undone, an empty frame stays empty, the floor is learned."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.filters import threshold_otsu

from occlib.foreground.background import (
    LEAST_NOISE_FLOOR,
    Background,
    as_background,
    average_background,
    update_background,
    weighted_median,
)
from occlib.foreground.difference import foreground_mask, smooth, subtract_background
from occlib.foreground.intensity import adjust_intensity, channel_gain_offset, intensity_gain_offset, to_grey
from occlib.foreground.learning import learn_background
from occlib.foreground.shadows import SURE, ShadowModel, foreground_evidence, foreground_evidence_naive
from occlib.foreground.threshold import THRESHOLDS, otsu_threshold, threshold_level, triangle_threshold
from occlib.lab.scenes import load_scene
from occlib.lab.truth import silhouettes
from occlib.recordings import LAB, open_recording

Pixels = np.ndarray[Any, np.dtype[np.uint8]]
HEIGHT, WIDTH = 120, 160


def as_uint8(levels: Any) -> Pixels:
    return np.asarray(np.clip(np.round(levels), 0, 255), dtype=np.uint8)


def textured_floor(seed: int = 0) -> Pixels:
    """A floor with shading from 70 to 180 grey levels, a slight tint and grain."""
    rng = np.random.default_rng(seed)
    shade = np.linspace(90, 160, WIDTH)[None, :, None] + np.linspace(-20, 20, HEIGHT)[:, None, None]
    return as_uint8(shade + np.array([4, 0, -6]) + rng.normal(0, 4, (HEIGHT, WIDTH, 3)))


def relit(image: Pixels, gain: float, offset: float) -> Pixels:
    """The frame for which ``image = gain * frame + offset``."""
    return as_uint8((image - offset) / gain)


def noisy(image: Pixels, sigma: float, rng: np.random.Generator) -> Pixels:
    return as_uint8(image + rng.normal(0, sigma, image.shape))


# --- intensity -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("colour", [(15, 15, 20), (250, 240, 235), (200, 30, 30)])
@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (1.25, -20.0), (0.8, 15.0), (1.4, -30.0), (1.0, 25.0)])
def test_planted_gain_and_offset_come_back_despite_an_object_over_a_third(
    gain: float, offset: float, colour: tuple[int, int, int]
) -> None:
    floor = textured_floor()
    frame = relit(floor, gain, offset)
    frame[10:90, 30:116] = colour
    assert 80 * 86 / (HEIGHT * WIDTH) > 0.35
    found = intensity_gain_offset(frame, floor, step=4)
    assert found[0] == pytest.approx(gain, abs=0.02)
    assert found[0] * 120 + found[1] == pytest.approx(gain * 120 + offset, abs=1.0)  # at mid grey, within a level


@settings(max_examples=30, deadline=None)
@given(gain=st.floats(0.75, 1.4), offset=st.floats(-25, 25), seed=st.integers(0, 100))
def test_the_adjusted_frame_is_the_background_again(gain: float, offset: float, seed: int) -> None:
    floor = textured_floor(seed)
    adjusted = adjust_intensity(relit(floor, gain, offset), floor)
    assert np.abs(adjusted.astype(int) - floor).mean() < 1.0


def test_a_flat_picture_gives_a_pure_offset_and_never_nan() -> None:
    flat = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    assert intensity_gain_offset(flat, flat) == (1.0, 0.0)
    assert intensity_gain_offset(flat, flat + np.uint8(30)) == (1.0, 30.0)
    black = np.zeros_like(flat)
    assert np.isfinite(intensity_gain_offset(black, textured_floor())).all()


def test_a_picture_smaller_than_the_sampling_step_is_adjusted_too() -> None:
    tiny = np.full((3, 5, 3), 90, np.uint8)
    assert intensity_gain_offset(tiny, tiny + np.uint8(10)) == (1.0, 10.0)


def test_gain_is_held_between_a_half_and_two() -> None:
    floor = np.repeat(as_uint8(np.linspace(0, 250, WIDTH))[None, :, None], HEIGHT, axis=0).repeat(3, axis=2)
    assert intensity_gain_offset(as_uint8(floor / 2.5), floor, step=4)[0] == 2.0
    assert intensity_gain_offset(floor, as_uint8(floor / 2.5), step=4)[0] == 0.5


def test_adjusting_clips_at_black_and_white_and_never_folds() -> None:
    floor = textured_floor()
    darker = relit(floor, 1.0, -60.0)  # the frame is brighter than the floor by 60, so 60 is taken away
    darker[:20, :20] = 10
    assert (adjust_intensity(darker, floor)[:20, :20] == 0).all()  # |10 - 60| would be 50
    brighter = relit(floor, 1.0, 60.0)
    brighter[:20, :20] = 240
    assert (adjust_intensity(brighter, floor)[:20, :20] == 255).all()  # (240 + 60) mod 256 would be 44


# --- difference ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("adjust", [True, False])
def test_identical_pictures_differ_by_zero(colour: bool, adjust: bool) -> None:
    floor = textured_floor()
    assert not subtract_background(floor, Background(floor), adjust=adjust, colour=colour).any()


def test_difference_of_a_known_object_is_its_contrast_in_grey_levels() -> None:
    floor = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    frame = floor.copy()
    frame[40:60, 50:80] = 160
    for colour in (True, False):
        difference = subtract_background(frame, Background(floor), colour=colour)
        assert difference.dtype == np.uint8 and difference.shape == (HEIGHT, WIDTH)
        assert (difference[40:60, 50:80] == 60).all() and difference.sum() == 60 * 20 * 30


def test_light_change_alone_is_no_difference_when_adjusted() -> None:
    floor = textured_floor()
    frame = relit(floor, 1.2, -15.0)
    assert subtract_background(frame, Background(floor), adjust=False).mean() > 5
    assert subtract_background(frame, Background(floor)).mean() < 1


def test_colour_sees_an_object_as_bright_as_the_floor_that_grey_does_not() -> None:
    floor = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    frame = floor.copy()
    frame[40:80, 50:90] = (200, 60, 44)
    assert (to_grey(frame) == 100).all()
    planted = np.zeros((HEIGHT, WIDTH), bool)
    planted[40:80, 50:90] = True
    background = Background(floor)
    assert not foreground_mask(frame, background, colour=False, size=1).any()
    np.testing.assert_array_equal(foreground_mask(frame, background, colour=True, size=1), planted)


def test_to_grey_weights_red_green_and_blue_in_that_order() -> None:
    primaries = np.diag([255, 255, 255]).astype(np.uint8)[None]
    assert to_grey(primaries).tolist() == [[76, 150, 29]]


def test_smoothing_keeps_the_mean_and_removes_a_lone_pixel() -> None:
    lone = np.zeros((41, 41), np.uint8)
    lone[20, 20] = 200
    blurred = smooth(lone)
    assert blurred.max() < 40 and float(blurred.sum()) == pytest.approx(200, abs=13)
    assert np.unravel_index(blurred.argmax(), blurred.shape) == (20, 20)
    np.testing.assert_array_equal(smooth(lone, size=1), lone)


# --- threshold -----------------------------------------------------------------------------------------
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


# --- background ----------------------------------------------------------------------------------------
def test_average_background_has_the_mean_and_the_planted_noise() -> None:
    rng = np.random.default_rng(3)
    floor = textured_floor()
    background = average_background([noisy(floor, 3.0, rng) for _ in range(40)])
    assert np.abs(background.image.astype(int) - floor).max() <= 3
    assert background.noise == pytest.approx(3.0, abs=0.15)
    assert background.noise_floor == pytest.approx(18.0, abs=0.9)
    few = average_background([noisy(floor, 3.0, rng) for _ in range(3)])
    assert few.noise == pytest.approx(3.0, abs=0.15)
    single = average_background([floor])
    np.testing.assert_array_equal(single.image, floor)
    assert (single.noise, single.noise_floor) == (0.0, LEAST_NOISE_FLOOR)


def test_the_mean_is_rounded_not_cut_off() -> None:
    pair = [np.full((2, 2, 3), level, np.uint8) for level in (10, 11, 11)]
    assert (average_background(pair).image == 11).all()


def crowded_frames(standing: float, *, count: int = 80) -> tuple[list[Pixels], np.ndarray[Any, Any]]:
    """Never an empty frame: one object stands for a share of the time, another walks through all the time."""
    rng = np.random.default_rng(4)
    floor, frames = textured_floor(), []
    spot = np.zeros((HEIGHT, WIDTH), bool)
    spot[40:75, 100:125] = True
    first = int(0.2 * count)
    for k in range(count):
        frame = floor.copy()
        left = int(k / count * (WIDTH - 12))
        frame[85:110, left : left + 12] = (180, 40, 40)
        if first <= k < first + standing * count:
            frame[spot] = (25, 30, 70)
        frames.append(noisy(frame, 2.0, rng))
    return frames, spot


@pytest.mark.parametrize("standing", [0.4, 0.55])
def test_the_empty_floor_is_learned_though_an_object_stands_there_long(standing: float) -> None:
    frames, spot = crowded_frames(standing)
    kept = [frame.copy() for frame in frames]
    background = learn_background(frames)
    error = np.abs(background.image.astype(int) - textured_floor()).max(axis=2)
    assert (error > 15).mean() < 0.001 and np.median(error) <= 2
    assert (error[spot] > 20).mean() < 0.01  # no ghost of the object
    assert 1.0 < background.noise < 4.0
    if standing > 0.5:  # where the plain median fails
        median = np.median(frames, axis=0)
        assert np.abs(median - textured_floor())[spot].mean() > 50
    for frame, before in zip(frames, kept, strict=True):
        np.testing.assert_array_equal(frame, before)


def test_learning_is_deterministic_and_an_empty_recording_gives_its_median() -> None:
    rng = np.random.default_rng(5)
    frames = [noisy(textured_floor(), 2.0, rng) for _ in range(30)]
    one, two = learn_background(frames), learn_background(frames)
    np.testing.assert_array_equal(one.image, two.image)
    assert one.noise == two.noise
    assert np.abs(one.image.astype(int) - textured_floor()).max() <= 6


@pytest.mark.parametrize("count", [1, 2, 3])
def test_very_few_frames_still_give_a_background(count: int) -> None:
    frames = [np.full((HEIGHT, WIDTH, 3), 100, np.uint8) for _ in range(count)]
    frames[-1][30:90, 40:120] = 200
    background = learn_background(frames)
    assert np.isfinite(background.noise)
    assert (background.image[:20] == 100).all()
    assert set(np.unique(background.image[40:80, 50:110])) <= {100, 200}
    assert background.spread is not None and np.isfinite(background.spread).all()
    assert (background.spread[:20] == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 5), (9, 2), (40, 33)])
@pytest.mark.parametrize("count", [1, 2, 3, 20])
def test_tiny_pictures_have_a_background_too(shape: tuple[int, int], count: int) -> None:
    rng = np.random.default_rng(6)
    background = learn_background([noisy(np.full((*shape, 3), 120, np.uint8), 2.0, rng) for _ in range(count)])
    assert background.image.shape == (*shape, 3) and background.image.dtype == np.uint8
    assert np.abs(background.image.astype(int) - 120).max() <= 8
    assert background.spread is not None and background.spread.shape == shape


def naive_weighted_median(values: Pixels, weights: Pixels) -> Pixels:
    """Sort, add up the weights, take the first value at which half of them is reached."""
    result = np.full(values.shape[1:], 255, np.uint8)
    for place in np.ndindex(*result.shape):
        column = [slice(None), *place]
        order = np.argsort(values[tuple(column)], kind="stable")
        summed = np.cumsum(weights[tuple(column)][order].astype(int))
        if summed[-1]:
            result[place] = values[tuple(column)][order][np.argmax(2 * summed >= summed[-1])]
    return result


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(1, 70),
    top=st.sampled_from([0, 1, 15]),
    levels=st.sampled_from([2, 20, 256]),
    seed=st.integers(0, 999),
)
def test_the_weighted_median_agrees_with_sorting(count: int, top: int, levels: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(256 - levels, 256, (count, 4, 5), dtype=np.uint8)
    weights = rng.integers(0, top + 1, values.shape, dtype=np.uint8)
    np.testing.assert_array_equal(weighted_median(values, weights), naive_weighted_median(values, weights))


def test_the_weighted_median_is_the_median_for_equal_weights_and_many_samples() -> None:
    values = np.random.default_rng(7).integers(0, 256, (601, 5, 6), dtype=np.uint8)
    for weight in (1, 15):
        median = weighted_median(values, np.full_like(values, weight))
        np.testing.assert_array_equal(median, np.median(values, axis=0))


def large_floor() -> Pixels:
    return as_uint8(cv2.resize(textured_floor(), (320, 240), interpolation=cv2.INTER_CUBIC))


def swaying_frames(standing: int, *, count: int = 60) -> tuple[list[Pixels], np.ndarray[Any, Any]]:
    """Somebody textured walks in from the left, stands for ``standing`` frames, swaying by a pixel or two, walks on.
    Another walks about on the other side all the time."""
    rng = np.random.default_rng(8)
    floor = large_floor()
    coat = as_uint8(np.array([60, 45, 40]) + rng.normal(0, 14, (70, 28, 3)))
    other = as_uint8(np.array([190, 60, 60]) + rng.normal(0, 10, (60, 24, 3)))
    frames, place = [], np.zeros((240, 320), bool)
    place[80:160, 60:100] = True
    first = (count - standing) // 2
    for k in range(count):
        frame = floor.copy()
        if k < first:
            left = round(66 * k / first)
        elif k < first + standing:
            left = 66 + int(rng.integers(-2, 3))
        else:
            left = 66 + round(226 * (k - first - standing) / (count - first - standing))
        frame[85:155, left : left + 28] = coat
        x = round(150 + 140 * abs(np.sin(0.9 * k)))
        frame[170:230, x : x + 24] = other
        frames.append(noisy(frame, 1.5, rng))
    return frames, place


@pytest.mark.parametrize("standing", [11, 22, 36])
def test_the_floor_is_learned_below_one_who_stands_and_sways(standing: int) -> None:
    frames, place = swaying_frames(standing)  # 11 of 60 frames are 5 s of 27 s
    floor = large_floor()
    background = learn_background(frames)
    error = cv2.blur(cv2.absdiff(background.image, floor), (3, 3)).max(axis=2)
    assert error[place].max() <= 3
    assert np.median(error) <= 1 and (error > 3).mean() < 0.002
    if standing > 30:
        assert np.abs(np.median(frames, axis=0) - floor)[place].mean() > 20  # here the plain median fails
    assert background.spread is not None  # nor does the spread count him
    assert np.median(background.spread[place]) == pytest.approx(1.5, abs=1.0) and background.spread[place].max() < 12


def test_frames_under_changing_light_give_a_background_of_one_light() -> None:
    rng = np.random.default_rng(9)
    frames, _ = crowded_frames(0.4)
    lit = [relit(frame, *rng.choice([(0.8, 10.0), (1.0, 0.0), (1.2, -10.0)])) for frame in frames]
    background = learn_background(lit)
    again = adjust_intensity(background.image, textured_floor())
    assert (np.abs(again.astype(int) - textured_floor()).max(axis=2) > 8).mean() < 0.002


def test_the_spread_is_the_noise_of_each_place() -> None:
    rng = np.random.default_rng(10)
    floor = textured_floor()
    sigma = np.full((HEIGHT, WIDTH, 1), 2.0)
    sigma[20:60, 30:90] = 8.0
    frames = [as_uint8(floor + rng.normal(0, 1, floor.shape) * sigma) for _ in range(60)]
    for background in (average_background(frames), learn_background(frames)):
        spread = background.spread
        assert spread is not None and spread.dtype == np.float32 and spread.shape == (HEIGHT, WIDTH)
        assert 2.0 <= spread[70:].mean() < 2.9  # of three channels the largest
        assert 7.5 < spread[25:55, 35:85].mean() < 10.5
    assert average_background(frames[:1]).spread is None


@pytest.mark.parametrize("count", [2, 3, 5, 8, 9])
def test_the_spread_of_few_pictures_is_the_median_absolute_deviation(count: int) -> None:
    stack = np.random.default_rng(11).integers(0, 256, (count, 6, 9, 3), dtype=np.uint8)
    centre = np.sort(stack, axis=0)[(count - 1) // 2].astype(float)
    expected = 1.4826 * np.median(np.abs(stack - centre), axis=0).max(axis=-1)
    spread = average_background(list(stack)).spread
    assert spread is not None
    np.testing.assert_allclose(spread, expected, rtol=1e-6)


FLOOR_WINDOWS = [  # camera, x, y, width, height, samples of 60 in which the place was seen to be empty
    ("cam1", 355, 285, 70, 90, [2, 3, 4, 5, 6, 7, 8]),
    ("cam1", 560, 300, 120, 100, [3, 4, 5, 6, 7, 8, 9]),
    ("cam2", 570, 330, 80, 200, [3, 4, 5, 6, 7, 8]),
    ("cam2", 800, 420, 120, 100, [10, 11, 12, 13, 15, 16, 17]),
    ("cam3", 885, 330, 60, 60, [0, 38, 39, 40, 52, 57]),
    ("cam3", 560, 300, 120, 100, [2, 3, 4, 5, 9, 10, 11, 12]),
]


def test_ufes_lab_nobody_stands_on_the_learned_floor(shared_data: Callable[[str], Path]) -> None:
    pictures = open_recording(shared_data("ufes-lab"), ["cam1", "cam2", "cam3"]).sample(60)
    learned = {name: learn_background(frames).image for name, frames in pictures.items()}
    ghosts = 0
    for camera, x, y, width, height, samples in FLOOR_WINDOWS:
        window = np.s_[y : y + height, x : x + width]
        empty = cv2.blur(np.median([pictures[camera][k][window] for k in samples], axis=0), (5, 5))
        error = np.abs(cv2.blur(learned[camera][window], (5, 5)) - empty).max(axis=2)
        assert np.percentile(error, 99) < 12 and error.mean() < 6, (camera, x, y)
        plain = np.median([frame[window] for frame in pictures[camera]], axis=0)
        ghosts += np.percentile(np.abs(cv2.blur(plain, (5, 5)) - empty).max(axis=2), 99) > 30
    assert ghosts >= 2  # in the plain median, people do


# --- following slow changes ------------------------------------------------------------------------------
@pytest.mark.parametrize("rate", [0.001, 0.02, 0.3])
@pytest.mark.parametrize("change", [-3, 1, 40])
def test_updates_converge_at_any_rate_and_are_frozen_in_the_foreground(rate: float, change: int) -> None:
    floor = textured_floor()
    frame = as_uint8(floor.astype(int) + change)
    foreground = np.zeros((HEIGHT, WIDTH), bool)
    foreground[30:60, 40:80] = True
    first = background = Background(floor, 2.0, np.ones((HEIGHT, WIDTH), np.float32))
    kept = floor.copy(), frame.copy(), foreground.copy()
    steps = int(np.ceil(np.log(0.01) / np.log1p(-rate)))
    for step in range(steps):
        background = update_background(background, frame, foreground, rate=rate)
        if step == steps // 2:  # what is left of the change is as planned, not stalled
            left = (1 - rate) ** (step + 1) * change
            outside = (frame.astype(int) - background.image)[~foreground]
            assert np.abs(outside - left).max() <= 0.51
    np.testing.assert_array_equal(background.image[~foreground], frame[~foreground])
    np.testing.assert_array_equal(background.image[foreground], floor[foreground])
    assert background.image.dtype == np.uint8 and (background.noise, background.spread) == (2.0, first.spread)
    assert first.unrounded is None
    for now, then in zip((floor, frame, foreground), kept, strict=True):
        np.testing.assert_array_equal(now, then)


def test_an_update_leaves_the_background_before_it_alone() -> None:
    floor, nobody = textured_floor(), np.zeros((HEIGHT, WIDTH), bool)
    one = update_background(Background(floor), textured_floor(1), nobody, rate=0.5)
    assert one.unrounded is not None
    image, levels = one.image.copy(), one.unrounded.copy()
    update_background(one, textured_floor(2), nobody, rate=0.5)
    np.testing.assert_array_equal(one.image, image)
    np.testing.assert_array_equal(one.unrounded, levels)


def test_wrong_arguments_of_an_update_are_named() -> None:
    floor = textured_floor()
    background, nobody = Background(floor), np.zeros((HEIGHT, WIDTH), bool)
    with pytest.raises(ValueError, match=r"image: expected uint8 \(120, 160, 3\), got float64"):
        update_background(background, floor.astype(float), nobody)
    with pytest.raises(ValueError, match="image: expected uint8"):
        update_background(background, floor[:50], nobody)
    with pytest.raises(ValueError, match=r"foreground: expected bool \(120, 160\), got bool \(50, 160\)"):
        update_background(background, floor, nobody[:50])
    with pytest.raises(ValueError, match="foreground: expected bool"):
        update_background(background, floor, nobody.astype(np.uint8))
    for rate in (-0.1, 1.5, np.nan):
        with pytest.raises(ValueError, match="rate: expected a share from 0 to 1"):
            update_background(background, floor, nobody, rate=rate)


# --- files ---------------------------------------------------------------------------------------------
def test_a_saved_background_reads_back_equal(tmp_path: Path) -> None:
    background = Background(textured_floor(), 2.25)
    path = background.save(tmp_path / "new" / "left.npz")
    again = Background.load(path)
    np.testing.assert_array_equal(again.image, background.image)
    assert again.image.dtype == np.uint8 and again.noise == 2.25
    assert again.spread is None  # as in files of before there was one
    assert [p.name for p in path.parent.iterdir()] == ["left.npz"]  # nothing temporary stays
    spread = np.random.default_rng(12).random((HEIGHT, WIDTH), dtype=np.float32)
    again = Background.load(Background(background.image, 2.25, spread).save(path))
    np.testing.assert_array_equal(again.spread, spread)
    assert again.spread is not None and again.spread.dtype == np.float32


def archive(**fields: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **fields)
    return buffer.getvalue()


def bare_array() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros((2, 2, 3), np.uint8))
    return buffer.getvalue()


GOOD = archive(image=np.zeros((20, 20, 3), np.uint8), noise=1.0)
DAMAGED = {
    "empty": b"",
    "no archive": b"not a background",
    "cut short": GOOD[: len(GOOD) // 2],
    "a flipped bit": GOOD[:150] + bytes([GOOD[150] ^ 0xFF]) + GOOD[151:],
    "a bare array": bare_array(),
    "no noise": archive(image=np.zeros((2, 2, 3), np.uint8)),
    "two noises": archive(image=np.zeros((2, 2, 3), np.uint8), noise=[1.0, 2.0]),
    "noise NaN": archive(image=np.zeros((2, 2, 3), np.uint8), noise=np.nan),
    "negative noise": archive(image=np.zeros((2, 2, 3), np.uint8), noise=-1.0),
    "grey": archive(image=np.zeros((2, 2), np.uint8), noise=1.0),
    "floats": archive(image=np.zeros((2, 2, 3)), noise=1.0),
    "another spread": archive(image=np.zeros((2, 2, 3), np.uint8), noise=1.0, spread=np.zeros((2, 3), np.float32)),
    "spread of bytes": archive(image=np.zeros((2, 2, 3), np.uint8), noise=1.0, spread=np.zeros((2, 2), np.uint8)),
    "spread NaN": archive(image=np.zeros((2, 2, 3), np.uint8), noise=1.0, spread=np.full((2, 2), np.nan, np.float32)),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_background_is_a_one_line_error_with_the_file_name(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "damaged.npz"
    path.write_bytes(DAMAGED[damage])
    with pytest.raises(ValueError, match=r"damaged\.npz: ") as error:
        Background.load(path)
    assert "\n" not in str(error.value)


def test_a_missing_background_is_a_value_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nowhere\.npz: cannot read a background"):
        Background.load(tmp_path / "nowhere.npz")


class Boom:
    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("a pickle was executed",))


def test_a_pickle_is_never_executed(tmp_path: Path) -> None:
    path = tmp_path / "pickle.npz"
    array = np.empty(1, dtype=object)
    array[0] = Boom()
    path.write_bytes(archive(image=array, noise=1.0))
    with pytest.raises(ValueError, match="allow_pickle"):
        Background.load(path)


# --- wrong arguments -------------------------------------------------------------------------------------
def test_wrong_arguments_are_named() -> None:
    floor = textured_floor()
    grey = floor[..., 0]
    with pytest.raises(ValueError, match=r"image: expected uint8 RGB \(H, W, 3\), got uint8 \(120, 160\)"):
        to_grey(grey)
    with pytest.raises(ValueError, match=r"image: expected uint8 RGB .* got float64"):
        to_grey(floor.astype(float))
    with pytest.raises(ValueError, match="image: expected the background's shape"):
        intensity_gain_offset(floor[:50], floor)
    with pytest.raises(ValueError, match=r"image: expected uint8 .* got float64"):
        subtract_background(floor.astype(float), Background(floor))
    with pytest.raises(ValueError, match=r"image: expected uint8 .* got uint8"):
        subtract_background(floor[:50], Background(floor))
    for learn in (average_background, learn_background):
        with pytest.raises(ValueError, match="images: expected at least one picture, got none"):
            learn([])
        with pytest.raises(ValueError, match="images: expected one size"):
            learn([floor, floor[:50]])
    for size in (0, 4, -3):
        with pytest.raises(ValueError, match=f"size: expected an odd number of px, got {size}"):
            smooth(grey, size=size)
    with pytest.raises(ValueError, match=r"threshold: expected otsu, .*noise or grey levels, got 'ostu'"):
        threshold_level(grey, "ostu")
    for level in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="threshold: expected grey levels >= 0"):
            threshold_level(grey, level)


def test_as_background_takes_a_picture_or_a_background() -> None:
    floor = textured_floor()
    background = Background(floor, 1.5)
    assert as_background(background) is background
    np.testing.assert_array_equal(as_background(floor).image, floor)
    with pytest.raises(ValueError, match="expected uint8 RGB"):
        as_background(np.zeros((4, 4)))


def test_no_stage_changes_its_input() -> None:
    floor, frame = textured_floor(), textured_floor(1)
    background = Background(floor)
    before = floor.copy(), frame.copy()
    adjust_intensity(frame, floor)
    difference = subtract_background(frame, background)
    kept = difference.copy()
    smooth(difference)
    otsu_threshold(difference)
    foreground_mask(frame, background)
    average_background([floor, frame])
    for now, then in ((floor, before[0]), (frame, before[1]), (difference, kept)):
        np.testing.assert_array_equal(now, then)


# --- evidence: objects without their shadows -------------------------------------------------------------
def blob(top: int = 40, left: int = 50, height: int = 40, width: int = 50) -> tuple[slice, slice]:
    return slice(top, top + height), slice(left, left + width)


PLACE, HEART, AWAY = blob(), blob(44, 54, 32, 42), blob(0, 0, 30, 160)


def plain_floor(level: int = 140) -> Pixels:
    """A floor of one warm colour, with a little shading so that gain and offset can be told."""
    shade = np.linspace(0.9, 1.1, WIDTH)[None, :, None] * np.array([1.03, 1.0, 0.94]) * level
    return as_uint8(np.broadcast_to(shade, (HEIGHT, WIDTH, 3)))


def evidence_of(frame: Pixels, floor: Pixels, noise: float = 0.0) -> Pixels:
    return foreground_evidence(frame, Background(floor, noise))


@settings(max_examples=40, deadline=None)
@given(
    data=st.data(),
    gains=st.tuples(*[st.floats(0.7, 1.4)] * 3),
    noise=st.floats(0, 6),
    seed=st.integers(0, 999),
    model=st.builds(
        ShadowModel,
        chroma=st.floats(0.02, 0.2),
        darkest=st.floats(0.4, 0.8),
        least_level=st.floats(40, 200),
        bright=st.floats(0.05, 0.3),
        texture=st.floats(0, 0.5),
        steepness=st.floats(0.5, 5),
    ),
)
def test_the_compiled_evidence_equals_the_equations(
    data: st.DataObject, gains: tuple[float, float, float], noise: float, seed: int, model: ShadowModel
) -> None:
    rng = np.random.default_rng(seed)
    floor = data.draw(st.sampled_from([textured_floor(seed), plain_floor(), plain_floor(30), plain_floor(230)]))
    frame = noisy(as_uint8(floor * np.array(gains)), 3, rng)
    for _ in range(3):
        y, x = rng.integers(0, 80), rng.integers(0, 110)
        frame[y : y + 30, x : x + 40] = as_uint8(frame[y : y + 30, x : x + 40] * rng.uniform(0.2, 1.8, 3))
    background = Background(floor, noise)
    kept = frame.copy()
    fast = foreground_evidence(frame, background, shadows=model)
    naive = foreground_evidence_naive(frame, background, shadows=model)
    assert fast.dtype == np.uint8 and fast.shape == (HEIGHT, WIDTH)
    assert np.abs(fast.astype(int) - naive).max() <= 1
    np.testing.assert_array_equal(frame, kept)


@settings(max_examples=30, deadline=None)
@given(left=st.floats(ShadowModel().darkest + 0.02, 1.0), level=st.integers(60, 200))
def test_no_shadow_down_to_the_darkest_is_foreground(left: float, level: int) -> None:
    floor = plain_floor(level)
    frame = floor.copy()
    frame[PLACE] = as_uint8(frame[PLACE] * left)
    assert (evidence_of(frame, floor) < SURE).all()


@pytest.mark.parametrize("level", [180, 210])
def test_on_a_bright_floor_a_deep_shadow_is_still_brighter_than_a_dark_object(level: int) -> None:
    floor, model = plain_floor(level), ShadowModel()
    for left, is_object in ((model.least_level + 6, False), (model.least_level - 12, True)):
        assert left < model.darkest * level
        frame = floor.copy()
        frame[PLACE] = as_uint8(frame[PLACE] * (left / level))
        assert (evidence_of(frame, floor)[HEART] >= SURE).all() == is_object


@pytest.mark.parametrize("colour", [(30, 30, 34), (200, 40, 30), (150, 150, 90)])
def test_a_silhouette_ends_where_half_of_a_pixel_is_object(colour: tuple[int, int, int]) -> None:
    """However strong the contrast: rims whose pixels show a little of the object do not make it larger."""
    floor = plain_floor()
    y, x = np.mgrid[: 8 * HEIGHT, : 8 * WIDTH] / 8 - 0.5 + 1 / 16
    disc = (np.hypot(x - 80.3, y - 60.2) < 25).astype(np.float32)
    share = cv2.resize(disc, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)[..., None]
    found = evidence_of(as_uint8(share * np.array(colour) + (1 - share) * floor), floor) >= SURE
    assert abs(found.sum() / share.sum() - 1) < 0.01
    assert ((found != (share[..., 0] >= 0.5)) & ((share[..., 0] < 0.3) | (share[..., 0] > 0.7))).sum() == 0


@settings(max_examples=30, deadline=None)
@given(share=st.floats(0.0, 0.93), level=st.integers(110, 200))
def test_what_is_darker_than_any_shadow_is_foreground(share: float, level: int) -> None:
    floor, model = plain_floor(level), ShadowModel()
    left = share * min(model.darkest, model.least_level / level)
    frame = floor.copy()
    frame[PLACE] = as_uint8(frame[PLACE] * left)
    found = evidence_of(frame, floor)
    assert (found[HEART] >= SURE).all() and not found[AWAY].any()


@pytest.mark.parametrize("colour", [(1.25, 0.9, 0.9), (0.8, 1.0, 0.8), (0.7, 0.75, 1.0), (0.5, 0.62, 0.62)])
def test_a_colour_of_its_own_is_foreground_however_bright(colour: tuple[float, float, float]) -> None:
    floor = plain_floor()
    frame = floor.copy()
    frame[PLACE] = as_uint8(frame[PLACE] * np.array(colour))
    found = evidence_of(frame, floor)
    assert (found[HEART] >= SURE).all() and not found[AWAY].any()


def test_brighter_than_a_reflection_is_foreground() -> None:
    floor = plain_floor()
    model = ShadowModel()
    for gain, is_object in ((1 + 0.5 * model.bright, False), (1 + 1.6 * model.bright, True)):
        frame = floor.copy()
        frame[PLACE] = as_uint8(frame[PLACE] * gain)
        assert ((evidence_of(frame, floor)[HEART] >= SURE) == is_object).all()


@settings(max_examples=30, deadline=None)
@given(gains=st.tuples(*[st.floats(0.8, 1.2)] * 3), offsets=st.tuples(*[st.floats(-15, 15)] * 3))
def test_gain_and_offset_of_each_channel_change_nothing(gains: tuple[float, ...], offsets: tuple[float, ...]) -> None:
    floor = plain_floor(120)
    frame = floor.copy()
    frame[PLACE] = (60, 110, 40)
    expected = evidence_of(frame, floor) >= SURE
    drifted = as_uint8(frame * np.array(gains) + np.array(offsets))
    found = evidence_of(drifted, floor) >= SURE
    assert expected[HEART].all()
    assert (found == expected).mean() > 0.985  # rounding decides at the rim
    for channel in range(3):
        gain, offset = channel_gain_offset(drifted, floor, channel)
        assert gain * drifted[..., channel][AWAY].mean() + offset == pytest.approx(
            floor[..., channel][AWAY].mean(), abs=2
        )


@pytest.mark.parametrize("sigma", [2.0, 4.0, 8.0])
def test_noise_alone_is_nothing(sigma: float) -> None:
    rng = np.random.default_rng(4)
    for floor in (plain_floor(60), plain_floor(), textured_floor()):
        frames = [noisy(floor, sigma, rng) for _ in range(6)]
        background = average_background(frames[:5])
        assert (foreground_evidence(frames[5], background) >= SURE).mean() < 1e-3


def test_trembling_edges_are_forgiven_and_an_object_on_them_is_not() -> None:
    floor = plain_floor()
    floor[:, ::16] = 60  # joints between tiles
    floor = cv2.GaussianBlur(floor, (5, 5), 1.0)
    shifted = as_uint8(0.8 * floor.astype(float) + 0.2 * np.roll(floor, 1, axis=1))
    assert not (evidence_of(shifted, floor) >= SURE).any()
    shifted[PLACE] = (200, 40, 40)
    assert (evidence_of(shifted, floor)[HEART] >= SURE).all()


def test_a_single_pixel_is_no_object() -> None:
    floor = plain_floor()
    frame = floor.copy()
    frame[20::30, 20::30] = 255
    assert not (evidence_of(frame, floor) >= SURE).any()


def test_wrong_images_for_the_evidence_are_named() -> None:
    floor = plain_floor()
    for bad in (floor[:50], floor.astype(float), floor[..., 0]):
        with pytest.raises(ValueError, match=r"image: expected uint8 \(120, 160, 3\), got"):
            foreground_evidence(bad, Background(floor))


# --- the rendered lab: true masks and true shadows --------------------------------------------------------
# recording: frames, then lower bounds of the F-measure as it is and with 2 px of outline left out, of the share of shadow
# that is called background, and of object that is called foreground
RENDERED = {
    "robot": (range(0, 6, 2), 0.97, 0.985, 0.99, 0.975),
    "four_robots": (range(0, 100, 30), 0.98, 0.99, 0.99, 0.985),
    "long_occlusion": (range(0, 100, 30), 0.985, 0.99, 0.99, 0.99),
    "ball_and_oval": (range(2), 0.94, 0.955, 0.87, 0.99),  # a deep contact shadow
}


@pytest.mark.parametrize("name", RENDERED)
def test_rendered_objects_are_found_and_their_shadows_left_out(name: str) -> None:
    if not (LAB / name / "frames").is_dir():
        pytest.skip(f"no rendered pictures in {LAB / name}")
    frames, least_f, least_inner_f, least_shadow, least_object = RENDERED[name]
    recording, scene = open_recording(name), load_scene(name)
    empty = {camera: average_background(pictures) for camera, pictures in recording.background_images().items()}
    found_true = found = true = outline = shadow = shadow_left_out = 0
    for frame, images in recording.images():
        if frame not in frames:
            continue
        masks = silhouettes(scene, frame)
        for camera, image in images.items():
            things = np.any([amodal for amodal, _ in masks[camera].values()], axis=0)
            wide = cv2.dilate(things.astype(np.uint8), np.ones((5, 5), np.uint8)).view(bool)
            foreground = foreground_evidence(image, empty[camera]) >= SURE
            reference = empty[camera].image
            changed = to_grey(cv2.absdiff(adjust_intensity(image, reference), reference)) > 15
            found_true, found, true = (
                found_true + (foreground & things).sum(),
                found + foreground.sum(),
                true + things.sum(),
            )
            outline += (foreground & wide & ~things).sum()
            shadow += (changed & ~wide).sum()
            shadow_left_out += (changed & ~wide & ~foreground).sum()
    assert shadow > 500 and true > 5000
    assert 2 * found_true / (found + true) > least_f
    assert 2 * found_true / (found - outline + true) > least_inner_f
    assert shadow_left_out / shadow > least_shadow
    assert found_true / true > least_object
