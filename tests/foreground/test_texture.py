"""Floor that shows through shadows and reflections, and objects that it does not show through."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.floors import Pixels, as_uint8, noisy, tiles
from occlib.foreground.background import Background
from occlib.foreground.pictures import picture_of
from occlib.foreground.shadows import SURE, foreground_evidence
from occlib.foreground.texture import (
    CERTAIN,
    INDEPENDENT,
    LEAST_BETA,
    NOISE_SHARE,
    TREMBLE,
    WINDOW,
    log_odds,
    products_of,
    texture_log_odds,
)

PLACE, HEART = np.s_[80:150, 100:190], np.s_[88:142, 108:182]
FLOOR = tiles()


def naive_log_odds(n: float, pp: float, fp: float, ff: float, alpha: float, noise: float) -> float:
    texture = max(pp - NOISE_SHARE * n * noise, 1e-6)
    beta = np.clip(fp / texture, LEAST_BETA * alpha, 1.05 * max(alpha, 1))
    nu = n * noise + TREMBLE * pp
    left = max(ff - 2 * beta * fp + beta**2 * texture, 0)
    return float(INDEPENDENT * n / 2 * np.log((left + nu) / (ff + nu)))


def test_the_compiled_texture_equals_the_equations() -> None:
    rng = np.random.default_rng(0)
    frame = noisy(FLOOR, 3, rng)
    frame[PLACE] = 90
    one, other = picture_of(frame), picture_of(FLOOR)
    products = products_of(one, other)
    fy, fx = (np.gradient(np.pad(one.grey, 1, mode="edge"), axis=k)[1:-1, 1:-1] * 2 for k in (0, 1))
    py, px = (np.gradient(np.pad(other.grey, 1, mode="edge"), axis=k)[1:-1, 1:-1] * 2 for k in (0, 1))
    for found, expected in zip(products, (px**2 + py**2, px * fx + py * fy, fx**2 + fy**2), strict=True):
        np.testing.assert_allclose(found, expected, atol=2e-2)
    cell = 4
    shape = (-(-one.grey.shape[0] // cell), -(-one.grey.shape[1] // cell))
    gain = rng.uniform(0.8, 1.2, shape).astype(np.float32)
    unsure = rng.uniform(0, 0.2, shape).astype(np.float32)
    found = texture_log_odds(one, other, products, gain, 3.0, unsure, 2.0, cell)
    n, reach = WINDOW**2, WINDOW // 2
    for y, x in rng.integers(reach, np.array(one.grey.shape) - reach, (300, 2)):
        pp, fp, ff = (k[y - reach : y + reach + 1, x - reach : x + reach + 1].sum() for k in products)
        g, level = gain[y // cell, x // cell], gain[y // cell, x // cell] * other.grey[y, x] + 3
        noise = 2 + (unsure[y // cell, x // cell] * level / cell) ** 2
        expected = naive_log_odds(n, g * g * pp, g * fp, ff, one.grey[y, x] / level, noise)
        expected = 0 if g * g * pp <= NOISE_SHARE * n * 2 else np.clip(expected, -CERTAIN, CERTAIN)
        assert found[y, x] == pytest.approx(expected, abs=2e-3)


def test_the_log_odds_have_the_right_sign() -> None:
    n, texture, noise = 25.0, 25 * 40.0, 2.0
    for alpha in (0.3, 0.6, 1.0):
        seen = log_odds(n, texture, alpha * texture, alpha**2 * texture + n * noise, alpha, noise)
        assert seen < -2, alpha
    assert (
        log_odds(n, texture, texture, texture + n * noise, 1.4, noise) < -2
    )  # a reflection: brighter, the texture as it was
    assert log_odds(n, texture, 0.0, n * noise, 1.0, noise) > 2  # smooth, where the floor is not
    assert abs(log_odds(n, n * noise, 0.0, n * noise, 1.0, noise)) < 0.5  # a smooth floor says nothing


def evidence(frame: Pixels, seed: int = 1) -> Pixels:
    rng = np.random.default_rng(seed)
    return foreground_evidence(noisy(frame, 1.5, rng), Background(noisy(FLOOR, 1.0, rng), 1.0))


@pytest.mark.parametrize("left", [0.35, 0.5, 0.7, 0.9])
def test_a_shadow_of_any_depth_is_floor_where_the_texture_shows_through(left: float) -> None:
    frame = FLOOR.copy()
    frame[PLACE] = as_uint8(frame[PLACE] * left)
    found = evidence(frame) >= SURE
    assert found[HEART].mean() < 0.05 and found.mean() < 0.01


@pytest.mark.parametrize("added", [15, 30, 50])
def test_a_mirror_image_is_floor_where_the_texture_shows_through(added: int) -> None:
    frame = FLOOR.copy()
    frame[PLACE] = as_uint8(frame[PLACE].astype(float) + added)
    found = evidence(frame) >= SURE
    assert found[HEART].mean() < 0.05 and found.mean() < 0.01


def test_an_object_of_the_floors_colour_is_an_object() -> None:
    frame = FLOOR.copy()
    frame[PLACE] = frame[HEART].reshape(-1, 3).mean(axis=0)
    found = evidence(frame) >= SURE
    assert found[HEART].mean() > 0.8 and found[:60].mean() < 0.01


@pytest.mark.parametrize("colour", [(30, 32, 36), (60, 60, 62), (210, 205, 200), (150, 70, 60)])
def test_dark_and_pale_objects_are_objects(colour: tuple[int, int, int]) -> None:
    frame = FLOOR.copy()
    frame[PLACE] = colour
    found = evidence(frame) >= SURE
    assert found[HEART].mean() > 0.97 and found[:60].mean() < 0.01
