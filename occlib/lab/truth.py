"""DOC"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray, Mask
from occlib.geometry import Camera
from occlib.lab.scenes import Scene, SceneObject
from occlib.lab.shapes import hit_distance, unit_mesh


def depth_image(
    scene: Scene, camera: Camera, thing: SceneObject, frame: float
) -> tuple[FloatArray, tuple[slice, slice]]:
    """Distances to one object and the window of the picture that they cover."""
    width, height = camera.size
    origin, rays = camera.centre_m, scene.rays[camera.name]
    matrices = thing.matrices(frame)
    corners = np.vstack([unit_mesh("box")[0] @ m[:3, :3].T + m[:3, 3] for m in matrices])
    pixels = camera.project(corners)
    if np.isnan(pixels).any():
        low, high = np.zeros(2), np.array([width, height], float)
    else:  # straight edges bulge between their ends under lens distortion: leave room
        spare = 4 + 0.1 * (pixels.max(0) - pixels.min(0))
        low, high = np.floor(pixels.min(0) - spare), np.ceil(pixels.max(0) + spare)
    (c0, r0), (c1, r1) = np.clip(low, 0, [width, height]).astype(int), np.clip(high, 0, [width, height]).astype(int)
    window = (slice(r0, r1), slice(c0, c1))
    view = rays[window].reshape(-1, 3)
    depth = np.full(len(view), np.inf)
    for part, matrix in zip(thing.parts, matrices, strict=True):
        depth = np.minimum(depth, hit_distance(part.shape, matrix, origin, view))
    return depth.reshape(r1 - r0, c1 - c0), window


def silhouettes(scene: Scene, frame: int) -> dict[str, dict[str, tuple[Mask, Mask]]]:
    """Ideal masks ``{camera: {object id: (amodal, visible)}}``, each (H, W).

    Amodal: the object as if it were alone. Visible: minus what other objects hide. Pixel-centre rays.
    """
    result: dict[str, dict[str, tuple[Mask, Mask]]] = {}
    for name, camera in scene.rig.cameras.items():
        shape = camera.size[::-1]
        nearest = np.full(shape, np.inf)
        depths = {thing.id: depth_image(scene, camera, thing, frame) for thing in scene.objects}
        for depth, window in depths.values():
            nearest[window] = np.minimum(nearest[window], depth)
        result[name] = {}
        for key, (depth, window) in depths.items():
            amodal, visible = np.zeros(shape, bool), np.zeros(shape, bool)
            amodal[window] = np.isfinite(depth)
            visible[window] = amodal[window] & (depth <= nearest[window])
            result[name][key] = (amodal, visible)
    return result


def ground_truth(scene: Scene, *, frames: Iterable[int] | None = None) -> dict[str, Any]:
    """The content of ``truth.json``: places, footprints, heights and hidden fractions, by ray casting.

    ``hidden_fraction`` is 1 - visible / amodal pixels; an object outside the picture has no entry.
    """
    content: dict[str, Any] = {}
    for frame in range(scene.frames) if frames is None else frames:
        masks = silhouettes(scene, frame)
        content[str(frame)] = []
        for thing in scene.objects:
            x, y, heading = thing.pose(frame)
            counts = {name: [int(m.sum()) for m in masks[name][thing.id]] for name in masks}
            content[str(frame)].append(
                {
                    "id": thing.id,
                    "x": round(x, 4),
                    "y": round(y, 4),
                    "heading_deg": round(heading, 2),
                    "label": thing.label,
                    "colour": list(thing.colour),
                    "height": round(thing.height, 4),
                    "footprint": np.round(_thin(thing.footprint(frame)), 4).tolist(),
                    "hidden_fraction": {
                        name: round(1 - visible / amodal, 6) for name, (amodal, visible) in counts.items() if amodal
                    },
                }
            )
    (x0, x1), (y0, y1) = scene.rig.floor.x, scene.rig.floor.y
    roi = {"floor": [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]}
    return {"units": "m", "frames": content, "roi": roi}


def _thin(polygon: FloatArray, most: int = 24) -> FloatArray:
    """At most ``most`` of the vertices: a circle need not take a page of JSON."""
    return polygon[:: -(-len(polygon) // most)]
