"""The similarity measures of template matching (section 3, Eq 1 and 2), each written twice.

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

The literal form of a measure (``reference``) reads like its definition and is slow; the fast one (``score``)
uses correlation in the frequency domain, as in Lewis's fast normalised cross-correlation, or one pass over
rows (``sad``). Integers with a mask of true and false are summed exactly. Where sums of other numbers cancel,
the few windows concerned are computed directly.

This module is about arrays that :mod:`occlib.matching.search` has checked; begin there.

Sources: Sulaiman et al. (2007), IJCSNS 7(7), for SSD in the paper; Steger, Ulrich and Wiedemann, "Machine
Vision Algorithms and Applications" (MVTec), for the mean SED; Lewis (1995), "Fast normalized
cross-correlation", Vision Interface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Mask
from occlib.base.kernels import compiled


def _method(name: str) -> Method:
    if not isinstance(name, str) or name not in METHODS:
        raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {name!r}")
    return METHODS[name]


Array = npt.NDArray[Any]


Measure = Callable[[Array, Array, Array], FloatArray]


Pairs = Sequence[tuple[Array, Array]]


FLAT = 1e-5
"""A *float* window whose spread is below this share of the picture's range is flat: the rest is rounding."""


CANCELLED = 1e-6
"""Share of the largest possible sum below which a sum of floats is taken again, directly: too few digits are left."""


UNEXPLAINED = 0.5
"""Share of the template's own contrast that a match may leave unexplained (default thresholds)."""


EDGE_IMAGE, EDGE_TEMPLATE = 40, 100
"""Gradients (``|gx| + |gy|`` of the 3x3 Sobel masks, 8 bit) above which a pixel of the image or of the
template can be an edge. The image's is lower, so the template's edges survive less light and some noise."""


EDGE_MARGIN = 3
"""Template edges closer to its border (px) depend on what lies beyond the border, and are left out."""


def unprepared(image: Array, pairs: Pairs) -> tuple[Array, Pairs]:
    """Nothing to prepare: the windows of the image itself are compared."""
    return image, pairs


@dataclass(frozen=True)
class Method:
    """A similarity measure.

    ``score`` and ``reference`` take an image (H, W, C) and a template (h, w, C) of one type, uint8, uint16 or
    float64, and the template's mask (h, w), bool or float64 weights up to 1; they return float64
    (H - h + 1, W - w + 1). ``default_threshold`` takes the same and returns a number, or is the name of a
    threshold. ``prepare`` turns the image and several pairs (template, mask) into what ``score`` compares
    window by window. ``bounds`` are the least and the largest score.
    """

    name: str
    description: str
    higher_is_better: bool
    score: Measure
    reference: Measure
    default_threshold: Callable[[Array, Array, Array], float] | str
    prepare: Callable[[Array, Pairs], tuple[Array, Pairs]] = unprepared
    bounds: tuple[float, float] = (-np.inf, np.inf)


def _spectrum(values: Array, shape: tuple[int, ...]) -> Array:
    padded = np.zeros(shape)
    padded[: values.shape[0], : values.shape[1]] = values
    return np.asarray(cv2.dft(padded, padded, nonzeroRows=values.shape[0])).reshape(shape)


def _correlations(*sums: Pairs) -> list[Array]:
    """For each list of (image, kernel) the sum of ``sum(kernel(u, v) image(r + u, c + v))``, all of equal shapes.

    By the discrete Fourier transform, of each array once. Integers give the exact result, int64: rounding is
    exact as long as the transform's error, for which the bound is the usual one, stays below 1/2. Where the bound
    is passed, the larger integers are cut into two halves of their digits.
    """
    image, kernel = sums[0][0]
    shape = tuple(max(2, cv2.getOptimalDFTSize(size)) for size in image.shape)
    rows, columns = (a - b + 1 for a, b in zip(image.shape, kernel.shape, strict=True))
    spectra: dict[int, Array] = {}
    product, total = np.empty(shape), np.empty(shape)  # fresh memory costs more than the arithmetic
    results = []
    for position, pairs in enumerate(sums, start=1):
        exact = image.dtype.kind != "f"
        if exact and sum(_error(f, k) for f, k in pairs) > 0.25:
            results.append(np.sum([_by_digits(f, k) for f, k in pairs], axis=0))
            continue
        for number, (f, k) in enumerate(pairs):
            for values in (f, k):
                if id(values) not in spectra:
                    spectra[id(values)] = _spectrum(values, shape)
            cv2.mulSpectrums(spectra[id(f)], spectra[id(k)], 0, product if number else total, conjB=True)
            if number:
                total += product
        needed = {id(values) for later in sums[position:] for pair in later for values in pair}
        spectra = {key: spectrum for key, spectrum in spectra.items() if key in needed}
        flags = cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT
        valid = cv2.dft(total, total, flags, nonzeroRows=rows).reshape(shape)[:rows, :columns]
        results.append(_rounded(valid) if exact else valid.copy())
    return results


