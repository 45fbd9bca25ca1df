"""Maps as the messages that robots record: ``nav_msgs/OccupancyGrid`` in bags of ROS 1 and ROS 2.

Needs the extra ``ros``: ``pip install "occlib[ros]"``, which is ``rosbags`` (https://gitlab.com/ternaris/rosbags), pure
Python; no ROS.
"""

from __future__ import annotations

import math
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from occlib.base.extras import import_extra
from occlib.mapping import OccupancyMap

FORMATS = ("mcap", "ros2", "ros1")
"""``mcap``: one file for ROS 2 and Foxglove. ``ros2``: a folder with SQLite and metadata. ``ros1``: one bag, version 2.0."""


SUFFIXES = {"mcap": ".mcap", "ros2": "", "ros1": ".bag"}


TOPIC, FRAME, TYPE = "/map", "map", "nav_msgs/msg/OccupancyGrid"


def save_bag(path: str | Path, maps: Iterable[tuple[float, OccupancyMap]], *, format: str = "mcap") -> Path:
    """Write maps as ``nav_msgs/OccupancyGrid`` on ``/map``, in the frame ``map``; return the bag's path.

    A bag that was there is replaced, when the new one is complete; nothing half-written is left.

    Parameters
    ----------
    path
        The file, or for ``"ros2"`` the folder. The suffix ``.mcap`` or ``.bag`` is added if it is missing.
    maps
        ``(time, map)`` in s and in order of time, at least one. The time is the message's stamp and that of its
        recording; below 2**31 s. The origin is the floor's lower left corner; the message holds the resolution in 32 bit.
    format
        One of :data:`FORMATS`. ROS 2 offers the map as ``map_server`` does: reliable, transient local, depth 1.

    Raises
    ------
    ValueError
        In one line: the extra is missing, an unknown format, no map, wrong times, a folder in the way that is no bag, or
        the bag cannot be written.

    Examples
    --------
    >>> save_bag("map", [], format="csv")
    Traceback (most recent call last):
    ValueError: format: expected one of mcap, ros2, ros1, got 'csv'
    """
    check_format(format)
    target = Path(path)
    if target.suffix != SUFFIXES[format] and SUFFIXES[format]:
        target = target.with_name(target.name + SUFFIXES[format])
    if target.is_dir() and (format != "ros2" or not (target / "metadata.yaml").is_file()):
        raise ValueError(f"{target}: cannot write (a folder that is no bag is in the way)")
    if format == "ros2" and target.exists() and not target.is_dir():
        raise ValueError(f"{target}: cannot write (a file is in the way of the folder)")
    write = _ros1_writer() if format == "ros1" else _ros2_writer(format)
    temporary = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
        _replace(write(temporary / target.stem, _in_order(maps)), target, temporary)
    except (OSError, sqlite3.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ValueError(f"{target}: cannot write ({reason})") from None
    finally:
        if temporary:
            shutil.rmtree(temporary, ignore_errors=True)
    return target


def grid_message(types: Mapping[str, Any], grid: OccupancyMap, time_s: float) -> Any:
    """The message ``nav_msgs/OccupancyGrid`` of a map; ``types`` has a class for each message type, of ROS 1 or ROS 2."""
    sec, nanosec = divmod(nanoseconds(time_s), 10**9)
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    header = types["std_msgs/msg/Header"]
    sequence = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}  # of ROS 1
    ny, nx = grid.data.shape
    origin = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=float(grid.floor.x[0]), y=float(grid.floor.y[0]), z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    info = types["nav_msgs/msg/MapMetaData"](
        map_load_time=stamp, resolution=float(grid.floor.resolution), width=nx, height=ny, origin=origin
    )
    return types[TYPE](header=header(stamp=stamp, frame_id=FRAME, **sequence), info=info, data=grid.data.ravel())


def nanoseconds(time_s: float) -> int:
    """A time in s as whole ns; ``ValueError`` unless it fits a ROS stamp, 0 to 2**31 s."""
    if not (math.isfinite(time_s) and 0 <= time_s < 2**31):
        raise ValueError(f"time_s: expected seconds from 0 to below 2**31, got {time_s}")
    return round(time_s * 1e9)


_Writer = Callable[[Path, Iterable[tuple[int, float, OccupancyMap]]], Path]


def _in_order(maps: Iterable[tuple[float, OccupancyMap]]) -> Iterable[tuple[int, float, OccupancyMap]]:
    last = -1
    for time_s, grid in maps:
        now = nanoseconds(time_s)
        if now < last:
            raise ValueError(f"maps: expected them in order of time, got {time_s} s after {last / 1e9} s")
        last = now
        yield now, time_s, grid
    if last < 0:
        raise ValueError("maps: expected at least one, got none")


def _ros2_writer(format: str) -> _Writer:
    from rosbags import interfaces, typesys
    from rosbags import rosbag2 as bag

    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    plugin = bag.StoragePlugin.MCAP if format == "mcap" else bag.StoragePlugin.SQLITE3
    for_ever = interfaces.QosTime(9223372036, 854775807)  # RMW_DURATION_INFINITE
    latched = interfaces.Qos(
        interfaces.QosHistory.KEEP_LAST,
        1,
        interfaces.QosReliability.RELIABLE,
        interfaces.QosDurability.TRANSIENT_LOCAL,
        for_ever,
        for_ever,
        interfaces.QosLiveliness.AUTOMATIC,
        for_ever,
        False,
    )

    def write(folder: Path, maps: Iterable[tuple[int, float, OccupancyMap]]) -> Path:
        with bag.Writer(folder, version=8, storage_plugin=plugin) as writer:
            connection = writer.add_connection(TOPIC, TYPE, typestore=store, offered_qos_profiles=[latched])
            for now, time_s, grid in maps:
                writer.write(connection, now, store.serialize_cdr(grid_message(store.types, grid, time_s), TYPE))
        return folder / f"{folder.name}.mcap" if format == "mcap" else folder

    return write


def _ros1_writer() -> _Writer:
    from rosbags import rosbag1 as bag
    from rosbags import typesys

    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)

    def write(file: Path, maps: Iterable[tuple[int, float, OccupancyMap]]) -> Path:
        with bag.Writer(file) as writer:
            connection = writer.add_connection(TOPIC, TYPE, typestore=store, latching=1)
            for now, time_s, grid in maps:
                writer.write(connection, now, store.serialize_ros1(grid_message(store.types, grid, time_s), TYPE))
        return file

    return write


def _replace(made: Path, target: Path, temporary: Path) -> None:
    """Move a finished bag over one that may be there; a folder cannot be renamed over another in one step."""
    if target.is_dir():
        os.replace(target, temporary / "replaced")
    os.replace(made, target)


def check_format(format: str, *, name: str = "format") -> None:
    """``ValueError`` unless such a bag can be written here: names the formats, or the extra to install."""
    if format not in FORMATS:
        raise ValueError(f"{name}: expected one of {', '.join(FORMATS)}, got {format!r}")
    import_extra("rosbags.typesys", "ros")
