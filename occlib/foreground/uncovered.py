"""Floor that an object of the background's pictures has left: it differs, and is no object.

Where a robot stood when the background was taken, each frame shows bare floor, which differs from it. The outline of such a region of
change is an edge in the background and none in the frame (Cucchiara et al. 2003, "Detecting moving objects, ghosts, and shadows in
video streams").
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.kernels import compiled

FAINTER = 0.4
"""The frame's gradient on the outline is no more than so many times the background's where the floor was uncovered."""

SHARE = 0.8
"""Share of the outline where that is so, for a region to be uncovered floor."""

LEAST_EDGE = 10.0
"""Grey levels over two px that are an edge."""


REACH = 11
"""Side in px of the window around the outline in which its edge is looked for: texture is compared in windows, which widens regions."""


@compiled
def _outline(labels: Any, background: Any, frame: Any, count: Any) -> Any:
    """Of each region the px of its outline: edges of either picture, and those that are edges in the background alone."""
    rows, columns = labels.shape
    votes = np.zeros((count, 3), np.int64)
    for y in range(rows):
        for x in range(columns):
            label = labels[y, x]
            if label == 0:
                continue
            if 0 < y < rows - 1 and 0 < x < columns - 1:
                if labels[y - 1, x] and labels[y + 1, x] and labels[y, x - 1] and labels[y, x + 1]:
                    continue
            p, f = np.float32(background[y, x]), np.float32(frame[y, x])
            votes[label, 0] += 1
            votes[label, 1] += max(p, f) > LEAST_EDGE
            votes[label, 2] += p > LEAST_EDGE and f < FAINTER * p
    return votes


def uncovered_floor(
    foreground: npt.NDArray[np.bool_], background: npt.NDArray[np.float32], frame: npt.NDArray[np.float32]
) -> npt.NDArray[np.bool_]:
    """Which px of the foreground are floor that the background's object has left.

    Parameters
    ----------
    foreground
        bool (H, W).
    background, frame
        Strength of the edges of the predicted background and of the frame, grey levels over two px, float32 (H, W).
    """
    count, labels = cv2.connectedComponents(foreground.view(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    if count == 1:
        return np.zeros_like(foreground)
    square = np.ones((REACH, REACH), np.uint8)
    strongest = [cv2.dilate(cv2.convertScaleAbs(one), square) for one in (background, frame)]
    votes = _outline(labels, *strongest, count)
    uncovered = (votes[:, 2] > SHARE * votes[:, 1]) & (votes[:, 1] > 0.5 * votes[:, 0])
    uncovered[0] = False
    if not uncovered.any():
        return np.zeros_like(foreground)
    return np.asarray(cv2.dilate(uncovered[labels].view(np.uint8), np.ones((3, 3), np.uint8)).view(np.bool_))
