"""Other light than the background was taken in: what is done to the frames, or to the pictures of the empty floor.

Pictures are changed after the camera, in grey levels, and clipped, as an exposure or a lamp would: gain, half a room
brighter, and backgrounds of another day.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import Image
from occlib.geometry import Camera

TINT = (1.15, 1.0, 0.85)
"""Factors of red, green and blue in the light of another day."""

PATCH_M = ((-0.5, 0.7), (-0.4, 0.5))
"""x and y in m of a patch of floor on which something's shadow lay when the background was taken."""

PATCH_EDGE_M = 0.1
"""Over this width the edge of the patch is soft."""

SHIFT_PX = 6
"""A camera that was knocked since the background was taken has moved by so much."""


@dataclass(frozen=True)
class Light:
    """One change of light.

    Parameters
    ----------
    name
        How it is called.
    about
        A line for the table.
    moment
        Whether it changes the ``"frames"`` or the pictures of the ``"background"``.
    change
        ``change(image, camera) -> image``, uint8 RGB (H, W, 3). None: the first frame, with all that stands there,
        is the background.
    """

    name: str
    about: str
    moment: Literal["frames", "background"]
    change: Callable[[Image, Camera], Image] | None


def scaled(image: Image, factor: npt.ArrayLike) -> Image:
    """A picture times a factor, rounded and clipped: a number, one for each channel, or (H, W) or (H, W, 3).

    >>> scaled(np.full((1, 1, 3), 200, np.uint8), [0.5, 1.0, 2.0]).tolist()
    [[[100, 200, 255]]]
    """
    by = np.asarray(factor, np.float32)
    by = by[..., None] if by.ndim == 2 else by
    return np.clip(np.rint(image.astype(np.float32) * by), 0, 255).astype(np.uint8)


def across(image: Image, left: float, right: float, soft: float) -> npt.NDArray[np.float64]:
    """A factor (H, W): ``left`` in the left half, ``right`` in the right one, linear over the share ``soft`` of the width between.

    >>> across(np.zeros((1, 5, 3), np.uint8), 1.0, 2.0, 1.0)
    array([[1.  , 1.25, 1.5 , 1.75, 2.  ]])
    """
    height, width = image.shape[:2]
    place = (np.arange(width) / max(width - 1, 1) - 0.5) / max(soft, 1e-9) + 0.5
    return np.tile(left + (right - left) * np.clip(place, 0, 1), (height, 1))


def _gain(factor: float) -> Callable[[Image, Camera], Image]:
    return lambda image, camera: scaled(image, factor)


def _lamp(soft: float) -> Callable[[Image, Camera], Image]:
    return lambda image, camera: scaled(image, across(image, 1.0, 1.6, soft))


def _tinted(image: Image, camera: Camera) -> Image:
    return scaled(image, TINT)


def _sloped(image: Image, camera: Camera) -> Image:
    return scaled(image, across(image, 0.8, 1.2, 1.0))


def _another_day(image: Image, camera: Camera) -> Image:
    factor: Any = 0.8 * across(image, 0.8, 1.2, 1.0)[..., None] * np.array(TINT)
    return scaled(image, factor)


def _shaded_patch(image: Image, camera: Camera) -> Image:
    """0.6 as bright on the patch of floor; worked out in every fourth pixel."""
    height, width = image.shape[:2]
    v, u = np.mgrid[0:height:4, 0:width:4]
    places = np.nan_to_num(camera.pixels_to_floor(np.column_stack([u.ravel(), v.ravel()])), nan=1e9)
    outside = np.zeros(len(places))
    for place, (low, high) in zip(places.T, PATCH_M, strict=True):
        outside = np.maximum.reduce([outside, low - place, place - high])
    factor = (0.6 + 0.4 * np.clip(outside / PATCH_EDGE_M, 0, 1)).reshape(u.shape).astype(np.float32)
    return scaled(image, cv2.resize(factor, (width, height), interpolation=cv2.INTER_LINEAR))


def _shifted(image: Image, camera: Camera) -> Image:
    return np.pad(image, ((0, 0), (SHIFT_PX, 0), (0, 0)), mode="edge")[:, :-SHIFT_PX]


LIGHTS = {
    light.name: light
    for light in (
        Light("gain 0.5", "the frames half as bright", "frames", _gain(0.5)),
        Light("gain 0.7", "the frames darker", "frames", _gain(0.7)),
        Light("gain 1.4", "the frames brighter, clipped", "frames", _gain(1.4)),
        Light("gain 1.6", "the frames brighter, clipped", "frames", _gain(1.6)),
        Light("lamp, soft edge", "right half of each frame x 1.6, soft over 0.3 of the width", "frames", _lamp(0.3)),
        Light("lamp, hard edge", "right half of each frame x 1.6", "frames", _lamp(0.0)),
        Light("background 0.8", "background x 0.8", "background", _gain(0.8)),
        Light("background tint", "background: red x 1.15, blue x 0.85", "background", _tinted),
        Light("background slope", "background x 0.8 at the left to x 1.2 at the right", "background", _sloped),
        Light("another day", "the last three together", "background", _another_day),
        Light("shaded patch", "background x 0.6 on 1.2 x 0.9 m of the floor", "background", _shaded_patch),
        Light("shifted", "background moved by 6 px", "background", _shifted),
        Light("robots left", "a frame with the robots is the background", "background", None),
    )
}
"""The changes of light by name."""
