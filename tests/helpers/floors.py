"""Pictures of an empty floor, lit otherwise and noisy."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

Pixels = np.ndarray[Any, np.dtype[np.uint8]]
HEIGHT, WIDTH = 120, 160


def as_uint8(levels: Any) -> Pixels:
    return np.asarray(np.clip(np.round(levels), 0, 255), dtype=np.uint8)


def textured_floor(seed: int = 0) -> Pixels:
    """A floor with shading from 70 to 180 grey levels, a slight tint and grain."""
    rng = np.random.default_rng(seed)
    shade = np.linspace(90, 160, WIDTH)[None, :, None] + np.linspace(-20, 20, HEIGHT)[:, None, None]
    return as_uint8(shade + np.array([4, 0, -6]) + rng.normal(0, 4, (HEIGHT, WIDTH, 3)))


def relit(image: Pixels, gain: float, offset: float) -> Pixels:
    """The frame for which ``image = gain * frame + offset``."""
    return as_uint8((image - offset) / gain)


def noisy(image: Pixels, sigma: float, rng: np.random.Generator) -> Pixels:
    return as_uint8(image + rng.normal(0, sigma, image.shape))


def large_floor() -> Pixels:
    return as_uint8(cv2.resize(textured_floor(), (320, 240), interpolation=cv2.INTER_CUBIC))
