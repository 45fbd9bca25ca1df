"""Two views, one map: the fusion rule, and who hides whom (section 5; Figs 8, 11).

Think of each camera as a lamp and of its foreground, warped to the floor, as the shadow cast. One shadow is far
larger than the object. The AND of two shadows is the umbra of both lamps: it contains the base of every object that both
views segmented, and little else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.geometry import FloatArray, Image, Mask

RULES: dict[str, Callable[[Any, Any], Any]] = {"and": np.minimum, "or": np.maximum}
"""Fusion rules by name: how the evidence of two views is joined, and then a third's with the result."""


def fuse(evidence: Sequence[Image], rule: str = "and", *, visible: Sequence[Mask] | None = None) -> Image:
    """Join the views' evidence on the floor (section 5).

    Parameters
    ----------
    evidence
        One array (ny, nx) a view, all of one shape and dtype: bool masks, or soft evidence where higher means more
        surely occupied. For ``"and"`` the soft result is the smallest evidence, so that thresholding the result equals
        the AND of the thresholded views.
    rule
        ``"and"``: occupied where *every* view says so (the paper's). ``"or"``: where any does.
    visible
        Bool (ny, nx) a view: a view says nothing about cells it cannot see. None if every view sees every cell. A cell
        that no view sees is 0.

    Returns
    -------
    Array (ny, nx) of the evidence's dtype.

    Examples
    --------
    >>> fuse([np.array([[True, True, False]]), np.array([[True, False, False]])]).tolist()
    [[True, False, False]]
    """
    if rule not in RULES:
        raise ValueError(f"rule: expected one of {', '.join(RULES)}, got {rule!r}")
    views = [np.asarray(view) for view in evidence]
    if not views:
        raise ValueError("evidence: expected at least one view, got none")
    if any(view.shape != views[0].shape or view.dtype != views[0].dtype or view.ndim != 2 for view in views):
        raise ValueError(f"evidence: expected one shape and dtype, got {[(v.shape, str(v.dtype)) for v in views]}")
    if views[0].dtype.kind == "f" and not all(np.isfinite(view).all() for view in views):
        raise ValueError("evidence: expected finite numbers, got NaN or infinity")
    if visible is None:
        return np.asarray(reduce(RULES[rule], views[1:], views[0].copy()))
    if len(visible) != len(views) or any(np.shape(seen) != views[0].shape for seen in visible):
        raise ValueError(f"visible: expected {len(views)} masks of shape {views[0].shape}")
    if views[0].dtype == np.bool_:
        neutral: Any = rule == "and"
    elif views[0].dtype.kind == "f":
        neutral = np.inf if rule == "and" else -np.inf
    else:
        limits = np.iinfo(views[0].dtype)
        neutral = limits.max if rule == "and" else limits.min
    fused = reduce(
        RULES[rule], [np.where(seen, v, np.array(neutral, v.dtype)) for v, seen in zip(views, visible, strict=True)]
    )
    return np.asarray(np.where(np.any(visible, axis=0), fused, np.zeros((), views[0].dtype)))


def truth_table() -> list[dict[str, Any]]:
    """The AND rule's complete truth table, and what the paper's listing says for each row.

    The paper lists ``left < Th, right < Th`` twice (rows 3 and 4) and never ``left > Th, right < Th``; the text and
    Fig 8(a) leave no doubt that the missing row gives 0. ``left = Th`` is not listed at all; here it counts as ``<``.
    """
    printed = {(True, True): "1", (False, True): "0", (False, False): "0 (twice)", (True, False): "missing"}
    return [
        {"left": left, "right": right, "output": left and right, "as printed": printed[left, right]}
        for left in (True, False)
        for right in (True, False)
    ]


def hidden_fractions(
    labels: npt.NDArray[np.int32],
    masks: Sequence[Mask],
    stations: Sequence[npt.ArrayLike],
    *,
    rays: int = 16,
    step: int = 3,
) -> FloatArray:
    """How much of each object's base every camera has behind another object, from the floor map alone.

    From cells of the object a sight-line is walked back towards the point below the camera for as long as this view calls the
    cells foreground. If it meets another object on the way, that object hides the cell.

    Parameters
    ----------
    labels
        Int (ny, nx): 0 free, 1 ... n the objects.
    masks
        The single views' foreground on the floor, bool (ny, nx) each.
    stations
        The point of the floor below each camera in cells ``(ix, iy)``; may lie outside the map.
    rays
        At most this many cells of an object are tested, evenly chosen.
    step
        Cells between two samples of a sight-line.

    Returns
    -------
    Shape (n, views): 0 plain, 1 entirely behind other objects.
    """
    count = int(labels.max(initial=0))
    fractions = np.zeros((count, len(masks)))
    iy, ix = np.divmod(np.flatnonzero(labels > 0), labels.shape[1])
    own = labels[iy, ix]
    order = np.argsort(own, kind="stable")
    bounds = np.searchsorted(own[order], np.arange(1, count + 2))
    chosen = np.concatenate(
        [order[a + np.arange(min(rays, b - a)) * (b - a) // max(1, min(rays, b - a))] for a, b in pairwise(bounds)]
        or [np.empty(0, np.intp)]
    )
    if not len(chosen):
        return fractions
    cells, own = np.column_stack([ix, iy])[chosen].astype(float), own[chosen]
    tested = np.maximum(np.bincount(own, minlength=count + 1)[1:], 1)  # a label without cells hides nowhere
    ny, nx = labels.shape
    for view, (mask, station) in enumerate(zip(masks, stations, strict=True)):
        line = np.asarray(station, float) - cells
        length = np.linalg.norm(line, axis=1)
        t = np.arange(step, min(length.max(), np.hypot(nx, ny)) + step, step)
        share = np.minimum(t, length[:, None]) / np.maximum(length[:, None], 1e-9)
        x, y = (np.rint(cells[:, None, i] + line[:, None, i] * share).astype(np.intp) for i in (0, 1))
        on_map = (x >= 0) & (y >= 0) & (x < nx) & (y < ny)
        x[~on_map] = y[~on_map] = 0
        unbroken = np.logical_and.accumulate(on_map & mask[y, x], axis=1)
        met = labels[y, x]
        hidden = (unbroken & (met > 0) & (met != own[:, None])).any(axis=1)
        fractions[:, view] = np.bincount(own, hidden, count + 1)[1:] / tested
    return fractions
