"""Cameras on the walls of the lab, and random crowds of upright objects on its floor, without a scene file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray, as_points
from occlib.formats import TrueObject, Truth
from occlib.geometry import Camera, Floor, Rig, look_at
from occlib.lab.scenes import SceneObject, Waypoint
from occlib.lab.shapes import SHAPES, Part
from occlib.lens import Lens

BEARINGS = {
    "left": 180.0,
    "right": 0.0,
    "front": 270.0,
    "back": 90.0,
    "front-left": 225.0,
    "back-right": 45.0,
    "front-right": 315.0,
    "back-left": 135.0,
}
"""Where the cameras hang, in degrees anticlockwise from the x axis as seen from the floor's middle."""


FLOOR = Floor((-2.0, 2.0), (-1.5, 1.5), 0.02)
"""The lab's floor in cells of 2 cm."""


ROOM_M = (3.05, 2.45)
"""Half the distance between opposite cameras in x and in y, in m."""


GREY = (90, 90, 90)


def wall_rig(
    cameras: int | Mapping[str, float],
    *,
    height: float = 2.5,
    floor: Floor = FLOOR,
    size: tuple[int, int] = (640, 480),
) -> Rig:
    """Cameras on the walls that look at the middle of the floor, each with the longest lens that shows all of it.

    Parameters
    ----------
    cameras
        How many, 1 to 8: the first of :data:`BEARINGS` (two are opposite, the first four at right angles). Or names and
        bearings in degrees; the angle between two bearings is the angle at which their sight-lines cross in the middle.
    height
        Of the cameras above the floor in m, above 0.7: the lens is to show objects of 0.6 m whole.
    floor
        Must lie inside the walls, at :data:`ROOM_M`.
    size
        Of the pictures ``(width, height)`` in px. No lens distortion.

    Raises
    ------
    ValueError
        Another number of cameras, a camera too low, a floor that reaches to the walls.

    Examples
    --------
    >>> rig = wall_rig(2)
    >>> list(rig.cameras), rig["left"].centre_m.round(3).tolist()
    (['left', 'right'], [-3.05, 0.0, 2.5])
    """
    if isinstance(cameras, int):
        if not 1 <= cameras <= len(BEARINGS):
            raise ValueError(f"cameras: expected 1 to {len(BEARINGS)}, got {cameras}")
        cameras = dict(list(BEARINGS.items())[:cameras])
    if not cameras or not height > 0.7:
        raise ValueError(f"cameras, height: expected at least one camera above 0.7 m, got {len(cameras)} at {height} m")
    if max(map(abs, floor.x)) >= ROOM_M[0] or max(map(abs, floor.y)) >= ROOM_M[1]:
        raise ValueError(f"floor: expected it between walls at +-{ROOM_M} m, got x {floor.x}, y {floor.y}")
    return Rig(floor, {name: _wall_camera(name, bearing, height, floor, size) for name, bearing in cameras.items()})


def _wall_camera(name: str, bearing: float, height: float, floor: Floor, size: tuple[int, int]) -> Camera:
    direction = np.array([np.cos(np.radians(bearing)), np.sin(np.radians(bearing))])
    station = np.append(direction * np.min(np.array(ROOM_M) / np.maximum(np.abs(direction), 1e-12)), height)
    rotation = look_at(station, (float(np.mean(floor.x)), float(np.mean(floor.y)), 0.0))
    corners = np.array([[x, y, z] for x in floor.x for y in floor.y for z in (0.0, 0.6)])
    rays = (corners - station) @ rotation.T
    rays = rays[:, :2] / rays[:, 2:]
    middle, half = (np.array(size) - 1) / 2, np.ptp(rays, axis=0) / 2
    focal = 0.97 * float(np.min(middle / half))
    centre = middle - focal * (rays.min(axis=0) + half)
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    return Camera.from_pose(name, size, Lens(matrix, np.zeros(5)), rotation, -rotation @ station)


