"""DOC"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.kernels import compiled
from occlib.geometry import Camera, Floor
from occlib.registration import _Warp


@dataclass(frozen=True)
class PolarEvidence:
    """The polar views of one instant.

    Parameters
    ----------
    views
        float64 (K, 8), from :attr:`occlib.explaining.evidence.PolarWarp.parameters`.
    sizes
        int64 (K, 2), columns and rows of each view.
    weights
        int32 (K, rows, columns), -255 surely background to 255 surely foreground; 0 says nothing.
    seen
        Bool (K, rows, columns), samples that the camera sees.
    """

    views: FloatArray
    sizes: npt.NDArray[np.int64]
    weights: npt.NDArray[np.int32]
    seen: Mask

    def __post_init__(self) -> None:
        shape = self.weights.shape  # the compiled loops look up without checking
        if self.weights.ndim != 3 or self.weights.dtype != np.int32:
            raise ValueError(f"weights: expected int32 (K, rows, columns), got {self.weights.dtype} {shape}")
        if self.seen.shape != shape or self.seen.dtype != np.bool_:
            raise ValueError(f"seen: expected bool {shape}, got {self.seen.dtype} {self.seen.shape}")
        if self.views.shape != (shape[0], 8) or not np.isfinite(self.views).all():
            raise ValueError(f"views: expected {(shape[0], 8)} finite numbers, got {self.views.shape}")
        if self.sizes.shape != (shape[0], 2) or not ((self.sizes >= 0) & (self.sizes <= shape[:0:-1])).all():
            raise ValueError(
                f"sizes: expected {shape[0]} times columns, rows up to {shape[:0:-1]}, got {self.sizes.tolist()}"
            )

    @classmethod
    def of(cls, views: Sequence[tuple[FloatArray, Image, Mask]]) -> PolarEvidence:
        """Views of different size side by side: for each its parameters, weights and samples seen, (rows, columns) each."""
        sizes = np.array([seen.shape[::-1] for _, _, seen in views], np.int64)
        columns, rows = sizes.max(axis=0)
        weights, seen = np.zeros((len(views), rows, columns), np.int32), np.zeros((len(views), rows, columns), bool)
        for k, (_, own, samples) in enumerate(views):
            window = np.s_[k, : samples.shape[0], : samples.shape[1]]
            weights[window], seen[window] = own, samples
        return cls(np.array([parameters for parameters, _, _ in views]), sizes, weights, seen)

    @cached_property
    def sums(self) -> npt.NDArray[np.int32]:
        """Running sums of the weights down the columns, int32 (K, rows + 1, columns)."""
        return running_sums(self.weights)

    @cached_property
    def seen_sums(self) -> npt.NDArray[np.int32]:
        """Running sums of the samples seen down the columns, int32 (K, rows + 1, columns)."""
        return running_sums(self.seen)


def running_sums(values: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    """Sums of what lies above each row, int32 (K, rows + 1, columns)."""
    sums = np.zeros((values.shape[0], values.shape[1] + 1, values.shape[2]), np.int32)
    _accumulate(values, sums)
    return sums


@compiled
def _accumulate(values: Any, sums: Any) -> None:
    for k in range(values.shape[0]):
        for row in range(values.shape[1]):
            for column in range(values.shape[2]):
                sums[k, row + 1, column] = sums[k, row, column] + values[k, row, column]


@dataclass(frozen=True)
class PolarWarp(_Warp):
    """Takes a camera's images to its polar view: a column is an azimuth about the camera, a row an angle of depression.

    A vertical line of the world, whatever its distance, is a vertical line of the polar view: an upright object covers in
    each column one run of rows, from the near edge of its base (below) to the far edge of its top. Such runs are known as
    stixels (Badino et al. 2009, doi:10.1007/978-3-642-03798-6_6).

    Parameters
    ----------
    camera, floor
        From the rig.
    step_px
        Angle between two samples, in px of the camera at the middle of its picture.
    """

    camera: Camera
    floor: Floor
    step_px: float = 3.0

    @cached_property
    def step(self) -> float:
        """Angle between neighbouring columns, and rows, in rad."""
        return self.step_px / float(np.sqrt(self.camera.matrix[0, 0] * self.camera.matrix[1, 1]))

    @cached_property
    def _ranges(self) -> tuple[float, float, float, float, float]:
        """Azimuth of the floor's middle; azimuths relative to it and depressions that the picture spans, in rad."""
        width, height = self.camera.size
        u, v = np.meshgrid(np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 49))
        ideal = self.camera.undistort_points(np.column_stack([u.ravel(), v.ravel()]))
        ideal = (ideal - self.camera.matrix[:2, 2]) / self.camera.matrix[[0, 1], [0, 1]]
        rays = np.column_stack([ideal, np.ones(len(ideal))]) @ self.camera.pose[0]
        to_middle = np.array([np.mean(self.floor.x), np.mean(self.floor.y)]) - self.camera.centre_m[:2]
        middle = float(np.arctan2(to_middle[1], to_middle[0]))
        azimuth = (np.arctan2(rays[:, 1], rays[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
        depression = np.arctan2(-rays[:, 2], np.hypot(rays[:, 0], rays[:, 1]))
        return middle, azimuth.min(), azimuth.max(), max(depression.min(), -0.5), depression.max()

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        _, left, right, top, bottom = self._ranges
        return int(np.ceil((bottom - top) / self.step)) + 1, int(np.ceil((right - left) / self.step)) + 1

    @cached_property
    def parameters(self) -> FloatArray:
        """Station x, y and height in m, azimuth of the middle, of column 0 relative to it, depression of row 0, step in rad,
        and the weight of a sample: its solid angle over that of a px of a VGA camera of 70 degrees, squared steps of 4.5 mrad.
        """
        middle, left, _, top, _ = self._ranges
        return np.array([*self.camera.centre_m, middle, left, top, self.step, (self.step / 0.0045) ** 2])

    @cached_property
    def pixels(self) -> FloatArray:
        """Raw px of every sample, (rows, columns, 2); NaN where the camera does not see it."""
        middle, left, _, top, _ = self._ranges
        rows, columns = self.shape
        azimuth, depression = np.meshgrid(
            middle + left + np.arange(columns) * self.step, top + np.arange(rows) * self.step
        )
        flat = np.cos(depression)
        rays = np.stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, -np.sin(depression)], axis=-1)
        pixels = self.camera.project(self.camera.centre_m + rays.reshape(-1, 3))
        pixels[~self.camera.inside(pixels)] = np.nan
        return pixels.reshape(rows, columns, 2)
