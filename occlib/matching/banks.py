"""Banks of turned and scaled templates, and the search from coarse to fine, for :func:`occlib.matching.search.find`.

A template is warped about its centre by each angle and scale, and the corners that the warp leaves empty are masked
out. The similarity images of all are laid over one another by the templates' centres: at each place the best counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from occlib.base.arrays import FloatArray, Mask
from occlib.matching.measures import Array, Method

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
    wanted = [(angle, scale) for angle in _numbers(angles, "angles") for scale in factors]
    sizes = [_canvas(template.shape, angle, scale) for angle, scale in wanted]
    small = [scale * min(template.shape[:2]) >= 0.5 for _, scale in wanted]  # px: less has no pixel of its own
    fits = [rows <= shape[0] and columns <= shape[1] for rows, columns in sizes]
    bank = [_warp(template, mask, *pair) for pair, *good in zip(wanted, small, fits, strict=True) if all(good)]
    if not any(warp.mask.any() for warp in bank):
        raise ValueError(
            f"scales: expected a template, turned and scaled, with a whole pixel and no larger than the image "
            f"{shape[:2]}; none of {len(wanted)} is"
        )
    return [warp for warp in bank if warp.mask.any()]


def _canvas(shape: tuple[int, ...], angle: float, scale: float) -> tuple[int, int]:
    """Rows and columns that hold the warped template, of its parity, so that the centres fall on one grid."""
    height, width = shape[:2]
    if angle % 360 == 0 and scale == 1:
        return height, width
    cosine, sine = abs(np.cos(np.deg2rad(angle))) * scale, abs(np.sin(np.deg2rad(angle))) * scale
    rows, columns = (
        size + 2 * max(-((size - 1) // 2), int(np.ceil((needed - size) / 2 - 1e-9)))
        for size, needed in ((height, sine * width + cosine * height), (width, cosine * width + sine * height))
    )
    return rows, columns


def _warp(template: Array, mask: Array, angle: float, scale: float) -> Warp:
    if angle % 360 == 0 and scale == 1:
        return Warp(angle, scale, template, mask)
    height, width = template.shape[:2]
    rows, columns = _canvas(template.shape, angle, scale)
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), angle, scale)
    matrix[:, 2] += (columns - width) / 2, (rows - height) / 2
    if scale < 1:  # or fine detail would turn into noise; the width is scikit-image's
        template = cv2.GaussianBlur(template, (0, 0), (1 / scale - 1) / 2).reshape(template.shape)
    # What lies beyond the template is its mirror image, not a step that would be taken for an edge.
    warped = cv2.warpAffine(
        template, matrix, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    weights = cv2.warpAffine(mask.astype(np.float64), matrix, (columns, rows), flags=cv2.INTER_LINEAR)
    if mask.dtype == np.bool_:
        used = weights > 0.999
    else:  # nor may a pixel count that is partly made of hidden ones
        seen = cv2.warpAffine((mask > 0).astype(np.float64), matrix, (columns, rows), flags=cv2.INTER_LINEAR)
        used = np.where(seen > 0.999, weights, 0.0)
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
        steps = [_coarse_step(self.measure, warp, levels) for warp in self.warps]
        for number, step in enumerate(steps):
            if step == 1:
                self._lay_over(cost, which, number)
        if max(steps) > 1:
            self._search(cost, which, limit, steps)
        return cost, which

    def _search(self, cost: FloatArray, which: Array, limit: float, steps: Sequence[int]) -> None:
        """Lay over the rest, beginning where the coarse image leaves hope of a cost up to the limit.

        From there a template's cost is computed tile by tile until none of the places that it won has a neighbour
        where it is not computed: whole components.
        """
        coarse = {step: _smaller(self.image, step) for step in {*steps} - {1}}
        wanted, done = {}, {}
        for number, (warp, step) in enumerate(zip(self.warps, steps, strict=True)):
            if step > 1:
                shape = cost[self._part(warp)].shape
                done[number] = np.zeros([-(-side // TILE) for side in shape], bool)  # divided and rounded up
                hopeful = _hopeful(self.measure, coarse[step], warp, limit, step, shape)
                wanted[number] = _tiles_of(hopeful, done[number].shape)
        while any(tiles.any() for tiles in wanted.values()):
            for number, tiles in wanted.items():
                h, w = self.warps[number].mask.shape
                done[number] |= tiles
                if tiles.any() and done[number].sum() * (TILE + h) * (TILE + w) > self.image[:, :, 0].size:
                    done[number][:] = True
                    self._lay_over(cost, which, number)  # faster in one piece
                else:
                    for y, x in np.argwhere(tiles) * TILE:
                        self._lay_over(cost, which, number, int(y), int(x), TILE)
            for number in wanted:
                won = ((cost <= limit) & (which == number))[self._part(self.warps[number])]
                near = cv2.dilate(won.astype(np.uint8), np.ones((3, 3), np.uint8))
                wanted[number] = _tiles_of(near, done[number].shape) & ~done[number]

    def complete(self, cost: FloatArray, which: Array, places: Array, levels: int) -> None:
        """Let every template compete for the neighbours of these places too, between which the vertex is sought."""
        for number, warp in enumerate(self.warps):
            if _coarse_step(self.measure, warp, levels) == 1:
                continue  # it has everywhere
            h, w = warp.mask.shape
            rows, columns = self._part(warp)
            if len(places) * (h + 2) * (w + 2) > self.image[:, :, 0].size:
                self._lay_over(cost, which, number)  # faster in one piece
                continue
            for r, c in places - (rows.start, columns.start):
                if -1 <= r <= rows.stop - rows.start and -1 <= c <= columns.stop - columns.start:
                    self._lay_over(cost, which, number, max(int(r) - 1, 0), max(int(c) - 1, 0), 3)

    def _part(self, warp: Warp) -> tuple[slice, slice]:
        """Where the similarity image of one template lies in the joint one."""
        starts = ((size - 1) // 2 - first for size, first in zip(warp.mask.shape, self.first_centre, strict=True))
        rows, columns = (
            slice(start, start + side - size + 1)
            for start, side, size in zip(starts, self.image.shape[:2], warp.mask.shape, strict=True)
        )
        return rows, columns

    def _lay_over(
        self, cost: FloatArray, which: Array, number: int, y: int = 0, x: int = 0, side: int | None = None
    ) -> None:
        """Let a template compete for the places of its similarity image, or for a square of them."""
        warp = self.warps[number]
        h, w = warp.mask.shape
        piece = self.image if side is None else self.image[y : y + side + h - 1, x : x + side + w - 1]
        own = _cost(self.measure, piece, warp)
        part = self._part(warp)
        part = np.s_[part[0].start + y :, part[1].start + x :]
        old, chosen = (array[part][: own.shape[0], : own.shape[1]] for array in (cost, which))
        better = (own < old) | ((own == old) & (number < chosen))
        chosen[better] = number
        old[better] = own[better]


def _cost(measure: Method, image: Array, warp: Warp) -> FloatArray:
    score = measure.score(image, warp.template, warp.mask)
    return -score if measure.higher_is_better else score


def _coarse_step(measure: Method, warp: Warp, levels: int) -> int:
    """Side in px of a coarse pixel: 4 of them span the template."""
    if not measure.coarse_to_fine:
        return 1
    return int(2 ** min(levels, np.floor(np.log2(max(min(warp.mask.shape) / 4, 1)))))


def _tiles_of(places: Array, grid: tuple[int, ...]) -> Mask:
    padded = np.zeros((grid[0] * TILE, grid[1] * TILE), bool)
    padded[: places.shape[0], : places.shape[1]] = places
    return np.asarray(padded.reshape(grid[0], TILE, grid[1], TILE).any(axis=(1, 3)))


def _hopeful(measure: Method, coarse: Array, warp: Warp, limit: float, step: int, shape: tuple[int, ...]) -> Mask:
    """Places near a coarse cost up to the limit, which is relaxed by what the coarse grid may add."""
    small = _coarse(warp, step)
    if not small.mask.any():
        return np.ones(shape, bool)
    cost = _cost(measure, coarse, small)
    half = step // 2
    places = np.zeros(shape, bool)
    for r, c in np.argwhere(cost <= _relaxed(measure, limit, warp, small, step)) * step - half:
        places[max(r - half, 0) : r + half + 1, max(c - half, 0) : c + half + 1] = True
    return places


def _coarse(warp: Warp, step: int, dy: int = 0, dx: int = 0) -> Warp:
    """The template on the coarse grid, as if moved up and left by so many px, up to half a square.

    A rim of half a square is left out: a copy beside the grid mixes it with what lies around the copy.
    """
    rows, columns = (size // step * step - step for size in warp.mask.shape)
    rim = step // 2
    part = np.s_[rim + dy : rim + dy + rows, rim + dx : rim + dx + columns]
    template, mask = warp.template[part], warp.mask[part]
    whole = mask.reshape(rows // step, step, columns // step, step).min(axis=(1, 3))  # or squares mix in what is hidden
    return Warp(warp.angle, warp.scale, _smaller(template, step), whole)


def _smaller(picture: Array, step: int) -> FloatArray:
    """Means of squares of ``step`` px; what does not fill a square is cut off."""
    rows, columns = picture.shape[0] // step, picture.shape[1] // step
    squares = picture[: rows * step, : columns * step].astype(np.float64).reshape(rows, step, columns, step, -1)
    return np.asarray(squares.mean(axis=(1, 3)))


def _relaxed(measure: Method, limit: float, warp: Warp, small: Warp, step: int) -> float:
    """The cost of a window at the limit that also misses the grid: what either leaves unexplained adds up."""
    half = step // 2
    shifts = [(dy, dx) for dy in (-half, 0, half) for dx in (-half, 0, half)]
    misfit = max(float(_cost(measure, _coarse(warp, step, *shift).template, small)[0, 0]) for shift in shifts)
    if not measure.higher_is_better:
        return limit + misfit
    kept = _contrast(measure, small) / max(_contrast(measure, warp), np.finfo(float).tiny)
    explained = 1 - (1 - limit**2) / max(kept, np.finfo(float).tiny) - (1 - misfit**2)
    return float(-np.sqrt(explained)) if limit < 0 < explained else np.inf


def _contrast(measure: Method, warp: Warp) -> float:
    """What of the template a correlation explains: its variance or, not centred, its mean square."""
    values, weights = warp.template[warp.mask > 0].astype(np.float64), warp.mask[warp.mask > 0].astype(np.float64)
    origin = np.average(values, axis=0, weights=weights) if measure.centred else 0.0
    return float(np.average((values - origin) ** 2, axis=0, weights=weights).mean())


def _numbers(values: Iterable[float], name: str) -> list[float]:
    numbers = np.asarray(list(values) if isinstance(values, Iterable) else [values])
    if numbers.ndim != 1 or numbers.size == 0 or numbers.dtype.kind not in "uif" or not np.isfinite(numbers).all():
        raise ValueError(f"{name}: expected one or more finite numbers, got {values!r}")
    return [float(number) for number in numbers]
