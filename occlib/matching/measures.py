"""The similarity measures of template matching (section 3, Eq 1 and 2).

The template ``t`` is moved over every location of the image ``f`` and a measure ``s`` compares the values
of its region of interest ``T`` with the window below it (Eq 1)::

    S(r, c) = s[t(u, v), f(r + u, c + v); (u, v) in T]

========  ======================================================  ============  =====================
method    measure over the ``n`` values of ``T``                  range         unmoved by
========  ======================================================  ============  =====================
``ssd``   mean of ``(t - f)^2`` (Eq 2)                            0 best, up    nothing
``sad``   mean of ``|t - f|``                                     0 best, up    nothing
``ncc``   ``sum(t f) / sqrt(sum(t^2) sum(f^2))``                  -1 .. 1 best  gain
``zncc``  ``ncc`` after removing both means, channel by channel   -1 .. 1 best  gain and offset
``sed``   mean over the template's edge pixels of the squared     0 best, up    moderate gain, offset
          distance (px^2) to the nearest edge pixel of the image
========  ======================================================  ============  =====================

``n`` counts pixels times channels, so a grey picture scores the same as its three-channel copy. With weights
``w(u, v)`` every sum and mean above is weighted, and ``n`` is their sum.

The measures here are fast: they use correlation in the frequency domain, as in Lewis's fast normalised
cross-correlation, or one pass over rows (``sad``). :mod:`occlib.matching.reference` has them as their definitions
read. Integers with a mask of true and false are summed exactly. Where sums of other numbers cancel, the few windows
concerned are computed directly.

A new measure is one more :class:`Method` in :data:`METHODS`, with its score, threshold and bounds: every table, plot
and command then has it.

This module is about arrays that :mod:`occlib.matching.search` has checked; begin there.

Sources: Sulaiman et al. (2007), IJCSNS 7(7), for SSD in the paper; Steger, Ulrich and Wiedemann, "Machine
Vision Algorithms and Applications" (MVTec), for the mean SED; Lewis (1995), "Fast normalized
cross-correlation", Vision Interface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled
from occlib.matching.edges import edge_pixels, squared_distances
from occlib.matching.sums import Array, Pairs, correlations, once, window_moments, window_sums

Measure = Callable[[Array, Array, Array], FloatArray]
"""Image (H, W, C), template (h, w, C) and mask (h, w) to scores (H - h + 1, W - w + 1)."""

FLAT = 1e-5
"""A *float* window whose spread is below this share of the picture's range is flat: the rest is rounding."""

CANCELLED = 1e-6
"""Share of the largest possible sum below which a sum of floats is taken again, directly: too few digits are left."""

UNEXPLAINED = 0.5
"""Share of the template's own contrast that a match may leave unexplained (default thresholds)."""


def unprepared(image: Array, pairs: Pairs) -> tuple[Array, Pairs]:
    """Nothing to prepare: the windows of the image itself are compared."""
    return image, pairs


@dataclass(frozen=True)
class Method:
    """A similarity measure.

    Attributes
    ----------
    name, description
        How it is called, and a few words for tables.
    higher_is_better
        Whether a high score means alike.
    score
        Takes an image (H, W, C) and a template (h, w, C) of one type, uint8, uint16 or float64, and the template's
        mask (h, w), bool or float64 weights up to 1; returns float64 (H - h + 1, W - w + 1).
    default_threshold
        Takes the same and returns the worst score to accept, or is the name of a threshold.
    prepare
        Turns the image and several pairs (template, mask) into what ``score`` compares window by window.
    bounds
        The least and the largest score.
    coarse_to_fine
        Whether a smaller picture can tell where to look first (the option ``pyramid`` of
        :func:`occlib.matching.search.find`): so for what compares grey values, difference by difference or product by
        product. ``sed`` is no slower in full, and of a measure of your own nothing is known.
    centred
        Whether means are removed first, so that no offset moves the score.
    """

    name: str
    description: str
    higher_is_better: bool
    score: Measure
    default_threshold: Callable[[Array, Array, Array], float] | str
    prepare: Callable[[Array, Pairs], tuple[Array, Pairs]] = unprepared
    bounds: tuple[float, float] = (-np.inf, np.inf)
    coarse_to_fine: bool = False
    centred: bool = False