def _error(image: Array, kernel: Array) -> float:
    """Bound for the rounding error of a correlation by Fourier transform in float64."""
    norms = [max(int(a.max()), -int(a.min())) * np.sqrt(a.size) for a in (image, kernel)]
    return float(3 * np.finfo(float).eps * np.log2(image.size + 1) * norms[0] * norms[1])


def _by_digits(image: Array, kernel: Array) -> Array:
    if _error(image, kernel) <= 0.25:
        return _correlations([(image, kernel)])[0]
    peaks = int(np.abs(image).max()), int(np.abs(kernel).max())
    bits = max(peaks).bit_length() // 2
    low, high = (1 << bits) - 1, bits
    if peaks[0] >= peaks[1]:
        return (_by_digits(image >> high, kernel) << bits) + _by_digits(image & low, kernel)
    return (_by_digits(image, kernel >> high) << bits) + _by_digits(image, kernel & low)


@compiled
def _rounded(values: Array) -> Array:  # pragma: no cover
    whole = np.empty(values.shape, np.int64)
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            whole[r, c] = np.int64(np.floor(values[r, c] + 0.5))
    return whole


@compiled
def _window_moments(values: Array, h: int, w: int) -> tuple[Array, Array]:  # pragma: no cover
    """Sums of integers and of their squares over every window: columns first, then along the row."""
    rows, columns = values.shape[0] - h + 1, values.shape[1] - w + 1
    sums, squares = np.empty((rows, columns), np.int64), np.empty((rows, columns), np.int64)
    column, column2 = np.zeros(values.shape[1], np.int64), np.zeros(values.shape[1], np.int64)
    for r in range(values.shape[0]):
        if r >= h:
            for c in range(values.shape[1]):
                new, old = np.int64(values[r, c]), np.int64(values[r - h, c])
                column[c] += new - old
                column2[c] += new * new - old * old
        else:
            for c in range(values.shape[1]):
                new = np.int64(values[r, c])
                column[c] += new
                column2[c] += new * new
        if r >= h - 1:
            total, total2 = np.int64(0), np.int64(0)
            for c in range(values.shape[1]):
                total += column[c]
                total2 += column2[c]
                if c >= w:
                    total -= column[c - w]
                    total2 -= column2[c - w]
                if c >= w - 1:
                    sums[r - h + 1, c - w + 1] = total
                    squares[r - h + 1, c - w + 1] = total2
    return sums, squares


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
            (part,) = _correlations([(f, -2 * k)])
            part += _window_moments(f, *k.shape)[1]
        else:
            squares = f.astype(np.uint32) ** 2
            (part,) = _correlations([(squares, weights), (f, -2 * k)])
        part += (k * k).sum()
        total = np.add(part, total, out=part)
    return np.asarray(total / n, dtype=np.float64)


def _float_ssd(image: Array, template: Array, mask: Array) -> FloatArray:
    used = mask > 0
    origin = template[used].mean(axis=0)  # differences do not change, but the sums that cancel become smaller
    near, own = image - origin, np.where(used[:, :, None], template - origin, 0.0)
    total: Any = 0
    for f, t in _channels(near, own):
        total = total + _correlations([(f * f, mask), (f, -2 * mask * t)])[0] + (mask * t * t).sum()
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
    """Add ``sum(|t - f|)`` of every window: a template pixel against a whole row at a time, in 16 bit."""
    rows, columns = total.shape
    part = np.zeros(columns, np.uint16)
    for r in range(rows):
        for u in range(t.shape[0]):
            for start in range(0, t.shape[1], 256):  # 256 differences fit into 16 bit
                part[:] = 0
                for v in range(start, min(start + 256, t.shape[1])):
                    if mask[u, v]:
                        value = t[u, v]
                        row = f[r + u, v:]
                        for c in range(columns):
                            part[c] += np.uint8(max(row[c], value) - min(row[c], value))
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
            (product,) = _correlations([(f, k)])
            sums, squares = _window_moments(f, *k.shape)
        else:
            product, sums, squares = _correlations([(f, k)], [(f, weights)], [(f.astype(np.uint32) ** 2, weights)])
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
        product, total, squares = _correlations([(f, mask * t)], [(f, mask)], [(f * f, mask)])
        cross = cross + product
        energy = energy + (squares - total * total / n if centred else squares)
    seen, _ = _window_moments((image != 0).any(axis=2).astype(np.uint8), *mask.shape)
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


def _scaled(image: Array, pairs: Pairs, *, remove_offset: bool) -> tuple[Array, Pairs]:
    """Float pictures scaled to magnitudes up to 1; integers, whose sums are exact, as they are.

    Neither measure is moved by the gain, nor ``zncc`` by the offset, but overflow and rounding are.
    """

    def scaled(values: Array, counting: Array) -> Array:
        origin = counting.min(axis=0) if remove_offset else 0.0
        peak = np.abs(counting - origin).max()
        return np.asarray((values - origin) / (peak if peak > 0 else 1.0))

    if all(_typed(image, template, mask)[0].dtype.kind != "f" for template, mask in pairs):
        return image, pairs
    image = image.astype(np.float64)
    return scaled(image, image.reshape(-1, image.shape[2])), [
        (scaled(template.astype(np.float64), template[mask > 0].astype(np.float64)), mask.astype(np.float64))
        for template, mask in pairs
    ]


