"""Template matching: similarity images and the places they point to (section 3, Eq 1 and 2).

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

``n`` counts pixels times channels, so a grey picture scores the same as its three-channel copy. The paper
thresholds the similarity image and keeps one optimum in each connected component: :func:`find`.

Each measure is written twice: literally, pixel by pixel (:func:`reference_similarity`), and by correlation
(:func:`similarity`), as in Lewis's fast normalised cross-correlation. Integer images are summed exactly.

Sources: Sulaiman et al. (2007), IJCSNS 7(7), for SSD in the paper; Steger, Ulrich and Wiedemann, "Machine
Vision Algorithms and Applications" (MVTec), for the mean SED; Lewis (1995), "Fast normalized
cross-correlation", Vision Interface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
from scipy import fft

from occlib.geometry import FloatArray, Image, Mask

Array = npt.NDArray[Any]
Measure = Callable[[Array, Array, Mask], FloatArray]

FLAT = 1e-5
"""A *float* window whose spread is below this share of the picture's range is flat: the rest is rounding."""
UNEXPLAINED = 0.5
"""Share of the template's own contrast that a match may leave unexplained (default thresholds)."""
EDGE_IMAGE, EDGE_TEMPLATE = 40, 100
"""Gradients (``|gx| + |gy|`` of the 3x3 Sobel masks, 8 bit) above which a pixel of the image or of the
template can be an edge. The image's is lower, so the template's edges survive less light and some noise."""
EDGE_MARGIN = 3
"""Template edges closer to its border (px) depend on what lies beyond the border, and are left out."""


@dataclass(frozen=True)
class Method:
    """A similarity measure: its fast form, its literal form and its default threshold."""

    name: str
    description: str
    higher_is_better: bool
    score: Measure
    reference: Measure
    default_threshold: Callable[[Array, Array, Mask], float]


@dataclass(frozen=True)
class Match:
    """A place where the template was found.

    ``x``, ``y`` are the column and row of the template's top-left pixel, ``width`` and ``height`` its size in
    px, ``score`` the value of the similarity image there.
    """

    x: int
    y: int
    score: float
    width: int
    height: int

    @property
    def centre_px(self) -> tuple[float, float]:
        """Centre ``(x, y)`` in px, pixel centres at integers.

        >>> Match(x=10, y=20, score=0.0, width=5, height=4).centre_px
        (12.0, 21.5)
        """
        return self.x + (self.width - 1) / 2, self.y + (self.height - 1) / 2


def similarity(
    image: npt.ArrayLike, template: npt.ArrayLike, method: str = "ssd", mask: npt.ArrayLike | None = None
) -> FloatArray:
    """Similarity image of a template: Eq 1 with the measure ``method``.

    Parameters
    ----------
    image
        (H, W) or (H, W, 3), integer or float, finite.
    template
        (h, w) or (h, w, 3), no larger than the image and with as many channels.
    method
        ``"ssd"``, ``"sad"``, ``"ncc"``, ``"zncc"`` or ``"sed"``; see :data:`METHODS`.
    mask
        (h, w) bool, True for the template pixels that count (the region ``T``); all of them by default.

    Returns
    -------
    ndarray
        float64 (H - h + 1, W - w + 1), indexed ``[row, col]`` by the template's top-left corner. Always
        finite. 0 is best for ``ssd``, ``sad`` and ``sed``, 1 is best for ``ncc`` and ``zncc``.

    Raises
    ------
    ValueError
        Unknown method; empty, oversized, non-finite or non-numeric arrays; unequal channels; bad mask.

    Notes
    -----
    *Exactness.* For integers from 0 to 65535 every sum is exact: identical windows score exactly 0
    (``ssd``, ``sad``) or 1 (``ncc``, ``zncc``). Other numbers are treated as float64: ``ssd`` is then right
    to about 1e-13 of the largest squared difference, and smaller values are returned as 0.

    *Nothing to compare.* ``zncc`` is 0 where the window or the template is flat, ``ncc`` is 0 where either
    has no energy. ``sed`` is the squared diagonal of the image (px^2), more than any real distance, when the
    image or the template has no edge: a picture without structure is then the worst match, not an error
    that would stop a sweep half-way.

    *Edges.* Local maxima of the gradient after a 3x3 Gaussian (Canny without hysteresis), in the channel
    where it is steepest. Template edges within 3 px of its border are left out, so an exact copy scores exactly 0:
    leave a margin of 4 px around the object; a template under 7 px has no edges. Unless both pictures are
    uint8, their joint range is first mapped to 0..255. ``mask`` selects among the whole template's edges.

    Examples
    --------
    >>> image = np.array([[1, 2, 3], [4, 5, 6]])
    >>> similarity(image, [[2, 3], [5, 6]])
    array([[1., 0.]])
    >>> similarity(image, [[2, 3], [5, 6]], "sad", mask=[[True, False], [False, False]])
    array([[1., 0.]])
    """
    measure = _method(method)
    return measure.score(*_checked(image, template, mask))


