"""What is true of a scene, by casting rays: depth, exact silhouettes, and the content of its truth file.

Rays go through the centres of the pixels of the same :class:`~occlib.geometry.Camera` that the pictures are rendered
with, lens distortion included.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from occlib.base.arrays import FloatArray, Mask
from occlib.formats import TrueObject, Truth
from occlib.geometry import Camera
from occlib.lab.scenes import Scene, SceneObject


def depth_image(
    scene: Scene, camera: Camera, item: SceneObject, frame: float
) -> tuple[FloatArray, tuple[slice, slice]]:
    """Distances to one object and the window of the picture that they cover."""
    shapes = [part.shape for part in item.parts]
    return scene.depths(camera.name, shapes, item.matrices(frame))


def silhouettes(scene: Scene, frame: int) -> dict[str, dict[str, tuple[Mask, Mask]]]:
    """Ideal masks ``{camera: {object id: (amodal, visible)}}``, each (H, W).

    Amodal: the object as if it were alone. Visible: minus what other objects and furniture hide. Pixel-centre rays.
    """
    result: dict[str, dict[str, tuple[Mask, Mask]]] = {}
    for name, camera in scene.rig.cameras.items():
        shape = camera.size[::-1]
        nearest = scene.furniture_depths[name].copy()
        depths = {each.id: depth_image(scene, camera, each, frame) for each in scene.objects}
        for depth, window in depths.values():
            nearest[window] = np.minimum(nearest[window], depth)
        result[name] = {}
        for key, (depth, window) in depths.items():
            amodal, visible = np.zeros(shape, bool), np.zeros(shape, bool)
            amodal[window] = np.isfinite(depth)
            visible[window] = amodal[window] & (depth <= nearest[window])
            result[name][key] = (amodal, visible)
    return result


def ground_truth(scene: Scene, *, frames: Iterable[int] | None = None) -> Truth:
    """Places, footprints, heights and hidden fractions of a scene's objects, by ray casting.

    ``hidden_fraction`` is 1 - visible / amodal pixels; an object outside the picture has no entry.
    """
    chosen = range(scene.frames) if frames is None else sorted(set(frames))
    (x0, x1), (y0, y1) = scene.rig.floor.x, scene.rig.floor.y
    roi: dict[str, tuple[tuple[float, float], ...]] = {"floor": ((x0, y0), (x1, y0), (x1, y1), (x0, y1))}
    return Truth({frame: _true_objects(scene, frame) for frame in chosen}, roi)


def _true_objects(scene: Scene, frame: int) -> list[TrueObject]:
    masks, found = silhouettes(scene, frame), []
    for each in scene.objects:
        x, y, heading = each.pose(frame)
        counts = {name: [int(mask.sum()) for mask in masks[name][each.id]] for name in masks}
        outline = np.round(_thin(each.footprint(frame)), 4)
        found.append(
            TrueObject(
                id=each.id,
                x=round(x, 4),
                y=round(y, 4),
                heading_deg=round(heading, 2),
                label=each.label,
                colour=each.colour,
                height=round(each.height, 4),
                footprint=tuple((float(u), float(v)) for u, v in outline),
                hidden_fraction={
                    name: round(1 - visible / amodal, 6) for name, (amodal, visible) in counts.items() if amodal
                },
            )
        )
    return found


def _thin(polygon: FloatArray, most: int = 24) -> FloatArray:
    """At most ``most`` of the vertices: a circle need not take a page of JSON."""
    return polygon[:: -(-len(polygon) // most)]
