"""What has changed in a view: intensity adjustment, background, smoothing and threshold (sections 2, 4).

The chain of Figs 4-6: adjust the frame's intensity to the background's, subtract, smooth, threshold. Every
step is a function of its own, on RGB uint8 images.
"""

from __future__ import annotations

import io
import itertools
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from occlib.geometry import Image, Mask
from occlib.kernels import compiled
from occlib.recordings import write_file

LEAST_NOISE_FLOOR = 8.0
"""Grey levels below which a difference is never called foreground: sensor noise and JPEG blocks."""

Float32Array = npt.NDArray[np.float32]

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation, of normal noise (Rousseeuw and Croux 1993)."""
NEAR, FAR = 1 / 20, 1 / 5
"""Distances from what moves, in widths of the picture, from which on a sample counts fully."""


@dataclass(frozen=True)
class Background:
    """The empty floor as one camera sees it, frozen.

    Parameters
    ----------
    image
        uint8 RGB, shape (H, W, 3).
    noise
        Standard deviation of a pixel over time in grey levels, 0 if only one picture was seen.
    spread
        The same pixel by pixel, float32 (H, W), of the channel that varies most: 1.4826 times the median absolute
        deviation. None if only one picture was seen. Where leaves or a screen move it is far above ``noise``; it
        can be 0, where a level never changed.
    unrounded
        The image before rounding, float32 (H, W, 3), kept by :func:`update_background` and not written to files.
    """

    image: Image
    noise: float = 0.0
    spread: Float32Array | None = None
    unrounded: Float32Array | None = field(default=None, repr=False, compare=False)

    @property
    def noise_floor(self) -> float:
        """The least difference in grey levels that can be an object: six sigma, at least 8."""
        return max(LEAST_NOISE_FLOOR, 6.0 * self.noise)

    @cached_property
    def grey(self) -> Image:
        """The background as grey levels, uint8 (H, W)."""
        return to_grey(self.image)

    @cached_property
    def soft(self) -> tuple[Float32Array, Float32Array, float]:
        """What :func:`foreground_evidence` needs: the image smoothed over 3 px, float32 (H, W, 3), its standard deviation within
        5 px, float32 (H, W), and the noise floor of a smoothed pixel in grey levels."""
        image = self.image.astype(np.float32)
        mean = cv2.blur(image, (5, 5))
        texture = np.sqrt(np.maximum(cv2.blur(image * image, (5, 5)) - mean * mean, 0)).max(axis=2)
        return (
            np.asarray(cv2.GaussianBlur(image, (3, 3), 0), np.float32),
            np.asarray(texture, np.float32),
            3.0 * self.noise,
        )

    def save(self, path: str | Path) -> Path:
        """Write as ``.npz``; :meth:`load` reads it back equal."""
        buffer = io.BytesIO()
        spread = {} if self.spread is None else {"spread": self.spread}
        np.savez_compressed(buffer, image=self.image, noise=self.noise, **spread)  # type: ignore[arg-type, unused-ignore]
        return write_file(path, buffer.getvalue())

    @classmethod
    def load(cls, path: str | Path) -> Background:
        """Read a saved background; ``ValueError`` in one line if the file is not one."""
        try:
            content = io.BytesIO(Path(path).read_bytes())  # np.load leaves a damaged file open
            with np.load(content, allow_pickle=False) as archive:  # a bare array (.npy) is no archive: TypeError
                image, noise = _checked(archive["image"], "background"), float(archive["noise"])
                spread = archive["spread"] if "spread" in archive else None  # older files have none
        except (OSError, KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise ValueError(f"{path}: cannot read a background ({error})") from None
        if not (np.isfinite(noise) and noise >= 0):
            raise ValueError(f"{path}: noise: expected grey levels >= 0, got {noise}")
        if spread is not None:
            if spread.shape != image.shape[:2] or spread.dtype != np.float32:
                raise ValueError(
                    f"{path}: spread: expected float32 {image.shape[:2]}, got {spread.dtype} {spread.shape}"
                )
            if not (np.isfinite(spread) & (spread >= 0)).all():
                raise ValueError(f"{path}: spread: expected grey levels >= 0")
        return cls(image, noise, spread)


def _checked(image: Image, name: str = "image") -> Image:
    array = np.asarray(image)
    if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise ValueError(f"{name}: expected uint8 RGB (H, W, 3), got {array.dtype} {array.shape}")
    return array


def _stack(images: Sequence[Image]) -> Image:
    if not len(images):
        raise ValueError("images: expected at least one picture, got none")
    shapes = {_checked(image).shape for image in images}
    if len(shapes) > 1:
        raise ValueError(f"images: expected one size, got {sorted(shapes)}")
    return np.stack([np.asarray(image) for image in images])


def average_background(images: Sequence[Image]) -> Background:
    """The background from pictures of the *empty* floor: their mean, and the noise and spread between them.

    Parameters
    ----------
    images
        One or more uint8 RGB pictures of one size.
    """
    stack = _stack(images)
    mean = stack.mean(axis=0)
    noise = 0.0
    if len(stack) > 1:  # the median keeps a flickering lamp or a passing insect from counting
        freedom = len(stack) - 1  # the median of chi-squared lies below its mean (Wilson and Hilferty 1931)
        noise = float(np.sqrt(np.median(stack.var(axis=0, ddof=1)) / (1 - 2 / (9 * freedom)) ** 3))
    return Background(np.round(mean).astype(np.uint8), noise, _spread(stack) if len(stack) > 1 else None)


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


def update_background(background: Background, image: Image, foreground: Mask, *, rate: float = 0.02) -> Background:
    """The background a little later: it follows the frame where there is no foreground.

    ``new = (1 - rate) * old + rate * image`` outside ``foreground``, and inside the background stays as it is: the
    selective running average of Koller et al. (1994), "Towards robust automatic traffic scene analysis in
    real-time". The levels are kept unrounded from update to update (:attr:`Background.unrounded`), so that small
    rates do not stall.

    Parameters
    ----------
    background
        The background so far; it is not changed.
    image
        uint8 RGB (H, W, 3), of the background's intensity (see :func:`adjust_intensity`).
    foreground
        Bool (H, W), True where the background must not learn. Rather too large than too small.
    rate
        Share of the difference that is made up for in one update, 0 to 1: after ``1 / rate`` of them 63 %.

    Returns
    -------
    Background
        With the noise and spread of before.

    Raises
    ------
    ValueError
        If the image or the foreground does not fit the background, or the rate is not between 0 and 1.

    Examples
    --------
    >>> background = Background(np.full((2, 2, 3), 100, np.uint8))
    >>> for _ in range(35):
    ...     background = update_background(background, np.full((2, 2, 3), 108, np.uint8), np.eye(2, dtype=bool))
    >>> background.image[..., 0].tolist()
    [[100, 104], [104, 100]]
    """
    if image.shape != background.image.shape or image.dtype != np.uint8:
        raise ValueError(f"image: expected uint8 {background.image.shape}, got {image.dtype} {image.shape}")
    if foreground.shape != image.shape[:2] or foreground.dtype != np.bool_:
        raise ValueError(f"foreground: expected bool {image.shape[:2]}, got {foreground.dtype} {foreground.shape}")
    if not 0 <= rate <= 1:
        raise ValueError(f"rate: expected a share from 0 to 1, got {rate}")
    before = background.image if background.unrounded is None else background.unrounded
    levels = before.astype(np.float32)  # a copy
    cv2.accumulateWeighted(image, levels, rate, mask=(~foreground).astype(np.uint8))
    return Background(cv2.convertScaleAbs(levels), background.noise, background.spread, levels)


def weighted_median(values: Image, weights: Image) -> Image:
    """The lower weighted median over the first axis: the least value that, with those below, has half of the weight.

    Found by bisection, a bit of the value at a time, which takes eight passes over the values and no sorting.

    Parameters
    ----------
    values
        uint8 (N, ...).
    weights
        uint8 from 0 to 15, of the values' shape; where all are 0, the result is 255.

    Returns
    -------
    uint8
        Of the shape of one value.
    """

    def total(part: Image) -> npt.NDArray[np.uint32]:
        # 17 * 15 = 255: such a sum still is a uint8, and quick
        groups = [np.add.reduce(part[first : first + 17], axis=0, dtype=np.uint8) for first in range(0, len(part), 17)]
        return np.sum(groups, axis=0, dtype=np.uint32)

    whole = total(weights)
    median = np.zeros(values.shape[1:], np.uint8)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        trial = median | np.uint8(bit)
        below = total((values < trial).view(np.uint8) * weights)
        median = np.where((2 * below < whole) | (whole == 0), trial, median)
    return median


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


def _strips(stack: Image, weights: Image) -> Iterator[tuple[slice, Image, Image]]:
    """A few rows at a time, which stay in the processor's cache: the rows, the values and their enlarged weights."""
    height, width = stack.shape[1:3]
    rows = np.arange(height) * weights.shape[1] // height
    columns = np.repeat(np.arange(width) * weights.shape[2] // width, 3)
    for top in range(0, height, 8):
        strip = slice(top, top + 8)
        part = stack[:, strip]
        yield strip, part, weights[:, rows[strip]].take(columns, axis=2).reshape(part.shape)


def _median_over_time(stack: Image, weights: Image) -> Image:
    return np.concatenate([weighted_median(part, weight) for _, part, weight in _strips(stack, weights)])


def _spread(stack: Image, image: Image | None = None, weights: Image | None = None) -> Float32Array:
    """1.4826 times the median absolute deviation, of the largest channel, float32 (H, W), over all samples from their
    median, or over those like the image from the image."""
    if weights is None:
        weights = np.ones((len(stack), 1, 1), np.uint8)
    spread = np.empty(stack.shape[1:3], np.float32)
    for strip, part, weight in _strips(stack, weights):
        if image is None:
            deviation = _absolute_difference(part, weighted_median(part, weight))
        else:
            deviation = _absolute_difference(part, image[strip])
            weight = weight * (deviation <= 30)
            weight[:, ~weight.any(axis=0)] = 1
        lower = weighted_median(deviation, weight)
        upper = ~weighted_median(~deviation, weight) if len(stack) < 10 else lower  # the two middle ones, if few
        spread[strip] = MAD_TO_SIGMA / 2 * (lower.astype(np.float32) + upper).max(axis=-1)
    return spread


def _absolute_difference(values: Image, centre: Image) -> Image:
    return np.maximum(values, centre) - np.minimum(values, centre)


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


def subtract_background(image: Image, background: Background, *, adjust: bool = True, colour: bool = True) -> Image:
    """Absolute difference from the background in grey levels, uint8 (H, W) (Fig 6).

    Parameters
    ----------
    image
        uint8 RGB of the background's size.
    adjust
        Adjust the frame's intensity first.
    colour
        Grey level of the three channels' differences, else the difference of the grey levels (the paper's); the
        former also sees an object of the floor's brightness but of another colour.
    """
    if image.shape != background.image.shape or image.dtype != np.uint8:
        raise ValueError(f"image: expected uint8 {background.image.shape}, got {image.dtype} {image.shape}")
    frame, reference = (image, background.image) if colour else (to_grey(image), background.grey)
    if adjust:
        frame = adjust_intensity(frame, reference)
        difference = cv2.absdiff(frame, reference, dst=frame)  # a new picture, and nobody else's: spare a large array
    else:
        difference = cv2.absdiff(frame, reference)
    return np.asarray(cv2.cvtColor(difference, cv2.COLOR_RGB2GRAY) if colour else difference)


def smooth(difference: Image, *, size: int = 5) -> Image:
    """Gaussian smoothing over ``size`` x ``size`` px (odd), which removes noise and thin reflections; 1 does nothing."""
    if size < 1 or size % 2 == 0:
        raise ValueError(f"size: expected an odd number of px, got {size}")
    return difference if size == 1 else np.asarray(cv2.GaussianBlur(difference, (size, size), 0))


def otsu_threshold(difference: Image) -> float:
    """Otsu's threshold of a uint8 image (Matlab's ``graythresh``): the split with the largest variance between classes."""
    return float(cv2.threshold(difference, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[0])


def triangle_threshold(difference: Image) -> float:
    """The triangle threshold of a uint8 image: suits a small object on a large background."""
    return float(cv2.threshold(difference, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_TRIANGLE)[0])


def half_otsu_threshold(difference: Image) -> float:
    """Half of Otsu's threshold: covers the faint parts of an object that Otsu cuts off, and still follows the contrast."""
    return otsu_threshold(difference) / 2


THRESHOLDS: dict[str, Callable[[Image], float]] = {
    "otsu": otsu_threshold,
    "half-otsu": half_otsu_threshold,
    "triangle": triangle_threshold,
}
"""Thresholds by name; each takes the uint8 difference and returns grey levels."""


def threshold_level(difference: Image, threshold: str | float = "otsu", *, noise_floor: float = 0.0) -> float:
    """The grey level above which a pixel is foreground; one that is found by a rule is never below the noise floor.

    Otsu splits *every* picture in two, an empty one into noise and more noise. The noise floor is what lets an
    empty frame have no foreground.

    Parameters
    ----------
    difference
        uint8 (H, W).
    threshold
        A name in :data:`THRESHOLDS`, ``"noise"`` (the noise floor itself), or grey levels >= 0, taken as they are.
    noise_floor
        Grey levels, e.g. :attr:`Background.noise_floor`.
    """
    if isinstance(threshold, str):
        if threshold == "noise":
            return noise_floor
        if threshold not in THRESHOLDS:
            known = ", ".join([*THRESHOLDS, "noise"])
            raise ValueError(f"threshold: expected {known} or grey levels, got {threshold!r}")
        return max(THRESHOLDS[threshold](difference), noise_floor)
    if not (np.isfinite(threshold) and threshold >= 0):
        raise ValueError(f"threshold: expected grey levels >= 0, got {threshold}")
    return float(threshold)


def foreground_mask(
    image: Image, background: Background, *, threshold: str | float = "otsu", size: int = 5, colour: bool = False
) -> Mask:
    """The whole chain of section 4 for one view: adjust, subtract, smooth, threshold. Bool (H, W)."""
    difference = smooth(subtract_background(image, background, colour=colour), size=size)
    return np.asarray(difference > threshold_level(difference, threshold, noise_floor=background.noise_floor))


SURE = 128
"""Soft evidence of foreground from this value on is foreground (0 surely background, 255 surely foreground)."""


@dataclass(frozen=True)
class ShadowModel:
    """What floor in a shadow, or under a reflection, may look like; the rest is an object (see :func:`foreground_evidence`).

    Parameters
    ----------
    chroma
        Change of colour, as a share of the background's brightness, that speaks for an object.
    least_chroma
        The same in grey levels, on a dark background.
    darkest, least_level
        A shadow leaves at least this share of the light, or so many grey levels where the floor is bright: what is dark there is an
        object.
    bright
        Gain of brightness, as a share, that speaks for an object.
    least_step
        Change of brightness in grey levels that can be told from noise.
    texture
        Share of the background's own contrast within 5 px that is added to the thresholds: edges tremble.
    steepness
        How fast evidence becomes sure on either side of a threshold.
    depth
        The same for darkness beyond these, relative to ``steepness``: a deep shadow looks much like a dark object.
    """

    chroma: float = 0.05
    least_chroma: float = 8.0
    darkest: float = 0.65
    least_level: float = 100.0
    bright: float = 0.12
    least_step: float = 14.0
    texture: float = 0.15
    steepness: float = 2.5
    depth: float = 0.5


def foreground_evidence(image: Image, background: Background, *, shadows: ShadowModel = ShadowModel()) -> Image:
    """How surely each pixel shows an object, its shadow and its mirror image left out. uint8 (H, W), 128 is even odds.

    A shadow scales the background's colour, ``I = alpha B``, and leaves its direction. The pixel's change is
    split (Horprasert et al. 1999) into brightness ``alpha = I.B / B.B`` and chroma ``|I - alpha B|``; each is measured in
    units of its threshold, and foreground is where their root of squares exceeds 1. Noise and the texture of the background
    raise the thresholds; a median over 5 px removes what is left of either.

    A pixel at an object's rim shows part of the floor. It counts as object where at least half of it is: where it has changed less
    than halfway between the least and the largest change within 5 px, the least evidence there takes its place (the lower half of a
    toggle mapping, Kramer and Bruckner 1975).

    Parameters
    ----------
    image
        uint8 RGB of the background's size; gain and offset of each channel are adjusted first.
    background
        The empty floor.
    """
    if image.shape != background.image.shape or image.dtype != np.uint8:
        raise ValueError(f"image: expected uint8 {background.image.shape}, got {image.dtype} {image.shape}")
    gains = np.array([channel_gain_offset(image, background.image, c) for c in range(3)], np.float32)
    smoothed, texture, least = background.soft
    numbers = np.array(
        [
            shadows.chroma,
            max(shadows.least_chroma, 0.5 * least),
            shadows.darkest,
            shadows.least_level,
            shadows.bright,
            max(shadows.least_step, least),
            shadows.texture,
            shadows.steepness,
            shadows.depth,
        ],
        np.float32,
    )
    evidence, change = np.empty(image.shape[:2], np.uint8), np.empty(image.shape[:2], np.uint8)
    _evidence(cv2.GaussianBlur(image, (3, 3), 0), smoothed, texture, gains, numbers, evidence, change)
    evidence = np.asarray(cv2.medianBlur(evidence, 5))
    square = np.ones((5, 5), np.uint8)
    _sharpen(evidence, cv2.erode(evidence, square), change, cv2.erode(change, square), cv2.dilate(change, square))
    return evidence


def channel_gain_offset(image: Image, background: Image, channel: int) -> tuple[float, float]:
    """:func:`intensity_gain_offset` of one channel: follows auto-exposure and a white balance that drifts."""
    return intensity_gain_offset(image[..., channel], background[..., channel])


@compiled
def _sharpen(evidence: Any, least: Any, change: Any, low: Any, high: Any) -> None:
    for y in range(evidence.shape[0]):
        for x in range(evidence.shape[1]):
            if 2 * np.int64(change[y, x]) < np.int64(low[y, x]) + np.int64(high[y, x]):
                evidence[y, x] = least[y, x]


@compiled
def _evidence(image: Any, background: Any, texture: Any, gains: Any, how: Any, out: Any, changes: Any) -> None:
    chroma_share, least_chroma, darkest, least_level, bright, least_step, per_texture, steepness, depth = how
    # neither chroma nor step exceeds the change itself: most pixels are found to be background without a root
    inverse = 1 / least_chroma**2 + 1 / (1.73 * least_step) ** 2
    nothing = np.float32(max(1 - 1 / steepness, 0.0) ** 2 / inverse)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            product = square = change = total = np.float32(0)
            for c in range(3):
                difference = gains[c, 0] * image[y, x, c] + gains[c, 1] - background[y, x, c]
                change += difference * difference
                total += abs(difference)
            changes[y, x] = np.uint8(min(total / np.float32(3), np.float32(255)))
            if change < nothing:
                out[y, x] = 0
                continue
            change = np.float32(0)
            for c in range(3):
                b = background[y, x, c]
                i = gains[c, 0] * image[y, x, c] + gains[c, 1]
                product += i * b
                square += b * b
            alpha = product / max(square, np.float32(1))
            for c in range(3):
                difference = gains[c, 0] * image[y, x, c] + gains[c, 1] - alpha * background[y, x, c]
                change += difference * difference
            level = np.sqrt(square)
            spare = per_texture * texture[y, x]
            chroma = np.sqrt(change) / (max(chroma_share * level, least_chroma) + spare)
            step = (alpha - 1) * level  # in units of a grey pixel's three channels: 1.73 levels each
            if step < 0:
                deepest = min(darkest, np.float32(1.73) * least_level / max(level, np.float32(1)))
                brightness = min((1 - alpha) / (1 - deepest), -step / (np.float32(1.73) * (least_step + 2 * spare)))
                if brightness > 1:
                    brightness = 1 + depth * (brightness - 1)
            else:
                brightness = step / (max(bright * level, np.float32(1.73) * least_step) + 3 * spare)
            score = np.sqrt(chroma * chroma + brightness * brightness)
            value = np.float32(127.5) * (1 + (score - 1) * steepness)
            out[y, x] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))


