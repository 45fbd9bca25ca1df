"""Where an object is, its contour and its size: counted by hand, by scipy and scikit-image, and on a known floor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage
from scipy.signal import find_peaks
from skimage.measure import regionprops

from occlib.geometry import Camera, Rig
from occlib.lens import Lens
from occlib.localization import Region, ScaleTable, contour, contour_polar, find_regions, scale_table, split_regions

Array = np.ndarray[Any, Any]
masks = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24))
EIGHT = np.ones((3, 3))


def picture(*rows: str) -> Array:
    """A mask drawn with ``#``."""
    return np.array([[character == "#" for character in row] for row in rows])


def disc(shape: tuple[int, int], centre: tuple[float, float], radius: float) -> Array:
    y, x = np.ogrid[: shape[0], : shape[1]]
    return np.asarray(np.hypot(x - centre[0], y - centre[1]) <= radius)


# --- Eq 3, 4: number of pixels and centroid ----------------------------------------------------------------
def test_equations_3_and_4_by_hand() -> None:
    labels, (region,) = find_regions(
        picture(
            "......",
            ".##...",
            ".###..",
            "......",
        )
    )
    assert region.area == 5
    assert region.centroid == pytest.approx(((1 + 2 + 1 + 2 + 3) / 5, (1 + 1 + 2 + 2 + 2) / 5))
    assert region.box == (1, 1, 3, 2)
    assert region.middle == (2.0, 1.5)
    assert labels.dtype == np.int32
    np.testing.assert_array_equal(labels[1], [0, 1, 1, 0, 0, 0])


def test_the_middle_of_the_extent_survives_a_hole_that_pulls_the_centroid() -> None:
    whole = np.zeros((20, 30), bool)
    whole[5:15, 4:24] = True
    holed = whole.copy()
    holed[6:14, 5:14] = False
    (before,), (after,) = find_regions(whole)[1], find_regions(holed)[1]
    assert before.middle == after.middle == before.centroid == (13.5, 9.5)
    assert after.centroid[0] > 15


@settings(max_examples=150, deadline=None)
@given(masks)
def test_regions_are_those_of_scipy_and_scikit_image(mask: Array) -> None:
    kept = mask.copy()
    labels, regions = find_regions(mask)
    expected, count = ndimage.label(mask, EIGHT)
    np.testing.assert_array_equal(labels, expected)
    assert [region.label for region in regions] == list(range(1, count + 1))
    for region, known in zip(regions, regionprops(labels), strict=True):
        top, left, bottom, right = known.bbox
        assert region.area == known.area
        assert region.centroid == pytest.approx(known.centroid[::-1])
        assert region.box == (left, top, right - left, bottom - top)
    np.testing.assert_array_equal(mask, kept)


@settings(max_examples=100, deadline=None)
@given(masks, st.integers(0, 4), st.integers(1, 5))
def test_labels_ascend_in_row_major_order_of_first_appearance(mask: Array, join: int, least: int) -> None:
    labels, regions = find_regions(mask, join=join, min_area=least)
    values, first = np.unique(labels[labels > 0], return_index=True)
    assert values.tolist() == [region.label for region in regions]
    assert (np.diff(first) > 0).all()
    again, same = find_regions(mask.copy(), join=join, min_area=least)
    np.testing.assert_array_equal(labels, again)
    assert regions == same


@settings(max_examples=100, deadline=None)
@given(masks, st.integers(1, 4))
def test_joining_moves_no_pixel_splits_no_region_and_needs_no_within_to_do_nothing(mask: Array, join: int) -> None:
    alone, _ = find_regions(mask)
    joined, regions = find_regions(mask, join=join)
    np.testing.assert_array_equal(joined > 0, mask)
    for value in range(1, alone.max(initial=0) + 1):
        assert len(np.unique(joined[alone == value])) == 1
    assert sum(region.area for region in regions) == mask.sum()
    everything, whole = find_regions(mask, join=join, within=[np.ones_like(mask)])
    np.testing.assert_array_equal(everything, joined)
    assert whole == regions


def test_region_numbers_shift_with_the_mask() -> None:
    rng = np.random.default_rng(0)
    mask = np.zeros((60, 70), bool)
    mask[10:40, 10:50] = ndimage.gaussian_filter(rng.normal(size=(30, 40)), 1.5) > 0.1
    moved = np.roll(mask, (15, 12), (0, 1))
    for a, b in zip(find_regions(mask)[1], find_regions(moved)[1], strict=True):
        assert b.centroid == pytest.approx((a.centroid[0] + 12, a.centroid[1] + 15))
        assert (b.area, b.label) == (a.area, a.label)


