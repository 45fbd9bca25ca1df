"""The background learned from frames in which objects move: what is there most of the time."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np

from occlib.base.arrays import Image
from occlib.foreground.background import (
    MAD_TO_SIGMA,
    Background,
    Float32Array,
    _absolute_difference,
    _spread,
    _stack,
    _strips,
    weighted_median,
)
from occlib.foreground.intensity import intensity_gain_offset

NEAR, FAR = 1 / 20, 1 / 5
"""Distances from what moves, in widths of the picture, from which on a sample counts fully."""


def learn_background(images: Sequence[Image]) -> Background:
    """The background from frames that are *never* empty, though someone stands still for long.

    Whoever stands is not still: the motion from frame to frame tells where, and the bare floor is best seen while
    everything that moves is far away. So each sample of a pixel is weighted by the cube of its distance to the nearest
    motion, up to a fifth of the picture's width, and the weighted median is one hypothesis. The other merely leaves
    out the moving things: weights in proportion to the distance, up to a twentieth. Where these disagree, the one
    with the fainter outline wins: what stands in front has an outline, the bare floor has none. At last, what else
    was seen in a place, by a fifth of the samples at least, wins if its outline is much fainter still: this removes
    a thing parked for more than half of the time, without any motion.

    Parameters
    ----------
    images
        uint8 RGB frames (H, W, 3) of one size in order of time, spread over the recording; 50 or more do well. Their
        intensities are adjusted to their median first. What never moves is the background, and of a single frame or
        two all that does not differ.

    Returns
    -------
    Background
        Its levels are levels of the adjusted frames (of an even number, the lower median). ``spread`` leaves out
        samples in motion and those that differ by more than 30 grey levels, which show something else.

    Raises
    ------
    ValueError
        If there is no frame, or one is not uint8 RGB, or the sizes differ.

    Notes
    -----
    The median over time is the background of Lo and Velastin (2001), "Automatic congestion detection system for
    underground platforms", and breaks where a thing stays for half of the time. Weights and outline are ours.

    Examples
    --------
    A block stays for six of ten frames and then leaves. The median keeps it, the learned background does not:

    >>> frames = np.full((10, 60, 120, 3), 90, np.uint8)
    >>> for frame, left in zip(frames, [10] * 6 + [30, 50, 70, 90]):
    ...     frame[20:40, left : left + 12] = 200
    >>> int(np.median(frames, axis=0).max()), int(learn_background(frames).image.max())
    (200, 90)
    """
    stack = _stack(images)
    small = _reduced(stack)
    reference = weighted_median(small, np.ones(small.shape, np.uint8))
    for sample, one in zip(stack, small, strict=True):
        gain, offset = intensity_gain_offset(one, reference)
        for picture in (sample, one):
            cv2.addWeighted(picture, gain, picture, 0.0, offset, dst=picture)
    distance = _distance_to_motion(small)
    near, far = _weights(distance, NEAR, 1), _weights(distance, FAR, 3)
    image = _fainter(_median_over_time(stack, near), _median_over_time(stack, far), 0.9)
    image = _fainter(image, _otherwise(stack, image), 0.7)
    deviation = np.median([cv2.absdiff(one, image) for one in stack[:: max(1, len(stack) // 8)]])
    return Background(image, MAD_TO_SIGMA * float(deviation), _spread(stack, image, near))


def _reduced(stack: Image) -> Image:
    """The pictures, about 320 px wide or left as they are: motion needs no more, and noise averages out."""
    height, width = stack.shape[1:3]
    shrink = max(1, round(width / 320))
    size = -(-width // shrink), -(-height // shrink)
    return np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in stack])


def _distance_to_motion(small: Image) -> Float32Array:
    """Distance of each pixel of each sample to what moves from the sample before or to the one after, in widths."""
    count, height, width = small.shape[:3]
    distance = np.full((count, height, width), np.inf, np.float32)
    differences = [cv2.absdiff(one, after).max(axis=-1) for one, after in itertools.pairwise(small)]
    if not differences:
        return distance
    level = 5 * max(1.6, float(np.median(differences)))  # the median is about the noise: see MAD_TO_SIGMA
    square = np.ones((3, 3), np.uint8)
    moves = [cv2.morphologyEx((d > level).astype(np.uint8), cv2.MORPH_OPEN, square) for d in differences]
    for one, before, after in zip(distance, [moves[0], *moves], [*moves, moves[-1]], strict=True):
        moving = cv2.max(before, after)
        if moving.any():
            one[:] = cv2.distanceTransform(1 - moving, cv2.DIST_L2, 3) / width
    return distance


def _weights(distance: Float32Array, reach: float, power: int) -> Image:
    """Weights 0 (in motion) to 15 (``reach`` away or more); 1 each where there is always motion."""
    weights = np.rint(15 * np.minimum(distance / reach, 1) ** power).astype(np.uint8)
    weights[:, ~weights.any(axis=0)] = 1
    return weights


def _median_over_time(stack: Image, weights: Image) -> Image:
    return np.concatenate([weighted_median(part, weight) for _, part, weight in _strips(stack, weights)])


def _otherwise(stack: Image, image: Image, *, level: int = 15, share: float = 0.2) -> Image:
    """The median of the samples that differ from the image, where these are the given share; else the image."""
    other = image.copy()
    for strip, part, _ in _strips(stack, np.ones((len(stack), 1, 1), np.uint8)):
        channels = _absolute_difference(part, image[strip]) > level
        differs = channels[..., 0] | channels[..., 1] | channels[..., 2]
        often = differs.sum(axis=0, dtype=np.uint16) >= max(2.0, share * len(stack))
        if often.any():
            weight = np.ascontiguousarray(np.broadcast_to(differs[..., None], part.shape)).view(np.uint8)
            other[strip] = np.where(often[..., None], weighted_median(part, weight), other[strip])
    return other


def _fainter(image: Image, other: Image, ratio: float, *, level: float = 15.0) -> Image:
    """The image, with each region where the other differs replaced if the outline then is fainter by the ratio."""
    image = image.copy()
    differs = cv2.absdiff(cv2.blur(image, (3, 3)), cv2.blur(other, (3, 3))).max(axis=-1) > level
    regions = cv2.morphologyEx(differs.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    regions = cv2.morphologyEx(regions, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(regions)
    for label in range(1, count):
        x, y, width, height = boxes[label, :4]
        window = np.s_[max(0, y - 12) : y + height + 12, max(0, x - 12) : x + width + 12]
        region = cv2.dilate((labels[window] == label).astype(np.uint8), np.ones((5, 5), np.uint8))
        replaced = np.where(region[..., None] > 0, other[window], image[window])
        if _outline(replaced, region) < ratio * _outline(image[window], region):
            image[window] = replaced
    return image


def _outline(image: Image, region: Image) -> float:
    """Mean gradient along the region's border, 3 px to either side."""
    square = np.ones((7, 7), np.uint8)
    ring = cv2.dilate(region, square) > cv2.erode(region, square)
    levels = cv2.GaussianBlur(image.astype(np.float32), (3, 3), 0)
    gradient = cv2.magnitude(cv2.Sobel(levels, cv2.CV_32F, 1, 0), cv2.Sobel(levels, cv2.CV_32F, 0, 1))
    return float(gradient.max(axis=-1)[ring].mean()) if ring.any() else 0.0