def reference_similarity(
    image: npt.ArrayLike, template: npt.ArrayLike, method: str = "ssd", mask: npt.ArrayLike | None = None
) -> FloatArray:
    """The same as :func:`similarity`, computed literally as Eq 1 reads. Slow: for reading and for tests.

    >>> reference_similarity([[1, 2, 3]], [[2, 4]], "ssd")
    array([[2.5, 0.5]])
    """
    measure = _method(method)
    return measure.reference(*_checked(image, template, mask))


def default_threshold(
    image: npt.ArrayLike, template: npt.ArrayLike, method: str = "ssd", mask: npt.ArrayLike | None = None
) -> float:
    """The threshold that :func:`find` uses when it is given none.

    A match may leave at most half of the template's own contrast unexplained, contrast being what the best
    *featureless* window would leave:

    ``ssd``
        half of the template's variance (around each channel's mean);
    ``sad``
        half of its mean absolute deviation (around each channel's median);
    ``zncc``
        ``sqrt(1/2) = 0.707``: ``zncc^2`` is the share of the variance that is explained;
    ``ncc``
        ``sqrt((1 + c^2) / 2)``, where ``c`` is the ``ncc`` of the template and a flat window;
    ``sed``
        half of the median squared edge distance over the image, but at most ``(min(h, w) / 8)^2`` px^2.
        Clutter and noise are full of edges, so false matches remain there; take the first.

    It depends on the template, not on the best score in the image (for ``sed``: only on how crowded the
    image's edges are), so an image without the object gives no match.

    >>> default_threshold(np.zeros((4, 4)), [[0, 2]], "ssd")
    0.5
    """
    measure = _method(method)
    return measure.default_threshold(*_checked(image, template, mask))


def find(
    image: npt.ArrayLike,
    template: npt.ArrayLike,
    method: str = "ssd",
    threshold: float | Literal["otsu"] | None = None,
    mask: npt.ArrayLike | None = None,
) -> list[Match]:
    """Places of a template, best first: one optimum per component of the thresholded similarity image.

    The paper's rule: threshold ``S(r, c)``, which gives regions of adjacent pixels (8-connected here), and
    keep the local optimum of each. Equal scores: the first in row-major order.

    Parameters
    ----------
    image, template, method, mask
        As for :func:`similarity`.
    threshold
        The worst score to accept, in units of the score (inclusive). ``"otsu"`` splits the similarity image
        in two classes; it always finds something unless the similarity image is constant (no match), and
        is lenient when few windows match. By default :func:`default_threshold`.

    Returns
    -------
    list of Match
        Empty if no score reaches the threshold.

    Notes
    -----
    One match per component cuts both ways: two objects whose regions touch count once (use a stricter
    threshold), and a ragged region that falls apart counts more than once.

    Examples
    --------
    >>> image = np.zeros((8, 12), np.uint8)
    >>> image[2, 3] = image[5, 9] = 200
    >>> [(match.x, match.y, match.score) for match in find(image, image[1:4, 2:5])]
    [(2, 1, 0.0), (8, 4, 0.0)]
    """
    measure = _method(method)
    arrays = _checked(image, template, mask)
    score = measure.score(*arrays)
    cost = -score if measure.higher_is_better else score
    limit = measure.default_threshold(*arrays) if threshold is None else _threshold(threshold, measure, score)
    accepted = cost <= (-limit if measure.higher_is_better else limit)

    _, labels = cv2.connectedComponents(accepted.astype(np.uint8), connectivity=8)
    places = np.flatnonzero(accepted)
    places = places[np.argsort(cost.flat[places], kind="stable")]
    _, first = np.unique(labels.flat[places], return_index=True)
    height, width = arrays[1].shape[:2]
    rows, columns = np.unravel_index(places[np.sort(first)], score.shape)
    return [Match(int(x), int(y), float(score[y, x]), width, height) for y, x in zip(rows, columns, strict=True)]


