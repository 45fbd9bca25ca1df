"""Crowds of upright objects under one to eight wall cameras, with perfect silhouettes: what a fusion rule can do at best.

No picture, no noise, no shadow of a lamp: rays are cast against exact shapes (:mod:`occlib.synthetic`), so whatever
goes wrong on the floor is the geometry's or the rule's doing. Views may be made to *miss* objects on purpose.

Ghosts are predicted, too. A camera at height ``H`` sees an object of height ``h`` as a shadow on the floor that
starts at its base and points away from the camera. Where the shadow of one object from one camera crosses the shadow of
another object from another camera, away from both bases, AND claims something and nothing stands.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from occlib.explaining import DEFAULT, Cylinder, Explanation, PolarEvidence, explain
from occlib.geometry import Camera, FloatArray, Floor, Image, Mask, Rig, apply_homography, as_points
from occlib.localization import find_regions
from occlib.metrics import claimed_area_ratio, evaluate, footprint_coverage
from occlib.occlusion import RULES, axis_colours, colour_agreement, fuse, standing_places
from occlib.recordings import open_recording
from occlib.registration import FloorWarp, PolarWarp
from occlib.synthetic import (
    SHAPES,
    Part,
    Scene,
    SceneObject,
    Waypoint,
    depth_image,
    ground_truth,
    hit_distance,
    load_scene,
    look_at,
    silhouettes,
    unit_mesh,
)

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
LEAST_AREA_M2 = 0.004
"""A region of the map that is smaller is noise."""
PLANES_M = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
"""Planes of the rule ``"planes"``: what reaches through half of them, so something at least 0.15 m high, is kept."""

GREY = (90, 90, 90)
EXPLAIN = ("explain", "explain, one spare")
"""Rules that are no vote on cells: :class:`MaskExplainer`, the second with one view that may miss an object."""


# --- the room --------------------------------------------------------------------------------------
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
        Of the cameras above the floor in m, above 0.7: the lens is to show things of 0.6 m whole.
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
    matrix = [[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]]
    return Camera.from_pose(name, size, matrix, np.zeros(5), rotation, -rotation @ station)


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
        One of :data:`occlib.synthetic.SHAPES`.
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
    >>> [thing.label for thing in crowd]
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
    """``number`` crowds of ``count`` objects, each from its own random numbers: the first do not depend on how many follow.

    >>> random_crowds(1, 4, 0) == random_crowds(3, 4, 0)[:1]
    True
    """
    return [random_crowd(count, np.random.default_rng([seed, count, i]), **sizes) for i in range(number)]


def places_m(crowd: Sequence[SceneObject]) -> FloatArray:
    """Where the objects stand, (N, 2) in m."""
    return as_points([thing.pose(0)[:2] for thing in crowd])


def truth_of(crowds: Sequence[Sequence[SceneObject]]) -> dict[str, Any]:
    """The crowds as the frames of a ``truth.json``, for :func:`occlib.metrics.evaluate`."""
    frames = {
        str(i): [
            {"id": thing.id, "x": thing.pose(0)[0], "y": thing.pose(0)[1], "footprint": thing.footprint(0).tolist()}
            for thing in crowd
        ]
        for i, crowd in enumerate(crowds)
    }
    return {"units": "m", "frames": frames}


# --- shadows and ghosts, predicted -----------------------------------------------------------------
def smear_m(distance: npt.ArrayLike, object_height: npt.ArrayLike, camera_height: npt.ArrayLike) -> FloatArray:
    """How far a shadow reaches beyond what casts it: ``d h / (H - h)``, by similar triangles.

    Parameters
    ----------
    distance
        From the point below the camera to the far edge of the object, in m.
    object_height, camera_height
        In m; a camera no higher than the object casts an endless shadow, inf.

    Examples
    --------
    >>> float(smear_m(3.0, 0.5, 2.5))
    0.75
    """
    d, h, high = (np.asarray(a, dtype=np.float64) for a in (distance, object_height, camera_height))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(high > h, d * h / (high - h), np.inf))


def shadow_outline_m(camera: Camera, thing: SceneObject) -> FloatArray:
    """The outline of a convex object's shadow on the floor, polygon (M, 2) in m, by similar triangles.

    Raises ``ValueError`` if the object reaches up to the camera.
    """
    points = np.vstack(
        [unit_mesh(p.shape)[0] @ m[:3, :3].T + m[:3, 3] for p, m in zip(thing.parts, thing.matrices(0), strict=True)]
    )
    x, y, high = camera.centre_m
    if points[:, 2].max() >= high:
        raise ValueError(f"thing: expected it below the camera at {high:.2f} m, got {points[:, 2].max():.2f} m")
    landing = np.array([x, y]) + (points[:, :2] - [x, y]) * (high / (high - points[:, 2:]))
    return np.asarray(landing[ConvexHull(landing).vertices])


def shadow_mask(camera: Camera, thing: SceneObject, floor: Floor) -> Mask:
    """Cells whose centre this camera has behind the object, or under it: bool (ny, nx), by rays through the cell centres.

    Unlike a mask of pixels it has no rim of half a pixel: the shadow at unlimited resolution.
    """
    cells = np.column_stack([floor.cell_centres_m(), np.zeros(floor.shape[0] * floor.shape[1])])
    rays = cells - camera.centre_m
    hit = [hit_distance(p.shape, m, camera.centre_m, rays) for p, m in zip(thing.parts, thing.matrices(0), strict=True)]
    return np.isfinite(np.min(hit, axis=0)).reshape(floor.shape)


def crossings(rig: Rig, crowd: Sequence[SceneObject], *, touch_m: float = 0.03) -> dict[tuple[int, int], FloatArray]:
    """Predicted ghosts of two cameras: where two objects' shadows cross away from both objects.

    Parameters
    ----------
    rig
        Two cameras.
    crowd
        Convex objects.
    touch_m
        A crossing nearer to one of the two bases is a bulge of that object and no ghost.

    Returns
    -------
    ``{(i, j): polygon (M, 2) in m}``: the shadow of ``crowd[i]`` from the first camera crosses that of ``crowd[j]`` from the
    second on at least :data:`LEAST_AREA_M2` of the floor.

    Raises
    ------
    ValueError
        Not two cameras.

    Examples
    --------
    Two lamps at right angles, and two tall boxes: one pair of shadows meets, the other points apart.

    >>> pair = [upright("box", at, 0.2, 0.9) for at in [(-0.6, 0.3), (0.0, -0.4)]]
    >>> list(crossings(wall_rig({"left": 180, "front": 270}), pair))
    [(0, 1)]
    """
    if len(rig.cameras) != 2:
        raise ValueError(f"rig: expected two cameras, got {len(rig.cameras)}")
    first, second = ([shadow_outline_m(camera, thing) for thing in crowd] for camera in rig.cameras.values())
    bases = [thing.footprint(0) for thing in crowd]
    wide = [_grown(base, touch_m) for base in bases]
    (x0, x1), (y0, y1) = rig.floor.x, rig.floor.y
    rim = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    found = {}
    for i, j in permutations(range(len(crowd)), 2):
        if (first[i].min(axis=0) > second[j].max(axis=0)).any() or (second[j].min(axis=0) > first[i].max(axis=0)).any():
            continue
        area, overlap = _overlap(first[i], second[j])
        if area >= LEAST_AREA_M2 and _overlap(overlap, wide[i])[0] == 0 and _overlap(overlap, wide[j])[0] == 0:
            area, overlap = _overlap(overlap, rim)
            if area >= LEAST_AREA_M2:
                found[i, j] = overlap
    return found


def _grown(polygon: FloatArray, margin: float) -> FloatArray:
    middle = polygon.mean(axis=0)
    away = polygon - middle
    return middle + away * (1 + margin / np.linalg.norm(away, axis=1, keepdims=True))


def _overlap(a: FloatArray, b: FloatArray) -> tuple[float, FloatArray]:
    """Area in m2 and polygon of the intersection of two convex polygons."""
    area, polygon = cv2.intersectConvexConvex(a.astype(np.float32), b.astype(np.float32))
    return float(area), as_points(polygon if area > 0 else [])


def expected_crossings(rig: Rig, count: int, height: float) -> float:
    """The law of crossings: how many shadows of thin objects at random places cross, on average.

    ``n (n - 1) (h / H)^2 b <y> / A``, with the distance ``b`` between the two cameras, the mean distance ``<y>`` of the floor
    from the line below them, and the floor's area ``A``.

    Parameters
    ----------
    rig
        Two cameras, equally high.
    count, height
        Number ``n`` of objects and their mean height ``h`` in m.

    Notes
    -----
    A shadow ends at a point p if its object stands up to ``d h / H`` before it, ``d`` being p's distance from the camera. Two
    such sticks with the directions of the two cameras cross at p with the density ``d1 d2 (h / H)^2 sin(theta) / A^2``. But
    ``d1 d2 sin(theta)`` is twice the area of the triangle of p and the cameras: the base ``b`` times the height ``y``.

    Examples
    --------
    >>> round(expected_crossings(wall_rig(2), 8, 0.4), 2)
    0.55
    """
    if len(rig.cameras) != 2:
        raise ValueError(f"rig: expected two cameras, got {len(rig.cameras)}")
    a, b = (camera.centre_m for camera in rig.cameras.values())
    line, cells = (b - a)[:2], rig.floor.cell_centres_m() - a[:2]
    twice_triangle = np.abs(line[0] * cells[:, 1] - line[1] * cells[:, 0]).mean()
    area = np.ptp(rig.floor.x) * np.ptp(rig.floor.y)
    return float(count * (count - 1) * (2 * height / (a[2] + b[2])) ** 2 * twice_triangle / area)


def ghost_regions(occupied: Mask, crowd: Sequence[SceneObject], floor: Floor) -> int:
    """How many regions of a map hold no part of any base, counted from :data:`LEAST_AREA_M2` on."""
    labels, regions = find_regions(occupied, min_area=LEAST_AREA_M2 / floor.cell_area)
    real: set[int] = set()
    for thing in crowd:
        real |= set(labels[floor.polygon_mask(thing.footprint(0))].tolist())
    return len(regions) - len(real - {0})


# --- simulation ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Simulation:
    """Perfect silhouettes of crowds as a rig's cameras see them, and what a rule makes of them.

    Parameters
    ----------
    rig
        One or more cameras.
    trust
        What a view's "yes" and "no" are worth as probabilities, for the rules that weigh evidence. A "yes" may be
        another object's shadow, so it is worth less than a "no".
    how
        For the rules ``"explain"`` and ``"explain, one spare"``: the latter looks also where one view sees nothing.

    Examples
    --------
    >>> simulation = Simulation(wall_rig(2))
    >>> crowd = random_crowd(2, np.random.default_rng(1))
    >>> found = simulation.places(simulation.masks(crowd), "and")
    >>> bool(np.linalg.norm(found[:, None] - places_m(crowd), axis=2).min(axis=0).max() < 0.1)
    True
    """

    rig: Rig
    trust: tuple[float, float] = (0.8, 0.1)
    how: Explanation = DEFAULT

    @cached_property
    def _scene(self) -> Scene:
        """Holds the pixels' rays; the objects come later."""
        return Scene("crowd", Path(), {}, self.rig, frames=1, background=0, seed=0, fps=10.0, objects=())

    @cached_property
    def _warps(self) -> dict[str, FloorWarp]:
        return {name: FloorWarp(camera, self.rig.floor) for name, camera in self.rig.cameras.items()}

    @cached_property
    def _planes(self) -> dict[str, list[FloorWarp]]:
        return {n: [FloorWarp(c, self.rig.floor, z) for z in PLANES_M] for n, c in self.rig.cameras.items()}

    @cached_property
    def _explainers(self) -> dict[str, MaskExplainer]:
        return {name: MaskExplainer(self.rig, self.how, spare=spare) for spare, name in enumerate(EXPLAIN)}

    def silhouettes(self, crowd: Sequence[SceneObject]) -> dict[str, Mask]:
        """Each object's silhouette as if it were alone, ``{camera: bool (n, H, W)}``."""
        seen = {}
        for name, camera in self.rig.cameras.items():
            seen[name] = np.zeros((len(crowd), *camera.size[::-1]), bool)
            for mask, thing in zip(seen[name], crowd, strict=True):
                depth, window = depth_image(self._scene, camera, thing, 0)
                mask[window] = np.isfinite(depth)
        return seen

    def masks(self, crowd: Sequence[SceneObject], kept: Mapping[str, Mask] | None = None) -> dict[str, Mask]:
        """Each camera's foreground, ``{camera: bool (H, W)}``.

        ``kept``: for each camera bool (n,), False for an object that this view misses; all for None.
        """
        return union(self.silhouettes(crowd), kept)

    def on_floor(self, masks: Mapping[str, Mask]) -> dict[str, Mask]:
        """The masks as shadows on the floor, ``{camera: bool (ny, nx)}``."""
        return {name: self._warps[name].warp(mask) for name, mask in masks.items()}

    def occupied(self, masks: Mapping[str, Mask], rule: str = "and") -> Mask:
        """The map of a rule of :func:`occlib.occlusion.fuse`, bool (ny, nx); two cameras (if there are two) must see a cell."""
        if rule not in RULES:
            raise ValueError(f"rule: expected one of {', '.join(RULES)}, got {rule!r}")
        visible: list[Mask] = [self._warps[name].visible for name in masks]
        if rule == "planes":
            views = [np.stack([plane.warp(mask) for plane in self._planes[name]]) for name, mask in masks.items()]
            fused = fuse(views, rule, visible=[np.stack([p.visible for p in self._planes[name]]) for name in masks])
        elif rule in ("product", "log-odds"):
            yes, no = self.trust
            fused = (
                fuse([np.where(view, yes, no) for view in self.on_floor(masks).values()], rule, visible=visible) > 0.5
            )
        else:
            fused = fuse(list(self.on_floor(masks).values()), rule, visible=visible)
        return np.asarray(fused & (np.sum(visible, axis=0) >= min(2, len(masks))), dtype=bool)

    def places(self, masks: Mapping[str, Mask], rule: str = "and") -> FloatArray:
        """Where a rule puts objects, (N, 2) in m: centroids of its regions, or the axes of ``"explain"``'s cylinders."""
        if rule in EXPLAIN:
            return as_points([(c.x, c.y) for c in self._explainers[rule].explain(masks)])
        floor = self.rig.floor
        regions = find_regions(self.occupied(masks, rule), min_area=LEAST_AREA_M2 / floor.cell_area)[1]
        return as_points([region.centroid for region in regions]) * floor.resolution + (
            np.array([floor.x[0], floor.y[0]]) + floor.resolution / 2
        )

    def cost_ms(self, masks: Sequence[Mapping[str, Mask]], rule: str, *, repeats: int = 3) -> float:
        """Median time from the masks of an instant to the objects' places, in ms, after one run to warm up."""
        self.places(masks[0], rule)
        times = []
        for _ in range(repeats):
            for views in masks:
                start = time.perf_counter()
                self.places(views, rule)
                times.append(1000 * (time.perf_counter() - start))
        return float(np.median(times))


