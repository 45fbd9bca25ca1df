"""Shadows, reflections and other light told from objects: soft evidence of foreground, beyond the paper's difference.

The evidence of a px are log-odds of "an opaque object" against "the floor", in four steps:

1. What would the floor look like? The background is moved if the camera was bumped (:mod:`occlib.foreground.alignment`) and lit as the
   frame is (:mod:`occlib.foreground.light`): the prediction ``P``.
2. Colour. A shadow scales the floor's colour and leaves its direction, ``I = alpha P``; so the change is split (Horprasert et al.
   1999) into brightness ``alpha = I.P / P.P`` and chroma ``|I - alpha P|``, each in units of its threshold, which is where object and
   floor are equally likely if nothing else has changed:

       chroma:          |I - alpha P|     /  (least_chroma s + chroma |P| + slack)
       darker, alpha<1: the less of  (1 - alpha) / (1 - darkest)  and  (1 - alpha) |P| / (least_step s sqrt 3 + bright |P| + 3 slack)
       brighter:        (alpha - 1) |P|  /  (least_step s sqrt 3 + bright |P| + 3 slack)

   ``s`` is the frame's noise, and ``slack`` what edges, screens and leaves add. Log-odds are ``steepness (r - 1)`` for the root r of the
   squares' sum.
3. Texture: added are the log-odds of whether the floor's texture shows through (:mod:`occlib.foreground.texture`): shadows of any depth
   and mirror images are floor where it does, and an object of the floor's colour is an object where it does not.
4. Evidence follows the edges of the change (:mod:`occlib.foreground.guided`), and floor that an object of the background has left is no
   object (:mod:`occlib.foreground.uncovered`).

Log-odds of -4 to 4 are evidence of 0 to 255; 128 is even odds. Where frame and prediction are both clipped, nothing has changed.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any

import cv2
import numpy as np

from occlib.base import checks
from occlib.base.arrays import Image
from occlib.base.kernels import compiled
from occlib.foreground.background import Background
from occlib.foreground.evidence import Evidence
from occlib.foreground.guided import follow_edges
from occlib.foreground.pictures import CLIPPED, halved, picture_of
from occlib.foreground.texture import CERTAIN, texture_log_odds
from occlib.foreground.uncovered import uncovered_floor

SURE = 128
"""Soft evidence of foreground from this value on is foreground (0 surely background, 255 surely foreground)."""

FULL = 4.0
"""Log-odds at which evidence is 255; 0 at minus these."""

UNCHANGED = 1.75
"""A px is unchanged, whatever its colour, if its three channels together changed by so many times the noise of two px, or less."""

DOUBT = 64
"""Evidence of the mean of four px below which they are not looked at one by one."""

JUMP = 0.1
"""Of a jump of the light between blocks: so far the prediction may be wrong."""

LEAST_JUMP = 0.1
"""Log gain from which on a jump may be a hard edge of light, and a px takes the gain around it that suits it best."""


@dataclass(frozen=True)
class ShadowModel:
    """What the floor may look like in shadows, under reflections and with noise; the rest is an object (see the module).

    Parameters
    ----------
    chroma
        Change of colour, as a share of the brightness, that speaks for an object.
    least_chroma
        The same on a dark floor, in units of the frame's noise or grey levels, whichever is more.
    darkest
        A shadow leaves about this share of the light; what is darker is rather an object.
    bright
        Gain of brightness, as a share, that speaks for an object.
    least_step
        The same on a dark floor, in units of the frame's noise or grey levels, whichever is more.
    steepness
        How fast evidence becomes sure on either side of a threshold.

    Notes
    -----
    Chosen on twelve development rooms (four cameras, random floors, gloss and lamps), where every second frame was scored against exact
    silhouettes. Half of the missed share plus half of the false share of the silhouettes' area, and the share of objects of which less than
    half is seen: 0.079 and 0.013 (before: 0.118 and 0.084). ``darkest`` 0.4 and 0.6: 0.079 and 0.082; ``chroma`` 0.008 and 0.018: 0.078 and
    0.082; ``least_chroma`` 1.25 and 2.5: 0.079 and 0.082; ``bright`` 0.03 and 0.08: 0.079 and 0.080; ``least_step`` 1.4 and 2.8: 0.079;
    ``steepness`` 4 and 9: 0.079 and 0.080.
    """

    chroma: float = 0.01
    least_chroma: float = 1.75
    darkest: float = 0.5
    bright: float = 0.05
    least_step: float = 2.0
    steepness: float = 6.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            checks.number(name, value, least=0, most=0.99 if name == "darkest" else None)
        for name in ("least_chroma", "least_step", "steepness"):
            checks.number(name, getattr(self, name), above=0)

    def evidence(self, image: Image, background: Background) -> Evidence:
        """:func:`foreground_evidence` of a uint8 RGB image as the evidence of a view."""
        return Evidence(foreground_evidence(image, background, shadows=self), SURE - 0.5, SURE - 1, soft=True)


def foreground_evidence(image: Image, background: Background, *, shadows: ShadowModel = ShadowModel()) -> Image:
    """How surely each pixel shows an object, its shadow and its mirror image left out. uint8 (H, W), 128 is even odds.

    Parameters
    ----------
    image
        uint8 RGB of the background's size.
    background
        The empty floor; under other light, moved by some px, or with objects that have left since.
    shadows
        What a floor may look like.
    """
    if image.shape != background.image.shape or image.dtype != np.uint8:
        raise ValueError(f"image: expected uint8 {background.image.shape}, got {image.dtype} {image.shape}")
    frame, reference = picture_of(image), background.reference
    if any(shift := reference.shift(frame)):
        reference = background.moved(*shift).reference
    (products, light), cell = reference.light(frame), reference.cell
    gain, offset = light.gain.mean(axis=2), float(light.offset.mean())
    texture = texture_log_odds(frame, reference.picture, products, gain, offset, light.jump, light.noise, cell)
    evidence, change = (np.zeros(frame.image.shape[:2], np.uint8) for _ in range(2))
    _evidence(
        frame.image,
        frame.half,
        reference.levels,
        reference.picture.half,
        reference.slack,
        light.gain,
        light.offset,
        light.jump,
        cell,
        texture,
        np.array(astuple(shadows), np.float32),
        np.float32(light.noise),
        evidence,
        change,
    )
    evidence = follow_edges(evidence, change)
    gone = uncovered_floor(halved(evidence) >= SURE, gain.mean() * np.sqrt(products.pp), np.sqrt(products.ff))
    if gone.any():
        evidence[cv2.resize(gone.view(np.uint8), evidence.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0] = 0
    if evidence.shape != image.shape[:2]:
        evidence = np.asarray(cv2.resize(evidence, image.shape[1::-1], interpolation=cv2.INTER_LINEAR))
    return evidence


@compiled
def _evidence(
    image: Any,
    half: Any,
    background: Any,
    half_background: Any,
    slack: Any,
    gains: Any,
    offset: Any,
    jump: Any,
    cell: Any,
    texture: Any,
    model: Any,
    noise: Any,
    out: Any,
    changes: Any,
) -> None:
    """Steps 1 to 3: the evidence of each px, and the mean change of its channels; four px at a time where nothing has changed."""
    rows, columns = gains.shape[:2]
    height, width = half.shape[:2]
    nothing = np.float32(UNCHANGED * UNCHANGED) * noise
    before, after, share = np.empty(width, np.uint32), np.empty(width, np.uint32), np.empty(width, np.float32)
    for x in range(width):
        before[x], after[x], share[x] = _between(x, cell, columns)
    row = np.empty((3, columns), np.float32)
    for y in range(height):
        v, v1, dv = _between(y, cell, rows)
        for u in range(columns):
            for c in range(3):
                row[c, u] = gains[v, u, c] + dv * (gains[v1, u, c] - gains[v, u, c])
        v = y // cell
        for x in range(width):
            u, u1, du = before[x], after[x], share[x]
            g0 = row[0, u] + du * (row[0, u1] - row[0, u])
            g1 = row[1, u] + du * (row[1, u1] - row[1, u])
            g2 = row[2, u] + du * (row[2, u1] - row[2, u])
            i0, i1, i2 = np.float32(half[y, x, 0]), np.float32(half[y, x, 1]), np.float32(half[y, x, 2])
            p0 = _predicted(np.float32(half_background[y, x, 0]), g0, offset[0], i0)
            p1 = _predicted(np.float32(half_background[y, x, 1]), g1, offset[1], i1)
            p2 = _predicted(np.float32(half_background[y, x, 2]), g2, offset[2], i2)
            value, shown = np.uint8(0), texture[y, x]
            if shown > 0 or (p0 - i0) ** 2 + (p1 - i1) ** 2 + (p2 - i2) ** 2 > nothing:
                value = _value(
                    _colour_log_odds(i0, i1, i2, p0, p1, p2, np.float32(0), np.float32(0), noise, model) + shown
                )
            if value < DOUBT:
                change = np.uint8((abs(p0 - i0) + abs(p1 - i1) + abs(p2 - i2)) / np.float32(3))
                for s in range(2 * y, min(2 * y + 2, out.shape[0])):
                    for t in range(2 * x, min(2 * x + 2, out.shape[1])):
                        out[s, t], changes[s, t] = value, change
                continue
            u = x // cell
            for s in range(2 * y, min(2 * y + 2, out.shape[0])):
                for t in range(2 * x, min(2 * x + 2, out.shape[1])):
                    out[s, t], changes[s, t] = _pixel(
                        image,
                        background,
                        s,
                        t,
                        g0,
                        g1,
                        g2,
                        gains,
                        v,
                        u,
                        offset,
                        jump,
                        slack,
                        texture[y, x],
                        noise,
                        model,
                    )


@compiled
def _pixel(
    image: Any,
    background: Any,
    y: Any,
    x: Any,
    g0: Any,
    g1: Any,
    g2: Any,
    gains: Any,
    v: Any,
    u: Any,
    offset: Any,
    jump: Any,
    slack: Any,
    shown: Any,
    noise: Any,
    model: Any,
) -> Any:
    """Evidence and change of a px of the frame smoothed over 3 px."""
    i0, i1, i2 = _smoothed(image, y, x, 0), _smoothed(image, y, x, 1), _smoothed(image, y, x, 2)
    b0, b1, b2 = background[y, x, 0], background[y, x, 1], background[y, x, 2]
    p0 = _predicted(b0, g0, offset[0], i0)
    p1 = _predicted(b1, g1, offset[1], i1)
    p2 = _predicted(b2, g2, offset[2], i2)
    total = abs(p0 - i0) + abs(p1 - i1) + abs(p2 - i2)
    if jump[v, u] > np.float32(LEAST_JUMP):
        for w in range(max(v - 1, 0), min(v + 2, gains.shape[0])):
            for t in range(max(u - 1, 0), min(u + 2, gains.shape[1])):
                q0 = _predicted(b0, gains[w, t, 0], offset[0], i0)
                q1 = _predicted(b1, gains[w, t, 1], offset[1], i1)
                q2 = _predicted(b2, gains[w, t, 2], offset[2], i2)
                other = abs(q0 - i0) + abs(q1 - i1) + abs(q2 - i2)
                if other < total:
                    total, p0, p1, p2 = other, q0, q1, q2
    change = np.uint8(total / np.float32(3))
    if min(p0, p1, p2) >= CLIPPED and min(i0, i1, i2) >= CLIPPED:
        return np.uint8(0), change
    odds = _colour_log_odds(i0, i1, i2, p0, p1, p2, slack[y, x] * gains[v, u, 1], jump[v, u], noise, model)
    return _value(odds + shown), change


@compiled
def _value(odds: Any) -> Any:
    """Log-odds as evidence, 0 to 255."""
    value = np.float32(127.5) * (np.float32(1) + odds / np.float32(FULL))
    return np.uint8(min(max(value, np.float32(0)), np.float32(255)))


@compiled
def _smoothed(image: Any, y: Any, x: Any, c: Any) -> Any:
    """A channel with binomial weights over 3 x 3 px."""
    up, down = max(y - 1, 0), min(y + 1, image.shape[0] - 1)
    left, right = max(x - 1, 0), min(x + 1, image.shape[1] - 1)
    corners = np.int64(image[up, left, c]) + image[up, right, c] + image[down, left, c] + image[down, right, c]
    sides = np.int64(image[up, x, c]) + image[down, x, c] + image[y, left, c] + image[y, right, c]
    return np.float32(corners + 2 * sides + 4 * np.int64(image[y, x, c])) / np.float32(16)


@compiled
def _between(x: Any, cell: Any, count: Any) -> Any:
    """The blocks before and after a px, and how far it is from the former's centre to the latter's, 0 to 1."""
    position = (np.float32(x) + np.float32(0.5)) / np.float32(cell) - np.float32(0.5)
    first = min(max(np.int64(np.floor(position)), 0), count - 1)
    return first, min(first + 1, count - 1), min(max(position - np.float32(first), np.float32(0)), np.float32(1))


@compiled
def _predicted(background: Any, gain: Any, offset: Any, image: Any) -> Any:
    """A channel's level: clipped as the frame is; and what is clipped in the background may be brighter."""
    level = min(max(gain * background + offset, np.float32(0)), np.float32(255))
    return max(level, image) if background >= np.float32(CLIPPED) else level


