"""Random rooms: the same for a seed, objects apart and seen, truth that counts furniture, lists that share no room."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

import occlib.lab
from occlib.base.files import read_yaml
from occlib.cli import main
from occlib.formats.scene import Lamp, SceneFile
from occlib.geometry import Rig
from occlib.lab import __main__ as lab_command
from occlib.lab import room_lists
from occlib.lab.engine import load_mitsuba
from occlib.lab.furnishing import OBJECTS, stander, walker
from occlib.lab.interiors import CROSSING_DEG, angle_between_deg
from occlib.lab.manifest import verify_manifest
from occlib.lab.placing import SEEN, TOGETHER, centroid_m, gap_m
from occlib.lab.rendering import Studio, denoise, render
from occlib.lab.room_lists import CROWDED, DEVELOPMENT, REPORTED, SHIPPED, is_rendered, listed_room, listed_scene
from occlib.lab.rooms import FLOOR_SEEN, random_scene
from occlib.lab.scenes import Scene, build_scene, load_scene, scaled_camera
from occlib.lab.shapes import hit_distance, unit_mesh
from occlib.lab.truth import ground_truth
from occlib.recordings import ROOMS, open_recording

SOME = SHIPPED[::3]
"""Of the rooms that ship, some for what takes long."""


@cache
def room(seed: int) -> Scene:
    return load_scene(f"room_{seed}")


def same(first: Scene, second: Scene) -> bool:
    """Whether two scenes are the same but for the folder that they are in."""
    names = ("name", "room", "frames", "background", "seed", "fps", "objects", "furniture", "lamps", "exposure")
    return first.rig.to_dict() == second.rig.to_dict() and all(getattr(first, n) == getattr(second, n) for n in names)


# --- seeds --------------------------------------------------------------------------------------------
def test_the_lists_share_no_seed() -> None:
    lists = DEVELOPMENT, REPORTED, SHIPPED
    assert all(not set(a) & set(b) for a, b in combinations(lists, 2)) and all(len(set(a)) == len(a) for a in lists)
    assert len(DEVELOPMENT) >= 20 and len(REPORTED) >= 30 and len(SHIPPED) == 12
    assert set(CROWDED) < {*DEVELOPMENT, *REPORTED} and set(room_lists.SOME) < set(REPORTED)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SOME)
def test_a_seed_gives_the_room_that_ships(seed: int) -> None:
    scene = listed_scene(seed)
    assert {name: (ROOMS / scene.name / name).read_bytes() for name in scene.files} == dict(scene.files)
    assert same(scene, room(seed))


def test_a_room_is_the_same_for_a_seed_and_read_back_equal(tmp_path: Path) -> None:
    scene = random_scene(5, cameras=2, objects=2, frames=3, size=(160, 120))
    assert random_scene(5, cameras=2, objects=2, frames=3, size=(160, 120)).files == scene.files
    assert random_scene(6, cameras=2, objects=2, frames=3, size=(160, 120)).files != scene.files
    for name, content in scene.files.items():
        (tmp_path / "room_5").mkdir(exist_ok=True)
        (tmp_path / "room_5" / name).write_bytes(content)
    assert same(load_scene(tmp_path / "room_5"), scene)
    assert (len(scene.rig.cameras), len(scene.objects), scene.frames) == (2, 2, 3)
    assert all(camera.size == (160, 120) for camera in scene.rig.cameras.values())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed: expected a whole number >= 0, got -1"),
        ({"seed": 1.5}, "seed: expected a whole number"),
        ({"seed": 1, "cameras": 1}, "cameras: expected a whole number from 2 to 6, got 1"),
        ({"seed": 1, "cameras": 7}, "cameras: expected a whole number from 2 to 6, got 7"),
        ({"seed": 1, "objects": 9}, "objects: expected a whole number from 1 to 8, got 9"),
        ({"seed": 1, "objects": 0}, "objects: expected a whole number from 1 to 8, got 0"),
        ({"seed": 1, "frames": 1}, "frames: expected a whole number from 2 to 30, got 1"),
        ({"seed": 1, "size": (8, 480)}, "size: expected a whole number >= 32, got 8"),
        ({"seed": 1, "background": -1}, "background: expected a whole number >= 0, got -1"),
        ({"seed": 1, "quality": 101}, "quality: expected a whole number from 1 to 100, got 101"),
    ],
)
def test_an_argument_out_of_range_is_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        random_scene(**arguments)


# --- what stands where ----------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", SHIPPED)
def test_objects_stay_on_the_floor_and_apart_from_all_else(seed: int) -> None:
    scene = room(seed)
    pieces = []
    for part in scene.furniture:
        points = unit_mesh(part.shape)[0] @ part.matrix[:3, :3].T + part.matrix[:3, 3]
        pieces.append(cv2.convexHull(points[:, :2].astype(np.float32)))
    for frame in range(scene.frames):
        outlines = [each.footprint(frame).astype(np.float32) for each in scene.objects]
        for outline in outlines:
            low, high = np.transpose([scene.rig.floor.x, scene.rig.floor.y])
            assert (outline > low + 0.04).all() and (outline < high - 0.04).all()
            assert all(cv2.intersectConvexConvex(outline, piece)[0] == 0 for piece in pieces)
        assert all(cv2.intersectConvexConvex(a, b)[0] == 0 for a, b in combinations(outlines, 2))
    for each in scene.objects:
        assert min(part[2, 3] - abs(part[2, :3]).max() / 2 for part in each.matrices(0)) > -0.2
        assert each.vertices_m(0)[:, 2].min() == pytest.approx(0, abs=2e-3)


@pytest.mark.parametrize("seed", SHIPPED)
def test_objects_move_steadily_and_no_faster_than_their_kind(seed: int) -> None:
    scene = room(seed)
    assert any(len(each.path) > 1 for each in scene.objects)
    for each in scene.objects:
        assert each.label in OBJECTS
        if len(each.path) == 1:
            continue
        places = np.array([each.pose(frame)[:2] for frame in range(scene.frames)])
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) * scene.fps
        slowest, fastest = OBJECTS[each.label].speed
        assert (speeds > 0.97 * slowest).all() and (speeds < 1.03 * fastest).all() and np.ptp(speeds) < 0.05


@pytest.mark.parametrize("seed", SHIPPED)
def test_cameras_hang_on_the_walls_and_the_first_two_cross(seed: int) -> None:
    content = room(seed).room
    assert content is not None
    places = [np.array(camera.position) for camera in content.cameras.values()]
    for at in places:
        to_wall = min(
            abs(at[axis] - end) for axis, ends in enumerate((content.walls.x, content.walls.y)) for end in ends
        )
        assert to_wall == pytest.approx(0.12, abs=0.002) and 2.2 <= at[2] <= min(4, content.walls.height)
    assert all(np.hypot(*(a - b)[:2]) >= 0.8 for a, b in combinations(places, 2))
    assert CROSSING_DEG[0] <= angle_between_deg(*places[:2]) <= CROSSING_DEG[1]
    assert all(lamp.centre[2] > max(at[2] for at in places) for lamp in content.lamps.values())


@pytest.mark.parametrize("seed", SHIPPED)
def test_each_camera_sees_most_of_the_floor(seed: int) -> None:
    """Ray by ray from each camera to places on the floor, against each piece of furniture."""
    scene = room(seed)
    x, y = np.meshgrid(np.linspace(*scene.rig.floor.x, 24), np.linspace(*scene.rig.floor.y, 24))
    places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    for camera in scene.rig.cameras.values():
        way, clear = places - camera.centre_m, camera.inside(camera.floor_to_pixels(places[:, :2]))
        for part in scene.furniture:
            clear &= hit_distance(part.shape, part.matrix, camera.centre_m, way) > 0.99
        assert clear.mean() > FLOOR_SEEN - 0.03


@pytest.mark.parametrize("seed", SHIPPED)
def test_two_cameras_see_a_third_of_each_object(seed: int) -> None:
    scene = room(seed)
    together: dict[str, list[bool]] = {each.id: [] for each in scene.objects}
    for objects in ground_truth(scene).frames.values():
        for each in objects:
            seen = {name for name, hidden in (each.hidden_fraction or {}).items() if 1 - hidden > SEEN - 0.05}
            assert len(seen) >= 2
            together[str(each.id)].append({"cam1", "cam2"} <= seen)
    assert all(np.mean(both) >= TOGETHER for both in together.values())


# --- truth --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", SOME)
def test_hidden_fractions_count_furniture(seed: int) -> None:
    """Against a search over all parts for each pixel of the whole picture."""
    cameras = {name: scaled_camera(camera, 0.5) for name, camera in room(seed).rig.cameras.items()}
    scene = replace(room(seed), rig=Rig(room(seed).rig.floor, cameras))
    (objects,) = ground_truth(scene, frames=[2]).frames.values()
    for name, camera in scene.rig.cameras.items():
        rays, centre = camera.rays().reshape(-1, 3), camera.centre_m
        still = np.min([hit_distance(p.shape, p.matrix, centre, rays) for p in scene.furniture], axis=0)
        depths = []
        for each in scene.objects:
            parts = zip(each.parts, each.matrices(2), strict=True)
            depths.append(np.min([hit_distance(p.shape, m, centre, rays) for p, m in parts], axis=0))
        nearest = np.minimum(np.min(depths, axis=0), still)
        for depth, true in zip(depths, objects, strict=True):
            alone = np.isfinite(depth)
            expected = {name: pytest.approx(1 - (alone & (depth <= nearest)).sum() / alone.sum(), abs=1e-6)}
            hidden = true.hidden_fraction or {}
            assert {name: hidden[name]} == expected if alone.any() else name not in hidden


def test_furniture_hides_something_in_the_rooms_that_ship() -> None:
    """Or the test above would not notice if it were left out."""
    hidden = []
    for seed in SOME:
        bare = replace(room(seed), furniture=())
        pairs = zip(
            ground_truth(room(seed), frames=[2]).frames[2], ground_truth(bare, frames=[2]).frames[2], strict=True
        )
        for each, other in pairs:
            hidden += [
                value - (other.hidden_fraction or {})[key] for key, value in (each.hidden_fraction or {}).items()
            ]
    assert min(hidden) >= 0 and max(hidden) > 0.1


@pytest.mark.parametrize("kind", [walker, stander])
def test_people_stand_on_the_floor_and_between_their_feet(kind: type) -> None:
    content = read_yaml(ROOMS / f"room_{SHIPPED[0]}/scene.yaml")
    parts = kind(np.random.default_rng(3), (200, 40, 40))
    content["objects"] = [
        {"id": "A", "label": "person", "colour": [200, 40, 40], "parts": msgspec.to_builtins(parts)}
        | {"path": [{"frame": 0, "at": [0.3, -0.2], "heading": 0}]}
    ]
    content |= {"lamps": {}, "exposure": {}}
    shipped = room(SHIPPED[0]).room
    assert shipped is not None
    person = build_scene(shipped, msgspec.convert(content, SceneFile), Path(".")).objects[0]
    shoes = [i for i, part in enumerate(person.parts) if part.shape == "box"]
    strides = []
    for frame in range(6):
        assert person.vertices_m(frame)[:, 2].min() == pytest.approx(0, abs=1e-9)
        left, right = (person.matrices(frame)[i][:3, 3] for i in shoes)
        assert (left + right)[:2] / 2 == pytest.approx([0.3, -0.2], abs=0.06)
        strides.append(left[0] - right[0])
    assert (np.ptp(strides) > 0.4) == (kind is walker) and (np.ptp(strides) < 1e-3) == (kind is stander)


def test_light_changes_once_a_frame() -> None:
    content = read_yaml(ROOMS / f"room_{SHIPPED[0]}/scene.yaml")
    with pytest.raises(ValueError, match=r"lamps.lamp1: expected 6 factors, one a frame, got 2"):
        msgspec.convert(content | {"lamps": {"lamp1": [1, 0]}}, SceneFile)
    shipped = room(SHIPPED[0]).room
    assert shipped is not None
    for field in ("lamps", "exposure"):
        scene = msgspec.convert(content | {field: {"sun": [1] * 6}}, SceneFile)
        with pytest.raises(ValueError, match=f"{field}: 'sun' is not in the room; it has "):
            build_scene(shipped, scene, Path("."))


# --- polygons -------------------------------------------------------------------------------------------
def test_the_gap_between_polygons_is_never_more_than_their_distance() -> None:
    rng = np.random.default_rng(0)
    apart = 0
    for _ in range(200):
        a, b = (
            cv2.convexHull((rng.uniform(-1, 1, (8, 2)) + rng.uniform(-1.5, 1.5, 2)).astype(np.float32))[:, 0]
            for _ in range(2)
        )
        a, b = (polygon.astype(float)[:: 1 if _signed(polygon) > 0 else -1] for polygon in (a, b))
        edge = [p + t * (q - p) for p, q in zip(b, np.roll(b, -1, axis=0), strict=True) for t in np.linspace(0, 1, 50)]
        distances = [-cv2.pointPolygonTest(a.astype(np.float32), (float(x), float(y)), True) for x, y in edge]
        overlap = cv2.intersectConvexConvex(a.astype(np.float32), b.astype(np.float32))[0] > 0
        gap = gap_m(a, b)
        assert (gap < 1e-6) if overlap else (0 < gap + 1e-6 <= min(distances) + 0.02)
        apart += not overlap
    assert 50 < apart < 190


def _signed(polygon: np.ndarray) -> float:
    x, y = polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_the_centroid_is_that_of_the_area() -> None:
    triangle = np.array([[0.0, 0], [3, 0], [3, 0.0], [0, 3]])
    assert centroid_m(triangle).tolist() == [1, 1]


# --- lists and commands ------------------------------------------------------------------------------------
def test_a_room_that_is_not_whole_is_rendered_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OCCLIB_CACHE", str(tmp_path))
    scene, rendered = random_scene(5, cameras=2, objects=2, frames=2, size=(64, 48)), []
    monkeypatch.setattr(room_lists, "listed_scene", lambda seed: scene)

    def fake(scene: Scene, folder: Path, **_: object) -> Path:
        rendered.append(folder)
        for kind, count in (("background", scene.background), ("frames", scene.frames)):
            for name in scene.rig.cameras:
                (folder / kind / name).mkdir(parents=True, exist_ok=True)
                for i in range(count):
                    (folder / kind / name / f"{i:04d}.png").touch()
        for file, content in {**scene.files, "rig.yaml": b"", "truth.json": b""}.items():
            (folder / file).write_bytes(content)
        return folder

    monkeypatch.setattr(room_lists, "render", fake)
    folder = listed_room(5)
    assert folder == tmp_path / "room_5" == listed_room(5) and rendered == [folder]
    for missing in ("truth.json", "frames/cam1/0001.png", "background/cam2/0000.png", "scene.yaml"):
        (folder / missing).unlink()
        assert not is_rendered(scene, folder)
        assert listed_room(5) == folder and is_rendered(scene, folder)
    (folder / "room.yaml").write_bytes(b"another")
    listed_room(5)
    assert len(rendered) == 6


def test_rooms_are_rendered_by_list_or_by_seed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rendered: list[int] = []
    monkeypatch.setattr(lab_command, "listed_room", lambda seed: rendered.append(seed) or Path(f"cache/room_{seed}"))
    assert lab_command.main(["7", "some"]) == 0 and rendered == [7, *room_lists.SOME]
    assert capsys.readouterr().out.startswith("11 rooms in cache (")
    monkeypatch.setattr(lab_command, "listed_room", lambda seed: os.kill(os.getpid(), signal.SIGTERM))
    assert lab_command.main(["7"]) == 130 and "interrupted" in capsys.readouterr().err
    assert lab_command.main(["most"]) == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("rooms: expected a seed or one of some, development, ")


def test_the_command_renders_a_random_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[Scene, Path]] = []
    monkeypatch.setattr(occlib.lab, "render", lambda scene, out, **_: asked.append((scene, out)) or out)
    assert main(["render", "--random", "5", "--cameras", "2", "--objects", "1"]) == 0
    ((scene, out),) = asked
    assert (len(scene.rig.cameras), len(scene.objects), out) == (2, 1, Path("runs/render/room_5"))
    for arguments in (["render"], ["render", "robot", "--random", "1"], ["render", "robot", "--cameras", "2"]):
        assert main(arguments) != 0
        assert "expected" in capsys.readouterr().err
    with pytest.raises(ValueError, match=r"^room_9: not rendered yet; first: python -m occlib.lab 9$"):
        open_recording("room_9")


# --- the rooms that ship ------------------------------------------------------------------------------------
def test_the_rooms_that_ship_are_whole_and_small() -> None:
    assert verify_manifest(ROOMS) == []
    assert sum(path.stat().st_size for path in ROOMS.rglob("*") if path.is_file()) < 2_500_000
    assert sorted(path.name for path in ROOMS.iterdir() if path.is_dir()) == [f"room_{seed}" for seed in SHIPPED]
    for seed in SHIPPED:
        recording = open_recording(f"room_{seed}")
        assert is_rendered(room(seed), recording.path)
        assert len(recording.rig.cameras) == 2 + seed % 2 and recording.fps == 5 and not recording.without_background
        assert recording.frames == tuple(range(6)) and len(list(recording.images())) == 6


@pytest.mark.parametrize("seed", SOME)
def test_the_truth_that_ships_is_what_the_scene_says(seed: int) -> None:
    truth = msgspec.json.decode((ROOMS / f"room_{seed}/truth.json").read_bytes())
    fresh = ground_truth(room(seed), frames=[0, 5]).to_dict()["frames"]
    assert msgspec.json.decode(msgspec.json.encode(fresh)) == {f: truth["frames"][f] for f in ("0", "5")}


@pytest.mark.parametrize("seed", SOME)
def test_pictures_change_where_the_truth_has_objects(seed: int) -> None:
    """By their silhouettes: most of what an object covers differs from the empty room, hardly anything far from it."""
    recording, scene = open_recording(f"room_{seed}"), room(seed)
    ((_, images),) = recording.images([3])
    inside, outside = [], []
    for name, (empty,) in recording.background_images().items():
        gain = np.median(images[name].astype(float) / np.maximum(empty, 1))
        change = np.abs(images[name] / gain - empty.astype(float)).max(axis=2)
        covered = np.zeros(change.shape, bool)
        for each in scene.objects:
            depth, window = occlib.lab.depth_image(scene, scene.rig[name], each, 3)
            covered[window] |= np.isfinite(depth)
        covered &= np.isinf(scene.furniture_depths[name])
        far = cv2.dilate(covered.astype(np.uint8), np.ones((81, 81), np.uint8)) == 0
        inside.append(change[covered])
        outside.append(change[far])
    assert np.median(np.concatenate(inside)) > 3 * np.median(np.concatenate(outside))


# --- pictures -----------------------------------------------------------------------------------------------
@pytest.fixture
def small() -> Scene:
    try:
        load_mitsuba()
    except ValueError as error:
        pytest.skip(str(error))
    return random_scene(5, cameras=2, objects=2, frames=2, size=(64, 48), background=2)


@pytest.mark.slow
def test_a_random_room_is_rendered_with_all_that_describes_it(
    small: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OCCLIB_CACHE", str(tmp_path))
    folder = render(small, tmp_path / "room_5", spp=1, progress=False, background_suffix=".jpg")
    assert is_rendered(small, folder) and same(load_scene("room_5"), small)
    recording = open_recording("room_5")
    assert {name: len(images) for name, images in recording.background_images().items()} == {"cam1": 2, "cam2": 2}
    for _, images in recording.images():
        assert all(40 < image.mean() < 240 for image in images.values())


@pytest.mark.slow
def test_only_what_changes_is_traced_anew_and_the_rest_has_the_same_noise(small: Scene) -> None:
    studio = Studio(small, spp=4)
    empty = studio.radiance("cam1", None)
    pixels = studio._touched("cam1", 1)
    assert 0.02 < pixels.mean() < 0.98
    studio.place(1, light=studio._light(1))
    whole = studio.layers("cam1")
    assert np.array_equal(studio.layers("cam1", pixels), whole[pixels.ravel()])
    change = np.abs(denoise(whole.reshape(48, 64, 9)) - empty).mean(axis=2)
    assert np.median(change[~pixels]) < 0.1 * np.mean(change[pixels])


@pytest.mark.slow
def test_a_lamp_that_is_switched_off_darkens_the_room(small: Scene) -> None:
    assert small.room is not None
    lamp = msgspec.convert({"centre": [0, 0, 2.5], "size": [0.3, 0.3], "radiance": 100}, Lamp)
    lit_room = msgspec.structs.replace(small.room, lamps={"spot": lamp})
    changing = replace(small, room=lit_room, lamps={"spot": (1.0, 0.0)}, exposure={"cam1": (1.0, 2.0)})
    studio = Studio(changing, spp=2)
    lit, dark, empty = (studio.radiance("cam1", frame).mean() for frame in (0, 1, None))
    assert dark < 0.8 * lit and lit == pytest.approx(empty, rel=0.3)
    grey = np.full((48, 64, 3), 0.02)
    first, second = (studio.photograph(grey, "cam1", "frames", frame).mean() for frame in (0, 1))
    assert second > 1.2 * first