def measured_smear_m(simulation: Simulation, thing: SceneObject) -> float:
    """How far the shadow of an upright cylinder reaches beyond it in m, read off the floor map of the rig's only camera."""
    ((name, camera),) = simulation.rig.cameras.items()
    floor, shadow = simulation.rig.floor, simulation.on_floor(simulation.masks([thing]))[name]
    axis = places_m([thing])[0] - camera.centre_m[:2]
    distance = float(np.linalg.norm(axis))
    offset = floor.cell_centres_m()[shadow.ravel()] - camera.centre_m[:2]
    along, across = offset @ axis / distance, (offset[:, 0] * axis[1] - offset[:, 1] * axis[0]) / distance
    reach = along[np.abs(across) <= floor.resolution].max() + floor.resolution / 2
    return float(reach - distance - thing.parts[0].size[0] / 2)


def score(
    simulation: Simulation,
    masks: Sequence[Mapping[str, Mask]],
    crowds: Sequence[Sequence[SceneObject]],
    rule: str = "and",
    *,
    radius: float = 0.3,
) -> dict[str, float]:
    """What :func:`occlib.metrics.evaluate` says of a rule on these crowds; NaN where it says nothing.

    Parameters
    ----------
    simulation
        Whose cameras took the masks.
    masks
        For each crowd ``{camera: bool (H, W)}``.
    crowds
        Who stands there.
    rule
        One of :data:`occlib.occlusion.RULES` or :data:`EXPLAIN`.
    radius
        Within which a detection is right, in m.
    """
    found = {i: simulation.places(views, rule) for i, views in enumerate(masks)}
    result = evaluate(found, truth_of(crowds), radius=radius)
    values = {
        "MODA": result.moda,
        "ghosts a frame": result.ghosts_per_frame,
        "precision": result.precision,
        "recall": result.recall,
        "median error (cm)": None if result.error_median_m is None else 100 * result.error_median_m,
    }
    return {name: np.nan if value is None else float(value) for name, value in values.items()}