def _typed(image: Array, template: Array, mask: Array) -> tuple[Array, Array, Array]:
    """Integers and a bool mask as they are, their sums being exact; anything else, the mask too, as float64."""
    if image.dtype != np.float64 and mask.dtype == np.bool_:
        return image, template, mask
    return image.astype(np.float64), template.astype(np.float64), mask.astype(np.float64)


def _channels(image: Array, template: Array) -> Iterator[tuple[Array, Array]]:
    for channel in range(image.shape[2]):
        yield np.ascontiguousarray(image[:, :, channel]), np.ascontiguousarray(template[:, :, channel])


def _ssd(image: Array, template: Array, mask: Array) -> FloatArray:
    image, template, mask = _typed(image, template, mask)
    n = mask.sum() * image.shape[2]
    if image.dtype.kind == "f":
        return _float_ssd(image, template, mask) / n
    whole, weights = bool(mask.all()), mask.astype(np.int64)
    total: Any = 0
    for f, t in _channels(image, template):
        k = np.where(mask, t, 0).astype(np.int64)
        if whole:
            product, _, sums = once(window_sums, f, k)
            part = sums - 2 * product
        else:
            squares = f.astype(np.uint32) ** 2
            (part,) = correlations([(squares, weights), (f, -2 * k)])
        part += (k * k).sum()
        total = np.add(part, total, out=part)
    return np.asarray(total / n, dtype=np.float64)


def _float_ssd(image: Array, template: Array, mask: Array) -> FloatArray:
    used = mask > 0
    origin = template[used].mean(axis=0)  # differences do not change, but the sums that cancel become smaller
    near, own = image - origin, np.where(used[:, :, None], template - origin, 0.0)
    total: Any = 0
    for f, t in _channels(near, own):
        total = total + correlations([(f * f, mask), (f, -2 * mask * t)])[0] + (mask * t * t).sum()
    peak = max(float(np.abs(near).max()), float(np.abs(own).max()))
    doubtful = np.argwhere(total <= CANCELLED * peak**2 * mask.sum() * image.shape[2])
    total[tuple(doubtful.T)] = _direct_ssd(image, template, mask, doubtful)
    return np.asarray(total, dtype=np.float64)


@compiled
def _direct_ssd(image: Array, template: Array, mask: Array, places: Array) -> Array:  # pragma: no cover
    totals = np.zeros(len(places))
    for i in range(len(places)):
        r, c = places[i]
        for u in range(template.shape[0]):
            for v in range(template.shape[1]):
                for channel in range(template.shape[2]):
                    difference = template[u, v, channel] - image[r + u, c + v, channel]
                    totals[i] += mask[u, v] * difference * difference
    return totals


def _sad(image: Array, template: Array, mask: Array) -> FloatArray:
    image, template, mask = _typed(image, template, mask)
    shape = image.shape[0] - template.shape[0] + 1, image.shape[1] - template.shape[1] + 1
    total = np.zeros(shape, np.float64 if image.dtype.kind == "f" else np.int64)
    for f, t in _channels(image, template):
        if f.dtype == np.uint8:
            _add_byte_differences(f, t, mask, total)
        else:
            kind = np.float64 if f.dtype.kind == "f" else np.int32
            _add_differences(f.astype(kind), t.astype(kind), mask.astype(kind), total)
    return np.asarray(total / (mask.sum() * image.shape[2]), dtype=np.float64)


