"""Cameras, the floor and the rig: projection, homographies and units.

Conventions, stated once and kept everywhere
--------------------------------------------
* Image arrays are ``(row, col)``; points are ``(x, y) = (col, row)`` in px, pixel centres at
  integers (OpenCV). Images in memory and in files are RGB.
* Floor coordinates ``(x, y)`` are metres, ``z`` points up. A map array is indexed ``[iy, ix]`` with
  row 0 at the *smallest* ``y`` (ROS order).
* ``image_to_floor`` maps *undistorted* pixels to floor metres: ``floor = H @ (u, v, 1)``.
* A pose is world to camera: ``x_camera = rotation @ x_world + translation``.
* Masks are ``bool``. Inputs are never changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml
from scipy.ndimage import distance_transform_edt

from occlib.base.arrays import FloatArray, Mask, as_points
from occlib.formats.rig import CameraEntry, RigFile, load_rig, rig_file


def apply_homography(homography: npt.ArrayLike, points: npt.ArrayLike) -> FloatArray:
    """Map points (N, 2) through a 3x3 homography; a point at infinity gives NaN.

    >>> apply_homography([[2, 0, 1], [0, 2, 0], [0, 0, 1]], [[1, 1]])
    array([[3., 2.]])
    """
    matrix = np.asarray(homography, dtype=np.float64)
    if matrix.shape != (3, 3):
        raise ValueError(f"homography: expected shape (3, 3), got {matrix.shape}")
    xyw = np.column_stack([as_points(points), np.ones(len(as_points(points)))]) @ matrix.T
    w = np.where(np.abs(xyw[:, 2:]) < 1e-12, np.nan, xyw[:, 2:])
    return xyw[:, :2] / w


@dataclass(frozen=True)
class Floor:
    """The mapped rectangle of floor: ``x`` and ``y`` are (min, max) in m, ``resolution`` m per cell."""

    x: tuple[float, float]
    y: tuple[float, float]
    resolution: float

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            low, high = getattr(self, name)
            if not (np.isfinite([low, high]).all() and low < high):
                raise ValueError(f"floor.{name}: expected [min, max] with min < max, got [{low}, {high}]")
        if not (np.isfinite(self.resolution) and self.resolution > 0):
            raise ValueError(f"floor.resolution: expected metres per cell > 0, got {self.resolution}")
        cells = [(high - low) / self.resolution for low, high in (self.x, self.y)]
        if not (max(cells) <= 32_766 and cells[0] * cells[1] <= 20_000_000):  # OpenCV's limit; 150 bytes a cell
            raise ValueError(f"floor: {cells[0]:.6g} x {cells[1]:.6g} cells are too many; raise floor.resolution")

    @property
    def shape(self) -> tuple[int, int]:
        """Map shape ``(ny, nx)``."""
        return (
            max(1, round((self.y[1] - self.y[0]) / self.resolution)),
            max(1, round((self.x[1] - self.x[0]) / self.resolution)),
        )

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """``(left, right, bottom, top)`` in m, for ``imshow(..., origin="lower")``."""
        ny, nx = self.shape
        return (self.x[0], self.x[0] + nx * self.resolution, self.y[0], self.y[0] + ny * self.resolution)

    @property
    def cell_area(self) -> float:
        """Area of a cell in m2."""
        return self.resolution**2

    @property
    def cell_to_floor(self) -> FloatArray:
        """3x3 matrix from cell ``(ix, iy)`` to the metres of its centre."""
        r = self.resolution
        return np.array([[r, 0, self.x[0] + r / 2], [0, r, self.y[0] + r / 2], [0, 0, 1]])

    def cell_centres_m(self) -> FloatArray:
        """Metres of every cell's centre, shape (ny * nx, 2), row-major."""
        ny, nx = self.shape
        iy, ix = np.mgrid[:ny, :nx]
        return apply_homography(self.cell_to_floor, np.column_stack([ix.ravel(), iy.ravel()]))

    def cells(self, points_m: npt.ArrayLike) -> FloatArray:
        """Fractional cell ``(ix, iy)`` of points in m; cell centres are at integers. Shape (N, 2)."""
        return apply_homography(np.linalg.inv(self.cell_to_floor), points_m)

    def distance_m(self, mask: Mask) -> FloatArray:
        """Distance in m from every cell's centre to the centre of the nearest cell of a mask (ny, nx); 0 inside.

        Exact and Euclidean; infinite everywhere if the mask is empty.

        >>> Floor((0, 4), (0, 1), 1.0).distance_m(np.array([[True, False, False, False]]))
        array([[0., 1., 2., 3.]])
        """
        if mask.shape != self.shape or mask.dtype != bool:
            raise ValueError(f"mask: expected bool {self.shape}, got {mask.dtype} {mask.shape}")
        if not mask.any():
            return np.full(self.shape, np.inf)
        return np.asarray(distance_transform_edt(~mask) * self.resolution, dtype=np.float64)

    def near(self, mask: Mask, radius_m: float) -> Mask:
        """Cells whose centre is closer than ``radius_m`` to the centre of a cell of a mask (ny, nx), and the mask itself.

        A cell that is exactly ``radius_m`` away, to a millionth of a cell, is not near. To keep clear of the *whole* of a
        cell and not only of its centre, add half its diagonal, ``0.71 * resolution``.
        """
        if not (np.isfinite(radius_m) and radius_m >= 0):
            raise ValueError(f"radius_m: expected metres >= 0, got {radius_m}")
        return np.asarray((self.distance_m(mask) < radius_m - 1e-6 * self.resolution) | mask)

    def polygon_mask(self, polygon_m: npt.ArrayLike) -> Mask:
        """Cells whose centre lies in a polygon (M, 2) given in m."""
        from skimage.draw import polygon2mask

        cells = self.cells(as_points(polygon_m, name="polygon_m"))
        return np.asarray(polygon2mask(self.shape, cells[:, ::-1]), dtype=bool)