def two_view_study(rig: Rig, crowds: Sequence[Sequence[SceneObject]]) -> dict[str, float]:
    """Ghosts a frame of the AND of two cameras, by the law, predicted and measured, beside its scores; means over the crowds."""
    simulation, floor = Simulation(rig), rig.floor
    masks = [simulation.masks(crowd) for crowd in crowds]
    maps = [simulation.occupied(views) for views in masks]
    pairs = list(zip(maps, crowds, strict=True))
    tall = float(np.mean([thing.height for crowd in crowds for thing in crowd]))
    ratios = [claimed_area_ratio(one, floor, [thing.footprint(0) for thing in crowd]) for one, crowd in pairs]
    return {
        "law": expected_crossings(rig, len(crowds[0]), tall),
        "predicted": float(np.mean([len(crossings(rig, crowd)) for crowd in crowds])),
        "measured": float(np.mean([ghost_regions(one, crowd, floor) for one, crowd in pairs])),
        "claimed / true": float(np.mean([ratio for ratio in ratios if ratio is not None])),
        **score(simulation, masks, crowds),
    }


def covered_share(
    simulation: Simulation, masks: Sequence[Mapping[str, Mask]], crowds: Sequence[Any], rule: str
) -> float:
    """Share of the objects of which a rule's map covers at least half the base."""
    floor = simulation.rig.floor
    covered = [
        footprint_coverage(simulation.occupied(views, rule), floor, [thing.footprint(0) for thing in crowd]) >= 0.5
        for views, crowd in zip(masks, crowds, strict=True)
    ]
    return float(np.mean(np.concatenate(covered)))


