"""The lamps and windows of a room as points of light: how much of it reaches a place, and what objects keep from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray
from occlib.formats.scene import RoomFile
from occlib.lab.scenes import SceneObject
from occlib.lab.shapes import rotation_xyz

CEILING_BELOW_M = 0.02
"""How far the ceiling light hangs below the ceiling."""


@dataclass(frozen=True)
class LightPoints:
    """Points of light: where each is (N, 3) in m, where it shines, unit vectors (N, 3), and radiance times area (N,)."""

    at: FloatArray
    facing: FloatArray
    power: FloatArray

    def flux(self, points: npt.ArrayLike) -> FloatArray:
        """Light (P, N) that reaches points (P, 3) from each point of light, on a surface that faces it."""
        way = np.asarray(points, float)[:, None] - self.at
        square = np.maximum((way**2).sum(axis=2), 1e-6)
        return np.asarray(self.power * np.maximum((way * self.facing).sum(axis=2), 0) / square**1.5)

    def irradiance(self, points: npt.ArrayLike) -> FloatArray:
        """Direct light (P,) on level places (P, 3), with nothing in its way."""
        way = self.at - np.asarray(points, float)[:, None]
        slant = np.maximum(way[..., 2], 0) / np.maximum(np.linalg.norm(way, axis=2), 1e-6)
        return np.asarray((self.flux(points) * slant).sum(axis=1))

    def shaded(self, points: FloatArray, objects: Iterable[SceneObject], frame: float) -> FloatArray:
        """Share (P,), 0 to 1, of the direct light to points (P, 3) that crosses the bounding box of an object."""
        flux = self.flux(points)
        blocked = np.zeros(flux.shape, bool)
        for each in objects:
            x, y, heading = each.pose(frame)
            turn = rotation_xyz((0.0, 0.0, -heading))
            solid = (each.vertices_m(frame) - [x, y, 0.0]) @ turn.T
            low, high = solid.min(axis=0), solid.max(axis=0)
            start, end = ((p - [x, y, 0.0]) @ turn.T for p in (points, self.at))
            way = end - start[:, None]
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b = (low - start)[:, None] / way, (high - start)[:, None] / way
            near, far = np.minimum(a, b).max(axis=2), np.maximum(a, b).min(axis=2)
            blocked |= (near < far) & (far > 1e-3) & (near < 1)
        return np.asarray((flux * blocked).sum(axis=1) / np.maximum(flux.sum(axis=1), 1e-12))


def light_points(room: RoomFile) -> LightPoints:
    """The lamps and windows of a room, each as a grid of points at most 0.6 m apart and at least 2 x 2."""
    (x0, x1), (y0, y1) = room.walls.x, room.walls.y
    top = np.eye(3)[:, :2]
    panel = ((x0 + x1) / 2, (y0 + y1) / 2, room.walls.height - CEILING_BELOW_M)
    areas = [(panel, room.ceiling_light.size, top, (0.0, 0.0, -1.0), room.ceiling_light.radiance)]
    areas += [(lamp.centre, lamp.size, top, (0.0, 0.0, -1.0), lamp.radiance) for lamp in room.lamps.values()]
    for window in room.daylight:
        c, s = np.cos(np.radians(window.facing_deg)), np.sin(np.radians(window.facing_deg))
        areas.append((window.centre, window.size, np.array([[-s, 0], [c, 0], [0, 1.0]]), (c, s, 0.0), window.radiance))
    at, facing, power = [], [], []
    for centre, size, axes, direction, radiance in areas:
        counts = [max(2, int(np.ceil(side / 0.6))) for side in size]
        grid = np.stack(np.meshgrid(*((np.arange(n) + 0.5) / n - 0.5 for n in counts)), axis=-1).reshape(-1, 2)
        at.append(centre + (grid * size) @ np.transpose(axes))
        facing.append(np.tile(direction, (len(grid), 1)))
        power.append(np.full(len(grid), radiance * size[0] * size[1] / len(grid)))
    return LightPoints(np.vstack(at), np.vstack(facing), np.concatenate(power))
