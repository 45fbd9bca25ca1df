"""Template matching: similarity images and the places they point to (section 3, Eq 1 and 2).

:func:`similarity` moves a template over every location of an image and compares it with the window below it; the
measures, ``ssd``, ``sad``, ``ncc``, ``zncc`` and ``sed``, are defined in :mod:`occlib.measures`. The paper thresholds
the similarity image and keeps one optimum in each connected component: :func:`find`, which also looks for turned and
scaled objects. :func:`compare` puts the measures side by side, and :func:`matcher` adds one of your own to them.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from occlib.banks import Bank, warps
from occlib.geometry import FloatArray, Image, Mask
from occlib.measures import BUILT_IN, METHODS, Array, Method

__all__ = [
    "METHODS",
    "Comparison",
    "Match",
    "Method",
    "compare",
    "default_threshold",
    "find",
    "matcher",
    "optima",
    "reference_similarity",
    "refine",
    "score_threshold",
    "similarity",
]

THRESHOLDS = ("otsu", "mad")
RULES = ("components", "nms")
RESERVED = ("condition", "criterion", "best", "tied", "area", "low", "high", "statement")
"""Columns that tables have beside those of the measures."""
SPREAD = 5.0
"""Standard deviations, estimated robustly, between the similarity image's median and the threshold ``"mad"``."""

ROUNDING = 1e-12
"""A similarity image whose scores differ by less than this share of the largest is constant."""


@dataclass(frozen=True)
class Match:
    """A place where the template was found.

    ``width`` and ``height`` are the size in px of the template, scaled; ``x``, ``y`` the column and row of its
    top-left pixel, before it is turned about its centre by ``angle`` degrees (counter-clockwise as one sees the
    picture); ``score`` is the value of the similarity image. All are whole numbers of px for a template that is
    neither turned, scaled nor refined below the pixel.
    """

    x: float
    y: float
    score: float
    width: float
    height: float
    angle: float = 0.0
    scale: float = 1.0

    @property
    def centre_px(self) -> tuple[float, float]:
        """Centre ``(x, y)`` in px, pixel centres at integers.

        >>> Match(x=10, y=20, score=0.0, width=5, height=4).centre_px
        (12.0, 21.5)
        """
        return self.x + (self.width - 1) / 2, self.y + (self.height - 1) / 2

    @property
    def corners_px(self) -> FloatArray:
        """Outer corners (4, 2) of the turned template in px, from the top-left one, clockwise when not turned.

        >>> Match(x=10, y=20, score=0.0, width=5, height=4).corners_px[0]
        array([ 9.5, 19.5])
        """
        half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (self.width / 2, self.height / 2)
        cosine, sine = np.cos(np.deg2rad(self.angle)), np.sin(np.deg2rad(self.angle))
        return np.asarray(half @ np.array([[cosine, -sine], [sine, cosine]]) + self.centre_px)