def union(silhouettes: Mapping[str, Mask], kept: Mapping[str, Mask] | None = None) -> dict[str, Mask]:
    """Silhouettes ``{camera: bool (n, H, W)}`` to one mask a camera, without those not ``kept`` ``{camera: bool (n,)}``."""
    return {n: np.any(one if kept is None else one[kept[n]], axis=0) for n, one in silhouettes.items()}


def misses(cameras: Iterable[str], count: int, recall: float, rng: np.random.Generator) -> dict[str, Mask]:
    """Which of ``count`` objects each camera segments: each independently with probability ``recall``, ``{camera: bool (n,)}``.

    >>> {name: kept.all() for name, kept in misses(["left"], 3, 1.0, np.random.default_rng(0)).items()}
    {'left': np.True_}
    """
    if not 0 <= recall <= 1:
        raise ValueError(f"recall: expected a probability, got {recall}")
    return {name: np.asarray(rng.random(count) < recall) for name in cameras}


def votes_needed(rule: str, cameras: int, trust: tuple[float, float] = (0.8, 0.1)) -> int:
    """How many of the cameras must say "yes" before a cell is occupied: with hard masks every rule is a vote.

    >>> [votes_needed(rule, 4) for rule in ("and", "most", "product", "log-odds", "or")]
    [4, 3, 4, 3, 1]
    """
    yes, no = trust if rule in ("product", "log-odds") else (1.0, 0.0)
    for count in range(1, cameras + 1):
        if fuse([np.array([[yes if i < count else no]]) for i in range(cameras)], rule)[0, 0] > 0.5:
            return count
    return cameras + 1


