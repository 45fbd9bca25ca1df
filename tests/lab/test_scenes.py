"""The rendered laboratory: its files, its truth, and that both describe the same scene."""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from occlib.geometry import Rig
from occlib.lab.manifest import verify_manifest, write_manifest
from occlib.lab.rendering import load_mitsuba, render, scaled_camera
from occlib.lab.scenes import floor_board, load_scene
from occlib.lab.shapes import hit_distance, unit_mesh
from occlib.lab.surfaces import wood_texture
from occlib.lab.truth import ground_truth, silhouettes
from occlib.recordings import LAB

RECORDINGS = ("ball_and_oval", "robot", "calibration", "long_occlusion", "four_robots", "wooden_room")
PLAIN_TO_SEE = ("ball_and_oval", "robot", "long_occlusion", "four_robots")


def read_truth(name: str) -> dict:
    return json.loads((LAB / name / "truth.json").read_text())


def read_rgb(path: Path) -> np.ndarray:
    return cv2.imread(str(path))[..., ::-1]


def test_the_manifest_matches_the_files():
    assert verify_manifest(LAB) == []
    assert sum(p.stat().st_size for p in LAB.rglob("*") if p.is_file()) < 28_000_000


def test_the_manifest_notices_changed_missing_and_new_files(tmp_path):
    for name in ("same", "changed", "missing"):
        (tmp_path / name).write_text(name)
    write_manifest(tmp_path)
    assert verify_manifest(tmp_path) == []
    (tmp_path / "changed").write_text("CHANGED")
    (tmp_path / "missing").unlink()
    (tmp_path / "new").write_text("new")
    assert verify_manifest(tmp_path) == ["changed: changed", "missing: missing", "new: not in the manifest"]
    (tmp_path / "manifest.json").write_text("")
    assert "cannot be read" in verify_manifest(tmp_path)[0]
    with pytest.raises(ValueError, match=r"nowhere: no such folder \(data/lab has "):
        verify_manifest(tmp_path / "nowhere")


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_rig_is_that_of_its_scene_and_sees_the_whole_floor(name):
    scene, rig = load_scene(name), Rig.load(LAB / name / "rig.yaml")
    assert list(rig.cameras) == list(scene.rig.cameras)
    border = [[x, y] for x in np.linspace(*rig.floor.x, 21) for y in np.linspace(*rig.floor.y, 21)]
    for key, camera in rig.cameras.items():
        assert camera.inside(camera.floor_to_pixels(border)).all()
        np.testing.assert_allclose(camera.centre_m, scene.room.cameras[key].position, atol=1e-6)
        above = [[0.3, -0.2, 0.5], [-1.0, 1.0, 0.1]]
        np.testing.assert_allclose(camera.project(above), scene.rig[key].project(above), atol=1e-6)


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_is_complete(name):
    scene, truth = load_scene(name), read_truth(name)
    assert list(truth["frames"]) == [str(i) for i in range(scene.frames)]
    for camera in scene.rig.cameras:
        frames = sorted(p.stem for p in (LAB / name / "frames" / camera).glob("*.jpg"))
        assert frames == [f"{i:04d}" for i in range(scene.frames)]
        empty = sorted((LAB / name / "background" / camera).glob("*.png"))
        assert len(empty) == scene.background and (scene.background > 0 or name == "calibration")
        assert all(read_rgb(path).shape == (480, 640, 3) for path in empty)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_the_truth_on_disk_is_what_the_scene_says(name):
    scene, truth = load_scene(name), read_truth(name)
    frames = sorted({0, scene.frames // 2, scene.frames - 1})
    fresh = ground_truth(scene, frames=frames)
    assert truth["units"] == "m"
    assert json.loads(json.dumps(fresh.to_dict()["frames"])) == {str(f): truth["frames"][str(f)] for f in frames}
    assert fresh.to_dict()["roi"] == truth["roi"]


@pytest.mark.parametrize("name", RECORDINGS)
def test_objects_stay_on_the_floor_and_footprints_surround_them(name):
    scene = load_scene(name)
    for objects in read_truth(name)["frames"].values():
        for item in objects:
            polygon = np.array(item["footprint"])
            assert (abs(polygon) < [scene.rig.floor.x[1] - 0.15, scene.rig.floor.y[1] - 0.15]).all()
            np.testing.assert_allclose((polygon.max(0) + polygon.min(0)) / 2, [item["x"], item["y"]], atol=0.03)


def test_the_ball_hides_the_oval_from_the_left_only():
    for objects in read_truth("ball_and_oval")["frames"].values():
        ball, oval = objects
        assert ball["hidden_fraction"] == {"left": 0.0, "right": 0.0}
        assert oval["hidden_fraction"] == {"left": 1.0, "right": 0.0}
    right = silhouettes(load_scene("ball_and_oval"), 0)["right"]
    ball_grown = cv2.dilate(right["ball"][0].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert not (ball_grown & right["oval"][0]).any()


def test_the_long_occlusion_is_long():
    frames = read_truth("long_occlusion")["frames"].values()
    hidden = [o["hidden_fraction"] for objects in frames for o in objects if o["id"] == "rover"]
    assert max(len(list(run)) for total, run in groupby(h["left"] == 1.0 for h in hidden) if total) >= 60
    assert hidden[0]["left"] == hidden[-1]["left"] == 0.0
    assert all(h["right"] == 0.0 for h in hidden)


def test_four_robots_hide_one_another_from_both_sides():
    items = [o for objects in read_truth("four_robots")["frames"].values() for o in objects]
    for camera in ("left", "right"):
        assert any(o["hidden_fraction"][camera] == 1.0 for o in items)
        assert any(0.2 < o["hidden_fraction"][camera] < 0.8 for o in items)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLAIN_TO_SEE)
def test_the_pictures_differ_from_the_empty_room_where_the_truth_says(name):
    scene = load_scene(name)
    frame = scene.frames // 2
    for camera, masks in silhouettes(scene, frame).items():
        picture = read_rgb(LAB / name / "frames" / camera / f"{frame:04d}.jpg").astype(float)
        empty = read_rgb(LAB / name / "background" / camera / "00.png").astype(float)
        change = abs(picture - empty).max(axis=2)
        for _, visible in masks.values():
            inner = cv2.erode(visible.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            if inner.sum() > 30:
                assert np.percentile(change[inner], 2) > 30
        union = np.any([amodal for amodal, _ in masks.values()], axis=0)
        grown = cv2.dilate(union.astype(np.uint8), np.ones((61, 61), np.uint8)) > 0
        assert np.percentile(change[~grown], 99) < 16  # noise and a change of exposure


def test_the_wooden_room_hides_a_robot_behind_a_cabinet_that_is_hard_to_see():
    scene, frames = load_scene("wooden_room"), read_truth("wooden_room")["frames"].values()
    hidden = [o["hidden_fraction"] for objects in frames for o in objects if o["id"] == "rover"]
    assert sum(h["left"] == 1.0 for h in hidden) >= len(hidden) / 2 and all(h["right"] == 0.0 for h in hidden)
    masks = silhouettes(scene, 12)["left"]
    places = ("frames/left/0012.jpg", "background/left/00.png")
    frame, empty = (cv2.imread(str(LAB / "wooden_room" / p), cv2.IMREAD_GRAYSCALE) for p in places)
    change = cv2.absdiff(frame, empty)
    level, _ = cv2.threshold(change, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    missed = {name: float((change[visible] <= level).mean()) for name, (_, visible) in masks.items() if visible.any()}
    assert missed["drum"] < 0.1 and missed["tray"] < 0.1 and missed["cabinet"] > 0.5


def test_planks_run_along_x_and_differ_from_one_another():
    floor = wood_texture([196, 160, 118], (2.4, 1.4), (1.2, 0.14), cell=0.01)
    assert floor.shape == (140, 240, 3) and 0 < floor.min() and floor.max() <= 1
    assert (floor == wood_texture([196, 160, 118], (2.4, 1.4), (1.2, 0.14), cell=0.01)).all()
    rows, columns = floor.mean(axis=(1, 2)), floor.mean(axis=(0, 2))
    assert rows.std() > 2 * columns.std()
    assert (rows[::14] < rows[7::14]).all()  # the seams


def test_a_scene_changes_its_room_and_no_other():
    wooden, plain = load_scene("wooden_room").room, load_scene("four_robots").room
    assert wooden.wood is not None and wooden.window is not None and plain.wood is plain.window is None
    assert wooden.cameras == plain.cameras and wooden.vinyl == plain.vinyl


@pytest.mark.parametrize("shape", ["box", "ellipsoid", "cylinder"])
def test_rays_hit_a_shape_where_its_mesh_is(shape):
    vertices, faces = unit_mesh(shape)
    volume = np.einsum("ij,ij->i", vertices[faces[:, 0]], np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]]))
    expected = {"box": 1.0, "ellipsoid": np.pi / 6, "cylinder": np.pi / 4}[shape]
    assert abs(volume.sum()) / 6 == pytest.approx(expected, rel=0.005)
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    directions = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1], [1, 0.001, 0.3]])
    depth = hit_distance(shape, matrix, np.array([-3.0, 0, 0]), directions)
    assert depth[0] == pytest.approx(2)
    assert np.isinf(depth[1]) and np.isinf(depth[2])
    assert 2 <= depth[3] < 3


