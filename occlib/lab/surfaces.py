"""Floors: what their surfaces look like, as pictures in linear RGB that cover the whole floor."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np

from occlib.base.arrays import FloatArray
from occlib.formats.scene import Surface

CELL_M = 0.005
"""Side of a pixel of a floor's picture in m: half of what a pixel of a camera shows of it."""


def to_linear(colour: Iterable[float]) -> list[float]:
    """sRGB 0-255 to linear 0-1.

    >>> to_linear([0, 255])
    [0.0, 1.0]
    """
    c = np.asarray(list(colour), float) / 255
    return [float(v) for v in np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)]


def to_srgb(linear: FloatArray) -> FloatArray:
    """Linear 0-1 to sRGB grey levels 0-255, clipped."""
    c = np.clip(linear, 0, 1)
    return np.asarray(255 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055))


def vinyl_texture(colour: Iterable[float], cells: int = 700) -> FloatArray:
    """A tile of floor, linear RGB (cells, cells, 3): faint mottling, a seam around the edge."""
    rng = np.random.default_rng(2009)
    mottle = np.zeros((cells, cells))
    for n, sigma in ((7, 0.008), (40, 0.012), (175, 0.02)):
        mottle += cv2.resize(rng.normal(0, sigma, (n, n)), (cells, cells), interpolation=cv2.INTER_CUBIC)
    tile = np.array(to_linear(colour)) * (1 + mottle[..., None])
    tile[[0, 1, -2, -1]] *= 0.72
    tile[:, [0, 1, -2, -1]] *= 0.72
    return np.asarray(tile)


def wood_texture(
    colour: Iterable[float], size: tuple[float, float], plank: tuple[float, float], *, cell: float = 0.004
) -> FloatArray:
    """A floor of planks along x, linear RGB (rows, columns, 3): each plank of its own shade, with grain and a dark seam.

    ``size`` of the floor, ``plank`` (length and width) and ``cell`` in m. Neighbouring rows of planks are staggered.
    """
    rng = np.random.default_rng(1926)
    columns, rows = round(size[0] / cell), round(size[1] / cell)
    length, width = max(2, round(plank[0] / cell)), max(2, round(plank[1] / cell))
    row, column = np.mgrid[:rows, :columns]
    line = row // width
    along = column + (rng.integers(0, length, line.max() + 1))[line]
    shades = rng.normal(0, 1, (line.max() + 1, along.max() // length + 1))[line, along // length]
    grain = np.zeros((rows, columns))
    for across, lengthwise, sigma in ((3, 150, 0.06), (1.5, 60, 0.06), (8, 400, 0.05)):  # cells of one streak
        noise = rng.normal(0, sigma, (max(2, round(rows / across)), max(2, round(columns / lengthwise))))
        grain += cv2.resize(noise, (columns, rows), interpolation=cv2.INTER_CUBIC)
    warm = np.array([0.9, 1.0, 1.15])  # a dark plank is browner, a light one paler
    floor = np.array(to_linear(colour)) * np.exp((0.11 * shades + grain)[..., None] * warm)
    floor[(row % width == 0) | (along % length == 0)] *= 0.45
    return np.clip(floor, 0, 1)


def concrete_texture(
    colour: Iterable[float], size: tuple[float, float], rng: np.random.Generator, *, cell: float = CELL_M
) -> FloatArray:
    """Mottled concrete, linear RGB (rows, columns, 3): clouds of 1 m to 5 cm and a fine grain. ``size``, ``cell`` in m."""
    shape = round(size[1] / cell), round(size[0] / cell)
    clouds = sum(_clouds(shape, round(m / cell), sigma, rng) for m, sigma in ((1.0, 0.1), (0.3, 0.08), (0.05, 0.05)))
    floor = np.array(to_linear(colour)) * np.exp(clouds + rng.normal(0, 0.04, shape))[..., None]
    return np.clip(floor, 0, 1)


def carpet_texture(
    colour: Iterable[float], size: tuple[float, float], rng: np.random.Generator, *, cell: float = CELL_M
) -> FloatArray:
    """Carpet, linear RGB (rows, columns, 3): fine noise of its yarn and faint traces of steps. ``size``, ``cell`` in m."""
    shape = round(size[1] / cell), round(size[0] / cell)
    yarn = rng.normal(0, 0.25, shape) + _clouds(shape, 3, 0.12, rng) + _clouds(shape, round(0.3 / cell), 0.05, rng)
    return np.clip(np.array(to_linear(colour)) * np.exp(yarn)[..., None], 0, 1)


def ceramic_texture(
    colour: Iterable[float],
    size: tuple[float, float],
    tile: tuple[float, float],
    rng: np.random.Generator,
    *,
    cell: float = CELL_M,
) -> FloatArray:
    """Ceramic tiles with grey grout of 1 cm, each of its own shade, linear RGB (rows, columns, 3). Lengths in m."""
    shape = round(size[1] / cell), round(size[0] / cell)
    (row, at_row), (column, at_column) = (
        np.divmod(np.arange(n), max(4, round(side / cell))) for n, side in zip(shape, tile[::-1], strict=True)
    )
    shades = rng.normal(0, 0.06, (row.max() + 1, column.max() + 1))[np.ix_(row, column)]
    floor = np.array(to_linear(colour)) * np.exp(shades + _clouds(shape, round(0.06 / cell), 0.03, rng))[..., None]
    floor[(at_row < 2)[:, None] | (at_column < 2)] = to_linear([138, 134, 126])
    return np.clip(floor, 0, 1)


def _clouds(shape: tuple[int, int], cells: int, sigma: float, rng: np.random.Generator) -> FloatArray:
    """Smooth noise (rows, columns) of a standard deviation, in clouds so many cells wide."""
    rows, columns = (max(2, round(n / max(1, cells))) for n in shape)
    return np.asarray(cv2.resize(rng.normal(0, sigma, (rows, columns)), shape[::-1], interpolation=cv2.INTER_CUBIC))


Floor = Callable[[Surface, tuple[float, float], np.random.Generator], FloatArray]

SURFACES: dict[str, Floor] = {
    "vinyl": lambda s, size, rng: tiled(vinyl_texture(s.colour, round(s.size[0] / CELL_M)), size),
    "planks": lambda s, size, rng: wood_texture(s.colour, size, s.size, cell=CELL_M),
    "concrete": lambda s, size, rng: concrete_texture(s.colour, size, rng),
    "carpet": lambda s, size, rng: carpet_texture(s.colour, size, rng),
    "ceramic": lambda s, size, rng: ceramic_texture(s.colour, size, s.size, rng),
}
"""Every pattern that a room's ``surface`` may name: its picture, from the surface and the floor's size in m."""


def surface_texture(surface: Surface, size: tuple[float, float], seed: int) -> FloatArray:
    """The picture of a floor of ``size`` (m), linear RGB (rows, columns, 3) in cells of :data:`CELL_M`; ``ValueError`` if its pattern is not known."""
    if surface.pattern not in SURFACES:
        raise ValueError(f"surface.pattern: expected one of {', '.join(SURFACES)}, got {surface.pattern!r}")
    return SURFACES[surface.pattern](surface, size, np.random.default_rng(seed))


def tiled(tile: FloatArray, size: tuple[float, float], cell: float = CELL_M) -> FloatArray:
    """A tile (n, m, 3) again and again over a floor of ``size`` in m."""
    rows, columns = round(size[1] / cell), round(size[0] / cell)
    return np.asarray(np.tile(tile, (-(-rows // len(tile)), -(-columns // tile.shape[1]), 1))[:rows, :columns])
