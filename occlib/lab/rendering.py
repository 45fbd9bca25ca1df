"""Photo-real pictures of the laboratory's scenes, with Mitsuba 3 (extra ``render``).

Only needed to make ``data/lab`` again or to render a scene of one's own; truth and silhouettes come without it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.files import encode_image, staged_folder, write_file
from occlib.formats.scene import Lamp, Surface, Window, Wood
from occlib.geometry import Rig
from occlib.lab.engine import load_mitsuba
from occlib.lab.lights import CEILING_BELOW_M, light_points
from occlib.lab.scenes import BOARD_PATTERN, Board, Scene, floor_board, floor_marks, scaled_camera
from occlib.lab.shapes import Part, hit_distance, unit_mesh
from occlib.lab.surfaces import surface_texture, to_linear, to_srgb, vinyl_texture, wood_texture
from occlib.lab.truth import depth_image, ground_truth

SHADOW_STEP = 6
"""Shadows are looked for at each sixth pixel in x and in y: less than what is traced around them."""

SHADOW = 0.03
"""Share of the direct light whose loss is visible: 3 % are 1.8 grey levels at a grey of 128, about the camera's noise."""


def denoise(layers: npt.NDArray[np.float32]) -> FloatArray:
    """Linear RGB (H, W, 3) from noisy colour, albedo and normal (H, W, 9), by Open Image Denoise."""
    import pyoidn

    colour, albedo, normal = (np.ascontiguousarray(layers[..., k : k + 3]) for k in (0, 3, 6))
    return np.asarray(pyoidn.denoise(colour, albedo=albedo, normal=normal, hdr=True), dtype=np.float64)


