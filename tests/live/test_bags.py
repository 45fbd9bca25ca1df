"""Bags read back as they were written: by readers written here from the formats' definitions, and by rosbags' own."""

from __future__ import annotations

import hashlib
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from occlib.cli import main
from occlib.geometry import Floor
from occlib.live.bags import FORMATS, grid_message, nanoseconds, save_bag
from occlib.mapping import OccupancyMap, load_map

pytest.importorskip("rosbags.typesys", reason="rosbags is not installed: pip install 'occlib[ros]'")

FLOOR = Floor((-1.5, 0.5), (2.0, 3.25), 0.25)  # 5 x 8 cells


def maps() -> list[tuple[float, OccupancyMap]]:
    """Three maps at 0, 0.1 and 1234567.891 s that differ in every way a reader could get wrong."""
    rng = np.random.default_rng(3)
    grids = [OccupancyMap(rng.integers(-1, 101, FLOOR.shape).astype(np.int8), FLOOR) for _ in range(3)]
    return list(zip((0.0, 0.1, 1234567.891), grids, strict=True))


def decode(data: bytes, *, ros: int) -> dict[str, Any]:
    """An ``OccupancyGrid`` by the field tables of ROS: CDR with its alignment (2), or packed with ``seq`` first (1)."""
    at = 4 if ros == 2 else 0
    if ros == 2:
        assert data[:4] == b"\0\1\0\0"  # CDR, little endian

    def take(kind: str) -> Any:
        nonlocal at
        size = struct.calcsize(kind)
        if ros == 2:
            at += -(at - 4) % size
        at += size
        return struct.unpack_from("<" + kind, data, at - size)[0]

    fields: dict[str, Any] = {"seq": take("I")} if ros == 1 else {}
    fields["stamp"] = take("I"), take("I")
    length = take("I")
    fields["frame"] = data[at : at + length].rstrip(b"\0").decode()
    at += length
    fields["loaded"] = take("I"), take("I")
    fields["resolution"], fields["width"], fields["height"] = take("f"), take("I"), take("I")
    fields["position"] = [take("d") for _ in range(3)]
    fields["turn"] = [take("d") for _ in range(4)]
    count = take("I")
    fields["data"] = np.frombuffer(data, np.int8, count, at)
    assert at + count == len(data)
    return fields


def read_sqlite(path: Path) -> list[tuple[int, str, str, bytes]]:
    meta = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    (topic,) = meta["topics_with_message_count"]
    assert meta["storage_identifier"] == "sqlite3" and topic["message_count"] == meta["message_count"]
    qos = yaml.safe_load(topic["topic_metadata"]["offered_qos_profiles"])[0]
    assert (qos["durability"], qos["reliability"], qos["history"], qos["depth"]) == (1, 1, 1, 1)
    (name,) = meta["relative_file_paths"]
    connection = sqlite3.connect(path / name)
    try:
        return list(
            connection.execute(
                "SELECT timestamp, name, type, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY timestamp"
            )
        )
    finally:
        connection.close()


def mcap_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """https://mcap.dev/spec: opcode, length, content; the records of a chunk one by one."""
    at = 0
    while at < len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        content = data[at + 9 : at + 9 + length]
        at += 9 + length
        if opcode == 6:
            (size,) = struct.unpack_from("<I", content, 28)
            assert size == 0  # not compressed
            yield from mcap_records(content[40:])
        else:
            yield opcode, content


def read_mcap(path: Path) -> list[tuple[int, str, str, bytes]]:
    data, magic = path.read_bytes(), b"\x89MCAP0\r\n"
    assert data.startswith(magic) and data.endswith(magic)
    schemas, channels, messages = {}, {}, []

    def text(content: bytes, at: int) -> tuple[str, int]:
        (length,) = struct.unpack_from("<I", content, at)
        return content[at + 4 : at + 4 + length].decode(), at + 4 + length

    for opcode, content in mcap_records(data[8:-8]):
        if opcode == 3:
            schemas[struct.unpack_from("<H", content)[0]] = text(content, 2)[0]
        elif opcode == 4:
            identity, schema = struct.unpack_from("<HH", content)
            topic, at = text(content, 4)
            assert text(content, at)[0] == "cdr"
            channels[identity] = topic, schemas[schema]
        elif opcode == 5:
            channel, _, log_time, _ = struct.unpack_from("<HIQQ", content)
            messages.append((log_time, *channels[channel], content[22:]))
    return messages