def upright(
    shape: str,
    at: tuple[float, float],
    width: float | tuple[float, float],
    height: float,
    *,
    heading: float = 0.0,
    name: str = "",
) -> SceneObject:
    """One object on the floor: ``"box"``, ``"cylinder"`` or ``"ellipsoid"`` (a ball if ``height`` is its ``width``).

    Parameters
    ----------
    shape
        One of :data:`occlib.lab.shapes.SHAPES`.
    at
        Middle of its base in m.
    width
        Diameter in m, or the two sides.
    height
        In m.
    heading
        Degrees anticlockwise.
    name
        Its id; the shape's name by default.

    Examples
    --------
    >>> upright("cylinder", (1.0, 0.5), 0.3, 0.4).pose(0)
    (1.0, 0.5, 0.0)
    """
    if shape not in SHAPES:
        raise ValueError(f"shape: expected one of {', '.join(SHAPES)}, got {shape!r}")
    wide, deep = (float(side) for side in np.broadcast_to(width, 2))
    part = Part(shape, (0.0, 0.0, height / 2), (wide, deep, float(height)), GREY)
    return SceneObject(name or shape, shape, GREY, (part,), (Waypoint(0, at, float(heading)),))


def random_crowd(
    count: int,
    rng: np.random.Generator,
    *,
    width: tuple[float, float] = (0.2, 0.4),
    height: tuple[float, float] = (0.15, 0.5),
    gap: float = 0.05,
    floor: Floor = FLOOR,
) -> tuple[SceneObject, ...]:
    """Upright boxes and cylinders, by turns, at random places, headings and sizes; no two nearer than ``gap``.

    Parameters
    ----------
    count
        Number of objects.
    rng
        Source of randomness; the crowd is determined by its state.
    width
        Least and greatest side or diameter in m, drawn evenly.
    height
        Least and greatest height in m, drawn evenly.
    gap
        At least so many m between two circumscribed circles, and between these and the floor's rim.
    floor
        Where they stand.

    Raises
    ------
    ValueError
        No room for so many.

    Examples
    --------
    >>> crowd = random_crowd(3, np.random.default_rng(0))
    >>> [each.label for each in crowd]
    ['box', 'cylinder', 'box']
    """
    crowd: list[SceneObject] = []
    circles: list[tuple[float, float, float]] = []
    for number in range(count):
        shape = ("box", "cylinder")[number % 2]
        sides = rng.uniform(*width, size=2) if shape == "box" else np.full(2, rng.uniform(*width))
        tall, radius = float(rng.uniform(*height)), float(np.hypot(*sides) / 2 if shape == "box" else sides[0] / 2)
        for _ in range(2000):
            x, y = (float(rng.uniform(low + radius + gap, high - radius - gap)) for low, high in (floor.x, floor.y))
            if all(np.hypot(x - a, y - b) >= radius + r + gap for a, b, r in circles):
                break
        else:
            raise ValueError(f"count: no room for {count} objects of {width} m on a floor of {floor.x} x {floor.y} m")
        circles.append((x, y, radius))
        turn = float(rng.uniform(0, 180))
        crowd.append(upright(shape, (x, y), (sides[0], sides[1]), tall, heading=turn, name=f"{shape}{number}"))
    return tuple(crowd)


def random_crowds(number: int, count: int, seed: int, **sizes: Any) -> list[tuple[SceneObject, ...]]:
    """``number`` crowds of ``count`` objects, each from its own random numbers.

    The first do not depend on how many follow.

    >>> random_crowds(1, 4, 0) == random_crowds(3, 4, 0)[:1]
    True
    """
    return [random_crowd(count, np.random.default_rng([seed, count, i]), **sizes) for i in range(number)]


def places_m(crowd: Sequence[SceneObject]) -> FloatArray:
    """Where the objects stand, (N, 2) in m."""
    return as_points([each.pose(0)[:2] for each in crowd])


@lru_cache(maxsize=4096)
def base_m(scene_object: SceneObject) -> FloatArray:
    """Footprint of an object that does not move, polygon (M, 2) in m, read-only: made once, as studies ask often."""
    outline = scene_object.footprint(0)
    outline.setflags(write=False)
    return outline


@lru_cache(maxsize=4096)
def solid_m(scene_object: SceneObject) -> FloatArray:
    """Vertices of an object that does not move, (N, 3) in m, read-only and made once."""
    vertices = scene_object.vertices_m(0)
    vertices.setflags(write=False)
    return vertices


def truth_of(crowds: Sequence[Sequence[SceneObject]]) -> Truth:
    """Where the crowds stand, a frame each, for :func:`occlib.metrics.evaluate`."""
    return Truth({i: [_true_object(each) for each in crowd] for i, crowd in enumerate(crowds)})


def _true_object(each: SceneObject) -> TrueObject:
    x, y, _ = each.pose(0)
    return TrueObject(id=each.id, x=x, y=y, footprint=tuple(map(tuple, base_m(each).tolist())))