class Studio:
    """The scene as Mitsuba sees it; objects move without rebuilding it."""

    def __init__(self, scene: Scene, *, spp: int) -> None:
        if scene.room is None:
            raise ValueError(f"scene: {scene.name!r} has no room to be rendered in")
        self.room = scene.room
        self.mi, self.scene, self.spp, self.cameras = load_mitsuba(), scene, spp, scene.rig.cameras
        self.integrator = self.mi.load_dict({"type": "path", "max_depth": 5, "rr_depth": 100})
        self.world = self.mi.load_dict(self._description(), optimize=False)
        self.parameters = self.mi.traverse(self.world)
        self._rays: dict[str, Any] = {}
        self._empty: dict[tuple[str, tuple[float, ...]], Any] = {}
        self._floor: dict[str, Any] = {}
        self._surfaces: dict[str, FloatArray] = {}
        self._lights = light_points(self.room)

    def _description(self) -> dict[str, Any]:
        mi, room = self.mi, self.room
        (x0, x1), (y0, y1), height = room.walls.x, room.walls.y, room.walls.height
        light, to = room.ceiling_light, mi.ScalarTransform4f
        middle, half = [(x0 + x1) / 2, (y0 + y1) / 2], [(x1 - x0) / 2, (y1 - y0) / 2]
        wall = self._matte(room.walls.colour)
        walls = Part("box", (middle[0], middle[1], height / 2), (2 * half[0], 2 * half[1], height), (0, 0, 0))
        world: dict[str, Any] = {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": to().translate([*middle, 0]).scale([*half, 1]),
                "bsdf": self._floor_coat((2 * half[0], 2 * half[1])),
            },
            "light": self._emitter(
                to().translate([*middle, height - CEILING_BELOW_M]).rotate([1, 0, 0], 180),
                light.size,
                [light.radiance * c for c in (1.0, 0.985, 0.955)],
            ),
            # The floor rectangle lies a hair above the bottom of the box that makes the walls.
            "walls": self._mesh("walls", "box", shift(walls.matrix, -0.001), wall),
        }
        for i, window in enumerate(room.daylight):
            world[f"window{i}"] = self._window(window)
        for key, lamp in room.lamps.items():
            world[f"lamp_{key}"] = self._lamp(lamp)
        for i, part in enumerate(self.scene.furniture):
            world[f"furniture{i}"] = self._mesh(f"f{i}", part.shape, part.matrix, self._matte(part.colour))
        for i, (x, y) in enumerate(self.scene.marks):  # crosses of tape
            for k, size in enumerate([(0.16, 0.02, 0.001), (0.02, 0.16, 0.0012)]):
                tape = Part("box", (x, y, 0.0), size, (20, 40, 120))
                world[f"mark{i}{k}"] = self._mesh(f"m{i}{k}", "box", tape.matrix, self._matte(tape.colour))
        for each in self.scene.objects:
            for i, (part, matrix) in enumerate(zip(each.parts, each.matrices(0), strict=True)):
                key = f"{each.id}{i}"
                world[key] = self._mesh(key, part.shape, matrix, self._matte(part.colour))
        if self.scene.boards or self.scene.floor_board:
            world["board"] = self._board()
        return world

    def _floor_coat(self, size: tuple[float, float]) -> dict[str, Any]:
        """The glossy floor, ``size`` in m: a surface if the room has one, else planks of wood, else tiles of vinyl."""
        coat = self.room.coat
        if isinstance(coat, Surface):
            picture, repeat = surface_texture(coat, size, self.scene.seed), [1.0, 1.0, 1]
        elif isinstance(coat, Wood):
            picture, repeat = wood_texture(coat.colour, size, coat.plank), [1.0, 1.0, 1]
        else:
            picture, repeat = vinyl_texture(coat.colour), [size[0] / coat.tile, size[1] / coat.tile, 1]
        return {
            "type": "roughplastic",
            "distribution": "ggx",
            "alpha": coat.roughness,
            "int_ior": coat.ior,
            "diffuse_reflectance": {
                "type": "bitmap",
                "bitmap": self.mi.Bitmap(picture.astype(np.float32)),
                "raw": True,
                "to_uv": self.mi.ScalarTransform4f().scale(repeat),
            },
        }

    def _window(self, window: Window) -> dict[str, Any]:
        place = self.mi.ScalarTransform4f().translate(list(window.centre)).rotate([0, 0, 1], window.facing_deg)
        return self._emitter(place.rotate([0, 1, 0], 90), window.size[::-1], self._radiance_of(window))

    def _lamp(self, lamp: Lamp) -> dict[str, Any]:
        place = self.mi.ScalarTransform4f().translate(list(lamp.centre)).rotate([1, 0, 0], 180)
        return self._emitter(place, lamp.size, self._radiance_of(lamp))

    @staticmethod
    def _emitter(place: Any, size: Sequence[float], radiance: Sequence[float]) -> dict[str, Any]:
        """A rectangle of light, ``size`` in m, that shines along the z axis of its place."""
        return {
            "type": "rectangle",
            "to_world": place.scale([size[0] / 2, size[1] / 2, 1]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}},
        }

    @staticmethod
    def _radiance_of(light: Lamp | Window, factor: float = 1.0) -> list[float]:
        return [factor * light.radiance * c for c in to_linear(light.colour)]

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

    def place(self, frame: int | None, board: Board | None = None, *, light: tuple[float, ...] = ()) -> None:
        """Move the objects to where they are at a frame; ``None`` empties the room. ``light``: see :meth:`_light`."""
        for name, factor in zip(self.scene.lamps, light, strict=False):
            value = self.mi.Color3f(*self._radiance_of(self.room.lamps[name], factor))
            self.parameters[f"lamp_{name}.emitter.radiance.value"] = value
        for each in self.scene.objects:
            for i, (part, matrix) in enumerate(zip(each.parts, each.matrices(frame or 0), strict=True)):
                # An empty room keeps its meshes, under the floor, so that the compiled kernel is reused.
                matrix = shift(matrix, -50.0) if frame is None else matrix
                key = f"{each.id}{i}.vertex_positions"
                self.parameters[key] = _world_vertices(unit_mesh(part.shape)[0], matrix)
        if "board.vertex_positions" in self.parameters:
            self.parameters["board.vertex_positions"] = self._board_vertices(board)
        self.parameters.update()

    def _directions(self, name: str) -> FloatArray:
        """Jittered rays (3, H * W * spp) through the exact lens model, shared by all frames of a camera."""
        if name not in self._rays:
            # R2 low-discrepancy offsets: the same sub-pixel pattern in each pixel is a box filter.
            steps = np.outer(np.arange(1, self.spp + 1), [0.7548776662466927, 0.5698402909980532])
            offsets = steps % 1
            offsets -= offsets.mean(axis=0)  # or the whole picture shifts by a fraction of a pixel
            camera = self.cameras[name]
            rays = np.stack([camera.rays(camera.pixel_centres() + offset) for offset in offsets], axis=2)
            rays /= np.linalg.norm(rays, axis=3, keepdims=True)
            self._rays[name] = np.ascontiguousarray(rays.reshape(-1, 3).T.astype(np.float32))
        return self._rays[name]

    def layers(self, name: str, pixels: Mask | None = None) -> npt.NDArray[np.float32]:
        """Noisy colour, albedo and normal, (N, 9), of all or of some pixels (H, W) of a camera.

        A pixel has the same random numbers in every picture: what has not changed has the same noise.
        """
        import drjit as dr

        mi, flat = self.mi, self._directions(name)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(list(self.cameras).index(name), flat.shape[1])
        traced = np.ones(flat.shape[1], bool) if pixels is None else np.repeat(pixels.ravel(), self.spp)
        centre = mi.Point3f(*map(float, self.cameras[name].centre_m))
        dr.make_opaque(centre)  # a number in memory, not in the code: one compilation serves all cameras
        ray, active = mi.Ray3f(centre, mi.Vector3f(flat)), mi.Bool(traced)
        colour, _, _ = self.integrator.sample(self.world, sampler, ray, None, active)
        hit = self.world.ray_intersect(ray, active)
        albedo = hit.bsdf().eval_diffuse_reflectance(hit, active)
        bounded = dr.select(colour < 4.0, colour, 4.0)  # tames fireflies
        sums = [dr.block_sum(c, self.spp) for layer in (bounded, albedo, hit.sh_frame.n) for c in layer]
        dr.eval(sums)
        found = np.stack([np.array(s, np.float32) for s in sums], axis=1) / np.float32(self.spp)
        return found if pixels is None else found[pixels.ravel()]

    def radiance(self, name: str, frame: int | None, board: Board | None = None) -> FloatArray:
        """Denoised linear RGB (H, W, 3) of what a camera sees at a frame, ``None`` for the empty room.

        Only what an object can change visibly (itself, its shadow, its reflection) is traced anew.
        """
        width, height = self.cameras[name].size
        light = self._light(frame)
        if (name, light) not in self._empty:
            self.place(None, light=light)
            self._surfaces[name] = self._places(name)
            layers = self.layers(name).reshape(height, width, 9)
            self._empty[name, light] = layers, denoise(layers)
        layers, picture = (a.copy() for a in self._empty[name, light])
        if board is not None or (frame is not None and self.scene.objects):
            self.place(frame, board, light=light)
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

    def _light(self, frame: int | None) -> tuple[float, ...]:
        """The factors on the light of the scene's lamps that change, at a frame or in the empty room (1)."""
        return tuple(1.0 if frame is None else factors[frame] for factors in self.scene.lamps.values())

    def _touched(self, name: str, frame: int, board: Board | None = None) -> Mask:
        """Pixels (H, W) that show an object, the floor near it (0.7 heights + 0.2 m), or its shadow; or a board."""
        camera = self.cameras[name]
        width, height = camera.size
        rays = self.scene.rays[name]
        if name not in self._floor:
            with np.errstate(divide="ignore"):
                floor = camera.centre_m[:2] - rays[..., :2] * (camera.centre_m[2] / rays[..., 2])[..., None]
            self._floor[name] = floor
        centre, floor = camera.centre_m, self._floor[name]
        pixels = self._shaded(name, frame)
        for each in self.scene.objects:
            x, y, _ = each.pose(frame)
            radius = np.hypot(*(each.footprint(frame) - [x, y]).T).max() + 0.7 * each.height + 0.2
            pixels |= (rays[..., 2] < 0) & (np.hypot(floor[..., 0] - x, floor[..., 1] - y) < radius)
            depth, window = depth_image(self.scene, camera, each, frame)
            pixels[window] |= np.isfinite(depth)
        spare = 25
        if board is not None:
            # A little more than the board: its soft shadow falls behind it, where the camera sees little of it.
            half = np.array([BOARD_PATTERN[0] + 3, BOARD_PATTERN[1] + 3, 0.02]) * board.square
            paper = board.pose @ np.diag([half[0], half[1], half[2], 1.0])
            hit = np.isfinite(hit_distance("box", paper, centre, rays.reshape(-1, 3)))
            pixels, spare = hit.reshape(height, width), 61
        return cv2.dilate(pixels.astype(np.uint8), np.ones((spare, spare), np.uint8)) > 0

    def _places(self, name: str) -> FloatArray:
        """What a camera sees now at each :data:`SHADOW_STEP`-th pixel, (N, 3) in m."""
        centre = self.cameras[name].centre_m
        view = self.scene.rays[name][SHADOW_STEP // 2 :: SHADOW_STEP, SHADOW_STEP // 2 :: SHADOW_STEP].reshape(-1, 3)
        directions = self.mi.Vector3f(np.ascontiguousarray(view.T.astype(np.float32)))
        hit = self.world.ray_intersect_preliminary(self.mi.Ray3f(self.mi.Point3f(*map(float, centre)), directions))
        return np.asarray(centre + view * np.array(hit.t, float)[:, None])

    def _shaded(self, name: str, frame: int) -> Mask:
        """Pixels (H, W) that show what an object keeps more than :data:`SHADOW` of the direct light from, by its bounding box."""
        camera = self.cameras[name]
        width, height = camera.size
        shaded = self._lights.shaded(self._surfaces[name], self.scene.objects, frame) > SHADOW
        size = len(range(SHADOW_STEP // 2, height, SHADOW_STEP)), -1
        grown = cv2.resize(shaded.reshape(size).astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        return grown > 0

    def photograph(self, radiance: FloatArray, name: str, kind: str, index: int) -> Image:
        """Exposure, vignetting, the sRGB curve and sensor noise: uint8 RGB (H, W, 3)."""
        sensor, camera = self.room.sensor, self.cameras[name]
        width, height = camera.size
        v, u = np.mgrid[:height, :width]
        cx, cy = (width - 1) / 2, (height - 1) / 2
        fall = 1 - sensor.vignetting * ((u - cx) ** 2 + (v - cy) ** 2) / (cx**2 + cy**2)
        gain = getattr(self.room.cameras[name].gain, "background" if kind == "background" else "frames")
        if kind == "frames" and name in self.scene.exposure:
            gain *= self.scene.exposure[name][index]
        clean = to_srgb(radiance * fall[..., None] * sensor.exposure * gain)
        names = list(self.room.cameras)
        rng = np.random.default_rng([self.scene.seed, names.index(name), index, kind == "background"])
        sigma = np.sqrt(sensor.read_noise**2 + sensor.shot_noise**2 * clean)
        return np.clip(np.rint(clean + sigma * rng.standard_normal(clean.shape)), 0, 255).astype(np.uint8)


def shift(matrix: FloatArray, up: float) -> FloatArray:
    """The map followed by a step along z, in m."""
    return np.vstack([matrix[:2], matrix[2] + [0, 0, 0, up], matrix[3]])


def _world_vertices(vertices: FloatArray, matrix: FloatArray) -> Any:
    return (vertices @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32).ravel()


def render(
    scene: Scene,
    out: str | Path,
    *,
    frames: Iterable[int] | None = None,
    spp: int = 6,
    scale: float = 1.0,
    progress: bool = True,
    background_suffix: str = ".png",
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
    background_suffix
        ``.png`` keeps the pictures of the empty room as they are, ``.jpg`` makes them small.

    Raises ``ValueError`` if Mitsuba is missing or a frame is out of range.
    """
    from tqdm import tqdm

    chosen = list(range(scene.frames)) if frames is None else list(frames)
    if wrong := [f for f in chosen if not 0 <= f < scene.frames]:
        raise ValueError(f"frames: expected 0 to {scene.frames - 1}, got {wrong[0]}")
    if spp < 1:
        raise ValueError(f"spp: expected 1 or more samples per pixel, got {spp}")
    cameras = {n: scaled_camera(c, scale) for n, c in scene.rig.cameras.items()}
    scene = replace(scene, rig=Rig(scene.rig.floor, cameras))
    total = len(cameras) * (len(chosen) + (scene.background > 0) + (scene.floor_board is not None))
    bar = tqdm(total=total, desc=scene.name, disable=None if progress else True)
    with bar, staged_folder(out) as stage:
        _write_recording(scene, Studio(scene, spp=spp), chosen, stage, bar, background_suffix)
    return Path(out)


def _write_recording(scene: Scene, studio: Studio, chosen: list[int], out: Path, bar: Any, suffix: str) -> None:
    quality, cameras = studio.room.sensor.jpeg_quality, scene.rig.cameras
    for name in cameras:  # camera by camera: its rays and its empty room are used again
        for i in range(scene.background):
            picture = studio.photograph(studio.radiance(name, None), name, "background", i)
            write_file(out / "background" / name / f"{i:02d}{suffix}", encode_image(suffix, picture, quality=quality))
        bar.update(scene.background > 0)
        boards = [i for i, board in enumerate(scene.boards) if board.camera == name]
        for frame in chosen:  # frame N shows the camera its own Nth board, if there are any
            index = boards[frame] if boards else frame
            light = studio.radiance(name, None, scene.boards[index]) if boards else studio.radiance(name, frame)
            picture = studio.photograph(light, name, "frames", index)
            write_file(out / "frames" / name / f"{frame:04d}.jpg", encode_image(".jpg", picture, quality=quality))
            bar.update()
    if (lying := floor_board(scene)) is not None:
        for k, name in enumerate(cameras):
            picture = studio.photograph(studio.radiance(name, None, lying), name, "frames", len(scene.boards) + k)
            write_file(out / "floor" / f"{name}.jpg", encode_image(".jpg", picture, quality=quality))
            bar.update()
        write_file(out / "floor_marks.yaml", _yaml(floor_marks(scene)))
    for file, content in scene.files.items():
        write_file(out / file, content)
    write_file(out / "rig.yaml", _yaml({"fps": scene.fps, **scene.rig.to_dict()}))
    ground_truth(scene, frames=chosen).save(out / "truth.json")


def _yaml(content: Any) -> bytes:
    return str(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)).encode()