def test_a_smaller_camera_sees_the_same():
    camera = load_scene("robot").rig["left"]
    half = scaled_camera(camera, 0.5)
    points = [[0, 0, 0], [1, 1, 0.3]]
    np.testing.assert_allclose((camera.project(points) + 0.5) / 2, half.project(points) + 0.5, atol=1e-6)
    with pytest.raises(ValueError, match="scale"):
        scaled_camera(camera, 0)


def test_the_floor_board_lies_where_the_marks_file_says():
    scene = load_scene("calibration")
    content = yaml.safe_load((LAB / "calibration" / "floor_marks.yaml").read_text())
    corners = floor_board(scene).corners_m()
    np.testing.assert_allclose(corners[0], [*content["board"]["origin"], 0])
    assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(content["board"]["square"])
    assert corners.shape == (54, 3)
    for name, marks in content["marks"].items():
        assert 6 <= len(marks) <= 10
        for mark in marks:
            np.testing.assert_allclose(scene.rig[name].floor_to_pixels(mark["floor"])[0], mark["pixel"], atol=0.051)


def test_the_checkerboards_calibrate_to_the_rig():
    scene = load_scene("calibration")
    grid = np.zeros((54, 3), np.float32)
    grid[:, :2] = np.mgrid[:9, :6].T.reshape(-1, 2) * 0.09
    corners = []
    for path in sorted((LAB / "calibration" / "frames" / "left").glob("*.jpg")):
        found, points = cv2.findChessboardCornersSB(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), (9, 6))
        if found:
            corners.append(np.asarray(points, np.float32).reshape(-1, 1, 2))
    assert len(corners) >= 12
    rms, matrix, *_ = cv2.calibrateCamera([grid] * len(corners), corners, (640, 480), None, None)
    assert rms < 0.3
    np.testing.assert_allclose(matrix[[0, 1], [0, 1]], scene.rig["left"].matrix[[0, 1], [0, 1]], rtol=0.005)


