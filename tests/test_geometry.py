"""Cameras, floor and rig: round trips, OpenCV as the reference, and every bad rig.yaml named in one line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib.base.arrays import as_points
from occlib.geometry import Camera, Floor, Rig, apply_homography, invert_homography
from occlib.lens import Lens

Array = np.ndarray[Any, Any]
SIZE = (640, 480)
MATRIX = np.array([[420.0, 0, 322.0], [0, 425.0, 236.0], [0, 0, 1]])
STRONG = np.array([-0.33, 0.11, 0.002, -0.0015, -0.012])  # bends the corners by some 70 px


def looking_down(centre: tuple[float, float, float], target: tuple[float, float], roll: float = 0.0) -> Array:
    """Rotation world to camera of a camera at ``centre`` that looks at a floor point."""
    forward = np.array([*target, 0.0]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    c, s = np.cos(roll), np.sin(roll)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ level


def camera(
    centre: tuple[float, float, float] = (-1.0, 0.5, 2.5),
    target: tuple[float, float] = (2.0, 1.0),
    roll: float = 0.0,
    distortion: Array = STRONG,
) -> Camera:
    rotation = looking_down(centre, target, roll)
    return Camera.from_pose("cam", SIZE, Lens(MATRIX, distortion), rotation, -rotation @ np.array(centre))


def sensor(step: int = 20) -> Array:
    xs, ys = np.meshgrid(np.arange(0, SIZE[0], step), np.arange(0, SIZE[1], step))
    return np.column_stack([xs.ravel(), ys.ravel()]).astype(float)


# --- homographies ----------------------------------------------------------------------------------
def test_homography_and_its_inverse_cancel() -> None:
    homography = np.array([[0.9, 0.1, 12.0], [-0.2, 1.1, 3.0], [1e-3, -5e-4, 1.0]])
    there = apply_homography(homography, sensor())
    assert np.abs(apply_homography(invert_homography(homography), there) - sensor()).max() < 1e-9
    assert invert_homography(homography)[2, 2] == 1


def test_point_at_infinity_is_nan() -> None:
    mapped = apply_homography([[1, 0, 0], [0, 1, 0], [1, 0, -2]], [[2, 5], [3, 5]])
    assert np.isnan(mapped[0]).all()
    assert mapped[1].tolist() == [3, 5]


@pytest.mark.parametrize(
    "bad", [np.zeros((3, 3)), [[1, 2, 3], [4, 5, 6], [7, 8, 9]], np.eye(2), np.full((3, 3), np.nan), np.eye(3) * 1e300]
)
def test_singular_homography_is_refused(bad: Any) -> None:
    with pytest.raises(ValueError, match="H: expected an invertible 3x3 homography"):
        invert_homography(bad, "H")


@pytest.mark.parametrize("scale", [1e-9, -1.0, 1e9])
def test_a_homography_has_no_scale(scale: float) -> None:
    homography = camera().image_to_floor
    assert np.allclose(invert_homography(scale * homography), invert_homography(homography), rtol=1e-9)
    assert np.allclose(apply_homography(scale * homography, [[300, 400]]), apply_homography(homography, [[300, 400]]))


def test_points_of_the_wrong_shape() -> None:
    assert as_points([]).shape == (0, 2)
    assert as_points([1, 2]).tolist() == [[1, 2]]
    for bad in ([[1, 2, 3]], [1, 2, 3], 5):
        with pytest.raises(ValueError, match=r"corner: expected shape \(N, 2\), got"):
            as_points(bad, name="corner")
    with pytest.raises(ValueError, match=r"homography: expected shape \(3, 3\), got \(2, 2\)"):
        apply_homography(np.eye(2), [[0, 0]])


# --- cameras ---------------------------------------------------------------------------------------
def test_strong_distortion_round_trips_both_ways() -> None:
    cam, pixels = camera(), sensor()
    assert np.abs(cam.lens.distort(cam.lens.undistort(pixels)) - pixels).max() < 1e-4
    assert np.abs(cam.lens.undistort(pixels) - pixels).max() > 50  # or there was nothing to undo
    floor = cam.pixels_to_floor(pixels)
    below = (np.abs(floor) < 20).all(axis=1) & np.isfinite(cam.floor_to_pixels(floor)).all(axis=1)
    assert below.sum() > 300
    assert np.abs(cam.floor_to_pixels(floor[below]) - pixels[below]).max() < 1e-3


@settings(max_examples=60, deadline=None)
@given(st.floats(0.5, 4), st.floats(0, 2), st.floats(-0.6, 0.6))
def test_floor_round_trip(x: float, y: float, roll: float) -> None:
    cam = camera(roll=roll)
    pixels = cam.floor_to_pixels([[x, y]])
    if cam.inside(pixels)[0]:
        assert np.abs(cam.pixels_to_floor(pixels) - [[x, y]]).max() < 1e-5


def test_projection_agrees_with_opencv() -> None:
    cam = camera(roll=0.2)
    rotation, translation = cam.pose
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(0.5, 4, 200), rng.uniform(-0.5, 2, 200), rng.uniform(0, 1, 200)])
    reference = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], translation, cam.matrix, cam.distortion)[0]
    assert np.abs(cam.project(points) - reference[:, 0]).max() < 1e-6
    floor = points * [1, 1, 0]
    assert np.abs(cam.project(floor) - cam.floor_to_pixels(floor[:, :2])).max() < 1e-6


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.floats(-3, -1), st.floats(-2, 2), st.floats(0.5, 4)),
    st.tuples(st.floats(0, 3), st.floats(-2, 2)),
    st.floats(-3, 3),
    st.sampled_from([1.0, -1.0, 1e-4, -250.0]),
)
def test_pose_from_homography_is_the_given_pose(
    centre: tuple[float, float, float], target: tuple[float, float], roll: float, scale: float
) -> None:
    given_pose = looking_down(centre, target, roll)
    cam = camera(centre, target, roll)
    by_homography = Camera("cam", SIZE, cam.lens, scale * cam.image_to_floor)
    rotation, translation = by_homography.pose
    assert np.abs(rotation - given_pose).max() < 1e-6
    assert np.abs(translation + given_pose @ centre).max() < 1e-6
    assert np.abs(by_homography.centre_m - centre).max() < 1e-6
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_behind_the_camera_is_nan() -> None:
    cam = camera()
    assert np.isnan(cam.floor_to_pixels([[-30.0, 0.5]])).all()
    assert np.isnan(cam.project([[-30.0, 0.5, 0.0], [-1.0, 0.5, 2.5]])).all()
    assert np.isfinite(cam.project([[2.0, 1.0, 0.0]])).all()
    assert not cam.inside(cam.floor_to_pixels([[-30.0, 0.5]]))[0]


def test_beyond_the_fold_of_the_distortion_is_nan() -> None:
    # r (1 - r^2 / 3) rises until r = 1 and then comes back: what lies beyond would land in the picture again.
    cam = camera(distortion=np.array([-1 / 3, 0, 0, 0, 0]))
    rotation, translation = cam.pose
    radii = np.array([0.5, 0.99, 1.01, 1.6])
    points = (np.column_stack([radii, np.zeros(4), np.ones(4)]) - translation) @ rotation
    pixels = cam.project(points)
    assert np.isfinite(pixels[:2]).all()
    assert np.isnan(pixels[2:]).all()
    folded = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], translation, cam.matrix, cam.distortion)[0]
    assert cam.inside(folded[3])[0]  # OpenCV alone would show it
    on_floor = cam.centre_m + (points - cam.centre_m) * (-cam.centre_m[2] / (points - cam.centre_m)[:, 2:])
    ahead = (on_floor @ rotation.T + translation)[:, 2] > 0
    assert np.isfinite(cam.floor_to_pixels(on_floor[ahead & (radii < 1), :2])).all()
    assert np.isnan(cam.floor_to_pixels(on_floor[radii > 1, :2])).all()


def test_inside_has_its_edges_half_a_pixel_out() -> None:
    pixels = [[-0.5, -0.5], [639.49, 479.49], [639.5, 0], [0, 479.5], [-0.51, 0], [np.nan, np.nan]]
    assert camera().inside(pixels).tolist() == [True, True, False, False, False, False]


def test_no_points_give_no_points() -> None:
    cam = camera()
    for method in (cam.lens.undistort, cam.lens.distort, cam.floor_to_pixels, cam.pixels_to_floor):
        assert method([]).shape == (0, 2)
    assert cam.project([]).shape == (0, 2)
    assert Floor((0, 4), (1, 2), 0.5).points([]).shape == (0, 2)
    assert Floor((0, 4), (1, 2), 0.5).points(np.empty((0, 3, 2))).shape == (0, 3, 2)


def test_inputs_stay_as_they_were() -> None:
    cam = camera()
    pixels, floor, world = sensor(), np.array([[1.0, 1.0], [-30.0, 0.5]]), np.array([[1.0, 1.0, 0.5], [-30.0, 0, 0]])
    copies = pixels.copy(), floor.copy(), world.copy()
    cam.lens.undistort(pixels), cam.lens.distort(pixels), cam.pixels_to_floor(pixels)
    cam.floor_to_pixels(floor), cam.project(world)
    for array, copy in zip((pixels, floor, world), copies, strict=True):
        assert np.array_equal(array, copy)


@pytest.mark.parametrize("rotation", [np.eye(3) * 2, np.diag([1.0, 1.0, -1.0]), np.zeros((3, 3)), np.eye(2)])
def test_a_rotation_that_is_none(rotation: Array) -> None:
    with pytest.raises(ValueError, match="cam: rotation: expected an orthonormal 3x3 matrix"):
        Camera.from_pose("cam", SIZE, Lens(MATRIX, STRONG), rotation, [0, 0, 3])


def test_rays_through_pixels_meet_the_points_seen_there() -> None:
    cam = camera(roll=0.2)
    world = np.array([[1.0, 0.5, 0.3], [2.5, 1.5, 0.0], [0.8, 1.0, 1.2]])
    rays = cam.rays(cam.project(world))
    along = np.linalg.norm(world - cam.centre_m, axis=1) / np.linalg.norm(rays, axis=1)
    assert np.abs(cam.centre_m + along[:, None] * rays - world).max() < 1e-5
    assert rays @ cam.pose[0][2] == pytest.approx(1)  # 1 m along the optical axis


def test_rays_through_all_pixels_in_the_pictures_layout() -> None:
    cam = camera()
    centres, rays = cam.pixel_centres(), cam.rays()
    assert centres.shape == (480, 640, 2) and rays.shape == (480, 640, 3)
    assert centres[7, 31].tolist() == [31, 7]
    assert np.abs(rays[7, 31] - cam.rays([[31, 7]])[0]).max() < 1e-12
    assert cam.rays((31.0, 7.0)).shape == (3,) and cam.rays(np.empty((0, 2))).shape == (0, 3)


# --- the floor -------------------------------------------------------------------------------------
def test_floor_shape_extent_and_cells() -> None:
    floor = Floor((-1.0, 3.0), (0.5, 3.5), 0.05)
    assert floor.shape == (60, 80)
    assert floor.extent == pytest.approx((-1, 3, 0.5, 3.5))
    assert floor.cell_area == pytest.approx(0.0025)
    assert floor.cells([[-0.975, 0.525], [2.975, 0.525]]) == pytest.approx(np.array([[0, 0], [79, 0]]))
    centres = floor.cell_centres_m()
    assert centres.shape == (4800, 2)
    assert centres[0] == pytest.approx([-0.975, 0.525])
    assert centres[1] == pytest.approx([-0.925, 0.525])  # row-major: x runs first
    assert centres[-1] == pytest.approx([2.975, 3.475])
    assert np.abs(floor.cells(centres)[:, 0].reshape(60, 80) - np.arange(80)).max() < 1e-9


def test_cells_to_metres_and_back() -> None:
    floor = Floor((-1.0, 3.0), (0.5, 3.5), 0.05)
    assert floor.points((0, 0)) == pytest.approx([-0.975, 0.525])
    assert floor.points([]).shape == (0, 2)
    cells = np.random.default_rng(0).uniform(-5, 90, (4, 7, 2))
    points = floor.points(cells)
    assert points.shape == (4, 7, 2)
    assert np.abs(floor.cells(points.reshape(-1, 2)) - cells.reshape(-1, 2)).max() < 1e-9
    iy, ix = np.mgrid[:60, :80]
    centres = floor.points(np.stack([ix, iy], axis=-1)).reshape(-1, 2)
    assert np.abs(centres - floor.cell_centres_m()).max() < 1e-12
    with pytest.raises(ValueError, match=r"cells: expected shape \(..., 2\), got \(3,\)"):
        floor.points((1, 2, 3))


def test_floor_that_is_no_multiple_of_the_resolution() -> None:
    floor = Floor((0.0, 1.04), (0.0, 0.02), 0.1)
    assert floor.shape == (1, 10)
    assert floor.extent == pytest.approx((0, 1, 0, 0.1))


def test_polygon_mask_has_row_0_at_the_smallest_y() -> None:
    floor = Floor((0.0, 4.0), (0.0, 3.0), 0.5)
    mask = floor.polygon_mask(np.array([[1, 0], [3, 0], [3, 0.5], [1, 0.5]]))
    expected = np.zeros((6, 8), bool)
    expected[0, 2:6] = True
    assert mask.dtype == bool
    assert np.array_equal(mask, expected)
    assert not floor.polygon_mask([[10, 10], [11, 10], [11, 11]]).any()


def test_polygon_mask_covers_the_polygons_area() -> None:
    floor = Floor((0.0, 4.0), (0.0, 3.0), 0.02)
    triangle = floor.polygon_mask([[0.5, 0.5], [3.5, 0.5], [0.5, 2.5]])
    assert triangle.sum() * floor.cell_area == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize(
    ("x", "resolution", "message"),
    [
        ((1.0, 1.0), 0.1, r"floor.x: expected \[min, max\] with min < max, got \[1.0, 1.0\]"),
        ((0.0, np.nan), 0.1, "floor.x: expected"),
        ((0.0, np.inf), 0.1, "floor.x: expected"),
        ((0.0, 1.0), 0.0, "floor.resolution: expected metres per cell > 0, got 0.0"),
        ((0.0, 1.0), -1.0, "floor.resolution"),
        ((0.0, 1.0), np.nan, "floor.resolution"),
        ((0.0, 1.0), 1e-6, r"floor: 1e\+06 x 1e\+06 cells are too many; raise floor.resolution"),
        ((0.0, 1.0), 1e-320, "cells are too many"),
        ((-1e308, 1e308), 0.1, "cells are too many"),
    ],
)
def test_impossible_floors(x: tuple[float, float], resolution: float, message: str) -> None:
    with np.errstate(all="ignore"), pytest.raises(ValueError, match=message):
        Floor(x, (0.0, 1.0), resolution)


# --- the rig ---------------------------------------------------------------------------------------
def test_rig_yaml_round_trip(tiny_rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(tiny_rig.to_yaml(), encoding="utf-8")
    again = Rig.load(path)
    assert again.floor == tiny_rig.floor
    assert list(again.cameras) == ["left", "right"]
    for name, cam in tiny_rig.cameras.items():
        other = again[name]
        assert (other.name, other.size) == (name, cam.size)
        for field in ("matrix", "distortion", "image_to_floor"):
            assert np.array_equal(getattr(other, field), getattr(cam, field))
    assert again.to_yaml() == tiny_rig.to_yaml()


def test_pose_form_equals_homography_form(tiny_rig: Rig) -> None:
    content = tiny_rig.to_dict()
    for name, fields in content["cameras"].items():
        rotation, translation = tiny_rig[name].pose
        del fields["floor_homography"]
        fields |= {"rotation": rotation.tolist(), "translation": translation.tolist()}
    points = [[0.5, 0.5], [3.5, 2.5], [2.0, 1.5]]
    for name, cam in Rig.from_dict(content).cameras.items():
        assert np.abs(cam.floor_to_pixels(points) - tiny_rig[name].floor_to_pixels(points)).max() < 1e-6
        assert np.abs(cam.image_to_floor - tiny_rig[name].image_to_floor).max() < 1e-9


def test_distortion_and_units_have_defaults(tiny_rig: Rig) -> None:
    content = tiny_rig.to_dict()
    del content["units"], content["cameras"]["left"]["distortion"]
    assert Rig.from_dict(content)["left"].distortion.tolist() == [0] * 5


def test_select_keeps_the_order_asked_for(tiny_rig: Rig) -> None:
    assert list(tiny_rig.select(["right", "left"]).cameras) == ["right", "left"]
    assert tiny_rig.select(None) is tiny_rig
    with pytest.raises(ValueError, match="camera 'top' is not in the rig; it has left, right"):
        tiny_rig.select(["left", "top"])
    for bad in ([], ["left", "left"]):
        with pytest.raises(ValueError, match="cameras: expected one or more different names, got"):
            tiny_rig.select(bad)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "expected a mapping with 'units', 'floor' and 'cameras'"),
        (b"- 1\n- 2", "expected a mapping with"),
        (b"units: m\ncameras: {}", "expected a mapping with"),
        (b"units: m\ncameras: [left]", "expected a mapping with"),
        (b"floor: [1, 2", "not valid YAML"),
        (b"\xff\xfe\x00\x81", "not valid YAML"),
        (b"a: \x00", "not valid YAML"),
        (b"a: 2001-99-99", "not valid YAML"),
        (b"a: " + b"1" * 5000, "not valid YAML"),
        (b"[" * 20_000, "not valid YAML"),
        (b"a: !!python/object:os.system x", "not valid YAML"),
    ],
)
def test_a_file_that_is_no_rig(tmp_path: Path, text: bytes, message: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_bytes(text)
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: .*{message}") as caught:
        Rig.load(path)
    assert "\n" not in str(caught.value)


def test_unreadable_rig(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"rig.yaml: cannot read \(No such file"):
        Rig.load(tmp_path / "rig.yaml")
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file" / "rig.yaml"):
        with pytest.raises(ValueError, match="cannot read"):
            Rig.load(path)


def damage(*keys: str, to: Any = None) -> Callable[[dict[str, Any]], None]:
    """A function that sets a field (deletes it for ``None``)."""

    def change(content: dict[str, Any]) -> None:
        for key in keys[:-1]:
            content = content[key]
        if to is None:
            del content[keys[-1]]
        else:
            content[keys[-1]] = to

    return change


LEFT = ("cameras", "left")
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (damage("units", to="mm"), "units: expected 'm', got 'mm'"),
        (damage("floor"), "floor: expected a mapping"),
        (damage("floor", to="m"), "floor: expected a mapping"),
        (damage("floor", "x"), "floor.x: expected 2 finite numbers, got None"),
        (damage("floor", "y", to=[0, 1, 2]), "floor.y: expected 2 finite numbers"),
        (damage("floor", "y", to=[0, NAN]), "floor.y: expected 2 finite numbers"),
        (damage("floor", "resolution"), "floor.resolution: expected a finite number, got None"),
        (damage("floor", "resolution", to=[0.1]), "floor.resolution: expected a finite number"),
        (damage("floor", "resolution", to="fine"), "floor.resolution: expected a finite number, got 'fine'"),
        (damage(*LEFT, to="left"), "cameras.left: expected a mapping"),
        (damage(*LEFT, "size"), "cameras.left.size: expected 2 finite numbers, got None"),
        (damage(*LEFT, "size", to=[160.5, 120]), r"cameras.left.size: expected \[width, height\] in px, got \[160.5"),
        (damage(*LEFT, "size", to=[0, 120]), "cameras.left.size: expected .width, height. in px"),
        (damage(*LEFT, "size", to=[-160, 120]), "cameras.left.size"),
        (damage(*LEFT, "size", to=[1e300, 1e300]), "cameras.left.size: expected .width, height. in px"),
        (damage(*LEFT, "size", to=[10**400, 1]), "cameras.left.size: expected 2 finite numbers"),
        (damage(*LEFT, "size", to=["wide", 1]), "cameras.left.size: expected 2 finite numbers"),
        (damage(*LEFT, "matrix"), "cameras.left.matrix: expected 3x3 finite numbers, got None"),
        (damage(*LEFT, "matrix", to=[[1, 0], [0, 1]]), "cameras.left.matrix: expected 3x3 finite numbers"),
        (damage(*LEFT, "matrix", to=[[NAN, 0, 0], [0, 1, 0], [0, 0, 1]]), "cameras.left.matrix: expected 3x3 finite"),
        (damage(*LEFT, "matrix", to=[[-5, 0, 0], [0, 5, 0], [0, 0, 1]]), "cameras.left.matrix: expected .*fx, fy > 0"),
        (damage(*LEFT, "matrix", to=[[1e-300, 0, 0], [0, 1, 0], [0, 0, 1]]), "cameras.left.matrix: .*fx, fy > 0"),
        (damage(*LEFT, "matrix", to=[[100, 3, 80], [0, 100, 60], [0, 0, 1]]), "cameras.left.matrix: .*fx, 0, cx"),
        (damage(*LEFT, "matrix", to=[[100, 0, 80], [0, 100, 60], [0, 0, 2]]), "cameras.left.matrix: .*0, 0, 1"),
        (damage(*LEFT, "distortion", to=[0, 0, 0, 0]), "cameras.left.distortion: expected 5 finite numbers"),
        (damage(*LEFT, "distortion", to=[0, 0, 0, 0, INF]), "cameras.left.distortion: expected 5 finite numbers"),
        (damage(*LEFT, "floor_homography"), "cameras.left.rotation: expected 3x3 finite numbers, got None"),
        (damage(*LEFT, "floor_homography", to=[1, 2, 3]), "cameras.left.floor_homography: expected 3x3 finite numbers"),
        (
            damage(*LEFT, "floor_homography", to=[[1, 2, 3], [2, 4, 6], [0, 0, 1]]),
            "cameras.left.floor_homography: expected an invertible 3x3 homography",
        ),
        (damage(*LEFT, "floor_homography", to=(np.eye(3) * 1e200).tolist()), "cameras.left.floor_homography: .*invert"),
    ],
)
def test_each_wrong_field_is_named(
    tiny_rig: Rig, tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    content = tiny_rig.to_dict()
    change(content)
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: {message}") as caught:
        Rig.load(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < len(str(path)) + 250


@pytest.mark.parametrize(
    ("rotation", "translation", "message"),
    [
        (np.eye(3), [0, 0], "cameras.left.translation: expected 3 finite numbers"),
        (np.eye(3), [[0], [0], [3]], "cameras.left.translation"),
        (np.eye(3) * 1.1, [0, 0, 3], "left: rotation: expected an orthonormal"),
        (np.diag([1.0, 1.0, -1.0]), [0, 0, 3], "left: rotation: expected an orthonormal 3x3 matrix that is no mirror"),
        (np.eye(3), [0, 0, 0], "left: expected an invertible 3x3 homography"),
    ],
)
def test_each_wrong_pose_is_named(tiny_rig: Rig, rotation: Array, translation: Any, message: str) -> None:
    content = tiny_rig.to_dict()
    fields = content["cameras"]["left"]
    del fields["floor_homography"]
    fields |= {"rotation": rotation.tolist(), "translation": translation}
    with pytest.raises(ValueError, match=message):
        Rig.from_dict(content)


# --- the pose of a homography that was fitted to marks ---------------------------------------------------
def algebraic_pose(cam: Camera) -> tuple[Array, Array]:
    """The textbook's: the first two columns of ``K^-1 H`` scaled and made orthonormal."""
    columns = np.linalg.inv(cam.matrix) @ np.linalg.inv(cam.image_to_floor)
    columns /= np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
    third = np.cross(columns[:, 0], columns[:, 1])
    if -(third @ columns[:, 2]) < 0:
        columns = -columns
    u, _, vt = np.linalg.svd(np.column_stack([columns[:, 0], columns[:, 1], third]))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt, columns[:, 2]