@compiled
def _colour_log_odds(
    i0: Any, i1: Any, i2: Any, p0: Any, p1: Any, p2: Any, slack: Any, jump: Any, noise: Any, model: Any
) -> Any:
    """Step 2: the log-odds that the colour I tells of an object before a floor that would be P."""
    chroma_share, least_chroma, darkest, bright, least_step, steepness = model
    one, root3 = np.float32(1), np.float32(1.7320508)
    square = p0 * p0 + p1 * p1 + p2 * p2
    alpha = (i0 * p0 + i1 * p1 + i2 * p2) / max(square, one)
    change = np.sqrt((i0 - alpha * p0) ** 2 + (i1 - alpha * p1) ** 2 + (i2 - alpha * p2) ** 2)
    level, sigma = np.sqrt(square), max(np.float32(0.5) * np.sqrt(noise), one)
    slack += np.float32(JUMP) * jump * level
    chroma = change / (least_chroma * sigma + chroma_share * level + slack)
    step = (alpha - one) * level / (root3 * least_step * sigma + bright * level + np.float32(3) * slack)
    if step < 0:
        step = min((one - alpha) / (one - darkest), -step)
    odds = steepness * (np.sqrt(chroma * chroma + step * step) - one)
    return min(max(odds, np.float32(-FULL)), np.float32(FULL + CERTAIN))
