"""Furniture and objects put into a random room, apart from one another and where enough cameras see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from occlib.base.arrays import FloatArray
from occlib.formats.scene import ObjectEntry, PartEntry, RoomFile, RoomFloor, WaypointEntry
from occlib.lab.furnishing import FURNITURE, OBJECTS, Colour, any_colour, near, rounded
from occlib.lab.scenes import Scene, SceneObject, Waypoint, object_of
from occlib.lab.shapes import unit_mesh
from occlib.lab.truth import silhouettes

SEEN = 1 / 3
"""Share of an object that a camera must see to count as one that sees it."""

TOGETHER = 0.6
"""Share of the frames in which the first two cameras must both see an object."""

GAP_M = 0.06
"""At least so far apart are objects from one another, from furniture and from the border of the mapped floor, in m."""

NEAR_FLOOR = 0.25
"""Share of the objects and of the furniture whose colour is close to the floor's."""

ORIGIN = (Waypoint(0, (0.0, 0.0), 0.0),)

BEHIND = 0.65
"""Share of the objects whose place is looked for behind what is there already, seen from one of the first two cameras."""

Outlines = list[FloatArray]
"""A convex polygon (N, 2) in m for each frame."""


@dataclass(frozen=True)
class Taken:
    """The place of an object or of furniture at each frame, and its height in m."""

    outlines: Outlines
    height: float

    def clear_of(self, outlines: Outlines) -> bool:
        """Whether other outlines keep :data:`GAP_M` away at each frame."""
        return all(gap_m(a, b) >= GAP_M for a, b in zip(self.outlines, outlines, strict=True))


def place_furniture(
    rng: np.random.Generator, room: RoomFile, taken: Sequence[Taken], frames: int
) -> tuple[list[PartEntry], Taken] | None:
    """Parts and place of a piece of furniture at the border of the mapped floor, its back outwards, or anywhere on it.

    ``None`` if no place is free of what is ``taken``.
    """
    kind, colour = str(rng.choice(list(FURNITURE))), _colour(rng, room)
    parts = FURNITURE[kind](rng, colour)
    (x0, x1), (y0, y1) = room.floor.x, room.floor.y
    for _ in range(30):
        side, along, inwards = int(rng.integers(4)), float(rng.uniform(0.08, 0.92)), float(rng.uniform(0.0, 0.35))
        x, y = x0 + along * (x1 - x0), y0 + along * (y1 - y0)
        at = [(x0 + inwards, y), (x1 - inwards, y), (x, y0 + inwards), (x, y1 - inwards)][side]
        if rng.random() < 0.3:
            at = tuple(rng.uniform([x0 + 0.4, y0 + 0.4], [x1 - 0.4, y1 - 0.4]))
        turn = (0.0, 180.0, 90.0, 270.0)[side] + float(rng.normal(0, 4))
        moved = [_moved(part, at, turn) for part in parts]
        body = _body(moved, colour, ORIGIN)
        place = Taken([body.footprint(0)] * frames, body.height)
        walls = RoomFloor(room.walls.x, room.walls.y, 1)
        if _inside(place.outlines[:1], walls, 0.03) and all(other.clear_of(place.outlines) for other in taken):
            return moved, place
    return None


