"""The difference to the background: an object's contrast, and nothing where nothing has changed."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.floors import HEIGHT, WIDTH, relit, textured_floor
from occlib.foreground.background import (
    Background,
    average_background,
)
from occlib.foreground.difference import foreground_mask, smooth, subtract_background
from occlib.foreground.intensity import adjust_intensity, intensity_gain_offset, to_grey
from occlib.foreground.learning import learn_background
from occlib.foreground.threshold import otsu_threshold, threshold_level


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
