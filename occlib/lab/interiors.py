"""Empty random rooms: floor, walls, light and cameras."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from occlib.base.arrays import FloatArray
from occlib.formats.scene import (
    CeilingLight,
    Gain,
    Lamp,
    PartEntry,
    RoomCamera,
    RoomFile,
    RoomFloor,
    Sensor,
    Surface,
    Walls,
    Window,
)
from occlib.geometry import look_at
from occlib.lab.furnishing import any_colour, as_colour, near, rounded
from occlib.lab.lights import light_points

FACING_DEG = (0.0, 180.0, 90.0, 270.0)
"""Where the inner sides of the four walls look: that at the least x, the greatest x, the least y, the greatest y."""

CROSSING_DEG = (60.0, 180.0)
"""Between the directions in which the first two cameras are seen from the middle of the floor."""


def _tint(rng: np.random.Generator, grey: float, warmth: float) -> tuple[int, int, int]:
    return as_colour(grey * (1 + warmth * np.array([1.0, 0.1, -1.0])))


def _surface(rng: np.random.Generator) -> Surface:
    """A floor: light to nearly black, dull to glossy."""
    pattern = str(rng.choice(["vinyl", "planks", "concrete", "carpet", "ceramic"]))
    grey, gloss, ior = float(rng.uniform(45, 225)), float(rng.uniform(0.05, 0.3)), 1.5
    if rng.random() < 0.15:
        grey = float(rng.uniform(16, 45))
    colour, size = _tint(rng, grey, float(rng.uniform(-0.06, 0.1))), (1.0, 1.0)
    if pattern == "vinyl":
        size = (float(rng.choice([0.3, 0.5, 0.6])),) * 2
    elif pattern == "planks":
        colour = _tint(rng, min(grey, 195), float(rng.uniform(0.15, 0.42)))
        size = float(rng.uniform(0.7, 1.6)), float(rng.uniform(0.08, 0.2))
    elif pattern == "ceramic":
        size = (float(rng.choice([0.2, 0.3, 0.45])),) * 2
        gloss = min(gloss, 0.15)
    elif pattern == "carpet":
        colour, gloss, ior = near(any_colour(rng), rng) if rng.random() < 0.6 else colour, 0.7, 1.02
    elif rng.random() < 0.6:  # concrete, not polished
        gloss, ior = 0.7, 1.02
    return Surface(pattern=pattern, colour=colour, roughness=round(gloss, 3), ior=ior, size=rounded(size))


def empty_room(rng: np.random.Generator, count: int, views: int, size: tuple[int, int]) -> RoomFile | None:
    """Floor, walls, light and cameras; ``None`` if the cameras do not see the floor."""
    large = count > 5
    half = np.array([rng.uniform(4.4 if large else 3, 6), rng.uniform(3.6 if large else 2.5, 5)]) / 2
    border = rng.uniform(0.25, 1.0, 4)
    height = float(rng.uniform(2.6, 4.3))
    floor = RoomFloor(rounded((-half[0], half[0]), 2), rounded((-half[1], half[1]), 2), 0.02)
    walls = Walls(
        rounded((-half[0] - border[0], half[0] + border[1]), 2),
        rounded((-half[1] - border[2], half[1] + border[3]), 2),
        round(height, 2),
        _tint(rng, float(rng.uniform(120, 235)), float(rng.uniform(-0.05, 0.09))),
    )
    surface = _surface(rng)
    stations = _stations(rng, walls, views)
    if stations is None:
        return None
    placed = {f"cam{i + 1}": _camera(rng, station, floor, size) for i, station in enumerate(stations)}
    ceiling, lamps = _lamps(rng, walls, floor, max(float(station[2]) for station in stations))
    windows = [_window(rng, walls) for _ in range(rng.choice(3, p=[0.5, 0.33, 0.17]))]
    room = RoomFile(
        units="m", floor=floor, walls=walls, ceiling_light=ceiling, cameras=placed, sensor=_sensor(rng, 1.0),
        furniture=_along_the_walls(rng, walls, windows), surface=surface, windows=windows, lamps=lamps,
    )  # fmt: skip
    # White paper on the floor is to be so bright; a camera makes a dark floor a little brighter.
    grid = np.array([[x, y, 0.0] for x in np.linspace(*floor.x, 5) for y in np.linspace(*floor.y, 5)])
    indirect = 0.9 + float(np.mean(walls.colour)) / 255
    white = 0.8 / np.pi * float(np.median(light_points(room).irradiance(grid))) * indirect
    dark = 1.35 if np.mean(surface.colour) < 90 else 1.0
    sensor = _sensor(rng, dark * float(rng.uniform(0.5, 0.95)) / white)
    return msgspec.structs.replace(room, sensor=sensor)


def _sensor(rng: np.random.Generator, exposure: float) -> Sensor:
    vignetting, read, shot = rounded((rng.uniform(0.05, 0.32), rng.uniform(0.5, 1.8), rng.uniform(0.05, 0.16)))
    return Sensor(round(float(exposure), 3), vignetting, read, shot, int(rng.integers(80, 94)))


def _stations(rng: np.random.Generator, walls: Walls, views: int) -> list[FloatArray] | None:
    """Where cameras hang, in corners and on walls, no two nearer than 0.8 m or 20 degrees; the first two a sensible pair."""
    (x0, x1), (y0, y1) = np.add(walls.x, (0.12, -0.12)), np.add(walls.y, (0.12, -0.12))
    found: list[FloatArray] = []
    for _ in range(100):
        if rng.random() < 0.4:
            at = [rng.choice([x0, x1]), rng.choice([y0, y1])]
        elif rng.random() < 0.5:
            at = [rng.choice([x0, x1]), rng.uniform(y0 + 0.4, y1 - 0.4)]
        else:
            at = [rng.uniform(x0 + 0.4, x1 - 0.4), rng.choice([y0, y1])]
        station = np.array([*at, rng.uniform(2.2, min(4.0, walls.height - 0.15))])
        angles = [angle_between_deg(station, other) for other in found]
        if any(a < 20 or np.hypot(*(station - other)[:2]) < 0.8 for a, other in zip(angles, found, strict=True)):
            continue
        if len(found) == 1 and not CROSSING_DEG[0] <= angles[0] <= CROSSING_DEG[1]:
            continue
        found.append(np.round(station, 3))
        if len(found) == views:
            return found
    return None


def angle_between_deg(first: FloatArray, second: FloatArray) -> float:
    """Angle, 0 to 180 degrees, between two directions from the middle of the floor, seen from above."""
    a, b = (np.arctan2(p[1], p[0]) for p in (first, second))
    return float(np.degrees(abs((a - b + np.pi) % (2 * np.pi) - np.pi)))


def _camera(rng: np.random.Generator, station: FloatArray, floor: RoomFloor, size: tuple[int, int]) -> RoomCamera:
    """A camera that looks at about the middle of the floor, with a lens that shows most of it and of what stands there."""
    target = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.0, 0.3)])
    target[:2] -= station[:2] * rng.uniform(-0.12, 0.08)
    grid = [(x, y, z) for x in np.linspace(*floor.x, 9) for y in np.linspace(*floor.y, 9) for z in (0.0, 0.6)]
    rays = (np.array(grid) - station) @ look_at(station, target).T
    middle = (np.array(size) - 1) / 2
    with np.errstate(divide="ignore"):  # the longest lens that shows a point, without distortion
        longest = np.where(rays[:, 2] > 0.1, np.min(middle / np.abs(rays[:, :2] / rays[:, 2:]), axis=1), 0)
    focal = np.clip(np.quantile(longest, 1 - rng.uniform(0.78, 0.97)), 0.5 * size[0], 1.4 * size[0])
    corner = float(np.hypot(*middle)) / focal * 1.04
    k1 = float(rng.uniform(-0.3, 0.01)) if rng.random() < 0.85 else 0.0
    radius = np.linspace(0, 4, 400)
    while True:  # a wide lens cannot bend as much: the corner must still have a ray
        bent = radius * (1 + k1 * radius**2 - 0.28 * k1 * radius**4)
        rising = np.diff(bent) > 1e-3
        reach = bent[: len(bent) if rising.all() else int(np.argmin(rising)) + 1].max()
        if reach > corner or abs(k1) < 1e-3:
            break
        k1 *= 0.8
    k1 = 0.0 if abs(k1) < 1e-3 else k1
    distortion = (*rounded((k1, -0.28 * k1, rng.normal(0, 5e-4), rng.normal(0, 5e-4)), 5), 0.0)
    gains = Gain(1.0, round(float(rng.uniform(0.965, 1.035)), 3))
    return RoomCamera(
        position=rounded(station), look_at=rounded(target), size=size, distortion=distortion, gain=gains,
        focal=rounded(focal * (1 + rng.normal(0, 0.002, 2)), 2),
        principal_point=rounded(middle + rng.uniform(-5, 5, 2), 2),
    )  # fmt: skip


def _lamps(
    rng: np.random.Generator, walls: Walls, floor: RoomFloor, above: float
) -> tuple[CeilingLight, dict[str, Lamp]]:
    """An even ceiling, or spots under a dim one; all ``above`` a height in m, where they are in no camera's way."""
    room = np.array([np.ptp(walls.x), np.ptp(walls.y)])
    panel = room * rng.uniform(0.35, 0.75, 2)
    if rng.random() < 0.5:
        even = round(float(rng.uniform(0.7, 1.3)) * 8 / float(np.prod(panel)), 3)
        lamps = _spots(rng, walls, floor, above, 1, 0.5) if rng.random() < 0.3 else {}
        return CeilingLight(rounded(panel), even), lamps
    dim = round(float(rng.uniform(0.1, 0.4)) * 8 / float(np.prod(panel)), 3)
    return CeilingLight(rounded(panel), dim), _spots(rng, walls, floor, above, int(rng.integers(1, 4)), 1.0)


