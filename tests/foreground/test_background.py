"""Backgrounds: mean, noise and spread, slow changes, files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.floors import HEIGHT, WIDTH, Pixels, as_uint8, noisy, textured_floor
from occlib.foreground.background import (
    LEAST_NOISE_FLOOR,
    Background,
    as_background,
    average_background,
    weighted_median,
)
from occlib.foreground.learning import learn_background


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


def test_as_background_takes_a_picture_or_a_background() -> None:
    floor = textured_floor()
    background = Background(floor, 1.5)
    assert as_background(background) is background
    np.testing.assert_array_equal(as_background(floor).image, floor)
    with pytest.raises(ValueError, match="expected uint8 RGB"):
        as_background(np.zeros((4, 4)))