@compiled
def _add_byte_differences(f: Array, t: Array, mask: Array, total: Array) -> None:  # pragma: no cover
    """Add ``sum(|t - f|)`` of every window: two template pixels against a whole row at a time, in 16 bit."""
    rows, columns = total.shape
    part = np.zeros(columns, np.uint16)
    for r in range(rows):
        for u in range(t.shape[0]):
            for start in range(0, t.shape[1], 256):  # 256 differences fit into 16 bit
                part[:] = 0
                v, stop = start, min(start + 256, t.shape[1])
                while v < stop:
                    value, row = t[u, v], f[r + u, v:]
                    if v + 1 < stop and mask[u, v] and mask[u, v + 1]:
                        value2, row2 = t[u, v + 1], f[r + u, v + 1 :]
                        for c in range(columns):
                            one = np.uint8(max(row[c], value) - min(row[c], value))
                            other = np.uint8(max(row2[c], value2) - min(row2[c], value2))
                            part[c] += np.uint16(np.uint16(one) + np.uint16(other))
                        v += 2
                        continue
                    if mask[u, v]:
                        for c in range(columns):
                            part[c] += np.uint8(max(row[c], value) - min(row[c], value))
                    v += 1
                for c in range(columns):
                    total[r, c] += part[c]


@compiled
def _add_differences(f: Array, t: Array, weights: Array, total: Array) -> None:  # pragma: no cover
    """The same for int32, whose rows of differences of 16 bit numbers are summed exactly, and for float64."""
    rows, columns = total.shape
    part = np.zeros(columns, f.dtype)
    for r in range(rows):
        for u in range(t.shape[0]):
            part[:] = 0
            for v in range(t.shape[1]):
                weight, value = weights[u, v], t[u, v]
                if weight > 0:
                    row = f[r + u, v:]
                    for c in range(columns):
                        part[c] += weight * abs(row[c] - value)
            for c in range(columns):
                total[r, c] += part[c]


def _ncc(image: Array, template: Array, mask: Array, *, centred: bool = False) -> FloatArray:
    image, template, mask = _typed(image, template, mask)
    if image.dtype.kind == "f":
        return _float_ncc(image, template, mask, centred)
    shape = image.shape[0] - template.shape[0] + 1, image.shape[1] - template.shape[1] + 1
    cross, energy = np.zeros(shape), np.zeros(shape)
    whole, weights = bool(mask.all()), mask.astype(np.int64)
    n, own = int(mask.sum()), 0.0
    for f, t in _channels(image, template):
        k = np.where(mask, t, 0).astype(np.int64)
        if whole:
            product, sums, squares = once(window_sums, f, k)
        else:
            product, sums, squares = correlations([(f, k)], [(f, weights)], [(f.astype(np.uint32) ** 2, weights)])
        t_sum = int(k.sum())
        wide = n * int(max(f.max(), t.max())) >= 2**32  # else n^2 times any covariance is below 2^62
        own += _centred(int((k * k).sum()), t_sum, t_sum, n, wide) if centred else float((k * k).sum())
        _add_products(product, sums, squares, t_sum, n, centred, wide, cross, energy)
    return _normalised(cross, energy, own, 0.0)


@compiled
def _add_products(
    product: Array,
    sums: Array,
    squares: Array,
    t_sum: int,
    n: int,
    centred: bool,
    wide: bool,
    cross: Array,
    energy: Array,
) -> None:  # pragma: no cover
    """Add ``n sum(tf) - sum(t) sum(f)`` and ``n sum(f^2) - sum(f)^2`` of a channel, or the sums of products alone."""
    for r in range(cross.shape[0]):
        if centred:
            for c in range(cross.shape[1]):
                cross[r, c] += _centred(product[r, c], t_sum, sums[r, c], n, wide)
                energy[r, c] += _centred(squares[r, c], sums[r, c], sums[r, c], n, wide)
        else:
            for c in range(cross.shape[1]):
                cross[r, c] += product[r, c]
                energy[r, c] += squares[r, c]


@compiled
def _centred(product: int, one: int, other: int, n: int, wide: bool) -> float:  # pragma: no cover
    """``n product - one other`` of whole numbers, rounded once, though the terms may pass 64 bit.

    The last 64 bits of the difference are exact; the first ones are those of the difference in float64, whose
    error is far below ``2^64``.
    """
    last = np.float64(n * product - one * other)
    if not wide:
        return last
    about = np.float64(n) * np.float64(product) - np.float64(one) * np.float64(other)
    return last + 2.0**64 * np.rint((about - last) / 2.0**64)