@dataclass(frozen=True)
class Comparison:
    """What one measure made of an image and a template, see :func:`compare`."""

    method: Method
    score: FloatArray
    threshold: float
    matches: list[Match]
    seconds: float


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
        ``"ssd"``, ``"sad"``, ``"ncc"``, ``"zncc"``, ``"sed"`` or one of your own; see :data:`METHODS`.
    mask
        (h, w), the region ``T`` of the template that counts: bool, or weights, finite and not negative, of
        which only the ratios matter. All of it by default.

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
    *Exactness.* For integers from 0 to 65535 and a mask of true and false every sum is exact: identical windows
    score exactly 0 (``ssd``, ``sad``) or 1 (``ncc``, ``zncc``). Everything else is computed in float64 and right to
    1e-9 of the largest value; identical windows still score exactly 0.

    *Nothing to compare.* ``zncc`` is 0 where the window or the template is flat, ``ncc`` is 0 where either
    has no energy; for floats and weights that is a spread, or magnitude, below 1e-5 of the largest in the picture. ``sed`` is the squared diagonal of the image (px^2), more than any real distance, when the
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
    f, t, used = _checked(image, template, mask)
    f, [(t, used)] = measure.prepare(f, [(t, used)])
    return measure.score(f, t, used)


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
    image's edges are), so an image without the object gives no match. A measure of your own may name a threshold
    of its similarity image instead.

    >>> default_threshold(np.zeros((4, 4)), [[0, 2]], "ssd")
    0.5
    """
    measure = _method(method)
    arrays = _checked(image, template, mask)
    if isinstance(measure.default_threshold, str):
        return score_threshold(similarity(image, template, method, mask), method, measure.default_threshold)
    return measure.default_threshold(*arrays)


def score_threshold(score: npt.ArrayLike, method: str, threshold: Any) -> float:
    """The worst score to accept, from a number or from the similarity image itself.

    Parameters
    ----------
    score
        Similarity image of ``method``, any shape; infinite where there is no score.
    method
        One of :data:`METHODS`.
    threshold
        ``"otsu"`` splits the scores in two classes; ``"mad"`` is the median, moved to the better side by 5
        robust standard deviations (1.4826 times the median absolute deviation; where that is 0, 1.2533 times the
        mean absolute deviation, Iglewicz and Hoaglin 1993). A number, in the range of the measure, is returned as
        it is.

    Returns
    -------
    float
        NaN, which no score reaches, for ``"otsu"`` and ``"mad"`` of a constant similarity image.

    Examples
    --------
    >>> round(score_threshold([8, 9, 10, 11, 12], "sad", "mad"), 3)
    2.587
    """
    measure = _method(method)
    if isinstance(threshold, str) and threshold in THRESHOLDS:
        values = np.asarray(score, dtype=np.float64)
        values = values[np.isfinite(values)]
        if values.size == 0 or np.ptp(values) <= ROUNDING * np.abs(values).max():
            return float("nan")
        if threshold == "otsu":
            from skimage.filters import threshold_otsu

            return float(threshold_otsu(values))
        middle = float(np.median(values))
        deviations = np.abs(values - middle)
        spread = 1.4826 * float(np.median(deviations)) or 1.2533 * float(deviations.mean())
        return middle + (SPREAD if measure.higher_is_better else -SPREAD) * spread
    if isinstance(threshold, bool) or not isinstance(threshold, Real) or not np.isfinite(float(threshold)):
        raise ValueError(
            f"threshold: expected a finite number, {', '.join(map(repr, THRESHOLDS))} or None, got {threshold!r}"
        )
    if not measure.bounds[0] <= float(threshold) <= measure.bounds[1]:
        low, high = measure.bounds
        raise ValueError(f"threshold: expected {low:g} to {high:g} for {measure.name}, got {threshold}")
    return float(threshold)


def optima(
    score: npt.ArrayLike,
    method: str,
    limit: float,
    rule: str = "components",
    *,
    size: tuple[int, int] = (1, 1),
    max_count: int | None = None,
) -> npt.NDArray[np.intp]:
    """Places of the optima in a similarity image, best first.

    Parameters
    ----------
    score
        Similarity image (M, N) of ``method``; infinite where there is no score.
    method
        One of :data:`METHODS`.
    limit
        The worst score to accept.
    rule
        ``"components"``, the paper's: one optimum in each 8-connected component of the accepted places. Two
        objects whose components touch count once, and a ragged component that falls apart counts more than once.
        ``"nms"``, non-maximum suppression: every accepted place that nothing within half a template, in both
        directions, beats.
    size
        ``(h, w)`` of the template, for ``"nms"``.
    max_count
        Keep at most this many, the best; all by default.

    Returns
    -------
    ndarray
        (K, 2) rows and columns. Equal scores: the first in row-major order.

    Examples
    --------
    >>> optima([[5, 1, 5, 2, 9]], "sad", 2)
    array([[0, 1],
           [0, 3]])
    >>> optima([[5, 1, 5, 2, 9]], "sad", 2, "nms", size=(1, 4))
    array([[0, 1]])
    """
    measure = _method(method)
    _check_search(rule, max_count)
    values = np.asarray(score, dtype=np.float64)
    if values.ndim != 2 or values.size == 0:
        raise ValueError(f"score: expected a similarity image (rows, columns), got shape {values.shape}")
    cost = -values if measure.higher_is_better else values
    accepted = cost <= (-limit if measure.higher_is_better else limit)
    if rule == "components":
        _, labels = cv2.connectedComponents(accepted.astype(np.uint8), connectivity=8)
        places = np.flatnonzero(accepted)
        places = places[np.argsort(cost.flat[places], kind="stable")]
        _, first = np.unique(labels.flat[places], return_index=True)
        places = places[np.sort(first)]
    else:
        places = _unsuppressed(cost, accepted, size[0] // 2, size[1] // 2)
    return np.stack(np.unravel_index(places[:max_count], values.shape), axis=1)


def refine(score: npt.ArrayLike, places: npt.ArrayLike) -> FloatArray:
    """Optima to a fraction of a pixel: the vertices of the parabolas through each place and its neighbours.

    Parameters
    ----------
    score
        Similarity image (M, N).
    places
        (K, 2) whole rows and columns of optima, as from :func:`optima`.

    Returns
    -------
    ndarray
        float64 (K, 2) rows and columns, moved by at most half a pixel; not at all at a border or on a plateau.

    Examples
    --------
    >>> refine([[9, 1, 5]], [[0, 1]])
    array([[0.        , 1.16666667]])
    """
    values = np.asarray(score, dtype=np.float64)
    moved = [(r + _vertex(values[:, c], r), c + _vertex(values[r], c)) for r, c in np.reshape(places, (-1, 2))]
    return np.reshape(moved, (-1, 2)).astype(np.float64)


def _unsuppressed(cost: FloatArray, accepted: Mask, rows: int, columns: int) -> npt.NDArray[np.intp]:
    """Flat indices of the accepted places that are the best within so many rows and columns, best first."""
    best = cv2.erode(cost, np.ones((2 * rows + 1, 2 * columns + 1), np.uint8))
    places = np.flatnonzero(accepted & (cost == best))
    taken = np.zeros(cost.shape, bool)
    kept = []
    for place in places[np.argsort(cost.flat[places], kind="stable")]:
        r, c = divmod(int(place), cost.shape[1])
        if not taken[r, c]:  # only an equal score can have taken it
            taken[max(r - rows, 0) : r + rows + 1, max(c - columns, 0) : c + columns + 1] = True
            kept.append(place)
    return np.array(kept, dtype=np.intp)


def find(
    image: npt.ArrayLike,
    template: npt.ArrayLike,
    method: str = "ssd",
    threshold: float | str | None = None,
    mask: npt.ArrayLike | None = None,
    *,
    rule: str = "components",
    max_count: int | None = None,
    subpixel: bool = False,
    angles: Iterable[float] = (0.0,),
    scales: Iterable[float] = (1.0,),
    pyramid: int = 0,
) -> list[Match]:
    """Places of a template, best first: threshold the similarity image ``S(r, c)``, keep its optima.

    Parameters
    ----------
    image, template, method, mask
        As for :func:`similarity`.
    threshold
        The worst score to accept, in units of the score (inclusive), or ``"otsu"`` or ``"mad"``, see
        :func:`score_threshold`. Otsu always finds something unless the similarity image is constant, and is
        lenient when few windows match. By default :func:`default_threshold`.
    rule
        ``"components"``, the paper's one optimum per connected component, or ``"nms"``, see :func:`optima`.
    max_count
        At most so many, the best.
    subpixel
        Move each optimum to the vertex of the parabolas through its neighbours, by at most half a pixel.
    angles, scales
        Turns in degrees, counter-clockwise, and factors. The template is warped by each pair, its corners masked
        out, and ``S`` becomes the best of all at each place of the template's centre. What is then larger than the
        image is left out.
    pyramid
        Search a picture smaller by ``2^pyramid`` first and compute ``S`` only where that leaves hope: worth it
        for many angles and scales, large templates and ``sad``. The matches are those of the full search. 0: off.
        Without effect on ``"otsu"`` and ``"mad"``, which need all of ``S``, on ``sed`` and on measures of your own.

    Returns
    -------
    list of Match
        Empty if no score reaches the threshold.

    Examples
    --------
    >>> image = np.zeros((8, 12), np.uint8)
    >>> image[2, 3] = image[5, 9] = 200
    >>> [(match.x, match.y, match.score) for match in find(image, image[1:4, 2:5])]
    [(2, 1, 0.0), (8, 4, 0.0)]
    """
    measure = _method(method)
    f, t, used = _checked(image, template, mask)
    _check_search(rule, max_count, pyramid)
    if threshold is None:
        threshold = _own_threshold(measure, f, t, used)
    bank = Bank.of(measure, f, warps(t, used, f.shape, angles, scales))
    if pyramid and not isinstance(threshold, str):
        limit = score_threshold([], method, threshold)
        cost, which = bank.cost(-limit if measure.higher_is_better else limit, pyramid)
    else:
        cost, which = bank.cost()
        limit = score_threshold(-cost if measure.higher_is_better else cost, method, threshold)
    score = -cost if measure.higher_is_better else cost
    places = optima(score, method, limit, rule, size=t.shape[:2], max_count=max_count)
    if pyramid and subpixel and len(bank.warps) > 1:
        bank.complete(cost, which, places, pyramid)
        score = -cost if measure.higher_is_better else cost
    return [_match(bank, score, int(r), int(c), which[r, c], subpixel, t.shape[:2]) for r, c in places]


def compare(
    image: npt.ArrayLike,
    template: npt.ArrayLike,
    methods: Sequence[str] | None = None,
    *,
    threshold: float | str | None = None,
    mask: npt.ArrayLike | None = None,
    rule: str = "components",
    max_count: int | None = None,
) -> dict[str, Comparison]:
    """What each measure makes of an image and a template: similarity image, threshold, matches and run time.

    ``methods`` are all of :data:`METHODS` by default; ``threshold`` must be a rule that suits all of them, or None.
    The rest as for :func:`find`. ``seconds`` is the time of :func:`similarity`, taken once after a first call on a
    corner of the image, so that nothing is compiled meanwhile.

    >>> image = np.zeros((8, 12), np.uint8)
    >>> image[2, 3] = image[5, 9] = 200
    >>> {name: len(result.matches) for name, result in compare(image, image[1:4, 2:5], ["ssd", "zncc"]).items()}
    {'ssd': 2, 'zncc': 2}
    """
    f, t, used = _checked(image, template, mask)
    results = {}
    for name in METHODS if methods is None else [methods] if isinstance(methods, str) else methods:
        measure = _method(name)
        similarity(f[: t.shape[0], : t.shape[1]], t, name, used)
        started = time.perf_counter()
        score = similarity(f, t, name, used)
        seconds = time.perf_counter() - started
        limit = score_threshold(score, name, _own_threshold(measure, f, t, used) if threshold is None else threshold)
        height, width = t.shape[:2]
        places = optima(score, name, limit, rule, size=(height, width), max_count=max_count)
        matches = [Match(int(x), int(y), float(score[y, x]), width, height) for y, x in places]
        results[name] = Comparison(measure, score, limit, matches, seconds)
    return results


def matcher(
    name: str,
    *,
    higher_is_better: bool,
    description: str = "",
    default_threshold: Callable[[Array, Array, Array], float] | Literal["otsu", "mad"] = "mad",
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> Callable[[Callable[..., npt.ArrayLike]], Callable[..., npt.ArrayLike]]:
    """Decorator: a measure of your own joins :data:`METHODS`, and with them every table and plot.

    Parameters
    ----------
    name
        How it is called from now on; none of the built-in ones.
    higher_is_better, bounds
        Which direction is better, and the least and largest score.
    description
        A few words for tables; the first line of the docstring by default.
    default_threshold
        The worst score to accept by default: a function of the same three arrays, or see :func:`score_threshold`.

    Notes
    -----
    The function gets the image (H, W, C) and the template (h, w, C), both uint8, uint16 or float64, C being 1 or 3,
    and the mask (h, w), bool or float64 weights up to 1. It returns a finite score for every place, any real type,
    (H - h + 1, W - w + 1).

    Examples
    --------
    >>> @matcher("extreme", higher_is_better=False)
    ... def extreme(image, template, mask):
    ...     "Largest absolute difference."
    ...     windows = np.lib.stride_tricks.sliding_window_view(image, template.shape[:2], axis=(0, 1))
    ...     difference = np.abs(np.moveaxis(windows, 2, -1).astype(float) - template)[:, :, mask > 0]
    ...     return difference.max(axis=(2, 3))
    >>> similarity([[1, 2, 3]], [[2, 4]], "extreme")
    array([[2., 1.]])
    >>> del METHODS["extreme"]
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][\w-]*", name) or name in {*BUILT_IN, *RESERVED}:
        taken = ", ".join((*BUILT_IN, *RESERVED))
        raise ValueError(f"name: expected letters, digits, _ and -, and none of {taken}; got {name!r}")
    if not callable(default_threshold) and default_threshold not in THRESHOLDS:
        known = ", ".join(map(repr, THRESHOLDS))
        raise ValueError(f"default_threshold: expected a function or one of {known}, got {default_threshold!r}")

    def register(function: Callable[..., npt.ArrayLike]) -> Callable[..., npt.ArrayLike]:
        def score(image: Array, template: Array, mask: Array) -> FloatArray:
            try:
                values = np.asarray(function(*map(_read_only, (image, template, mask))), dtype=np.float64)
            except Exception as error:
                raise ValueError(f"{name}: {type(error).__name__}: {error}") from error
            shape = image.shape[0] - template.shape[0] + 1, image.shape[1] - template.shape[1] + 1
            if values.shape != shape:
                raise ValueError(
                    f"{name}: expected a score for each of {shape} places of a template {template.shape[:2]} in an image "
                    f"{image.shape[:2]}, got {values.shape}"
                )
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: expected finite scores, got NaN or infinity")
            return values

        text = description or (function.__doc__ or name).strip().splitlines()[0]
        METHODS[name] = Method(name, text, higher_is_better, score, score, default_threshold, bounds=bounds)
        return function

    return register


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
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite values, got NaN or infinity")
    if array.dtype.kind == "f" and float(np.abs(array).max()) > 1e100:
        raise ValueError(f"{name}: expected magnitudes up to 1e100, whose squares can be summed; got more")
    return array.reshape(*array.shape[:2], -1)


