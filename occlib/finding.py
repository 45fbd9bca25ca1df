"""DOC"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Mask
from occlib.tracking import ObjectVector

HIDDEN = 0.9
"""An object is *hidden* in a view from this fraction on."""


def _confirmed_first(
    labels: npt.NDArray[np.int32], objects: Sequence[ObjectVector]
) -> tuple[npt.NDArray[np.int32], Mask]:
    """Labels of the confirmed objects alone, renumbered, and the cells of the others."""
    real = np.array([thing.id > 0 for thing in objects], bool)
    if real.all():
        return labels, np.zeros(labels.shape, bool)
    confirmed = _new_labels(real)[labels]
    return confirmed, (labels > 0) & (confirmed == 0)


def _new_labels(kept: Mask) -> npt.NDArray[np.int32]:
    """The new label of each old one, 0 to n: 1, 2, ... for what is kept, 0 for the rest."""
    return np.concatenate([[0], np.where(kept, np.cumsum(kept), 0)]).astype(np.int32)


def _visible(hidden: FloatArray, cameras: Iterable[str]) -> dict[str, float]:
    pairs = zip(cameras, hidden, strict=True)
    return {name: round(float(1 - fraction), 4) for name, fraction in pairs if np.isfinite(fraction)}


def _hidden_in(hidden: FloatArray, cameras: Iterable[str], limit: float) -> tuple[str, ...]:
    return tuple(name for name, fraction in zip(cameras, hidden, strict=True) if fraction >= limit)


def _hidden_by(
    objects: Sequence[ObjectVector], hidden: FloatArray, by: npt.NDArray[np.int64], cameras: Sequence[str]
) -> list[dict[str, tuple[float, int]]]:
    return [
        {
            name: (float(hidden[i, k]), objects[by[i, k]].id if by[i, k] >= 0 else -1)
            for k, name in enumerate(cameras)
            if hidden[i, k] > 0.5
        }
        for i in range(len(objects))
    ]
