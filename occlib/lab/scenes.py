"""Rendered laboratory scenes with exact ground truth.

A scene is two readable YAML files: ``room.yaml`` (room, light, cameras) and ``scene.yaml`` (objects and their paths).
From these alone, with numpy, come the *truth* (positions, footprints, hidden fractions) and the ideal silhouettes;
:mod:`occlib.lab.rendering` makes the pictures with Mitsuba 3. Both cast their rays through the same
:class:`~occlib.geometry.Camera`, lens distortion included, so pictures, truth and ``rig.yaml`` agree.

Every shape is a unit box, ellipsoid or cylinder under an affine map, which makes a ray test one inverse
map and one closed formula.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull

from occlib.base.arrays import FloatArray
from occlib.base.files import read_yaml
from occlib.formats.decoding import convert
from occlib.formats.scene import RGB, BoardEntry, FloorBoardEntry, ObjectEntry, PartEntry, RoomFile, SceneFile
from occlib.geometry import Camera, Floor, Rig, look_at
from occlib.lab.shapes import SHAPES, Part, rotation_xyz, unit_mesh
from occlib.lens import Lens
from occlib.recordings import LAB, lab_recordings

T = TypeVar("T")

BOARD_PATTERN = (9, 6)  # inner corners
GREY = (128, 128, 128)  # of furniture without a colour


@dataclass(frozen=True)
class Waypoint:
    """Where an object is at a frame (m); ``heading`` in degrees, ``None`` to look along the path."""

    frame: int
    at: tuple[float, float]
    heading: float | None = None


@dataclass(frozen=True)
class SceneObject:
    """Parts that move together along a smooth path."""

    id: str
    label: str
    colour: tuple[float, float, float]
    parts: tuple[Part, ...]
    path: tuple[Waypoint, ...]

    def pose(self, frame: float) -> tuple[float, float, float]:
        """``(x, y, heading)`` in m and degrees; it rests before its first and after its last waypoint."""
        times = [w.frame for w in self.path]
        at = np.array([w.at for w in self.path], dtype=float)
        t = float(np.clip(frame, times[0], times[-1]))
        headings = [w.heading for w in self.path]
        if len(times) == 1:
            return float(at[0, 0]), float(at[0, 1]), float(headings[0] or 0.0)
        spline = CubicSpline(times, at, bc_type="natural")
        x, y = spline(t)
        if any(h is None for h in headings):
            vx, vy = spline(t, 1)
            return float(x), float(y), float(np.degrees(np.arctan2(vy, vx)))
        return float(x), float(y), float(CubicSpline(times, np.array(headings, float), bc_type="natural")(t))

    def matrices(self, frame: float) -> list[FloatArray]:
        """4x4 per part, unit shape to world."""
        x, y, heading = self.pose(frame)
        world = np.eye(4)
        world[:3, :3] = rotation_xyz((0.0, 0.0, heading))
        world[:2, 3] = x, y
        return [world @ part.matrix for part in self.parts]

    def vertices_m(self, frame: float) -> FloatArray:
        """Vertices of all its parts in the world, (N, 3) in m."""
        parts = zip(self.parts, self.matrices(frame), strict=True)
        return np.vstack([unit_mesh(part.shape)[0] @ m[:3, :3].T + m[:3, 3] for part, m in parts])

    def footprint(self, frame: float) -> FloatArray:
        """Vertical projection: convex polygon (N, 2) in m, anticlockwise."""
        points = self.vertices_m(frame)[:, :2]
        return np.asarray(points[ConvexHull(points).vertices])

    @property
    def height(self) -> float:
        """Highest point in m."""
        return float(self.vertices_m(0)[:, 2].max())


@dataclass(frozen=True)
class Board:
    """A checkerboard of 9x6 inner corners; ``pose`` maps its plane (x right, y up, m, centred) to the world."""

    camera: str | None
    square: float
    pose: FloatArray

    def corners_m(self) -> FloatArray:
        """World positions of the inner corners, shape (54, 3), row by row."""
        columns, rows = BOARD_PATTERN
        i, j = np.meshgrid(np.arange(columns), np.arange(rows))
        grid = np.column_stack([i.ravel() - (columns - 1) / 2, j.ravel() - (rows - 1) / 2]) * self.square
        return grid @ self.pose[:3, :2].T + self.pose[:3, 3]


@dataclass(frozen=True)
class Scene:
    """A recording to be: the room, its cameras, the objects and how long to film."""

    name: str
    folder: Path
    room: RoomFile | None
    rig: Rig
    frames: int
    background: int
    seed: int
    fps: float
    objects: tuple[SceneObject, ...]
    boards: tuple[Board, ...] = ()
    floor_board: FloorBoardEntry | None = None
    marks: tuple[tuple[float, float], ...] = ()
    furniture: tuple[Part, ...] = field(default=(), repr=False)

    @cached_property
    def rays(self) -> dict[str, FloatArray]:
        """Directions (H, W, 3) through the pixel centres of each camera, in the world."""
        return {name: camera.rays() for name, camera in self.rig.cameras.items()}


def load_scene(source: str | Path) -> Scene:
    """Read a scene from ``scene.yaml``, its folder, or the name of a lab recording such as ``"robot"``.

    Raises ``ValueError`` with the file and the field that is wrong.
    """
    path = Path(source)
    if not path.exists() and (LAB / str(source) / "scene.yaml").exists():
        path = LAB / str(source)
    if not path.exists() and len(path.parts) == 1:
        raise ValueError(f"{source}: no such scene ({lab_recordings()})")
    path = path / "scene.yaml" if path.is_dir() else path
    content = _read(path, SceneFile, "scene")
    room_path = path.parent / content.room
    changes = {name: getattr(content, name) for name in ("vinyl", "wood", "window")}
    room = _read(room_path, RoomFile, room_path.name, changes=changes)
    try:
        rig = _rig(room, content.cameras)
        return Scene(
            name=path.resolve().parent.name,
            folder=path.resolve().parent,
            room=room,
            rig=rig,
            frames=content.frames,
            background=content.background,
            seed=content.seed,
            fps=content.fps,
            objects=tuple(_object(entry, i) for i, entry in enumerate(content.objects)),
            boards=tuple(_board(board, rig) for board in content.boards),
            floor_board=content.floor_board,
            marks=tuple(content.marks),
            furniture=tuple(_part(part, f"furniture[{i}]", GREY) for i, part in enumerate(room.furniture)),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _read(path: Path, kind: type[T], name: str, *, changes: Mapping[str, Mapping[str, Any]] | None = None) -> T:
    """A YAML file as a structure; ``changes`` replace fields of its mappings of those names, or bring such a mapping."""
    content = read_yaml(path)
    for key, fields in (changes or {}).items():
        if fields and isinstance(content, Mapping) and isinstance(content.get(key) or {}, Mapping):
            content = {**content, key: {**(content.get(key) or {}), **fields}}
    try:
        return convert(content, kind, name, inside="", strict=False)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _part(entry: PartEntry, where: str, colour: RGB) -> Part:
    if entry.shape not in SHAPES:
        raise ValueError(f"{where}.shape: expected one of {', '.join(SHAPES)}, got {entry.shape!r}")
    return Part(entry.shape, entry.centre, entry.size, entry.colour or colour, entry.turn)


def _object(entry: ObjectEntry, index: int) -> SceneObject:
    parts = tuple(_part(part, f"objects[{index}].parts[{i}]", entry.colour) for i, part in enumerate(entry.parts))
    path = tuple(Waypoint(waypoint.frame, waypoint.at, waypoint.heading) for waypoint in entry.path)
    return SceneObject(str(entry.id), str(entry.label), entry.colour, parts, path)


def _rig(room: RoomFile, names: Sequence[str]) -> Rig:
    cameras = {}
    for name in names:
        if name not in room.cameras:
            raise ValueError(f"cameras: {name!r} is not in the room; it has {', '.join(room.cameras)}")
        camera = room.cameras[name]
        (fx, fy), (cx, cy) = camera.focal, camera.principal_point
        rotation = look_at(camera.position, camera.look_at)
        cameras[name] = Camera.from_pose(
            name,
            camera.size,
            Lens(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(camera.distortion, np.float64)),
            rotation,
            -rotation @ np.asarray(camera.position, float),
        )
    return Rig(Floor(room.floor.x, room.floor.y, room.floor.resolution), cameras)


def _board(entry: BoardEntry, rig: Rig) -> Board:
    """A board held before a camera: its centre at a pixel and a distance, turned from facing it squarely."""
    camera = rig[str(entry.camera)]
    (direction,) = camera.lens.directions([entry.pixel])
    rotation, translation = camera.pose
    pose = np.eye(4)
    # The board's y axis points up in the picture, its z axis towards the camera: half a turn about x.
    pose[:3, :3] = rotation.T @ rotation_xyz((180, 0, 0)) @ rotation_xyz(entry.turn)
    pose[:3, 3] = rotation.T @ (direction / np.linalg.norm(direction) * entry.distance - translation)
    return Board(camera.name, entry.square, pose)


def floor_board(scene: Scene) -> Board | None:
    """The board that lies on the floor, if the scene has one.

    ``origin`` is the floor position of the first inner corner. The rows of nine start on the side with two
    black corner squares and run along ``angle_deg``; the next row lies to the left, seen from above.
    """
    if scene.floor_board is None:
        return None
    columns, rows = BOARD_PATTERN
    square, pose = float(scene.floor_board.square), np.eye(4)
    pose[:3, :3] = rotation_xyz((0.0, 0.0, float(scene.floor_board.angle_deg)))
    pose[:2, 3] = scene.floor_board.origin
    pose[:3, 3] += pose[:3, :2] @ np.array([columns - 1, rows - 1]) * square / 2
    return Board(None, square, pose)