# ---------------------------------------------------------------- arguments


def _method(name: str) -> Method:
    if not isinstance(name, str) or name not in METHODS:
        raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {name!r}")
    return METHODS[name]


def _picture(values: npt.ArrayLike, name: str) -> Image:
    """A checked (H, W, channels) array."""
    array = np.asarray(values)
    if array.dtype.kind not in "uif":
        raise ValueError(f"{name}: expected integer or float values, got dtype {array.dtype}")
    if array.ndim != 2 and not (array.ndim == 3 and array.shape[2] in (1, 3)):
        raise ValueError(f"{name}: expected shape (rows, columns) or (rows, columns, 3), got {array.shape}")
    if array.size == 0:
        raise ValueError(f"{name}: expected at least one pixel, got shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite values, got NaN or infinity")
    if float(np.abs(array.astype(np.float64)).max()) > 1e100:
        raise ValueError(f"{name}: expected magnitudes up to 1e100, whose squares can be summed; got more")
    return array.reshape(*array.shape[:2], -1)


def _checked(image: npt.ArrayLike, template: npt.ArrayLike, mask: npt.ArrayLike | None) -> tuple[Image, Image, Mask]:
    """Image (H, W, C) and template (h, w, C) of one type, uint8, uint16 or float64, and the mask (h, w)."""
    f, t = _picture(image, "image"), _picture(template, "template")
    if f.shape[2] != t.shape[2]:
        raise ValueError(f"template: expected {f.shape[2]} channel(s) like the image, got {t.shape[2]}")
    if t.shape[0] > f.shape[0] or t.shape[1] > f.shape[1]:
        raise ValueError(f"template: expected no larger than the image {f.shape[:2]}, got {t.shape[:2]}")
    used = np.ones(t.shape[:2], bool) if mask is None else np.asarray(mask)
    if used.dtype != np.bool_ or used.shape != t.shape[:2]:
        raise ValueError(f"mask: expected bool {t.shape[:2]}, got {used.dtype} {used.shape}")
    if not used.any():
        raise ValueError("mask: expected at least one True pixel, got none")
    kind: type[Any] = np.float64
    if f.dtype == t.dtype == np.uint8:
        kind = np.uint8
    elif all(a.dtype.kind in "ui" and a.min() >= 0 and a.max() <= 65535 for a in (f, t)):
        kind = np.uint16
    return f.astype(kind, copy=False), t.astype(kind, copy=False), used


def _threshold(threshold: Any, measure: Method, score: FloatArray) -> float:
    """The number that a given threshold means; NaN, which nothing reaches, for Otsu of a single value."""
    from skimage.filters import threshold_otsu

    if isinstance(threshold, str) and threshold == "otsu":
        return float(threshold_otsu(score)) if np.ptp(score) > 0 else np.nan
    if isinstance(threshold, bool) or not isinstance(threshold, Real) or not np.isfinite(float(threshold)):
        raise ValueError(f"threshold: expected a finite number, 'otsu' or None, got {threshold!r}")
    low, high = (-1.0, 1.0) if measure.higher_is_better else (0.0, np.inf)
    if not low <= float(threshold) <= high:
        raise ValueError(f"threshold: expected {low:g} to {high:g} for {measure.name}, got {threshold}")
    return float(threshold)


# ---------------------------------------------------------------- sums over every window


def _channels(image: Array, template: Array) -> Iterator[tuple[Array, Array]]:
    """The channels of both, as int64 or float64."""
    kind = np.float64 if image.dtype == np.float64 else np.int64
    for channel in range(image.shape[2]):
        yield image[:, :, channel].astype(kind), template[:, :, channel].astype(kind)


