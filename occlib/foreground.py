"""What has changed in a view: intensity adjustment, background, smoothing and threshold (sections 2, 4).

The chain of Figs 4-6: adjust the frame's intensity to the background's, subtract, smooth, threshold. Every
step is a function of its own, on RGB uint8 images.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from occlib.geometry import FloatArray, Image, Mask
from occlib.recordings import write_file

LEAST_NOISE_FLOOR = 8.0
"""Grey levels below which a difference is never called foreground: sensor noise and JPEG blocks."""


@dataclass(frozen=True)
class Background:
    """The empty floor as one camera sees it, frozen.

    Parameters
    ----------
    image
        uint8 RGB, shape (H, W, 3).
    noise
        Standard deviation of a pixel over time in grey levels, 0 if only one picture was seen.
    """

    image: Image
    noise: float = 0.0

    @property
    def noise_floor(self) -> float:
        """The least difference in grey levels that can be an object: six sigma, at least 8."""
        return max(LEAST_NOISE_FLOOR, 6.0 * self.noise)

    @cached_property
    def grey(self) -> Image:
        """The background as grey levels, uint8 (H, W)."""
        return to_grey(self.image)

    def save(self, path: str | Path) -> Path:
        """Write as ``.npz``; :meth:`load` reads it back equal."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, image=self.image, noise=self.noise)
        return write_file(path, buffer.getvalue())

    @classmethod
    def load(cls, path: str | Path) -> Background:
        """Read a saved background; ``ValueError`` in one line if the file is not one."""
        try:
            content = io.BytesIO(Path(path).read_bytes())  # np.load leaves a damaged file open
            with np.load(content, allow_pickle=False) as archive:  # a bare array (.npy) is no archive: TypeError
                image, noise = _checked(archive["image"], "background"), float(archive["noise"])
        except (OSError, KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise ValueError(f"{path}: cannot read a background ({error})") from None
        if not (np.isfinite(noise) and noise >= 0):
            raise ValueError(f"{path}: noise: expected grey levels >= 0, got {noise}")
        return cls(image, noise)


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
    """The background from pictures of the *empty* floor: their mean, and the noise between them.

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
    return Background(np.round(mean).astype(np.uint8), noise)


def learn_background(
    images: Sequence[Image], *, windows: int = 10, tolerance: float = 18.0, agreement: float = 0.75
) -> Background:
    """The background from frames that are *never* empty.

    The time line is cut into windows; the median of each is one candidate for a pixel. A candidate that
    ``agreement`` of the windows share (within ``tolerance`` grey levels) is the background. Where somebody
    stood for long, no candidate has that support, or the wrong one might: there the background grows inwards from its
    surroundings, and the candidate wins that continues them best.

    Parameters
    ----------
    images
        uint8 RGB frames in order of time, spread over the recording; 50 or more do well.
    windows
        Number of windows; an object may stay in one place for about half of them.
    tolerance
        Grey levels (largest of the three channels) within which two candidates agree.
    agreement
        Share of the windows, 0 to 1, that settles a pixel at once.
    """
    stack = _stack(images)
    parts = np.array_split(np.arange(len(stack)), min(windows, len(stack)))
    candidates = np.stack([np.median(stack[part], axis=0) for part in parts]).astype(np.float32)
    smooth = np.stack([cv2.blur(candidate, (3, 3)) for candidate in candidates])
    support = np.zeros(candidates.shape[:3], np.float32)
    for i, one in enumerate(smooth):
        for j, other in enumerate(smooth[:i]):
            agree = np.abs(one - other).max(axis=-1) <= tolerance
            support[i] += agree
            support[j] += agree
    support = ((support + 1) / len(candidates)).astype(np.float32)
    best = support.argmax(axis=0)
    image = np.take_along_axis(candidates, best[None, ..., None], axis=0)[0]
    settled = support.max(axis=0) >= agreement
    image = _grow(image, settled, np.where(support[..., None] > 1.5 / len(candidates), candidates, np.inf))
    background = np.round(image).astype(np.uint8)
    checked = [cv2.absdiff(adjust_intensity(one, background), background) for one in stack[:: max(1, len(stack) // 8)]]
    return Background(background, float(np.median(checked)) * 1.4826)


def _grow(image: FloatArray, settled: Mask, candidates: FloatArray) -> FloatArray:
    """Fill the unsettled pixels from the rim inwards with the candidate nearest to the settled mean around."""
    image, settled, accept = image.copy(), settled.copy(), 8.0
    while settled.any() and not settled.all():
        weight = cv2.boxFilter(settled.astype(np.float32), -1, (11, 11))
        around = cv2.boxFilter(image * settled[..., None], -1, (11, 11)) / np.maximum(weight, 1e-6)[..., None]
        rim = ~settled & (weight > 0.15)
        if not rim.any():
            rim = ~settled & (weight > 1e-6)
        y, x = np.nonzero(rim)
        distance = np.abs(candidates[:, y, x] - around[y, x]).max(axis=-1)
        choice = distance.argmin(axis=0)
        good = distance.min(axis=0) <= accept
        if good.mean() < 0.02:  # the sure pixels are used up: take less sure ones
            accept *= 1.5
            if accept < 1.5 * 255:  # beyond that, only candidates without any support are left
                continue
            good = np.ones(len(y), dtype=bool)
        accept = 8.0
        y, x, choice = y[good], x[good], choice[good]
        filled = candidates[choice, y, x]
        image[y, x] = np.where(np.isfinite(filled), filled, image[y, x])
        settled[y, x] = True
    return image


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


def as_background(background: Background | npt.ArrayLike) -> Background:
    """A ``Background`` from itself or from a single uint8 RGB picture of the empty floor."""
    if isinstance(background, Background):
        return background
    return average_background([np.asarray(background)])
