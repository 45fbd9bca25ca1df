"""Who hides whom: the share of each object's silhouette that nearer objects cover, in each view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled
from occlib.explaining.evidence import PolarEvidence, view_at
from occlib.explaining.prisms import Prism, as_array, prism_at
from occlib.explaining.silhouettes import silhouette


@compiled
def _cover_seen(seen_sums: Any, own: Any, other: Any, covered: Any) -> int:
    """Mark in ``covered``, bool (columns of ``own``, rows), the samples seen that both silhouettes hold; their number."""
    count = 0
    first, last = max(own.first, other.first), min(own.first + len(own.low), other.first + len(other.low))
    for column in range(first, last):
        i, j = column - own.first, column - other.first
        for row in range(max(own.low[i], other.low[j]), min(own.high[i], other.high[j])):
            if seen_sums[row + 1, column] > seen_sums[row, column]:
                covered[i, row] = True
                count += 1
    return count


@compiled
def _hidden(views: Any, sizes: Any, seen_sums: Any, prisms: Any, fractions: Any, by: Any) -> None:
    """Fill ``fractions`` (samples that nearer silhouettes cover, over all seen) and ``by`` of :func:`occlusion_state`."""
    for k in range(len(views)):
        view = view_at(views, k)
        columns, rows = sizes[k]
        for i in range(len(prisms)):
            prism = prism_at(prisms, i)
            own = silhouette(view, columns, rows, prism)
            covered, area = np.zeros((len(own.low), rows), np.bool_), 0
            for c in range(len(own.low)):
                area += seen_sums[k, own.high[c], own.first + c] - seen_sums[k, own.low[c], own.first + c]
            distance = np.hypot(prism.x - view.x, prism.y - view.y)
            most = 0
            for j in range(len(prisms)):
                other = prism_at(prisms, j)
                if j != i and np.hypot(other.x - view.x, other.y - view.y) < distance:
                    shared = _cover_seen(seen_sums[k], own, silhouette(view, columns, rows, other), covered)
                    if shared > most:
                        most, by[i, k] = shared, j
            fractions[i, k] = covered.sum() / area if area else np.nan


def occlusion_state(evidence: PolarEvidence, prisms: Sequence[Prism]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """How much of each object nearer objects hide from each camera, from geometry alone.

    Parameters
    ----------
    evidence
        Of which only the views and the samples seen count.
    prisms
        The N objects.

    Returns
    -------
    fractions
        (N, K): 0 in plain view to 1 entirely hidden; NaN where the object lies outside the picture.
    by
        (N, K): index of the object that hides most of it, -1 if none does.

    Raises
    ------
    ValueError
        A place or size that is not finite, or a size that is not positive.
    """
    array = as_array(prisms, "prisms")
    fractions = np.zeros((len(array), len(evidence.views)))
    by = np.full(fractions.shape, -1, np.int64)
    if len(array):
        _hidden(evidence.views, evidence.sizes, evidence.seen_sums, array, fractions, by)
    return fractions, by
