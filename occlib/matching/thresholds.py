"""From scores to a threshold: a number that is checked, or a rule that reads it from the similarity image."""

from __future__ import annotations

import warnings
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base.kernels import compiled
from occlib.matching.measures import Array, Method, known_method

THRESHOLDS = ("otsu", "mad")

_warned: set[Method] = set()

SPREAD = 5.0
"""Standard deviations, estimated robustly, between the similarity image's median and the threshold ``"mad"``."""

OTSU_BINS = 256
"""Bins of the histogram that ``"otsu"`` splits."""

ROUNDING = 1e-12
"""A similarity image whose scores differ by less than this share of the largest is constant."""


def score_threshold(score: npt.ArrayLike, method: str, threshold: Any) -> float:
    """The worst score to accept, from a number or from the similarity image itself.

    Parameters
    ----------
    score
        Similarity image of ``method``, any shape; infinite where there is no score.
    method
        One of :data:`METHODS`.
    threshold
        ``"otsu"`` splits the scores in two classes; ``"mad"`` is the median, moved to the better side by 5
        robust standard deviations (1.4826 times the median absolute deviation; where that is 0, 1.2533 times the
        mean absolute deviation, Iglewicz and Hoaglin 1993). A number, in the range of the measure, is returned as
        it is.

    Returns
    -------
    float
        NaN, which no score reaches, for ``"otsu"`` and ``"mad"`` of a constant similarity image.

    Examples
    --------
    >>> round(score_threshold([8, 9, 10, 11, 12], "sad", "mad"), 3)
    2.587
    """
    measure = known_method(method)
    if isinstance(threshold, str) and threshold in THRESHOLDS:
        values = np.asarray(score, dtype=np.float64)
        if not np.isfinite([values.min(initial=0), values.max(initial=0)]).all():
            values = values[np.isfinite(values)]
        values = values.ravel()
        if values.size == 0 or np.ptp(values) <= ROUNDING * max(-values.min(), values.max()):
            return float("nan")
        if threshold == "otsu":
            from skimage.filters import threshold_otsu

            edges = np.linspace(values.min(), values.max(), OTSU_BINS + 1)
            return float(threshold_otsu(hist=(_counts(values, edges), (edges[:-1] + edges[1:]) / 2)))
        middle = _median(values)
        deviations = np.abs(values - middle)
        spread = 1.4826 * _median(deviations) or 1.2533 * float(deviations.mean())
        return middle + (SPREAD if measure.higher_is_better else -SPREAD) * spread
    if isinstance(threshold, bool) or not isinstance(threshold, Real) or not np.isfinite(float(threshold)):
        raise ValueError(
            f"threshold: expected a finite number, {', '.join(map(repr, THRESHOLDS))} or None, got {threshold!r}"
        )
    if not measure.bounds[0] <= float(threshold) <= measure.bounds[1]:
        low, high = measure.bounds
        raise ValueError(f"threshold: expected {low:g} to {high:g} for {measure.name}, got {threshold}")
    return float(threshold)


def own_threshold(measure: Method, image: Array, template: Array, mask: Array) -> float | str:
    """What a measure accepts by default: a number, or the name of a rule."""
    own = measure.default_threshold
    return own if isinstance(own, str) else own(image, template, mask)


def warn_outside(measure: Method, limit: float) -> None:
    """Warn, once a measure, of a default threshold outside its bounds: it accepts nothing, or everything."""
    low, high = measure.bounds
    if measure in _warned or np.isnan(limit) or low <= limit <= high:
        return
    _warned.add(measure)
    nothing = limit > high if measure.higher_is_better else limit < low
    warnings.warn(
        f"{measure.name}: its default threshold is {limit:.4g}, outside its bounds {low:g} to {high:g}, so it accepts "
        f"{'nothing' if nothing else 'everything'}; give the matcher a default_threshold",
        UserWarning,
        stacklevel=3,
    )


@compiled
def _counts(values: Array, edges: Array) -> Array:  # pragma: no cover
    """How many values lie from each edge to the next, the last one included: ``np.histogram``, several times faster."""
    bins = len(edges) - 1
    counts = np.zeros(bins, np.int64)
    for value in values:
        place = min(int((value - edges[0]) / (edges[-1] - edges[0]) * bins), bins - 1)
        if value < edges[place]:  # the edges decide, not the rounding of the line above
            place -= 1
        elif place < bins - 1 and value >= edges[place + 1]:
            place += 1
        counts[place] += 1
    return counts


def _median(values: Array) -> float:
    """``np.median`` of finite numbers: only those that share a bin with the middle are put in order."""
    middle, before = _middle_of(values, 4 * OTSU_BINS)
    low, high = (len(values) - 1) // 2 - before, len(values) // 2 - before
    ordered = np.partition(middle, (low, high))
    return float((ordered[low] + ordered[high]) / 2)


@compiled
def _middle_of(values: Array, bins: int) -> tuple[Array, int]:  # pragma: no cover
    """The values in the bins of the two in the middle, and how many are below these."""
    low, high = values.min(), values.max()
    scale = bins / (high - low) if high > low else 0.0
    counts = np.zeros(bins + 1, np.int64)
    for value in values:
        counts[int((value - low) * scale)] += 1
    wanted = ((len(values) - 1) // 2, len(values) // 2)
    first, before = 0, 0
    while before + counts[first] <= wanted[0]:
        before += counts[first]
        first += 1
    last, upto = first, before + counts[first]
    while upto <= wanted[1]:
        last += 1
        upto += counts[last]
    kept = np.empty(upto - before, values.dtype)
    count = 0
    for value in values:
        if first <= int((value - low) * scale) <= last:
            kept[count] = value
            count += 1
    return kept, before
