"""Shadows and reflections told from objects by their colour: soft evidence of foreground, beyond the paper's difference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from occlib.base import checks
from occlib.base.arrays import Image
from occlib.base.kernels import compiled
from occlib.foreground.background import Background
from occlib.foreground.evidence import Evidence
from occlib.foreground.intensity import channel_gain_offset

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

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            checks.number(name, value, least=0, most=1 if name == "darkest" else None)
        checks.number("steepness", self.steepness, above=0)
        checks.number("chroma", self.chroma, above=0)
        checks.number("darkest", self.darkest, most=0.99)

    def evidence(self, image: Image, background: Background) -> Evidence:
        """:func:`foreground_evidence` of a uint8 RGB image as the evidence of a view."""
        return Evidence(foreground_evidence(image, background, shadows=self), SURE - 0.5, SURE - 1, soft=True)


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
