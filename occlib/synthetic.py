"""Rendered laboratory scenes with exact ground truth.

A scene is two readable YAML files: ``room.yaml`` (room, light, cameras) and ``scene.yaml`` (objects and
their paths). From these alone, with numpy, come the *truth* (positions, footprints, hidden fractions) and
the ideal silhouettes; Mitsuba 3 is needed only to make the pictures. Both cast their rays through the same
:class:`~occlib.geometry.Camera`, lens distortion included, so pictures, truth and ``rig.yaml`` agree.

Every shape is a unit box, ellipsoid or cylinder under an affine map, which makes a ray test one inverse
map and one closed formula.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull

from occlib.geometry import Camera, FloatArray, Floor, Image, Mask, Rig

SHAPES = ("box", "ellipsoid", "cylinder")
LAB = Path(__file__).resolve().parents[1] / "data" / "lab"
BOARD_PATTERN = (9, 6)  # inner corners
INSTALL_HINT = "rendering needs Mitsuba 3 with LLVM and OIDN: pip install occlib[render]"


@dataclass(frozen=True)
class Part:
    """A unit shape under an affine map: ``size`` are full extents in m, ``turn`` degrees about x, y, z."""

    shape: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    colour: tuple[int, int, int]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def matrix(self) -> FloatArray:
        """4x4, unit shape to the frame of the object."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_xyz(self.turn) @ np.diag(self.size)
        matrix[:3, 3] = self.centre
        return matrix


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

    def footprint(self, frame: float) -> FloatArray:
        """Vertical projection: convex polygon (N, 2) in m, anticlockwise."""
        corners = [
            unit_mesh(p.shape)[0] @ m[:3, :3].T + m[:3, 3]
            for p, m in zip(self.parts, self.matrices(frame), strict=True)
        ]
        points = np.vstack(corners)[:, :2]
        return np.asarray(points[ConvexHull(points).vertices])

    @property
    def height(self) -> float:
        """Highest point in m."""
        return max(
            float((unit_mesh(p.shape)[0] @ m[:3, :3].T + m[:3, 3])[:, 2].max())
            for p, m in zip(self.parts, self.matrices(0), strict=True)
        )


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
        return {name: pixel_rays(camera) for name, camera in self.rig.cameras.items()}


# --- reading -----------------------------------------------------------------------------------------


def load_scene(source: str | Path) -> Scene:
    """Read a scene from ``scene.yaml``, its folder, or the name of a lab recording such as ``"robot"``.

    Raises ``ValueError`` with the file and the field that is wrong.
    """
    path = Path(source)
    if not path.exists() and (LAB / str(source) / "scene.yaml").exists():
        path = LAB / str(source)
    path = path / "scene.yaml" if path.is_dir() else path
    content = _read_yaml(path)
    try:
        _check(
            content,
            "scene",
            {"room", "cameras", "frames"},
            {"background", "seed", "fps", "objects", "boards", "floor_board", "marks", "vinyl"},
        )
        room_path = path.parent / str(content["room"])
        room = _read_yaml(room_path)
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


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot read the scene ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not valid YAML ({str(error).splitlines()[0]})") from None
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
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{name}: expected a whole number >= 0, got {value!r}")
    return value


def _vector(value: Any, length: int, name: str) -> tuple[Any, ...]:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != (length,) or not np.isfinite(array).all():
        raise ValueError(f"{name}: expected {length} finite numbers, got {str(value)[:60]}")
    return tuple(value)


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
            [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
            fields["distortion"],
            rotation,
            -rotation @ np.asarray(fields["position"], float),
        )
    return Rig(floor, cameras)


def _board(fields: Any, index: int, rig: Rig) -> Board:
    """A board held before a camera: its centre at a pixel and a distance, turned from facing it squarely."""
    where = f"boards[{index}]"
    _check(fields, where, {"camera", "square", "pixel", "distance", "turn"}, set())
    camera = rig[str(fields["camera"])]
    ray = (camera.undistort_points([fields["pixel"]]) - camera.matrix[:2, 2]) / camera.matrix[[0, 1], [0, 1]]
    direction = np.array([*ray[0], 1.0])
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


