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
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull

from occlib.base import checks
from occlib.base.arrays import FloatArray
from occlib.base.files import read_yaml
from occlib.formats.decoding import convert
from occlib.formats.scene import RGB, BoardEntry, FloorBoardEntry, ObjectEntry, PartEntry, RoomFile, SceneFile
from occlib.geometry import Camera, Floor, Rig, look_at
from occlib.lab.shapes import SHAPES, Part, Swing, hit_distance, rotation_xyz, unit_mesh
from occlib.lens import Lens
from occlib.recordings import find_folder, lab_recordings

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
        """4x4 per part, unit shape to world. With swinging parts it stands on the lowest of them."""
        x, y, heading = self.pose(frame)
        world = np.eye(4)
        world[:3, :3] = rotation_xyz((0.0, 0.0, heading))
        world[:2, 3] = x, y
        matrices = [part.matrix_at(frame) for part in self.parts]
        if limbs := [(p, m) for p, m in zip(self.parts, matrices, strict=True) if p.swing is not None]:
            world[2, 3] = -min(float((unit_mesh(p.shape)[0] @ m[2, :3] + m[2, 3]).min()) for p, m in limbs)
        return [world @ matrix for matrix in matrices]

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
    """A recording to be: the room, its cameras, the objects and how long to film.

    ``lamps`` and ``exposure`` have factors, one a frame, on the light of some lamps and on the exposure of some cameras.
    ``files`` are written beside the pictures: the room and the scene themselves, where they come from no file.
    """

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
    lamps: Mapping[str, tuple[float, ...]] = field(default_factory=dict, repr=False)
    exposure: Mapping[str, tuple[float, ...]] = field(default_factory=dict, repr=False)
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    @cached_property
    def rays(self) -> dict[str, FloatArray]:
        """Directions (H, W, 3) through the pixel centres of each camera, in the world."""
        return {name: camera.rays() for name, camera in self.rig.cameras.items()}

    @cached_property
    def furniture_depths(self) -> dict[str, FloatArray]:
        """Distances (H, W) to the furniture, along the :attr:`rays` of each camera; inf where there is none."""
        found = {}
        for name, camera in self.rig.cameras.items():
            found[name] = np.full(camera.size[::-1], np.inf)
            for part in self.furniture:
                depth, window = self.depths(name, [part.shape], [part.matrix])
                found[name][window] = np.minimum(found[name][window], depth)
        return found

    def with_objects(self, objects: Sequence[SceneObject]) -> Scene:
        """The same with other objects; rays and distances to the furniture are not computed again."""
        scene = replace(self, objects=tuple(objects))
        scene.__dict__.update(rays=self.rays, furniture_depths=self.furniture_depths)
        return scene

    def depths(
        self, name: str, shapes: Sequence[str], matrices: Sequence[FloatArray]
    ) -> tuple[FloatArray, tuple[slice, slice]]:
        """Distances along a camera's :attr:`rays` to the nearest of some shapes, and the window of the picture that they cover."""
        camera = self.rig[name]
        width, height = camera.size
        corners = np.vstack([unit_mesh("box")[0] @ m[:3, :3].T + m[:3, 3] for m in matrices])
        pixels = camera.project(corners)
        if np.isnan(pixels).any():
            low, high = np.zeros(2), np.array([width, height], float)
        else:  # straight edges bulge between their ends under lens distortion: leave room
            spare = 4 + 0.1 * (pixels.max(0) - pixels.min(0))
            low, high = np.floor(pixels.min(0) - spare), np.ceil(pixels.max(0) + spare)
        (c0, r0), (c1, r1) = (np.clip(end, 0, [width, height]).astype(int) for end in (low, high))
        window = (slice(r0, r1), slice(c0, c1))
        view = self.rays[name][window].reshape(-1, 3)
        depth = np.full(len(view), np.inf)
        for shape, matrix in zip(shapes, matrices, strict=True):
            depth = np.minimum(depth, hit_distance(shape, matrix, camera.centre_m, view))
        return depth.reshape(r1 - r0, c1 - c0), window