@dataclass(frozen=True)
class Camera:
    """A calibrated camera that sees the floor.

    Parameters
    ----------
    name
        Its name in the rig.
    size
        ``(width, height)`` in px.
    matrix
        3x3 intrinsic matrix in px.
    distortion
        ``(k1, k2, p1, p2, k3)`` of the Brown-Conrady model (OpenCV).
    image_to_floor
        3x3, undistorted px to floor metres.
    """

    name: str
    size: tuple[int, int]
    matrix: FloatArray
    distortion: FloatArray
    image_to_floor: FloatArray

    @classmethod
    def from_pose(
        cls,
        name: str,
        size: tuple[int, int],
        matrix: npt.ArrayLike,
        distortion: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
    ) -> Camera:
        """A camera from its pose (world to camera, m): ``H = (K [r1 r2 t])^-1``."""
        k, r, t = (np.asarray(a, dtype=np.float64) for a in (matrix, rotation, translation))
        if r.shape != (3, 3) or not np.allclose(r @ r.T, np.eye(3), atol=1e-4) or np.linalg.det(r) < 0:
            raise ValueError(f"{name}: rotation: expected an orthonormal 3x3 matrix that is no mirror")
        floor_to_image = k @ np.column_stack([r[:, 0], r[:, 1], t.reshape(3)])
        return cls(name, size, k, np.asarray(distortion, float), invert_homography(floor_to_image, name))

    @cached_property
    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Rotation (3, 3) and translation (3,) in m, world to camera, with the camera above the floor."""
        columns = np.linalg.inv(self.matrix) @ np.linalg.inv(self.image_to_floor)
        columns /= np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
        r3 = np.cross(columns[:, 0], columns[:, 1])
        if -(r3 @ columns[:, 2]) < 0:  # z of the centre; r3 does not change with the sign of the columns
            columns = -columns
        u, _, vt = np.linalg.svd(np.column_stack([columns[:, 0], columns[:, 1], r3]))
        return self._refined_pose(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt, columns[:, 2])

    def _refined_pose(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The pose that agrees best with the homography on the floor in the picture.

        A homography fitted to marks is no exact pose: what is left over is spread over the picture (Levenberg-Marquardt)
        rather than left to the algebra.
        """
        u, v = np.meshgrid(np.linspace(0, self.size[0] - 1, 12), np.linspace(0, self.size[1] - 1, 12))
        pixels = np.column_stack([u.ravel(), v.ravel()])
        straight = self.undistort_points(pixels)
        radius = np.hypot(*((straight - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]).T)
        valid = (np.abs(self.distort_points(straight) - pixels).max(axis=1) < 0.1) & (radius**2 < self._valid_radius2)
        pixels, straight = pixels[valid], straight[valid]  # beyond the fold of the distortion nothing can be inverted
        floor = apply_homography(self.image_to_floor, straight)
        depth = floor @ rotation[2, :2] + translation[2]
        centre = -rotation.T @ translation
        with np.errstate(invalid="ignore"):
            seen = (depth > 1e-9) & (np.hypot(*(floor - centre[:2]).T) < 10 * centre[2])
        if seen.sum() < 12:
            return rotation, translation
        points = np.column_stack([floor[seen], np.zeros(int(seen.sum()))])
        ideal = points @ rotation.T + translation
        ideal = ideal[:, :2] / ideal[:, 2:] * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]
        if np.abs(self.distort_points(ideal) - pixels[seen]).max() < 0.01:  # from a pose, not from marks
            return rotation, translation
        turn, shift = cv2.solvePnPRefineLM(
            points,
            pixels[seen],
            self.matrix,
            self.distortion,
            cv2.Rodrigues(rotation)[0],
            translation.reshape(3, 1).copy(),
        )
        return np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(shift, float).reshape(3)

    @cached_property
    def centre_m(self) -> FloatArray:
        """Position of the optical centre in m, shape (3,)."""
        rotation, translation = self.pose
        return -rotation.T @ translation

    def undistort_points(self, points_px: npt.ArrayLike) -> FloatArray:
        """Raw px (N, 2) to undistorted px (N, 2)."""
        points = as_points(points_px, name="points_px")
        if not len(points):
            return points
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
        source = points.reshape(-1, 1, 2)
        if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
            ideal = cv2.undistortPointsIter(source, self.matrix, self.distortion, None, self.matrix, criteria)
        else:
            ideal = cv2.undistortPoints(source, self.matrix, self.distortion, P=self.matrix, criteria=criteria)
        return np.asarray(ideal, dtype=np.float64).reshape(-1, 2)

    def distort_points(self, points_px: npt.ArrayLike) -> FloatArray:
        """Undistorted px (N, 2) to raw px (N, 2): the Brown-Conrady model."""
        points = as_points(points_px, name="points_px")
        x, y = ((points - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]).T
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.column_stack([xd, yd]) * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]

    @cached_property
    def _valid_radius2(self) -> float:
        """Largest squared normalised radius before the distortion model folds back on itself."""
        k1, k2, _, _, k3 = self.distortion
        slope = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # d(r * radial)/dr = 0, in r^2
        real = slope[(np.abs(slope.imag) < 1e-9) & (slope.real > 0)].real
        return float(real.min()) if len(real) else np.inf

    def project(self, points_m: npt.ArrayLike) -> FloatArray:
        """World points (N, 3) in m to raw px (N, 2).

        NaN behind the camera and where the distortion model folds back (far outside the image).
        """
        rotation, translation = self.pose
        xyz = as_points(points_m, dimensions=3, name="points_m") @ rotation.T + translation
        depth = np.where(xyz[:, 2] > 1e-9, xyz[:, 2], np.nan)
        ideal = xyz[:, :2] / depth[:, None]
        ideal[(ideal**2).sum(axis=1) >= self._valid_radius2] = np.nan
        return self.distort_points(ideal * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2])

    def floor_to_pixels(self, points_m: npt.ArrayLike) -> FloatArray:
        """Floor points (N, 2) in m to raw px (N, 2); NaN where the camera cannot see them at all."""
        points = as_points(points_m, name="points_m")
        rotation, translation = self.pose
        depth = points @ rotation[2, :2] + translation[2]
        undistorted = apply_homography(np.linalg.inv(self.image_to_floor), points)
        ideal = (undistorted - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]
        undistorted[(depth <= 1e-9) | ((ideal**2).sum(axis=1) >= self._valid_radius2)] = np.nan
        return self.distort_points(undistorted)

    def pixels_to_floor(self, points_px: npt.ArrayLike) -> FloatArray:
        """Raw px (N, 2) to floor m (N, 2), as if every pixel showed the floor."""
        return apply_homography(self.image_to_floor, self.undistort_points(points_px))

    def inside(self, points_px: npt.ArrayLike) -> Mask:
        """Which raw px (N, 2) lie on the sensor."""
        x, y = as_points(points_px, name="points_px").T
        with np.errstate(invalid="ignore"):
            return (x >= -0.5) & (y >= -0.5) & (x < self.size[0] - 0.5) & (y < self.size[1] - 0.5)