class MaskExplainer:
    """Explains away with masks alone: ``{camera: mask}`` to cylinders, :func:`occlib.explaining.explain`.

    Parameters
    ----------
    rig
        The cameras.
    how
        Thresholds of the explanation.
    step_rad
        Angle between two samples of the polar views.
    planes_m
        Heights at which something that stands is looked for, in m.
    spare
        So many views may miss an object: it is looked for where all but ``spare`` of them have foreground, but in two at
        least. 0 is what :func:`occlib.occlusion.standing_places` does.
    """

    def __init__(
        self,
        rig: Rig,
        how: Explanation = DEFAULT,
        *,
        step_rad: float = 0.0045,
        planes_m: Sequence[float] = (0.0, 0.1, 0.3),
        spare: int = 0,
    ) -> None:
        self.how, self.spare = how, spare
        self._polar = {n: PolarWarp(c, rig.floor, step_rad * float(c.matrix[0, 0])) for n, c in rig.cameras.items()}
        self._coarse = Floor(rig.floor.x, rig.floor.y, max(how.grid_m, rig.floor.resolution))
        self._planes = {n: [FloorWarp(c, self._coarse, z) for z in planes_m] for n, c in rig.cameras.items()}
        self._visible = {n: np.stack([plane.visible for plane in planes]) for n, planes in self._planes.items()}

    def explain(self, masks: Mapping[str, Mask], before: Sequence[Cylinder] = ()) -> list[Cylinder]:
        """The cylinders that explain the masks of one instant, ``{camera: bool (H, W)}``; ``before``: those of the last."""
        views = []
        for name, mask in masks.items():
            warp = self._polar[name]
            share = warp.warp(np.where(mask, np.uint8(255), np.uint8(0))).astype(np.float64) / 255
            signed = np.where(share > 0.5, 255 * (2 * share - 1), 255 * self.how.background * (2 * share - 1))
            views.append((warp.parameters, np.rint(signed * warp.visible).astype(np.int32), warp.visible))
        votes = {name: np.stack([plane.warp(mask) for plane in self._planes[name]]) for name, mask in masks.items()}
        standing = np.unique(
            np.vstack(
                [
                    standing_places(
                        [votes[n] for n in team], [self._visible[n] for n in team], self._coarse, level=0, views=fewest
                    )
                    for fewest in [min(2, len(masks))]
                    for team in combinations(masks, max(fewest, len(masks) - self.spare))
                ]
            ),
            axis=0,
        )
        return explain(PolarEvidence.of(views), standing, before=before, how=self.how)


