"""What stands in random rooms: robots, people, cartons and the like, and furniture, each with sizes and colours drawn at random.

A kind is a function of the random numbers and a main colour that gives its parts, standing on z = 0 and facing x.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from occlib.formats.scene import PartEntry, SwingEntry

Colour = tuple[int, int, int]
Parts = list[PartEntry]

DARK = (30, 31, 34)
"""Of tyres, masts, handles and legs of tables."""

SKIN = ((224, 180, 150), (198, 144, 112), (150, 102, 74), (96, 64, 48))

HAIR = ((30, 24, 20), (64, 44, 30), (120, 90, 54), (120, 118, 114))


def rounded(values: Iterable[float], digits: int = 3) -> tuple[Any, ...]:
    """Numbers as they stand in a YAML file."""
    return tuple(round(float(v), digits) for v in values)


def _part(
    shape: str,
    centre: Iterable[float],
    size: Iterable[float],
    colour: Colour | None = None,
    turn: Iterable[float] = (0, 0, 0),
    swing: SwingEntry | None = None,
) -> PartEntry:
    place, extent, angles = (rounded(values, 4) for values in (centre, size, turn))
    return PartEntry(shape=shape, centre=place, size=extent, colour=colour, turn=angles, swing=swing)


def as_colour(levels: npt.ArrayLike) -> Colour:
    """Grey levels of red, green and blue as whole numbers, none of them quite black or white."""
    r, g, b = np.clip(np.rint(levels), 8, 245).astype(int).tolist()
    return r, g, b


def any_colour(rng: np.random.Generator) -> Colour:
    """A colour that things have: from dull to strong, from dark to light."""
    hue, grey = rng.uniform(0, 2 * np.pi), rng.uniform(25, 215)
    strength = rng.uniform(0, 0.8) * min(grey, 235 - grey)
    wave = np.cos(hue - np.array([0, 2, 4]) * np.pi / 3)
    return as_colour(grey + strength * wave)


def near(colour: Iterable[float], rng: np.random.Generator, spread: int = 14) -> Colour:
    """A colour that differs from another by at most ``spread`` in each channel."""
    return as_colour(np.array(list(colour), int) + rng.integers(-spread, spread + 1, 3))


def _mast(rng: np.random.Generator, x: float, foot: float) -> Parts:
    """A thin dark mast from a height, with a sensor at its top."""
    tall, thick = rng.uniform(0.3, 0.8), rng.uniform(0.025, 0.045)
    top = foot + tall
    head = [_part("box", (x, 0, top + 0.03), (0.05, 0.16, 0.06), DARK)]
    if rng.random() < 0.4:
        head = [_part("box", (x + 0.02, 0, top + 0.1), (0.02, 0.26, 0.2), (18, 20, 24))]
    return [_part("cylinder", (x, 0, foot + tall / 2), (thick, thick, tall), DARK), *head]


def round_robot(rng: np.random.Generator, colour: Colour) -> Parts:
    """A drum on wheels, low or tall, with a bumper and often a mast."""
    wide, tall = rng.uniform(0.3, 0.5), rng.uniform(0.1, 0.45)
    parts = [
        _part("cylinder", (0, 0, 0.03), (wide * 0.85, wide * 0.85, 0.06), DARK),
        _part("cylinder", (0, 0, 0.03 + tall / 2), (wide, wide, tall - 0.02), None),
        _part("cylinder", (0, 0, 0.08), (wide + 0.016, wide + 0.016, 0.05), DARK),
        _part("box", (wide / 2 - 0.01, 0, 0.03 + tall * 0.75), (0.04, 0.14, min(0.06, tall / 4)), (16, 18, 22)),
    ]
    if rng.random() < 0.5:
        parts.append(_part("ellipsoid", (0, 0, 0.02 + tall), (wide * 0.8, wide * 0.8, 0.14), near(colour, rng, 30)))
    if rng.random() < 0.5:
        parts += _mast(rng, float(rng.uniform(-0.25, 0.1)) * wide, 0.02 + tall)
    return parts


def boxy_robot(rng: np.random.Generator, colour: Colour) -> Parts:
    """A box on four wheels with a mast or a handle, narrow and dark."""
    long, wide, tall = rng.uniform(0.32, 0.6), rng.uniform(0.26, 0.44), rng.uniform(0.1, 0.4)
    foot = 0.06
    parts = [_part("box", (0, 0, foot + tall / 2), (long, wide, tall), None)]
    parts.append(_part("box", (0, 0, foot + tall * 0.3), (long + 0.008, wide + 0.008, 0.03), DARK))
    for i, j in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        wheel = i * long * 0.33, j * (wide / 2 - 0.01), 0.06
        parts.append(_part("cylinder", wheel, (0.12, 0.12, 0.04), DARK, (90, 0, 0)))
    parts.append(_part("box", (0.05, 0, foot + tall + 0.01), (long * 0.5, wide * 0.6, 0.02), near(colour, rng, 60)))
    if rng.random() < 0.5:
        return parts + _mast(rng, float(rng.uniform(-0.35, 0.2)) * long, foot + tall)
    up, x = rng.uniform(0.35, 0.6), -long / 2 + 0.02
    for y in (-wide / 2 + 0.03, wide / 2 - 0.03):
        parts.append(_part("cylinder", (x, y, foot + tall + up / 2), (0.025, 0.025, up), DARK))
    parts.append(_part("cylinder", (x, 0, foot + tall + up), (0.03, 0.03, wide - 0.03), DARK, (90, 0, 0)))
    return parts


def carton(rng: np.random.Generator, colour: Colour) -> Parts:
    """One or two cardboard boxes with tape."""
    long, wide, tall = rng.uniform(0.28, 0.55), rng.uniform(0.22, 0.42), rng.uniform(0.18, 0.45)
    parts = [
        _part("box", (0, 0, tall / 2), (long, wide, tall), None),
        _part("box", (0, 0, tall / 2), (long + 0.002, 0.05, tall + 0.002), (208, 190, 150)),
    ]
    if rng.random() < 0.4:
        size = np.array([long, wide]) * rng.uniform(0.6, 0.95)
        high = rng.uniform(0.15, 0.35)
        turn = rng.uniform(-20, 20)
        parts.append(_part("box", (0, 0, tall + high / 2), (*size, high), near(colour, rng, 24), (0, 0, turn)))
    return parts


def ball(rng: np.random.Generator, colour: Colour) -> Parts:
    """From a football to a gymnastic ball."""
    wide = rng.uniform(0.2, 0.32) if rng.random() < 0.7 else rng.uniform(0.45, 0.6)
    return [_part("ellipsoid", (0, 0, wide / 2), (wide, wide, wide), None)]


def cone(rng: np.random.Generator, colour: Colour) -> Parts:
    """A traffic cone with a white band."""
    tall = rng.uniform(0.3, 0.7)
    wide, band = 0.5 * tall + 0.08, 0.45
    collar = wide * (1 - band) + 0.006
    return [
        _part("box", (0, 0, 0.015), (wide + 0.1, wide + 0.1, 0.03), DARK),
        _part("cone", (0, 0, 0.03 + tall / 2), (wide, wide, tall)),
        _part("cylinder", (0, 0, 0.03 + tall * band), (collar, collar, 0.06), (235, 235, 232)),
    ]


def board(rng: np.random.Generator, colour: Colour) -> Parts:
    """A board or a mat that lies flat."""
    thick = rng.uniform(0.015, 0.05)
    return [_part("box", (0, 0, thick / 2), (rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.6), thick), None)]


def table(rng: np.random.Generator, colour: Colour) -> Parts:
    """A top on four thin legs: one sees the floor through it."""
    long, wide, tall = rng.uniform(0.6, 1.1), rng.uniform(0.45, 0.7), rng.uniform(0.45, 0.76)
    leg = DARK if rng.random() < 0.6 else near(colour, rng)
    parts = [_part("box", (0, 0, tall - 0.015), (long, wide, 0.03), None)]
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        place = x * (long / 2 - 0.05), y * (wide / 2 - 0.05), (tall - 0.03) / 2
        parts.append(_part("cylinder", place, (0.04, 0.04, tall - 0.03), leg))
    if rng.random() < 0.3:
        parts.append(_part("box", (rng.uniform(-0.1, 0.1), 0, tall + 0.1), (0.25, 0.2, 0.2), any_colour(rng)))
    return parts


def walker(rng: np.random.Generator, colour: Colour, *, step: float = 21.0) -> Parts:
    """A person who walks: legs and arms swing about hips and shoulders, ``step`` degrees."""
    tall = rng.uniform(1.55, 1.9)
    k, skin, trousers = tall / 1.75, SKIN[rng.integers(len(SKIN))], any_colour(rng)
    hair, shoes = HAIR[rng.integers(len(HAIR))], any_colour(rng) if rng.random() < 0.3 else DARK
    period, phase = round(float(rng.uniform(5.0, 6.5)), 2), round(float(rng.random()), 3)
    hip, shoulder = 0.88 * k, 1.42 * k
    parts = []
    for side, half in ((1, 0.0), (-1, 0.5)):
        swing = {"period": period, "phase": round(phase + half, 3)}
        leg = SwingEntry(pivot=(0.0, round(side * 0.09 * k, 3), round(hip, 3)), degrees=step, **swing)
        parts.append(
            _part("cylinder", (0, side * 0.09 * k, hip * 0.74), (0.17 * k, 0.16 * k, hip * 0.56), trousers, swing=leg)
        )
        parts.append(
            _part("cylinder", (0, side * 0.09 * k, hip * 0.27), (0.115 * k, 0.11 * k, hip * 0.46), trousers, swing=leg)
        )
        parts.append(
            _part("box", (0.05 * k, side * 0.09 * k, 0.04 * k), (0.27 * k, 0.1 * k, 0.08 * k), shoes, swing=leg)
        )
        counter = SwingEntry(
            pivot=(0.0, round(side * 0.21 * k, 3), round(shoulder - 0.04, 3)), degrees=-0.9 * step, **swing
        )
        parts.append(
            _part("cylinder", (0, side * 0.22 * k, 1.21 * k), (0.095 * k, 0.095 * k, 0.4 * k), None, swing=counter)
        )
        parts.append(
            _part("cylinder", (0, side * 0.22 * k, 0.9 * k), (0.07 * k, 0.07 * k, 0.26 * k), skin, swing=counter)
        )
        parts.append(
            _part("ellipsoid", (0, side * 0.22 * k, 0.75 * k), (0.1 * k, 0.06 * k, 0.16 * k), skin, swing=counter)
        )
    return [
        *parts,
        _part("cylinder", (0, 0, 0.9 * k), (0.22 * k, 0.34 * k, 0.16 * k), trousers),
        *_trunk(1.19 * k, k, skin, hair),
    ]


def stander(rng: np.random.Generator, colour: Colour) -> Parts:
    """A person who stands, one foot a little before the other."""
    parts = walker(rng, colour, step=float(rng.uniform(2, 6)))
    return [
        part
        if part.swing is None
        else msgspec.structs.replace(part, swing=msgspec.structs.replace(part.swing, period=1e6))
        for part in parts
    ]


def _trunk(middle: float, k: float, skin: Colour, hair: Colour, x: float = 0.0) -> Parts:
    """Trunk, neck and head; the trunk's middle at a height, for a person of 1.75 m times ``k``."""
    up = middle - 1.19 * k
    return [
        _part("cylinder", (x, 0, middle - 0.02 * k), (0.23 * k, 0.35 * k, 0.42 * k), None),
        _part("ellipsoid", (x, 0, middle + 0.17 * k), (0.24 * k, 0.44 * k, 0.22 * k), None),
        _part("cylinder", (x, 0, up + 1.48 * k), (0.11 * k, 0.11 * k, 0.14 * k), skin),
        _part("ellipsoid", (x + 0.02, 0, up + 1.62 * k), (0.2 * k, 0.16 * k, 0.24 * k), skin),
        _part("ellipsoid", (x - 0.005, 0, up + 1.655 * k), (0.21 * k, 0.18 * k, 0.21 * k), hair),
    ]


