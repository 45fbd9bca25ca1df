"""Sums over every window of an image: correlations by the Fourier transform, and running sums; exact for integers.

A window has the template's size; there is one for each place of the template's top-left pixel in the image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.kernels import compiled

Array = npt.NDArray[Any]

Pairs = Sequence[tuple[Array, Array]]
"""(image, kernel) or (template, mask), both (rows, columns)."""

Made = TypeVar("Made")

_SHARED: ContextVar[dict[Any, Any] | None] = ContextVar("shared sums", default=None)


@contextmanager
def shared() -> Iterator[None]:
    """Within this block, what several measures need of the same arrays is computed once: for comparisons that are not timed."""
    token = _SHARED.set({})
    try:
        yield
    finally:
        _SHARED.reset(token)


def once(make: Callable[..., Made], *arrays: Array) -> Made:
    """``make(*arrays)``; within :func:`shared`, what it was for equal arrays before. Not to be changed in place."""
    known = _SHARED.get()
    if known is None:
        return make(*arrays)
    key = (make, *((values.shape, values.dtype.str, values.tobytes()) for values in arrays))
    if key not in known:
        known[key] = make(*arrays)
    return known[key]  # type: ignore[no-any-return]


def window_sums(image: Array, kernel: Array) -> tuple[Array, Array, Array]:
    """Of integers: the correlation with the kernel, and the sums and sums of squares over every window."""
    return correlations([(image, kernel)])[0], *window_moments(image, *kernel.shape)


def _spectrum(values: Array, shape: tuple[int, ...]) -> Array:
    padded = np.zeros(shape)
    padded[: values.shape[0], : values.shape[1]] = values
    return np.asarray(cv2.dft(padded, padded, nonzeroRows=values.shape[0])).reshape(shape)


def correlations(*sums: Pairs) -> list[Array]:
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


def correlate(image: npt.ArrayLike, template: npt.ArrayLike) -> Array:
    """The sum of the products of a template and the window below it, at every place: what many measures are made of.

    Parameters
    ----------
    image, template
        (H, W) and (h, w), or (H, W, C) and (h, w, C), whose channels are added. Complex numbers count as vectors of
        two parts, whose product is the scalar product.

    Returns
    -------
    ndarray
        float64 (H - h + 1, W - w + 1), by the Fourier transform; a place is that of the template's top-left pixel.

    Examples
    --------
    >>> correlate([[1, 2, 3]], [[10, 1]]).round(6)
    array([[12., 23.]])
    """
    f, t = (np.atleast_3d(np.asarray(values)) for values in (image, template))
    if f.ndim != 3 or t.ndim != 3 or f.shape[2] != t.shape[2] or not np.all(np.less_equal(t.shape, f.shape)):
        raise ValueError(f"template: expected one that fits into the image {f.shape}, got shape {t.shape}")
    if np.iscomplexobj(f) or np.iscomplexobj(t):
        f, t = (np.concatenate([values.real, values.imag], axis=2) for values in (f, t))
    channels = zip(np.moveaxis(f, 2, 0).astype(np.float64), np.moveaxis(t, 2, 0).astype(np.float64), strict=True)
    return correlations(list(channels))[0]


def _error(image: Array, kernel: Array) -> float:
    """Bound for the rounding error of a correlation by Fourier transform in float64."""
    norms = [max(int(a.max()), -int(a.min())) * np.sqrt(a.size) for a in (image, kernel)]
    return float(3 * np.finfo(float).eps * np.log2(image.size + 1) * norms[0] * norms[1])


def _by_digits(image: Array, kernel: Array) -> Array:
    if _error(image, kernel) <= 0.25:
        return correlations([(image, kernel)])[0]
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
def window_moments(values: Array, h: int, w: int) -> tuple[Array, Array]:  # pragma: no cover
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
