"""What is computed of a background once, for all frames that are compared with it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import Image
from occlib.foreground.alignment import edge_points, shift_between
from occlib.foreground.light import Light, block_means, block_size, fit_light
from occlib.foreground.pictures import Picture, picture_of, reduced
from occlib.foreground.texture import Products, products_of

Float32Array = npt.NDArray[np.float32]

TREMBLE = 0.1
"""Share of the background's own contrast by which its levels may be wrong: edges move by a fraction of a px."""

STEADY = 3.0
"""A px is unsteady as far as its spread exceeds so many times the noise of the background, a grey level at least."""


class Reference(NamedTuple):
    """A background as frames are compared with it.

    Parameters
    ----------
    picture
        Its :class:`~occlib.foreground.pictures.Picture`.
    levels
        The picture smoothed over 3 px, float32 (H, W, 3): not rounded.
    slack
        Grey levels by which a px may be wrong without any object, float32 (H, W): trembling edges, leaves, flickering screens.
    cell, blocks
        Side of its blocks, and their means (:mod:`occlib.foreground.light`).
    points
        Where its edges are looked up (:mod:`occlib.foreground.alignment`).
    """

    picture: Picture
    levels: Float32Array
    slack: Float32Array
    cell: int
    blocks: Float32Array
    points: npt.NDArray[np.int32]

    def shift(self, frame: Picture) -> tuple[float, float]:
        """By how many px (x, y) the camera was bumped since: see :func:`~occlib.foreground.alignment.shift_between`."""
        return shift_between(self.picture.grey, frame.grey, self.points)

    def light(self, frame: Picture) -> tuple[Products, Light]:
        """The products of a frame's gradients and the background's, and the frame's light."""
        products = products_of(frame, self.picture)
        return products, fit_light(block_means(frame.half, self.cell), self.blocks, products, self.cell)


def reference_of(image: Image, noise: float, spread: Float32Array | None) -> Reference:
    """The reference of a background: uint8 RGB, the noise in grey levels, and that of each px if it is known."""
    picture = picture_of(image)
    levels = picture.image.astype(np.float32)
    mean = cv2.blur(levels, (5, 5))
    slack = TREMBLE * np.sqrt(np.maximum(cv2.blur(levels * levels, (5, 5)) - mean * mean, 0)).max(axis=2)
    if spread is not None:
        slack += 2 * np.maximum(cv2.blur(reduced(spread), (5, 5)) - STEADY * max(noise, 1.0), 0)
    cell = block_size(picture.grey.shape)
    return Reference(
        picture,
        np.asarray(cv2.GaussianBlur(levels, (3, 3), 0), np.float32),
        np.asarray(slack, np.float32),
        cell,
        block_means(picture.half, cell),
        edge_points(picture.grey),
    )