def place_object(
    rng: np.random.Generator, room: RoomFile, taken: Sequence[Taken], labels: Sequence[str], frames: int, fps: float
) -> tuple[ObjectEntry, Taken] | None:
    """An object on its path over the mapped floor, and its place; ``None`` if no path keeps clear of what is ``taken``.

    No kind comes more than twice: ``labels`` are those of the objects so far. The first is one of those that mostly move.
    """
    kinds = {n: kind for n, kind in OBJECTS.items() if labels.count(n) < 2 and (labels or kind.moving > 0.7)}
    often = np.array([kind.often for kind in kinds.values()])
    label = str(rng.choice(list(kinds), p=often / often.sum()))
    kind = kinds[label]
    colour = kind.colour or _colour(rng, room)
    speed = float(rng.uniform(*kind.speed)) if not labels or rng.random() < kind.moving else 0.0
    parts = _centred(kind.parts(rng, colour), colour)
    swings = any(part.swing is not None for part in parts)
    if swings and speed:
        parts = [_striding(part, speed) for part in parts]
    body = _body(parts, colour, ORIGIN)
    own = [body.footprint(frame) for frame in (range(frames) if swings else [0])] * (1 if swings else frames)
    radius = float(np.linalg.norm(own[0], axis=1).max())
    for _ in range(15):
        middle = _behind(rng, room, taken, radius, frames // 2) if taken and rng.random() < BEHIND else None
        path = _path(rng, room.floor, speed, frames, fps, middle)
        moving = replace(body, path=tuple(Waypoint(w.frame, w.at, w.heading) for w in path))
        place = Taken([_at(outline, moving.pose(frame)) for frame, outline in enumerate(own)], body.height)
        if _inside(place.outlines, room.floor, GAP_M) and all(other.clear_of(place.outlines) for other in taken):
            return ObjectEntry(
                id=chr(ord("A") + len(labels)), label=label, colour=colour, parts=parts, path=path
            ), place
    return None


def _striding(part: PartEntry, speed: float) -> PartEntry:
    """A limb whose swing fits a speed in m/s: it is drawn for 1.1."""
    if part.swing is None:
        return part
    degrees = round(part.swing.degrees * speed / 1.1, 2)
    return msgspec.structs.replace(part, swing=msgspec.structs.replace(part.swing, degrees=degrees))


def _behind(rng: np.random.Generator, room: RoomFile, taken: Sequence[Taken], radius: float, frame: int) -> FloatArray:
    """A place (2,) in what another object or furniture hides from the first or the second camera, if it is flat."""
    camera = np.array(list(room.cameras.values())[int(rng.integers(2))].position)
    other = taken[int(rng.integers(len(taken)))]
    middle = other.outlines[frame].mean(axis=0)
    way = middle - camera[:2]
    distance = float(np.linalg.norm(way))
    shadow = min(1.5, other.height * distance / max(camera[2] - other.height, 0.3))
    past = float(np.linalg.norm(other.outlines[frame] - middle, axis=1).max()) + radius + GAP_M
    return np.asarray(middle + way / distance * (past + rng.uniform(-0.1, 0.7) * shadow))


def _colour(rng: np.random.Generator, room: RoomFile) -> Colour:
    if rng.random() < NEAR_FLOOR:
        return near(room.coat.colour, rng)
    return any_colour(rng)


def _body(parts: Sequence[PartEntry], colour: Colour, path: tuple[Waypoint, ...]) -> SceneObject:
    entry = ObjectEntry(id="", label="", colour=colour, parts=list(parts), path=[WaypointEntry(frame=0, at=(0, 0))])
    return replace(object_of(entry), path=path)


def _moved(part: PartEntry, at: tuple[float, float], turn: float) -> PartEntry:
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    x, y, z = part.centre
    centre = rounded((at[0] + c * x - s * y, at[1] + s * x + c * y, z))
    return msgspec.structs.replace(part, centre=centre, turn=rounded((*part.turn[:2], part.turn[2] + turn), 2))


def _centred(parts: list[PartEntry], colour: Colour) -> list[PartEntry]:
    """The parts moved so that the middle of their footprint is the origin; a walking person's is the axis of the trunk."""
    if any(part.swing is not None for part in parts):
        return parts
    x, y = centroid_m(_body(parts, colour, ORIGIN).footprint(0))
    return [_moved(part, (-x, -y), 0.0) for part in parts]


def centroid_m(polygon: FloatArray) -> FloatArray:
    """Centre of the area of a polygon (N, 2)."""
    following = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]
    return np.asarray(((polygon + following) * cross[:, None]).sum(axis=0) / (3 * cross.sum()))


def _path(
    rng: np.random.Generator, floor: RoomFloor, speed: float, frames: int, fps: float, middle: FloatArray | None
) -> list[WaypointEntry]:
    """A place to stand, or an arc of up to 70 degrees at a steady speed; around ``middle`` (2,), or anywhere for ``None``."""
    low, high = (np.array([ends[i] for ends in (floor.x, floor.y)]) + (0.2, -0.2)[i] for i in (0, 1))
    middle = rng.uniform(low, high) if middle is None else middle
    heading, turn = float(rng.uniform(-180, 180)), np.radians(rng.uniform(-70, 70))
    if speed == 0:
        return [WaypointEntry(frame=0, at=rounded(middle), heading=round(heading, 1))]
    path = []
    for step in sorted({round(k) for k in np.linspace(0, frames - 1, 5)}):
        done = step / (frames - 1) - 0.5
        angle = np.radians(heading) + turn * done / 2  # of the chord from the middle
        chord = speed * (frames - 1) / fps * done * np.sinc(turn * done / 2 / np.pi)
        at = middle + chord * np.array([np.cos(angle), np.sin(angle)])
        path.append(WaypointEntry(frame=step, at=rounded(at, 4)))
    return path