def chair(colour: Colour) -> Parts:
    """A chair that faces x, its seat at 0.46 m, around x = 0."""
    parts = [
        _part("box", (0, 0, 0.44), (0.42, 0.42, 0.04), colour),
        _part("box", (-0.2, 0, 0.72), (0.03, 0.4, 0.36), colour),
    ]
    for x, y in ((0.18, 0.18), (0.18, -0.18), (-0.19, 0.18), (-0.19, -0.18)):
        tall = 0.42 if x > 0 else 0.56
        parts.append(_part("cylinder", (x, y, tall / 2), (0.03, 0.03, tall), DARK))
    return parts


def sitter(rng: np.random.Generator, colour: Colour) -> Parts:
    """A person on a chair, as one object."""
    k, skin, trousers = rng.uniform(0.93, 1.06), SKIN[rng.integers(len(SKIN))], any_colour(rng)
    hair, out = HAIR[rng.integers(len(HAIR))], 0.36 * k
    parts = chair(any_colour(rng))
    for side in (1, -1):
        y = side * 0.1 * k
        parts.append(_part("cylinder", (out / 2 - 0.02, y, 0.53), (0.15 * k, 0.15 * k, 0.46 * k), trousers, (0, 90, 0)))
        parts.append(_part("cylinder", (out, y, 0.29), (0.12 * k, 0.12 * k, 0.5), trousers))
        parts.append(_part("box", (out + 0.07, y, 0.04), (0.27 * k, 0.1 * k, 0.08), DARK))
        parts.append(
            _part("cylinder", (-0.06, side * 0.22 * k, 0.83), (0.09 * k, 0.09 * k, 0.36 * k), None, (0, -12, 0))
        )
        parts.append(_part("cylinder", (0.1, side * 0.2 * k, 0.65), (0.075, 0.075, 0.3 * k), skin, (0, 90, 0)))
    parts.append(_part("cylinder", (-0.06, 0, 0.53), (0.26 * k, 0.36 * k, 0.16), trousers))
    return parts + _trunk(0.5 + 0.3 * k, k, skin, hair, -0.07)


