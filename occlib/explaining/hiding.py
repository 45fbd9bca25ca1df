"""DOC"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled
from occlib.explaining.cylinders import Cylinder, _as_array, room_for_runs, silhouette
from occlib.explaining.evidence import PolarEvidence


@compiled
def _hidden(views: Any, sizes: Any, seen: Any, things: Any, out: Any, by: Any) -> None:
    runs = room_for_runs(seen.shape[2])
    for k in range(len(views)):
        columns, rows = sizes[k]
        for i in range(len(things)):
            first, last = silhouette(
                views[k], columns, rows, things[i, 0], things[i, 1], things[i, 2], things[i, 3], runs
            )
            mine = runs[: last - first].copy()
            covered = np.zeros((last - first, rows), np.bool_)
            area = 0
            for c in range(last - first):
                area += seen[k, mine[c, 1], first + c] - seen[k, mine[c, 0], first + c]
            distance = np.hypot(things[i, 0] - views[k, 0], things[i, 1] - views[k, 1])
            most = 0
            for j in range(len(things)):
                if j == i or np.hypot(things[j, 0] - views[k, 0], things[j, 1] - views[k, 1]) >= distance:
                    continue
                start, stop = silhouette(
                    views[k], columns, rows, things[j, 0], things[j, 1], things[j, 2], things[j, 3], runs
                )
                own = 0
                for column in range(max(first, start), min(last, stop)):
                    for row in range(
                        max(mine[column - first, 0], runs[column - start, 0]),
                        min(mine[column - first, 1], runs[column - start, 1]),
                    ):
                        if seen[k, row + 1, column] > seen[k, row, column]:
                            covered[column - first, row] = True
                            own += 1
                if own > most:
                    most, by[i, k] = own, j
            out[i, k] = covered.sum() / area if area else np.nan


def occlusion_state(evidence: PolarEvidence, things: Sequence[Cylinder]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """How much of each object nearer objects hide from each camera, from geometry.

    Returns
    -------
    fractions
        (N, K): 0 plain, 1 entirely hidden; NaN where the object lies outside the picture.
    by
        (N, K): index of the object that hides most of it, -1 if none does.

    Raises
    ------
    ValueError
        A place or size that is not finite, or a size that is not positive.
    """
    array = _as_array(things, "things")
    fractions = np.zeros((len(array), len(evidence.views)))
    by = np.full(fractions.shape, -1, np.int64)
    if len(array):
        _hidden(evidence.views, evidence.sizes, evidence.seen_sums, array, fractions, by)
    return fractions, by
