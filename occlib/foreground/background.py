"""The background of a fixed camera, from pictures of the empty floor: its brightness and its noise, pixel by pixel."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import Image
from occlib.base.files import write_file
from occlib.foreground.intensity import _checked, to_grey
from occlib.foreground.reference import Reference, reference_of

LEAST_NOISE_FLOOR = 8.0
"""Grey levels below which a difference is never called foreground: sensor noise and JPEG blocks."""


Float32Array = npt.NDArray[np.float32]


MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation, of normal noise (Rousseeuw and Croux 1993)."""


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
    """

    image: Image
    noise: float = 0.0
    spread: Float32Array | None = None

    @property
    def noise_floor(self) -> float:
        """The least difference in grey levels that can be an object: six sigma, at least 8."""
        return max(LEAST_NOISE_FLOOR, 6.0 * self.noise)

    @cached_property
    def grey(self) -> Image:
        """The background as grey levels, uint8 (H, W)."""
        return to_grey(self.image)

    @cached_property
    def reference(self) -> Reference:
        """What frames are compared with by :func:`foreground_evidence`, made once."""
        return reference_of(self.image, self.noise, self.spread)

    @cached_property
    def _moved(self) -> dict[tuple[float, float], Background]:
        return {}

    def moved(self, x: float, y: float) -> Background:
        """The background as the camera sees it that has been bumped by so many px; the last few are kept."""
        if (x, y) not in self._moved:
            while len(self._moved) >= 4:
                del self._moved[next(iter(self._moved))]
            by, size = np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), self.image.shape[1::-1]

            def moved(picture: Image) -> Image:
                return np.asarray(cv2.warpAffine(picture, by, size, borderMode=cv2.BORDER_REPLICATE))

            spread = None if self.spread is None else moved(self.spread)
            self._moved[x, y] = Background(moved(self.image), self.noise, spread)
        return self._moved[x, y]

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
        checks.number(f"{path}: noise", noise, least=0, unit="grey levels")
        if spread is not None:
            if spread.shape != image.shape[:2] or spread.dtype != np.float32:
                raise ValueError(
                    f"{path}: spread: expected float32 {image.shape[:2]}, got {spread.dtype} {spread.shape}"
                )
            if not (np.isfinite(spread) & (spread >= 0)).all():
                raise ValueError(f"{path}: spread: expected grey levels >= 0")
        return cls(image, noise, spread)


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


def _strips(stack: Image, weights: Image) -> Iterator[tuple[slice, Image, Image]]:
    """A few rows at a time, which stay in the processor's cache: the rows, the values and their enlarged weights."""
    height, width = stack.shape[1:3]
    rows = np.arange(height) * weights.shape[1] // height
    columns = np.repeat(np.arange(width) * weights.shape[2] // width, 3)
    for top in range(0, height, 8):
        strip = slice(top, top + 8)
        part = stack[:, strip]
        yield strip, part, weights[:, rows[strip]].take(columns, axis=2).reshape(part.shape)


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


def as_background(background: Background | npt.ArrayLike) -> Background:
    """A ``Background`` from itself or from a single uint8 RGB picture of the empty floor."""
    if isinstance(background, Background):
        return background
    return average_background([np.asarray(background)])