def cabinet(rng: np.random.Generator, colour: Colour) -> Parts:
    """A closed cabinet or a chest of drawers."""
    deep, wide, tall = rng.uniform(0.35, 0.5), rng.uniform(0.5, 1.1), rng.uniform(0.6, 1.5)
    return [
        _part("box", (0, 0, tall / 2 + 0.02), (deep, wide, tall - 0.04), colour),
        _part("box", (0, 0, tall), (deep + 0.03, wide + 0.03, 0.025), near(colour, rng, 30)),
        _part("box", (0, 0, 0.02), (deep - 0.04, wide - 0.04, 0.04), DARK),
        _part("box", (deep / 2, 0, tall / 2), (0.012, 0.01, tall * 0.85), DARK),
    ]


def shelf(rng: np.random.Generator, colour: Colour) -> Parts:
    """An open shelf with boxes on it."""
    deep, wide, tall = rng.uniform(0.28, 0.4), rng.uniform(0.6, 1.0), rng.uniform(0.8, 1.6)
    parts = [_part("box", (0, s * wide / 2, tall / 2), (deep, 0.025, tall), colour) for s in (-1, 1)]
    for z in np.arange(0.08, tall + 0.01, 0.38):
        parts.append(_part("box", (0, 0, z), (deep, wide, 0.025), colour))
        if z + 0.3 < tall:
            size = rng.uniform(0.15, 0.28, 3)
            parts.append(_part("box", (0, rng.uniform(-0.25, 0.25) * wide, z + size[2] / 2), size, any_colour(rng)))
    return parts


