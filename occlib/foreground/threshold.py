"""Thresholds of a difference image: Otsu's, half of it, the triangle rule, or a fixed level (section 4)."""

from __future__ import annotations

from collections.abc import Callable

import cv2

from occlib.base import checks
from occlib.base.arrays import Image


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
    return checks.number("threshold", threshold, least=0, unit="grey levels")
