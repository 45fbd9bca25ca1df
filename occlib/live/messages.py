"""The map as a message: the wire format of the broadcast, version 1, for robots in any language.

A publisher is a ZeroMQ XPUB socket; a listener is a SUB socket that subscribes to ``occlib/1/map``, then to
``occlib/1/last/ID`` with 32 random hexadecimal digits of its own as ``ID``: it gets the last map at once under that topic,
and nobody else does. Each message has three frames:

0. the topic, ``occlib/1/map`` or ``occlib/1/last/ID``, in ASCII; ``1`` is the version;
1. the header, one JSON object in UTF-8, at most 1 MiB, with exactly these fields: ``session``, 32 hexadecimal digits, new
   whenever the publisher is; ``sequence``, 1, 2, ... in a session; ``t_capture`` and ``t_sent``, when the picture was taken
   and when the message left, in s since 1970-01-01 UTC; ``floor``, ``{"x": [min, max], "y": [min, max], "resolution"}`` in m
   as in ``rig.yaml``; ``width`` and ``height`` of the map in cells; ``objects``, a list of the entries of ``objects.jsonl``:
   ``id`` (whole number), ``x``, ``y`` (m), ``vx``, ``vy`` (m/s by the clock of ``t_capture``), ``area`` (m2), ``colour`` (``[r, g, b]``,
   each 0 to 255), ``label`` (string or null), ``hidden_in`` (a list of cameras) and, but for old publishers, ``size`` (m2 or null);
   and one that is there only if it is not empty: ``coasting``, the like of the objects that were there a moment ago and are not seen
   now, where they are expected; on the map their cells are occupied or unknown, never free;
2. the map, ``width * height`` int8, row by row, the row of the smallest ``y`` first, each with the smallest ``x`` first: the
   ``data`` of a ``nav_msgs/OccupancyGrid``, -1 unknown, 0 (free) to 100 (occupied). Not compressed: on loopback that costs
   more time than it saves.

A sequence that is not one more than the last means that messages were lost, or that the last map came first; one that is not greater is a repeat. The last map has
the times at which it was made and first sent. ``occlib broadcast`` publishes at ``tcp://127.0.0.1:5599`` unless told otherwise. A listener in ten lines::

    import json, secrets, zmq

    socket = zmq.Context().socket(zmq.SUB)
    socket.subscribe(b"occlib/1/map")
    socket.subscribe(b"occlib/1/last/" + secrets.token_hex(16).encode())
    socket.connect("tcp://127.0.0.1:5599")
    while True:
        topic, header, cells = socket.recv_multipart()
        header = json.loads(header)
        print(header["sequence"], header["width"], header["height"], len(cells), header["objects"])

Anything more, less or different is rejected. Beyond the machine itself every connection is encrypted and both ends are
authenticated: CurveZMQ (https://rfc.zeromq.org/spec/26), see :func:`occlib.live.broadcast.keygen`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from occlib.formats.decoding import convert, short
from occlib.formats.message import MAX_CELLS, MAX_OBJECTS, MAX_TEXT, Header, MapObject
from occlib.geometry import Floor

TOPIC, LAST = b"occlib/1/map", b"occlib/1/last/"

MAX_HEADER = 1 << 20  # bytes

OBJECT_FIELDS, HEADER_FIELDS = MapObject.__struct_fields__, Header.__struct_fields__

__all__ = [
    "HEADER_FIELDS", "LAST", "MAX_CELLS", "MAX_HEADER", "MAX_OBJECTS", "MAX_TEXT", "OBJECT_FIELDS", "TOPIC", "Message",
    "decode", "encode", "short",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Message:
    """A map as it is broadcast. Whatever it is made of is checked, and copied unless it cannot change.

    Parameters
    ----------
    sequence
        1, 2, ... in a session.
    t_capture, t_sent
        When the picture was taken and when the message left: seconds since 1970-01-01 UTC, by the publisher's clock.
    data
        int8 (ny, nx): -1 unknown, 0 (free) to 100 (occupied); row 0 is the smallest ``y``.
    floor
        Where the map lies.
    objects
        Entries of ``objects.jsonl``; their ids differ.
    session
        32 hexadecimal digits, those of one publisher from its start to its end.
    coasting
        Entries of the objects that are not seen now; their ids are others.

    Raises
    ------
    ValueError
        One line that names what is wrong.
    """

    sequence: int
    t_capture: float
    t_sent: float
    data: npt.NDArray[np.int8]
    floor: Floor
    objects: Sequence[Mapping[str, Any]]
    session: str
    coasting: Sequence[Mapping[str, Any]] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.floor, Floor):
            raise ValueError(f"floor: expected a Floor, got {type(self.floor).__name__}")
        header = convert(_header(self), Header, "header", inside="")
        floor = Floor(header.floor.x, header.floor.y, header.floor.resolution)
        checked = {"t_capture": header.t_capture, "t_sent": header.t_sent, "floor": floor}
        checked |= {"objects": _entries(header.objects), "coasting": _entries(header.coasting)}
        for name, value in {**checked, "data": _cells(self.data, floor)}.items():
            object.__setattr__(self, name, value)

    def __eq__(self, other: object) -> bool:
        """Same header, same cells."""
        if not isinstance(other, Message):
            return NotImplemented
        return _header(self) == _header(other) and np.array_equal(self.data, other.data)


def encode(message: Message) -> list[bytes]:
    """The three frames of a message, as the module describes them.

    Examples
    --------
    >>> grid = np.array([[-1, 0, 100]], np.int8)
    >>> topic, header, cells = encode(Message(1, 0.5, 0.7, grid, Floor((0, 3), (0, 1), 1.0), [], 32 * "0"))
    >>> topic, len(header), cells
    (b'occlib/1/map', 199, b'\\xff\\x00d')
    """
    header = json.dumps(_header(message), allow_nan=False).encode()
    if len(header) > MAX_HEADER:
        raise ValueError(f"objects: expected a header of at most {MAX_HEADER} bytes, got {len(header)}")
    return [TOPIC, header, message.data.tobytes()]


def decode(frames: Sequence[bytes]) -> Message:
    """The message in three frames from anybody: nothing in them is trusted.

    Raises
    ------
    ValueError
        One line: another version, a wrong number of frames or cells, not JSON, a field that is missing, not known, there twice,
        of another type, not finite, out of range, or too long.
    """
    if len(frames) != 3:
        raise ValueError(f"frames: expected 3, got {len(frames)}")
    topic, text, cells = frames
    if topic != TOPIC and not re.fullmatch(re.escape(LAST) + b"[0-9a-f]{32}", topic):
        raise ValueError(f"topic: expected {TOPIC.decode()}, got {short(topic)}")
    header = convert(_json(text), Header, "header", inside="")
    floor = Floor(header.floor.x, header.floor.y, header.floor.resolution)
    ny, nx = floor.shape
    if (header.width, header.height) != (nx, ny):
        raise ValueError(f"width, height: expected {nx}, {ny} for this floor, got {header.width}, {header.height}")
    if len(cells) != nx * ny:
        raise ValueError(f"cells: expected {nx * ny} bytes, got {len(cells)}")
    data = np.frombuffer(bytes(cells), np.int8).reshape(ny, nx)
    objects, coasting = _entries(header.objects), _entries(header.coasting)
    return Message(header.sequence, header.t_capture, header.t_sent, data, floor, objects, header.session, coasting)


def _header(message: Message) -> dict[str, Any]:
    floor, (height, width) = message.floor, message.floor.shape
    area = {"x": list(floor.x), "y": list(floor.y), "resolution": floor.resolution}
    own = {name: getattr(message, name) for name in ("session", "sequence", "t_capture", "t_sent")}
    header = {**own, "floor": area, "width": width, "height": height, "objects": message.objects}
    return {**header, "coasting": message.coasting} if message.coasting else header


def _entries(objects: Sequence[MapObject]) -> tuple[dict[str, Any], ...]:
    return tuple(msgspec.to_builtins(each) for each in objects)


def _json(text: bytes) -> Any:
    """JSON without what Python allows beyond it, and without a field given twice."""
    if len(text) > MAX_HEADER:
        raise ValueError(f"header: expected at most {MAX_HEADER} bytes, got {len(text)}")

    def constant(name: str) -> None:
        raise ValueError(f"{name} is not a number")

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(fields := dict(items)) < len(items):
            raise ValueError("a field is there twice")
        return fields

    try:
        return json.loads(text.decode("utf-8"), parse_constant=constant, object_pairs_hook=pairs)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"header: expected JSON in UTF-8, got {short(text)} ({short(str(error))})") from None


def _cells(data: Any, floor: Floor) -> npt.NDArray[np.int8]:
    """A map that cannot change any more."""
    if not isinstance(data, np.ndarray) or data.dtype != np.int8 or data.shape != floor.shape:
        came = f"{data.dtype} {data.shape}" if isinstance(data, np.ndarray) else type(data).__name__
        raise ValueError(f"data: expected int8 {floor.shape}, got {came}")
    data = data.copy(order="C")  # before it is looked at
    if data.min() < -1 or data.max() > 100:
        raise ValueError(f"data: expected values from -1 to 100, got {data.min()} to {data.max()}")
    data.flags.writeable = False
    return data
