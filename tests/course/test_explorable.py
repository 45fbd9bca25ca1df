"""The explorable without a browser: one small module, a page that stands alone, and Python's answer is the library's."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from occlib.course.explorable import (
    crowd_of,
    explorable,
    library_map,
    preset_scene,
    presets,
    seen_cells,
    standalone_page,
)
from occlib.course.explorable.page import MODULE, module_source
from occlib.course.explorable.scene import checked_cameras, checked_objects, overhead_camera
from occlib.geometry import Floor
from occlib.lab import FLOOR, ghost_regions, shadow_mask, wall_rig
from occlib.lab.ghosts import LEAST_AREA_M2
from occlib.localization import find_regions
from occlib.occlusion import fuse

CAMERA = {"name": "A", "x": -3.0, "y": 0.0, "height": 2.5}
OBJECT = {"x": 0.5, "y": 0.0, "radius": 0.2, "height": 0.4}


# --- the module and the page ---------------------------------------------------------------------------------------
def test_the_module_is_small_and_needs_nothing() -> None:
    assert MODULE.stat().st_size < 40_000
    source = module_source()
    assert not re.search(r"\bimport\b|\bfetch\b|XMLHttpRequest|WebSocket|\beval\b|url\(", source)
    assert re.findall(r"https?://[^\"']+", source) == ["http://www.w3.org/2000/svg"]  # a name, nobody asks there
    assert re.findall(r"^export (?:default|const \w+)", source, re.M) == ["export const presets", "export const geometry", "export default"]  # fmt: skip


@pytest.mark.parametrize("preset", list(presets()))
def test_a_page_stands_alone(preset: str) -> None:
    page = standalone_page(preset)
    assert not re.search(r"<link|<script[^>]+src|<img|@import|\bexport ", page)
    assert page.count("</script>") == 1
    state = json.loads(re.search(r"^const state = (.*);$", page, re.M)[1])  # type: ignore[index]
    assert state["preset"] == preset
    assert "<noscript>" in page


def test_presets_are_five_and_have_one_sentence_each() -> None:
    assert list(presets()) == ["hide the small one", "make a ghost", "a third camera", "raise the cameras", "one mask has a hole"]  # fmt: skip
    for name, preset in presets().items():
        assert preset["caption"].count(". ") == 0 and preset["caption"].endswith(".")
        scene = preset_scene(name)
        assert checked_cameras(scene["cameras"]) == scene["cameras"]
        assert checked_objects(scene["objects"]) == scene["objects"]


# --- the library's answer --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("preset", "regions", "ghosts", "explained"),
    [
        ("hide the small one", 2, 0, 2),
        ("make a ghost", 3, 1, 2),
        ("a third camera", 2, 0, 2),
        ("one mask has a hole", 1, 0, 1),
    ],
)
def test_the_library_tells_the_presets_story_too(preset: str, regions: int, ghosts: int, explained: int) -> None:
    found = library_map(**preset_scene(preset))
    assert found.explained is not None
    assert (found.regions, found.ghosts, len(found.explained)) == (regions, ghosts, explained)


def test_the_map_is_what_the_labs_own_cameras_see() -> None:
    rig = wall_rig(3)
    cameras = [
        dict(zip(("name", "x", "y", "height"), (name, *camera.centre_m.tolist()), strict=True))
        for name, camera in zip("ABC", rig.cameras.values(), strict=True)
    ]
    # off the cells' symmetry: no cell's centre lies on the very rim of a shadow
    objects = [{**each, "x": each["x"] + 0.0037} for each in preset_scene("make a ghost")["objects"]]
    crowd = crowd_of(objects)
    shadows = [np.any([shadow_mask(c, each, FLOOR) for each in crowd], axis=0) for c in rig.cameras.values()]
    occupied = fuse(shadows, "and")
    found = library_map(cameras, objects, explain=False)
    assert np.array_equal(found.occupied, occupied)
    assert found.ghosts == ghost_regions(occupied, crowd, FLOOR)
    assert found.regions == len(find_regions(occupied, min_area=LEAST_AREA_M2 / FLOOR.cell_area)[1])
    assert found.explained is None


def test_a_camera_overhead_sees_the_shadow_itself() -> None:
    floor = Floor((-1, 1), (-1, 1), 0.05)
    camera = overhead_camera({**CAMERA, "x": -0.4, "y": 0.3}, floor)
    assert camera.centre_m == pytest.approx([-0.4, 0.3, 2.5])
    assert camera.floor_to_pixels([[-2 + 0.025, 2 - 0.025]])[0] == pytest.approx([0, 0])


def test_a_camera_sees_what_lies_in_its_angle_of_view() -> None:
    seen = seen_cells({**CAMERA, "view": 60}, FLOOR)
    places = FLOOR.cell_centres_m() - [-3, 0]
    assert np.array_equal(seen.ravel(), np.degrees(np.abs(np.arctan2(places[:, 1], places[:, 0]))) <= 30)
    assert seen_cells({**CAMERA, "view": 360, "x": 0.5}, FLOOR).all()


def test_runs_give_the_map_back() -> None:
    found = library_map(**preset_scene("raise the cameras"), explain=False)
    runs = found.runs()
    assert sum(runs) == found.occupied.size
    assert np.array_equal(np.repeat(np.arange(len(runs)) % 2 == 1, runs), found.occupied.ravel())


# --- the widget --------------------------------------------------------------------------------------------------------
def test_what_the_reader_moves_is_answered() -> None:
    pytest.importorskip("anywidget")
    room = explorable("make a ghost")
    assert (room.answer["regions"], room.answer["ghosts"]) == (3, 1)
    moved = [{**room.objects[0], "height": 0.4}, room.objects[1]]
    room.set_state({"objects": moved, "cameras": room.cameras})
    assert room.answer["objects"] == moved == room.objects
    assert room.answer["ghosts"] == 0
    assert sum(room.answer["runs"]) == 30_000
    room.floor = {"x": [-2, 2], "y": [-1.5, 1.5], "resolution": 0.05}
    assert sum(room.answer["runs"]) == 80 * 60


def test_own_cameras_and_objects_replace_the_presets() -> None:
    pytest.importorskip("anywidget")
    room = explorable(cameras=[CAMERA, {**CAMERA, "name": "C", "y": 2.0}], objects=[OBJECT])
    assert [camera["view"] for camera in room.cameras] == [150, 150]
    assert room.objects[0]["missed"] == []


def test_an_executed_notebook_shows_a_frame_that_needs_no_kernel() -> None:
    pytest.importorskip("anywidget")
    data, _ = explorable("make a ghost")._repr_mimebundle_()
    assert set(data) == {"text/plain", "text/html", "application/vnd.jupyter.widget-view+json"}
    assert data["text/html"].startswith("<iframe srcdoc=") and "</script" not in data["text/html"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"preset": "nothing"}, "preset: expected one of hide the small one"),
        ({"cameras": [CAMERA]}, "cameras: expected 2 to 4 cameras, got 1"),
        ({"cameras": [CAMERA, CAMERA]}, "cameras: expected each name once, got A, A"),
        ({"cameras": [CAMERA, {**CAMERA, "name": "E"}]}, "cameras: name: expected one of A, B, C, D, got 'E'"),
        ({"cameras": [CAMERA, {"name": "B"}]}, "cameras: expected the keys name, x, y, height, view, got name"),
        (
            {"cameras": [CAMERA, {**CAMERA, "name": "B", "height": 0}]},
            "cameras: height: expected m from 0.1 to 20, got 0",
        ),
        ({"objects": [OBJECT] * 9}, "objects: expected at most 8, got 9"),
        ({"objects": [{**OBJECT, "radius": float("nan")}]}, "objects: radius: expected m from 0.01 to 5, got nan"),
        ({"objects": [{**OBJECT, "missed": ["Z"]}]}, "objects: missed: expected one of A, B, C, D, got 'Z'"),
        ({"objects": [{**OBJECT, "missed": None}]}, "objects: missed: expected a list of names, got None"),
        ({"objects": "none"}, "objects: expected a list of dictionaries, got 'none'"),
        ({"floor": Floor((-2, 2), (-2, 2), 0.005)}, "floor: expected at most 200000 cells, got 800 x 800"),
    ],
)
def test_wrong_input_is_refused_in_one_line(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        explorable(**arguments)


@pytest.mark.parametrize(
    "message",
    [
        {"cameras": [CAMERA]},
        {"cameras": None},
        {"objects": [{**OBJECT, "x": None}]},
        {"objects": [{**OBJECT, "missed": None}]},
        {"floor": {"x": [0, 1]}},
    ],
)
def test_a_malformed_message_leaves_the_room_as_it_was(message: dict[str, Any]) -> None:
    traitlets = pytest.importorskip("traitlets")
    room = explorable("make a ghost")
    before = (room.cameras, room.objects, room.floor, room.answer)
    with pytest.raises(traitlets.TraitError):
        room.set_state(message)
    assert (room.cameras, room.objects, room.floor, room.answer) == before


def test_without_anywidget_the_extra_is_named(hide_package: Callable[[str], None]) -> None:
    from occlib.course.explorable import widget

    widget._widget_class.cache_clear()
    hide_package("anywidget")
    with pytest.raises(ValueError, match=r'needs the extra notebooks: pip install "occlib\[notebooks\]"'):
        explorable()