def floor_disagreement_px(cam: Camera, pose: tuple[Array, Array]) -> Array:
    """How far apart the homography and a pose see the same floor points in the picture."""
    x, y = np.meshgrid(np.arange(-0.5, 4, 0.1), np.arange(-1, 3, 0.1))
    points = np.column_stack([x.ravel(), y.ravel()])
    pixels = cam.floor_to_pixels(points)
    points, pixels = points[cam.inside(pixels)], pixels[cam.inside(pixels)]
    world = np.column_stack([points, np.zeros(len(points))])
    turn = cv2.Rodrigues(pose[0])[0]
    seen = cv2.projectPoints(world, turn, pose[1], cam.matrix, cam.distortion)[0].reshape(-1, 2)
    return np.asarray(np.linalg.norm(seen - pixels, axis=1))


def marked_camera(seed: int, noise_px: float) -> tuple[Camera, Camera]:
    """A camera, and what a homography fitted to 12 marks measured with noise makes of it."""
    cam = camera(roll=0.05)
    rng = np.random.default_rng(seed)
    marks = np.array([[x, y] for x in (0.8, 1.5, 2.2, 3.0) for y in (0.2, 1.0, 1.8)])
    ideal = cam.lens.undistort(cam.floor_to_pixels(marks)) + rng.normal(0, noise_px, marks.shape)
    homography = cv2.findHomography(ideal, marks)[0]
    return cam, Camera("cam", SIZE, cam.lens, np.asarray(homography, float))


