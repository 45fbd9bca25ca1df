"""What the tests of the broadcast share: a map to send, who sends it, and bare sockets."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import zmq

from occlib.geometry import Floor
from occlib.live.broadcast import Listener, Publisher
from occlib.live.messages import Message

FLOOR = Floor((-2.0, 2.0), (-1.5, 1.5), 0.1)
GRID = np.random.default_rng(1).choice([-1, 0, 100], FLOOR.shape).astype(np.int8)
THING = {"id": 1, "x": 0.5, "y": 1.0, "vx": 0.1, "vy": 0.0, "area": 0.04, "colour": [200, 30, 30], "label": None}
THINGS: list[dict[str, Any]] = [
    {**THING, "hidden_in": ["cam2"]},
    {**THING, "id": 2, "label": "blue ü", "hidden_in": []},
]
SESSION = 32 * "a"
SOON = 4.0  # s: longer than anything here takes
NEVER = 0.4  # s: long enough for something that is there to come


def message(sequence: int = 1, session: str = SESSION, **changes: Any) -> Message:
    fields = {"t_capture": 10.0, "t_sent": 10.5, "data": GRID, "floor": FLOOR, "objects": THINGS}
    return Message(sequence=sequence, session=session, **{**fields, **changes})  # type: ignore[arg-type]


def until(true: Callable[[], object], seconds: float = SOON) -> bool:
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.005)
    return bool(true())


def send(publisher: Publisher) -> Message:
    return publisher.send(GRID, FLOOR, THINGS, time.time())


def meet(publisher: Publisher, listener: Listener) -> Message:
    """Send until the listener is known to be connected; the last message that it got."""
    end = time.monotonic() + SOON
    while time.monotonic() < end:
        sent = send(publisher)
        while (got := listener.receive(0.05)) is not None:
            if got == sent:
                listener.receive(0.2)  # the same as the last map, if it joined just as it was sent
                return got
    raise AssertionError("they do not meet")


@contextlib.contextmanager
def fake(kind: int, address: str, *, bind: bool = False, **options: Any) -> Iterator[zmq.Socket[bytes]]:
    """A bare socket; with ``bind``, at any port of the address."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    bare = context.socket(kind)
    bare.linger = 0
    for name, value in options.items():
        setattr(bare, name, value)
    try:
        bare.bind(address) if bind else bare.connect(address)
        yield bare
    finally:
        bare.close()
        context.term()