@compiled
def _normalised(cross: Array, energy: Array, own: float, least: float) -> Array:  # pragma: no cover
    """``cross / sqrt(energy * own)``, 0 where an energy is not above ``least``; written over ``cross``."""
    for r in range(cross.shape[0]):
        for c in range(cross.shape[1]):
            if own > least and energy[r, c] > least:
                cross[r, c] = min(1.0, max(-1.0, cross[r, c] / np.sqrt(energy[r, c] * own)))
            else:
                cross[r, c] = 0.0
    return cross


def _float_ncc(image: Array, template: Array, mask: Array, centred: bool) -> FloatArray:
    n = mask.sum()
    template = np.where(mask[:, :, None] > 0, template, 0.0)
    if centred:
        template = template - np.tensordot(mask, template, 2) / n
    cross: Any = 0.0
    energy: Any = 0.0
    for f, t in _channels(image, template):
        product, total, squares = correlations([(f, mask * t)], [(f, mask)], [(f * f, mask)])
        cross = cross + product
        energy = energy + (squares - total * total / n if centred else squares)
    seen, _ = window_moments((image != 0).any(axis=2).astype(np.uint8), *mask.shape)
    cross[seen == 0] = energy[seen == 0] = 0.0  # black: nothing to compute
    doubtful = np.argwhere((energy <= CANCELLED * n * image.shape[2]) & (seen > 0))
    cross[tuple(doubtful.T)], energy[tuple(doubtful.T)] = _direct_ncc(image, template, mask, doubtful, centred)
    own = float((mask[:, :, None] * template**2).sum())
    return _normalised(cross, energy, own, FLAT**2 * n * image.shape[2])


@compiled
def _direct_ncc(
    image: Array, template: Array, mask: Array, places: Array, centred: bool
) -> tuple[Array, Array]:  # pragma: no cover
    crosses, energies = np.zeros(len(places)), np.zeros(len(places))
    n = mask.sum()
    for i in range(len(places)):
        r, c = places[i]
        for channel in range(template.shape[2]):
            mean = 0.0
            if centred:
                for u in range(template.shape[0]):
                    for v in range(template.shape[1]):
                        mean += mask[u, v] * image[r + u, c + v, channel]
                mean /= n
            for u in range(template.shape[0]):
                for v in range(template.shape[1]):
                    value = image[r + u, c + v, channel] - mean
                    crosses[i] += mask[u, v] * template[u, v, channel] * value
                    energies[i] += mask[u, v] * value * value
    return crosses, energies


def scaled(image: Array, pairs: Pairs, *, remove_offset: bool) -> tuple[Array, Pairs]:
    """Float pictures scaled to magnitudes up to 1; integers, whose sums are exact, as they are.

    Neither measure is moved by the gain, nor ``zncc`` by the offset, but overflow and rounding are.
    """

    def divided(values: Array, counting: Array) -> Array:
        origin = counting.min(axis=0) if remove_offset else 0.0
        peak = np.abs(counting - origin).max()
        return np.asarray((values - origin) / (peak if peak > 0 else 1.0))

    if all(_typed(image, template, mask)[0].dtype.kind != "f" for template, mask in pairs):
        return image, pairs
    image = image.astype(np.float64)
    return divided(image, image.reshape(-1, image.shape[2])), [
        (divided(template.astype(np.float64), template[mask > 0].astype(np.float64)), mask.astype(np.float64))
        for template, mask in pairs
    ]


def _edge_distances(image: Array, pairs: Pairs) -> tuple[Array, Pairs]:
    """The image's squared distances, and for each pair its edges as the mask; no edges score as in an empty image."""
    edges, template_edges = edge_pixels(image, [template for template, _ in pairs])
    distances = once(squared_distances, edges)[:, :, None]
    prepared = []
    for (_, mask), own in zip(pairs, template_edges, strict=True):
        none = not (own & (mask > 0)).any()
        constant = np.full((*mask.shape, 1), image.shape[0] ** 2 + image.shape[1] ** 2 if none else 0, np.int64)
        prepared.append((constant, mask if none else own & mask if mask.dtype == np.bool_ else own * mask))
    return distances, prepared


