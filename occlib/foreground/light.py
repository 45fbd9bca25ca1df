"""How the light of a frame differs from its background's: a gain that varies over the picture, with which the frame is predicted.

The frame is predicted as ``P = clip(G B + o, 0, 255)`` for each channel, from means ``i`` and ``b`` of blocks, as light varies slowly:

1. ``G`` is a surface of second order over the picture and ``o`` a constant, fitted by least squares with Tukey's weights, begun
   at the densest half of the ratios ``i / b`` of blocks that are floor by their texture (:mod:`occlib.foreground.texture`), or of all if
   these are few: objects, lamps and shade do not count.
2. What is left, ``e = log((i - o) / (G b))``, is light, too, where it is small, and in large regions of smoothly varying ``e``: very
   large ones, or such that the background's texture shows through them. A lamp that lights half of a
   room is such a region, and shade of another day. Elsewhere stands an object; its blocks take the gain around them.

A clipped channel tells no more than a bound of ``e``: a clipped block joins the light around it that the bound allows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base.kernels import compiled
from occlib.foreground.pictures import CLIPPED
from occlib.foreground.texture import log_odds

Float32Array = npt.NDArray[np.float32]

BLOCKS = 48
"""Blocks along the longer side of the picture."""

SAMPLES = 600
"""Blocks that the surface is fitted to, about."""

ORDERS = (2, 4, 4, 7, 7, 7)
"""Terms of the surface in each step of the fit: gain and offset, then a slope, then curvature."""

SAME = 0.05
"""Difference of log gain up to which a block is lit as its neighbour, or as the surface says."""

OPAQUE = 1.0
"""Log-odds of its texture from which on a block is no light."""

SURE_LIGHT = -8.0
"""Log-odds of its texture up to which a region is light."""

LARGE = 0.02
"""Share of the picture that a region of light has at least. Smaller ones are shadows, which are told from objects px by px."""

SHOWN = 0.3
"""Share of the blocks of a region of light, clipped ones left out, that the texture shows through one by one."""

VERY_LARGE = 0.3
"""Share of the picture from which on a region is light without any texture."""

DARK = 5.0
"""Grey levels up to which a channel of the background tells no gain."""

UNKNOWN, EXACT, AT_LEAST, AT_MOST = 0, 1, 2, 3
"""What a block's ``e`` is: nothing, itself, or a bound, as the frame or the background is clipped."""


class Light(NamedTuple):
    """The light of a frame against its background's.

    Parameters
    ----------
    gain
        Of each block and channel, float32 (rows, columns, 3).
    offset
        Of each channel in grey levels, float32 (3,).
    jump
        The largest difference of log gain to a neighbouring block, float32 (rows, columns).
    noise
        Energy of the noise of a gradient over two px, grey levels squared: four times the variance of a px.
    known
        Blocks whose light was seen; the others took that of their neighbours, bool (rows, columns).
    floor
        Blocks through which the background's texture shows, whatever the light, bool (rows, columns).
    """

    gain: Float32Array
    offset: Float32Array
    jump: Float32Array
    noise: float
    known: npt.NDArray[np.bool_]
    floor: npt.NDArray[np.bool_]