def sofa(rng: np.random.Generator, colour: Colour) -> Parts:
    """An armchair or a sofa."""
    wide = rng.uniform(0.75, 1.5)
    parts = [_part("box", (0, 0, 0.22), (0.75, wide, 0.32), colour)]
    parts.append(_part("box", (-0.3, 0, 0.55), (0.18, wide, 0.5), colour))
    parts.append(_part("box", (0.05, 0, 0.41), (0.6, wide - 0.3, 0.1), near(colour, rng, 20)))
    return parts + [_part("box", (0, s * (wide / 2 - 0.07), 0.46), (0.7, 0.14, 0.2), colour) for s in (-1, 1)]


def desk(rng: np.random.Generator, colour: Colour) -> Parts:
    """A desk with drawers on one side and a screen."""
    wide = rng.uniform(0.9, 1.4)
    return [
        _part("box", (0, 0, 0.73), (0.65, wide, 0.03), colour),
        _part("box", (0, wide / 2 - 0.22, 0.36), (0.58, 0.4, 0.7), near(colour, rng, 30)),
        _part("box", (0, -wide / 2 + 0.03, 0.36), (0.58, 0.03, 0.7), near(colour, rng, 30)),
        _part("box", (-0.15, 0, 1.0), (0.04, 0.52, 0.32), (24, 25, 28)),
        _part("box", (-0.17, 0, 0.8), (0.06, 0.08, 0.12), DARK),
    ]