def _sed(distances: Array, constant: Array, mask: Array) -> FloatArray:
    """Mean distance under the template's edges, or the constant where there are none."""
    shape = distances.shape[0] - mask.shape[0] + 1, distances.shape[1] - mask.shape[1] + 1
    if constant.any():
        return np.full(shape, float(constant.max()))
    values = distances[:, :, 0]
    exact = values.dtype.kind == "i" and mask.dtype == np.bool_
    kind = np.int64 if exact else np.float64
    (total,) = correlations([(values.astype(kind), mask.astype(kind))])
    if not exact:  # where every edge lies on an edge, the sum of floats is 0 up to rounding
        (total_exact,) = correlations([(np.rint(values).astype(np.int64), (mask > 0).astype(np.int64))])
        total[total_exact == 0] = 0
    return np.asarray(np.maximum(total, 0) / mask.sum(), dtype=np.float64)


def _ssd_threshold(image: Array, template: Array, mask: Array) -> float:
    values, weights = template[mask > 0].astype(np.float64), mask[mask > 0].astype(np.float64)
    deviations = values - np.average(values, axis=0, weights=weights)
    return UNEXPLAINED * float(np.average(deviations**2, axis=0, weights=weights).mean())


def _sad_threshold(image: Array, template: Array, mask: Array) -> float:
    values, weights = template[mask > 0].astype(np.float64), mask[mask > 0].astype(np.float64)
    deviations = values - np.median(values, axis=0)
    return UNEXPLAINED * float(np.average(np.abs(deviations), axis=0, weights=weights).mean())


def _ncc_threshold(image: Array, template: Array, mask: Array) -> float:
    values, weights = template[mask > 0].astype(np.float64), mask[mask > 0].astype(np.float64)
    values = values / max(float(np.abs(values).max()), np.finfo(float).tiny)
    energy = float(np.average(values**2, axis=0, weights=weights).sum())
    flat = float((np.average(values, axis=0, weights=weights) ** 2).sum()) / energy if energy > 0 else 1.0
    return float(np.sqrt(min(1.0, 1 - UNEXPLAINED * (1 - flat))))


def _zncc_threshold(image: Array, template: Array, mask: Array) -> float:
    return float(np.sqrt(1 - UNEXPLAINED))


def _sed_threshold(image: Array, template: Array, mask: Array) -> float:
    crowded = UNEXPLAINED * float(np.median(once(squared_distances, edge_pixels(image, [template])[0])))
    return min(crowded, float(min(mask.shape) / 8) ** 2)


DISTANCE, CORRELATION = (0.0, np.inf), (-1.0, 1.0)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            "ssd", "mean squared difference (Eq 2)", False, _ssd, _ssd_threshold, bounds=DISTANCE, coarse_to_fine=True
        ),
        Method("sad", "mean absolute difference", False, _sad, _sad_threshold, bounds=DISTANCE, coarse_to_fine=True),
        Method(
            "ncc", "normalised cross-correlation", True, _ncc, _ncc_threshold,
            partial(scaled, remove_offset=False), CORRELATION, coarse_to_fine=True,
        ),
        Method(
            "zncc", "zero-mean normalised cross-correlation", True, partial(_ncc, centred=True), _zncc_threshold,
            partial(scaled, remove_offset=True), CORRELATION, coarse_to_fine=True, centred=True,
        ),
        Method("sed", "mean squared edge distance (px^2)", False, _sed, _sed_threshold, _edge_distances, DISTANCE),
    )
}  # fmt: skip
"""The measures by name. :func:`occlib.matching.registry.matcher` adds one of your own."""

BUILT_IN = tuple(METHODS)


def known_method(name: str) -> Method:
    """The measure of this name; ``ValueError`` with the names that there are."""
    if not isinstance(name, str) or name not in METHODS:
        raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {name!r}")
    return METHODS[name]
