"""Two views, one map: the fusion rule, and who hides whom (section 5; Figs 8, 11).

Think of each camera as a lamp and of its foreground, warped to the floor, as the shadow cast. One shadow is far
larger than the object. The AND of two shadows is the umbra of both lamps: it contains the base of every object that both
views segmented, and little else.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, Mask

RuleFunction = Callable[[Any, Mask], npt.ArrayLike]
"""``function(views, seen)``: the views' evidence and what they see, both (K, ny, nx), to one array (ny, nx)."""


@dataclass(frozen=True)
class FusionRule:
    """A rule that joins the views' evidence, and what its callers need to know about it.

    Parameters
    ----------
    name
        How it is asked for.
    description
        One line: when is a cell occupied?
    function
        What :func:`fusion_rule` decorates.
    soft
        It weighs probabilities, and says more when it is given them than when it is given yes or no.
    planes
        It wants each view on several parallel planes above the floor, (K, planes, ny, nx).
    unanimous
        What it calls occupied is occupied in every view that sees it: its regions lie inside each view's.
    one_view_enough
        It believes a single view, so a cell that only one view sees may be occupied.
    """

    name: str
    description: str
    function: RuleFunction
    soft: bool = False
    planes: bool = False
    unanimous: bool = False
    one_view_enough: bool = False


RULES: dict[str, FusionRule] = {}
"""Fusion rules by name: those below, and those that :func:`fusion_rule` adds."""

_BUILT_IN: list[str] = []
"""The rules of this file, which keep their names; a rule of one's own may be defined again, as in a notebook."""


def fusion_rule(
    name: str,
    *,
    soft: bool = False,
    planes: bool = False,
    unanimous: bool = False,
    one_view_enough: bool = False,
) -> Callable[[RuleFunction], RuleFunction]:
    """Decorator: a rule of your own joins :data:`RULES`, and with them the pipeline's settings and ``--rule``.

    Parameters
    ----------
    name
        How it is called from now on; none of the built-in ones.
    soft, planes, unanimous, one_view_enough
        See :class:`FusionRule`.

    Notes
    -----
    The function gets the views' evidence (K, ny, nx) (for ``planes`` (K, planes, ny, nx)) and a bool array of the same shape
    that says where each view sees; what it does not see must not count. The evidence is float64 probabilities from 0 to 1 for
    a ``soft`` rule, else of any type, higher meaning more surely occupied. It returns the evidence of the cells (ny, nx), a
    soft rule their probabilities. The first line of its docstring says when a cell is occupied.

    Examples
    --------
    >>> @fusion_rule("mean", soft=True)
    ... def mean(views, seen):
    ...     "the mean of the probabilities is at least one half"
    ...     return np.where(seen, views, 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    >>> fuse([np.array([[0.9, 0.25]]), np.array([[0.7, 0.25]])], "mean")
    array([[0.8 , 0.25]])
    >>> del RULES["mean"]
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][\w-]*", name) or name in _BUILT_IN:
        taken = ", ".join(_BUILT_IN)
        raise ValueError(f"name: expected letters, digits, _ and -, and none of {taken}; got {name!r}")

    def register(function: RuleFunction) -> RuleFunction:
        text = (function.__doc__ or name).strip().splitlines()[0]
        RULES[name] = FusionRule(name, text, function, soft, planes, unanimous, one_view_enough)
        return function

    return register


def fuse(evidence: Sequence[Image], rule: str = "and", *, visible: Sequence[Mask] | None = None) -> Image:
    """Join the views' evidence on the floor (section 5).

    Parameters
    ----------
    evidence
        One array (ny, nx) a view, all of one shape and dtype: bool masks, or soft evidence where higher means more
        surely occupied. For ``"and"`` the soft result is the smallest evidence, so that thresholding the result equals
        the AND of the thresholded views. Soft rules take bool, uint8 (0 to 255) and floats in [0, 1] as probabilities.
        For ``"planes"`` (planes, ny, nx) a view: the view on parallel planes above the floor.
    rule
        One of :data:`RULES`, which say when a cell is occupied. Explaining away needs more than one cell at a time:
        :func:`occlib.explaining.search.explain`.
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
    chosen = RULES[checks.choice("rule", rule, RULES)]
    views = [np.asarray(view) for view in evidence]
    if not views:
        raise ValueError("evidence: expected at least one view, got none")
    shape, dtype = views[0].shape, views[0].dtype
    if any(v.shape != shape or v.dtype != dtype or v.ndim != (3 if chosen.planes else 2) for v in views):
        raise ValueError(f"evidence: expected one shape and dtype, got {[(v.shape, str(v.dtype)) for v in views]}")
    if chosen.planes and not shape[0]:
        raise ValueError("evidence: expected at least one plane, got none")
    if dtype.kind == "f" and not all(np.isfinite(view).all() for view in views):
        raise ValueError("evidence: expected finite numbers, got NaN or infinity")
    if visible is not None and (len(visible) != len(views) or any(np.shape(v) != shape for v in visible)):
        raise ValueError(f"visible: expected {len(views)} masks of shape {shape}")
    stack = np.stack(views)
    seen = np.ones(stack.shape, bool) if visible is None else np.stack(visible).astype(bool, copy=False)
    fused = np.asarray(chosen.function(_as_probability(stack) if chosen.soft else stack, seen))
    if fused.shape != shape[-2:]:
        raise ValueError(f"{rule}: expected a rule that returns {shape[-2:]}, got {fused.shape}")
    if visible is not None:
        fused = np.where(seen.reshape(-1, *shape[-2:]).any(axis=0), fused, np.zeros((), fused.dtype))
    return _as_evidence(fused, dtype) if chosen.soft else fused.astype(dtype, copy=False)


