"""A picture at the sizes at which a frame is compared with its background."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import Image
from occlib.base.kernels import compiled

LARGEST = 1_000_000
"""Px up to which a picture is compared px by px; a larger one is halved first, which bounds the work."""

CLIPPED = 250
"""Levels from here on say only "at least so bright"."""

Float32Array = npt.NDArray[np.float32]


class Picture(NamedTuple):
    """A frame, or a background, ready to be compared; see :func:`picture_of`.

    Parameters
    ----------
    image
        uint8 (H, W, 3), at most ``LARGEST`` px.
    half
        Each the mean of 2 x 2 px, uint8 (H / 2, W / 2, 3).
    grey
        The mean of the channels of ``half``, float32 (H / 2, W / 2).
    clipped
        Where two of these channels or all are clipped, bool: there is no texture to be seen.
    """

    image: Image
    half: Image
    grey: Float32Array
    clipped: npt.NDArray[np.bool_]


def picture_of(image: Image) -> Picture:
    """The picture of a uint8 RGB image."""
    image = reduced(image)
    small = halved(image)
    grey, clipped = np.empty(small.shape[:2], np.float32), np.empty(small.shape[:2], np.bool_)
    _grey(small, grey, clipped)
    return Picture(image, small, grey, clipped)


def reduced(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The picture, halved until it has no more than ``LARGEST`` px."""
    while image.shape[0] * image.shape[1] > LARGEST:
        image = halved(image)
    return image


def halved(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The mean of each 2 x 2 px; a last odd row or column is left out."""
    height, width = (max(1, side // 2) for side in image.shape[:2])
    return np.asarray(cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))


@compiled
def _grey(image: Any, grey: Any, clipped: Any) -> None:
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            r, g, b = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            grey[y, x] = (np.float32(r) + np.float32(g) + np.float32(b)) / np.float32(3)
            clipped[y, x] = max(min(r, g), min(max(r, g), b)) >= CLIPPED