# --- geometry ----------------------------------------------------------------------------------------


def rotation_xyz(degrees: Iterable[float]) -> FloatArray:
    """Rotation about x, then y, then z, 3x3."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(list(degrees))), np.sin(np.radians(list(degrees)))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def look_at(position: Iterable[float], target: Iterable[float]) -> FloatArray:
    """World-to-camera rotation of a level camera (x right, y down, z forwards)."""
    forward = np.subtract(list(target), list(position))
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(forward, right), forward])


def pixel_rays(camera: Camera, offset: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """World directions (H, W, 3) through every pixel's centre plus ``offset`` px; not normalised."""
    width, height = camera.size
    v, u = np.mgrid[:height, :width]
    points = np.column_stack([u.ravel() + offset[0], v.ravel() + offset[1]])
    ideal = (camera.undistort_points(points) - camera.matrix[:2, 2]) / camera.matrix[[0, 1], [0, 1]]
    world = np.column_stack([ideal, np.ones(len(ideal))]) @ camera.pose[0]
    return np.asarray(world.reshape(height, width, 3))


def unit_mesh(shape: str) -> tuple[FloatArray, FloatArray]:
    """Vertices (N, 3) and triangles (M, 3) of a unit shape, extents -0.5 to 0.5."""
    if shape == "box":
        vertices = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    around = 96
    angle = np.arange(around) * 2 * np.pi / around
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) / 2
    if shape == "cylinder":
        rings = [(1.0, -0.5), (1.0, 0.5)]
    else:
        tilt = np.linspace(-np.pi / 2, np.pi / 2, 49)[1:-1]
        rings = [(np.cos(t), np.sin(t) / 2) for t in tilt]
    vertices = np.vstack(
        [[[0, 0, -0.5]], *(np.column_stack([circle * r, np.full(around, z)]) for r, z in rings), [[0, 0, 0.5]]]
    )
    k, following = np.arange(around), (np.arange(around) + 1) % around
    faces = [np.column_stack([np.zeros(around, int), 1 + following, 1 + k])]
    for ring in range(len(rings) - 1):
        low, high = 1 + ring * around, 1 + (ring + 1) * around
        faces += [
            np.column_stack([low + k, low + following, high + following]),
            np.column_stack([low + k, high + following, high + k]),
        ]
    top = 1 + (len(rings) - 1) * around
    faces.append(np.column_stack([top + k, top + following, np.full(around, len(vertices) - 1)]))
    return vertices, np.vstack(faces)


