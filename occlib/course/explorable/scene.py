"""The explorable's room in the library's terms: its cameras and objects, and the map that the library makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from occlib.base import checks
from occlib.base.arrays import Mask
from occlib.explaining import Explainer
from occlib.foreground import Evidence
from occlib.geometry import Camera, Floor, Rig
from occlib.lab import FLOOR, SceneObject, ghost_regions, shadow_mask, upright
from occlib.lens import Lens
from occlib.localization import find_regions
from occlib.metrics import claimed_area_ratio
from occlib.occlusion import fuse

Item = Mapping[str, Any]
"""A camera ``{"name", "x", "y", "height", "view"}`` or an object ``{"x", "y", "radius", "height", "missed"}``: metres,
``view`` in degrees as seen from above, ``missed`` the names of the cameras whose mask has a hole there."""

NAMES = ("A", "B", "C", "D")
"""What cameras may be called; each has its colour."""

MOST_OBJECTS = 8
LEAST_AREA_M2 = 0.004
"""As in :func:`occlib.lab.ghost_regions`: a smaller region is noise."""

MARGIN_M = 1.0
"""The explainer's pictures show so much floor around the map."""


@dataclass(frozen=True)
class LibraryMap:
    """What the library says of a room.

    Parameters
    ----------
    occupied
        The AND map, bool (ny, nx).
    regions, ghosts
        How many regions it has, and how many of them hold no part of any object's base.
    ratio
        Claimed over true area; None without objects.
    explained
        The cylinders ``(x, y, radius, height)`` in m that the library's explainer finds; None if it cannot be asked.
    """

    occupied: Mask
    regions: int
    ghosts: int
    ratio: float | None
    explained: list[tuple[float, float, float, float]] | None

    def runs(self) -> list[int]:
        """Lengths of the runs of free and occupied cells by turns, row by row, first the free ones.

        >>> LibraryMap(np.array([[False, False, True], [True, False, False]]), 1, 0, 1.0, None).runs()
        [2, 2, 2]
        """
        flat = np.concatenate([[False], self.occupied.ravel(), [not self.occupied.flat[-1]]])
        edges = np.flatnonzero(flat[1:] != flat[:-1])
        return [int(run) for run in np.diff(edges, prepend=0)]


def checked_cameras(value: Any) -> list[dict[str, Any]]:
    """Cameras as plain dictionaries, all values named; ``ValueError`` for what is no camera, or not 2 to 4 of them.

    >>> checked_cameras([{"name": "A", "x": -3, "y": 0, "height": 2.5}])
    Traceback (most recent call last):
    ValueError: cameras: expected 2 to 4 cameras, got 1
    """
    items = _items("cameras", value, ("name", "x", "y", "height"), ("view",))
    if not 2 <= len(items) <= len(NAMES):
        raise ValueError(f"cameras: expected 2 to {len(NAMES)} cameras, got {len(items)}")
    names = [checks.choice("cameras: name", item["name"], NAMES) for item in items]
    if len(set(names)) < len(names):
        raise ValueError(f"cameras: expected each name once, got {', '.join(names)}")
    return [
        {
            "name": item["name"],
            **{axis: checks.number(f"cameras: {axis}", item[axis], least=-100, most=100, unit="m") for axis in "xy"},
            "height": checks.number("cameras: height", item["height"], least=0.1, most=20, unit="m"),
            "view": checks.number("cameras: view", item.get("view", 150), least=1, most=360, unit="degrees"),
        }
        for item in items
    ]


def checked_objects(value: Any) -> list[dict[str, Any]]:
    """Objects as plain dictionaries, all values named; ``ValueError`` for what is no object, or more than 8.

    >>> checked_objects([{"x": 0, "y": 0.5, "radius": 0.2, "height": 0.4}])
    [{'x': 0.0, 'y': 0.5, 'radius': 0.2, 'height': 0.4, 'missed': []}]
    """
    items = _items("objects", value, ("x", "y", "radius", "height"), ("missed",))
    if len(items) > MOST_OBJECTS:
        raise ValueError(f"objects: expected at most {MOST_OBJECTS}, got {len(items)}")
    return [
        {
            **{axis: checks.number(f"objects: {axis}", item[axis], least=-100, most=100, unit="m") for axis in "xy"},
            **{n: checks.number(f"objects: {n}", item[n], least=0.01, most=5, unit="m") for n in ("radius", "height")},
            "missed": [checks.choice("objects: missed", name, NAMES) for name in _names(item.get("missed", []))],
        }
        for item in items
    ]


def _names(value: Any) -> list[Any]:
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise ValueError(f"objects: missed: expected a list of names, got {checks.shown(value)}")
    return list(value)


def _items(name: str, value: Any, needed: Sequence[str], more: Sequence[str]) -> list[Item]:
    if not isinstance(value, Sequence) or isinstance(value, str) or not all(isinstance(one, Mapping) for one in value):
        raise ValueError(f"{name}: expected a list of dictionaries, got {checks.shown(value)}")
    for one in value:
        if not set(needed) <= set(one) <= {*needed, *more}:
            raise ValueError(f"{name}: expected the keys {', '.join([*needed, *more])}, got {', '.join(map(str, one))}")
    return list(value)


def checked_floor(value: Any) -> Floor:
    """The floor of ``{"x": [min, max], "y": [min, max], "resolution"}``, of at most 200 000 cells: a browser draws them live."""
    if not isinstance(value, Mapping) or set(value) != {"x", "y", "resolution"}:
        raise ValueError(f"floor: expected x, y and resolution, got {checks.shown(value)}")
    x, y = (checks.numbers(f"floor.{axis}", value[axis], (2,)).tolist() for axis in "xy")
    floor = Floor((x[0], x[1]), (y[0], y[1]), checks.number("floor.resolution", value["resolution"], above=0, unit="m"))
    if floor.shape[0] * floor.shape[1] > 200_000:
        raise ValueError(f"floor: expected at most 200000 cells, got {floor.shape[1]} x {floor.shape[0]}")
    return floor


