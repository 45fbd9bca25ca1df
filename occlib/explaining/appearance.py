"""What objects look like: their colour, whether the views agree about it, and which known object they resemble."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Image, Mask, as_points
from occlib.explaining.prisms import Prism, outline_points
from occlib.geometry import Rig
from occlib.matching.search import similarity

AXIS_SHARES = (0.3, 0.4, 0.5, 0.6, 0.7)
"""Shares of an object's height at which its colour is read, clear of the floor and of what is seen beyond its top."""

MIN_SIDE_PX = 4
"""A template of fewer px, as it is or resized, says nothing."""

SCALES = np.array([0.8, 0.9, 1.0, 1.1, 1.25])
"""Sizes tried of a template, over the height of the object's picture."""

RING = 24
"""Points on each rim of a prism of which its box in a picture is made."""


def axis_colours(points_m: npt.ArrayLike, heights: npt.ArrayLike, images: Mapping[str, Image], rig: Rig) -> FloatArray:
    """The mean colour that each view shows along the axes of upright objects.

    Parameters
    ----------
    points_m
        Floor points (N, 2) in m.
    heights
        Of the objects, (N,) or a number, in m; looked at from 0.3 to 0.7 of it.
    images
        ``{camera: uint8 RGB (H, W, 3)}``.
    rig
        The cameras.

    Returns
    -------
    Shape (views, N, 3) in grey levels; NaN where a view does not see the axis.
    """
    points, shares = as_points(points_m), np.array(AXIS_SHARES)
    tall = np.broadcast_to(np.asarray(heights, dtype=np.float64), len(points))
    colours = np.full((len(images), len(points), 3), np.nan)
    for k, (name, image) in enumerate(images.items()):
        for i, point in enumerate(points):
            pixels = rig[name].project(np.column_stack([np.tile(point, (len(shares), 1)), shares * tall[i]]))
            pixels = np.rint(pixels[rig[name].inside(pixels)]).astype(int)
            if len(pixels):
                colours[k, i] = image[pixels[:, 1], pixels[:, 0]].mean(axis=0)
    return colours


def colour_agreement(
    points_m: npt.ArrayLike, heights: npt.ArrayLike, images: Mapping[str, Image], rig: Rig
) -> FloatArray:
    """How much the views disagree about the colour of what may stand at a place: a ghost test.

    All views show the same colour at an object that no other hides. At a ghost each view shows another object, the one
    that casts its shadow there.

    Parameters
    ----------
    points_m, heights, images, rig
        As for :func:`axis_colours`, of the candidates; two or more images.

    Returns
    -------
    Shape (N,): the largest distance between the colours of two views in grey levels, 0 to 442, lower is
    more alike; NaN where fewer than two views see the axis.

    Raises
    ------
    ValueError
        Fewer than two images.

    Examples
    --------
    >>> from occlib.recordings import LAB
    >>> rig = Rig.load(LAB / "robot" / "rig.yaml")
    >>> images = {name: np.full((480, 640, 3), level, np.uint8) for name, level in [("left", 90), ("right", 100)]}
    >>> colour_agreement([[0, 0]], 0.2, images, rig).round(1)
    array([17.3])
    """
    if len(images) < 2:
        raise ValueError(f"images: expected two or more, got {len(images)}")
    colours = axis_colours(points_m, heights, images, rig)
    pairs = [np.linalg.norm(colours[a] - colours[b], axis=1) for a, b in combinations(range(len(images)), 2)]
    largest = np.max(np.nan_to_num(pairs, nan=-1.0), axis=0)
    return np.where(largest < 0, np.nan, largest)


def _likeness(window: Image, picture: Image, mask: Mask | None, height: int) -> float:
    """Least mean absolute difference of a template, about ``height`` px high, in a window; infinite if it fits nowhere."""
    best = np.inf
    for scale in height / len(picture) * SCALES:
        size = tuple(round(float(scale * side)) for side in picture.shape[1::-1])
        if MIN_SIDE_PX <= min(size) and size[0] <= window.shape[1] and size[1] <= window.shape[0]:
            resized = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
            used = None if mask is None else cv2.resize(mask.view(np.uint8), size).astype(bool)
            if used is None or used.any():
                best = min(best, float(similarity(window, resized, "sad", used).min()))
    return best


def _box(prism: Prism, rig: Rig, name: str) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of an object in a view, in whole px; it may reach beyond the picture."""
    ring = outline_points(prism)
    points = rig[name].project(np.vstack([np.column_stack([ring, np.full(len(ring), z)]) for z in (0.0, prism.height)]))
    left, top = np.floor(points.min(axis=0)).astype(int).tolist()
    right, bottom = np.ceil(points.max(axis=0)).astype(int).tolist()
    return left, top, right, bottom
