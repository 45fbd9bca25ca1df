"""The publisher: every map once and in order, the last one for late joiners, nobody waited for."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq

from helpers.broadcasts import FLOOR, GRID, NEVER, SOON, THINGS, fake, meet, send
from occlib.live.broadcast import Listener, Publisher
from occlib.live.messages import LAST, encode


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"data": GRID.astype(np.int16)}, r"data: expected int8 \(30, 40\), got int16 \(30, 40\)"),
        ({"data": GRID[1:]}, r"data: expected int8 \(30, 40\), got int8 \(29, 40\)"),
        ({"data": GRID.tolist()}, r"data: expected int8 \(30, 40\), got list"),
        ({"data": GRID + np.int8(1)}, "data: expected values from -1 to 100, got 0 to 101"),
        ({"t_capture": float("nan")}, "t_capture: expected a number from 0 to 1e\\+12, got nan"),
        ({"objects": [{**THINGS[0], "x": float("inf")}]}, r"objects\[0\].x: expected a number"),
        ({"objects": THINGS[:1] * 2}, "objects: expected different ids"),
    ],
)
def test_a_wrong_argument_is_not_sent(changes: dict[str, Any], match: str) -> None:
    arguments = {"data": GRID, "floor": FLOOR, "objects": THINGS, "t_capture": 1.0}
    with Publisher() as publisher:
        with pytest.raises(ValueError, match=match):
            publisher.send(**{**arguments, **changes})  # type: ignore[arg-type]
        assert send(publisher).sequence == 1


def test_too_large_a_header_is_not_sent() -> None:
    many = [{**THINGS[0], "id": i, "hidden_in": ["x" * 200] * 10} for i in range(1000)]
    with Publisher() as publisher, pytest.raises(ValueError, match="objects: expected a header of at most"):
        publisher.send(GRID, FLOOR, many, 1.0)


def test_a_late_joiner_gets_the_last_map_at_once_and_nobody_gets_it_twice() -> None:
    with Publisher() as publisher, Listener(publisher.address) as early:
        first, before = meet(publisher, early), early.missed
        for _ in range(3):
            with Listener(publisher.address) as late:
                start = time.monotonic()
                assert late.receive(SOON) == first
                assert time.monotonic() - start < 1.0
                assert late.receive(NEVER) is None
                assert (late.received, late.missed, late.repeats, late.rejected) == (1, 0, 0, 0)
        repeats = early.repeats
        assert early.receive(0.0) is None
        assert early.repeats == repeats  # it did not even arrive
        second = send(publisher)
        assert early.receive(SOON) == second
        assert early.missed == before


def test_who_joins_before_the_first_map_gets_it_once() -> None:
    with Publisher() as publisher, Listener(publisher.address) as listener:
        assert listener.receive(NEVER) is None
        sent = [send(publisher) for _ in range(5)]
        assert [listener.receive(SOON) for _ in sent] == sent
        assert (listener.missed, listener.repeats) == (0, 0)


def test_who_comes_back_before_it_is_known_to_be_gone_gets_the_last_map() -> None:
    """As after a broken connection: the same subscription from two connections."""
    with Publisher() as publisher, contextlib.ExitStack() as stack:
        frames = encode(send(publisher))
        for _ in range(2):
            bare = stack.enter_context(fake(zmq.SUB, publisher.address))
            bare.subscribe(LAST + 32 * b"5")
            assert bare.poll(int(SOON * 1000))
            assert bare.recv_multipart() == [LAST + 32 * b"5", *frames[1:]]


def test_the_fields_of_what_is_sent() -> None:
    before = time.time()
    with Publisher() as a, Publisher() as b:
        first, second = send(a), send(a)
        assert (first.sequence, second.sequence, a.sequence, b.sequence) == (1, 2, 2, 0)
        assert first.session == second.session == a.session != b.session
        assert before <= first.t_capture <= first.t_sent <= second.t_sent <= time.time()
        assert a.address.startswith("tcp://127.0.0.1:") and not a.address.endswith("*")


def test_a_restarted_publisher_is_found_again_and_recognised() -> None:
    with Publisher() as publisher:
        address = publisher.address
        with contextlib.ExitStack() as stack:
            listener = stack.enter_context(Listener(address))
            for _ in range(20):
                send(publisher)
            meet(publisher, listener)
            before = listener.missed
            publisher.close()
            again = stack.enter_context(Publisher(address))
            sent = send(again)
            while (got := listener.receive(SOON)) is not None and got.session != again.session:
                pass
            assert got == sent
            for _ in range(3):
                assert send(again) == listener.receive(SOON)
            assert listener.missed == before


def test_nothing_is_left_behind() -> None:
    threads, files = threading.active_count(), len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc") else 0
    for _ in range(5):
        publisher = Publisher()
        with Listener(publisher.address) as listener:
            meet(publisher, listener)
        publisher.close()
        publisher.close()
        listener.close()
    assert threading.active_count() == threads
    assert not files or len(os.listdir("/proc/self/fd")) <= files + 2
    with pytest.raises(ValueError, match="publisher: expected an open one"):
        send(publisher)


def test_ipc_neither_deletes_a_file_nor_takes_over(tmp_path: Path) -> None:
    important = tmp_path / "important.txt"
    important.write_text("kept")
    with pytest.raises(ValueError, match="is there already, and is no socket"):
        Publisher(f"ipc://{important}")
    assert important.read_text() == "kept"
    address = f"ipc://{tmp_path}/s"
    with Publisher(address), pytest.raises(ValueError, match="Address already in use"):
        Publisher(address)
    with Publisher(address):  # what a dead one left behind does not matter
        pass


def test_a_closed_listener_and_wrong_types_are_named() -> None:
    with Publisher() as publisher, Listener(publisher.address) as listener:
        with pytest.raises(ValueError, match="timeout_s: expected seconds, got nan"):
            listener.receive(float("nan"))
        with pytest.raises(ValueError, match="floor: expected a Floor, got NoneType"):
            publisher.send(np.zeros((2, 2), np.int8), None, [], 0.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="listener: expected an open one"):
        listener.receive(0.1)
    with pytest.raises(ValueError, match="address: expected text, got int"):
        Publisher(5599)  # type: ignore[arg-type]
