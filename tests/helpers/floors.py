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


def tiles(shape: tuple[int, int] = (240, 320), grain: float = 6.0, level: float = 130.0, seed: int = 0) -> Pixels:
    """A floor of speckled tiles with dark joints, and some shading: plenty of texture."""
    rng = np.random.default_rng(seed)
    floor = np.full(shape, level) + cv2.GaussianBlur(rng.normal(0, 2.5 * grain, shape), (0, 0), 1.2)
    floor[::40], floor[:, ::40] = 0.6 * level, 0.6 * level
    shade = np.linspace(0.85, 1.1, shape[1])[None, :, None] * np.array([1.03, 1.0, 0.94])
    return as_uint8(cv2.GaussianBlur(floor, (0, 0), 0.7)[..., None] * shade)
