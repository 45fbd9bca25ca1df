"""Grey levels, and the adjustment of a picture's intensity to that of the background (section 2)."""

from __future__ import annotations

import cv2
import numpy as np

from occlib.base.arrays import Image


def _checked(image: Image, name: str = "image") -> Image:
    array = np.asarray(image)
    if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise ValueError(f"{name}: expected uint8 RGB (H, W, 3), got {array.dtype} {array.shape}")
    return array


def to_grey(image: Image) -> Image:
    """Grey levels of an RGB image, uint8 (H, W): 0.299 R + 0.587 G + 0.114 B."""
    return np.asarray(cv2.cvtColor(_checked(image), cv2.COLOR_RGB2GRAY))


def intensity_gain_offset(image: Image, background: Image, *, step: int = 16) -> tuple[float, float]:
    """Gain and offset that bring a frame to the background's intensity: ``background = gain * image + offset``.

    Least squares over every ``step``-th pixel, refitted twice to the half that fits best, so that objects (less
    than half of the picture) do not count. A picture without contrast gives a pure gain or offset.

    Returns
    -------
    gain, offset
        The gain is held between 0.5 and 2, the offset in grey levels.
    """
    if image.shape != background.shape:
        raise ValueError(f"image: expected the background's shape {background.shape}, got {image.shape}")
    step = min(step, *image.shape[:2])  # at least one px of a tiny picture
    x = image[step // 2 :: step, step // 2 :: step].ravel().astype(np.float32)
    y = background[step // 2 :: step, step // 2 :: step].ravel().astype(np.float32)
    half = (x.size - 1) // 2
    residual = np.abs(y - x - np.partition(y - x, half)[half])
    gain, offset = 1.0, 0.0
    for _ in range(3):
        keep = residual <= np.partition(residual, half)[half]
        xk, yk = x[keep], y[keep]
        mean_x, mean_y = float(xk.mean()), float(yk.mean())
        xk -= mean_x
        variance = float(xk @ xk) / len(xk)
        gain = float(xk @ (yk - mean_y)) / len(xk) / variance if variance > 25.0 else 1.0
        gain = min(max(gain, 0.5), 2.0)
        offset = mean_y - gain * mean_x
        residual = np.abs(y - gain * x - offset)
    return gain, offset


def adjust_intensity(image: Image, background: Image) -> Image:
    """The frame with the background's intensity (section 2), uint8, clipped to 0-255."""
    gain, offset = intensity_gain_offset(image, background)
    # addWeighted rather than convertScaleAbs: the latter would fold negative values back to positive ones
    return np.asarray(cv2.addWeighted(image, gain, image, 0.0, offset))


def channel_gain_offset(image: Image, background: Image, channel: int) -> tuple[float, float]:
    """:func:`intensity_gain_offset` of one channel: follows auto-exposure and a white balance that drifts."""
    return intensity_gain_offset(image[..., channel], background[..., channel])