def _checked(image: npt.ArrayLike, template: npt.ArrayLike, mask: npt.ArrayLike | None) -> tuple[Image, Image, Array]:
    """Image (H, W, C) and template (h, w, C) of one type, uint8, uint16 or float64, and the mask (h, w)."""
    f, t = _picture(image, "image"), _picture(template, "template")
    if f.shape[2] != t.shape[2]:
        raise ValueError(f"template: expected {f.shape[2]} channel(s) like the image, got {t.shape[2]}")
    if t.shape[0] > f.shape[0] or t.shape[1] > f.shape[1]:
        raise ValueError(f"template: expected no larger than the image {f.shape[:2]}, got {t.shape[:2]}")
    kind: type[Any] = np.float64
    if f.dtype == t.dtype == np.uint8:
        kind = np.uint8
    elif all(a.dtype.kind in "ui" and a.min() >= 0 and a.max() <= 65535 for a in (f, t)):
        kind = np.uint16
    return f.astype(kind, copy=False), t.astype(kind, copy=False), _checked_mask(mask, t.shape[:2])


def _checked_mask(mask: npt.ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Bool where the weights say no more than yes and no, else float64 up to 1."""
    weights = np.ones(shape, bool) if mask is None else np.asarray(mask)
    if weights.dtype.kind not in "buif" or weights.shape != shape:
        raise ValueError(f"mask: expected bool or weights {shape}, got {weights.dtype} {weights.shape}")
    if not np.isfinite(weights).all() or weights.min() < 0:
        raise ValueError("mask: expected finite weights >= 0, got negative ones, NaN or infinity")
    if not weights.any():
        raise ValueError("mask: expected at least one pixel that counts, got none")
    largest = weights.max()
    if ((weights == 0) | (weights == largest)).all():
        return weights > 0
    return weights.astype(np.float64) / float(largest)


def _read_only(values: Array) -> Array:
    view = values.view()
    view.flags.writeable = False
    return view


def _own_threshold(measure: Method, image: Array, template: Array, mask: Array) -> float | str:
    own = measure.default_threshold
    return own if isinstance(own, str) else own(image, template, mask)


def _check_search(rule: str, max_count: Any, pyramid: Any = 0) -> None:
    if rule not in RULES:
        raise ValueError(f"rule: expected one of {', '.join(RULES)}, got {rule!r}")
    if max_count is not None and (
        isinstance(max_count, bool) or not isinstance(max_count, Integral) or int(max_count) < 1
    ):
        raise ValueError(f"max_count: expected a whole number >= 1 or None, got {max_count!r}")
    if isinstance(pyramid, bool) or not isinstance(pyramid, Integral) or not 0 <= int(pyramid) <= 8:
        raise ValueError(f"pyramid: expected a whole number from 0 to 8, got {pyramid!r}")


# ---------------------------------------------------------------- places to matches


def _match(bank: Bank, score: FloatArray, r: int, c: int, number: int, subpixel: bool, size: tuple[int, ...]) -> Match:
    """The match at a place of the joint similarity image; ``size`` is the template's own, (h, w)."""
    warp = bank.warps[number]
    y: float = r + bank.first_centre[0] - (size[0] - 1) // 2
    x: float = c + bank.first_centre[1] - (size[1] - 1) // 2
    height: float = size[0]
    width: float = size[1]
    if warp.scale != 1:
        height, width = size[0] * warp.scale, size[1] * warp.scale
        y, x = y - (height - size[0]) / 2, x - (width - size[1]) / 2
    if subpixel:
        (row, column), *_ = refine(score, [[r, c]])
        y, x = y + float(row) - r, x + float(column) - c
    return Match(x, y, float(score[r, c]), width, height, warp.angle, warp.scale)


def _vertex(score: FloatArray, place: int) -> float:
    """Offset in px, -0.5 to 0.5, of the vertex of the parabola through a place and its two neighbours."""
    if not 0 < place < len(score) - 1:
        return 0.0
    before, here, after = score[place - 1 : place + 2]
    bend = before - 2 * here + after
    if not np.isfinite(bend) or bend == 0:
        return 0.0
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5))
