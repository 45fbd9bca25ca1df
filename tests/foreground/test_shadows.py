"""Evidence: objects without their shadows, on planted floors and in the rendered lab."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.floors import HEIGHT, WIDTH, Pixels, as_uint8, noisy, textured_floor
from occlib.foreground.background import (
    Background,
    average_background,
)
from occlib.foreground.intensity import adjust_intensity, channel_gain_offset, to_grey
from occlib.foreground.shadows import SURE, ShadowModel, foreground_evidence
from occlib.lab.scenes import load_scene
from occlib.lab.truth import silhouettes
from occlib.recordings import LAB, open_recording


def foreground_evidence_naive(image: Pixels, background: Background, *, shadows: ShadowModel) -> Pixels:
    """The same as :func:`foreground_evidence`, equation by equation in NumPy."""
    gains = np.array([channel_gain_offset(image, background.image, c) for c in range(3)], np.float32)
    smoothed, texture, least = background.soft
    i = cv2.GaussianBlur(image, (3, 3), 0) * gains[:, 0] + gains[:, 1]
    level = np.sqrt((smoothed**2).sum(axis=2))
    alpha = (i * smoothed).sum(axis=2) / np.maximum(level**2, 1)
    spare = shadows.texture * texture
    chroma = np.sqrt(((i - alpha[..., None] * smoothed) ** 2).sum(axis=2))
    chroma /= np.maximum(shadows.chroma * level, max(shadows.least_chroma, 0.5 * least)) + spare
    least = 1.73 * max(shadows.least_step, least)
    deepest = np.minimum(shadows.darkest, 1.73 * shadows.least_level / np.maximum(level, 1))
    darker = np.minimum((1 - alpha) / (1 - deepest), (1 - alpha) * level / (least + 2 * 1.73 * spare))
    darker = np.where(darker > 1, 1 + shadows.depth * (darker - 1), darker)
    brighter = (alpha - 1) * level / (np.maximum(shadows.bright * level, least) + 3 * spare)
    score = np.hypot(chroma, np.where(alpha < 1, darker, brighter))
    evidence = cv2.medianBlur(np.clip(127.5 * (1 + (score - 1) * shadows.steepness), 0, 255).astype(np.uint8), 5)
    change = np.minimum(np.abs(i - smoothed).mean(axis=2), 255).astype(np.uint8)
    square = np.ones((5, 5), np.uint8)
    halfway = cv2.erode(change, square) / 2 + cv2.dilate(change, square) / 2
    return np.asarray(np.where(change < halfway, cv2.erode(evidence, square), evidence))


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