def test_small_regions_are_dropped_and_the_rest_renumbered() -> None:
    mask = picture("##...#...###", "##.......###")
    labels, regions = find_regions(mask, min_area=2)
    assert [(region.label, region.area) for region in regions] == [(1, 4), (2, 6)]
    assert labels[0].tolist() == [1, 1, 0, 0, 0, 0, 0, 0, 0, 2, 2, 2]
    assert [region.area for region in find_regions(mask, min_area=4.5)[1]] == [6]


def test_an_empty_mask_has_no_region() -> None:
    for shape in ((5, 7), (0, 0), (1, 1)):
        labels, regions = find_regions(np.zeros(shape, bool), join=3)
        assert regions == [] and labels.shape == shape and not labels.any()


def test_a_transposed_or_sliced_mask_is_read_as_it_looks() -> None:
    mask = np.random.default_rng(1).random((40, 30)) < 0.3
    for view in (mask.T, mask[::2, 1::3], mask[:, ::-1]):
        np.testing.assert_array_equal(find_regions(view)[0], ndimage.label(view, EIGHT)[0])


# --- joining fragments -------------------------------------------------------------------------------------
@pytest.mark.parametrize("gap", [1, 2, 3, 4, 5, 8, 20])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_straight_gap_is_bridged_up_to_join_and_not_beyond(gap: int, axis: int) -> None:
    mask = np.zeros((9, 60), bool)
    mask[3:6, 10:14] = True
    mask[3:6, 14 + gap : 18 + gap] = True
    mask = mask if axis else mask.T
    assert len(find_regions(mask, join=gap)[1]) == 1
    assert len(find_regions(mask, join=gap + 1)[1]) == 1
    assert len(find_regions(mask, join=gap - 1)[1]) == 2
    labels, (region,) = find_regions(mask, join=gap)
    np.testing.assert_array_equal(labels > 0, mask)  # the gap stays empty
    assert region.area == 24
    assert region.centroid == pytest.approx(((27 + gap) / 2, 4) if axis else (4, (27 + gap) / 2))


@settings(max_examples=60, deadline=None)
@given(arrays(bool, (12, 12)), st.integers(1, 5))
def test_joining_agrees_with_a_closing_by_a_square(mask: Array, join: int) -> None:
    padded = np.pad(mask, 12)
    closed = ndimage.binary_closing(padded, np.ones((join + 1, join + 1)))[12:-12, 12:-12]
    bridged = ndimage.label(closed, EIGHT)[0]
    labels, _ = find_regions(mask, join=join)
    pairs = {(int(a), int(b)) for a, b in zip(labels[mask], bridged[mask], strict=True)}
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})  # one to one


FEET = picture(
    "............",
    ".##....##...",
    ".##....##...",
    "............",
)
BODY = picture("............", ".#########..", ".#########..", "............")


def test_feet_join_where_every_view_connects_them_and_objects_stay_apart_where_one_does_not() -> None:
    assert len(find_regions(FEET, join=4)[1]) == 1
    assert len(find_regions(FEET, join=4, within=[BODY, BODY])[1]) == 1
    labels, regions = find_regions(FEET, join=4, within=[BODY, FEET])
    assert len(regions) == 2
    assert labels[1].tolist() == [0, 1, 1, 0, 0, 0, 0, 2, 2, 0, 0, 0]
    assert len(find_regions(FEET, join=2, within=[BODY, BODY])[1]) == 2  # connected, but too far apart
    assert len(find_regions(FEET, join=0, within=[BODY, BODY])[1]) == 2


def test_what_leaves_the_map_may_be_connected_out_there() -> None:
    bent = picture("##.....##", "##.....##", ".........")  # one view: two silhouettes that leave the map above
    assert len(find_regions(bent, join=5, within=[bent])[1]) == 1
    inside = np.pad(bent, 1)
    assert len(find_regions(inside, join=5, within=[inside])[1]) == 2


def test_wrong_arguments_are_named() -> None:
    mask = np.zeros((4, 5), bool)
    with pytest.raises(ValueError, match=r"mask: expected bool \(4, 5\), got uint8"):
        find_regions(mask.astype(np.uint8))
    with pytest.raises(ValueError, match=r"mask: expected bool .* \(4, 5, 3\)"):
        find_regions(np.zeros((4, 5, 3), bool))
    with pytest.raises(ValueError, match=r"within: expected bool \(4, 5\), got bool \(5, 4\)"):
        find_regions(mask, within=[mask.T])
    with pytest.raises(ValueError, match="join: expected px >= 0, got -1"):
        find_regions(mask, join=-1)