# --- the rules: a cell is occupied where ... ------------------------------------------------------------------
@fusion_rule("and", unanimous=True)
def _and(views: Image, seen: Mask) -> Image:
    """every view that sees it says so (the paper's); soft: the smallest evidence"""
    return np.asarray(np.minimum.reduce(_where_seen(views, seen, _limits(views.dtype)[1])))


@fusion_rule("or", one_view_enough=True)
def _or(views: Image, seen: Mask) -> Image:
    """any view says so; soft: the largest evidence"""
    return np.asarray(np.maximum.reduce(_where_seen(views, seen, _limits(views.dtype)[0])))


@fusion_rule("most")
def _most(views: Image, seen: Mask) -> Image:
    """all but one of the views that see it say so, and at least one: one missed view no longer deletes it"""
    ranked = np.sort(np.where(seen, views, _limits(views.dtype)[0]), axis=0)[::-1]  # what is not seen comes last
    second_smallest = np.maximum(seen.sum(axis=0) - 2, 0)[None]
    return np.asarray(np.take_along_axis(ranked, second_smallest, axis=0)[0])


@fusion_rule("product", soft=True)
def _product(views: FloatArray, seen: Mask) -> FloatArray:
    """the geometric mean of the probabilities is at least one half: a soft AND"""
    return np.asarray(np.exp(np.where(seen, np.log(_unsure(views)), 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)))


@fusion_rule("log-odds", soft=True)
def _log_odds(views: FloatArray, seen: Mask) -> FloatArray:
    """the sum of the log-odds is positive: each view votes with its certainty"""
    p = _unsure(views)
    return np.asarray(1 / (1 + np.exp(-np.where(seen, np.log(p / (1 - p)), 0).sum(axis=0))))


@fusion_rule("planes", soft=True, planes=True)
def _planes(views: FloatArray, seen: Mask) -> FloatArray:
    """on at least half of the planes every view says so: the body counts where the feet are not seen"""
    return np.asarray(np.where(seen.any(axis=0), _and(views, seen), 0).mean(axis=0))


_BUILT_IN.extend(RULES)


def _where_seen(views: Image, seen: Mask, neutral: Any) -> Image:
    """The evidence, and the neutral value where a view does not see the cell."""
    return views if seen.all() else np.where(seen, views, neutral)


def _limits(dtype: np.dtype[Any]) -> tuple[Any, Any]:
    """The least and the largest evidence of a type: what a view that does not see a cell must not overrule."""
    if dtype == np.bool_:
        return np.False_, np.True_
    if dtype.kind == "f":
        return dtype.type(-np.inf), dtype.type(np.inf)
    limits = np.iinfo(dtype)
    return dtype.type(limits.min), dtype.type(limits.max)


LEAST_DOUBT = 1e-3
"""No view is ever certain: probabilities are kept this far from 0 and 1, or one wrong view could never be outvoted."""


def _unsure(probability: FloatArray) -> FloatArray:
    return np.clip(probability, LEAST_DOUBT, 1 - LEAST_DOUBT)


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