def load_scene(source: str | Path) -> Scene:
    """Read a scene from ``scene.yaml``, its folder, or the name of a rendered recording such as ``"robot"``.

    Raises ``ValueError`` with the file and the field that is wrong.
    """
    path = Path(source)
    if not path.exists() and (found := find_folder(source)) is not None and (found / "scene.yaml").exists():
        path = found
    if not path.exists() and len(path.parts) == 1:
        raise ValueError(f"{source}: no such scene ({lab_recordings()})")
    path = path / "scene.yaml" if path.is_dir() else path
    content = _read(path, SceneFile, "scene")
    room_path = path.parent / content.room
    changes = {name: getattr(content, name) for name in ("vinyl", "wood", "window")}
    room = _read(room_path, RoomFile, room_path.name, changes=changes)
    try:
        return build_scene(room, content, path.resolve().parent)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def build_scene(room: RoomFile, content: SceneFile, folder: Path, files: Mapping[str, bytes] | None = None) -> Scene:
    """The scene that a room and the content of a ``scene.yaml`` describe; ``ValueError`` if the two do not fit."""
    for field_name, wanted, known in (
        ("lamps", content.lamps, room.lamps),
        ("exposure", content.exposure, content.cameras),
    ):
        if unknown := [name for name in wanted if name not in known]:
            raise ValueError(f"{field_name}: {unknown[0]!r} is not in the room; it has {', '.join(known) or 'none'}")
    rig = _rig(room, content.cameras)
    return Scene(
        name=folder.name,
        folder=folder,
        room=room,
        rig=rig,
        frames=content.frames,
        background=content.background,
        seed=content.seed,
        fps=content.fps,
        objects=tuple(object_of(entry, i) for i, entry in enumerate(content.objects)),
        boards=tuple(_board(board, rig) for board in content.boards),
        floor_board=content.floor_board,
        marks=tuple(content.marks),
        furniture=tuple(_part(part, f"furniture[{i}]", GREY) for i, part in enumerate(room.furniture)),
        lamps=content.lamps,
        exposure=content.exposure,
        files=files or {},
    )


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
    moving = entry.swing
    swing = None if moving is None else Swing(moving.pivot, moving.degrees, moving.period, moving.phase)
    return Part(entry.shape, entry.centre, entry.size, entry.colour or colour, entry.turn, swing)


def object_of(entry: ObjectEntry, index: int = 0) -> SceneObject:
    """The object that an entry of ``scene.yaml`` describes; errors name it by its index."""
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


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """The same view with fewer (or more) pixels."""
    if scale == 1:
        return camera
    checks.number("scale", scale, least=0.02, most=4, unit="a factor")
    size = (max(8, round(camera.size[0] * scale)), max(8, round(camera.size[1] * scale)))
    matrix = camera.matrix.copy()
    for axis in (0, 1):
        matrix[axis] *= size[axis] / camera.size[axis]
        matrix[axis, 2] += (size[axis] / camera.size[axis] - 1) / 2  # pixel centres are at integers
    rotation, translation = camera.pose
    return Camera.from_pose(camera.name, size, replace(camera.lens, matrix=matrix), rotation, translation)


def floor_marks(scene: Scene) -> dict[str, Any]:
    """Where the board and the marks on the floor are: metres, and the pixels of each camera, to 0.1 px."""
    marks: dict[str, Any] = {name: [] for name in scene.rig.cameras}
    for name, camera in scene.rig.cameras.items():
        for mark, pixel in zip(scene.marks, camera.floor_to_pixels(scene.marks), strict=True):
            if camera.inside([pixel])[0]:
                marks[name].append({"pixel": np.round(pixel, 1).tolist(), "floor": list(mark)})
    content: dict[str, Any] = {"units": {"pixel": "raw image px", "floor": "m"}}
    if scene.floor_board is not None:
        content["board"] = {"pattern": list(BOARD_PATTERN), **msgspec.to_builtins(scene.floor_board)}
    return {**content, "marks": marks}