# --- Eq 5: contour -----------------------------------------------------------------------------------------
def test_equation_5_by_hand() -> None:
    theta, d = contour_polar([[3, 1], [1, 4], [-2, 1], [1, -1]], (1, 1))
    np.testing.assert_allclose(theta, [-np.pi / 2, 0, np.pi / 2, np.pi])
    np.testing.assert_allclose(d, [2, 2, 3, 3])


def test_the_contour_of_a_disc_is_a_constant() -> None:
    mask = disc((101, 121), (60, 50), 30)
    (region,) = find_regions(mask)[1]
    theta, d = contour_polar(contour(mask), region.centroid)
    assert (np.diff(theta) >= 0).all() and theta[0] >= -np.pi and theta[-1] <= np.pi
    assert np.ptp(theta) > 2 * np.pi - 0.1  # all the way around: a plain arctangent would stop at pi
    assert np.abs(d - 30).max() < 1.0


def test_the_contour_of_a_square_has_its_four_corners() -> None:
    mask = np.zeros((80, 80), bool)
    mask[20:61, 15:56] = True
    (region,) = find_regions(mask)[1]
    theta, d = contour_polar(contour(mask), region.centroid)
    peaks, _ = find_peaks(d, prominence=3)
    np.testing.assert_allclose(theta[peaks], np.array([-3, -1, 1, 3]) * np.pi / 4, atol=0.03)
    np.testing.assert_allclose(d[peaks], 20 * np.sqrt(2))
    assert d.min() == pytest.approx(20)


def test_a_contour_scales_and_does_not_turn_with_the_position() -> None:
    points = np.array([[10.0, 4.0], [14.0, 9.0], [7.0, 12.0], [3.0, 6.0]])
    kept = points.copy()
    theta, d = contour_polar(points, points.mean(0))
    moved = contour_polar(3 * points + 50, 3 * points.mean(0) + 50)
    np.testing.assert_allclose(moved[0], theta)
    np.testing.assert_allclose(moved[1], 3 * d)
    np.testing.assert_array_equal(points, kept)


def test_contour_is_that_of_the_largest_region_not_of_the_longest_outline() -> None:
    mask = disc((60, 160), (30, 30), 20)
    mask[5, 60:155] = True  # a hair: 95 px, but an outline longer than the disc's
    points = contour(mask)
    assert points.shape[1] == 2 and points[:, 0].max() <= 50
    inner = ndimage.binary_erosion(mask)  # 4-neighbours: what is left is the rim that the contour walks along
    rim = {(float(x), float(y)) for y, x in np.argwhere(disc((60, 160), (30, 30), 20) & ~inner)}
    assert {tuple(point) for point in points.tolist()} == rim


def test_contour_goes_around_step_by_step_and_ignores_holes() -> None:
    mask = disc((60, 60), (30, 30), 20) & ~disc((60, 60), (30, 30), 8)
    points = contour(mask)
    steps = np.abs(np.diff(np.vstack([points, points[:1]]), axis=0)).max(axis=1)
    assert (steps == 1).all()
    assert np.hypot(*(points - 30).T).min() > 18


def test_contour_of_nothing_and_of_wrong_points() -> None:
    with pytest.raises(ValueError, match="mask: expected at least one foreground px, got none"):
        contour(np.zeros((5, 5), bool))
    with pytest.raises(ValueError, match=r"contour_px: expected shape \(N, 2\)"):
        contour_polar(np.zeros((4, 3)), (0, 0))
    theta, d = contour_polar(np.empty((0, 2)), (0, 0))
    assert theta.shape == d.shape == (0,)


# --- scale factors -------------------------------------------------------------------------------------------
def pixels_of_patch(camera: Camera, patch: tuple[float, float, float, float]) -> Array:
    """Mask of the px whose centre shows the floor rectangle ``(x0, x1, y0, y1)`` in m."""
    columns, rows = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
    x, y = camera.pixels_to_floor(np.column_stack([columns.ravel(), rows.ravel()])).T
    x0, x1, y0, y1 = patch
    return ((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)).reshape(camera.size[::-1])


@pytest.mark.parametrize("name", ["left", "right"])
def test_scale_factors_summed_over_a_floor_patch_give_its_area(tiny_rig: Rig, name: str) -> None:
    camera = tiny_rig[name]
    table = scale_table(camera, cell_px=4)
    assert table.factors.shape == (30, 40)
    mask = pixels_of_patch(camera, (0.5, 3.5, 0.5, 2.5))
    rows, columns = np.nonzero(mask)
    total = table.lookup(np.column_stack([columns, rows])).sum()
    assert total == pytest.approx(3.0 * 2.0, rel=0.02)


