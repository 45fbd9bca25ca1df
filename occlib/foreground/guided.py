"""Evidence that follows the edges of the change: in a window, px that have changed alike get like evidence.

A px at an object's rim shows part of the floor. It counts as object where at least half of it is: where it has changed less than
halfway between the least and the largest change around it, the least evidence there takes its place (the lower half of a toggle mapping,
Kramer and Bruckner 1975). Then, in each window, evidence becomes a line in the change of the px, fitted by least squares (guided filter, He,
Sun and Tang 2013): noise is averaged out and edges stay. Both is done at half of the picture's size, and the lines applied to its px.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from occlib.base.arrays import Image
from occlib.base.kernels import compiled
from occlib.foreground.pictures import halved

WINDOW = 5
"""Side of the window in px of the halved picture."""

SQUARE = np.ones((3, 3), np.uint8)
"""The px around a px, in which the least and the largest change are looked for."""

SMOOTH = 5.0
"""Variance of the change in grey levels squared that is no edge."""


def follow_edges(evidence: Image, change: Image) -> Image:
    """The evidence, uint8 (H, W), smoothed along the edges of the change, uint8 (H, W) in grey levels; single px are left out first."""
    coarse, result = np.asarray(cv2.medianBlur(halved(evidence), 3)), np.zeros_like(evidence)
    left, top, width, height = cv2.boundingRect(coarse)
    if width:
        rows, columns = (
            slice(max(0, first - WINDOW), first + size + WINDOW) for first, size in ((top, height), (left, width))
        )
        coarse, guide = coarse[rows, columns], halved(change)[rows, columns]
        low, high, least = cv2.erode(guide, SQUARE), cv2.dilate(guide, SQUARE), cv2.erode(coarse, SQUARE)
        rim = guide < cv2.addWeighted(low, 0.5, high, 0.5, 0)
        slope, intercept = _lines(guide.astype(np.float32), np.where(rim, least, coarse).astype(np.float32))
        _apply(change, slope, intercept, rows.start, columns.start, result)
    return result


def _lines(guide: Any, values: Any) -> tuple[Any, Any]:
    """Slope and intercept of the line from the guide to the values, the mean of those of all windows around each px."""

    def mean(one: Any) -> Any:
        return cv2.blur(one, (WINDOW, WINDOW))

    middle, level = mean(guide), mean(values)
    slope = (mean(guide * values) - middle * level) / (mean(guide * guide) - middle * middle + SMOOTH)
    return mean(slope), mean(level - slope * middle)


@compiled
def _apply(guide: Any, slope: Any, intercept: Any, top: Any, left: Any, out: Any) -> None:
    rows, columns = slope.shape
    for y in range(2 * top, min(2 * (top + rows), out.shape[0])):
        v = y // 2 - top
        for x in range(2 * left, min(2 * (left + columns), out.shape[1])):
            u = x // 2 - left
            value = slope[v, u] * np.float32(guide[y, x]) + intercept[v, u] + np.float32(0.5)
            out[y, x] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))