def invert_homography(homography: npt.ArrayLike, name: str = "homography") -> FloatArray:
    """The inverse, scaled to ``H[2, 2] = 1`` where possible; ``ValueError`` if it is singular."""
    matrix = np.asarray(homography, dtype=np.float64)
    largest = np.abs(matrix).max(initial=0.0)  # a homography has no scale of its own; absurd ones only overflow
    if matrix.shape != (3, 3) or not 1e-50 < largest < 1e50 or abs(np.linalg.det(matrix / largest)) < 1e-12:
        raise ValueError(f"{name}: expected an invertible 3x3 homography")
    inverse = np.linalg.inv(matrix)
    return np.asarray(inverse / inverse[2, 2] if abs(inverse[2, 2]) > 1e-12 else inverse)


@dataclass(frozen=True)
class Rig:
    """The floor and the cameras that watch it, as ``rig.yaml`` stores them."""

    floor: Floor
    cameras: dict[str, Camera]

    def __getitem__(self, name: str) -> Camera:
        try:
            return self.cameras[name]
        except KeyError:
            raise ValueError(f"camera {name!r} is not in the rig; it has {', '.join(self.cameras)}") from None

    def select(self, names: Sequence[str] | None) -> Rig:
        """The rig with only the named cameras, in that order; all of them for ``None``."""
        if names is None:
            return self
        if not names or len(set(names)) != len(names):
            raise ValueError(f"cameras: expected one or more different names, got {list(names)}")
        return Rig(self.floor, {name: self[name] for name in names})

    @classmethod
    def load(cls, path: str | Path) -> Rig:
        """Read ``rig.yaml``; ``ValueError`` with the file's name and the field that is wrong."""
        content = load_rig(path)
        try:
            return cls.of(content)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    @classmethod
    def from_dict(cls, content: Any) -> Rig:
        """Build from the mapping that ``rig.yaml`` holds (see the contract in the README)."""
        return cls.of(rig_file(content))

    @classmethod
    def of(cls, content: RigFile) -> Rig:
        """Build from the checked content of ``rig.yaml``."""
        floor = Floor(content.floor.x, content.floor.y, content.floor.resolution)
        return cls(floor, {name: _camera(name, entry) for name, entry in content.cameras.items()})

    def to_dict(self) -> dict[str, Any]:
        """The mapping that :meth:`from_dict` reads."""
        return {
            "units": "m",
            "floor": {"x": list(self.floor.x), "y": list(self.floor.y), "resolution": self.floor.resolution},
            "cameras": {
                name: {
                    "size": list(camera.size),
                    "matrix": camera.matrix.tolist(),
                    "distortion": camera.distortion.tolist(),
                    "floor_homography": camera.image_to_floor.tolist(),
                }
                for name, camera in self.cameras.items()
            },
        }

    def to_yaml(self) -> str:
        """The text of ``rig.yaml``."""
        return yaml.safe_dump(self.to_dict(), sort_keys=False, default_flow_style=None)