@pytest.mark.parametrize("name", ["left", "right"])
@pytest.mark.parametrize("corner", [(0.4, 0.4), (2.0, 1.5), (3.2, 2.2)])
def test_the_actual_area_of_a_flat_patch(tiny_rig: Rig, name: str, corner: tuple[float, float]) -> None:
    camera = tiny_rig[name]
    x, y = corner
    mask = pixels_of_patch(camera, (x, x + 0.6, y, y + 0.5))
    (region,) = find_regions(mask)[1]
    assert scale_table(camera, cell_px=8).actual_area(region) == pytest.approx(0.3, rel=0.12)


def test_a_pixel_far_away_covers_more_floor_than_one_close_by(tiny_rig: Rig) -> None:
    camera = tiny_rig["left"]
    near, far = scale_table(camera, cell_px=8).lookup(camera.floor_to_pixels([[0.3, 1.5], [3.7, 1.5]]))
    assert 0 < near < far / 2


def test_above_the_horizon_there_is_no_scale(tiny_rig: Rig) -> None:
    left = tiny_rig["left"]
    level = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # looks along +x: the horizon is in the middle
    camera = Camera.from_pose("level", left.size, Lens(left.matrix, np.zeros(5)), level, -level @ [0.0, 0.0, 1.5])
    factors = scale_table(camera, cell_px=10).factors
    assert np.isnan(factors[:5]).all()
    assert (factors[7:] > 0).all()


def test_scale_table_lookup_by_hand_and_its_borders() -> None:
    table = ScaleTable(10, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    assert table.lookup([[0, 0], [9.4, 0], [9.6, 0], [29, 19], [-0.5, 10]]).tolist() == [1, 1, 2, 6, 4]
    assert table.actual_area(Region(1, 7, (15.0, 12.0), (0, 0, 1, 1))) == 35.0
    for outside in ([-1, 0], [30, 0], [0, 20]):
        with pytest.raises(ValueError, match="points_px: expected px inside the table's 3 x 2 cells of 10 px"):
            table.lookup([outside])


def test_a_grid_that_does_not_divide_the_picture_covers_all_of_it(tiny_rig: Rig) -> None:
    camera = tiny_rig["left"]
    table = scale_table(camera, cell_px=33)
    assert table.factors.shape == (4, 5)
    assert (table.lookup([[0, 0], [159, 0], [0, 119], [159, 119]]) > 0).any()
    with pytest.raises(ValueError, match="cell_px: expected px >= 1, got 0"):
        scale_table(camera, cell_px=0)


def two_bars() -> tuple[np.ndarray, np.ndarray]:
    """A mask of two blocks that a thin bridge connects, and the blocks alone."""
    mask, core = np.zeros((30, 60), bool), np.zeros((30, 60), bool)
    for columns in (slice(5, 20), slice(35, 55)):
        mask[8:22, columns] = core[10:20, columns] = True
    mask[14:16, 20:35] = True
    return mask, core


def test_a_region_with_two_cores_is_split_halfway_between_them() -> None:
    mask, core = two_bars()
    labels, regions = find_regions(mask)
    before = labels.copy()
    split, parts = split_regions(labels, regions, core, within=[core])
    assert len(regions) == 1 and len(parts) == 2
    np.testing.assert_array_equal(labels, before)
    np.testing.assert_array_equal(split > 0, mask)
    assert [part.box for part in parts] == [(5, 8, 23, 14), (28, 8, 27, 14)]
    assert split[14, 26] == 1 and split[14, 29] == 2
    assert [part.area for part in parts] == [int((split == k).sum()) for k in (1, 2)]


def test_cores_that_every_view_connects_or_that_are_small_do_not_split() -> None:
    mask, core = two_bars()
    labels, regions = find_regions(mask)
    for options in ({"within": [mask]}, {"within": [core], "min_area": 180}):
        split, parts = split_regions(labels, regions, core, **options)
        np.testing.assert_array_equal(split, labels)
        assert parts == regions
    assert len(split_regions(labels, regions, core, within=[mask, core])[1]) == 2


@given(seed=st.integers(0, 10_000))
def test_splitting_keeps_every_pixel_and_never_joins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    soft = ndimage.uniform_filter(rng.random((24, 32)), 3)
    labels, regions = find_regions(soft > 0.5)
    split, parts = split_regions(labels, regions, soft > 0.58, within=[soft > 0.58])
    np.testing.assert_array_equal(split > 0, labels > 0)
    assert sum(part.area for part in parts) == sum(region.area for region in regions)
    for part in parts:
        assert len(set(labels[split == part.label].tolist())) == 1
    assert len(parts) >= len(regions)


def test_splitting_checks_the_core() -> None:
    labels, regions = find_regions(np.ones((3, 4), bool))
    with pytest.raises(ValueError, match=r"core: expected bool \(3, 4\)"):
        split_regions(labels, regions, np.ones((4, 3), bool))
