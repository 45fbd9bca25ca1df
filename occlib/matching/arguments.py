"""Checks of what :mod:`occlib.matching.search` is given: image, template and mask, made ready for a measure."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import Image
from occlib.matching.sums import Array


def _picture(values: npt.ArrayLike, name: str) -> Image:
    """A checked (H, W, channels) array."""
    array = np.asarray(values)
    if array.dtype.kind not in "uif":
        raise ValueError(f"{name}: expected integer or float values, got dtype {array.dtype}")
    if array.ndim != 2 and not (array.ndim == 3 and array.shape[2] in (1, 3)):
        raise ValueError(f"{name}: expected shape (rows, columns) or (rows, columns, 3), got {array.shape}")
    if array.size == 0:
        raise ValueError(f"{name}: expected at least one pixel, got shape {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite values, got NaN or infinity")
    if array.dtype.kind == "f" and float(np.abs(array).max()) > 1e100:
        raise ValueError(f"{name}: expected magnitudes up to 1e100, whose squares can be summed; got more")
    return array.reshape(*array.shape[:2], -1)


def checked(image: npt.ArrayLike, template: npt.ArrayLike, mask: npt.ArrayLike | None) -> tuple[Image, Image, Array]:
    """Image (H, W, C) and template (h, w, C) of one type, uint8, uint16 or float64, and the mask (h, w)."""
    f, t = _picture(image, "image"), _picture(template, "template")
    if f.shape[2] != t.shape[2]:
        raise ValueError(f"template: expected {f.shape[2]} channel(s) like the image, got {t.shape[2]}")
    if t.shape[0] > f.shape[0] or t.shape[1] > f.shape[1]:
        raise ValueError(f"template: expected no larger than the image {f.shape[:2]}, got {t.shape[:2]}")
    kind: type[Any] = np.float64
    if f.dtype == t.dtype == np.uint8:
        kind = np.uint8
    elif all(a.dtype.kind in "ui" and a.min() >= 0 and a.max() <= 65535 for a in (f, t)):
        kind = np.uint16
    return f.astype(kind, copy=False), t.astype(kind, copy=False), checked_mask(mask, t.shape[:2])


def checked_mask(mask: npt.ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Bool where the weights say no more than yes and no, else float64 up to 1."""
    weights = np.ones(shape, bool) if mask is None else np.asarray(mask)
    if weights.dtype.kind not in "buif" or weights.shape != shape:
        raise ValueError(f"mask: expected bool or weights {shape}, got {weights.dtype} {weights.shape}")
    if not np.isfinite(weights).all() or weights.min() < 0:
        raise ValueError("mask: expected finite weights >= 0, got negative ones, NaN or infinity")
    if not weights.any():
        raise ValueError("mask: expected at least one pixel that counts, got none")
    largest = weights.max()
    if ((weights == 0) | (weights == largest)).all():
        return weights > 0
    return weights.astype(np.float64) / float(largest)