def _camera(name: str, entry: CameraEntry) -> Camera:
    size = (int(entry.size[0]), int(entry.size[1]))
    matrix, distortion = np.array(entry.matrix), np.array(entry.distortion)
    if entry.floor_homography is not None:
        homography = np.array(entry.floor_homography)
        invert_homography(homography, f"cameras.{name}.floor_homography")
        return Camera(name, size, matrix, distortion, homography)
    assert entry.rotation is not None and entry.translation is not None  # CameraEntry has one or the other
    return Camera.from_pose(name, size, matrix, distortion, entry.rotation, entry.translation)


def look_at(position: Iterable[float], target: Iterable[float]) -> FloatArray:
    """World-to-camera rotation of a level camera (x right, y down, z forwards)."""
    forward = np.subtract(list(target), list(position))
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(forward, right), forward])


def pixel_rays(camera: Camera, offset: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """World directions (H, W, 3) through every pixel's centre plus ``offset`` px; not normalised."""
    width, height = camera.size
    v, u = np.mgrid[:height, :width]
    points = np.column_stack([u.ravel() + offset[0], v.ravel() + offset[1]])
    ideal = (camera.undistort_points(points) - camera.matrix[:2, 2]) / camera.matrix[[0, 1], [0, 1]]
    world = np.column_stack([ideal, np.ones(len(ideal))]) @ camera.pose[0]
    return np.asarray(world.reshape(height, width, 3))
