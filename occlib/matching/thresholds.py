"""From scores to a threshold: a number that is checked, or a rule that reads it from the similarity image."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.matching.measures import Array, Method, known_method

THRESHOLDS = ("otsu", "mad")

SPREAD = 5.0
"""Standard deviations, estimated robustly, between the similarity image's median and the threshold ``"mad"``."""

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
        values = values[np.isfinite(values)]
        if values.size == 0 or np.ptp(values) <= ROUNDING * np.abs(values).max():
            return float("nan")
        if threshold == "otsu":
            from skimage.filters import threshold_otsu

            return float(threshold_otsu(values))
        middle = float(np.median(values))
        deviations = np.abs(values - middle)
        spread = 1.4826 * float(np.median(deviations)) or 1.2533 * float(deviations.mean())
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