def hit_distance(shape: str, matrix: FloatArray, origin: FloatArray, directions: FloatArray) -> FloatArray:
    """Distance along each ray (N, 3), in units of its direction, to a unit shape under ``matrix``; inf if missed.

    The camera is taken to be outside the shape.
    """
    inverse = np.linalg.inv(matrix)
    o = inverse[:3, :3] @ origin + inverse[:3, 3]
    d = directions @ inverse[:3, :3].T
    axes = {"box": 3, "cylinder": 1, "ellipsoid": 0}[shape]  # slabs, counted from z
    near, far = np.full(len(d), -np.inf), np.full(len(d), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in range(3 - axes, 3):
            a, b = (-0.5 - o[axis]) / d[:, axis], (0.5 - o[axis]) / d[:, axis]
            near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
        if axes < 3:  # |o + t d|^2 = 1/4 over the round axes
            n = 3 - axes
            a, b, c = (d[:, :n] ** 2).sum(1), d[:, :n] @ o[:n], o[:n] @ o[:n] - 0.25
            root = np.sqrt(b * b - a * c)  # NaN where the ray misses
            near, far = np.maximum(near, (-b - root) / a), np.minimum(far, (-b + root) / a)
        return np.where((near <= far) & (far > 0), near, np.inf)


def _depth(scene: Scene, camera: Camera, thing: SceneObject, frame: float) -> tuple[FloatArray, tuple[slice, slice]]:
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
        depths = {thing.id: _depth(scene, camera, thing, frame) for thing in scene.objects}
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


# --- pictures ----------------------------------------------------------------------------------------


def load_mitsuba() -> Any:
    """Import Mitsuba in its vectorised variant; ``ValueError`` with the remedy if that cannot work."""
    try:
        # karellen-llvm-core needs its C++ runtime in the process before LLVM itself is opened.
        llvm = Path(os.environ.get("DRJIT_LIBLLVM_PATH", Path(sys.prefix) / "lib" / "libLLVM.so"))
        if llvm.exists():
            os.environ["DRJIT_LIBLLVM_PATH"] = str(llvm)
            for library in ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1"):
                if (found := llvm.parent / "x86_64-unknown-linux-gnu" / library).exists():
                    # Not RTLD_GLOBAL: libc++abi would take over the C++ exceptions of every other library.
                    ctypes.CDLL(str(found), mode=ctypes.RTLD_LOCAL)
        import drjit
        import mitsuba
        import pyoidn  # noqa: F401

        mitsuba.set_variant("llvm_ad_rgb")
        version = int(drjit.detail.llvm_version()[0])
        if not 19 <= version <= 22:  # older and newer ones abort the whole process on a real scene
            raise ImportError(f"LLVM {version} cannot compile Mitsuba's kernels, 19 to 22 can: karellen-llvm-core<23")
    except (ImportError, OSError) as error:
        raise ValueError(f"{INSTALL_HINT} ({error})") from None
    return mitsuba


def to_linear(colour: Iterable[float]) -> list[float]:
    """sRGB 0-255 to linear 0-1.

    >>> to_linear([0, 255])
    [0.0, 1.0]
    """
    c = np.asarray(list(colour), float) / 255
    return [float(v) for v in np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)]


def to_srgb(linear: FloatArray) -> FloatArray:
    """Linear 0-1 to sRGB grey levels 0-255, clipped."""
    c = np.clip(linear, 0, 1)
    return np.asarray(255 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055))


def vinyl_texture(colour: Iterable[float], cells: int = 700) -> FloatArray:
    """A tile of floor, linear RGB (cells, cells, 3): faint mottling, a seam around the edge."""
    rng = np.random.default_rng(2009)
    mottle = np.zeros((cells, cells))
    for n, sigma in ((7, 0.008), (40, 0.012), (175, 0.02)):
        mottle += cv2.resize(rng.normal(0, sigma, (n, n)), (cells, cells), interpolation=cv2.INTER_CUBIC)
    tile = np.array(to_linear(colour)) * (1 + mottle[..., None])
    tile[[0, 1, -2, -1]] *= 0.72
    tile[:, [0, 1, -2, -1]] *= 0.72
    return np.asarray(tile)


def denoise(layers: npt.NDArray[np.float32]) -> FloatArray:
    """Linear RGB (H, W, 3) from noisy colour, albedo and normal (H, W, 9), by Open Image Denoise."""
    import pyoidn

    colour, albedo, normal = (np.ascontiguousarray(layers[..., k : k + 3]) for k in (0, 3, 6))
    return np.asarray(pyoidn.denoise(colour, albedo=albedo, normal=normal, hdr=True), dtype=np.float64)