def _at(outline: FloatArray, pose: tuple[float, float, float]) -> FloatArray:
    x, y, heading = pose
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    return np.asarray(outline @ np.array([[c, s], [-s, c]]) + [x, y])


def _inside(outlines: Outlines, floor: RoomFloor, margin: float) -> bool:
    points = np.vstack(outlines)
    low, high = (np.array([ends[i] for ends in (floor.x, floor.y)]) for i in (0, 1))
    return bool((points >= low + margin).all() and (points <= high - margin).all())


def gap_m(first: FloatArray, second: FloatArray) -> float:
    """How far apart two convex polygons (N, 2) are, in m, at least; below 0 if they overlap.

    The widest strip between them that is square to an edge of one of the two: less than their distance only where corner
    faces corner.
    """
    widest = -np.inf
    for a, b in ((first, second), (second, first)):
        edges = np.roll(a, -1, axis=0) - a
        normals = (
            np.column_stack([edges[:, 1], -edges[:, 0]]) / np.maximum(np.linalg.norm(edges, axis=1), 1e-12)[:, None]
        )
        widest = max(widest, float(((b @ normals.T).min(axis=0) - (a * normals).sum(axis=1)).max()))
    return widest


def hiding(scene: Scene, frames: Sequence[int]) -> float | None:
    """How much of the objects is hidden from the first two cameras, 0 to 1 on average; ``None`` if too little is seen.

    Two cameras or more are to see each object at each of the frames, and the first two at :data:`TOGETHER` of them.
    """
    together, hidden_shares = np.zeros(len(scene.objects)), []
    for frame in frames:
        seen, hidden = visibility(scene, frame)
        if ((seen >= SEEN).sum(axis=0) < 2).any():
            return None
        together += (seen[:2] >= SEEN).all(axis=0)
        hidden_shares.append(hidden[:2].mean())
    return float(np.mean(hidden_shares)) if (together >= TOGETHER * len(frames)).all() else None


def visibility(scene: Scene, frame: int) -> tuple[FloatArray, FloatArray]:
    """Shares (cameras, objects) of each object that a camera sees, and that others and furniture hide.

    The part that lies outside the picture, judged by the corners of its parts, is not seen and not hidden.
    """
    masks = silhouettes(scene, frame)
    seen, hidden = np.zeros((2, len(masks), len(scene.objects)))
    for k, each in enumerate(scene.objects):
        corners = np.vstack([CORNERS @ m[:3, :3].T + m[:3, 3] for m in each.matrices(frame)])
        for i, (name, found) in enumerate(masks.items()):
            amodal, visible = (int(mask.sum()) for mask in found[each.id])
            if amodal:
                hidden[i, k] = 1 - visible / amodal
                seen[i, k] = visible / amodal * scene.rig[name].inside(scene.rig[name].project(corners)).mean()
    return seen, hidden


CORNERS = unit_mesh("box")[0]


def floor_seen(scene: Scene, name: str, step_m: float = 0.25) -> float:
    """Share of the mapped floor that a camera sees: inside its picture and not behind furniture."""
    camera, floor = scene.rig[name], scene.rig.floor
    x, y = (np.linspace(low, high, round((high - low) / step_m) + 1) for low, high in (floor.x, floor.y))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixels = camera.floor_to_pixels(points)
    inside = camera.inside(pixels)
    u, v = np.rint(pixels[inside]).astype(int).T
    depth = scene.furniture_depths[name][v, u] * np.linalg.norm(scene.rays[name][v, u], axis=1)
    way = np.linalg.norm(np.column_stack([points[inside], np.zeros(inside.sum())]) - camera.centre_m, axis=1)
    return float((depth > way - 0.05).sum() / len(points))