def _spots(
    rng: np.random.Generator, walls: Walls, floor: RoomFloor, above: float, number: int, power: float
) -> dict[str, Lamp]:
    lamps = {}
    for i in range(number):
        side, z = float(rng.uniform(0.12, 0.45)), float(rng.uniform(max(above, 2.2) + 0.05, walls.height - 0.05))
        at = rng.uniform([floor.x[0], floor.y[0]], [floor.x[1], floor.y[1]])
        light = power * float(rng.uniform(5, 9)) / number / side**2
        colour = _tint(rng, 240, float(rng.uniform(-0.03, 0.08)))
        lamps[f"lamp{i + 1}"] = Lamp(
            centre=rounded((*at, z)),
            size=rounded((side, side)),
            radiance=round(light, 2),
            colour=colour,
        )
    return lamps


def _window(rng: np.random.Generator, walls: Walls) -> Window:
    wide, tall = float(rng.uniform(0.7, 1.8)), float(rng.uniform(0.7, 1.3))
    z, side = float(rng.uniform(0.9, 1.2)) + tall / 2, int(rng.integers(4))
    (x0, x1), (y0, y1) = walls.x, walls.y
    along_x, along_y = (rng.uniform(low + wide / 2 + 0.3, high - wide / 2 - 0.3) for low, high in ((x0, x1), (y0, y1)))
    centre = [(x0 + 0.005, along_y), (x1 - 0.005, along_y), (along_x, y0 + 0.005), (along_x, y1 - 0.005)][side]
    radiance, cold = float(rng.uniform(2.0, 7.0)), _tint(rng, 236, float(rng.uniform(-0.07, 0.04)))
    return Window(
        centre=rounded((*centre, z)), size=rounded((wide, tall)), facing_deg=FACING_DEG[side],
        radiance=round(radiance, 2), colour=cold,
    )  # fmt: skip


