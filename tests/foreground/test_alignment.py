"""Cameras that were bumped."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.covers import lit
from helpers.floors import as_uint8, noisy, tiles
from occlib.foreground.alignment import _agreement, edge_points, shift_between
from occlib.foreground.background import Background
from occlib.foreground.pictures import picture_of
from occlib.foreground.shadows import SURE, foreground_evidence
from occlib.recordings import open_recording

ROOMS = {name: images[0] for name, images in open_recording("four_robots").background_images().items()}


@pytest.mark.parametrize("shift", [(5, -3), (-7, 4), (8, 8), (-2, 0), (0, 3)])
@pytest.mark.parametrize("view", ROOMS)
def test_a_planted_shift_is_found_to_half_a_px(view: str, shift: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    frame = lit(np.roll(ROOMS[view], shift[::-1], (0, 1)), 0.8, 5)
    frame[100:300, 200:330] = (40, 90, 160)
    background = picture_of(ROOMS[view]).grey
    found = shift_between(background, picture_of(noisy(frame, 2, rng)).grey, edge_points(background))
    assert np.abs(np.subtract(found, shift)).max() <= 0.5


def test_pictures_that_agree_are_left_alone() -> None:
    rng = np.random.default_rng(0)
    for room in ROOMS.values():
        background = picture_of(room).grey
        points = edge_points(background)
        assert shift_between(background, picture_of(noisy(room, 3, rng)).grey, points) == (0.0, 0.0)
        assert shift_between(background, np.full_like(background, 90), points) == (0.0, 0.0)
        assert shift_between(background, np.roll(background, 40, axis=1), points[:5]) == (0.0, 0.0)  # too few points


def test_the_agreement_is_the_mean_cosine_of_the_gradients() -> None:
    rng = np.random.default_rng(3)
    one, other = (rng.uniform(0, 255, (60, 80)).astype(np.float32) for _ in range(2))
    points = edge_points(one)
    assert len(points) >= 8 and (points >= 7).all()

    def gradient(grey: np.ndarray, y: int, x: int) -> np.ndarray:
        return np.array([grey[y, x + 1] - grey[y, x - 1], grey[y + 1, x] - grey[y - 1, x]], np.float64)

    pairs = [(gradient(one, y, x), gradient(other, y + 2, x - 3)) for y, x in points]
    expected = np.mean([p @ f / np.sqrt((p @ p) * (f @ f) + 1) for p, f in pairs])
    assert _agreement(one, other, points, 2, -3) == pytest.approx(expected, abs=1e-5)


def test_a_bumped_camera_still_tells_objects() -> None:
    """Without the shift, every edge of the room would be foreground."""
    for shift in ((3, -5), (-4, 7)):
        background = Background(np.roll(ROOMS["left"], shift, (0, 1)), 1.0)
        frame = ROOMS["left"].copy()
        frame[200:300, 250:330] = (40, 90, 160)
        found = foreground_evidence(frame, background) >= SURE
        assert found[204:296, 254:326].all()
        found[196:304, 246:334] = False
        assert found[10:-10, 10:-10].mean() < 2e-3


def test_a_moved_background_is_kept_and_not_too_many() -> None:
    background = Background(tiles(), 1.0, np.ones((240, 320), np.float32))
    moved = background.moved(3.0, -2.0)
    np.testing.assert_array_equal(moved.image[:-2, 3:], background.image[2:, :-3])
    assert background.moved(3.0, -2.0) is moved and moved.spread is not None
    for x in range(10):
        background.moved(float(x), 0.5)
    assert len(background._moved) <= 4
    assert as_uint8(background.moved(0.5, 0.0).image).shape == background.image.shape
