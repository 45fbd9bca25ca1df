"""Random rooms with exact truth: floor, light, cameras, furniture and moving objects, all drawn from one seed.

A room is what ``room.yaml`` and ``scene.yaml`` describe, as for the rooms made by hand: :func:`random_scene` draws
their content. Drawn again and again until the cameras see the floor and everything on it well enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml

from occlib.base import checks
from occlib.formats.scene import ObjectEntry, RoomFile, SceneFile
from occlib.geometry import Rig
from occlib.lab.interiors import empty_room
from occlib.lab.placing import Taken, floor_seen, hiding, place_furniture, place_object
from occlib.lab.scenes import Scene, build_scene, object_of, scaled_camera

FPS = 5.0
"""Frames a second of a random room."""

FLOOR_SEEN = 0.7
"""Share of the mapped floor that each camera must see, furniture in its way included."""


HIDING = 0.7
"""Share of the objects that are to hide others, or to be hidden by them or by furniture, if one of :data:`CHOICES` does."""

CHOICES = 6
"""Candidates for an object that is to hide or be hidden."""


CHANGING = 0.2
"""Share of the rooms in which a lamp is switched or dimmed, or all light becomes brighter or darker, while it is filmed."""

DRIFTING = 0.3
"""Share of the cameras whose exposure drifts over the frames."""


def random_scene(
    seed: int,
    *,
    cameras: int | None = None,
    objects: int | None = None,
    frames: int = 10,
    size: tuple[int, int] = (480, 360),
    background: int = 3,
    quality: int | None = None,
) -> Scene:
    """A random room with furniture, 2 to 6 cameras and 1 to 8 objects; the same for the same arguments.

    Parameters
    ----------
    seed
        A whole number >= 0, from which everything is drawn.
    cameras, objects
        How many, 2 to 6 and 1 to 8; drawn for ``None`` (3 to 5 objects).
    frames
        How many, 2 to 30, at 5 a second.
    size
        Of the pictures ``(width, height)`` in px.
    background
        Pictures of the room without the objects.
    quality
        Of the JPEG files, 1 to 100; drawn for ``None``.

    Raises
    ------
    ValueError
        An argument outside its range, or no such room is found (which no seed is known to do).
    """
    checks.whole("seed", seed, least=0)
    checks.whole("background", background, least=0)
    bounds = {
        "cameras": (cameras, 2, 6),
        "objects": (objects, 1, 8),
        "frames": (frames, 2, 30),
        "quality": (quality, 1, 100),
    }
    for name, (value, least, most) in bounds.items():
        if value is not None:
            checks.whole(name, value, least=least, most=most)
    for pixels in size:
        checks.whole("size", pixels, least=32)
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 6)) if objects is None else objects
    views = int(rng.integers(2, 7)) if cameras is None else cameras
    for _ in range(200):
        room = empty_room(rng, count, views, size)
        if room is not None and quality is not None:
            room = msgspec.structs.replace(room, sensor=msgspec.structs.replace(room.sensor, jpeg_quality=quality))
        if room is not None and (scene := _furnished(rng, room, seed, count, frames, background)) is not None:
            return scene
    raise ValueError(f"seed: no room of {views} cameras and {count} objects found for {seed}")


def scene_files(room: RoomFile, content: SceneFile) -> dict[str, bytes]:
    """``room.yaml`` and ``scene.yaml`` as their bytes: :func:`~occlib.lab.load_scene` reads the same scene from them."""
    written = (("room.yaml", room), ("scene.yaml", content))
    return {
        name: yaml.safe_dump(_plain(c), sort_keys=False, default_flow_style=None, width=150).encode()
        for name, c in written
    }


def _plain(content: Any) -> Any:
    """Structures as mappings, without the fields that are as they are by default."""
    if isinstance(content, msgspec.Struct):
        fields = {f.name: f.default for f in msgspec.structs.fields(content)}
        values = {name: getattr(content, name) for name in fields}
        return {n: _plain(v) for n, v in values.items() if v is not None and v != fields[n] and v not in ([], {}, ())}
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    return [_plain(value) for value in content] if isinstance(content, list | tuple) else content


def _furnished(
    rng: np.random.Generator, room: RoomFile, seed: int, count: int, frames: int, background: int
) -> Scene | None:
    """The room with furniture and objects; ``None`` if they do not fit or are not seen."""
    content = SceneFile(
        room="room.yaml", cameras=list(room.cameras), frames=frames, background=background, seed=seed, fps=FPS
    )
    cameras = build_scene(room, content, Path(".")).rig.cameras
    if not all(np.isfinite(camera.rays()).all() for camera in cameras.values()):
        return None
    taken: list[Taken] = []
    for _ in range(rng.choice([1, 2, 3], p=[0.4, 0.4, 0.2])):
        if (placed := place_furniture(rng, room, taken, frames)) is not None:
            room = msgspec.structs.replace(room, furniture=[*room.furniture, *placed[0]])
            taken.append(placed[1])
    empty = build_scene(room, content, Path("."))
    small = {name: scaled_camera(camera, 100 / camera.size[0]) for name, camera in cameras.items()}
    empty = replace(empty, rig=Rig(empty.rig.floor, small))  # enough to judge what is seen
    if not all(floor_seen(empty, name) >= FLOOR_SEEN for name in cameras):
        return None
    objects: list[ObjectEntry] = []
    while len(objects) < count:
        found = (_next_object(rng, room, empty, objects, taken) for _ in range(12))
        chosen = next(filter(None, found), None)
        if chosen is None:
            return None
        objects.append(chosen[0])
        taken.append(chosen[1])
    content = _with_changes(rng, room, msgspec.structs.replace(content, objects=objects))
    return build_scene(room, content, Path(f"room_{seed}"), scene_files(room, content))


def _next_object(
    rng: np.random.Generator, room: RoomFile, empty: Scene, objects: Sequence[ObjectEntry], taken: Sequence[Taken]
) -> tuple[ObjectEntry, Taken] | None:
    """One more object and its place, of some candidates that which hides or is hidden most; ``None`` if none is seen enough."""
    labels, frames = [str(each.label) for each in objects], empty.frames
    ranked = []
    drawn = [
        place_object(rng, room, taken, labels, frames, FPS) for _ in range(CHOICES if rng.random() < HIDING else 1)
    ]
    for found in filter(None, drawn):
        scene = empty.with_objects([object_of(entry) for entry in (*objects, found[0])])
        if (hidden := hiding(scene, [0, frames // 2, frames - 1])) is not None:
            ranked.append((hidden, scene, found))
    ranked.sort(key=lambda each: -each[0])
    return next((found for _, scene, found in ranked if hiding(scene, range(frames)) is not None), None)


def _with_changes(rng: np.random.Generator, room: RoomFile, content: SceneFile) -> SceneFile:
    """The scene with light and exposures that change over the frames."""
    frames = content.frames
    lamps: dict[str, tuple[float, ...]] = {}
    exposure = {name: np.ones(frames) for name in content.cameras}
    if rng.random() < CHANGING:
        start, factor = int(rng.integers(1, frames)), float(rng.choice([0.0, 0.35, 1.8]))
        if room.lamps and rng.random() < 0.75:
            name = str(rng.choice(list(room.lamps)))
            lamps[name] = tuple(1.0 if frame < start else factor for frame in range(frames))
        else:
            shift = np.linspace(0, np.log(rng.uniform(1.2, 1.7)) * rng.choice([-1, 1]), frames)
            exposure = {name: values * np.exp(shift) for name, values in exposure.items()}
    for name in content.cameras:
        if rng.random() < DRIFTING:
            exposure[name] = exposure[name] * np.exp(np.cumsum(rng.normal(0, 0.025, frames)))
        if rng.random() < 0.06:
            exposure[name] = exposure[name] * rng.uniform(1.15, 1.4)  # white clips
    drifting = {n: tuple(float(v) for v in np.round(f, 4)) for n, f in exposure.items() if (f != 1).any()}
    return msgspec.structs.replace(content, lamps=lamps, exposure=drifting)
