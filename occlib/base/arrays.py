"""Array types, and points as rows of an array."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
"""A silhouette (H, W), or cells of the floor (ny, nx)."""
Image = npt.NDArray[Any]
"""A picture (H, W) or (H, W, 3), or the like on the floor, (ny, nx); mostly uint8, colours RGB."""


def as_points(points: npt.ArrayLike, *, dimensions: int = 2, name: str = "points") -> FloatArray:
    """Points as a float64 array of shape (N, dimensions); a single point becomes (1, dimensions).

    Raises ``ValueError`` if the last axis has another length.
    """
    array = np.asarray(points, dtype=np.float64)
    if array.size == 0:
        return np.empty((0, dimensions))
    if array.ndim == 0 or array.shape[-1] != dimensions:
        raise ValueError(f"{name}: expected shape (N, {dimensions}), got {array.shape}")
    return array.reshape(-1, dimensions)
