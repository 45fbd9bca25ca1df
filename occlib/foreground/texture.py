"""Does the floor's texture show through? In shadows and reflections of any strength it does, in front of an object it does not.

Light changes the brightness of a floor by a factor, a mirror image adds some; the floor's grain and joints stay where they are.
So in a window the gradient ``f`` of the frame is held against the gradient ``p`` of the predicted background:

- floor: ``f = beta p + noise``, where ``beta`` is the brightness ratio ``alpha`` in a shadow, near 1 under a reflection, and somewhat
  less than ``alpha`` where a mirror image lies in a shadow;
- object: ``f`` has nothing to do with ``p``.

An object's own texture is noise, too, of unknown strength, so the largest likelihoods of both are compared. With n samples of noise
energy ``s``, the log-odds of an object are

    L = n / 2  log( (sum |f - beta p|^2 + nu) / (sum |f|^2 + nu) ),    nu = n s + TREMBLE sum |p|^2.

Where the background has no texture above the noise, the texture says nothing: L = 0. All is done at half of the picture's size.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.kernels import compiled
from occlib.foreground.pictures import Picture

Float32Array = npt.NDArray[np.float32]

WINDOW = 5
"""Side of the window in px of the halved picture."""

INDEPENDENT = 0.6
"""Share of the window's px that count as samples."""

CERTAIN = 5.0
"""The log-odds are held between these."""

LEAST_BETA = 0.7
"""What is left of the floor's texture at least, as a share of the brightness ratio."""

TREMBLE = 0.1
"""Share of the texture's energy that counts as noise, as edges move by a fraction of a px."""

NOISE_SHARE = 1.5
"""Of the background's energy, so many times the noise's is none of its texture."""


class Products(NamedTuple):
    """At each px of the halved picture ``|p|^2``, ``p.f`` and ``|f|^2``, float32, of gradients over two px; 0 where either is clipped."""

    pp: Float32Array
    fp: Float32Array
    ff: Float32Array


def products_of(frame: Picture, background: Picture) -> Products:
    """The products of a frame's gradients and the background's."""
    found = Products(*(np.empty_like(frame.grey) for _ in range(3)))
    _products(frame.grey, background.grey, frame.clipped | background.clipped, *found)
    return found


@compiled
def _products(frame: Any, background: Any, clipped: Any, pp: Any, fp: Any, ff: Any) -> None:
    rows, columns = frame.shape
    for y in range(rows):
        up, down = max(y - 1, 0), min(y + 1, rows - 1)
        for x in range(columns):
            left, right = max(x - 1, 0), min(x + 1, columns - 1)
            if clipped[y, left] or clipped[y, right] or clipped[up, x] or clipped[down, x]:
                pp[y, x] = fp[y, x] = ff[y, x] = np.float32(0)
                continue
            px, py = background[y, right] - background[y, left], background[down, x] - background[up, x]
            fx, fy = frame[y, right] - frame[y, left], frame[down, x] - frame[up, x]
            pp[y, x], fp[y, x], ff[y, x] = px * px + py * py, px * fx + py * fy, fx * fx + fy * fy


@compiled
def residual_ratio(n: Any, pp: Any, fp: Any, ff: Any, alpha: Any, noise: Any) -> Any:
    """What the best floor leaves of the frame's gradients, over what no floor leaves, from sums over n px."""
    texture = max(pp - np.float32(NOISE_SHARE) * n * noise, np.float32(1e-6))
    beta = min(max(fp / texture, np.float32(LEAST_BETA) * alpha), np.float32(1.05) * max(alpha, np.float32(1)))
    nu = n * noise + np.float32(TREMBLE) * pp
    return (max(ff + beta * (beta * texture - fp - fp), np.float32(0)) + nu) / (ff + nu)


@compiled
def log_odds(n: Any, pp: Any, fp: Any, ff: Any, alpha: Any, noise: Any) -> Any:
    """L of the module's docstring, from sums over n px."""
    return np.float32(INDEPENDENT / 2) * n * np.log(residual_ratio(n, pp, fp, ff, alpha, noise))


def texture_log_odds(
    frame: Picture,
    background: Picture,
    products: Products,
    gain: Float32Array,
    offset: float,
    unsure: Float32Array,
    noise: float,
    cell: int,
) -> Float32Array:
    """L around each px, float32 (H / 2, W / 2).

    Parameters
    ----------
    frame, background, products
        What is compared.
    gain, offset
        The predicted background is ``gain * grey + offset``; a gain for each block of ``cell`` px, float32 (rows, columns).
    unsure
        How much of the level the prediction may be wrong from one side of a block to the other: that much is noise.
    noise
        Energy of the noise of a gradient over two px, grey levels squared.
    """
    pp, fp, ff = (np.asarray(cv2.boxFilter(one, -1, (WINDOW, WINDOW), normalize=False)) for one in products)
    found = np.empty_like(frame.grey)
    _map(frame.grey, background.grey, pp, fp, ff, gain, np.float32(offset), unsure, np.float32(noise), cell, found)
    return found


@compiled
def _map(
    frame: Any,
    background: Any,
    pp: Any,
    fp: Any,
    ff: Any,
    gain: Any,
    offset: Any,
    unsure: Any,
    noise: Any,
    cell: Any,
    out: Any,
) -> None:
    n, one, none = np.float32(WINDOW * WINDOW), np.float32(1), np.float32(NOISE_SHARE * WINDOW * WINDOW) * noise
    surely = np.float32(np.exp(-2 * CERTAIN / (INDEPENDENT * WINDOW * WINDOW)))
    for y in range(frame.shape[0]):
        v = y // cell
        for x in range(frame.shape[1]):
            u = x // cell
            g = gain[v, u]
            energy = g * g * pp[y, x]
            if energy <= none:
                out[y, x] = np.float32(0)
                continue
            level = max(g * background[y, x] + offset, one)
            step = unsure[v, u] * level / np.float32(cell)
            ratio = residual_ratio(n, energy, g * fp[y, x], ff[y, x], frame[y, x] / level, noise + step * step)
            if ratio < surely:  # most of the floor: spare the logarithm
                out[y, x] = np.float32(-CERTAIN)
            else:
                out[y, x] = min(np.float32(INDEPENDENT / 2) * n * np.log(ratio), np.float32(CERTAIN))