def plant(rng: np.random.Generator, colour: Colour) -> Parts:
    """A bush in a pot."""
    pot, bush = rng.uniform(0.25, 0.4), rng.uniform(0.4, 0.7)
    green = (int(rng.integers(30, 70)), int(rng.integers(80, 120)), int(rng.integers(30, 60)))
    return [
        _part("cylinder", (0, 0, pot / 2), (pot, pot, pot), colour),
        _part("cylinder", (0, 0, pot + 0.1), (0.05, 0.05, 0.24), (80, 58, 40)),
        _part("ellipsoid", (0, 0, pot + 0.15 + bush / 2), (bush, bush, bush * 1.1), green),
    ]


@dataclass(frozen=True)
class Kind:
    """A kind of object.

    Parameters
    ----------
    parts
        Gives its parts from random numbers and a main colour.
    often
        Weight: how often it comes.
    speed
        Least and greatest, in m/s.
    moving
        Share of them that move.
    colour
        Its main colour, if it is always the same.
    """

    parts: Callable[[np.random.Generator, Colour], Parts]
    often: float
    speed: tuple[float, float] = (0.0, 0.0)
    moving: float = 0.0
    colour: Colour | None = None


OBJECTS = {
    "round robot": Kind(round_robot, 0.17, (0.2, 0.8), 0.8),
    "boxy robot": Kind(boxy_robot, 0.17, (0.2, 0.8), 0.8),
    "walking person": Kind(walker, 0.2, (0.6, 1.2), 1.0),
    "standing person": Kind(stander, 0.04),
    "sitting person": Kind(sitter, 0.08),
    "carton": Kind(carton, 0.1),
    "ball": Kind(ball, 0.08, (0.3, 1.0), 0.6),
    "cone": Kind(cone, 0.06, colour=(226, 84, 22)),
    "board": Kind(board, 0.05),
    "table": Kind(table, 0.06),
}
"""The kinds of objects by their label."""

FURNITURE: dict[str, Callable[[np.random.Generator, Colour], Parts]] = {
    "cabinet": cabinet, "shelf": shelf, "sofa": sofa, "desk": desk, "plant": plant, "cartons": carton,
}  # fmt: skip
"""Kinds of furniture; they face x, their back is towards a wall."""