def block_size(shape: tuple[int, ...]) -> int:
    """Side of a block in px of a picture (H, W)."""
    return max(2, -(-max(shape[:2]) // BLOCKS))


@compiled
def block_means(image: Any, cell: Any) -> Any:
    """Of each block the means of the channels and the shares of them that are clipped, float32 (rows, columns, 6)."""
    height, width = image.shape[:2]
    means = np.empty((-(-height // cell), -(-width // cell), 6), np.float32)
    for v in range(means.shape[0]):
        for u in range(means.shape[1]):
            bottom, right = min((v + 1) * cell, height), min((u + 1) * cell, width)
            size = np.float32((bottom - v * cell) * (right - u * cell))
            for c in range(3):
                total, clipped = 0, 0
                for y in range(v * cell, bottom):
                    for x in range(u * cell, right):
                        total += image[y, x, c]
                        clipped += image[y, x, c] >= CLIPPED
                means[v, u, c], means[v, u, 3 + c] = total / size, clipped / size
    return means


@compiled
def _block_sums(pp: Any, fp: Any, ff: Any, cell: Any) -> Any:
    """Of each block the sums of the texture's products and the number of px, float32 (rows, columns, 4)."""
    height, width = pp.shape
    sums = np.zeros((-(-height // cell), -(-width // cell), 4), np.float32)
    for v in range(sums.shape[0]):
        for u in range(sums.shape[1]):
            bottom, right = min((v + 1) * cell, height), min((u + 1) * cell, width)
            for y in range(v * cell, bottom):
                for x in range(u * cell, right):
                    sums[v, u, 0] += pp[y, x]
                    sums[v, u, 1] += fp[y, x]
                    sums[v, u, 2] += ff[y, x]
            sums[v, u, 3] = (bottom - v * cell) * (right - u * cell)
    return sums


def fit_light(frame: Float32Array, background: Float32Array, products: tuple[Float32Array, ...], cell: int) -> Light:
    """The light of a frame.

    Parameters
    ----------
    frame, background
        Of the halved pictures, by :func:`block_means`.
    products
        Of their gradients, by :func:`occlib.foreground.texture.products_of`.
    cell
        Side of a block in px of the halved picture.
    """
    sums = _block_sums(*products, cell)
    noise, odds = _texture(frame, background, sums)
    floor = (odds < -OPAQUE) & (background[..., :3].min(axis=2) > DARK)
    gain, offset = _surface(frame, background, floor)
    left, kind = _left_over(frame, background, gain, offset)
    known = _known(left, kind, background, sums, gain.mean(axis=2), odds, noise)
    _spread(left, kind, known)
    return Light(gain * np.exp(left), offset, _jumps(left), float(noise), known, floor)


@compiled
def _texture(frame: Any, background: Any, sums: Any) -> Any:
    """The noise, as the median over the blocks of the energy that their gradients leave, and the log-odds of each block's texture."""
    rows, columns = frame.shape[:2]
    energies, odds = np.empty(rows * columns, np.float32), np.empty((rows, columns), np.float32)
    alphas = np.empty((rows, columns), np.float32)
    for v in range(rows):
        for u in range(columns):
            one = sums[v, u]
            a = (frame[v, u, :3].sum() + np.float32(3)) / (background[v, u, :3].sum() + np.float32(3))
            alphas[v, u] = a
            energies[v * columns + u] = max((one[2] - 2 * a * one[1] + a * a * one[0]) / one[3], np.float32(0))
    noise = np.float32(max(np.median(energies), 0.5))
    for v in range(rows):
        for u in range(columns):
            a, one = alphas[v, u], sums[v, u]
            odds[v, u] = log_odds(one[3], a * a * one[0], a * one[1], one[2], np.float32(1), noise)
    return noise, odds


# --- the surface ----------------------------------------------------------------------------------------------
@compiled
def _surface(frame: Any, background: Any, floor: Any) -> Any:
    """The fitted surface: gain (rows, columns, 3) and offset (3,)."""
    rows, columns = frame.shape[:2]
    step = int(np.ceil(np.sqrt(rows * columns / SAMPLES)))
    i, b = np.empty((3, rows * columns), np.float32), np.empty((3, rows * columns), np.float32)
    x, y, ratio = np.empty(rows * columns), np.empty(rows * columns), np.empty(rows * columns)
    seen_through, count = np.empty(rows * columns, np.bool_), 0
    for strict in (True, False):  # leave out what is clipped or black, if enough is left
        count = 0
        for v in range(step // 2, rows, step):
            for u in range(step // 2, columns, step):
                one, other = frame[v, u], background[v, u]
                if strict and (max(one[3:].max(), other[3:].max()) > 0 or one[:3].min() < 3 or other[:3].min() < 6):
                    continue
                i[:, count], b[:, count] = one[:3], other[:3]
                x[count], y[count] = 2 * (u + 0.5) / columns - 1, 2 * (v + 0.5) / rows - 1
                ratio[count] = np.log((one[:3].sum() + 6) / (other[:3].sum() + 6))
                seen_through[count] = floor[v, u]
                count += 1
        if count >= 30:
            break
    start = seen_through[:count] if seen_through[:count].sum() >= 30 else np.ones(count, np.bool_)
    low, high = _densest_half(ratio[:count][start])
    dense = start & (ratio[:count] >= low) & (ratio[:count] <= high)
    gain, offset = np.empty((rows, columns, 3), np.float32), np.empty(3, np.float32)
    for c in range(3):
        fit = _robust_fit(i[c, :count], b[c, :count], x[:count], y[:count], dense, np.exp((low + high) / 2))
        offset[c] = fit[1]
        for v in range(rows):
            for u in range(columns):
                s, t = 2 * (u + 0.5) / columns - 1, 2 * (v + 0.5) / rows - 1
                value = fit[0] + fit[2] * s + fit[3] * t + fit[4] * s * s + fit[5] * s * t + fit[6] * t * t
                gain[v, u, c] = max(value, 0.05)
    return gain, offset


@compiled
def _densest_half(values: Any) -> Any:
    """The shortest interval that holds half of the values (least median of squares, Rousseeuw 1984)."""
    ordered = np.sort(values)
    count = (len(ordered) + 1) // 2
    best = 0
    for k in range(len(ordered) - count + 1):
        if ordered[k + count - 1] - ordered[k] < ordered[best + count - 1] - ordered[best]:
            best = k
    return ordered[best], ordered[best + count - 1]


@compiled
def _robust_fit(i: Any, b: Any, x: Any, y: Any, dense: Any, gain: Any) -> Any:
    """Coefficients of b, 1, bx, by, bxx, bxy, byy that give i: iterated least squares from the dense samples on."""
    count = len(i)
    terms, found = np.ones((7, count)), np.zeros(7)
    terms[0], terms[2], terms[3] = b, b * x, b * y
    terms[4], terms[5], terms[6] = b * x * x, b * x * y, b * y * y
    weights, target = dense.astype(np.float64), i - gain * b
    for n in ORDERS:
        scale = np.empty(n)
        for p in range(n):
            scale[p] = 1 / (np.sqrt((weights * terms[p] * terms[p]).sum()) + 1e-6)
        matrix, vector = np.empty((n, n)), np.empty(n)
        for p in range(n):
            share = weights * terms[p]
            vector[p] = scale[p] * (share * target).sum()
            for q in range(p + 1):
                matrix[p, q] = matrix[q, p] = scale[p] * scale[q] * (share * terms[q]).sum()
            matrix[p, p] += 3e-3 if p == 1 else 1e-4  # no offset and no slope where a flat background cannot tell
        solution = np.linalg.solve(matrix, vector)
        left = target.copy()
        for p in range(n):
            found[p] = scale[p] * solution[p]
            left -= found[p] * terms[p]
        quarter = count // 4
        sigma = max(3.14 * np.partition(np.abs(left), quarter)[quarter], 1.0)  # right with three quarters astray
        inside = np.maximum(1 - (left / (4.7 * sigma)) ** 2, 0)
        weights = inside * inside
    found[0] += gain
    return found


# --- what the surface leaves -----------------------------------------------------------------------------------
@compiled
def _left_over(frame: Any, background: Any, gain: Any, offset: Any) -> Any:
    """``e`` of each block and channel, and what it is: exact where one channel at least is; the others take its value."""
    rows, columns = frame.shape[:2]
    left, kind = np.empty((rows, columns, 3), np.float32), np.empty((rows, columns), np.uint8)
    for v in range(rows):
        for u in range(columns):
            one, other, exact, total = frame[v, u], background[v, u], 0, np.float32(0)
            for c in range(3):
                level = max(one[c] - offset[c], np.float32(0)) + np.float32(1)
                left[v, u, c] = np.log(level / (gain[v, u, c] * other[c] + np.float32(1)))
                if max(one[3 + c], other[3 + c]) < 0.1 and other[c] > DARK:
                    exact, total = exact + 1, total + left[v, u, c]
            if exact:
                kind[v, u] = EXACT
                for c in range(3):
                    if max(one[3 + c], other[3 + c]) >= 0.1 or other[c] <= DARK:
                        left[v, u, c] = total / np.float32(exact)
                continue
            left[v, u] = left[v, u].mean()
            kind[v, u] = UNKNOWN
            if one[3:].min() > 0.5 and other[3:].max() < 0.1 and other[:3].min() > DARK:
                kind[v, u] = AT_LEAST
            elif other[3:].min() > 0.5 and one[3:].max() < 0.1:
                kind[v, u] = AT_MOST
    return left, kind


@compiled
def _known(left: Any, kind: Any, background: Any, sums: Any, gain: Any, odds: Any, noise: Any) -> Any:
    """Whether each block is light: small ``e``, or in a large region that the texture shows through, or in a very large one."""
    rows, columns = kind.shape
    known, seen = np.zeros((rows, columns), np.bool_), np.zeros((rows, columns), np.bool_)
    for v in range(rows):
        for u in range(columns):
            opaque = odds[v, u] > OPAQUE
            known[v, u] = kind[v, u] == EXACT and not opaque and np.abs(left[v, u]).max() < SAME
            seen[v, u] = kind[v, u] == UNKNOWN or (kind[v, u] == EXACT and (opaque or known[v, u]))
    stack = np.empty(rows * columns, np.int64)
    for start in range(rows * columns):
        if seen[start // columns, start % columns] or kind[start // columns, start % columns] != EXACT:
            continue
        stack[0], count, done, exact, shown = start, 1, 0, 0, 0
        seen[start // columns, start % columns] = True
        pp = fp = ff = n = total = np.float32(0)
        while done < count:
            v, u = stack[done] // columns, stack[done] % columns
            done += 1
            if kind[v, u] == EXACT:
                g, one = gain[v, u], sums[v, u]
                pp, fp, ff, n = pp + g * g * one[0], fp + g * one[1], ff + one[2], n + one[3]
                exact, total, shown = exact + 1, total + left[v, u].mean(), shown + (odds[v, u] < -OPAQUE)
            for k in range(4):
                w, t = v + (k == 0) - (k == 1), u + (k == 2) - (k == 3)
                if 0 <= w < rows and 0 <= t < columns and not seen[w, t]:
                    if _alike(left, kind, background, v, u, w, t, total / np.float32(exact)):
                        seen[w, t] = True
                        stack[count] = w * columns + t
                        count += 1
        is_light = count > VERY_LARGE * rows * columns or (
            count > LARGE * rows * columns
            and shown > SHOWN * exact
            and log_odds(n, pp, fp, ff, np.float32(np.exp(total / np.float32(exact))), noise) < SURE_LIGHT
        )
        for k in range(count):
            v, u = stack[k] // columns, stack[k] % columns
            known[v, u] = is_light and kind[v, u] == EXACT
            seen[v, u] = is_light or kind[v, u] == EXACT
    return known


@compiled
def _alike(left: Any, kind: Any, background: Any, v: Any, u: Any, w: Any, t: Any, mean: Any) -> Any:
    """Whether a block (w, t) is lit as its neighbour (v, u) of a region with the given mean ``e``."""
    if kind[w, t] == EXACT and kind[v, u] == EXACT:
        dark = min(background[v, u, :3].min(), background[w, t, :3].min())
        return np.abs(left[v, u] - left[w, t]).max() < SAME + 2 / dark
    step = left[w, t].mean() - mean
    if kind[w, t] == EXACT:
        return abs(step) < 2 * SAME
    return (kind[w, t] == AT_LEAST and step < SAME < mean) or (kind[w, t] == AT_MOST and step > -SAME > mean)


@compiled
def _spread(left: Any, kind: Any, known: Any) -> None:
    """``e`` of light goes on into the blocks around, ring by ring: as far as their bounds allow, and then into what is left."""
    rows, columns = kind.shape
    reached, fresh = known.copy(), np.zeros((rows, columns), np.bool_)
    value, total = np.zeros((rows, columns, 3), np.float32), np.zeros(3, np.float32)
    for bounded in (True, False):
        changed = known.any()
        while changed:
            changed = False
            for v in range(rows):
                for u in range(columns):
                    if reached[v, u]:
                        continue
                    total[:], count = 0, 0
                    for w in range(max(v - 1, 0), min(v + 2, rows)):
                        for t in range(max(u - 1, 0), min(u + 2, columns)):
                            if reached[w, t] and not (bounded and _is_beyond(left, kind, v, u, w, t)):
                                total += left[w, t]
                                count += 1
                    if count:
                        value[v, u], fresh[v, u], changed = total / np.float32(count), True, True
            for v in range(rows):
                for u in range(columns):
                    if fresh[v, u]:
                        left[v, u], reached[v, u], fresh[v, u] = value[v, u], True, False
    if not known.any():
        left[:] = 0


@compiled
def _is_beyond(left: Any, kind: Any, v: Any, u: Any, w: Any, t: Any) -> Any:
    """Whether the ``e`` of a block (w, t) lies beyond the bound of its clipped neighbour (v, u)."""
    step = left[w, t].mean() - left[v, u].mean()
    return (kind[v, u] == AT_LEAST and step < -SAME) or (kind[v, u] == AT_MOST and step > SAME)


@compiled
def _jumps(left: Any) -> Any:
    rows, columns = left.shape[:2]
    jump = np.zeros((rows, columns), np.float32)
    for v in range(rows):
        for u in range(columns):
            for w in range(max(v - 1, 0), min(v + 2, rows)):
                for t in range(max(u - 1, 0), min(u + 2, columns)):
                    for c in range(3):
                        jump[v, u] = max(jump[v, u], abs(left[v, u, c] - left[w, t, c]))
    return jump