class Studio:
    """The scene as Mitsuba sees it; objects move without rebuilding it."""

    def __init__(self, scene: Scene, *, spp: int) -> None:
        self.mi, self.scene, self.spp, self.cameras = load_mitsuba(), scene, spp, scene.rig.cameras
        self.integrator = self.mi.load_dict({"type": "path", "max_depth": 5, "rr_depth": 100})
        self.world = self.mi.load_dict(self._description(), optimize=False)
        self.parameters = self.mi.traverse(self.world)
        self._rays: dict[str, Any] = {}
        self._empty: dict[str, Any] = {}
        self._floor: dict[str, Any] = {}

    def _description(self) -> dict[str, Any]:
        mi, room = self.mi, self.scene.room
        (x0, x1), (y0, y1), height = room["walls"]["x"], room["walls"]["y"], room["walls"]["height"]
        light, vinyl, to = room["ceiling_light"], room["vinyl"], mi.ScalarTransform4f
        middle, half = [(x0 + x1) / 2, (y0 + y1) / 2], [(x1 - x0) / 2, (y1 - y0) / 2]
        tiles = to().scale([2 * half[0] / vinyl["tile"], 2 * half[1] / vinyl["tile"], 1])
        texture = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(vinyl_texture(vinyl["colour"]).astype(np.float32)),
            "raw": True,
            "to_uv": tiles,
        }
        wall = self._matte(room["walls"]["colour"])
        walls = Part("box", (*middle, height / 2), (2 * half[0], 2 * half[1], height), (0, 0, 0))
        world: dict[str, Any] = {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": to().translate([*middle, 0]).scale([*half, 1]),
                "bsdf": {
                    "type": "roughplastic",
                    "distribution": "ggx",
                    "alpha": vinyl["roughness"],
                    "int_ior": vinyl["ior"],
                    "diffuse_reflectance": texture,
                },
            },
            "light": {
                "type": "rectangle",
                "to_world": to()
                .translate([*middle, height - 0.02])
                .rotate([1, 0, 0], 180)
                .scale([light["size"][0] / 2, light["size"][1] / 2, 1]),
                "emitter": {
                    "type": "area",
                    "radiance": {"type": "rgb", "value": [light["radiance"] * c for c in (1.0, 0.985, 0.955)]},
                },
            },
            # The floor rectangle lies a hair above the bottom of the box that makes the walls.
            "walls": self._mesh("walls", "box", shift(walls.matrix, -0.001), wall),
        }
        for i, part in enumerate(self.scene.furniture):
            world[f"furniture{i}"] = self._mesh(f"f{i}", part.shape, part.matrix, self._matte(part.colour))
        for i, (x, y) in enumerate(self.scene.marks):  # crosses of tape
            for k, size in enumerate([(0.16, 0.02, 0.001), (0.02, 0.16, 0.0012)]):
                tape = Part("box", (x, y, 0.0), size, (20, 40, 120))
                world[f"mark{i}{k}"] = self._mesh(f"m{i}{k}", "box", tape.matrix, self._matte(tape.colour))
        for thing in self.scene.objects:
            for i, (part, matrix) in enumerate(zip(thing.parts, thing.matrices(0), strict=True)):
                key = f"{thing.id}{i}"
                world[key] = self._mesh(key, part.shape, matrix, self._matte(part.colour))
        if self.scene.boards or self.scene.floor_board:
            world["board"] = self._board()
        return world

    def _matte(self, colour: Iterable[float]) -> Any:
        diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": to_linear(colour)}}
        return self.mi.load_dict({"type": "twosided", "bsdf": diffuse})

    def _mesh(self, name: str, shape: str, matrix: FloatArray, bsdf: Any) -> Any:
        vertices, faces = unit_mesh(shape)
        properties = self.mi.Properties()
        properties["mesh_bsdf"] = bsdf
        properties["face_normals"] = True
        mesh = self.mi.Mesh(name, len(vertices), len(faces), props=properties)
        parameters = self.mi.traverse(mesh)
        parameters["vertex_positions"] = _world_vertices(vertices, matrix)
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        return mesh

    def _board(self) -> Any:
        columns, rows = BOARD_PATTERN[0] + 3, BOARD_PATTERN[1] + 3  # the squares, and a white margin of one
        i, j = np.meshgrid(np.arange(columns), np.arange(rows))
        inner = (i > 0) & (i < columns - 1) & (j > 0) & (j < rows - 1)
        paper = np.where(inner & ((i + j) % 2 == 0), 0.03, 0.8).astype(np.float32)  # (1, 1) is black
        texture = {
            "type": "bitmap",
            "bitmap": self.mi.Bitmap(np.repeat(paper[::-1, :, None], 3, axis=2)),
            "raw": True,
            "filter_type": "nearest",
        }
        matte = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture}}
        properties = self.mi.Properties()
        properties["mesh_bsdf"] = self.mi.load_dict(matte)
        # A mesh and not Mitsuba's rectangle, whose pose is compiled into the code, again for each picture.
        mesh = self.mi.Mesh("board", 4, 2, has_vertex_texcoords=True, props=properties)
        parameters = self.mi.traverse(mesh)
        parameters["vertex_positions"] = self._board_vertices(None)
        parameters["vertex_texcoords"] = np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32)
        parameters["faces"] = np.array([0, 1, 2, 0, 2, 3], np.uint32)
        parameters.update()
        return mesh

    def _board_vertices(self, board: Board | None) -> Any:
        """The corners of the paper in the world; under the floor for ``None``."""
        pose = np.eye(4) if board is None else board.pose
        half = np.array([BOARD_PATTERN[0] + 3, BOARD_PATTERN[1] + 3]) * (board.square if board else 0.1) / 2
        corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 0]
        up = -50.0 if board is None else 0.0002 if board.camera is None else 0.0  # paper lies on the floor
        return _world_vertices(corners, shift(pose, up))

    def place(self, frame: int | None, board: Board | None = None) -> None:
        """Move the objects to where they are at a frame; ``None`` empties the room."""
        for thing in self.scene.objects:
            for i, (part, matrix) in enumerate(zip(thing.parts, thing.matrices(frame or 0), strict=True)):
                # An empty room keeps its meshes, under the floor, so that the compiled kernel is reused.
                matrix = shift(matrix, -50.0) if frame is None else matrix
                key = f"{thing.id}{i}.vertex_positions"
                self.parameters[key] = _world_vertices(unit_mesh(part.shape)[0], matrix)
        if "board.vertex_positions" in self.parameters:
            self.parameters["board.vertex_positions"] = self._board_vertices(board)
        self.parameters.update()

    def _directions(self, name: str) -> FloatArray:
        """Jittered rays (H * W, spp, 3) through the exact lens model, shared by all frames of a camera."""
        if name not in self._rays:
            # R2 low-discrepancy offsets: the same sub-pixel pattern in each pixel is a box filter.
            steps = np.outer(np.arange(1, self.spp + 1), [0.7548776662466927, 0.5698402909980532])
            offsets = steps % 1
            offsets -= offsets.mean(axis=0)  # or the whole picture shifts by a fraction of a pixel
            rays = np.stack([pixel_rays(self.cameras[name], tuple(o)) for o in offsets], axis=2)
            rays /= np.linalg.norm(rays, axis=3, keepdims=True)
            self._rays[name] = rays.reshape(-1, self.spp, 3).astype(np.float32)
        return self._rays[name]

    def layers(self, name: str, pixels: Mask | None = None) -> npt.NDArray[np.float32]:
        """Noisy colour, albedo and normal, (N, 9), of all or of some pixels (H, W) of a camera."""
        import drjit as dr

        mi, directions = self.mi, self._directions(name)
        directions = directions if pixels is None else directions[pixels.ravel()]
        flat = np.ascontiguousarray(directions.reshape(-1, 3).T)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(list(self.cameras).index(name), flat.shape[1])
        centre = mi.Point3f(*map(float, self.cameras[name].centre_m))
        dr.make_opaque(centre)  # a number in memory, not in the code: one compilation serves all cameras
        ray = mi.Ray3f(centre, mi.Vector3f(flat))
        colour, _, _ = self.integrator.sample(self.world, sampler, ray)
        hit = self.world.ray_intersect(ray)
        albedo = hit.bsdf().eval_diffuse_reflectance(hit)
        bounded = dr.select(colour < 4.0, colour, 4.0)  # tames fireflies
        sums = [dr.block_sum(c, self.spp) for layer in (bounded, albedo, hit.sh_frame.n) for c in layer]
        dr.eval(sums)
        return np.stack([np.array(s, np.float32) for s in sums], axis=1) / np.float32(self.spp)

    def radiance(self, name: str, frame: int | None, board: Board | None = None) -> FloatArray:
        """Denoised linear RGB (H, W, 3) of what a camera sees at a frame, ``None`` for the empty room.

        Only what an object can change visibly (itself, its shadow, its reflection) is traced anew.
        """
        width, height = self.cameras[name].size
        if name not in self._empty:
            self.place(None)
            layers = self.layers(name).reshape(height, width, 9)
            self._empty[name] = layers, denoise(layers)
        layers, picture = (a.copy() for a in self._empty[name])
        if board is not None or (frame is not None and self.scene.objects):
            self.place(frame, board)
            pixels = self._touched(name, frame or 0, board)
            layers[pixels] = self.layers(name, pixels)
            rows, columns = np.flatnonzero(pixels.any(axis=1)), np.flatnonzero(pixels.any(axis=0))
            if len(rows):  # denoise a window around what was traced
                window = tuple(slice(max(0, k[0] - 16), k[-1] + 17) for k in (rows, columns))
                # Fade into the empty room, so that the rim of a soft shadow shows no step.
                inside = cv2.distanceTransform(pixels[window].astype(np.uint8), cv2.DIST_L2, 3)
                weight = np.clip(inside / 12, 0, 1)[..., None]
                picture[window] += weight * (denoise(layers[window]) - picture[window])
        return picture

    def _touched(self, name: str, frame: int, board: Board | None = None) -> Mask:
        """Pixels (H, W) that show an object or the floor near it (0.7 heights + 0.2 m), or a board."""
        camera = self.cameras[name]
        width, height = camera.size
        rays = self.scene.rays[name]
        if name not in self._floor:
            with np.errstate(divide="ignore"):
                floor = camera.centre_m[:2] - rays[..., :2] * (camera.centre_m[2] / rays[..., 2])[..., None]
            self._floor[name] = floor
        centre, floor = camera.centre_m, self._floor[name]
        pixels = np.zeros((height, width), bool)
        for thing in self.scene.objects:
            x, y, _ = thing.pose(frame)
            radius = np.hypot(*(thing.footprint(frame) - [x, y]).T).max() + 0.7 * thing.height + 0.2
            pixels |= (rays[..., 2] < 0) & (np.hypot(floor[..., 0] - x, floor[..., 1] - y) < radius)
            depth, window = _depth(self.scene, camera, thing, frame)
            pixels[window] |= np.isfinite(depth)
        spare = 25
        if board is not None:
            # A little more than the board: its soft shadow falls behind it, where the camera sees little of it.
            half = np.array([BOARD_PATTERN[0] + 3, BOARD_PATTERN[1] + 3, 0.02]) * board.square
            paper = board.pose @ np.diag([half[0], half[1], half[2], 1.0])
            hit = np.isfinite(hit_distance("box", paper, centre, rays.reshape(-1, 3)))
            pixels, spare = hit.reshape(height, width), 61
        return cv2.dilate(pixels.astype(np.uint8), np.ones((spare, spare), np.uint8)) > 0

    def photograph(self, radiance: FloatArray, name: str, kind: str, index: int) -> Image:
        """Exposure, vignetting, the sRGB curve and sensor noise: uint8 RGB (H, W, 3)."""
        sensor, camera = self.scene.room["sensor"], self.cameras[name]
        width, height = camera.size
        v, u = np.mgrid[:height, :width]
        cx, cy = (width - 1) / 2, (height - 1) / 2
        fall = 1 - sensor["vignetting"] * ((u - cx) ** 2 + (v - cy) ** 2) / (cx**2 + cy**2)
        gain = self.scene.room["cameras"][name]["gain"]["background" if kind == "background" else "frames"]
        clean = to_srgb(radiance * fall[..., None] * sensor["exposure"] * gain)
        names = list(self.scene.room["cameras"])
        rng = np.random.default_rng([self.scene.seed, names.index(name), index, kind == "background"])
        sigma = np.sqrt(sensor["read_noise"] ** 2 + sensor["shot_noise"] ** 2 * clean)
        return np.clip(np.rint(clean + sigma * rng.standard_normal(clean.shape)), 0, 255).astype(np.uint8)


