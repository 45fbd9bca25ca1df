"""Edge pixels of an image and a template, and how far every pixel is from the nearest: what ``sed`` is made of."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from occlib.base.arrays import Mask
from occlib.matching.sums import Array, once

EDGE_IMAGE, EDGE_TEMPLATE = 40, 100
"""Gradients (``|gx| + |gy|`` of the 3x3 Sobel masks, 8 bit) above which a pixel of the image or of the
template can be an edge. The image's is lower, so the template's edges survive less light and some noise."""

EDGE_MARGIN = 3
"""Template edges closer to its border (px) depend on what lies beyond the border, and are left out."""


def edge_pixels(image: Array, templates: Sequence[Array]) -> tuple[Mask, list[Mask]]:
    """Edge pixels of the image, and those of each template that are not too near its border."""
    if image.dtype != np.uint8:
        low = min(float(a.min()) for a in (image, *templates))
        span = max(float(a.max()) for a in (image, *templates)) - low
        span = span if span > 0 else 1.0
        image, *templates = (
            np.rint((a.astype(float) - low) / span * 255).astype(np.uint8) for a in (image, *templates)
        )
    found = [_steepest(template, EDGE_TEMPLATE) for template in templates]
    for edges in found:
        edges[:EDGE_MARGIN] = edges[-EDGE_MARGIN:] = edges[:, :EDGE_MARGIN] = edges[:, -EDGE_MARGIN:] = False
    return once(_image_edges, image), found


def _image_edges(image: Array) -> Mask:
    return _steepest(image, EDGE_IMAGE)


def _steepest(picture: Array, limit: int) -> Mask:
    smooth = cv2.GaussianBlur(np.ascontiguousarray(picture), (3, 3), 0)
    return np.asarray(cv2.Canny(smooth, limit, limit) > 0)


def squared_distances(edges: Mask) -> Array:
    """Squared distance (px^2, int64) to the nearest edge pixel; the squared diagonal if there is none."""
    if not edges.any():
        return np.full(edges.shape, edges.shape[0] ** 2 + edges.shape[1] ** 2, dtype=np.int64)
    distance = cv2.distanceTransform((~edges).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.rint(distance.astype(np.float64) ** 2).astype(np.int64)
