"""The light of a frame: a gain that varies over the picture, an offset, and what is no light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from helpers.floors import Pixels, as_uint8, noisy, tiles
from occlib.foreground.light import (
    AT_LEAST,
    AT_MOST,
    BLOCKS,
    DARK,
    EXACT,
    LARGE,
    ORDERS,
    UNKNOWN,
    VERY_LARGE,
    Light,
    _alike,
    _block_sums,
    _densest_half,
    _jumps,
    _left_over,
    _robust_fit,
    _spread,
    _texture,
    block_means,
    block_size,
    fit_light,
)
from occlib.foreground.pictures import CLIPPED, picture_of
from occlib.foreground.texture import log_odds, products_of

Array = np.ndarray[Any, Any]
SHAPE = (480, 640)
SIDE = 2 * block_size((240, 320))  # of a block in px of the whole picture
SPECKLED, SMOOTH = tiles(SHAPE), tiles(SHAPE, grain=0.0)
PLAIN = as_uint8(np.broadcast_to(np.linspace(110, 150, 640)[None, :, None] * np.array([1.03, 1.0, 0.94]), (*SHAPE, 3)))
Y, X = (2 * (axis + 0.5) / size - 1 for axis, size in zip(np.mgrid[:480, :640], SHAPE, strict=True))


def light_of(frame: Pixels, background: Pixels) -> Light:
    one, other = picture_of(frame), picture_of(background)
    cell = block_size(one.grey.shape)
    means = [block_means(picture.half, cell) for picture in (one, other)]
    return fit_light(means[0], means[1], products_of(one, other), cell)


def lit_by(gain: Array | float, floor: Pixels, offset: Array | float = 0.0, seed: int = 0) -> Pixels:
    gain = np.asarray(gain, float)
    return noisy(
        as_uint8(floor * (gain[..., None] if gain.ndim == 2 else gain) + offset), 1.5, np.random.default_rng(seed)
    )


def errors(light: Light, gain: Array | float, offset: Array | float = 0.0, level: float = 130.0) -> Array:
    """By which share the light is wrong about a floor of this level, in each block, (rows, columns, 3)."""
    gain = np.asarray(gain, float)
    field = np.broadcast_to(gain[..., None] if gain.ndim == 2 else gain, (*SHAPE, 3))
    rows, columns = light.known.shape
    true = [
        [field[v * SIDE : (v + 1) * SIDE, u * SIDE : (u + 1) * SIDE].mean((0, 1)) for u in range(columns)]
        for v in range(rows)
    ]
    return np.abs((light.gain * level + light.offset) / (np.array(true) * level + offset) - 1)


def blocks(rows: slice, columns: slice) -> tuple[slice, slice]:
    """The blocks within a part of the picture, those at its rim left out, which show the rim's own edge."""
    first, second = (slice(-(-part.start // SIDE) + 1, part.stop // SIDE - 1) for part in (rows, columns))
    return first, second


# --- planted light -------------------------------------------------------------------------------------
@pytest.mark.parametrize("floor", [SPECKLED, SMOOTH, PLAIN])
def test_under_the_same_light_the_gain_is_one(floor: Pixels) -> None:
    same = light_of(floor.copy(), floor)
    assert errors(same, 1.0).max() < 1e-6 and same.known.all() and same.jump.max() < 1e-6
    light = light_of(lit_by(1.0, floor), floor)
    assert errors(light, 1.0).max() < 0.01 and light.known.all() and light.jump.max() < 0.02


def test_the_parts_of_a_light_have_the_shapes_that_they_claim() -> None:
    light = light_of(SPECKLED.copy(), SPECKLED)
    rows, columns = light.known.shape
    assert (rows, columns) == (-(-240 // (SIDE // 2)), -(-320 // (SIDE // 2))) and columns <= BLOCKS
    assert light.gain.shape == (rows, columns, 3) and light.gain.dtype == np.float32
    assert light.offset.shape == (3,) and light.jump.shape == light.floor.shape == (rows, columns)


@pytest.mark.parametrize("scale", [0.6, 0.9, 1.2])
@pytest.mark.parametrize("floor", [SPECKLED, SMOOTH])
def test_a_surface_of_second_order_and_an_offset_are_found(floor: Pixels, scale: float) -> None:
    surface = 1 + 0.2 * X - 0.15 * Y + 0.15 * X * X - 0.1 * X * Y + 0.1 * Y * Y
    gain, offset = scale * surface[..., None] * np.array([1.1, 1.0, 0.9]), np.array([8.0, 0.0, -6.0])
    light = light_of(lit_by(gain, floor, offset), floor)
    wrong = errors(light, gain, offset)
    assert np.median(wrong) < 0.005 and wrong.max() < 0.04
    assert light.known.all() and light.jump.max() < 0.05


def test_an_offset_is_told_from_a_gain_where_the_floor_has_contrast() -> None:
    dark = (np.indices(SHAPE) // 80).sum(0) % 2 == 1  # like a chessboard
    floor = as_uint8(SPECKLED * np.where(dark, 0.4, 1.0)[..., None])
    for gain, offset in ((0.8, 20.0), (1.2, -10.0)):
        light = light_of(lit_by(gain, floor, offset), floor)
        np.testing.assert_allclose(light.offset, offset, atol=1.5)
        np.testing.assert_allclose(light.gain, gain, atol=0.03)


@pytest.mark.parametrize("factor", [0.6, 1.5])
@pytest.mark.parametrize("floor", [SPECKLED, SMOOTH])
def test_a_lamp_over_half_of_the_room_is_light_with_a_hard_edge(floor: Pixels, factor: float) -> None:
    edge = 25 * SIDE
    gain = np.where(np.arange(640) < edge, factor, 1.0)[None].repeat(480, 0)
    light = light_of(lit_by(gain, floor), floor)
    assert errors(light, gain).max() < 0.02 and light.known.all()
    assert (light.jump[:, 24:26] > 0.8 * abs(np.log(factor))).all() and light.jump[:, :24].max() < 0.05


def test_an_object_over_a_quarter_of_the_view_does_not_count() -> None:
    place = np.s_[120:360, 160:480]
    for floor in (SPECKLED, SMOOTH):
        for colour in ((40, 90, 160), (235, 230, 225), (20, 20, 20)):
            frame = floor.copy()
            frame[place] = colour
            light = light_of(lit_by(0.8, frame), floor)
            assert errors(light, 0.8).max() < 0.02, colour  # below it, too: its blocks take the gain around them
            assert not light.known[blocks(*place)].any() and light.known.mean() > 0.7


def test_what_is_clipped_takes_the_gain_around_it() -> None:
    """A gain of 1.5 over a floor that it clips in part: what is clipped tells no gain, but a bound that allows it."""
    floor = tiles(SHAPE, level=160)
    frame = lit_by(1.5, floor)
    assert 0.1 < (frame >= CLIPPED).mean() < 0.5
    light = light_of(frame, floor)
    assert errors(light, 1.5).max() < 0.02
    assert not light.known[block_means(picture_of(frame).half, SIDE // 2)[..., 3:].min(axis=2) > 0.5].any()


# --- what is light, and what is not -----------------------------------------------------------------------
def spot(floor: Pixels, share: float, factor: float = 0.6) -> tuple[Light, tuple[slice, slice]]:
    """A spot of other light over about a share of the picture, and the blocks within it."""
    height, width = (round(share**0.5 * side / SIDE) * SIDE for side in SHAPE)
    place = np.s_[2 * SIDE : 2 * SIDE + height, 3 * SIDE : 3 * SIDE + width]
    gain = np.ones(SHAPE)
    gain[place] = factor
    return light_of(lit_by(gain, floor), floor), blocks(*place)


@pytest.mark.parametrize("floor", [SPECKLED, SMOOTH])
def test_a_region_that_the_texture_shows_through_is_light_if_it_is_large(floor: Pixels) -> None:
    small, place = spot(floor, 0.5 * LARGE)
    assert not small.known[place].any() and np.abs(small.gain[place] - 1).max() < 0.03
    for share in (2.5 * LARGE, 0.2):
        large, place = spot(floor, share)
        assert large.known[place].all() and np.abs(large.gain[place] / 0.6 - 1).max() < 0.03


def test_without_texture_only_a_very_large_region_is_light() -> None:
    for share, is_light in ((0.6 * VERY_LARGE, False), (1.2 * VERY_LARGE, True)):
        light, place = spot(PLAIN, share)
        assert (light.known[place] == is_light).all(), share
        assert np.abs(light.gain[place] / (0.6 if is_light else 1.0) - 1).max() < 0.04


def test_floor_is_where_the_texture_shows_whatever_the_light() -> None:
    frame = SPECKLED.copy()
    place, shade = np.s_[120:360, 160:360], np.s_[120:360, 420:600]
    frame[place] = (40, 90, 160)
    frame[shade] = as_uint8(0.5 * frame[shade].astype(float))
    light = light_of(lit_by(1.0, frame), SPECKLED)
    assert not light.floor[blocks(*place)].any() and light.floor[blocks(*shade)].all() and light.floor[:8].all()
    flat = np.full_like(SPECKLED, 140)
    assert not light_of(lit_by(1.0, flat), flat).floor.any()  # no texture, nothing to be seen


def test_light_is_the_same_again_and_the_pictures_are_left_alone() -> None:
    frame = lit_by(0.7, SPECKLED)
    kept = frame.copy(), SPECKLED.copy()
    for one, other in zip(light_of(frame, SPECKLED), light_of(frame, SPECKLED), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(frame, kept[0])
    np.testing.assert_array_equal(SPECKLED, kept[1])


@pytest.mark.parametrize("shape", [(2, 2), (3, 400), (60, 80), (61, 47)])
def test_pictures_of_any_size_have_a_finite_light(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    for levels in ((0, 256), (0, 1), (255, 256)):
        floor = rng.integers(*levels, (*shape, 3)).astype(np.uint8)
        for frame in (floor, rng.integers(0, 256, (*shape, 3)).astype(np.uint8)):
            light = light_of(frame, floor)
            assert np.isfinite(light.gain).all() and (light.gain > 0).all() and np.isfinite(light.offset).all()


# --- beside each loop its equation -------------------------------------------------------------------------
@pytest.mark.parametrize(("shape", "cell"), [((30, 40), 5), ((31, 43), 7), ((4, 4), 9)])
def test_block_means_and_sums_equal_those_of_numpy(shape: tuple[int, int], cell: int) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    products = [rng.uniform(0, 900, shape).astype(np.float32) for _ in range(3)]
    means, sums = block_means(image, cell), _block_sums(*products, cell)
    assert means.shape == (-(-shape[0] // cell), -(-shape[1] // cell), 6) and sums.shape == (*means.shape[:2], 4)
    for v, u in np.ndindex(means.shape[:2]):
        part = np.s_[v * cell : (v + 1) * cell, u * cell : (u + 1) * cell]
        np.testing.assert_allclose(means[v, u, :3], image[part].mean((0, 1)), rtol=1e-6)
        np.testing.assert_allclose(means[v, u, 3:], (image[part] >= CLIPPED).mean((0, 1)), atol=1e-6)
        np.testing.assert_allclose(
            sums[v, u], [*(one[part].sum() for one in products), image[part][..., 0].size], rtol=1e-5
        )


def test_the_noise_is_the_median_of_what_the_gradients_leave() -> None:
    rng = np.random.default_rng(2)
    frame, background = lit_by(0.8, SPECKLED), SPECKLED
    one, other = picture_of(frame), picture_of(background)
    i, b = (block_means(picture.half, SIDE // 2) for picture in (one, other))
    sums = _block_sums(*products_of(one, other), SIDE // 2)
    noise, odds = _texture(i, b, sums)
    alpha = (i[..., :3].sum(2) + 3) / (b[..., :3].sum(2) + 3)
    pp, fp, ff, n = np.moveaxis(sums.astype(float), 2, 0)
    assert noise == pytest.approx(np.median((ff - 2 * alpha * fp + alpha**2 * pp) / n), rel=1e-3)
    for v, u in rng.integers(0, odds.shape, (50, 2)):
        a = alpha[v, u]
        expected = log_odds(n[v, u], a * a * pp[v, u], a * fp[v, u], ff[v, u], 1.0, float(noise))
        assert odds[v, u] == pytest.approx(expected, rel=1e-3)
    quiet, _ = _texture(b, b, _block_sums(*products_of(other, other), SIDE // 2))
    assert quiet == 0.5  # rounding, at least


def test_the_densest_half_is_the_shortest_interval_with_half_of_the_values() -> None:
    rng = np.random.default_rng(3)
    for count in (1, 2, 7, 40):
        values = rng.normal(0, 1, count)
        low, high = _densest_half(values)
        pairs = [
            (b - a, a, b) for a in values for b in values if ((values >= a) & (values <= b)).sum() >= (count + 1) // 2
        ]
        assert high - low == pytest.approx(min(pairs)[0]) and ((values >= low) & (values <= high)).sum() >= count / 2


def naive_fit(i: Array, b: Array, x: Array, y: Array, weights: Array, gain: float) -> Array:
    """Iterated least squares with Tukey's weights, in matrices."""
    terms = np.stack([b, np.ones_like(b), b * x, b * y, b * x * x, b * x * y, b * y * y])
    target = i - gain * b
    for n in ORDERS:
        scaled = terms[:n] / (np.sqrt((weights * terms[:n] ** 2).sum(1, keepdims=True)) + 1e-6)
        ridge = np.full(n, 1e-4)
        ridge[1] = 3e-3
        solution = np.linalg.solve((weights * scaled) @ scaled.T + np.diag(ridge), (weights * scaled) @ target)
        left = target - solution @ scaled
        found = solution / (np.sqrt((weights * terms[:n] ** 2).sum(1)) + 1e-6)
        sigma = max(3.14 * np.sort(np.abs(left))[len(i) // 4], 1.0)
        weights = np.maximum(1 - (left / (4.7 * sigma)) ** 2, 0) ** 2
    return found + np.array([gain, 0, 0, 0, 0, 0, 0])


def test_the_compiled_fit_equals_the_matrices_and_leaves_objects_out() -> None:
    rng = np.random.default_rng(4)
    x, y, b = rng.uniform(-1, 1, 500), rng.uniform(-1, 1, 500), rng.uniform(20, 150, 500)
    true = np.array([0.9, 6.0, 0.2, -0.1, 0.1, 0.05, -0.08])
    terms = np.stack([b, np.ones_like(b), b * x, b * y, b * x * x, b * x * y, b * y * y])
    i = true @ terms + rng.normal(0, 1, 500)
    i[:150] = rng.uniform(0, 255, 150)
    dense = rng.random(500) < 0.5
    found = _robust_fit(i, b, x, y, dense, 0.9)
    np.testing.assert_allclose(found, naive_fit(i, b, x, y, dense.astype(float), 0.9), rtol=1e-5, atol=1e-6)
    assert np.abs((found - true) @ terms).max() < 2.5


def test_what_the_surface_leaves_is_exact_or_a_bound() -> None:
    frame, background = np.zeros((1, 6, 6), np.float32), np.zeros((1, 6, 6), np.float32)
    frame[0, :, :3], background[0, :, :3] = 90, 100
    frame[0, 1, 3] = 0.2  # one channel is clipped: it takes the others' value
    frame[0, 2, 3:] = background[0, 3, 3:] = 1.0  # the frame, the background is
    frame[0, 4, 3:] = background[0, 4, 3:] = 1.0  # both are
    background[0, 5, :3] = DARK  # too dark to tell
    gain, offset = np.full((1, 6, 3), 0.8, np.float32), np.full(3, 2, np.float32)
    left, kind = _left_over(frame, background, gain, offset)
    assert kind.tolist() == [[EXACT, EXACT, AT_LEAST, AT_MOST, UNKNOWN, UNKNOWN]]
    np.testing.assert_allclose(left[0, :5], np.log(89 / 81), rtol=1e-5)
    frame[0, 1, 0] = 250
    assert _left_over(frame, background, gain, offset)[0][0, 1] == pytest.approx(np.log(89 / 81), rel=1e-5)


def test_clipped_blocks_join_the_light_that_their_bound_allows() -> None:
    kind = np.array([[EXACT, AT_LEAST, AT_MOST]], np.uint8)
    background = np.full((1, 3, 6), 100, np.float32)

    def joins(mean: float, bound: float, block: int) -> bool:
        left = np.array([[[mean] * 3, [bound] * 3, [bound] * 3]], np.float32)
        return bool(_alike(left, kind, background, 0, 0, 0, block, np.float32(mean)))

    assert (
        joins(0.4, 0.2, 1) and not joins(0.4, 0.6, 1) and not joins(0.0, -0.2, 1)
    )  # as the surface says: nobody's region
    assert joins(-0.4, -0.2, 2) and not joins(-0.4, -0.6, 2) and not joins(0.0, 0.2, 2)


def test_light_goes_on_into_what_is_not_known_ring_by_ring() -> None:
    left, known = np.full((1, 5, 3), 9, np.float32), np.array([[True, False, False, False, True]])
    left[0, 0], left[0, 4] = 0.2, 0.6
    _spread(left, np.full((1, 5), EXACT, np.uint8), known)
    np.testing.assert_allclose(left[0, :, 0], [0.2, 0.2, 0.4, 0.6, 0.6], rtol=1e-6)
    bound = np.array([[[0.2] * 3, [0.5] * 3, [0.6] * 3]], np.float32)
    _spread(bound, np.array([[EXACT, AT_LEAST, EXACT]], np.uint8), np.array([[True, False, True]]))
    assert bound[0, 1, 0] == pytest.approx(0.6)  # the darker neighbour lies below its bound
    nothing = np.ones((2, 2, 3), np.float32)
    _spread(nothing, np.full((2, 2), UNKNOWN, np.uint8), np.zeros((2, 2), bool))
    assert not nothing.any()


def test_a_jump_is_the_largest_step_to_a_neighbour() -> None:
    left = np.random.default_rng(5).normal(0, 0.3, (9, 12, 3)).astype(np.float32)
    highest, lowest = ndimage.maximum_filter(left, (3, 3, 1)), ndimage.minimum_filter(left, (3, 3, 1))
    np.testing.assert_allclose(_jumps(left), np.maximum(highest - left, left - lowest).max(axis=2), rtol=1e-6)