def _along_the_walls(rng: np.random.Generator, walls: Walls, windows: Sequence[Window]) -> list[PartEntry]:
    """Skirting boards, and on walls without a window a door and posters: nothing that stands out into the room."""
    (x0, x1), (y0, y1) = walls.x, walls.y
    skirting = any_colour(rng)
    middle, length = (float(np.mean(walls.x)), float(np.mean(walls.y))), (x1 - x0, y1 - y0)
    flat: list[tuple[tuple[float, ...], tuple[float, ...], tuple[int, int, int]]] = [
        ((middle[0], y0 + 0.01, 0.05), (length[0], 0.02, 0.1), skirting),
        ((middle[0], y1 - 0.01, 0.05), (length[0], 0.02, 0.1), skirting),
        ((x0 + 0.01, middle[1], 0.05), (0.02, length[1], 0.1), skirting),
        ((x1 - 0.01, middle[1], 0.05), (0.02, length[1], 0.1), skirting),
    ]
    for wide, low, tall in ((0.95, 0.0, 2.0), *((rng.uniform(0.4, 1.3), 1.1, rng.uniform(0.4, 0.9)) for _ in range(3))):
        side, along = int(rng.integers(4)), float(rng.uniform(-0.4, 0.4))
        if any(window.facing_deg == FACING_DEG[side] for window in windows):
            continue
        at = (x0 + 0.022, x1 - 0.022, y0 + 0.022, y1 - 0.022)[side]
        if side < 2:
            place, size = (at, middle[1] + along * (length[1] - wide)), (0.02, wide, tall)
        else:
            place, size = (middle[0] + along * (length[0] - wide), at), (wide, 0.02, tall)
        flat.append(((*place, low + tall / 2), size, any_colour(rng)))
    return [PartEntry(shape="box", centre=rounded(c), size=rounded(s), colour=colour) for c, s, colour in flat]