@pytest.mark.parametrize("noise_px", [0.3, 1.0, 3.0])
def test_the_refined_pose_sees_the_floor_more_as_the_homography_does_than_the_algebra(noise_px: float) -> None:
    refined, algebraic = [], []
    for seed in range(6):
        _, fitted = marked_camera(seed, noise_px)
        rotation, translation = fitted.pose
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-9 and np.linalg.det(rotation) > 0
        assert fitted.centre_m[2] > 0
        refined.append(np.sqrt(np.mean(floor_disagreement_px(fitted, (rotation, translation)) ** 2)))
        algebraic.append(np.sqrt(np.mean(floor_disagreement_px(fitted, algebraic_pose(fitted)) ** 2)))
    assert np.mean(refined) < 0.9 * np.mean(algebraic)
    assert (np.array(refined) < 1.05 * np.array(algebraic)).all()


@settings(max_examples=20, deadline=None)
@given(
    st.tuples(st.floats(-3, -1), st.floats(-2, 2), st.floats(0.5, 4)),
    st.tuples(st.floats(0, 3), st.floats(-2, 2)),
    st.floats(-1, 1),
)
def test_an_exact_homography_keeps_its_exact_pose(
    centre: tuple[float, float, float], target: tuple[float, float], roll: float
) -> None:
    cam = camera(centre, target, roll)
    rotation, translation = cam.pose
    by_algebra = algebraic_pose(cam)
    np.testing.assert_array_equal(rotation, by_algebra[0])  # not even touched
    np.testing.assert_array_equal(translation, by_algebra[1])