def shift(matrix: FloatArray, up: float) -> FloatArray:
    """The map followed by a step along z, in m."""
    return np.vstack([matrix[:2], matrix[2] + [0, 0, 0, up], matrix[3]])


def _world_vertices(vertices: FloatArray, matrix: FloatArray) -> Any:
    return (vertices @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32).ravel()


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """The same view with fewer (or more) pixels."""
    if scale == 1:
        return camera
    if not 0.02 <= scale <= 4:
        raise ValueError(f"scale: expected a factor between 0.02 and 4, got {scale}")
    size = (max(8, round(camera.size[0] * scale)), max(8, round(camera.size[1] * scale)))
    matrix = camera.matrix.copy()
    for axis in (0, 1):
        matrix[axis] *= size[axis] / camera.size[axis]
        matrix[axis, 2] += (size[axis] / camera.size[axis] - 1) / 2  # pixel centres are at integers
    rotation, translation = camera.pose
    return Camera.from_pose(camera.name, size, matrix, camera.distortion, rotation, translation)


def write_picture(path: Path, picture: Image, quality: int) -> None:
    """Write RGB under a temporary name, then rename: an interrupted render leaves no half picture."""
    path.parent.mkdir(parents=True, exist_ok=True)
    jpeg = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    options = jpeg if path.suffix == ".jpg" else [cv2.IMWRITE_PNG_COMPRESSION, 9]
    ok, data = cv2.imencode(path.suffix, picture[..., ::-1], options)
    if not ok:
        raise ValueError(f"{path}: cannot encode the picture")
    write_bytes(path, data.tobytes())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    temporary.write_bytes(data)
    temporary.replace(path)