def _edges(image: Array, templates: Sequence[Array]) -> tuple[Mask, list[Mask]]:
    """Edge pixels of the image, and those of each template that are not too near its border."""
    if image.dtype != np.uint8:
        low = min(float(a.min()) for a in (image, *templates))
        span = max(float(a.max()) for a in (image, *templates)) - low
        span = span if span > 0 else 1.0
        image, *templates = (
            np.rint((a.astype(float) - low) / span * 255).astype(np.uint8) for a in (image, *templates)
        )
    found = []
    for picture, limit in ((image, EDGE_IMAGE), *((t, EDGE_TEMPLATE) for t in templates)):
        smooth = cv2.GaussianBlur(np.ascontiguousarray(picture), (3, 3), 0)
        found.append(cv2.Canny(smooth, limit, limit) > 0)
    for edges in found[1:]:
        edges[:EDGE_MARGIN] = edges[-EDGE_MARGIN:] = edges[:, :EDGE_MARGIN] = edges[:, -EDGE_MARGIN:] = False
    return found[0], found[1:]


def _squared_distances(edges: Mask) -> Array:
    """Squared distance (px^2, int64) to the nearest edge pixel; the squared diagonal if there is none."""
    if not edges.any():
        return np.full(edges.shape, edges.shape[0] ** 2 + edges.shape[1] ** 2, dtype=np.int64)
    distance = cv2.distanceTransform((~edges).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.rint(distance.astype(np.float64) ** 2).astype(np.int64)


def _edge_distances(image: Array, pairs: Pairs) -> tuple[Array, Pairs]:
    """The image's squared distances, and for each pair its edges as the mask; no edges score as in an empty image."""
    edges, template_edges = _edges(image, [template for template, _ in pairs])
    distances = _squared_distances(edges)[:, :, None]
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
    (total,) = _correlations([(values.astype(kind), mask.astype(kind))])
    if not exact:  # where every edge lies on an edge, the sum of floats is 0 up to rounding
        (total_exact,) = _correlations([(np.rint(values).astype(np.int64), (mask > 0).astype(np.int64))])
        total[total_exact == 0] = 0
    return np.asarray(np.maximum(total, 0) / mask.sum(), dtype=np.float64)


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


def _reference_ssd(image: Array, template: Array, mask: Array) -> FloatArray:
    return _slide(image, template, mask, lambda t, f, w: float((w * (t - f) ** 2).sum() / (w.sum() * t.shape[1])))


def _reference_sad(image: Array, template: Array, mask: Array) -> FloatArray:
    return _slide(image, template, mask, lambda t, f, w: float((w * np.abs(t - f)).sum() / (w.sum() * t.shape[1])))


def _reference_ncc(image: Array, template: Array, mask: Array, *, centred: bool = False) -> FloatArray:
    image, [(template, mask)] = _scaled(image, [(template, mask)], remove_offset=centred)
    least = FLAT**2 if image.dtype.kind == "f" else 0.0

    def ncc(t: FloatArray, f: FloatArray, w: FloatArray) -> float:
        if centred:
            t, f = t - (w * t).sum(axis=0) / w.sum(), f - (w * f).sum(axis=0) / w.sum()
        energies = (w * t * t).sum(), (w * f * f).sum()
        if min(energies) <= least * w.sum() * t.shape[1]:
            return 0.0
        return float((w * t * f).sum() / np.sqrt(energies[0] * energies[1]))

    return _slide(image, template, mask, ncc)


def _reference_sed(image: Array, template: Array, mask: Array) -> FloatArray:
    edges, (template_edges,) = _edges(image, [template])
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
    crowded = UNEXPLAINED * float(np.median(_squared_distances(_edges(image, [template])[0])))
    return min(crowded, float(min(mask.shape) / 8) ** 2)


DISTANCE, CORRELATION = (0.0, np.inf), (-1.0, 1.0)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("ssd", "mean squared difference (Eq 2)", False, _ssd, _reference_ssd, _ssd_threshold, bounds=DISTANCE),
        Method("sad", "mean absolute difference", False, _sad, _reference_sad, _sad_threshold, bounds=DISTANCE),
        Method(
            "ncc",
            "normalised cross-correlation",
            True,
            _ncc,
            _reference_ncc,
            _ncc_threshold,
            partial(_scaled, remove_offset=False),
            CORRELATION,
        ),
        Method(
            "zncc",
            "zero-mean normalised cross-correlation",
            True,
            partial(_ncc, centred=True),
            partial(_reference_ncc, centred=True),
            _zncc_threshold,
            partial(_scaled, remove_offset=True),
            CORRELATION,
        ),
        Method(
            "sed",
            "mean squared edge distance (px^2)",
            False,
            _sed,
            _reference_sed,
            _sed_threshold,
            _edge_distances,
            DISTANCE,
        ),
    )
}
"""The measures by name. :func:`occlib.matching.registry.matcher` adds one of your own."""


BUILT_IN = tuple(METHODS)
