"""Both views on one floor: a picture painted from floor coordinates gives the floor back, exactly and the right way up."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from occlib.explaining.evidence import PolarWarp
from occlib.geometry import Camera, Floor, Rig, apply_homography
from occlib.lens import Lens
from occlib.registration import (
    FloorWarp,
    registration_error_m,
    rotation_about_centre,
    rotation_onto,
    undistort,
    view_angle,
    view_homography,
    warp_top_view,
)

Array = np.ndarray[Any, Any]
SIZE = (320, 240)
FLOOR = Floor((-1.0, 3.0), (0.5, 3.5), 0.02)  # not centred on the origin, not square


def looking(name: str, centre: tuple[float, float, float], target: tuple[float, float], *, lens: float = 1.0) -> Camera:
    """A camera at ``centre`` (m) that looks at a floor point; ``lens`` scales its distortion."""
    position = np.array(centre)
    forward = np.array([*target, 0.0]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = [[205.0, 0, 161.3], [0, 203.0, 118.4], [0, 0, 1]]
    distortion = lens * np.array([-0.22, 0.06, 0.0015, -0.001, 0.0])
    return Camera.from_pose(name, SIZE, Lens(matrix, distortion), rotation, -rotation @ position)


LEFT = looking("left", (-3.0, 1.8, 2.5), (1.0, 2.0))
RIGHT = looking("right", (5.0, 2.2, 2.6), (1.0, 2.0))
PARTIAL = looking("partial", (1.0, -0.5, 1.2), (2.6, 1.2))


def floor_of_pixels(camera: Camera) -> Array:
    """Metres that each pixel shows, (H, W, 2)."""
    columns, rows = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
    points = camera.pixels_to_floor(np.column_stack([columns.ravel(), rows.ravel()]))
    return points.reshape(camera.size[1], camera.size[0], 2)


def paint(x: Array, y: Array) -> Array:
    """A smooth picture of the floor without any symmetry, grey levels 0 to 255."""
    return 127 + 60 * np.sin(1.7 * x + 0.3) * np.cos(1.1 * y) + 50 * np.tanh(x - 0.4 * y)


def centres(floor: Floor) -> Array:
    return floor.cell_centres_m().reshape(*floor.shape, 2)


@pytest.mark.parametrize("camera", [LEFT, RIGHT, PARTIAL], ids=lambda c: c.name)
def test_a_picture_painted_from_the_floor_gives_the_floor_back(camera: Camera) -> None:
    metres = floor_of_pixels(camera)
    picture = paint(metres[..., 0], metres[..., 1]).astype(np.float32)
    warp = FloorWarp(camera, FLOOR)
    mapped = warp.warp(picture)
    truth = paint(centres(FLOOR)[..., 0], centres(FLOOR)[..., 1])
    near = np.hypot(*(centres(FLOOR) - camera.centre_m[:2]).transpose(2, 0, 1)) < 4.5
    x, y = np.moveaxis(warp.pixels, -1, 0)
    inner = warp.visible & near & (x > 0) & (y > 0) & (x < SIZE[0] - 1) & (y < SIZE[1] - 1)
    assert inner.sum() > 5000
    assert np.abs(mapped - truth)[inner].max() < 1.0
    assert np.abs(mapped - truth)[inner].mean() < 0.1


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_warp_is_bilinear_interpolation_at_the_cells_pixels(dtype: Any) -> None:
    picture = np.random.default_rng(0).integers(0, 256, SIZE[::-1]).astype(dtype)
    kept = picture.copy()
    warp = FloorWarp(LEFT, FLOOR)
    mapped = warp.warp(picture)
    assert mapped.dtype == dtype and mapped.shape == FLOOR.shape
    x, y = warp.pixels[warp.visible].T
    expected = map_coordinates(picture.astype(float), [y, x], order=1, mode="grid-constant")
    assert np.abs(mapped[warp.visible] - expected).max() < 10  # positions are rounded to 1/32 px
    assert np.abs(mapped[warp.visible] - expected).mean() < 2
    np.testing.assert_array_equal(picture, kept)


def test_colour_is_warped_channel_by_channel() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (*SIZE[::-1], 3)).astype(np.uint8)
    warp = FloorWarp(LEFT, FLOOR)
    mapped = warp.warp(picture)
    assert mapped.shape == (*FLOOR.shape, 3)
    for channel in range(3):
        np.testing.assert_array_equal(mapped[..., channel], warp.warp(np.ascontiguousarray(picture[..., channel])))


@pytest.mark.parametrize("camera", [LEFT, PARTIAL], ids=lambda c: c.name)
def test_a_mask_takes_exactly_the_nearest_pixel(camera: Camera) -> None:
    mask = np.random.default_rng(2).random(SIZE[::-1]) < 0.5
    warp = FloorWarp(camera, FLOOR)
    mapped = warp.warp(mask)
    x, y = np.rint(warp.pixels[warp.visible]).astype(int).T
    expected = np.zeros(FLOOR.shape, bool)
    expected[warp.visible] = mask[y, x]
    assert mapped.dtype == np.bool_
    np.testing.assert_array_equal(mapped, expected)


def test_visible_is_where_the_cell_projects_onto_the_sensor() -> None:
    for camera in (LEFT, PARTIAL):
        warp = FloorWarp(camera, FLOOR)
        world = np.column_stack([FLOOR.cell_centres_m(), np.zeros(FLOOR.shape[0] * FLOOR.shape[1])])
        pixels = camera.project(world)
        with np.errstate(invalid="ignore"):
            inside = (np.abs(pixels - (np.array(SIZE) - 1) / 2) < np.array(SIZE) / 2).all(axis=1)
        np.testing.assert_array_equal(warp.visible.ravel(), inside)
        np.testing.assert_array_equal(np.isfinite(warp.pixels).all(axis=2), warp.visible)
        np.testing.assert_allclose(warp.pixels[warp.visible], pixels[inside], atol=1e-6)
    assert 0.2 < FloorWarp(PARTIAL, FLOOR).visible.mean() < 0.8


def test_what_a_camera_cannot_see_is_zero_even_behind_it() -> None:
    warp = FloorWarp(PARTIAL, Floor((-4.0, 6.0), (-4.0, 4.0), 0.05))  # most of this floor is behind the camera
    for picture in (np.full(SIZE[::-1], 255, np.uint8), np.ones(SIZE[::-1], bool)):
        assert not warp.warp(picture)[~warp.visible].any()
    behind = warp.floor.cell_centres_m()[:, 1].reshape(warp.floor.shape) < -2.0
    assert not warp.visible[behind].any()
    assert (warp.warp(np.ones(SIZE[::-1], bool)) == warp.visible).all()


@pytest.mark.parametrize("camera", [LEFT, RIGHT], ids=lambda c: c.name)
def test_a_mark_at_large_y_lands_in_a_high_row_and_at_small_x_in_a_low_column(camera: Camera) -> None:
    metres = floor_of_pixels(camera)
    mark = np.hypot(metres[..., 0] + 0.5, metres[..., 1] - 3.2) < 0.15
    iy, ix = np.nonzero(FloorWarp(camera, FLOOR).warp(mark))
    assert iy.mean() * FLOOR.resolution + FLOOR.y[0] == pytest.approx(3.2, abs=0.03)
    assert ix.mean() * FLOOR.resolution + FLOOR.x[0] == pytest.approx(-0.5, abs=0.03)
    assert iy.min() > 0.8 * FLOOR.shape[0] and ix.max() < 0.2 * FLOOR.shape[1]


def test_both_views_of_a_flat_scene_agree_after_registration() -> None:
    maps = []
    for camera in (LEFT, RIGHT):
        metres = floor_of_pixels(camera)
        maps.append(FloorWarp(camera, FLOOR).warp(paint(metres[..., 0], metres[..., 1]).astype(np.float32)))
    middle = np.s_[40:110, 60:140]
    assert np.abs(maps[0] - maps[1])[middle].max() < 1.5


def test_lens_distortion_is_not_ignored() -> None:
    ideal = looking("ideal", (-3.0, 1.8, 2.5), (1.0, 2.0), lens=0.0)
    both = FloorWarp(LEFT, FLOOR), FloorWarp(ideal, FLOOR)
    shared = both[0].visible & both[1].visible
    shift = np.linalg.norm(both[0].pixels - both[1].pixels, axis=2)[shared]
    assert shift.max() > 5  # px
    assert np.abs(both[1].pixels[shared] - ideal.floor_to_pixels(centres(FLOOR)[shared])).max() < 1e-9


def test_undistorting_then_the_homography_equals_the_one_look_up() -> None:
    metres = floor_of_pixels(LEFT)
    picture = np.clip(paint(metres[..., 0], metres[..., 1]), 0, 255).round().astype(np.uint8)
    kept = picture.copy()
    direct = FloorWarp(LEFT, FLOOR)
    to_cells = np.linalg.inv(FLOOR.cell_to_floor) @ LEFT.image_to_floor
    two_steps = warp_top_view(undistort(picture, LEFT), to_cells, FLOOR)
    both = direct.visible & (two_steps > 0)
    difference = np.abs(direct.warp(picture).astype(int) - two_steps)[both]
    assert both.mean() > 0.5
    assert difference.mean() < 1 and np.percentile(difference, 99) <= 3
    np.testing.assert_array_equal(picture, kept)


# --- the paper's two steps -------------------------------------------------------------------------------
def same_map(a: Array, b: Array) -> None:
    """Homographies that map points alike; a matrix means the same whatever its scale."""
    points = np.array([[160.0, 120.0], [40.0, 200.0], [290.0, 180.0], [100.0, 230.0]])
    np.testing.assert_allclose(apply_homography(a, points), apply_homography(b, points), atol=1e-6)


@pytest.mark.parametrize(("camera", "reference"), [(LEFT, RIGHT), (RIGHT, LEFT), (PARTIAL, RIGHT), (LEFT, LEFT)])
def test_transform_and_rotation_equal_the_single_homography(camera: Camera, reference: Camera) -> None:
    single = np.linalg.inv(FLOOR.cell_to_floor) @ camera.image_to_floor
    registered = rotation_onto(camera, reference, FLOOR) @ view_homography(camera, FLOOR)
    turn_back = rotation_about_centre(view_angle(reference, FLOOR), FLOOR)
    same_map(turn_back @ registered, single)


def test_a_floor_point_lands_in_the_same_cell_from_both_views_once_the_left_is_rotated() -> None:
    points_m = np.array([[0.0, 1.0], [2.5, 3.0], [1.0, 2.0], [-0.5, 3.2]])
    cells = {}
    for camera in (LEFT, RIGHT):
        ideal = apply_homography(np.linalg.inv(camera.image_to_floor), points_m)
        cells[camera.name] = apply_homography(view_homography(camera, FLOOR), ideal)
    assert np.abs(cells["left"] - cells["right"]).max() > 20  # before the rotation
    turned = apply_homography(rotation_onto(LEFT, RIGHT, FLOOR), cells["left"])
    np.testing.assert_allclose(turned, cells["right"], atol=1e-6)


def test_opposite_cameras_differ_by_half_a_turn() -> None:
    middle = (np.mean(FLOOR.x), np.mean(FLOOR.y))
    west = looking("west", (middle[0] - 4, middle[1], 2.5), middle)
    east = looking("east", (middle[0] + 4, middle[1], 2.5), middle)
    turn = (view_angle(west, FLOOR) - view_angle(east, FLOOR)) % (2 * np.pi)
    assert turn == pytest.approx(np.pi)
    ny, nx = FLOOR.shape
    half_turn = np.array([[-1, 0, nx - 1], [0, -1, ny - 1], [0, 0, 1]])
    np.testing.assert_allclose(rotation_onto(west, east, FLOOR), half_turn, atol=1e-9)


@pytest.mark.parametrize("camera", [LEFT, RIGHT, PARTIAL], ids=lambda c: c.name)
def test_in_its_own_top_view_the_camera_looks_upwards_and_nothing_is_mirrored(camera: Camera) -> None:
    """Shown as maps are, row 0 at the bottom: far is up, and what is right in the picture stays right."""
    to_top = view_homography(camera, FLOOR)
    u, v = camera.matrix[:2, 2]
    centre, above, right = apply_homography(to_top, [[u, v], [u, v - 20], [u + 20, v]])
    assert above[1] > centre[1] and right[0] > centre[0]


@given(angle=st.floats(-7, 7))
def test_rotation_keeps_the_centre_and_all_distances(angle: float) -> None:
    rotation = rotation_about_centre(angle, FLOOR)
    ny, nx = FLOOR.shape
    middle = np.array([[(nx - 1) / 2, (ny - 1) / 2]])
    np.testing.assert_allclose(apply_homography(rotation, middle), middle, atol=1e-9)
    corners = np.array([[0.0, 0.0], [nx - 1, 0.0], [nx - 1, ny - 1], [0.0, ny - 1]])
    turned = apply_homography(rotation, corners)
    sides = np.linalg.norm(np.roll(corners, 1, 0) - corners, axis=1)
    np.testing.assert_allclose(np.linalg.norm(np.roll(turned, 1, 0) - turned, axis=1), sides, atol=1e-9)
    np.testing.assert_allclose(rotation @ rotation_about_centre(-angle, FLOOR), np.eye(3), atol=1e-9)


def test_registration_error_is_zero_for_exact_marks_and_the_planted_shift_otherwise() -> None:
    marks = np.array([[0.0, 1.0], [2.0, 2.5], [1.0, 3.0]])
    pixels = LEFT.floor_to_pixels(marks)
    assert registration_error_m(LEFT, pixels, marks).max() < 1e-6
    np.testing.assert_allclose(registration_error_m(LEFT, pixels, marks + np.array([0.03, 0.04])), 0.05, atol=1e-6)


def test_wrong_sizes_are_named(tiny_rig: Rig) -> None:
    with pytest.raises(ValueError, match=r"image: expected \(240, 320\) for left, got \(320, 240\)"):
        FloorWarp(LEFT, FLOOR).warp(np.zeros(SIZE, np.uint8))
    with pytest.raises(ValueError, match=r"image: expected \(120, 160\) for right"):
        FloorWarp(tiny_rig["right"], tiny_rig.floor).warp(np.zeros((121, 160), bool))
    with pytest.raises(ValueError, match="homography: expected shape"):
        warp_top_view(np.zeros(SIZE[::-1], np.uint8), np.eye(2), FLOOR)


# --- planes above the floor ------------------------------------------------------------------------------
@pytest.mark.parametrize("height", [0.1, 0.6, 1.1])
@pytest.mark.parametrize("camera", [LEFT, PARTIAL], ids=lambda c: c.name)
def test_a_plane_shows_in_each_cell_what_is_at_its_height_above_it(camera: Camera, height: float) -> None:
    warp = FloorWarp(camera, FLOOR, height)
    rotation, translation = camera.pose
    above = np.concatenate([centres(FLOOR), np.full((*FLOOR.shape, 1), height)], axis=2).reshape(-1, 3)
    expected = cv2.projectPoints(above, cv2.Rodrigues(rotation)[0], translation, camera.matrix, camera.distortion)[0]
    expected = expected.reshape(*FLOOR.shape, 2)
    assert warp.visible.any()
    np.testing.assert_allclose(warp.pixels[warp.visible], expected[warp.visible], atol=1e-6)
    x, y = np.round(warp.pixels[warp.visible][500]).astype(int)
    picture = np.zeros(SIZE[::-1], bool)
    picture[y, x] = True
    assert warp.warp(picture)[warp.visible][500]


def test_the_plane_at_height_0_is_the_floor() -> None:
    picture = np.random.default_rng(5).integers(0, 256, SIZE[::-1]).astype(np.uint8)
    np.testing.assert_array_equal(FloorWarp(LEFT, FLOOR, 0.0).pixels, FloorWarp(LEFT, FLOOR).pixels)
    np.testing.assert_array_equal(FloorWarp(LEFT, FLOOR, 0.0).warp(picture), FloorWarp(LEFT, FLOOR).warp(picture))
    both = FloorWarp(LEFT, FLOOR).visible & FloorWarp(LEFT, FLOOR, 1e-9).visible
    np.testing.assert_allclose(
        FloorWarp(LEFT, FLOOR, 1e-9).pixels[both], FloorWarp(LEFT, FLOOR).pixels[both], atol=1e-4
    )


# --- polar views -----------------------------------------------------------------------------------------
def polar_samples(warp: PolarWarp, points_m: Array) -> Array:
    """Fractional (column, row) of world points, by the angles that the parameters name."""
    x, y, z, middle, left, top, step, _ = warp.parameters
    dx, dy, dz = (np.asarray(points_m, float) - [x, y, z]).T
    azimuth = (np.arctan2(dy, dx) - middle + np.pi) % (2 * np.pi) - np.pi
    return np.column_stack([(azimuth - left) / step, (np.arctan2(-dz, np.hypot(dx, dy)) - top) / step])


@pytest.mark.slow
@pytest.mark.parametrize("camera", [LEFT, RIGHT, PARTIAL], ids=lambda c: c.name)
def test_a_vertical_line_of_the_world_falls_into_one_column(camera: Camera) -> None:
    warp = PolarWarp(camera, FLOOR, 1.0)
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    for foot in ((1.0, 2.0), (1.8, 1.6), (2.2, 1.4)):
        line = np.column_stack([np.tile(foot, (200, 1)), np.linspace(0, 0.6, 200)])
        pixels = camera.project(line)
        pixels = pixels[camera.inside(pixels)]
        assert len(pixels) > 20
        picture = np.zeros(SIZE[::-1], np.float32)
        for x, y in pixels:  # a thin smooth stroke
            picture = np.maximum(picture, np.exp(-((u - x) ** 2 + (v - y) ** 2) / 2).astype(np.float32))
        polar = warp.warp(picture)
        columns = np.arange(warp.shape[1])
        bright = polar.max(axis=1) > 0.5
        centre = (polar * columns).sum(axis=1)[bright] / polar.sum(axis=1)[bright]
        assert bright.sum() > 5
        assert np.ptp(centre[2:-2]) < 1.0
        assert np.median(centre) == pytest.approx(polar_samples(warp, line)[0, 0], abs=0.5)


@pytest.mark.parametrize("camera", [LEFT, RIGHT, PARTIAL], ids=lambda c: c.name)
def test_rows_are_depressions_and_columns_azimuths_of_known_points(camera: Camera) -> None:
    warp = PolarWarp(camera, FLOOR)
    assert warp.step == pytest.approx(3.0 / np.sqrt(205 * 203))
    np.testing.assert_allclose(warp.parameters[:3], camera.centre_m)
    towards = np.array([np.mean(FLOOR.x), np.mean(FLOOR.y)]) - camera.centre_m[:2]
    assert warp.parameters[3] == pytest.approx(np.arctan2(towards[1], towards[0]))
    assert warp.parameters[7] == pytest.approx((warp.step / 0.0045) ** 2)
    rng = np.random.default_rng(6)
    points = np.column_stack([rng.uniform(-0.8, 2.8, 300), rng.uniform(0.7, 3.3, 300), rng.uniform(0, 0.8, 300)])
    pixels = camera.project(points)
    pixels, points = pixels[camera.inside(pixels)], points[camera.inside(pixels)]
    samples = polar_samples(warp, points)
    inner = ((samples >= 0) & (samples <= np.array(warp.shape[::-1]) - 1)).all(axis=1)
    assert inner.all() and len(samples) > 80
    for axis in (0, 1):  # interpolated between samples, the look-up leads to the pixel
        found = map_coordinates(warp.pixels[..., axis], samples.T[::-1], order=1)
        known = np.isfinite(found)
        assert known.mean() > 0.9
        assert np.abs(found - pixels[:, axis])[known].max() < 0.3


@pytest.mark.parametrize("camera", [LEFT, RIGHT, PARTIAL], ids=lambda c: c.name)
def test_the_polar_look_up_agrees_with_projection_and_misses_nothing(camera: Camera) -> None:
    warp = PolarWarp(camera, FLOOR)
    x, y, z, middle, left, top, step, _ = warp.parameters
    rows, columns = np.nonzero(warp.visible)
    azimuth, depression = middle + left + step * columns, top + step * rows
    far = 3.7  # m along the ray: any distance will do
    flat = far * np.cos(depression)
    world = np.column_stack([x + flat * np.cos(azimuth), y + flat * np.sin(azimuth), z - far * np.sin(depression)])
    np.testing.assert_allclose(warp.pixels[warp.visible], camera.project(world), atol=1e-6)
    assert camera.inside(warp.pixels[warp.visible]).all()
    np.testing.assert_array_equal(np.isfinite(warp.pixels).all(axis=2), warp.visible)
    assert warp.pixels.shape == (*warp.shape, 2)
    cells = FLOOR.cell_centres_m()[FloorWarp(camera, FLOOR).visible.ravel()]
    samples = polar_samples(warp, np.column_stack([cells, np.zeros(len(cells))]))
    assert samples.min() > -1 and (samples < np.array(warp.shape[::-1])).all()  # all of the floor in view is in it


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_polar_view_is_bilinear_interpolation_and_0_where_nothing_is_seen(dtype: Any) -> None:
    picture = np.random.default_rng(7).integers(1, 256, (*SIZE[::-1], 3)).astype(dtype)
    kept = picture.copy()
    warp = PolarWarp(RIGHT, FLOOR)
    polar = warp.warp(picture)
    assert polar.dtype == dtype and polar.shape == (*warp.shape, 3)
    assert not polar[~warp.visible].any()
    x, y = warp.pixels[warp.visible].T
    expected = map_coordinates(picture[..., 1].astype(float), [y, x], order=1, mode="grid-constant")
    assert np.abs(polar[warp.visible][:, 1] - expected).max() < 12  # positions are rounded to 1/32 px
    np.testing.assert_array_equal(warp.warp(np.ascontiguousarray(picture[..., 2])), polar[..., 2])
    np.testing.assert_array_equal(picture, kept)


def test_a_coarser_polar_view_has_fewer_samples_of_the_same_angles() -> None:
    fine, coarse = PolarWarp(LEFT, FLOOR, 1.0), PolarWarp(LEFT, FLOOR, 3.0)
    assert coarse.step == pytest.approx(3 * fine.step)
    assert np.array(fine.shape) == pytest.approx(3 * np.array(coarse.shape), abs=3)
    np.testing.assert_array_equal(fine.parameters[:6], coarse.parameters[:6])
    area = [warp.visible.sum() * warp.parameters[7] for warp in (fine, coarse)]
    assert area[0] == pytest.approx(area[1], rel=0.02)  # the weight of a sample is its solid angle


def test_wrong_sizes_for_a_polar_view_are_named() -> None:
    with pytest.raises(ValueError, match=r"image: expected \(240, 320\) for left, got \(320, 240\)"):
        PolarWarp(LEFT, FLOOR).warp(np.zeros(SIZE, np.uint8))
