"""A background is learned from frames that are never empty."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from helpers.floors import HEIGHT, WIDTH, Pixels, as_uint8, large_floor, noisy, relit, textured_floor
from occlib.foreground.intensity import adjust_intensity
from occlib.foreground.learning import learn_background


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


@pytest.mark.slow
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
