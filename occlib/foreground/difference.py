"""What has changed in a view: intensity adjustment, background, smoothing and threshold (sections 2, 4).

The chain of Figs 4-6: adjust the frame's intensity to the background's, subtract, smooth, threshold. Every
step is a function of its own, on RGB uint8 images.
"""

from __future__ import annotations

import cv2
import numpy as np

from occlib.base.arrays import Image, Mask
from occlib.foreground.background import Background
from occlib.foreground.intensity import adjust_intensity, to_grey
from occlib.foreground.threshold import threshold_level


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


def foreground_mask(
    image: Image, background: Background, *, threshold: str | float = "otsu", size: int = 5, colour: bool = False
) -> Mask:
    """The whole chain of section 4 for one view: adjust, subtract, smooth, threshold. Bool (H, W)."""
    difference = smooth(subtract_background(image, background, colour=colour), size=size)
    return np.asarray(difference > threshold_level(difference, threshold, noise_floor=background.noise_floor))