# --- recordings --------------------------------------------------------------------------------------


def render(
    scene: Scene,
    out: str | Path,
    *,
    frames: Iterable[int] | None = None,
    spp: int = 6,
    scale: float = 1.0,
    progress: bool = True,
) -> Path:
    """Render a recording in the contract's layout, with its truth; returns its folder.

    Parameters
    ----------
    out
        Folder to write; pictures in it are replaced.
    frames
        Which frames; all for ``None``.
    spp
        Samples per pixel, before denoising.
    scale
        Factor on the size of the pictures; ``rig.yaml`` and the truth follow it.
    progress
        Show a progress bar.

    Raises ``ValueError`` if Mitsuba is missing or a frame is out of range.
    """
    from tqdm import tqdm

    chosen = list(range(scene.frames)) if frames is None else list(frames)
    if wrong := [f for f in chosen if not 0 <= f < scene.frames]:
        raise ValueError(f"frames: expected 0 to {scene.frames - 1}, got {wrong[0]}")
    if spp < 1:
        raise ValueError(f"spp: expected 1 or more samples per pixel, got {spp}")
    out = Path(out)
    cameras = {n: scaled_camera(c, scale) for n, c in scene.rig.cameras.items()}
    scene = replace(scene, rig=Rig(scene.rig.floor, cameras))
    quality = int(scene.room["sensor"]["jpeg_quality"])
    boards = [(b.camera, i) for i, b in enumerate(scene.boards) if frames is None or i in chosen]
    chosen = [] if scene.boards else chosen
    total = len(cameras) * (len(chosen) + (scene.background > 0) + (scene.floor_board is not None)) + len(boards)
    bar = tqdm(total=total, desc=scene.name, disable=not progress)
    studio = Studio(scene, spp=spp)
    for name in cameras:  # camera by camera: its rays and its empty room are used again
        for i in range(scene.background):
            picture = studio.photograph(studio.radiance(name, None), name, "background", i)
            write_picture(out / "background" / name / f"{i:02d}.png", picture, quality)
        bar.update(scene.background > 0)
        for frame in chosen:
            picture = studio.photograph(studio.radiance(name, frame), name, "frames", frame)
            write_picture(out / "frames" / name / f"{frame:04d}.jpg", picture, quality)
            bar.update()
    for camera, i in boards:
        picture = studio.photograph(studio.radiance(str(camera), None, scene.boards[i]), str(camera), "frames", i)
        write_picture(out / "frames" / str(camera) / f"{i:04d}.jpg", picture, quality)
        bar.update()
    if (lying := floor_board(scene)) is not None:
        for k, name in enumerate(cameras):
            picture = studio.photograph(studio.radiance(name, None, lying), name, "frames", len(scene.boards) + k)
            write_picture(out / "floor" / f"{name}.jpg", picture, quality)
            bar.update()
        write_bytes(out / "floor_marks.yaml", _yaml(floor_marks(scene)))
    bar.close()
    write_bytes(out / "rig.yaml", _yaml({"fps": scene.fps, **scene.rig.to_dict()}))
    if scene.objects:
        truth = ground_truth(scene, frames=chosen)
        lines = [f"{json.dumps(k)}: {json.dumps(v)}" for k, v in truth.pop("frames").items()]
        head = json.dumps(truth)[:-1]  # one frame a line: short, and still readable
        write_bytes(out / "truth.json", (head + ', "frames": {\n' + ",\n".join(lines) + "\n}}\n").encode())
    return out


