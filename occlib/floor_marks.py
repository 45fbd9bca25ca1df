"""Where a camera sees the floor, from marks on it whose place is known (section 2 of the paper, Fig 2).

Marks are measured on the floor in m and in the picture in px. From four or more comes the homography that takes
undistorted px to metres, from a board that lies on the floor also the camera's pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from occlib.base.arrays import FloatArray, as_points
from occlib.base.files import read_yaml
from occlib.geometry import Camera, apply_homography, invert_homography
from occlib.lens import HasLens, Pose


@dataclass(frozen=True)
class FloorFit:
    """A homography fitted to marks on the floor, and its residuals mark by mark.

    Parameters
    ----------
    image_to_floor
        3x3, undistorted px to m.
    error_px
        Distance of each mark from its reprojection, undistorted px, shape (N,).
    error_m
        The same on the floor in m, shape (N,).
    leave_one_out_m
        Error in m at each mark when the others alone are fitted: what to expect at a new point. Shape
        (N,), or ``None`` with four marks, or when a mark is needed to fix the homography.
    """

    image_to_floor: FloatArray
    error_px: FloatArray
    error_m: FloatArray
    leave_one_out_m: FloatArray | None


def floor_homography_from_marks(camera: HasLens, pixels: npt.ArrayLike, floor_m: npt.ArrayLike) -> FloorFit:
    """The homography to the floor from marks whose floor coordinates are known.

    Parameters
    ----------
    camera
        A camera, or the calibration of one.
    pixels
        Marks (N, 2) in raw px, four or more, no three of four on a line.
    floor_m
        The same marks (N, 2) on the floor in m.

    Returns
    -------
    FloorFit
        The homography with the least squared distance in undistorted px, where marking errors arise, and
        its residuals.

    Notes
    -----
    Normalised DLT (Hartley & Zisserman 2004, section 4.4), then Gauss-Newton, all in float64
    (`cv2.findHomography` rounds its points to float32).
    """
    floor, raw = as_points(floor_m, name="floor_m"), as_points(pixels, name="pixels")
    if len(raw) != len(floor) or len(raw) < 4 or not (np.isfinite(raw).all() and np.isfinite(floor).all()):
        raise ValueError(f"pixels, floor_m: expected 4 or more finite pairs, got {len(raw)} and {len(floor)}")
    ideal = camera.lens.undistort(raw)
    floor_to_image = _fit_homography(floor, ideal)
    image_to_floor = invert_homography(floor_to_image, "floor_m")
    return FloorFit(
        image_to_floor,
        np.linalg.norm(apply_homography(floor_to_image, floor) - ideal, axis=1),
        np.linalg.norm(apply_homography(image_to_floor, ideal) - floor, axis=1),
        _leave_one_out(ideal, floor),
    )


def solve_floor_pose(camera: HasLens, pixels: npt.ArrayLike, floor_m: npt.ArrayLike) -> Pose:
    """Pose of the camera from points on the floor, such as a board that lies there.

    Parameters
    ----------
    camera
        A camera, or the calibration of one.
    pixels
        Points (N, 2) in raw px, four or more.
    floor_m
        The same points (N, 2) on the floor in m.

    Returns
    -------
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        World to camera, m.

    Raises
    ------
    ValueError
        No pose fits, or the camera would be under the floor: the points come in mirrored order.
    """
    floor, seen = as_points(floor_m, name="floor_m"), as_points(pixels, name="pixels")
    if len(seen) != len(floor) or len(seen) < 4:
        raise ValueError(f"pixels, floor_m: expected 4 or more pairs, got {len(seen)} and {len(floor)}")
    points = np.column_stack([floor, np.zeros(len(floor))])
    try:
        rotation, translation = camera.lens.solve_pose(points, seen)
    except ValueError as error:
        raise ValueError(f"pixels, floor_m: {error}") from None
    height = -(rotation.T @ translation)[2]
    if not height > 0:
        raise ValueError(f"floor_m: the camera would be {-height:.2f} m under the floor; the points are mirrored")
    return rotation, translation


def floor_homography_from_pose(camera: HasLens, rotation: npt.ArrayLike, translation: npt.ArrayLike) -> FloatArray:
    """The homography (3, 3), undistorted px to m, of a pose (world to camera, m): ``(K [r1 r2 t])^-1``."""
    size = (1, 1)  # has no part in it
    return Camera.from_pose("pose", size, camera.lens, rotation, translation).image_to_floor


def load_marks(path: str | Path) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Read hand-marked floor points: for each camera raw px (N, 2) and floor m (N, 2).

    The file is YAML, ``marks: {camera: [{pixel: [u, v], floor: [x, y]}, ...]}``.
    """
    content = read_yaml(path)
    cameras = content.get("marks") if isinstance(content, dict) else None
    if not isinstance(cameras, dict):
        raise ValueError(f"{path}: expected a mapping 'marks' of cameras")
    marks = {}
    for name, entries in cameras.items():
        try:
            pair = [as_points([entry[key] for entry in entries], name=key) for key in ("pixel", "floor")]
        except (KeyError, TypeError, ValueError):
            pair = [np.full((1, 2), np.nan)]
        if not all(np.isfinite(points).all() for points in pair):
            raise ValueError(f"{path}: marks.{name}: expected a list of {{pixel: [u, v], floor: [x, y]}}")
        marks[str(name)] = (pair[0], pair[1])
    return marks


def _fit_homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """The 3x3 homography with the least squared distance in the target plane; (N, 2) each, N >= 4."""
    to_source, to_target = _normalising(source), _normalising(target)
    a, b = apply_homography(to_source, source), apply_homography(to_target, target)
    ones, zeros = np.ones((len(a), 1)), np.zeros((len(a), 3))
    xyw = np.hstack([a, ones])
    system = np.vstack([np.hstack([xyw, zeros, -b[:, :1] * xyw]), np.hstack([zeros, xyw, -b[:, 1:] * xyw])])
    _, values, vectors = np.linalg.svd(system)
    if values[7] < 1e-6 * values[0]:
        raise ValueError("floor_m: the marks do not fix a homography (too many on one line)")
    start = vectors[8] / np.linalg.norm(vectors[8])

    def residuals(h: FloatArray) -> FloatArray:
        projected = xyw @ h.reshape(3, 3).T
        return (projected[:, :2] / projected[:, 2:] - b).ravel()

    # The scale of h is free: the trust-region step leaves it alone.
    best = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x.reshape(3, 3)
    homography = np.linalg.inv(to_target) @ best @ to_source
    return np.asarray(homography / np.linalg.norm(homography))


def _normalising(points: FloatArray) -> FloatArray:
    """Similarity that moves points to mean 0 and mean distance sqrt(2)."""
    mean = points.mean(axis=0)
    scale = np.sqrt(2) / max(np.linalg.norm(points - mean, axis=1).mean(), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def _leave_one_out(ideal: FloatArray, floor: FloatArray) -> FloatArray | None:
    if len(floor) < 5:
        return None
    errors = []
    for i in range(len(floor)):
        others = np.arange(len(floor)) != i
        try:
            fit = invert_homography(_fit_homography(floor[others], ideal[others]))
        except ValueError:
            return None
        errors.append(np.linalg.norm(apply_homography(fit, ideal[i]) - floor[i]))
    return np.array(errors)
