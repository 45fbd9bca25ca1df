"""What may come between a camera and its room: other light, noise, and covers over a share of the picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np

Array = np.ndarray[Any, Any]
PATTERNED = ("cloth", "knitting", "grass")


def noisy(picture: Array, rng: np.random.Generator, sigma: float = 2.0) -> Array:
    return np.clip(picture + rng.normal(0, sigma, picture.shape), 0, 255).astype(np.uint8)


def lit(picture: Array, gain: float, offset: float) -> Array:
    return np.clip(picture.astype(float) * gain + offset, 0, 255).astype(np.uint8)


def covers(shape: Sequence[int], rng: np.random.Generator) -> dict[str, Array]:
    """What may hide a room: lens cap, wall, over-exposure, a hand in the light, cloth of coarse and fine texture."""
    height, width = shape[:2]
    y, x = np.mgrid[:height, :width]
    plain = {
        "cap": np.full((height, width), 3.0),
        "wall": np.full((height, width), 120.0),
        "white": np.full((height, width), 254.0),
        "hand": 60 + 90 * x / width + 50 * np.sin(3.0 * y / height),
    }
    for name, sigma in (("cloth", 120.0), ("knitting", 40.0), ("grass", 10.0)):
        coarse = rng.normal(0, 1, (round(height / sigma) + 2, round(width / sigma) + 2))
        texture = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        plain[name] = 110 + 35 * texture / texture.std()
    return {name: noisy(np.dstack([grey] * 3), rng) for name, grey in plain.items()}


def hide(picture: Array, cover: Array, share: float) -> Iterator[Array]:
    """The picture with a share of its area hidden: from the left, right, top, bottom, and in the middle."""
    height, width = picture.shape[:2]
    w, h, root = round(width * share), round(height * share), share**0.5
    top, left = round(height * (1 - root) / 2), round(width * (1 - root) / 2)
    middle = (slice(top, height - top), slice(left, width - left))
    for where in (np.s_[:, :w], np.s_[:, width - w :], np.s_[:h], np.s_[height - h :], middle):
        hidden = picture.copy()
        hidden[where] = cover[where]
        yield hidden