def write_scene(folder: Path, **changes: object) -> Path:
    content = yaml.safe_load((LAB / "robot" / "scene.yaml").read_text())
    content["room"] = str(LAB / "room.yaml")
    (folder / "scene.yaml").write_text(yaml.safe_dump({**content, **changes}))
    return folder / "scene.yaml"


THING = {"id": "a", "label": "a", "colour": [1, 2, 3], "parts": [], "path": [{"frame": 0, "at": [0, 0]}]}
BOX = {"shape": "box", "centre": [0, 0, 0], "size": [1, 1, 1]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robots": 3}, "scene: expected the fields .* missing or not known: 'robots'"),
        ({"frames": -1}, "frames: expected a whole number"),
        ({"frames": "many"}, "frames: expected a whole number"),
        ({"cameras": ["ceiling"]}, "'ceiling' is not in the room"),
        ({"room": "nowhere.yaml"}, "cannot read"),
        (
            {"objects": [{"id": "a"}]},
            r"objects\[0\]: expected the fields .* missing or not known: 'label', 'colour', 'parts'",
        ),
        ({"objects": [THING]}, r"objects\[0\]: expected parts, and a path whose frames increase"),
        ({"objects": [{**THING, "parts": [BOX]}] * 2}, "objects: expected different ids, got .'a', 'a'"),
        (
            {"objects": [{**THING, "parts": [BOX], "path": [{"frame": 4, "at": [0, 0]}, {"frame": 4, "at": [1, 0]}]}]},
            r"objects\[0\]: expected parts, and a path whose frames increase, got frames \[4, 4\]",
        ),
        ({"fps": 0}, "fps: expected a finite number > 0, got 0"),
        ({"vinyl": {"roughness": "none"}}, "room.yaml: vinyl.roughness: expected a finite number > 0, got 'none'"),
        ({"wood": {"colour": [1, 2, 3]}}, r"room.yaml: wood: expected the fields .* missing or not known: 'roughness'"),
        ({"window": {"size": [0, 1]}}, "room.yaml: window: expected the fields .* missing or not known: 'centre'"),
        ({"objects": [{**THING, "parts": [{**BOX, "shape": "torus"}]}]}, "expected one of box"),
        ({"objects": [{**THING, "parts": [{**BOX, "size": [1, 0, 1]}]}]}, "three lengths > 0"),
        ({"objects": [{**THING, "parts": [BOX], "path": [{"frame": 0, "at": [0]}]}]}, "expected 2 finite numbers"),
        ({"objects": 5}, "objects: expected a list of objects, got 5"),
    ],
)
def test_a_bad_scene_says_what_is_wrong(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        load_scene(write_scene(tmp_path, **changes))
    assert "\n" not in str(caught.value)


def test_broken_yaml_and_a_missing_scene_say_so(tmp_path):
    (tmp_path / "scene.yaml").write_text("frames: [1")
    with pytest.raises(ValueError, match="not valid YAML"):
        load_scene(tmp_path)
    with pytest.raises(ValueError, match=r"no_such_scene: no such scene \(data/lab has ball_and_oval, "):
        load_scene("no_such_scene")
    with pytest.raises(ValueError, match="cannot read"):
        load_scene(tmp_path / "no_such_folder" / "scene.yaml")


def test_rendering_rejects_frames_that_do_not_exist(tmp_path):
    with pytest.raises(ValueError, match="frames: expected 0 to 5, got 6"):
        render(load_scene("robot"), tmp_path, frames=[6])
    with pytest.raises(ValueError, match="spp"):
        render(load_scene("robot"), tmp_path, spp=0)


@pytest.mark.slow
def test_a_small_render_resembles_the_recording(tmp_path):
    try:
        load_mitsuba()
    except ValueError as error:
        pytest.skip(str(error))
    scene = load_scene("ball_and_oval")
    out = render(scene, tmp_path / "small", frames=[0], spp=4, scale=0.1, progress=False)
    assert Rig.load(out / "rig.yaml")["left"].size == (64, 48)
    for camera in scene.rig.cameras:
        small = read_rgb(out / "frames" / camera / "0000.jpg").astype(float)
        shipped = read_rgb(LAB / "ball_and_oval" / "frames" / camera / "0000.jpg").astype(float)
        shipped = cv2.resize(shipped, (64, 48), interpolation=cv2.INTER_AREA)
        assert np.median(abs(small - shipped)) < 6
        assert np.corrcoef(small.ravel(), shipped.ravel())[0, 1] > 0.95
    assert json.loads((out / "truth.json").read_text())["frames"]["0"][1]["hidden_fraction"]["left"] == 1.0
