"""DOC"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy  # whose `stats` loads when used, and slowly

from occlib.base.arrays import FloatArray

if TYPE_CHECKING:
    import pandas as pd

STEP = 0.05  # of an area, the least that a lost target costs


def wilson_interval(hits: npt.ArrayLike, count: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """95 % interval of a proportion (Wilson 1927); NaN for a count of 0.

    >>> [round(float(end), 3) for end in wilson_interval(8, 10)]
    [0.49, 0.943]
    """
    k, n, z = np.asarray(hits, float), np.asarray(count, float), float(scipy.stats.norm.ppf(0.975))
    n = np.where(n > 0, n, np.nan)
    middle = (k + z * z / 2) / (n + z * z)
    half = z / (n + z * z) * np.sqrt(k * (n - k) / n + z * z / 4)
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)


def t_interval(values: npt.ArrayLike) -> tuple[float, float, float]:
    """Mean and 95 % t-interval of independent values (one a seed); NaN are left out, and fewer than two have no ends.

    >>> [round(end, 3) for end in t_interval([1, 2, 3])]
    [2.0, -0.484, 4.484]
    """
    kept = np.asarray(values, float)
    kept = kept[np.isfinite(kept)]
    if len(kept) < 2:
        return (float(kept[0]) if len(kept) else np.nan), np.nan, np.nan
    half = float(scipy.stats.t.ppf(0.975, len(kept) - 1) * kept.std(ddof=1) / np.sqrt(len(kept)))
    return float(kept.mean()), float(kept.mean()) - half, float(kept.mean()) + half


def stratified_interval(values: pd.Series[float]) -> tuple[float, float, float]:
    """Mean over sources and its 95 % interval over seeds; ``values`` has the index levels ``source`` and ``seed``.

    The sources are the same on every run and the seeds redraw the targets in them, so what differs between sources
    is no error: the variance is the mean one within sources, and a t-distribution has its degrees of freedom.
    Where (nearly) nothing varied among ``n`` values it is taken as ``3 / n`` times 0.05 squared: what happened to none
    of ``n`` may still happen to 3 of ``n`` (the rule of three), and then costs an area a step. NaN are left out, and
    there are no ends where a source has one seed.

    >>> import pandas as pd
    >>> index = pd.MultiIndex.from_product([["a", "b"], [0, 1, 2]], names=["source", "seed"])
    >>> [round(end, 3) for end in stratified_interval(pd.Series([1, 2, 3, 11, 12, 13.0], index))]
    [7.0, 5.867, 8.133]
    """
    groups = values.dropna().groupby(level="source")
    mean, freedom = float(groups.mean().mean()), int((groups.size() - 1).sum())
    variance = groups.apply(lambda group: ((group - group.mean()) ** 2).sum()).sum() / max(freedom, 1)
    if (groups.size() < 2).any():
        return mean, np.nan, np.nan
    variance = max(variance, 3 / groups.size().sum() * STEP**2)
    half = float(scipy.stats.t.ppf(0.975, freedom) * np.sqrt(variance * (1 / groups.size()).sum()) / len(groups))
    return mean, mean - half, mean + half


def _log_interval(values: pd.Series[float]) -> tuple[float, ...]:
    """As :func:`t_interval` for what is positive and skewed; a length of exactly 0 counts as a thousandth."""
    return tuple(float(np.exp(end)) for end in t_interval(np.log(values.clip(lower=1e-3))))