def _yaml(content: Any) -> bytes:
    return str(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)).encode()


def floor_marks(scene: Scene) -> dict[str, Any]:
    """Where the board and the marks on the floor are: metres, and the pixels of each camera, to 0.1 px."""
    marks: dict[str, Any] = {name: [] for name in scene.rig.cameras}
    for name, camera in scene.rig.cameras.items():
        for mark, pixel in zip(scene.marks, camera.floor_to_pixels(scene.marks), strict=True):
            if camera.inside([pixel])[0]:
                marks[name].append({"pixel": np.round(pixel, 1).tolist(), "floor": list(mark)})
    content: dict[str, Any] = {"units": {"pixel": "raw image px", "floor": "m"}}
    if scene.floor_board is not None:
        content["board"] = {"pattern": list(BOARD_PATTERN), **scene.floor_board}
    return {**content, "marks": marks}


def write_manifest(lab_dir: str | Path = LAB, *, spp: int = 6, llvm: str | None = None) -> Path:
    """Write ``manifest.json``: size and SHA-256 of every file of the lab, and how it was made.

    Call it where the lab was rendered: it records the versions that are installed; ``llvm`` is what
    ``drjit.detail.llvm_version()`` said.
    """
    lab = Path(lab_dir)
    files = {str(p.relative_to(lab).as_posix()): _fingerprint(p) for p in _lab_files(lab)}
    how: dict[str, Any] = {"by": "occlib.synthetic.render", "variant": "llvm_ad_rgb", "spp": spp, "versions": {}}
    for package in ("mitsuba", "drjit", "pyoidn", "numpy", "opencv-python-headless", "scipy"):
        try:
            how["versions"][package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            pass
    if llvm:
        how["versions"]["llvm"] = llvm
    how["seeds"] = {p.parent.name: _read_yaml(p).get("seed", 0) for p in sorted(lab.glob("*/scene.yaml"))}
    content = {"made": how, "bytes": sum(f["bytes"] for f in files.values()), "files": files}
    write_bytes(lab / "manifest.json", (json.dumps(content, indent=1) + "\n").encode())
    return lab / "manifest.json"


def verify_manifest(lab_dir: str | Path = LAB) -> list[str]:
    """What differs from the manifest, one line a file; an empty list if nothing does."""
    lab = Path(lab_dir)
    try:
        expected = json.loads((lab / "manifest.json").read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        return [f"manifest.json: cannot be read ({error})"]
    present = {str(p.relative_to(lab).as_posix()): p for p in _lab_files(lab)}
    problems = [f"{name}: missing" for name in expected if name not in present]
    problems += [f"{name}: not in the manifest" for name in present if name not in expected]
    problems += [f"{n}: changed" for n, p in present.items() if n in expected and _fingerprint(p) != expected[n]]
    return sorted(problems)


def _lab_files(lab: Path) -> list[Path]:
    return sorted(p for p in lab.rglob("*") if p.is_file() and p.name != "manifest.json" and p.suffix != ".part")


def _fingerprint(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