def _fft_correlation(image: Array, kernel: Array) -> FloatArray:
    shape = [fft.next_fast_len(size, real=True) for size in image.shape]
    spectrum = fft.rfft2(image, shape) * np.conj(fft.rfft2(kernel, shape))
    rows, columns = (a - b + 1 for a, b in zip(image.shape, kernel.shape, strict=True))
    return np.asarray(fft.irfft2(spectrum, shape)[:rows, :columns], dtype=np.float64)


def _digits(values: Array, bits: int) -> Iterator[tuple[int, Array]]:
    """Integers as a sum of ``digit << shift``; only the last digit can be negative."""
    shift = 0
    while np.abs(values).max() >> bits:
        yield shift, values & ((1 << bits) - 1)
        values, shift = values >> bits, shift + bits
    yield shift, values


def _correlation(image: Array, kernel: Array) -> Array:
    """``sum(kernel(u, v) image(r + u, c + v))``; exact, int64, if both are integers.

    The transform's rounding error stays far below 1/2 for 16 bit times 8 bit, so larger integers are cut
    into digits of that size.
    """
    if image.dtype.kind == "f":
        return _fft_correlation(image, kernel)
    total: Any = 0
    for image_shift, f in _digits(image, 16):
        for kernel_shift, k in _digits(kernel, 8):
            total = total + (np.rint(_fft_correlation(f, k)).astype(np.int64) << (image_shift + kernel_shift))
    return np.asarray(total)


