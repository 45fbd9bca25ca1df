"""Messages: what is encoded is decoded, and nothing is believed that comes over the wire."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from helpers.broadcasts import GRID, SESSION, THINGS, message
from occlib.geometry import Floor
from occlib.live.messages import LAST, MAX_HEADER, MAX_OBJECTS, OBJECT_FIELDS, decode, encode

numbers = st.floats(-1e6, 1e6)
names = st.text(st.characters(categories=["L", "N", "P"]), max_size=20)
things = st.fixed_dictionaries(
    {
        "id": st.integers(0, 10**9),
        **dict.fromkeys(("x", "y", "vx", "vy"), numbers),
        "area": st.floats(0, 100),
        "colour": st.lists(st.integers(0, 255), min_size=3, max_size=3),
        "label": st.none() | names,
        "hidden_in": st.lists(names, max_size=3),
    }
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(1, 2**53),
    st.floats(0, 1e11),
    st.tuples(st.integers(1, 12), st.integers(1, 12)),
    st.lists(things, max_size=4, unique_by=lambda thing: thing["id"]),
    st.integers(0, 2**32 - 1),
)
def test_what_is_encoded_is_decoded(sequence: int, at: float, shape: Any, entries: Any, seed: int) -> None:
    ny, nx = shape
    data = np.random.default_rng(seed).integers(-1, 101, shape).astype(np.int8)
    sent = message(sequence, t_capture=at, data=data, floor=Floor((-1, nx - 1), (2, 2 + ny), 1.0), objects=entries)
    frames = encode(sent)
    assert decode(frames) == sent
    assert decode([LAST + b"0" * 32, *frames[1:]]) == sent
    assert list(decode(frames).objects) == entries


def test_the_bytes_are_those_of_the_documentation() -> None:
    topic, header, cells = encode(message())
    assert topic == b"occlib/1/map"
    assert json.loads(header) == {
        "session": SESSION,
        "sequence": 1,
        "t_capture": 10.0,
        "t_sent": 10.5,
        "floor": {"x": [-2.0, 2.0], "y": [-1.5, 1.5], "resolution": 0.1},
        "width": 40,
        "height": 30,
        "objects": THINGS,
    }
    assert cells == bytes(int(v) % 256 for row in GRID for v in row)


def test_the_size_travels_and_publishers_that_do_not_know_it_are_understood() -> None:
    for size in (None, 0.03):
        sent = message(objects=[{**THINGS[0], "size": size}])
        assert json.loads(encode(sent)[1])["objects"] == [{**THINGS[0], "size": size}]
        assert decode(encode(sent)).objects == ({**THINGS[0], "size": size},)
    assert "size" not in decode(encode(message())).objects[0]
    for wrong in (-0.1, "big", float("nan")):
        with pytest.raises(ValueError, match=r"objects\[0\].size: expected a number from 0 to 1e\+12, got"):
            message(objects=[{**THINGS[0], "size": wrong}])


def test_what_coasts_travels_beside_the_objects_if_anything_does() -> None:
    assert "coasting" not in json.loads(encode(message(coasting=[]))[1]) and message(coasting=[]) == message()
    assert message().coasting == decode(encode(message())).coasting == ()
    sent = message(objects=THINGS[:1], coasting=THINGS[1:])
    assert json.loads(encode(sent)[1])["coasting"] == THINGS[1:]
    got = decode(encode(sent))
    assert got == sent != message(objects=THINGS[:1])
    assert (list(got.objects), list(got.coasting)) == (THINGS[:1], THINGS[1:])
    assert decode([encode(sent)[0], spoilt(coasting=[]), encode(sent)[2]]).coasting == ()
    with pytest.raises(ValueError, match=r"coasting\[0\].x: expected a number"):
        message(coasting=[{**THINGS[0], "id": 3, "x": "far"}])
    with pytest.raises(ValueError, match="coasting: expected other ids than those of the objects, got one of them"):
        message(objects=THINGS[:1], coasting=THINGS)
    with pytest.raises(ValueError, match="coasting: expected different ids, got one twice"):
        message(objects=[], coasting=[THINGS[0]] * 2)


def test_numbers_of_numpy_may_be_sent() -> None:
    objects = [{**THINGS[0], "x": np.float64(0.5), "colour": np.array([200, 30, 30])}, THINGS[1]]
    assert message(objects=objects, t_capture=np.float64(10.0)) == message()


def test_a_message_does_not_change_with_what_it_was_made_of() -> None:
    grid, entries = GRID.copy(), json.loads(json.dumps(THINGS))
    made = message(data=grid, objects=entries)
    grid[0, 0], entries[0]["x"] = 50, 9.0
    entries[0]["hidden_in"].append("cam3")
    assert made == message()
    with pytest.raises(ValueError, match="read-only"):
        made.data[0, 0] = 0
    assert made != message(2)
    assert made != "a message"


def spoilt(**changes: Any) -> bytes:
    """A header with other fields; ``None`` leaves one out."""
    fields = {**json.loads(encode(message())[1]), **changes}
    return json.dumps({name: value for name, value in fields.items() if value != "left out"}).encode()


def spoilt_thing(**changes: Any) -> bytes:
    return spoilt(objects=[{**THINGS[0], **changes}])


HEADERS: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "header: expected JSON"),
    "not JSON": (b"{'a': 1}", "header: expected JSON"),
    "not UTF-8": (b'{"\xff": 1}', "header: expected JSON"),
    "too long": (b" " * (MAX_HEADER + 1), "header: expected at most 1048576 bytes, got 1048577"),
    "too deep": (b"[" * 100_000, "header: expected JSON"),
    "a list": (b"[]", "header: expected the fields"),
    "a field twice": (b'{"a": 1, "a": 1}', "a field is there twice"),
    "NaN": (spoilt(t_sent=float("nan")), "NaN is not a number"),
    "Infinity": (spoilt(t_sent=float("inf")), "Infinity is not a number"),
    "1e999": (spoilt(t_sent=12345.0).replace(b"12345.0", b"1e999"), "t_sent: expected a number"),
    "4301 digits": (spoilt(t_sent=12345).replace(b"12345", b"1" * 4301), "header: expected JSON"),
    "400 digits": (spoilt(t_sent=10**400), "t_sent: expected a number"),
    "a field more": (spoilt(more=1), "header: expected the fields .* not known: 'more'"),
    "a field less": (spoilt(session="left out"), "header: expected the fields .* missing or not known: 'session'"),
    "session": (spoilt(session="../../etc/passwd"), "session: expected 32 hexadecimal digits"),
    "session type": (spoilt(session=3), "session: expected 32 hexadecimal digits, got 3"),
    "sequence 0": (spoilt(sequence=0), "sequence: expected a whole number from 1"),
    "sequence true": (spoilt(sequence=True), "sequence: expected a whole number from 1"),
    "sequence 1.0": (spoilt(sequence=1.0), "sequence: expected a whole number from 1"),
    "time before 1970": (spoilt(t_capture=-1.0), "t_capture: expected a number from 0"),
    "time text": (spoilt(t_capture="1"), "t_capture: expected a number"),
    "floor": (spoilt(floor=[0, 1]), "floor: expected the fields x, y, resolution"),
    "floor.x": (spoilt(floor={"x": [0, 1, 2], "y": [0, 1], "resolution": 1}), "floor.x: expected a list of 2 to 2"),
    "floor upside down": (spoilt(floor={"x": [1, 0], "y": [0, 1], "resolution": 1}), "floor.x: expected .* min < max"),
    "floor too fine": (spoilt(floor={"x": [0, 4], "y": [0, 3], "resolution": 1e-300}), "floor: .* too many"),
    "resolution 0": (spoilt(floor={"x": [0, 4], "y": [0, 3], "resolution": 0}), "floor.resolution: expected"),
    "width": (spoilt(width=41), "width, height: expected 40, 30 for this floor, got 41, 30"),
    "height": (spoilt(height="30"), "height: expected a whole number"),
    "objects": (spoilt(objects={}), "objects: expected a list"),
    "too many": (spoilt(objects=[0] * (MAX_OBJECTS + 1)), "objects: expected a list of 0 to 2000"),
    "object": (spoilt(objects=[0]), r"objects\[0\]: expected the fields id, x, y"),
    "object field": (spoilt_thing(__class__="x"), r"objects\[0\]: .* not known: '__class__'"),
    "id twice": (spoilt(objects=[THINGS[0], THINGS[0]]), "objects: expected different ids"),
    "id": (spoilt_thing(id=-1), r"objects\[0\].id: expected a whole number"),
    "x": (spoilt_thing(x=None), r"objects\[0\].x: expected a number"),
    "area": (spoilt_thing(area=-0.1), r"objects\[0\].area: expected a number from 0"),
    "colour": (spoilt_thing(colour=[0, 0]), r"objects\[0\].colour: expected a list of 3 to 3"),
    "colour 256": (spoilt_thing(colour=[0, 0, 256]), r"objects\[0\].colour: expected a whole number from 0 to 255"),
    "label": (spoilt_thing(label=1), r"objects\[0\].label: expected at most 200 printable"),
    "label too long": (spoilt_thing(label="x" * 201), r"objects\[0\].label: expected at most 200 printable"),
    "escape codes": (spoilt_thing(label="\x1b[2J"), r"objects\[0\].label: expected at most 200 printable"),
    "half a pair": (spoilt_thing(label="\ud800"), r"objects\[0\].label: expected at most 200 printable"),
    "hidden_in": (spoilt_thing(hidden_in="cam1"), r"objects\[0\].hidden_in: expected a list"),
    "hidden_in numbers": (spoilt_thing(hidden_in=[1]), r"objects\[0\].hidden_in: expected at most 200 printable"),
}


@pytest.mark.parametrize("case", HEADERS)
def test_a_wrong_header(case: str) -> None:
    header, match = HEADERS[case]
    topic, _, cells = encode(message())
    with pytest.raises(ValueError, match=match) as error:
        decode([topic, header, cells])
    assert len(str(error.value)) < 300
    assert str(error.value).isascii() and "\n" not in str(error.value)


def test_wrong_frames() -> None:
    topic, header, cells = encode(message())
    for frames in ([], [topic], [topic, header], [topic, header, cells, b""]):
        with pytest.raises(ValueError, match=f"frames: expected 3, got {len(frames)}"):
            decode(frames)
    for other in (b"", b"occlib/2/map", b"occlib/1/map ", b"occlib/1/last/", LAST + b"g" * 32, LAST + b"0" * 33):
        with pytest.raises(ValueError, match="topic: expected occlib/1/map, got"):
            decode([other, header, cells])
    for wrong in (b"", cells[:-1], cells + b"\0"):
        with pytest.raises(ValueError, match=f"cells: expected 1200 bytes, got {len(wrong)}"):
            decode([topic, header, wrong])
    for value in (b"\xfe", b"\x65", b"\x80"):
        with pytest.raises(ValueError, match="data: expected values from -1 to 100"):
            decode([topic, header, cells[:-1] + value])


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@pytest.mark.slow
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_whatever_comes_is_a_message_or_a_value_error(data: st.DataObject) -> None:
    frames = encode(message())
    kind = data.draw(st.sampled_from(["random", "bytes", "field"]))
    if kind == "random":
        frames = data.draw(st.lists(st.binary(max_size=200) | st.sampled_from(frames), max_size=5))
    elif kind == "bytes":
        index = data.draw(st.integers(0, 2))
        damaged = bytearray(frames[index])
        for _ in range(data.draw(st.integers(1, 4))):
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
        frames[index] = bytes(damaged)
    else:
        fields, value = json.loads(frames[1]), data.draw(json_values)
        place = data.draw(st.sampled_from([*fields, *OBJECT_FIELDS]))
        (fields if place in fields else fields["objects"][0])[place] = value
        frames[1] = json.dumps(fields).encode()
    try:
        got = decode(frames)
    except ValueError as error:
        assert "\n" not in str(error)
    else:
        assert decode(encode(got)) == got
