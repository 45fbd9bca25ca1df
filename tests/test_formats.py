"""Files as typed structures: what is read and written, and every malformed file named in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib import formats
from occlib.base.files import read_yaml
from occlib.formats import DetectedObject, LabManifest, TrueObject, Truth, convert
from occlib.formats.decoding import LARGEST, Metres, Polygon
from occlib.formats.scene import RoomFile, SceneFile
from occlib.recordings import DATA, LAB, ROOMS
from occlib.tracking import ObjectVector

ROOT = Path(__file__).parents[1]
TRUTH_FILES = [path for folder in (DATA, LAB, ROOMS) for path in sorted(folder.glob("*/truth.json"))]


# --- objects.jsonl ---------------------------------------------------------------------------------
def test_objects_file_reads_back(tmp_path: Path) -> None:
    lines = [
        {"frame": 3, "time": 0.3, "objects": [{"id": 1, "x": 1, "y": 2.0, "hidden_in": None, "mass": "unknown"}]},
        {"frame": 4, "objects": []},
    ]
    path = tmp_path / "objects.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)) + "\n\n")
    assert formats.load_objects(path) == {3: [DetectedObject(id=1, x=1.0, y=2.0)], 4: []}


def test_what_the_tracker_writes_is_read_with_every_field(tmp_path: Path) -> None:
    vector = ObjectVector(1, (0.5, 1.0), (0.1, 0.0), 0.04, (200, 30, 30), "oval", ("cam2",), size_m2=0.03007)
    path = tmp_path / "objects.jsonl"
    path.write_text(json.dumps({"frame": 0, "objects": [vector.to_dict(), ObjectVector.to_dict(vector)]}))
    ((first, _),) = formats.load_objects(path).values()
    assert msgspec.structs.asdict(first) == {**vector.to_dict(), "colour": (200, 30, 30), "hidden_in": ("cam2",)}
    assert first.size == 0.0301
    assert list(vector.to_dict()) == list(DetectedObject.__struct_fields__)


def test_what_coasts_is_read_but_is_none_of_the_objects(tmp_path: Path) -> None:
    path = tmp_path / "objects.jsonl"
    path.write_text(
        '{"frame": 3, "objects": [{"x": 1, "y": 2}], "coasting": [{"id": 4, "x": 0, "y": 0, "label": null}]}'
    )
    assert formats.load_objects(path) == {3: [DetectedObject(x=1.0, y=2.0)]}
    path.write_text('{"frame": 3, "objects": [], "coasting": [{"x": 1}]}')
    with pytest.raises(ValueError, match=r"objects.jsonl:1: coasting\[0\].y: expected finite metres, got None"):
        formats.load_objects(path)


GOOD = b'{"frame": 1, "objects": []}\n'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (GOOD + b"{nope", r":2: not valid JSON \(Expecting property name"),
        (GOOD + b"[" * 100_000, r":2: not valid JSON"),
        (GOOD + b"\xff\xfe", r":2: not UTF-8 text"),
        (GOOD + GOOD, r":2: frame 1 comes twice"),
        (GOOD + b'{"frame": ' + b"9" * 5000 + b"}", r":2: not valid JSON"),
        (GOOD + b"[]", r":2: expected an object with an integer 'frame'"),
        (b'{"frame": true, "objects": []}', r":1: expected an object with an integer 'frame'"),
        (b'{"frame": 1}', r":1: objects: expected a list, got None"),
        (b'{"frame": 1, "objects": [{"x": 1}]}', r":1: objects\[0\].y: expected finite metres, got None"),
        (
            b'{"frame": 1, "objects": [{"x": NaN, "y": 0}]}',
            r":1: objects\[0\].x: expected finite metres, got nan",
        ),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": "2"}]}',
            r":1: objects\[0\].y: expected finite metres, got '2'",
        ),
        (b'{"frame": 1, "objects": [7]}', r":1: objects\[0\]: expected a mapping with x and y, got 7"),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": 0, "area": -1}]}',
            r":1: objects\[0\].area: expected square metres >= 0, got -1",
        ),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": 0, "size": "big"}]}',
            r":1: objects\[0\].size: expected square metres >= 0, got 'big'",
        ),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": 0, "id": [1]}]}',
            r":1: objects\[0\].id: expected a name or number, got \[1\]",
        ),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": 0, "colour": "red"}]}',
            r":1: objects\[0\].colour: expected \[r, g, b\].*, got 'red'",
        ),
        (b'{"frame": 1, "objects": [], "time": "now"}', r":1: time: expected a finite number, got 'now'"),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": 0, "hidden_in": "left"}]}',
            r":1: objects\[0\].hidden_in: expected a list of cameras, got 'left'",
        ),
        (
            b'{"frame": 1, "objects": [{"x": 1, "y": 0, "hidden_in": [3]}]}',
            r":1: objects\[0\].hidden_in: expected a list of cameras, got \[3\]",
        ),
    ],
)
def test_malformed_objects_name_the_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "objects.jsonl"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"objects.jsonl{message}"):
        formats.load_objects(path)


# --- truth.json ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "expected a mapping"),
        ('{"units": "mm", "frames": {}}', "truth.units: expected 'm', got 'mm'"),
        ('{"frames": {"one": []}}', "truth.frames: expected whole numbers as keys, got 'one'"),
        ('{"frames": {"1": [], "01": []}}', "truth.frames: frame 1 comes twice"),
        ('{"frames": {"0": [{"x": 1}]}}', r"truth.frames.0\[0\].y: expected finite metres, got None"),
        (
            '{"frames": {"7": [{"x": 1, "y": 2}, {"x": NaN, "y": 0}]}}',
            r"truth.frames.7\[1\].x: expected finite metres, got nan",
        ),
        ('{"frames": {"0": [{"x": 1, "y": 1e999}]}}', r"truth.frames.0\[0\].y: expected finite metres, got inf"),
        ('{"frames": {"0": [{"x": true, "y": 1}]}}', r"truth.frames.0\[0\].x: expected finite metres, got True"),
        ('{"frames": {"0": [3]}}', r"truth.frames.0\[0\]: expected a mapping with x and y, got 3"),
        (
            '{"frames": {"0": [{"x": 1, "y": 0, "hidden_fraction": {"left": "much"}}]}}',
            r"truth.frames.0\[0\].hidden_fraction.left: expected a finite number, got 'much'",
        ),
        (
            '{"frames": {"0": [{"x": 1, "y": 0, "hidden_fraction": [1]}]}}',
            r"truth.frames.0\[0\].hidden_fraction: expected a mapping of cameras to numbers, got \[1\]",
        ),
        ('{"frames": {}, "roi": 5}', "truth.roi: expected a mapping of names to polygons, got 5"),
        ('{"frames": {"0": {}}}', "truth.frames.0: expected a list, got {}"),
        ('{"frames": {}, "roi": {"a": [[0, 0], [1, 1]]}}', "truth.roi.a: expected three or more finite points"),
        ('{"frames": {}, "roi": {"a": "hall"}}', "truth.roi.a: expected three or more finite points"),
    ],
)
def test_malformed_truth_names_the_field(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "truth.json"
    path.write_text(content)
    with pytest.raises(ValueError, match=f"truth.json: .*{message}"):
        formats.load_truth(path)


def test_missing_files_are_one_line_errors(tmp_path: Path) -> None:
    for load in (formats.load_objects, formats.load_truth):
        with pytest.raises(ValueError, match=r"none.json: cannot read .No such file"):
            load(tmp_path / "none.json")


def test_truth_has_whole_frames_in_order_and_compares_by_value(tmp_path: Path) -> None:
    content = {
        "frames": {"10": [], "0009": [{"x": 1, "y": 2, "footprint": None, "mass": 3}]},
        "roi": None,
        "by": "hand",
    }
    truth = Truth.from_dict(content)
    assert list(truth.frames) == [9, 10]
    assert truth == Truth({9: [TrueObject(x=1.0, y=2.0)], 10: []})
    assert truth == Truth.from_dict({"frames": {10: [], 9: [{"x": 1, "y": 2}]}})
    assert truth != Truth({9: [TrueObject(x=1.0, y=2.5)], 10: []})
    assert list(truth.select([10, 11]).frames) == [10]


def test_a_selection_keeps_the_regions() -> None:
    truth = Truth({0: [], 1: []}, {"west": ((0, 0), (1, 0), (1, 1))})
    assert truth.select([1]).region("west") == ((0, 0), (1, 0), (1, 1))
    with pytest.raises(ValueError, match="roi: 'hall' is not in the truth, which has west"):
        truth.region("hall")


@pytest.mark.parametrize("path", TRUTH_FILES, ids=lambda path: path.parent.name)
def test_truth_is_written_as_it_was_read(path: Path, tmp_path: Path) -> None:
    truth = formats.load_truth(path)
    assert formats.load_truth(truth.save(tmp_path / "truth.json")) == truth
    assert Truth.from_dict(truth.to_dict()) == truth
    assert truth.to_dict() == json.loads(path.read_text())


# --- rig, scene, manifests -------------------------------------------------------------------------
def test_yaml_numbers_may_be_text_but_not_words() -> None:
    content = read_yaml(LAB / "robot" / "rig.yaml")
    assert isinstance(read_yaml_text("1e-2"), str)  # YAML 1.1 wants 1.0e-2
    content["floor"]["resolution"] = "1e-2"
    assert formats.rig_file(content).floor.resolution == 0.01
    for word in ("fine", "nan", "inf", True, float("nan")):
        content["floor"]["resolution"] = word
        with pytest.raises(ValueError, match=r"floor.resolution: expected a finite number, got "):
            formats.rig_file(content)


def read_yaml_text(text: str) -> Any:
    import yaml

    return yaml.safe_load(text)


def test_cameras_may_be_called_by_numbers_and_other_fields_are_skipped() -> None:
    content = read_yaml(LAB / "robot" / "rig.yaml")
    content |= {"cameras": {0: {**content["cameras"]["left"], "maker": "x"}}, "room": "B2"}
    rig = formats.rig_file(content)
    assert list(rig.cameras) == ["0"] and rig.fps == 10.0


@pytest.mark.parametrize("path", sorted(LAB.glob("*/scene.yaml")), ids=lambda path: path.parent.name)
def test_scenes_and_their_room_are_what_the_structures_say(path: Path) -> None:
    assert convert(read_yaml(path), SceneFile).frames > 0
    assert convert(read_yaml(LAB / "room.yaml"), RoomFile).units == "m"


@pytest.mark.parametrize("folder", [LAB, ROOMS], ids=lambda folder: folder.name)
def test_a_manifest_is_what_the_structure_says(folder: Path) -> None:
    manifest = convert(json.loads((folder / "manifest.json").read_text()), LabManifest)
    assert manifest.bytes == sum(entry.bytes for entry in manifest.files.values())


# --- errors ----------------------------------------------------------------------------------------
class Inner(msgspec.Struct, forbid_unknown_fields=True):
    at: Metres
    outline: Polygon | None = None

    def __post_init__(self) -> None:
        if self.at == 13:
            raise ValueError("at: expected better luck, got 13")
        if self.at == 14:
            raise ValueError("expected another, got 14")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"at": "x"}, "inner.at: expected finite metres, got 'x'"),
        ({}, "inner: expected the fields at, outline; missing or not known: 'at'"),
        ({"at": 1, "by": 2}, "inner: expected the fields at, outline; missing or not known: 'by'"),
        (5, "inner: expected the fields at, outline, got 5"),
        ({"at": 13}, "inner.at: expected better luck, got 13"),
        ({"at": 14}, "inner: expected another, got 14"),
        (
            {"at": 1, "outline": [[0, 0], [1, "1"], [1, 1]]},
            "inner.outline: expected three or more finite points [x, y], got [[0, 0], [1, '1'], [1, 1]]",
        ),
        ({"at": 10**400}, "inner.at: expected finite metres, got 1000000"),
        ({"at": "\ud800\n" + 100 * "y"}, "inner.at: expected finite metres, got '\\ud800\\nyyyy"),
    ],
)
def test_an_error_names_the_field_what_came_and_what_was_expected(value: Any, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        convert(value, Inner, "inner")
    assert str(caught.value).startswith(message)
    assert len(str(caught.value)) < 150 and "\n" not in str(caught.value)


def test_a_list_is_named_by_itself_and_a_structure_in_it_by_its_place() -> None:
    with pytest.raises(ValueError, match=r"^all\[1\].at: expected finite metres, got None$"):
        convert([{"at": 1}, {"at": None}], list[Inner], "all")
    with pytest.raises(ValueError, match=r"^all.b: expected finite metres, got 'x'$"):
        convert({"a": [1, 2], "b": [1, "x"]}, dict[str, list[Metres]], "all")
    with pytest.raises(ValueError, match=r"^malformed|content: malformed, got"):
        convert("x", Annotated[int, msgspec.Meta(ge=0)])


def test_numbers_of_numpy_are_numbers() -> None:
    assert convert({"at": np.float32(1.5)}, Inner) == Inner(1.5)
    assert convert(np.array([[0, 0], [1, 0], [1, 1]]), Polygon) == ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["x", "y", "footprint", "id"]), inner),
    max_leaves=8,
)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.dictionaries(st.sampled_from(["0", "1", "x"]), st.lists(json_values, max_size=3) | json_values), json_values)
def test_whatever_comes_is_a_truth_or_a_line_of_error(frames: Any, regions: Any) -> None:
    try:
        truth = Truth.from_dict({"frames": frames, "roi": regions})
    except ValueError as error:
        assert str(error).startswith("truth") and "\n" not in str(error) and "malformed" not in str(error)
    else:
        assert all(abs(each.x) <= LARGEST for objects in truth.frames.values() for each in objects)
        assert Truth.from_dict(truth.to_dict()) == truth


# --- schemas ---------------------------------------------------------------------------------------
def test_the_schemas_in_docs_are_up_to_date(tmp_path: Path) -> None:
    """If this fails: python -c "from occlib import formats; formats.write_schemas('docs/schemas')"."""
    written = {path.name: path.read_bytes() for path in formats.write_schemas(tmp_path)}
    assert written == {path.name: path.read_bytes() for path in (ROOT / "docs" / "schemas").glob("*.json")}


def test_the_schemas_describe_the_files_that_ship() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    samples = {
        "rig": [read_yaml(path) for folder in (LAB, ROOMS) for path in folder.glob("*/rig.yaml")],
        "truth": [json.loads(path.read_text()) for path in TRUTH_FILES],
        "scene": [read_yaml(path) for folder in (LAB, ROOMS) for path in folder.glob("*/scene.yaml")],
        "room": [read_yaml(path) for path in (LAB / "room.yaml", *ROOMS.glob("*/room.yaml"))],
        "lab_manifest": [json.loads((folder / "manifest.json").read_text()) for folder in (LAB, ROOMS)],
    }
    entry = ObjectVector(1, (0.5, 1.0), (0.1, 0.0), 0.04, (200, 30, 30)).to_dict()
    samples["objects"] = [{"frame": 3, "time": 0.3, "objects": [entry], "coasting": [{**entry, "id": 2}]}]
    for name, contents in samples.items():
        for content in contents:
            jsonschema.validate(content, formats.json_schema(name))
    with pytest.raises(jsonschema.ValidationError, match="is a required property"):
        jsonschema.validate({"frames": {"0": [{"x": 1}]}}, formats.json_schema("truth"))
    with pytest.raises(jsonschema.ValidationError, match="is not of type 'array'"):
        jsonschema.validate({"frame": 3, "objects": [], "coasting": entry}, formats.json_schema("objects"))