def header_fields(content: bytes) -> Iterator[tuple[str, bytes]]:
    at = 0
    while at < len(content):
        (size,) = struct.unpack_from("<I", content, at)
        name, _, value = content[at + 4 : at + 4 + size].partition(b"=")
        yield name.decode(), value
        at += 4 + size


def ros1_records(data: bytes) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """http://wiki.ros.org/Bags/Format/2.0: header length, header, data length, data; those of a chunk one by one."""
    at = 0
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        header = dict(header_fields(data[at + 4 : at + 4 + length]))
        at += 4 + length
        (size,) = struct.unpack_from("<I", data, at)
        content, at = data[at + 4 : at + 4 + size], at + 4 + size
        if header["op"] == b"\x05":
            assert header["compression"] == b"none"
            yield from ros1_records(content)
        else:
            yield header, content


def read_ros1(path: Path) -> list[tuple[int, str, str, bytes]]:
    data, magic = path.read_bytes(), b"#ROSBAG V2.0\n"
    assert data.startswith(magic)
    connections, messages = {}, []
    for header, content in ros1_records(data[len(magic) :]):
        if header["op"] == b"\x07":
            fields = dict(header_fields(content))
            assert fields["latching"] == b"1" and fields["md5sum"] == b"3381f2d731d4076ec5c71b0759edbe4e"
            connections[header["conn"]] = header["topic"].decode(), fields["type"].decode()
        elif header["op"] == b"\x02":
            sec, nanosec = struct.unpack("<II", header["time"])
            messages.append((sec * 10**9 + nanosec, *connections[header["conn"]], content))
    return messages


READERS = {"mcap": read_mcap, "ros2": read_sqlite, "ros1": read_ros1}
NAMES = {"mcap": "map.mcap", "ros2": "map", "ros1": "map.bag"}


@pytest.mark.parametrize("format", FORMATS)
def test_an_independent_reader_finds_the_same_maps(tmp_path: Path, format: str) -> None:
    expected = maps()
    path = save_bag(tmp_path / "deep" / "map", expected, format=format)
    assert path.name == NAMES[format] and [p.name for p in path.parent.iterdir()] == [NAMES[format]]
    messages = READERS[format](path)
    assert len(messages) == 3
    for (time_s, grid), (stamp, topic, kind, data) in zip(expected, messages, strict=True):
        fields = decode(data, ros=1 if format == "ros1" else 2)
        assert (topic, kind.replace("/msg/", "/")) == ("/map", "nav_msgs/OccupancyGrid")
        assert stamp == round(time_s * 1e9)
        assert fields["stamp"] == fields["loaded"] == divmod(stamp, 10**9)
        assert (fields["frame"], fields["width"], fields["height"]) == ("map", 8, 5)
        assert fields["resolution"] == 0.25
        assert fields["position"] == [-1.5, 2.0, 0.0] and fields["turn"] == [0, 0, 0, 1]
        assert np.array_equal(fields["data"].reshape(5, 8), grid.data)  # row by row from the smallest y


@pytest.mark.parametrize("format", FORMATS)
def test_rosbags_reads_the_same(tmp_path: Path, format: str) -> None:
    from rosbags.highlevel import AnyReader

    expected = maps()
    with AnyReader([save_bag(tmp_path / "map", expected, format=format)]) as reader:
        for (time_s, grid), (connection, stamp, raw) in zip(expected, reader.messages(), strict=True):
            message: Any = reader.deserialize(raw, connection.msgtype)
            assert stamp == nanoseconds(time_s) and message.header.frame_id == "map"
            assert np.array_equal(message.data.reshape(message.info.height, message.info.width), grid.data)


