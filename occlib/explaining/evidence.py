"""Polar views: what each camera says about foreground, by azimuth and angle of depression about its station.

A vertical line of the world, whatever its distance, is a vertical line of the polar view; what stands upright covers in
each column one run of rows. Such runs are known as stixels (Badino et al. 2009, doi:10.1007/978-3-642-03798-6_6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.kernels import compiled
from occlib.geometry import Camera, Floor
from occlib.registration import ImageWarp

REFERENCE_STEP_RAD = 0.0045
"""Angle between two px of a VGA camera with a field of view of 70 degrees: a sample of this step weighs 1."""

LEAST_STEP_RAD = 0.0035
"""Least angle between two samples: 1.4 cm at 4 m. Finer pictures are not sampled finer, so that their size costs nothing."""

ABOVE_HORIZON_RAD = 0.5
"""How far above the horizon a polar view reaches at most, in rad: nothing on the floor that could matter is higher."""

GRID = (65, 49)
"""Columns and rows of a grid of px whose rays tell which angles a picture spans; its rim would do but for the lens."""


class PolarView(NamedTuple):
    """Where a polar view's samples lie: its camera's station and its angles; a row of :attr:`PolarEvidence.views`.

    Parameters
    ----------
    x, y, height
        The camera's station, in m.
    middle
        Azimuth of the middle of the floor from there, in rad.
    left
        Azimuth of column 0 relative to ``middle``, in rad.
    top
        Angle of depression of row 0, in rad; negative above the horizon.
    step
        Angle between neighbouring columns, and rows, in rad.
    weight
        Of a sample: its solid angle over that of a sample of :data:`REFERENCE_STEP_RAD`.
    """

    x: float
    y: float
    height: float
    middle: float
    left: float
    top: float
    step: float
    weight: float


@compiled
def view_at(views: Any, k: int) -> Any:
    """Row ``k`` of an array of views, float64 (K, 8), as a :class:`PolarView`."""
    return PolarView(
        views[k, 0], views[k, 1], views[k, 2], views[k, 3], views[k, 4], views[k, 5], views[k, 6], views[k, 7]
    )


@dataclass(frozen=True)
class PolarEvidence:
    """The polar views of one instant.

    Parameters
    ----------
    views
        float64 (K, 8), each row a :class:`PolarView`, see :attr:`PolarWarp.parameters`.
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
        if self.views.shape != (shape[0], len(PolarView._fields)) or not np.isfinite(self.views).all():
            expected = (shape[0], len(PolarView._fields))
            raise ValueError(f"views: expected {expected} finite numbers, got {self.views.shape}")
        if self.sizes.shape != (shape[0], 2) or not ((self.sizes >= 0) & (self.sizes <= shape[:0:-1])).all():
            raise ValueError(
                f"sizes: expected {shape[0]} times columns, rows up to {shape[:0:-1]}, got {self.sizes.tolist()}"
            )

    @classmethod
    def of(cls, views: Sequence[tuple[PolarView, Image, Mask]]) -> PolarEvidence:
        """Views of different size side by side: each its parameters, and its weights and samples seen, (rows, columns)."""
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
class PolarWarp(ImageWarp):
    """Takes a camera's images to its polar view: a column is an azimuth about the camera, a row an angle of depression.

    Parameters
    ----------
    camera, floor
        From the rig.
    step_px
        Angle between two samples, in px of the camera at the middle of its picture; at least :data:`LEAST_STEP_RAD`.
    """

    camera: Camera
    floor: Floor
    step_px: float = 3.0

    @cached_property
    def step(self) -> float:
        """Angle between neighbouring columns, and rows, in rad."""
        return max(self.step_px / self._focal_px, LEAST_STEP_RAD)

    @property
    def spacing_px(self) -> float:
        """Distance between neighbouring samples in px, in the middle of the picture."""
        return self.step * self._focal_px

    @cached_property
    def _focal_px(self) -> float:
        return float(np.sqrt(self.camera.matrix[0, 0] * self.camera.matrix[1, 1]))

    @cached_property
    def _ranges(self) -> tuple[float, float, float, float, float]:
        """Azimuth of the floor's middle; azimuths relative to it and depressions that the picture spans, in rad."""
        width, height = self.camera.size
        u, v = np.meshgrid(np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1]))
        rays = self.camera.rays(np.column_stack([u.ravel(), v.ravel()]))
        to_middle = np.array([np.mean(self.floor.x), np.mean(self.floor.y)]) - self.camera.centre_m[:2]
        middle = float(np.arctan2(to_middle[1], to_middle[0]))
        azimuth = (np.arctan2(rays[:, 1], rays[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
        depression = np.arctan2(-rays[:, 2], np.hypot(rays[:, 0], rays[:, 1]))
        return middle, azimuth.min(), azimuth.max(), max(depression.min(), -ABOVE_HORIZON_RAD), depression.max()

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        _, left, right, top, bottom = self._ranges
        return int(np.ceil((bottom - top) / self.step)) + 1, int(np.ceil((right - left) / self.step)) + 1

    @cached_property
    def parameters(self) -> PolarView:
        """The view's station and angles."""
        middle, left, _, top, _ = self._ranges
        weight = (self.step / REFERENCE_STEP_RAD) ** 2
        return PolarView(*map(float, [*self.camera.centre_m, middle, left, top, self.step, weight]))

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