# --- colour ----------------------------------------------------------------------------------------
def colour_study(recording: str, frames: Iterable[int], *, height: float = 0.05) -> list[dict[str, Any]]:
    """How much two views disagree at what AND claims in a recording of the lab, for every pair of its cameras.

    The masks are the scene's ideal silhouettes, the colours those of the pictures. Few frames hold a ghost. But a ghost shows one
    object to one camera and another object to the other, so for each two objects in plain view the distance between the colour
    of the one in one view and of the other in the other view is what a ghost of theirs would show.

    Parameters
    ----------
    recording
        Name of a rendered recording, such as ``"four_robots"``.
    frames
        Which of its frames.
    height
        Up to which a candidate's colour is looked at in m: no higher than the lowest object.

    Returns
    -------
    Rows ``{"frame", "cameras", "kind", "object", "x", "y", "disagreement"}``. ``kind``: ``"real, in plain view"``, ``"real, partly
    hidden"`` (more than a tenth from one of the two cameras), ``"ghost"`` or ``"ghost to be"``; m and grey levels.
    """
    source, scene = open_recording(recording), load_scene(recording)
    rig, floor = source.rig, source.rig.floor
    warps = {name: FloorWarp(camera, floor) for name, camera in rig.cameras.items()}
    truth, wanted, rows = ground_truth(scene, frames=frames)["frames"], {int(frame) for frame in frames}, []
    for frame, images in source.images():
        if frame not in wanted:
            continue
        seen = silhouettes(scene, frame)
        views = {name: warps[name].warp(np.any([m for m, _ in seen[name].values()], axis=0)) for name in rig.cameras}
        for pair in combinations(rig.cameras, 2):
            pictures = {name: images[name] for name in pair}
            for kind, name, (x, y), value in [
                *_claimed(views, pair, pictures, truth[str(frame)], rig, height),
                *_ghosts_to_be(pair, pictures, truth[str(frame)], rig),
            ]:
                row = {"frame": frame, "cameras": " + ".join(pair), "kind": kind, "object": name}
                rows.append({**row, "x": x, "y": y, "disagreement": value})
    return rows


