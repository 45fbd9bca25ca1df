"""The evidence of one view: how surely each pixel shows an object, and from where on that is foreground (sections 2, 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import Image, Mask
from occlib.foreground.background import Background
from occlib.foreground.difference import smooth, subtract_background
from occlib.foreground.threshold import threshold_level

CONTRAST = 2.5
"""A difference counts as surely an object from ``1 + 1 / CONTRAST`` times its threshold on."""


class Evidence(NamedTuple):
    """What one view says of each of its pixels, before it is thresholded on the floor.

    Parameters
    ----------
    values
        uint8 (H, W), higher means more surely an object.
    threshold
        Where object and background are equally likely, in the units of ``values``.
    level
        Values above it are foreground: the threshold in whole numbers, never below the noise.
    soft
        Whether ``values`` are odds, 0 surely background to 255 surely object. Else they are a difference in grey levels.
    """

    values: Image
    threshold: float
    level: int
    soft: bool

    @classmethod
    def of_mask(cls, mask: Mask) -> Evidence:
        """A mask, bool (H, W), as evidence that is sure of every pixel."""
        return cls(np.where(mask, np.uint8(255), np.uint8(0)), 127.5, 127, soft=True)

    def core_level(self, factor: float) -> int:
        """The level of surer evidence, ``factor`` times the threshold, never below ``level``.

        >>> Evidence(np.zeros((1, 1), np.uint8), 40.0, 40, soft=False).core_level(1.5)
        60
        """
        return int(max(self.level, factor * self.threshold))

    def weights(self) -> npt.NDArray[np.float32]:
        """For each value 0 to 255 what it says, -255 surely background to 255 surely object, 0 at the level; float32 (256,)."""
        steepness = 2.0 if self.soft else CONTRAST * 255 / max(self.level, 1)
        return np.clip((np.arange(256) - (self.level + 0.5)) * steepness, -255, 255).astype(np.float32)


@dataclass(frozen=True)
class Difference:
    """Evidence from the difference to the background: subtract, smooth, threshold (sections 4 and 5; Fig 6).

    Parameters
    ----------
    threshold
        ``"otsu"`` (the paper's), ``"half-otsu"``, ``"triangle"``, ``"noise"`` or grey levels, see
        :func:`occlib.foreground.threshold.threshold_level`. It is applied on the floor, to the transformed view as section 5
        has it: thresholding first would stretch hard tiles over the floor.
    colour
        Subtract the three channels rather than the grey levels.
    smoothing_px
        Side of the Gaussian in px, odd.
    min_level
        Grey levels that a threshold found by a rule is never below; six sigma of the noise are always kept.
    """

    threshold: str | float = "half-otsu"
    colour: bool = True
    smoothing_px: int = 5
    min_level: float = 30.0

    def __post_init__(self) -> None:
        threshold_level(np.zeros((1, 1), np.uint8), self.threshold)  # an unknown one is found out now
        smooth(np.zeros((1, 1), np.uint8), size=self.smoothing_px)

    def evidence(self, image: Image, background: Background) -> Evidence:
        """The smoothed difference of a uint8 RGB image from its background, and its threshold in grey levels."""
        difference = smooth(subtract_background(image, background, colour=self.colour), size=self.smoothing_px)
        threshold = threshold_level(difference, self.threshold)
        ruled = isinstance(self.threshold, str)
        level = max(threshold, self.min_level, background.noise_floor) if ruled else threshold
        # whole levels: the same decision on whole grey levels, without a detour through floats
        return Evidence(difference, threshold, int(level), soft=False)
