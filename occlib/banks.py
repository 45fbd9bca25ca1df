"""Banks of turned and scaled templates, and the search from coarse to fine, for :func:`occlib.matching.find`.

A template is warped about its centre by each angle and scale, and the corners that the warp leaves empty are masked
out. The similarity images of all are laid over one another by the templates' centres: at each place the best counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from occlib.geometry import FloatArray, Mask
from occlib.measures import Array, Method

TILE = 64
"""Side in px of the squares of the similarity image that the search from coarse to fine computes at a time."""


@dataclass(frozen=True)
class Warp:
    """A template turned and scaled about its centre; ``mask`` is what of the canvas the template covers."""

    angle: float
    scale: float
    template: Array
    mask: Array


def warps(
    template: Array, mask: Array, shape: tuple[int, ...], angles: Iterable[float], scales: Iterable[float]
) -> list[Warp]:
    """Those that fit into an image of this shape, angle by angle."""
    factors = _numbers(scales, "scales")
    if min(factors) <= 0:
        raise ValueError(f"scales: expected numbers > 0, got {min(factors):g}")
    size = max(factors) * max(template.shape[:2])
    bank = [_warp(template, mask, angle, scale) for angle in _numbers(angles, "angles") for scale in factors]
    fitting = [w for w in bank if w.mask.any() and w.mask.shape[0] <= shape[0] and w.mask.shape[1] <= shape[1]]
    if not fitting:
        raise ValueError(f"scales: expected a scaled template that fits the image {shape[:2]}, got up to {size:.0f} px")
    return fitting


def _warp(template: Array, mask: Array, angle: float, scale: float) -> Warp:
    if angle % 360 == 0 and scale == 1:
        return Warp(angle, scale, template, mask)
    height, width = template.shape[:2]
    cosine, sine = abs(np.cos(np.deg2rad(angle))) * scale, abs(np.sin(np.deg2rad(angle))) * scale
    rows, columns = (  # of the same parity as the template's, so that the centres fall on one grid
        size + 2 * max(-((size - 1) // 2), int(np.ceil((needed - size) / 2 - 1e-9)))
        for size, needed in ((height, sine * width + cosine * height), (width, cosine * width + sine * height))
    )
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), angle, scale)
    matrix[:, 2] += (columns - width) / 2, (rows - height) / 2
    if scale < 1:  # or fine detail would turn into noise; the width is scikit-image's
        template = cv2.GaussianBlur(template, (0, 0), (1 / scale - 1) / 2).reshape(template.shape)
    # What lies beyond the template is its mirror image, not a step that would be taken for an edge.
    warped = cv2.warpAffine(
        template, matrix, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    weights = cv2.warpAffine(mask.astype(np.float64), matrix, (columns, rows), flags=cv2.INTER_LINEAR)
    used = weights > 0.999 if mask.dtype == np.bool_ else weights
    return Warp(angle, scale, warped.reshape(rows, columns, -1), used.reshape(rows, columns))


@dataclass(frozen=True)
class Bank:
    """Templates whose similarity images are laid over one another by their centres, the best one counting."""

    measure: Method
    image: Array
    warps: Sequence[Warp]

    @classmethod
    def of(cls, measure: Method, image: Array, warps: Sequence[Warp]) -> Bank:
        """With image and templates prepared as the measure wants them."""
        image, pairs = measure.prepare(image, [(warp.template, warp.mask) for warp in warps])
        return cls(measure, image, [Warp(w.angle, w.scale, *pair) for w, pair in zip(warps, pairs, strict=True)])

    @property
    def first_centre(self) -> tuple[int, int]:
        """Row and column of the image that are the templates' centre, halves rounded down, at the first place."""
        rows, columns = self._window
        return rows.start, columns.start

    @property
    def _window(self) -> tuple[slice, slice]:
        """Rows and columns of the image that can be the centre of any template, halves rounded down."""
        sizes = np.array([warp.mask.shape for warp in self.warps])
        first, last = ((sizes - 1) // 2).min(axis=0), (self.image.shape[:2] - sizes + (sizes - 1) // 2).max(axis=0)
        return slice(int(first[0]), int(last[0]) + 1), slice(int(first[1]), int(last[1]) + 1)

    def cost(self, limit: float = np.inf, levels: int = 0) -> tuple[FloatArray, Array]:
        """The joint similarity image as the least cost of any template, and which it is; infinite for none.

        With ``levels``, also where a coarse search leaves no hope of a cost up to the limit.
        """
        rows, columns = self._window
        cost = np.full((rows.stop - rows.start, columns.stop - columns.start), np.inf)
        which = np.zeros(cost.shape, np.intp)
        coarse: dict[int, Array] = {}
        for number, warp in enumerate(self.warps):
            step = _coarse_step(self.measure, warp, levels)
            if step > 1 and step not in coarse:
                coarse[step] = _smaller(self.image, np.ones(self.image.shape[:2], bool), step)[0]
            own = (
                _pyramid_cost(self.measure, self.image, warp, limit, coarse[step], step)
                if step > 1
                else _cost(self.measure, self.image, warp)
            )
            y, x = ((size - 1) // 2 - first.start for size, first in zip(warp.mask.shape, self._window, strict=True))
            part = np.s_[y : y + own.shape[0], x : x + own.shape[1]]
            which[part][own < cost[part]] = number
            cost[part] = np.minimum(cost[part], own)
        return cost, which


# ---------------------------------------------------------------- coarse to fine


def _cost(measure: Method, image: Array, warp: Warp) -> FloatArray:
    score = measure.score(image, warp.template, warp.mask)
    return -score if measure.higher_is_better else score


def _coarse_step(measure: Method, warp: Warp, levels: int) -> int:
    """Side in px of a coarse pixel: 4 of them span the template. Of a measure of one's own nothing is known: 1."""
    if not np.isfinite(measure.bounds).any():
        return 1
    return int(2 ** min(levels, np.floor(np.log2(max(min(warp.mask.shape) / 4, 1)))))


def _pyramid_cost(measure: Method, image: Array, warp: Warp, limit: float, coarse: Array, step: int) -> FloatArray:
    """Cost of each place, infinite where the coarse image leaves no hope of a cost up to the limit.

    The coarse image tells where to begin. From there the cost is computed tile by tile until no accepted place
    has a neighbour that is not computed: whole components, and all that sub-pixel positions need.
    """
    h, w = warp.mask.shape
    cost = np.full((image.shape[0] - h + 1, image.shape[1] - w + 1), np.inf)
    done = np.zeros([-(-side // TILE) for side in cost.shape], bool)  # divided and rounded up
    wanted = _tiles_of(_hopeful(measure, coarse, warp, limit, step, cost.shape), done.shape)
    while wanted.any():
        done |= wanted
        if done.sum() * (TILE + h) * (TILE + w) > image.shape[0] * image.shape[1]:
            return _cost(measure, image, warp)  # faster in one piece
        for y, x in np.argwhere(wanted) * TILE:
            piece = image[y : y + TILE + h - 1, x : x + TILE + w - 1]
            cost[y : y + TILE, x : x + TILE] = _cost(measure, piece, warp)
        near = cv2.dilate((cost <= limit).astype(np.uint8), np.ones((3, 3), np.uint8))
        wanted = _tiles_of(near, done.shape) & ~done
    return cost


def _tiles_of(places: Array, grid: tuple[int, ...]) -> Mask:
    padded = np.zeros((grid[0] * TILE, grid[1] * TILE), bool)
    padded[: places.shape[0], : places.shape[1]] = places
    return np.asarray(padded.reshape(grid[0], TILE, grid[1], TILE).any(axis=(1, 3)))


def _hopeful(measure: Method, coarse: Array, warp: Warp, limit: float, step: int, shape: tuple[int, ...]) -> Mask:
    """Places near a local optimum of the coarse cost, where the limit is relaxed by what the coarse grid may add."""
    small = Warp(warp.angle, warp.scale, *_smaller(warp.template, warp.mask, step))
    cost = _cost(measure, coarse, small)
    relaxed = _relaxed(measure, limit, _misfit(measure, warp, small, step))
    hopeful = (cost <= relaxed) & (cost == cv2.erode(cost, np.ones((3, 3), np.uint8)))
    places = np.zeros(shape, bool)
    for r, c in np.argwhere(hopeful) * step:
        places[max(r - step, 0) : r + step + 1, max(c - step, 0) : c + step + 1] = True
    return places


def _smaller(picture: Array, mask: Array, step: int) -> tuple[FloatArray, Array]:
    """Weighted means of squares of ``step`` px, and the mean weights; what does not fill a square is cut off."""
    rows, columns = picture.shape[0] // step, picture.shape[1] // step

    def total(values: Array) -> FloatArray:
        blocks = values[: rows * step, : columns * step].astype(np.float64).reshape(rows, step, columns, step, -1)
        return np.asarray(blocks.sum(axis=(1, 3)))

    weights = total(mask)
    means = total(picture * mask[:, :, None]) / np.where(weights > 0, weights, 1)
    return means, np.ones((rows, columns), bool) if mask.all() else weights[:, :, 0] / step**2


def _misfit(measure: Method, warp: Warp, small: Warp, step: int) -> float:
    """Worst cost of a template whose exact copy lies half a square beside the coarse grid."""
    h, w = warp.mask.shape
    if not np.ptp(warp.template):  # nothing to compare, or edges, whose distance grows no faster than the shift
        return float(step**2)
    padded = np.pad(warp.template, ((0, step), (0, step), (0, 0)), mode="symmetric")
    shifts = (0, step // 2), (step // 2, 0), (step // 2, step // 2)
    copies = [_smaller(padded[dy : dy + h, dx : dx + w], np.ones((h, w), bool), step)[0] for dy, dx in shifts]
    return max(float(_cost(measure, copy, small)[0, 0]) for copy in copies)


def _relaxed(measure: Method, limit: float, misfit: float) -> float:
    """The cost of a window at the limit that also misses the grid: what either leaves unexplained adds up."""
    if measure.higher_is_better:
        return float(-np.sqrt(max(0.0, limit**2 + misfit**2 - 1))) if limit < 0 else np.inf
    return limit + misfit


def _numbers(values: Iterable[float], name: str) -> list[float]:
    numbers = np.asarray(list(values) if isinstance(values, Iterable) else [values])
    if numbers.ndim != 1 or numbers.size == 0 or numbers.dtype.kind not in "uif" or not np.isfinite(numbers).all():
        raise ValueError(f"{name}: expected one or more finite numbers, got {values!r}")
    return [float(number) for number in numbers]