def _window_sum(values: Array, mask: Mask) -> Array:
    """``sum(values(r + u, c + v))`` over the mask."""
    if values.dtype.kind == "f" or not mask.all():
        return _correlation(values, mask.astype(values.dtype))
    integral = np.pad(values, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    h, w = mask.shape
    return np.asarray(integral[h:, w:] - integral[:-h, w:] - integral[h:, :-w] + integral[:-h, :-w])


# ---------------------------------------------------------------- the measures


def _ssd(image: Array, template: Array, mask: Mask) -> FloatArray:
    total: Any = 0
    rounding = 0.0
    for f, t in _channels(image, template):
        if f.dtype.kind == "f":  # differences do not change, but the sums that cancel become smaller
            origin = t[mask].mean()
            f, t = f - origin, t - origin
            peak = max(np.abs(f).max(), np.abs(t[mask]).max())
            rounding += 8 * np.finfo(float).eps * np.sqrt(f.size * mask.sum()) * peak**2
        t = np.where(mask, t, 0)
        total = total + _window_sum(f * f, mask) - 2 * _correlation(f, t) + (t * t).sum()
    return np.asarray(np.where(total > rounding, total, 0) / (mask.sum() * image.shape[2]), dtype=np.float64)


def _sad(image: Array, template: Array, mask: Mask) -> FloatArray:
    total = sum(_absolute_differences(f, t, mask) for f, t in _channels(image, template))
    return np.asarray(total / (mask.sum() * image.shape[2]), dtype=np.float64)


def _absolute_differences(f: Array, t: Array, mask: Mask) -> Array:
    """Sum over the mask of ``|t - f|``, one template pixel for all windows at a time.

    The windows' pixels are then one run of memory: the image from that template pixel on. The narrowest type
    is the fastest; it is emptied into ``total`` before it can overflow.
    """
    kind: type[Any] = np.float64
    capacity = mask.size
    if f.dtype.kind == "i":
        kind, capacity = (np.int16, 128) if max(f.max(), t.max()) < 256 else (np.int32, 32768)
    rows, columns = f.shape[0] - t.shape[0] + 1, f.shape[1] - t.shape[1] + 1
    length = rows * f.shape[1] - t.shape[1] + 1
    run, values = f.astype(kind).ravel(), t.astype(kind)
    step, part = np.empty(length, kind), np.zeros(length, kind)
    total = np.zeros(rows * f.shape[1], f.dtype)
    for count, (u, v) in enumerate(np.argwhere(mask), start=1):
        start = u * f.shape[1] + v
        np.subtract(run[start : start + length], values[u, v], out=step)
        part += np.abs(step, out=step)
        if count % capacity == 0:
            total[:length] += part
            part[:] = 0
    total[:length] += part
    return total.reshape(rows, -1)[:, :columns]


def _ncc(image: Array, template: Array, mask: Mask, *, centred: bool = False) -> FloatArray:
    image, template, least = _rescaled(image, template, mask, centred)
    n = int(mask.sum())
    cross: Any = 0
    energy: Any = 0
    own: Any = 0
    for f, t in _channels(image, template):
        if centred and f.dtype.kind == "i":  # smaller numbers, same result
            origin = int(np.rint(t[mask].mean()))
            f, t = f - origin, t - origin
        t = np.where(mask, t, 0)
        f_sum, t_sum = (_window_sum(f, mask), t.sum()) if centred else (np.zeros(1, f.dtype), f.dtype.type(0))
        cross = cross + _about_means(_correlation(f, t), t_sum, f_sum, n)
        energy = energy + _about_means(_window_sum(f * f, mask), f_sum, f_sum, n)
        own = own + _about_means((t * t).sum(), t_sum, t_sum, n)
    cross, energy, own = (np.asarray(a, dtype=np.float64) for a in (cross, energy, own))
    usable = np.minimum(energy, own) > least * n * image.shape[2]
    norm = np.sqrt(np.where(usable, energy, 1.0) * np.where(usable, own, 1.0))
    return np.asarray(np.clip(np.where(usable, cross, 0.0) / norm, -1.0, 1.0), dtype=np.float64)


def _rescaled(image: Array, template: Array, mask: Mask, remove_offset: bool) -> tuple[Array, Array, float]:
    """Float pictures scaled to magnitudes up to 1, and the energy per value below which one counts as empty.

    Integers are left alone, since their sums are exact. Neither measure is moved by the gain, nor ``zncc``
    by the offset, but overflow and rounding are.
    """
    if image.dtype != np.float64:
        return image, template, 0.0
    pictures = []
    for values, used in ((image, image.reshape(-1, image.shape[2])), (template, template[mask])):
        origin = used.min(axis=0) if remove_offset else 0.0
        peak = np.abs(used - origin).max()
        pictures.append((values - origin) / (peak if peak > 0 else 1.0))
    return pictures[0], pictures[1], FLAT**2


def _about_means(products: Any, a_sum: Any, b_sum: Any, n: int) -> Any:
    """``sum(ab) - sum(a) sum(b) / n``; of integers only the last term is rounded: flat gives exactly 0."""
    if np.asarray(b_sum).dtype.kind == "f":
        return products - a_sum * b_sum / n
    quotient, remainder = np.divmod(b_sum, n)
    return (products - a_sum * quotient) - a_sum * remainder / n


def _edges(image: Array, template: Array, mask: Mask) -> tuple[Mask, Mask]:
    """Edge pixels of the image, and those of the template that count."""
    if image.dtype != np.uint8:
        low = min(float(image.min()), float(template.min()))
        span = max(float(image.max()), float(template.max())) - low
        scale = 255 / span if span > 0 else 0.0
        image, template = (np.rint((a.astype(float) - low) * scale).astype(np.uint8) for a in (image, template))
    found = []
    for picture, limit in ((image, EDGE_IMAGE), (template, EDGE_TEMPLATE)):
        smooth = cv2.GaussianBlur(np.ascontiguousarray(picture), (3, 3), 0)
        found.append(cv2.Canny(smooth, limit, limit) > 0)
    inner = np.zeros_like(mask)
    inner[EDGE_MARGIN:-EDGE_MARGIN, EDGE_MARGIN:-EDGE_MARGIN] = True
    return found[0], found[1] & mask & inner


def _squared_distances(edges: Mask) -> Array:
    """Squared distance (px^2, int64) to the nearest edge pixel; the squared diagonal if there is none."""
    if not edges.any():
        return np.full(edges.shape, edges.shape[0] ** 2 + edges.shape[1] ** 2, dtype=np.int64)
    distance = cv2.distanceTransform((~edges).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.rint(distance.astype(np.float64) ** 2).astype(np.int64)


def _sed(image: Array, template: Array, mask: Mask) -> FloatArray:
    image_edges, template_edges = _edges(image, template, mask)
    if not template_edges.any():  # score as an image without edges does
        image_edges, template_edges = np.zeros_like(image_edges), mask
    total = _window_sum(_squared_distances(image_edges), template_edges)
    return np.asarray(total / template_edges.sum(), dtype=np.float64)


# ---------------------------------------------------------------- the same, literally


def _slide(image: Array, template: Array, mask: Mask, measure: Callable[..., float]) -> FloatArray:
    """Eq 1: ``measure(t, f)`` of the (n, channels) values of the template and of each window."""
    h, w = mask.shape
    t = template[mask].astype(np.float64)
    scores = np.empty((image.shape[0] - h + 1, image.shape[1] - w + 1))
    for r in range(scores.shape[0]):
        for c in range(scores.shape[1]):
            scores[r, c] = measure(t, image[r : r + h, c : c + w][mask].astype(np.float64))
    return scores


def _reference_ssd(image: Array, template: Array, mask: Mask) -> FloatArray:
    return _slide(image, template, mask, lambda t, f: float(((t - f) ** 2).sum() / t.size))  # Eq 2


def _reference_sad(image: Array, template: Array, mask: Mask) -> FloatArray:
    return _slide(image, template, mask, lambda t, f: float(np.abs(t - f).sum() / t.size))


def _reference_ncc(image: Array, template: Array, mask: Mask, *, centred: bool = False) -> FloatArray:
    image, template, _ = _rescaled(image, template, mask, centred)

    def ncc(t: FloatArray, f: FloatArray) -> float:
        if centred:
            t, f = t - t.mean(axis=0), f - f.mean(axis=0)
        if min((t * t).sum(), (f * f).sum()) <= FLAT**2 * t.size:
            return 0.0
        return float((t * f).sum() / np.sqrt((t * t).sum() * (f * f).sum()))

    return _slide(image, template, mask, ncc)


def _reference_sed(image: Array, template: Array, mask: Mask) -> FloatArray:
    image_edges, template_edges = _edges(image, template, mask)
    scores = np.empty((image.shape[0] - mask.shape[0] + 1, image.shape[1] - mask.shape[1] + 1))
    if not image_edges.any() or not template_edges.any():
        return np.full_like(scores, image.shape[0] ** 2 + image.shape[1] ** 2)
    targets = np.argwhere(image_edges)
    for r in range(scores.shape[0]):
        for c in range(scores.shape[1]):
            nearest = [((targets - (r + u, c + v)) ** 2).sum(axis=1).min() for u, v in np.argwhere(template_edges)]
            scores[r, c] = np.mean(nearest)
    return scores


# ---------------------------------------------------------------- default thresholds


def _ssd_threshold(image: Array, template: Array, mask: Mask) -> float:
    return UNEXPLAINED * float(template[mask].astype(np.float64).var(axis=0).mean())


def _sad_threshold(image: Array, template: Array, mask: Mask) -> float:
    values = template[mask].astype(np.float64)
    return UNEXPLAINED * float(np.abs(values - np.median(values, axis=0)).mean())


def _ncc_threshold(image: Array, template: Array, mask: Mask) -> float:
    values = template[mask].astype(np.float64)
    values = values / max(float(np.abs(values).max()), np.finfo(float).tiny)
    energy = float((values**2).mean(axis=0).sum())
    flat = float((values.mean(axis=0) ** 2).sum()) / energy if energy > 0 else 1.0
    return float(np.sqrt(min(1.0, 1 - UNEXPLAINED * (1 - flat))))


def _sed_threshold(image: Array, template: Array, mask: Mask) -> float:
    crowded = UNEXPLAINED * float(np.median(_squared_distances(_edges(image, template, mask)[0])))
    return min(crowded, float(min(mask.shape) / 8) ** 2)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("ssd", "mean squared difference (Eq 2)", False, _ssd, _reference_ssd, _ssd_threshold),
        Method("sad", "mean absolute difference", False, _sad, _reference_sad, _sad_threshold),
        Method("ncc", "normalised cross-correlation", True, _ncc, _reference_ncc, _ncc_threshold),
        Method(
            "zncc",
            "zero-mean normalised cross-correlation",
            True,
            partial(_ncc, centred=True),
            partial(_reference_ncc, centred=True),
            lambda image, template, mask: (1 - UNEXPLAINED) ** 0.5,
        ),
        Method("sed", "mean squared edge distance (px^2)", False, _sed, _reference_sed, _sed_threshold),
    )
}
"""The measures by name. Add a :class:`Method` to compare one of your own."""
