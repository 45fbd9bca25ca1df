"""Floor that an object of the background's pictures has left."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from helpers.floors import noisy, tiles
from occlib.foreground.background import Background
from occlib.foreground.shadows import SURE, foreground_evidence
from occlib.foreground.uncovered import FAINTER, LEAST_EDGE, REACH, SHARE, uncovered_floor

LEFT, STANDS = np.s_[60:120, 40:100], np.s_[100:180, 180:250]


def disc(shape: tuple[int, int], centre: tuple[int, int], radius: int) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(y - centre[0], x - centre[1]) < radius


def naive(foreground: np.ndarray, background: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Region by region: of the outline's px that are edges, the share that is one in the background alone."""
    strongest = [ndimage.maximum_filter(np.clip(np.rint(one), 0, 255), REACH) for one in (background, frame)]
    labels, count = ndimage.label(foreground)
    gone = np.zeros(foreground.shape, bool)
    for number in range(1, count + 1):
        region = labels == number
        p, f = (
            one[region & ~ndimage.binary_erosion(foreground)] for one in strongest
        )  # px at the picture's rim as well
        edge, alone = np.maximum(p, f) > LEAST_EDGE, (p > LEAST_EDGE) & (f < FAINTER * p)
        if alone.sum() > SHARE * edge.sum() and edge.mean() > 0.5:
            gone |= ndimage.binary_dilation(region, np.ones((3, 3)))
    return gone


@pytest.mark.parametrize("seed", range(12))
def test_the_compiled_outline_equals_the_plain_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    foreground = ndimage.gaussian_filter(rng.normal(0, 1, (70, 90)), 4) > 0.05
    rim = ndimage.binary_dilation(foreground) & ~ndimage.binary_erosion(foreground)
    fading = np.clip(np.linspace(-0.5, 1.5, 90) + rng.normal(0, 0.1, 90), 0, 1)  # the frame's edges, from none to all
    background = (rim * rng.uniform(8, 60, rim.shape)).astype(np.float32)
    frame = (background * fading).astype(np.float32)
    gone = uncovered_floor(foreground, background, frame)
    np.testing.assert_array_equal(gone, naive(foreground, background, frame))
    assert gone.any() and not gone[foreground].all()


@pytest.mark.xfail(reason="joints of the floor as strong as the outline pass for edges of the frame", strict=True)
def test_floor_that_an_object_has_left_is_no_object() -> None:
    rng = np.random.default_rng(0)
    for grain in (0.0, 6.0):
        floor = tiles(grain=grain)
        empty, frame = floor.copy(), floor.copy()
        empty[LEFT] = (40, 60, 150)
        frame[STANDS] = (150, 60, 40)
        found = foreground_evidence(noisy(frame, 1.5, rng), Background(noisy(empty, 1.0, rng), 1.0)) >= SURE
        assert found[STANDS].mean() > 0.95
        found[96:184, 176:254] = False
        assert not found.any()


def test_an_object_that_stands_before_an_edge_of_the_background_stays() -> None:
    rng = np.random.default_rng(1)
    floor = tiles()
    floor[:110] = (70, 60, 50)  # a wall; its foot runs behind the object
    frame = floor.copy()
    frame[STANDS] = (180, 170, 60)
    found = foreground_evidence(noisy(frame, 1.5, rng), Background(floor, 1.0)) >= SURE
    assert found[STANDS].mean() > 0.97


def test_each_region_is_judged_by_its_own_outline() -> None:
    shape = (80, 120)
    one, other = disc(shape, (40, 30), 15), disc(shape, (40, 85), 15)
    rims = [disc(shape, (40, x), 17) & ~disc(shape, (40, x), 13) for x in (30, 85)]
    background = np.where(rims[0], 60, 2).astype(np.float32)
    frame = np.where(rims[1], 60, 2).astype(np.float32)
    gone = uncovered_floor(one | other, background, frame)
    assert gone[one].all() and not gone[other].any()
    assert not uncovered_floor(one | other, frame * 0, frame * 0).any()  # no edge, no verdict
    assert not uncovered_floor(np.zeros(shape, bool), background, frame).any()
    both = uncovered_floor(one | other, background + frame, background + frame)
    assert not both.any()


def test_all_sides_of_the_outline_count_and_half_of_it_has_to_be_an_edge() -> None:
    region, nothing = np.zeros((60, 100), bool), np.zeros((60, 100), np.float32)
    region[20:40, 20:80] = True
    top, bottom, ends = nothing.copy(), nothing.copy(), nothing.copy()
    top[20, 20:80] = bottom[39, 20:80] = ends[20:40, [20, 79]] = 60
    assert uncovered_floor(region, top + ends, nothing)[region].all()
    assert not uncovered_floor(region, top, nothing).any()  # two fifths of the outline
    for side in (top, bottom):
        assert not uncovered_floor(region, top + ends + bottom, side).any()  # there, the frame has an edge as well
