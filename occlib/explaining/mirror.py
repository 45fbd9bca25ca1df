"""The mirror in the floor: how much of an object a glossy floor shows below its base, estimated from the recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled
from occlib.explaining.evidence import PolarEvidence, view_at
from occlib.explaining.objective import mirrored, workspace
from occlib.explaining.prisms import Prism, as_array, prism_at
from occlib.explaining.silhouettes import WHOLE, outline_edges, run_of, span_of

LEAST_SAMPLES = 30
"""A mirror image of fewer samples, clear of other objects, says nothing."""


@compiled
def _shares(work: Any, prisms: Any, shares: Any) -> None:
    """Fill ``shares`` (N, K): foreground in the mirror image of each prism over its samples; NaN where too few are clear."""
    for k in range(len(work.views)):
        view, rows = view_at(work.views, k), work.sizes[k, 1]
        taken = np.zeros(work.weights.shape[1:], np.bool_)
        for j in range(len(prisms)):
            prism = prism_at(prisms, j)
            span = span_of(view, work.sizes[k, 0], prism)
            for column in range(span.first, span.last):
                run = run_of(view, rows, prism, span, column)
                taken[run.low : run.high, column] = True
        for j in range(len(prisms)):
            prism = prism_at(prisms, j)
            span, weight, samples = span_of(view, work.sizes[k, 0], prism), 0.0, 0
            for column in range(span.first, span.last):
                near, _ = outline_edges(view, column, span, prism, WHOLE)
                high = run_of(view, rows, prism, span, column).high
                for row in range(high, mirrored(view, rows, near, prism.height)):
                    if not taken[row, column] and work.seen_sums[k, row + 1, column] > work.seen_sums[k, row, column]:
                        weight += max(work.weights[k, row, column], 0) / 255
                        samples += 1
            shares[j, k] = weight / samples if samples >= LEAST_SAMPLES else np.nan


def mirrored_shares(evidence: PolarEvidence, prisms: Sequence[Prism]) -> FloatArray:
    """How much of each object's mirror image each view calls foreground, (N, K) from 0 to 1.

    In a level mirror a point at height z seems to lie at -z: the image hangs below the base, in the same columns. NaN
    where other objects hide nearly all of it, or it lies outside the picture.
    """
    array = as_array(prisms, "prisms")
    shares = np.full((len(array), len(evidence.views)), np.nan)
    if len(array):
        _shares(workspace(evidence), array, shares)
    return shares
