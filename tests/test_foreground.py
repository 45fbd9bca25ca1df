"""The foreground of one view: planted light changes are undone, an empty frame stays empty, the floor is learned."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.filters import threshold_otsu

from occlib.foreground import (
    LEAST_NOISE_FLOOR,
    THRESHOLDS,
    Background,
    adjust_intensity,
    as_background,
    average_background,
    foreground_mask,
    intensity_gain_offset,
    learn_background,
    otsu_threshold,
    smooth,
    subtract_background,
    threshold_level,
    to_grey,
    triangle_threshold,
)

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


# --- files ---------------------------------------------------------------------------------------------
def test_a_saved_background_reads_back_equal(tmp_path: Path) -> None:
    background = Background(textured_floor(), 2.25)
    path = background.save(tmp_path / "new" / "left.npz")
    again = Background.load(path)
    np.testing.assert_array_equal(again.image, background.image)
    assert again.image.dtype == np.uint8 and again.noise == 2.25
    assert [p.name for p in path.parent.iterdir()] == ["left.npz"]  # nothing temporary stays


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
