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

import numpy as np
import numpy.typing as npt
import yaml
from msgspec.structs import asdict
from scipy.ndimage import distance_transform_edt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Mask, as_points
from occlib.formats.rig import CameraEntry, RigFile, load_rig, rig_file
from occlib.lens import Lens, Pose


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
        checks.number("floor.resolution", self.resolution, above=0, unit="metres per cell")
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

    def points(self, cells: npt.ArrayLike) -> FloatArray:
        """Metres (..., 2) of cells ``(ix, iy)``, (..., 2), whole or fractional; cell centres are at integers.

        >>> Floor((0, 4), (1, 2), 0.5).points((3, 0))
        array([1.75, 1.25])
        """
        ixy = np.asarray(cells, dtype=np.float64)
        if ixy.shape == (0,):  # an empty list
            return np.empty((0, 2))
        if ixy.shape[-1:] != (2,):
            raise ValueError(f"cells: expected shape (..., 2), got {ixy.shape}")
        return np.array([self.x[0], self.y[0]]) + (ixy + 0.5) * self.resolution

    def cells(self, points_m: npt.ArrayLike) -> FloatArray:
        """Fractional cell ``(ix, iy)`` of points in m; cell centres are at integers. Shape (N, 2)."""
        return apply_homography(np.linalg.inv(self.cell_to_floor), points_m)

    def contains(self, point_m: tuple[float, float]) -> bool:
        """Whether a point (x, y) in m lies on the floor.

        >>> Floor((0, 4), (1, 2), 0.5).contains((4.1, 1.5))
        False
        """
        return all(low <= at <= high for at, (low, high) in zip(point_m, (self.x, self.y), strict=True))

    def distance_m(self, mask: Mask) -> FloatArray:
        """Distance in m from every cell's centre to the centre of the nearest cell of a mask (ny, nx); 0 inside.

        Exact and Euclidean; infinite everywhere if the mask is empty.

        >>> Floor((0, 4), (0, 1), 1.0).distance_m(np.array([[True, False, False, False]]))
        array([[0., 1., 2., 3.]])
        """
        if not checks.mask("mask", mask, self.shape).any():
            return np.full(self.shape, np.inf)
        return np.asarray(distance_transform_edt(~mask) * self.resolution, dtype=np.float64)

    def near(self, mask: Mask, radius_m: float) -> Mask:
        """Cells whose centre is closer than ``radius_m`` to the centre of a cell of a mask (ny, nx), and the mask itself.

        A cell that is exactly ``radius_m`` away, to a millionth of a cell, is not near. To keep clear of the *whole* of a
        cell and not only of its centre, add half its diagonal, ``0.71 * resolution``.
        """
        checks.number("radius_m", radius_m, least=0, unit="metres")
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
    lens
        The intrinsic matrix, and the distortion.
    image_to_floor
        3x3, undistorted px to floor metres.
    """

    name: str
    size: tuple[int, int]
    lens: Lens
    image_to_floor: FloatArray

    @classmethod
    def from_pose(
        cls, name: str, size: tuple[int, int], lens: Lens, rotation: npt.ArrayLike, translation: npt.ArrayLike
    ) -> Camera:
        """A camera from its pose (world to camera, m): ``H = (K [r1 r2 t])^-1``."""
        r, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)
        if r.shape != (3, 3) or not np.allclose(r @ r.T, np.eye(3), atol=1e-4) or np.linalg.det(r) < 0:
            raise ValueError(f"{name}: rotation: expected an orthonormal 3x3 matrix that is no mirror")
        floor_to_image = lens.matrix @ np.column_stack([r[:, 0], r[:, 1], t.reshape(3)])
        return cls(name, size, lens, invert_homography(floor_to_image, name))

    @property
    def matrix(self) -> FloatArray:
        """The lens's 3x3 intrinsic matrix in px."""
        return self.lens.matrix

    @property
    def distortion(self) -> FloatArray:
        """The lens's distortion coefficients."""
        return self.lens.distortion

    @cached_property
    def pose(self) -> Pose:
        """Rotation (3, 3) and translation (3,) in m, world to camera, with the camera above the floor."""
        columns = np.linalg.inv(self.matrix) @ np.linalg.inv(self.image_to_floor)
        columns /= np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
        r3 = np.cross(columns[:, 0], columns[:, 1])
        if -(r3 @ columns[:, 2]) < 0:  # z of the centre; r3 does not change with the sign of the columns
            columns = -columns
        u, _, vt = np.linalg.svd(np.column_stack([columns[:, 0], columns[:, 1], r3]))
        return self._refined_pose(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt, columns[:, 2])

    def _refined_pose(self, rotation: FloatArray, translation: FloatArray) -> Pose:
        """The pose that agrees best with the homography on the floor in the picture.

        A homography fitted to marks is no exact pose: what is left over is spread over the picture (Levenberg-Marquardt)
        rather than left to the algebra.
        """
        u, v = np.meshgrid(np.linspace(0, self.size[0] - 1, 12), np.linspace(0, self.size[1] - 1, 12))
        pixels = np.column_stack([u.ravel(), v.ravel()])
        straight = self.lens.undistort(pixels)
        invertible = np.abs(self.lens.distort(straight) - pixels).max(axis=1) < 0.1  # not beyond the distortion's fold
        invertible &= self.lens.valid(straight)
        pixels, straight = pixels[invertible], straight[invertible]
        floor = apply_homography(self.image_to_floor, straight)
        depth = floor @ rotation[2, :2] + translation[2]
        centre = -rotation.T @ translation
        with np.errstate(invalid="ignore"):
            seen = (depth > 1e-9) & (np.hypot(*(floor - centre[:2]).T) < 10 * centre[2])
        if seen.sum() < 12:
            return rotation, translation
        points = np.column_stack([floor[seen], np.zeros(int(seen.sum()))])
        expected = self.lens.distort(self.lens.pinhole(points @ rotation.T + translation))
        if np.abs(expected - pixels[seen]).max() < 0.01:  # from a pose, not from marks
            return rotation, translation
        return self.lens.refine_pose(points, pixels[seen], rotation, translation)

    @cached_property
    def centre_m(self) -> FloatArray:
        """Position of the optical centre in m, shape (3,)."""
        rotation, translation = self.pose
        return -rotation.T @ translation

    def project(self, points_m: npt.ArrayLike) -> FloatArray:
        """World points (N, 3) in m to raw px (N, 2).

        NaN behind the camera and where the distortion model folds back (far outside the image).
        """
        rotation, translation = self.pose
        return self.lens.project(as_points(points_m, dimensions=3, name="points_m") @ rotation.T + translation)

    def floor_to_pixels(self, points_m: npt.ArrayLike) -> FloatArray:
        """Floor points (N, 2) in m to raw px (N, 2); NaN where the camera cannot see them at all."""
        points = as_points(points_m, name="points_m")
        rotation, translation = self.pose
        depth = points @ rotation[2, :2] + translation[2]
        straight = apply_homography(np.linalg.inv(self.image_to_floor), points)
        straight[(depth <= 1e-9) | ~self.lens.valid(straight)] = np.nan
        return self.lens.distort(straight)

    def pixels_to_floor(self, points_px: npt.ArrayLike) -> FloatArray:
        """Raw px (N, 2) to floor m (N, 2), as if every pixel showed the floor."""
        return apply_homography(self.image_to_floor, self.lens.undistort(points_px))

    def pixel_centres(self) -> FloatArray:
        """Raw px ``(x, y)`` of every pixel's centre, (H, W, 2)."""
        width, height = self.size
        v, u = np.mgrid[:height, :width]
        return np.stack([u, v], axis=-1).astype(np.float64)

    def rays(self, points_px: npt.ArrayLike | None = None) -> FloatArray:
        """World directions through raw px (..., 2), or through every pixel's centre (H, W, 2), as (..., 3).

        They start at :attr:`centre_m` and are not normalised: each reaches 1 m along the optical axis.
        """
        points = self.pixel_centres() if points_px is None else np.asarray(points_px, dtype=np.float64)
        directions = self.lens.directions(points) @ self.pose[0]
        return directions.reshape(*points.shape[:-1], 3)

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
                    **camera.lens.to_dict(),
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
    lens = Lens.from_dict(asdict(entry), f"cameras.{name}.")
    if entry.floor_homography is not None:
        homography = np.array(entry.floor_homography)
        invert_homography(homography, f"cameras.{name}.floor_homography")
        return Camera(name, size, lens, homography)
    assert entry.rotation is not None and entry.translation is not None  # CameraEntry has one or the other
    return Camera.from_pose(name, size, lens, entry.rotation, entry.translation)


def look_at(position: Iterable[float], target: Iterable[float]) -> FloatArray:
    """World-to-camera rotation of a level camera (x right, y down, z forwards)."""
    forward = np.subtract(list(target), list(position))
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(forward, right), forward])
