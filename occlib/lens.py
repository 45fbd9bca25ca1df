"""The lens: how a straight picture is bent on its way to the sensor, and how to bend it back.

Nothing else in the library knows the lens model. Points are px, ``(x, y) = (col, row)``. *Raw* px are those of the
picture; *undistorted* px are those that a pinhole camera with the same matrix would have seen.

The model is Brown and Conrady's, as in OpenCV. For a second one (a fisheye, say) derive a class from :class:`Lens`,
overwrite the methods that differ, and let :meth:`Lens.from_dict` choose between the two by a field of ``rig.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, Mask, as_points

Pose = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and translation (3,): ``x_camera = rotation @ x_world + translation``."""

_NEAREST_DEPTH = 1e-9
"""Points no further in front of the camera than this have no picture; in the unit of the points, m."""

_UNDISTORT_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
"""The inverse of the distortion is found step by step: at most 50 steps, or until a step is smaller than 1e-10."""

_POSE_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-6)
"""The refinement of a pose: at most 100 steps, or until a step is smaller than 1e-6 (rad and m)."""


@dataclass(frozen=True)
class Lens:
    """A pinhole camera's matrix and the Brown-Conrady distortion of its lens.

    Parameters
    ----------
    matrix
        3x3 intrinsic matrix in px, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``.
    distortion
        ``(k1, k2, p1, p2, k3)``, without unit; zeros for a lens that keeps straight lines straight.

    Examples
    --------
    >>> lens = Lens([[100, 0, 50], [0, 100, 40], [0, 0, 1]], [-0.2, 0, 0, 0, 0])
    >>> lens.distort([[150, 40]])  # one focal length off the axis: 1 - 0.2 of the way
    array([[130.,  40.]])
    >>> lens.undistort([[130, 40]]).round(3)
    array([[150.,  40.]])
    """

    matrix: FloatArray
    distortion: FloatArray

    def __post_init__(self) -> None:
        for name in ("matrix", "distortion"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))

    # --- points ---------------------------------------------------------------------------------------
    def distort(self, points_px: npt.ArrayLike) -> FloatArray:
        """Undistorted px (N, 2) to raw px (N, 2)."""
        x, y = self._normalised(points_px).T
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return self._pixels(np.column_stack([xd, yd]))

    def undistort(self, points_px: npt.ArrayLike) -> FloatArray:
        """Raw px (N, 2) to undistorted px (N, 2)."""
        points = as_points(points_px, name="points_px")
        if not len(points):
            return points
        source = points.reshape(-1, 1, 2)
        if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
            straight = cv2.undistortPointsIter(
                source, self.matrix, self.distortion, None, self.matrix, _UNDISTORT_STEPS
            )
        else:
            straight = cv2.undistortPoints(
                source, self.matrix, self.distortion, P=self.matrix, criteria=_UNDISTORT_STEPS
            )
        return np.asarray(straight, dtype=np.float64).reshape(-1, 2)

    def valid(self, points_px: npt.ArrayLike) -> Mask:
        """Which undistorted px (N, 2) the model holds for, bool (N,).

        Far outside the picture the distortion turns back on itself: beyond the fold, :meth:`distort` returns to px where
        the picture shows something else.
        """
        return np.asarray((self._normalised(points_px) ** 2).sum(axis=1) < self._fold_radius2)

    @cached_property
    def _fold_radius2(self) -> float:
        """Squared distance from the axis at which the radial distortion turns back, in focal lengths; infinite if never."""
        k1, k2, _, _, k3 = self.distortion
        slope = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # d(r * radial)/dr = 0, in r^2
        real = slope[(np.abs(slope.imag) < 1e-9) & (slope.real > 0)].real
        return float(real.min()) if len(real) else np.inf

    def directions(self, points_px: npt.ArrayLike) -> FloatArray:
        """Directions (N, 3) in which raw px (N, 2) look: x right, y down, z = 1 along the axis."""
        ideal = self._normalised(self.undistort(points_px))
        return np.column_stack([ideal, np.ones(len(ideal))])

    def pinhole(self, points: npt.ArrayLike) -> FloatArray:
        """Undistorted px (N, 2) of points (N, 3) in the camera's axes; NaN behind the camera."""
        xyz = as_points(points, dimensions=3)
        depth = np.where(xyz[:, 2] > _NEAREST_DEPTH, xyz[:, 2], np.nan)
        return self._pixels(xyz[:, :2] / depth[:, None])

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Raw px (N, 2) of points (N, 3) in the camera's axes; NaN behind the camera and where :meth:`valid` is false."""
        straight = self.pinhole(points)
        straight[~self.valid(straight)] = np.nan
        return self.distort(straight)

    def _normalised(self, points_px: npt.ArrayLike) -> FloatArray:
        """Undistorted px (N, 2) to focal lengths off the axis, (x / z, y / z)."""
        return (as_points(points_px, name="points_px") - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]

    def _pixels(self, normalised: FloatArray) -> FloatArray:
        return normalised * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]

    # --- pictures -------------------------------------------------------------------------------------
    def undistort_image(self, image: Image) -> Image:
        """The picture (H, W[, 3]) that a pinhole camera with the same matrix would have taken; bilinear, 0 outside."""
        return np.asarray(cv2.undistort(image, self.matrix, self.distortion))

    # --- poses ----------------------------------------------------------------------------------------
    def solve_pose(self, points: FloatArray, pixels: FloatArray) -> Pose:
        """The pose from which points (N, 3) of the plane ``z = 0`` are seen at raw px (N, 2), N >= 4.

        IPPE (Collins & Bartoli 2014, doi:10.1007/s11263-014-0725-5), then Levenberg-Marquardt on the reprojection
        error. ``ValueError`` if no pose fits.
        """
        try:
            arguments = (points, pixels.reshape(-1, 1, 2), self.matrix, self.distortion)
            _, turn, shift = cv2.solvePnP(*arguments, flags=cv2.SOLVEPNP_IPPE)
            turn, shift = cv2.solvePnPRefineLM(*arguments, turn, shift, _POSE_STEPS)
        except cv2.error:
            raise ValueError("no pose of the camera fits these points") from None
        return _pose(turn, shift)

    def refine_pose(
        self, points: FloatArray, pixels: FloatArray, rotation: FloatArray, translation: FloatArray
    ) -> Pose:
        """The pose near a given one with the least reprojection error of points (N, 3) seen at raw px (N, 2)."""
        turn, shift = cv2.Rodrigues(rotation)[0], translation.reshape(3, 1).copy()
        return _pose(*cv2.solvePnPRefineLM(points, pixels, self.matrix, self.distortion, turn, shift))

    # --- calibration ----------------------------------------------------------------------------------
    @classmethod
    def calibrate(
        cls, board: FloatArray, views: Sequence[FloatArray], size: tuple[int, int]
    ) -> tuple[Lens, list[Pose], float, FloatArray]:
        """The lens that explains views of a flat board best (Zhang 2000, doi:10.1109/34.888718).

        Parameters
        ----------
        board
            Points (N, 3) in the board's axes.
        views
            For each view the raw px (N, 2) of these points.
        size
            ``(width, height)`` of the pictures in px.

        Returns
        -------
        lens
        poses
            Board to camera, one for each view.
        rms_px
            Root mean square reprojection error.
        view_rms_px
            The same for each view, (V,).
        """
        objects = [board.astype(np.float32)] * len(views)
        pixels = [view.astype(np.float32).reshape(-1, 1, 2) for view in views]
        try:
            solution = cv2.calibrateCameraExtended(objects, pixels, size, None, None)  # type: ignore[call-overload]
        except cv2.error as error:
            raise ValueError(f"OpenCV cannot calibrate from these views ({error.err})") from None
        rms, matrix, distortion, turns, shifts, _, _, view_rms = solution
        poses = [_pose(turn, shift) for turn, shift in zip(turns, shifts, strict=True)]
        return cls(matrix, np.ravel(distortion)[:5]), poses, float(rms), np.asarray(view_rms, np.float64).ravel()

    # --- files ----------------------------------------------------------------------------------------
    @classmethod
    def from_dict(cls, fields: Mapping[str, Any], where: str = "") -> Lens:
        """The lens that ``matrix`` and ``distortion`` of ``rig.yaml`` describe; without ``distortion`` there is none.

        ``where`` is put before the name of a wrong field: ``cameras.left.``
        """
        matrix = checks.numbers(f"{where}matrix", fields.get("matrix"), (3, 3))
        zeros, bottom = (matrix[0, 1], matrix[1, 0]), matrix[2].tolist()
        if matrix[[0, 1], [0, 1]].min() < 1e-3 or np.abs(matrix).max() > 1e9 or any(zeros) or bottom != [0, 0, 1]:
            raise ValueError(
                f"{where}matrix: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in px with fx, fy > 0, got {matrix.tolist()}"
            )
        return cls(matrix, checks.numbers(f"{where}distortion", fields.get("distortion", [0.0] * 5), (5,)))

    def to_dict(self) -> dict[str, Any]:
        """The fields that :meth:`from_dict` reads."""
        return {"matrix": self.matrix.tolist(), "distortion": self.distortion.tolist()}


class HasLens(Protocol):
    """A camera, a calibration: whatever has a lens."""

    @property
    def lens(self) -> Lens:
        """The lens."""


def _pose(turn: npt.ArrayLike, shift: npt.ArrayLike) -> Pose:
    rotation = cv2.Rodrigues(np.asarray(turn, np.float64))[0]
    return np.asarray(rotation, np.float64), np.asarray(shift, np.float64).ravel()
