"""Two views, one map: the fusion rule, and who hides whom (section 5; Figs 8, 11).

Think of each camera as a lamp and of its foreground, warped to the floor, as the shadow cast. One shadow is far
larger than the object. The AND of two shadows is the umbra of both lamps: it contains the base of every object that both
views segmented, and little else.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Image, Mask

RULES = ("and", "or", "most", "product", "log-odds", "planes")
"""Fusion rules by name, see :func:`fuse`."""


def fuse(evidence: Sequence[Image], rule: str = "and", *, visible: Sequence[Mask] | None = None) -> Image:
    """Join the views' evidence on the floor (section 5).

    =========  ===================================================================================================
    rule       a cell is occupied where
    =========  ===================================================================================================
    and        *every* view that sees it says so (the paper's); soft: the smallest evidence
    or         any view says so; soft: the largest
    most       all but one of the views that see it say so, and at least one: one missed view no longer deletes it
    product    the geometric mean of the probabilities is at least one half: a soft AND
    log-odds   the sum of the log-odds is positive: each view votes with its certainty
    planes     on at least half of the planes *every* view says so: the body counts where the feet are not seen
    =========  ===================================================================================================

    Parameters
    ----------
    evidence
        One array (ny, nx) a view, all of one shape and dtype: bool masks, or soft evidence where higher means more
        surely occupied. For ``"and"`` the soft result is the smallest evidence, so that thresholding the result equals
        the AND of the thresholded views. ``product``, ``log-odds`` and ``planes`` take bool, uint8 (0 to 255) and floats in
        [0, 1] as probabilities. For ``"planes"`` (planes, ny, nx) a view: the view on parallel planes above the floor.
    rule
        One of :data:`RULES`. Explaining away needs more than one cell at a time: :func:`occlib.explaining.search.explain`.
    visible
        Bool, of the evidence's shape, a view: a view says nothing about cells it cannot see. None if every view sees every
        cell. A cell that no view sees is 0.

    Returns
    -------
    Array (ny, nx) of the evidence's dtype.

    Examples
    --------
    >>> fuse([np.array([[True, True, False]]), np.array([[True, False, False]])]).tolist()
    [[True, False, False]]
    >>> views = [np.array([[0.9, 0.9]]), np.array([[0.7, 0.2]]), np.array([[0.4, 0.4]])]
    >>> fuse(views, "most").tolist(), (fuse(views, "log-odds") > 0.5).tolist()
    ([[0.7, 0.4]], [[True, True]])
    """
    if rule not in RULES:
        raise ValueError(f"rule: expected one of {', '.join(RULES)}, got {rule!r}")
    views = [np.asarray(view) for view in evidence]
    if not views:
        raise ValueError("evidence: expected at least one view, got none")
    dimensions = 3 if rule == "planes" else 2
    if any(v.shape != views[0].shape or v.dtype != views[0].dtype or v.ndim != dimensions for v in views):
        raise ValueError(f"evidence: expected one shape and dtype, got {[(v.shape, str(v.dtype)) for v in views]}")
    if views[0].dtype.kind == "f" and not all(np.isfinite(view).all() for view in views):
        raise ValueError("evidence: expected finite numbers, got NaN or infinity")
    if visible is not None and (len(visible) != len(views) or any(np.shape(v) != views[0].shape for v in visible)):
        raise ValueError(f"visible: expected {len(views)} masks of shape {views[0].shape}")
    if rule in ("and", "or") or (rule == "planes" and len(views[0]) == 0):
        return _extreme(views, np.minimum if rule == "and" else np.maximum, visible)
    if rule == "planes":
        level = np.stack(
            [_extreme([v[p] for v in views], np.minimum, _plane(visible, p)) for p in range(len(views[0]))]
        )
        return _as_evidence(_as_probability(level).mean(axis=0), views[0].dtype)
    seen = np.ones((len(views), *views[0].shape), bool) if visible is None else np.stack(visible)
    return _joint(np.stack(views), seen, rule)


def _extreme(views: Sequence[Image], choose: Any, visible: Sequence[Mask] | None) -> Image:
    if visible is None:
        return np.asarray(reduce(choose, views[1:], views[0].copy()))
    high = choose is np.minimum  # what changes nothing
    if views[0].dtype == np.bool_:
        neutral: Any = high
    elif views[0].dtype.kind == "f":
        neutral = np.inf if high else -np.inf
    else:
        limits = np.iinfo(views[0].dtype)
        neutral = limits.max if high else limits.min
    fused = reduce(choose, [np.where(s, v, np.array(neutral, v.dtype)) for v, s in zip(views, visible, strict=True)])
    return np.asarray(np.where(np.any(visible, axis=0), fused, np.zeros((), views[0].dtype)))


def _plane(visible: Sequence[Mask] | None, plane: int) -> Sequence[Mask] | None:
    return None if visible is None else [seen[plane] for seen in visible]


def _joint(views: Image, seen: Mask, rule: str) -> Image:
    """The rules that need all views of a cell at once, (K, ny, nx)."""
    count = seen.sum(axis=0)
    if rule == "most":
        ranked = np.sort(np.where(seen, views, np.zeros((), views.dtype)), axis=0)[::-1]  # what is not seen comes last
        chosen = np.maximum(count - 2, 0)[None]
        return np.asarray(np.where(count > 0, np.take_along_axis(ranked, chosen, axis=0)[0], np.zeros((), views.dtype)))
    p = np.clip(_as_probability(views), 1e-3, 1 - 1e-3)  # no view is ever certain
    if rule == "product":
        joint = np.exp(np.where(seen, np.log(p), 0).sum(axis=0) / np.maximum(count, 1))
    else:
        joint = 1 / (1 + np.exp(-np.where(seen, np.log(p / (1 - p)), 0).sum(axis=0)))
    return _as_evidence(np.where(count > 0, joint, 0), views.dtype)


def _as_probability(evidence: Image) -> FloatArray:
    if evidence.dtype.kind == "f" and evidence.size and (evidence.min() < 0 or evidence.max() > 1):
        raise ValueError(f"evidence: expected probabilities in [0, 1], got {evidence.min():g} to {evidence.max():g}")
    return evidence / np.float64(255 if evidence.dtype == np.uint8 else 1)


def _as_evidence(probability: FloatArray, dtype: npt.DTypeLike) -> Image:
    if dtype == np.bool_:
        return np.asarray(probability >= 0.5)
    return np.asarray(np.rint(255 * probability) if dtype == np.uint8 else probability).astype(dtype)


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
