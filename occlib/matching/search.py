"""Template matching: similarity images and the places they point to (section 3, Eq 1 and 2).

:func:`similarity` moves a template over every location of an image and compares it with the window below it; the
measures, ``ssd``, ``sad``, ``ncc``, ``zncc`` and ``sed``, are defined in :mod:`occlib.matching.measures`. The paper thresholds
the similarity image and keeps one optimum in each connected component: :func:`find`, which also looks for turned and
scaled objects. :func:`compare` puts the measures side by side, and :func:`matcher` adds one of your own to them.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray
from occlib.matching.arguments import checked
from occlib.matching.banks import Bank, warps
from occlib.matching.measures import METHODS, Method, known_method
from occlib.matching.optima import check_search, optima, refine
from occlib.matching.thresholds import own_threshold, score_threshold, warn_outside


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
    measure = known_method(method)
    f, t, used = checked(image, template, mask)
    f, [(t, used)] = measure.prepare(f, [(t, used)])
    return measure.score(f, t, used)


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
    measure = known_method(method)
    arrays = checked(image, template, mask)
    own = own_threshold(measure, *arrays)
    limit = score_threshold(similarity(image, template, method, mask), method, own) if isinstance(own, str) else own
    warn_outside(measure, limit)
    return limit


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
    measure = known_method(method)
    f, t, used = checked(image, template, mask)
    check_search(rule, max_count, pyramid)
    by_default = threshold is None
    if threshold is None:
        threshold = own_threshold(measure, f, t, used)
    bank = Bank.of(measure, f, warps(t, used, f.shape, angles, scales))
    if pyramid and not isinstance(threshold, str):
        limit = score_threshold([], method, threshold)
        cost, which = bank.cost(-limit if measure.higher_is_better else limit, pyramid)
    else:
        cost, which = bank.cost()
        limit = score_threshold(-cost if measure.higher_is_better else cost, method, threshold)
    if by_default:
        warn_outside(measure, limit)
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
    f, t, used = checked(image, template, mask)
    results = {}
    for name in METHODS if methods is None else [methods] if isinstance(methods, str) else methods:
        measure = known_method(name)
        similarity(f[: t.shape[0], : t.shape[1]], t, name, used)
        started = time.perf_counter()
        score = similarity(f, t, name, used)
        seconds = time.perf_counter() - started
        limit = score_threshold(score, name, own_threshold(measure, f, t, used) if threshold is None else threshold)
        if threshold is None:
            warn_outside(measure, limit)
        height, width = t.shape[:2]
        places = optima(score, name, limit, rule, size=(height, width), max_count=max_count)
        matches = [Match(int(x), int(y), float(score[y, x]), width, height) for y, x in places]
        results[name] = Comparison(measure, score, limit, matches, seconds)
    return results


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
