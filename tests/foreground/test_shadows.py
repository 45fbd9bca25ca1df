"""Evidence: objects without their shadows, on planted floors and in the rendered lab."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.floors import HEIGHT, WIDTH, Pixels, as_uint8, noisy, textured_floor, tiles
from occlib.foreground.background import (
    Background,
    average_background,
)
from occlib.foreground.intensity import adjust_intensity, channel_gain_offset, to_grey
from occlib.foreground.light import Light, block_means, fit_light
from occlib.foreground.pictures import CLIPPED, picture_of
from occlib.foreground.shadows import (
    DOUBT,
    FULL,
    JUMP,
    LEAST_JUMP,
    SURE,
    UNCHANGED,
    ShadowModel,
    _between,
    _colour_log_odds,
    _evidence,
    _smoothed,
    foreground_evidence,
)
from occlib.foreground.texture import CERTAIN, products_of
from occlib.lab.scenes import load_scene
from occlib.lab.truth import silhouettes
from occlib.recordings import LAB, open_recording

Array = np.ndarray[Any, Any]


def blob(top: int = 40, left: int = 50, height: int = 40, width: int = 50) -> tuple[slice, slice]:
    return slice(top, top + height), slice(left, left + width)


PLACE, HEART, AWAY = blob(), blob(44, 54, 32, 42), blob(0, 0, 30, 160)


def plain_floor(level: int = 140) -> Pixels:
    """A floor of one warm colour, with a little shading so that gain and offset can be told."""
    shade = np.linspace(0.9, 1.1, WIDTH)[None, :, None] * np.array([1.03, 1.0, 0.94]) * level
    return as_uint8(np.broadcast_to(shade, (HEIGHT, WIDTH, 3)))


def evidence_of(frame: Pixels, floor: Pixels, noise: float = 0.0) -> Pixels:
    return foreground_evidence(frame, Background(floor, noise))


# --- beside each loop its equation ---------------------------------------------------------------------------
def naive_colour_log_odds(i: Array, p: Array, slack: Any, jump: Any, noise: float, model: ShadowModel) -> Array:
    """Step 2 of the module, of pixels i and their predictions p, (..., 3)."""
    level, sigma = np.linalg.norm(p, axis=-1), max(np.sqrt(noise) / 2, 1)
    alpha = (i * p).sum(-1) / np.maximum(level**2, 1)
    slack = slack + JUMP * jump * level
    chroma = np.linalg.norm(i - alpha[..., None] * p, axis=-1)
    chroma /= model.least_chroma * sigma + model.chroma * level + slack
    step = abs(alpha - 1) * level / (model.least_step * sigma * np.sqrt(3) + model.bright * level + 3 * slack)
    step = np.where(alpha < 1, np.minimum((1 - alpha) / (1 - model.darkest), step), step)
    return np.clip(model.steepness * (np.hypot(chroma, step) - 1), -FULL, FULL + CERTAIN)


def naive_evidence(frame: Pixels, background: Background, light: Light, texture: Array, model: ShadowModel) -> Array:
    """Steps 1 to 3: coarse decisions for 2 x 2 px, and px by px where these are in doubt; and the change."""
    one, reference = picture_of(frame), background.reference
    rows, columns = light.gain.shape[:2]
    y, x = ((np.arange(side) + 0.5) / reference.cell - 0.5 for side in one.grey.shape)
    along = np.stack([[np.interp(y, np.arange(rows), light.gain[:, u, c]) for u in range(columns)] for c in range(3)])
    gain = np.stack([[np.interp(x, np.arange(columns), row) for row in channel.T] for channel in along], axis=-1)

    def predicted(levels: Array, gain: Array, image: Array) -> Array:
        found = np.clip(gain * levels + light.offset, 0, 255)
        return np.where(levels >= CLIPPED, np.maximum(found, image), found)

    def value(odds: Array) -> Array:
        return np.clip(127.5 * (1 + odds / FULL), 0, 255).astype(np.uint8)

    def wide(coarse: Array) -> Array:
        return coarse.repeat(2, 0).repeat(2, 1)[: frame.shape[0], : frame.shape[1]]

    half = one.half.astype(float)
    p = predicted(reference.picture.half.astype(float), gain, half)
    odds = naive_colour_log_odds(half, p, 0.0, 0.0, light.noise, model) + texture
    quiet = (texture <= 0) & (((half - p) ** 2).sum(-1) <= UNCHANGED**2 * light.noise)
    coarse, coarse_change = np.where(quiet, 0, value(odds)), abs(half - p).mean(-1).astype(np.uint8)
    i, b = cv2.GaussianBlur(frame.astype(np.float32), (3, 3), 0, borderType=cv2.BORDER_REPLICATE), reference.levels
    blocks = [np.arange(side) // (2 * reference.cell) for side in frame.shape[:2]]
    jump = light.jump[np.ix_(*blocks)]
    p = predicted(b, wide(gain), i)
    padded = np.pad(light.gain, ((1, 1), (1, 1), (0, 0)), mode="edge")
    for v, u in np.ndindex(3, 3):  # the gains of the blocks around
        other = predicted(b, padded[v : v + rows, u : u + columns][np.ix_(*blocks)], i)
        better = (jump > LEAST_JUMP) & (abs(other - i).sum(-1) < abs(p - i).sum(-1))
        p = np.where(better[..., None], other, p)
    fine = naive_colour_log_odds(i, p, reference.slack * light.gain[..., 1][np.ix_(*blocks)], jump, light.noise, model)
    fine = value(fine + wide(texture))
    fine[(p.min(-1) >= CLIPPED) & (i.min(-1) >= CLIPPED)] = 0
    doubt = wide(coarse) >= DOUBT
    change = np.where(doubt, abs(i - p).mean(-1).astype(np.uint8), wide(coarse_change))
    return np.stack([np.where(doubt, fine, wide(coarse)), change])


models = st.builds(
    ShadowModel,
    chroma=st.floats(0.005, 0.1),
    least_chroma=st.floats(0.5, 4),
    darkest=st.floats(0.2, 0.8),
    bright=st.floats(0.02, 0.3),
    least_step=st.floats(0.5, 5),
    steepness=st.floats(1, 12),
)


@settings(max_examples=50, deadline=None)
@given(model=models, seed=st.integers(0, 999), noise=st.floats(0.5, 40), slack=st.floats(0, 8), jump=st.floats(0, 0.5))
def test_the_compiled_colour_equals_the_equations(
    model: ShadowModel, seed: int, noise: float, slack: float, jump: float
) -> None:
    rng = np.random.default_rng(seed)
    p = rng.uniform(0, 255, (40, 3)).astype(np.float32)
    i = (p * rng.uniform(0.3, 1.4, (40, 1)) + rng.normal(0, 8, (40, 3))).astype(np.float32)
    numbers = np.array(astuple(model), np.float32)
    found = [
        _colour_log_odds(*one, *other, np.float32(slack), np.float32(jump), np.float32(noise), numbers)
        for one, other in zip(i, p, strict=True)
    ]
    expected = naive_colour_log_odds(i.astype(float), p.astype(float), slack, jump, noise, model)
    np.testing.assert_allclose(found, expected, atol=0.01, rtol=1e-3)


@settings(max_examples=15, deadline=None)
@given(
    model=models, seed=st.integers(0, 999), level=st.sampled_from([190, 245]), lamp=st.booleans(), spread=st.booleans()
)
def test_the_compiled_evidence_equals_the_equations(
    model: ShadowModel, seed: int, level: int, lamp: bool, spread: bool
) -> None:
    rng = np.random.default_rng(seed)
    floor = tiles((HEIGHT, WIDTH), level=level, seed=seed % 7)  # the brighter one is clipped in places
    frame = floor * np.where(np.arange(WIDTH) < 60 + seed % 40, 1.5 if lamp else 1.0, 1.0)[None, :, None]
    for _ in range(4):
        y, x = rng.integers(0, 80), rng.integers(0, 110)
        frame[y : y + 30, x : x + 40] *= rng.uniform(0.2, 1.5, 3)
    frame = noisy(as_uint8(frame), 2, rng)
    background = Background(floor, 2.0, rng.uniform(0, 12, floor.shape[:2]).astype(np.float32) if spread else None)
    one, reference = picture_of(frame), background.reference
    products = products_of(one, reference.picture)
    light = fit_light(block_means(one.half, reference.cell), reference.blocks, products, reference.cell)
    texture = rng.normal(-1, 2, one.grey.shape).astype(np.float32)  # whatever it says
    found = np.zeros((2, *frame.shape[:2]), np.uint8)
    _evidence(
        frame, one.half, reference.levels, reference.picture.half, reference.slack, light.gain, light.offset, light.jump,
        reference.cell, texture, np.array(astuple(model), np.float32), np.float32(light.noise), found[0], found[1],
    )  # fmt: skip
    expected = naive_evidence(frame, background, light, texture, model)
    assert (np.abs(found.astype(int) - expected) > 1).mean() < 1e-3  # thresholds, rounded otherwise


def test_the_gain_goes_from_block_to_block_in_lines() -> None:
    for x in range(40):
        first, second, share = _between(x, 7, 5)
        position = np.clip((x + 0.5) / 7 - 0.5, 0, 4)
        assert 0 <= first <= second <= 4 and first + share * (second - first) == pytest.approx(position, abs=1e-5)


def test_frames_are_smoothed_as_opencv_does() -> None:
    frame = np.random.default_rng(0).integers(0, 256, (5, 6, 3)).astype(np.uint8)
    expected = cv2.GaussianBlur(frame.astype(np.float32), (3, 3), 0, borderType=cv2.BORDER_REPLICATE)
    found = [[[_smoothed(frame, y, x, c) for c in range(3)] for x in range(6)] for y in range(5)]
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_the_frame_and_the_background_are_left_alone() -> None:
    frame, floor = noisy(plain_floor(), 2, np.random.default_rng(0)), plain_floor()
    frame.flags.writeable = floor.flags.writeable = False
    one, other = (foreground_evidence(frame, Background(floor, 1.0)) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    assert one.dtype == np.uint8 and one.shape == (HEIGHT, WIDTH)


# --- planted floors ------------------------------------------------------------------------------------------
@settings(max_examples=30, deadline=None)
@given(left=st.floats(ShadowModel().darkest + 0.02, 1.0), level=st.integers(60, 200))
def test_no_shadow_down_to_the_darkest_is_foreground(left: float, level: int) -> None:
    floor = plain_floor(level)
    frame = floor.copy()
    frame[PLACE] = as_uint8(frame[PLACE] * left)
    assert (evidence_of(frame, floor) < SURE).all()


@pytest.mark.parametrize("colour", [(30, 30, 34), (200, 40, 30), (150, 150, 90)])
def test_a_silhouette_ends_where_half_of_a_pixel_is_object(colour: tuple[int, int, int]) -> None:
    """However strong the contrast: rims whose pixels show a little of the object do not make it larger."""
    floor = plain_floor()
    y, x = np.mgrid[: 8 * HEIGHT, : 8 * WIDTH] / 8 - 0.5 + 1 / 16
    disc = (np.hypot(x - 80.3, y - 60.2) < 25).astype(np.float32)
    share = cv2.resize(disc, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)[..., None]
    found = evidence_of(as_uint8(share * np.array(colour) + (1 - share) * floor), floor) >= SURE
    share = share[..., 0]
    assert abs(found.sum() / share.sum() - 1) < 0.02
    assert not found[share == 0].any() and found[share == 1].all()
    clear = ((share > 0) & (share < 0.3)) | ((share > 0.7) & (share < 1))  # edges are followed at half size
    assert (found != (share >= 0.5))[clear].mean() < 0.1


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
    for gain, is_object in ((1 + 0.5 * model.bright, False), (1 + 3 * model.bright, True)):
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
    "ball_and_oval": (range(2), 0.89, 0.91, 0.70, 0.99),  # a deep contact shadow
}


@pytest.mark.slow
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
