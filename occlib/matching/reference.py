"""The built-in measures written as their definitions read: slow, for readers and for tests of the fast ones.

:func:`reference_similarity` is to :func:`occlib.matching.search.similarity` what a definition is to a program.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray
from occlib.matching.arguments import checked
from occlib.matching.edges import edge_pixels
from occlib.matching.measures import FLAT, Array, Measure, scaled


def _slide(image: Array, template: Array, mask: Array, measure: Callable[..., float]) -> FloatArray:
    """Eq 1: ``measure(t, f, w)`` of the (n, channels) values of the template and of each window, and their weights."""
    h, w = mask.shape
    used = mask > 0
    t, weights = template[used].astype(np.float64), mask[used].astype(np.float64)[:, None]
    scores = np.empty((image.shape[0] - h + 1, image.shape[1] - w + 1))
    for r in range(scores.shape[0]):
        for c in range(scores.shape[1]):
            scores[r, c] = measure(t, image[r : r + h, c : c + w][used].astype(np.float64), weights)
    return scores


def _ssd(image: Array, template: Array, mask: Array) -> FloatArray:
    return _slide(image, template, mask, lambda t, f, w: float((w * (t - f) ** 2).sum() / (w.sum() * t.shape[1])))


def _sad(image: Array, template: Array, mask: Array) -> FloatArray:
    return _slide(image, template, mask, lambda t, f, w: float((w * np.abs(t - f)).sum() / (w.sum() * t.shape[1])))


def _ncc(image: Array, template: Array, mask: Array, *, centred: bool = False) -> FloatArray:
    image, [(template, mask)] = scaled(image, [(template, mask)], remove_offset=centred)
    least = FLAT**2 if image.dtype.kind == "f" else 0.0

    def ncc(t: FloatArray, f: FloatArray, w: FloatArray) -> float:
        if centred:
            t, f = t - (w * t).sum(axis=0) / w.sum(), f - (w * f).sum(axis=0) / w.sum()
        energies = (w * t * t).sum(), (w * f * f).sum()
        if min(energies) <= least * w.sum() * t.shape[1]:
            return 0.0
        return float((w * t * f).sum() / np.sqrt(energies[0] * energies[1]))

    return _slide(image, template, mask, ncc)


def _sed(image: Array, template: Array, mask: Array) -> FloatArray:
    edges, (template_edges,) = edge_pixels(image, [template])
    weights = mask * template_edges
    scores = np.full((image.shape[0] - mask.shape[0] + 1, image.shape[1] - mask.shape[1] + 1), 0.0)
    if not edges.any() or not weights.any():
        return scores + image.shape[0] ** 2 + image.shape[1] ** 2
    targets, places = np.argwhere(edges), np.argwhere(weights)
    for r in range(scores.shape[0]):
        for c in range(scores.shape[1]):
            nearest = [((targets - (r + u, c + v)) ** 2).sum(axis=1).min() for u, v in places]
            scores[r, c] = np.average(nearest, weights=weights[tuple(places.T)])
    return scores


REFERENCES: dict[str, Measure] = {
    "ssd": _ssd,
    "sad": _sad,
    "ncc": _ncc,
    "zncc": partial(_ncc, centred=True),
    "sed": _sed,
}
"""The literal forms by the name of their measure."""


def reference_similarity(
    image: npt.ArrayLike, template: npt.ArrayLike, method: str = "ssd", mask: npt.ArrayLike | None = None
) -> FloatArray:
    """The same as :func:`occlib.matching.search.similarity`, computed literally as Eq 1 reads. Slow.

    Only for the measures of :data:`REFERENCES`; ``ValueError`` for others, as those of your own.

    >>> reference_similarity([[1, 2, 3]], [[2, 4]], "ssd")
    array([[2.5, 0.5]])
    """
    if not isinstance(method, str) or method not in REFERENCES:
        raise ValueError(f"method: expected one of {', '.join(REFERENCES)}, got {method!r}")
    return REFERENCES[method](*checked(image, template, mask))