def foreground_evidence_naive(image: Image, background: Background, *, shadows: ShadowModel = ShadowModel()) -> Image:
    """The same as :func:`foreground_evidence`, equation by equation in NumPy."""
    gains = np.array([channel_gain_offset(image, background.image, c) for c in range(3)], np.float32)
    smoothed, texture, least = background.soft
    i = cv2.GaussianBlur(image, (3, 3), 0) * gains[:, 0] + gains[:, 1]
    level = np.sqrt((smoothed**2).sum(axis=2))
    alpha = (i * smoothed).sum(axis=2) / np.maximum(level**2, 1)
    spare = shadows.texture * texture
    chroma = np.sqrt(((i - alpha[..., None] * smoothed) ** 2).sum(axis=2))
    chroma /= np.maximum(shadows.chroma * level, max(shadows.least_chroma, 0.5 * least)) + spare
    least = 1.73 * max(shadows.least_step, least)
    deepest = np.minimum(shadows.darkest, 1.73 * shadows.least_level / np.maximum(level, 1))
    darker = np.minimum((1 - alpha) / (1 - deepest), (1 - alpha) * level / (least + 2 * 1.73 * spare))
    darker = np.where(darker > 1, 1 + shadows.depth * (darker - 1), darker)
    brighter = (alpha - 1) * level / (np.maximum(shadows.bright * level, least) + 3 * spare)
    score = np.hypot(chroma, np.where(alpha < 1, darker, brighter))
    evidence = cv2.medianBlur(np.clip(127.5 * (1 + (score - 1) * shadows.steepness), 0, 255).astype(np.uint8), 5)
    change = np.minimum(np.abs(i - smoothed).mean(axis=2), 255).astype(np.uint8)
    square = np.ones((5, 5), np.uint8)
    halfway = cv2.erode(change, square) / 2 + cv2.dilate(change, square) / 2
    return np.asarray(np.where(change < halfway, cv2.erode(evidence, square), evidence))


def as_background(background: Background | npt.ArrayLike) -> Background:
    """A ``Background`` from itself or from a single uint8 RGB picture of the empty floor."""
    if isinstance(background, Background):
        return background
    return average_background([np.asarray(background)])