def floor_values(floor: Floor = FLOOR) -> dict[str, Any]:
    """A floor as :func:`checked_floor` takes it."""
    return {"x": list(floor.x), "y": list(floor.y), "resolution": floor.resolution}


def crowd_of(objects: Sequence[Item]) -> list[SceneObject]:
    """The objects as upright cylinders of :mod:`occlib.lab`."""
    return [upright("cylinder", (one["x"], one["y"]), 2 * one["radius"], one["height"]) for one in objects]


def overhead_camera(camera: Item, floor: Floor) -> Camera:
    """A camera at this place that looks straight down: its picture is the floor itself, with a margin, row 0 at greatest y.

    So a silhouette in it *is* the shadow on the floor, and only where the camera stands matters to the geometry.
    """
    px = 1 / floor.resolution
    (x0, x1), (y0, y1) = ((low - MARGIN_M, high + MARGIN_M) for low, high in (floor.x, floor.y))
    size = (round((x1 - x0) * px), round((y1 - y0) * px))
    focal = px * camera["height"]
    middle = (px * (camera["x"] - x0) - 0.5, px * (y1 - camera["y"]) - 0.5)
    rotation = np.diag([1.0, -1.0, -1.0])
    station = np.array([camera["x"], camera["y"], camera["height"]])
    lens = Lens(np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]]), np.zeros(5))
    return Camera.from_pose(camera["name"], size, lens, rotation, -rotation @ station)


def seen_cells(camera: Item, floor: Floor) -> Mask:
    """Cells within a camera's angle of view around the floor's middle, as seen from above, bool (ny, nx)."""
    if camera["view"] >= 360:
        return np.ones(floor.shape, bool)
    station = np.array([camera["x"], camera["y"]])
    ahead, rays = np.array([np.mean(floor.x), np.mean(floor.y)]) - station, floor.cell_centres_m() - station
    least = np.cos(np.radians(camera["view"] / 2)) * np.linalg.norm(ahead)
    return np.asarray(rays @ ahead >= least * np.linalg.norm(rays, axis=1)).reshape(floor.shape)


def library_map(
    cameras: Sequence[Item], objects: Sequence[Item], floor: Floor = FLOOR, *, explain: bool = True
) -> LibraryMap:
    """What the library's own stages make of a room: exact shadows, AND, regions, ghosts, and the explainer.

    Parameters
    ----------
    cameras, objects
        As in :data:`Item`.
    floor
        Of the map.
    explain
        Ask the explainer, too: 0.1 to 0.3 s.

    Examples
    --------
    >>> cameras = [{"name": "A", "x": -3.05, "y": 0, "height": 2.5}, {"name": "B", "x": 0, "y": -2.45, "height": 2.5}]
    >>> pair = [{"x": x, "y": y, "radius": 0.18, "height": 1.1} for x, y in [(-0.7, 0.35), (0.35, -0.75)]]
    >>> found = library_map(cameras, pair)
    >>> found.regions, found.ghosts, len(found.explained)
    (3, 1, 2)
    """
    cameras, objects = checked_cameras(cameras), checked_objects(objects)
    crowd = crowd_of(objects)
    seen = [seen_cells(camera, floor) for camera in cameras]
    shadows = [_shadows(camera, objects, crowd, floor) & visible for camera, visible in zip(cameras, seen, strict=True)]
    occupied = np.asarray(fuse(shadows, "and", visible=seen) & (np.sum(seen, axis=0) >= 2), dtype=bool)
    regions = find_regions(occupied, min_area=LEAST_AREA_M2 / floor.cell_area)[1]
    return LibraryMap(
        occupied,
        len(regions),
        ghost_regions(occupied, crowd, floor),
        claimed_area_ratio(occupied, floor, [each.footprint(0) for each in crowd]),
        _explained(cameras, objects, crowd, floor) if explain else None,
    )


def _shadows(camera: Item, objects: Sequence[Item], crowd: Sequence[SceneObject], floor: Floor) -> Mask:
    """All shadows of the objects that a camera does not miss, bool (ny, nx)."""
    lamp = overhead_camera(camera, floor)
    cast = [
        shadow_mask(lamp, each, floor)
        for item, each in zip(objects, crowd, strict=True)
        if camera["name"] not in item["missed"]
    ]
    return np.any([np.zeros(floor.shape, bool), *cast], axis=0)


def _explained(
    cameras: Sequence[Item], objects: Sequence[Item], crowd: Sequence[SceneObject], floor: Floor
) -> list[tuple[float, float, float, float]] | None:
    """The explainer's cylinders; None where an object is as high as a camera, whose picture then cannot show it."""
    if any(one["height"] >= 0.95 * camera["height"] for one in objects for camera in cameras):
        return None
    rig = Rig(floor, {camera["name"]: overhead_camera(camera, floor) for camera in cameras})
    around = Floor((floor.x[0] - MARGIN_M, floor.x[1] + MARGIN_M), (floor.y[0] - MARGIN_M, floor.y[1] + MARGIN_M),
                   floor.resolution)  # fmt: skip
    evidence = {}
    for camera in cameras:
        silhouettes = _shadows(camera, objects, crowd, around) & seen_cells(camera, around)
        evidence[camera["name"]] = Evidence.of_mask(np.ascontiguousarray(silhouettes[::-1]))
    found = Explainer(rig).explain(evidence).prisms
    return [(round(c.x, 3), round(c.y, 3), round(c.radius, 3), round(c.height, 3)) for c in found]
