"""Rendered laboratory scenes with exact ground truth.

A scene is two readable YAML files: ``room.yaml`` (room, light, cameras) and ``scene.yaml`` (objects and
their paths). From these alone, with numpy, come the *truth* (positions, footprints, hidden fractions) and
the ideal silhouettes; :mod:`occlib.lab.rendering` makes the pictures with Mitsuba 3. Both cast their rays through the same
:class:`~occlib.geometry.Camera`, lens distortion included, so pictures, truth and ``rig.yaml`` agree.

Every shape is a unit box, ellipsoid or cylinder under an affine map, which makes a ray test one inverse
map and one closed formula.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull

from occlib.base import checks
from occlib.base.arrays import FloatArray
from occlib.base.files import read_yaml
from occlib.geometry import Camera, Floor, Rig, look_at
from occlib.lab.shapes import SHAPES, Part, rotation_xyz, unit_mesh
from occlib.lens import Lens
from occlib.recordings import LAB

BOARD_PATTERN = (9, 6)  # inner corners


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
    colour: tuple[int, int, int]
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
    room: dict[str, Any]
    rig: Rig
    frames: int
    background: int
    seed: int
    fps: float
    objects: tuple[SceneObject, ...]
    boards: tuple[Board, ...] = ()
    floor_board: dict[str, Any] | None = None
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
    path = path / "scene.yaml" if path.is_dir() else path
    content = _mapping(path)
    try:
        _check(
            content,
            "scene",
            {"room", "cameras", "frames"},
            {"background", "seed", "fps", "objects", "boards", "floor_board", "marks", "vinyl"},
        )
        room_path = path.parent / str(content["room"])
        room = _mapping(room_path)
        _check(
            room,
            room_path.name,
            {"units", "floor", "walls", "vinyl", "ceiling_light", "cameras", "sensor"},
            {"furniture"},
        )
        room = {**room, "vinyl": {**room["vinyl"], **content.get("vinyl", {})}}
        rig = _rig(room, content["cameras"])
        scene = Scene(
            name=path.resolve().parent.name,
            folder=path.resolve().parent,
            room=room,
            rig=rig,
            frames=_count(content["frames"], "frames"),
            background=_count(content.get("background", 1), "background"),
            seed=_count(content.get("seed", 0), "seed"),
            fps=float(content.get("fps", 10)),
            objects=tuple(_object(o, i) for i, o in enumerate(content.get("objects", []))),
            boards=tuple(_board(b, i, rig) for i, b in enumerate(content.get("boards", []))),
            floor_board=content.get("floor_board"),
            marks=tuple((float(x), float(y)) for x, y in content.get("marks", [])),
            furniture=tuple(
                _part(p, f"furniture[{i}]", (128, 128, 128)) for i, p in enumerate(room.get("furniture", []))
            ),
        )
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: malformed scene ({type(error).__name__}: {error})") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    names = [o.id for o in scene.objects]
    if len(set(names)) != len(names):
        raise ValueError(f"{path}: objects: ids must differ, got {names}")
    return scene


def _mapping(path: Path) -> dict[str, Any]:
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected a mapping")
    return content


def _check(fields: Any, where: str, required: set[str], optional: set[str]) -> None:
    if not isinstance(fields, dict):
        raise ValueError(f"{where}: expected a mapping, got {str(fields)[:40]}")
    if unknown := sorted(map(str, set(fields) - required - optional)):
        raise ValueError(f"{where}: unknown field {unknown[0]!r}; known are {', '.join(sorted(required | optional))}")
    if missing := sorted(required - set(fields)):
        raise ValueError(f"{where}: field {missing[0]!r} is missing")


def _count(value: Any, name: str) -> int:
    return checks.whole(name, value, least=0)


def _vector(value: Any, length: int, name: str) -> tuple[Any, ...]:
    checks.numbers(name, value, (length,))
    return tuple(value)  # the numbers as they are written: 1 is not 1.0 in files made from them


def _part(fields: Any, where: str, colour: tuple[int, int, int]) -> Part:
    _check(fields, where, {"shape", "centre", "size"}, {"colour", "turn"})
    if fields["shape"] not in SHAPES:
        raise ValueError(f"{where}.shape: expected one of {', '.join(SHAPES)}, got {fields['shape']!r}")
    size = _vector(fields["size"], 3, f"{where}.size")
    if min(size) <= 0:
        raise ValueError(f"{where}.size: expected three lengths > 0, got {list(size)}")
    return Part(
        fields["shape"],
        _vector(fields["centre"], 3, f"{where}.centre"),
        size,
        _vector(fields.get("colour", colour), 3, f"{where}.colour"),
        _vector(fields.get("turn", (0, 0, 0)), 3, f"{where}.turn"),
    )


def _object(fields: Any, index: int) -> SceneObject:
    where = f"objects[{index}]"
    _check(fields, where, {"id", "label", "colour", "parts", "path"}, set())
    colour = _vector(fields["colour"], 3, f"{where}.colour")
    parts = tuple(_part(p, f"{where}.parts[{i}]", colour) for i, p in enumerate(fields["parts"]))
    path = []
    for i, waypoint in enumerate(fields["path"]):
        _check(waypoint, f"{where}.path[{i}]", {"frame", "at"}, {"heading"})
        at = _vector(waypoint["at"], 2, f"{where}.path[{i}].at")
        heading = waypoint.get("heading")
        if heading is not None:
            (heading,) = _vector([heading], 1, f"{where}.path[{i}].heading")
        path.append(Waypoint(_count(waypoint["frame"], f"{where}.path[{i}].frame"), at, heading))
    times = [w.frame for w in path]
    if not parts or not times or sorted(set(times)) != times:
        raise ValueError(f"{where}: expected parts, and a path whose frames increase, got frames {times}")
    return SceneObject(str(fields["id"]), str(fields["label"]), colour, parts, tuple(path))


def _rig(room: dict[str, Any], names: Any) -> Rig:
    floor = Floor(tuple(room["floor"]["x"]), tuple(room["floor"]["y"]), room["floor"]["resolution"])
    if not isinstance(names, list) or not names:
        raise ValueError(f"cameras: expected a list of names, got {names!r}")
    cameras = {}
    for name in names:
        if name not in room["cameras"]:
            raise ValueError(f"cameras: {name!r} is not in the room; it has {', '.join(room['cameras'])}")
        fields = room["cameras"][name]
        _check(
            fields,
            f"cameras.{name}",
            {"position", "look_at", "size", "focal", "principal_point", "distortion", "gain"},
            set(),
        )
        (fx, fy), (cx, cy) = fields["focal"], fields["principal_point"]
        rotation = look_at(fields["position"], fields["look_at"])
        cameras[name] = Camera.from_pose(
            name,
            tuple(fields["size"]),
            Lens(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), fields["distortion"]),
            rotation,
            -rotation @ np.asarray(fields["position"], float),
        )
    return Rig(floor, cameras)


def _board(fields: Any, index: int, rig: Rig) -> Board:
    """A board held before a camera: its centre at a pixel and a distance, turned from facing it squarely."""
    where = f"boards[{index}]"
    _check(fields, where, {"camera", "square", "pixel", "distance", "turn"}, set())
    camera = rig[str(fields["camera"])]
    (direction,) = camera.lens.directions([fields["pixel"]])
    rotation, translation = camera.pose
    pose = np.eye(4)
    # The board's y axis points up in the picture, its z axis towards the camera: half a turn about x.
    pose[:3, :3] = rotation.T @ rotation_xyz((180, 0, 0)) @ rotation_xyz(_vector(fields["turn"], 3, f"{where}.turn"))
    pose[:3, 3] = rotation.T @ (direction / np.linalg.norm(direction) * float(fields["distance"]) - translation)
    return Board(camera.name, float(fields["square"]), pose)


def floor_board(scene: Scene) -> Board | None:
    """The board that lies on the floor, if the scene has one.

    ``origin`` is the floor position of the first inner corner. The rows of nine start on the side with two
    black corner squares and run along ``angle_deg``; the next row lies to the left, seen from above.
    """
    if scene.floor_board is None:
        return None
    columns, rows = BOARD_PATTERN
    square, pose = float(scene.floor_board["square"]), np.eye(4)
    pose[:3, :3] = rotation_xyz((0.0, 0.0, float(scene.floor_board["angle_deg"])))
    pose[:2, 3] = scene.floor_board["origin"]
    pose[:3, 3] += pose[:3, :2] @ np.array([columns - 1, rows - 1]) * square / 2
    return Board(None, square, pose)
