"""Shadows and ghosts, predicted by geometry alone.

A camera at height ``H`` sees an object of height ``h`` as a shadow on the floor that starts at its base and points away
from the camera. Where the shadow of one object from one camera crosses the shadow of another object from another
camera, away from both bases, AND claims something where nothing stands: a *ghost*.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from occlib.base.arrays import FloatArray, Mask, as_points
from occlib.geometry import Camera, Floor, Rig
from occlib.lab.crowds import base_m, solid_m
from occlib.lab.scenes import SceneObject
from occlib.lab.shapes import hit_distance
from occlib.localization import find_regions

LEAST_AREA_M2 = 0.004
"""A region of the map that is smaller is noise."""


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


def shadow_outline_m(camera: Camera, scene_object: SceneObject) -> FloatArray:
    """The outline of a convex object's shadow on the floor, polygon (M, 2) in m, by similar triangles.

    Raises ``ValueError`` if the object reaches up to the camera.
    """
    points = solid_m(scene_object)
    x, y, high = camera.centre_m
    if points[:, 2].max() >= high:
        raise ValueError(f"scene_object: expected it below the camera at {high:.2f} m, got {points[:, 2].max():.2f} m")
    landing = np.array([x, y]) + (points[:, :2] - [x, y]) * (high / (high - points[:, 2:]))
    return np.asarray(landing[ConvexHull(landing).vertices])


def shadow_mask(camera: Camera, scene_object: SceneObject, floor: Floor) -> Mask:
    """Cells that the object hides from this camera, those under it included, bool (ny, nx): rays to the cell centres.

    Unlike a mask of pixels it has no rim of half a pixel: the shadow at unlimited resolution.
    """
    cells = np.column_stack([floor.cell_centres_m(), np.zeros(floor.shape[0] * floor.shape[1])])
    rays = cells - camera.centre_m
    hit = [
        hit_distance(p.shape, m, camera.centre_m, rays)
        for p, m in zip(scene_object.parts, scene_object.matrices(0), strict=True)
    ]
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
    ``{(i, j): polygon (M, 2) in m}``: the shadow of ``crowd[i]`` from the first camera crosses that of
    ``crowd[j]`` from the second on at least :data:`LEAST_AREA_M2` of the floor.

    Raises
    ------
    ValueError
        Not two cameras.

    Examples
    --------
    Two lamps at right angles, and two tall boxes: one pair of shadows meets, the other points apart.

    >>> from occlib.lab import upright, wall_rig
    >>> pair = [upright("box", at, 0.2, 0.9) for at in [(-0.6, 0.3), (0.0, -0.4)]]
    >>> list(crossings(wall_rig({"left": 180, "front": 270}), pair))
    [(0, 1)]
    """
    if len(rig.cameras) != 2:
        raise ValueError(f"rig: expected two cameras, got {len(rig.cameras)}")
    first, second = ([shadow_outline_m(camera, each) for each in crowd] for camera in rig.cameras.values())
    bases = [base_m(each) for each in crowd]
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
    """The law of crossings: how many pairs of shadows of thin objects at random places cross, on average.

    ``n (n - 1) (h / H)^2 b <y> / A``, with the distance ``b`` between the two cameras, the mean distance ``<y>`` of the
    floor from the line below them, and the floor's area ``A``.

    Parameters
    ----------
    rig
        Two cameras, equally high.
    count, height
        Number ``n`` of objects and their mean height ``h`` in m.

    Notes
    -----
    A thin object casts a thin shadow, which ends about ``d h / H`` behind it, ``d`` being the distance of the shadow's
    end from the camera. Leave the shadow of one object from the second camera where it is and move another object: its
    shadow from the first camera meets the resting one exactly while the object stands in the parallelogram of the two
    shadows, of the area ``d1 d2 (h / H)^2 sin(theta)``. For a random place that has the probability area over ``A``.
    And ``d1 d2 sin(theta)`` is twice the area of the triangle of the place and the two cameras: the base ``b`` times
    the height ``y``. There are ``n (n - 1)`` ordered pairs of objects.

    Examples
    --------
    >>> from occlib.lab import wall_rig
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
    for each in crowd:
        real |= set(labels[floor.polygon_mask(base_m(each))].tolist())
    return len(regions) - len(real - {0})
