"""Intensity: planted changes of light are found and undone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.floors import HEIGHT, WIDTH, as_uint8, relit, textured_floor
from occlib.foreground.intensity import adjust_intensity, intensity_gain_offset


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