@pytest.mark.parametrize("format", FORMATS)
def test_a_bag_is_replaced_whole_or_not_at_all(tmp_path: Path, format: str) -> None:
    path = save_bag(tmp_path / "map", maps()[:1], format=format)
    assert save_bag(path, maps(), format=format) == path
    assert len(READERS[format](path)) == 3

    def interrupted() -> Iterator[tuple[float, OccupancyMap]]:
        yield from maps()[:2]
        raise KeyboardInterrupt

    before = digest(path)
    with pytest.raises(KeyboardInterrupt):
        save_bag(path, interrupted(), format=format)
    with pytest.raises(ValueError, match="maps: expected at least one, got none"):
        save_bag(path, [], format=format)
    with pytest.raises(ValueError, match=r"maps: expected them in order of time, got 0.0 s after 0.1 s"):
        save_bag(path, [maps()[1], maps()[0]], format=format)
    assert digest(path) == before and [p.name for p in tmp_path.iterdir()] == [NAMES[format]]


def digest(path: Path) -> dict[str, str]:
    files = [path] if path.is_file() else sorted(path.iterdir())
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_what_is_in_the_way_stays(tmp_path: Path) -> None:
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "mine.txt").write_text("mine")
    (tmp_path / "map.mcap").mkdir()
    (tmp_path / "file").write_text("mine")
    for name, format in (("map", "ros2"), ("map", "mcap")):
        with pytest.raises(ValueError, match="a folder that is no bag is in the way"):
            save_bag(tmp_path / name, maps(), format=format)
    with pytest.raises(ValueError, match="a file is in the way of the folder"):
        save_bag(tmp_path / "file", maps(), format="ros2")
    with pytest.raises(ValueError, match="cannot write"):
        save_bag(tmp_path / "file" / "map", maps())
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["file", "map", "map.mcap", "mine.txt"]


@pytest.mark.parametrize("time_s", [-1.0, 2.0**31, np.nan, np.inf])
def test_times_that_no_stamp_can_hold(tmp_path: Path, time_s: float) -> None:
    with pytest.raises(ValueError, match=r"time_s: expected seconds from 0 to below 2\*\*31"):
        save_bag(tmp_path / "map", [(time_s, maps()[0][1])])
    assert not list(tmp_path.iterdir())


def test_the_message_does_not_change_the_map() -> None:
    from rosbags.typesys import Stores, get_typestore

    grid = maps()[0][1]
    before = grid.data.copy()
    message = grid_message(get_typestore(Stores.ROS2_HUMBLE).types, grid, 0.5)
    assert message.data.dtype == np.int8 and np.array_equal(grid.data, before)


# --- occlib run --------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize("format", FORMATS)
def test_run_writes_every_frame_into_the_bag(tiny_recording: Path, tmp_path: Path, format: str) -> None:
    out = tmp_path / "out"
    options = ["--bag", format, "--maps", "--map-mode", "scale"]
    assert main(["run", str(tiny_recording), "--out", str(out), *options]) == 0
    messages = READERS[format](out / NAMES[format])
    grids = [load_map(path) for path in sorted((out / "maps").glob("*.yaml"))]
    assert len(messages) == len(grids) == 5
    for k, (grid, (stamp, *_, data)) in enumerate(zip(grids, messages, strict=True)):
        assert stamp == k * 10**8
        assert np.array_equal(decode(data, ros=1 if format == "ros1" else 2)["data"], grid.data.ravel())
    assert load_map(out / "map.yaml") == grids[-1] and (out / "map.png").is_file()


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--bag", "rosbag", "--bag: expected one of mcap, ros2, ros1, got 'rosbag'"),
        ("--map-mode", "grey", "--map-mode: expected one of trinary, scale, raw, got 'grey'"),
    ],
)
def test_run_refuses_unknown_formats_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, message: str
) -> None:
    assert main(["run", "no-such-recording", "--out", str(tmp_path), option, value]) == 2
    assert capsys.readouterr().err == f"occlib run: {message}\n"