def _plain(thing: Mapping[str, Any], camera: str) -> bool:
    return bool(thing["hidden_fraction"].get(camera, 1.0) < 0.1)


def _claimed(
    views: Mapping[str, Mask], pair: tuple[str, str], pictures: Mapping[str, Image], truth: Any, rig: Rig, height: float
) -> list[tuple[str, str, tuple[float, float], float]]:
    """Regions of the AND: kind, objects, place and disagreement."""
    floor = rig.floor
    labels, regions = find_regions(views[pair[0]] & views[pair[1]], min_area=LEAST_AREA_M2 / floor.cell_area)
    owners: dict[int, list[Any]] = {region.label: [] for region in regions}
    for thing in truth:
        for label in set(labels[floor.polygon_mask(thing["footprint"])].tolist()) - {0}:
            owners[label].append(thing)
    places = apply_homography(floor.cell_to_floor, [region.centroid for region in regions])
    found = colour_agreement(places, height, pictures, rig)
    kinds = [
        "ghost"
        if not owners[region.label]
        else "real, in plain view"
        if all(_plain(thing, name) for thing in owners[region.label] for name in pair)
        else "real, partly hidden"
        for region in regions
    ]
    ids = [" + ".join(str(thing["id"]) for thing in owners[region.label]) for region in regions]
    return [
        (kind, name, (float(x), float(y)), float(d))
        for kind, name, (x, y), d in zip(kinds, ids, places, found, strict=True)
    ]


def _ghosts_to_be(
    pair: tuple[str, str], pictures: Mapping[str, Image], truth: Any, rig: Rig
) -> list[tuple[str, str, tuple[float, float], float]]:
    """Colour of one object in one view against that of another object in the other view."""
    colours = axis_colours([[t["x"], t["y"]] for t in truth], [t["height"] for t in truth], pictures, rig)
    return [
        ("ghost to be", "", (np.nan, np.nan), float(np.linalg.norm(colours[0, i] - colours[1, j])))
        for i, j in permutations(range(len(truth)), 2)
        if _plain(truth[i], pair[0]) and _plain(truth[j], pair[1])
    ]
