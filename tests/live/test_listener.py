"""The listener: gaps counted, garbage rejected, slow and killed listeners no matter to others."""

from __future__ import annotations

import contextlib
import itertools
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import zmq

from helpers.broadcasts import NEVER, SOON, THINGS, fake, message, until
from occlib.geometry import Floor
from occlib.live.broadcast import Listener, Publisher
from occlib.live.messages import TOPIC, encode

CHILD = """
import json, sys, time
from occlib.live.broadcast import Listener
with Listener(sys.argv[1], timeout_s=20) as listener:
    print("ready", flush=True)
    for message in listener:
        print(json.dumps([message.session, message.sequence, listener.received, listener.missed]), flush=True)
        time.sleep(float(sys.argv[2]))
"""


@contextlib.contextmanager
def fake_publisher() -> Iterator[tuple[str, Callable[[Sequence[bytes]], None]]]:
    """An address, and what sends frames to the listener that is there; waits for it first."""
    with fake(zmq.XPUB, "tcp://127.0.0.1:*", bind=True) as bare:
        joined: list[bytes] = []

        def publish(frames: Sequence[bytes]) -> None:
            while len(joined) < 2:
                assert bare.poll(int(SOON * 1000))
                joined.append(bare.recv())
            bare.send_multipart(frames)

        yield bare.getsockopt_string(zmq.LAST_ENDPOINT), publish


class Child:
    """A listener in a process of its own, that writes what it gets to a file."""

    def __init__(self, address: str, pause: float, path: Path) -> None:
        self.path = path
        with path.open("w") as output:
            self.process = subprocess.Popen([sys.executable, "-c", CHILD, address, str(pause)], stdout=output)

    def lines(self) -> list[tuple[str, int, int, int]]:
        """Session, sequence, received, missed of each message so far."""
        return [tuple(json.loads(line)) for line in self.path.read_text().splitlines() if line[:1] + line[-1:] == "[]"]


@pytest.fixture
def child(tmp_path: Path) -> Iterator[Callable[..., Child]]:
    """``child(address, pause)``, which does not survive the test."""
    children: list[Child] = []

    def start(address: str, pause: float = 0.0) -> Child:
        children.append(Child(address, pause, tmp_path / f"child{len(children)}"))
        return children[-1]

    try:
        yield start
    finally:
        for each in children:
            each.process.kill()
            each.process.wait()


def test_a_gap_is_counted_and_nothing_comes_twice_or_out_of_order() -> None:
    other = 32 * "b"
    sent = [message(i) for i in (7, 8, 8, 11, 10, 20)] + [message(5, other), message(21), message(7, other)]
    with fake_publisher() as (address, publish), Listener(address, timeout_s=NEVER) as listener:
        for each in sent:
            publish(encode(each))
        got = [(m.session[0], m.sequence) for m in listener]
        assert got == [("a", 7), ("a", 8), ("a", 11), ("a", 20), ("b", 5), ("b", 7)]
        assert (listener.received, listener.missed, listener.repeats, listener.rejected) == (6, 2 + 8 + 1, 3, 0)


def test_the_latest_only() -> None:
    with fake_publisher() as (address, publish), Listener(address, latest=True) as listener:
        for i in range(1, 6):
            publish(encode(message(i)))
        publish([TOPIC, b"", b""])
        newest = 0
        while newest < 5 and (got := listener.receive(SOON)):
            assert got.sequence > newest
            newest = got.sequence
            time.sleep(0.05)
        assert newest == 5
        assert (listener.received + listener.skipped, listener.missed) == (5, 0)
        assert listener.received <= 3
        assert listener.receive(0.1) is None
        assert listener.rejected == 1


def test_garbage_from_a_publisher_is_rejected_and_counted() -> None:
    rng, good = np.random.default_rng(3), encode(message(1))
    bad = [[TOPIC, rng.bytes(30), rng.bytes(1200)] for _ in range(100)]
    bad += [[TOPIC], [TOPIC, *good], [TOPIC + b"2", *good[1:]], [TOPIC, good[1], good[2] + b"1"]]
    bad += [[TOPIC, b"cos\nsystem\n(S'exit'\ntR.", b""], [TOPIC, b"__import__('os').abort()", good[2]]]
    with fake_publisher() as (address, publish), Listener(address) as listener:
        for frames in bad:
            publish(frames)
            assert listener.receive(0.005) is None
        publish(good)
        assert listener.receive(SOON) == message(1)
        assert until(lambda: listener.receive(0.0) is None and listener.rejected == len(bad))
        assert (listener.received, listener.missed) == (1, 0)


def test_an_endless_stream_of_garbage_does_not_hold_up_a_listener() -> None:
    with fake_publisher() as (address, publish), Listener(address) as listener:
        publish([TOPIC])
        stop = threading.Event()

        def flood() -> None:
            while not stop.is_set():
                publish([TOPIC])

        thread = threading.Thread(target=flood)
        thread.start()
        try:
            start = time.monotonic()
            assert listener.receive(0.2) is None
            assert time.monotonic() - start < 1.0
        finally:
            stop.set()
            thread.join()


def test_oversized_messages_do_not_arrive() -> None:
    with fake_publisher() as (address, publish), Listener(address) as listener:
        publish([TOPIC, encode(message())[1], bytes(20_000_001)])
        assert listener.receive(NEVER) is None
        assert (listener.received, listener.rejected) == (0, 0)


def assert_complete(lines: Sequence[tuple[str, int, int, int]]) -> None:
    """Nothing twice or out of order, and every number is received or counted as missed."""
    assert lines
    assert len({session for session, *_ in lines}) == 1
    assert all(b[1] > a[1] for a, b in itertools.pairwise(lines))
    first = lines[0][1]
    assert all(received + missed == sequence - first + 1 for _, sequence, received, missed in lines)
    assert [received for *_, received, _ in lines] == list(range(1, len(lines) + 1))


@pytest.mark.slow
def test_slow_stopped_and_killed_listeners(child: Callable[..., Child]) -> None:
    big = Floor((0.0, 4.0), (0.0, 3.0), 0.01)
    grid, longest = np.zeros(big.shape, np.int8), 0.0
    with Publisher() as publisher:
        children = [child(publisher.address, pause) for pause in (0.0, 0.01, 0.0, 0.0)]
        fast, slow, killed, stopped = children

        def send_some(count: int) -> None:
            nonlocal longest
            for _ in range(count):
                start = time.perf_counter()
                publisher.send(grid, big, THINGS, time.time())
                longest = max(longest, time.perf_counter() - start)
            time.sleep(0.004)

        def go_on(done: Callable[[], object]) -> bool:
            return until(lambda: send_some(1) or done(), 2 * SOON)

        assert go_on(lambda: all(len(each.lines()) > 10 for each in children))
        killed.process.send_signal(signal.SIGKILL)
        stopped.process.send_signal(signal.SIGSTOP)
        for _ in range(100):
            send_some(20)
        last = publisher.sequence
        assert go_on(lambda: slow.lines()[-1][3] > 100 and fast.lines()[-1][1] > last)  # it missed some, and knows
    for each in children:
        each.process.kill()
        each.process.wait()
        assert_complete(each.lines())
    assert longest < 0.5  # a stopped listener stays so: whoever waited for it would wait for ever
    assert len(slow.lines()) < len(fast.lines()) <= publisher.sequence