def test_pixels_beyond_the_fold_of_the_distortion_have_no_say_in_the_pose() -> None:
    strong = np.array([-0.55, 0.0, 0, 0, 0])  # folds back within the picture's corners
    cam = camera(distortion=strong)
    outer = sensor()[np.abs(cam.lens.distort(cam.lens.undistort(sensor())) - sensor()).max(axis=1) > 0.1]
    assert len(outer)
    assert np.abs(cam.centre_m - [-1.0, 0.5, 2.5]).max() < 1e-6


def test_ufes_lab_poses_see_the_floor_where_the_marks_are(shared_data: Callable[[str], Path]) -> None:
    rig = Rig.load(shared_data("ufes-lab") / "rig.yaml")
    for name, cam in rig.cameras.items():
        cells = rig.floor.cell_centres_m()
        pixels = cam.floor_to_pixels(cells)
        cells, pixels = cells[cam.inside(pixels)], pixels[cam.inside(pixels)]
        error = np.linalg.norm(cam.project(np.column_stack([cells, np.zeros(len(cells))])) - pixels, axis=1)
        assert len(error) > 40_000
        assert error.mean() < 1.5 and np.percentile(error, 99) < 3 and error.max() < 4, name
        assert 2.5 < cam.centre_m[2] < 3.2, name


@pytest.mark.parametrize("shape", [(0, 2), (3, 0, 2), (0, 17, 2)])
def test_no_cells_keep_their_shape_as_points(shape: tuple[int, ...]) -> None:
    assert Floor((0, 4), (0, 3), 0.5).points(np.empty(shape)).shape == shape
    assert Floor((0, 4), (0, 3), 0.5).points([]).shape == (0, 2)
