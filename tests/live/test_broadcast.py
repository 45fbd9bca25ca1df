"""The broadcast: every map once and in order, gaps counted, nobody waited for, and nothing believed that comes over the wire."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from occlib.geometry import Floor
from occlib.live.broadcast import Listener, Publisher, keygen
from occlib.live.messages import LAST, MAX_HEADER, MAX_OBJECTS, OBJECT_FIELDS, TOPIC, Message, decode, encode

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

CHILD = """
import json, sys, time
from occlib.live.broadcast import Listener
with Listener(sys.argv[1], timeout_s=20) as listener:
    print("ready", flush=True)
    for message in listener:
        print(json.dumps([message.session, message.sequence, listener.received, listener.missed]), flush=True)
        time.sleep(float(sys.argv[2]))
"""


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


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of keys; ``good`` is in ``allowed/``, ``stranger`` is not."""
    folder = tmp_path_factory.mktemp("keys")
    for name in ("server", "good", "stranger"):
        keygen(folder, name)
    (folder / "allowed").mkdir()
    (folder / "allowed/good.key").write_bytes((folder / "good.key").read_bytes())
    return folder


# --- messages ----------------------------------------------------------------------------------------
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


# --- one publisher, its listeners ----------------------------------------------------------------------
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


# --- who is let in -------------------------------------------------------------------------------------
def attack(address: str) -> None:
    """10,000 pieces of garbage at a publisher's port, as bytes and as ZeroMQ messages of every kind that might get through."""
    rng, port = np.random.default_rng(5), int(address.rpartition(":")[2])
    greeting = b"\xff" + bytes(8) + b"\x7f\x03\x01NULL" + bytes(16) + bytes(32)
    with contextlib.ExitStack() as stack:
        kinds = (zmq.DEALER, zmq.PUB, zmq.SUB, zmq.XSUB)
        sockets = {kind: stack.enter_context(fake(kind, address, sndtimeo=0)) for kind in kinds}
        sockets[zmq.SUB].subscribe(b"")
        for i in range(2500):
            kind = kinds[i % 4]
            for _ in range(3):
                with contextlib.suppress(zmq.Again):
                    if kind == zmq.SUB:
                        sockets[kind].subscribe(rng.bytes(int(rng.integers(1, 2000))))
                    else:
                        start = (b"", b"\x00", b"\x01", b"\x01" + LAST)[int(rng.integers(4))]
                        sockets[kind].send(start + rng.bytes(int(rng.integers(0, 3000))))
            if i % 25 == 0:
                with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1) as raw:
                    raw.sendall(greeting if i % 50 else b"")
                    for _ in range(25):
                        raw.sendall(rng.bytes(int(rng.integers(1, 400))))


def test_garbage_at_the_port_is_ignored() -> None:
    with Publisher() as publisher, Listener(publisher.address) as listener:
        meet(publisher, listener)
        missed = listener.missed
        attack(publisher.address)
        for _ in range(3):
            assert send(publisher) == listener.receive(SOON)
        assert (listener.missed, listener.rejected) == (missed, 0)
        with Listener(publisher.address) as late:
            assert late.receive(SOON) is not None


def test_a_huge_subscription_is_cut_off() -> None:
    with Publisher() as publisher, fake(zmq.SUB, publisher.address) as bare:
        with bare.get_monitor_socket(zmq.EVENT_DISCONNECTED) as monitor:
            bare.subscribe(bytes(2000))
            assert monitor.poll(int(SOON * 1000))
            bare.disable_monitor()


def test_encrypted(keys: Path) -> None:
    secure = {"keys": keys / "server.key_secret", "allowed": keys / "allowed"}
    good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
    with contextlib.ExitStack() as stack:
        publisher = stack.enter_context(Publisher(**secure))  # type: ignore[arg-type]
        listener = stack.enter_context(Listener(publisher.address, **good))  # type: ignore[arg-type]
        meet(publisher, listener)
        missed = listener.missed
        outsiders = [
            Listener(publisher.address),
            Listener(publisher.address, keys=keys / "stranger.key_secret", server_key=keys / "server.key"),
            Listener(publisher.address, keys=keys / "good.key_secret", server_key=keys / "stranger.key"),
        ]
        for outsider in outsiders:
            stack.enter_context(outsider)
        attack(publisher.address)
        for _ in range(3):
            assert send(publisher) == listener.receive(SOON)
        end = time.monotonic() + 2 * NEVER
        while time.monotonic() < end:
            sent = send(publisher)
            assert listener.receive(SOON) == sent
            assert [outsider.receive(0.01) for outsider in outsiders] == [None, None, None]
        assert [(o.received, o.rejected, o.repeats) for o in outsiders] == [(0, 0, 0)] * 3
        assert (listener.missed, listener.rejected) == (missed, 0)
        late = stack.enter_context(Listener(publisher.address, **good))  # type: ignore[arg-type]
        assert late.receive(SOON) == sent


def test_a_listener_with_keys_believes_nobody_else(keys: Path) -> None:
    """Neither a publisher in clear, nor one with another key, at the address of the right one."""
    good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
    with fake(zmq.PUB, "tcp://127.0.0.1:*", bind=True) as bare:
        with Listener(bare.getsockopt_string(zmq.LAST_ENDPOINT), **good) as listener:  # type: ignore[arg-type]
            end = time.monotonic() + NEVER
            while time.monotonic() < end:
                bare.send_multipart(encode(message()))
                assert listener.receive(0.01) is None
            assert (listener.received, listener.rejected, listener.repeats) == (0, 0, 0)
    with Publisher(keys=keys / "stranger.key_secret", allowed=keys / "allowed") as publisher:
        with Listener(publisher.address, **good) as listener:  # type: ignore[arg-type]
            send(publisher)
            assert listener.receive(NEVER) is None


def test_two_publishers_have_lists_of_their_own(keys: Path) -> None:
    with contextlib.ExitStack() as stack:
        for name, stranger in (("good", "stranger"), ("stranger", "good")):
            allowed = [keys / f"{name}.key"]
            publisher = stack.enter_context(Publisher(keys=keys / "server.key_secret", allowed=allowed))
            send(publisher)
            for who, gets in ((name, True), (stranger, False)):
                own = {"keys": keys / f"{who}.key_secret", "server_key": keys / "server.key"}
                with Listener(publisher.address, **own) as listener:  # type: ignore[arg-type]
                    assert (listener.receive(SOON if gets else NEVER) is not None) == gets


OUTSIDE = ["tcp://*:*", "tcp://0.0.0.0:*", "tcp://[::]:*", "tcp://192.168.1.2:*", "tcp://example.org:*", "tcp://eth0:*"]


@pytest.mark.parametrize("address", [*OUTSIDE, "tcp://[::ffff:0.0.0.0]:*", "tcp://127.1:*", "tcp://127.0.0.1.nip.io:*"])
def test_nothing_leaves_the_machine_without_keys(address: str) -> None:
    with pytest.raises(ValueError, match=r"address: expected 127.0.0.1 without keys; .* needs keys and allowed"):
        Publisher(address)
    if "*" not in address[:-1]:
        with pytest.raises(ValueError, match=r"address: expected 127.0.0.1 without keys; .* needs keys and server_key"):
            Listener(address.replace(":*", ":5599"))


def test_with_keys_the_machine_may_be_left(keys: Path) -> None:
    with Publisher("tcp://*:*", keys=keys / "server.key_secret", allowed=keys / "allowed") as publisher:
        sent, port = send(publisher), publisher.address.rpartition(":")[2]
        good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
        with Listener(f"tcp://localhost:{port}", **good) as listener:  # type: ignore[arg-type]
            assert listener.receive(SOON) == sent


@pytest.mark.parametrize("address", ["tcp://localhost:*", "tcp://127.3.2.1:*", "tcp://[::1]:*", "ipc://{}/socket"])
def test_local_addresses(address: str, tmp_path: Path) -> None:
    if "[" in address:
        with socket.socket(socket.AF_INET6) as probe:
            try:
                probe.bind(("::1", 0))
            except OSError:
                pytest.skip("no IPv6 here")
    with Publisher(address.format(tmp_path)) as publisher, Listener(publisher.address) as listener:
        assert send(publisher) == listener.receive(SOON)


@pytest.mark.parametrize(
    "address", ["", "here", "tcp://", "tcp://127.0.0.1", "tcp://127.0.0.1:x", "tcp://127.0.0.1:65536", "udp://127.0.0.1:1",
                "inproc://x", "tcp://127.0.0.1:1;tcp://0.0.0.0:1", "tcp://127.0.0.1:1\n", "tcp://user@host:1", "ipc://"]
)  # fmt: skip
def test_wrong_addresses(address: str) -> None:
    for kind in (Publisher, Listener):
        with pytest.raises(ValueError, match=r"address: expected tcp://HOST:PORT or ipc://FILE, got"):
            kind(address)


def test_addresses_that_do_not_work(keys: Path) -> None:
    with (
        Publisher() as publisher,
        pytest.raises(ValueError, match=r"address: cannot publish at .* \(Address .*in use\)"),
    ):
        Publisher(publisher.address)
    with pytest.raises(ValueError, match=r"address: expected tcp://HOST:PORT"):
        Listener("tcp://127.0.0.1:*")
    good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
    with pytest.raises(ValueError, match=r"address: unknown host 'nobody.invalid'"):
        Listener("tcp://nobody.invalid:5599", **good)  # type: ignore[arg-type]


# --- keys ----------------------------------------------------------------------------------------------
def test_keys_are_made_once_and_the_secret_is_kept(tmp_path: Path) -> None:
    umask = os.umask(0)
    try:
        public, secret = keygen(tmp_path / "new", "robot-1")
    finally:
        os.umask(umask)
    assert (public.name, secret.name) == ("robot-1.key", "robot-1.key_secret")
    if os.name == "posix":
        assert [stat.S_IMODE(path.stat().st_mode) for path in (public, secret)] == [0o644, 0o600]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["robot-1.key", "robot-1.key_secret"]
    assert "secret-key" not in public.read_text()
    before = public.read_bytes(), secret.read_bytes()
    for gone in (None, public):
        if gone:
            gone.unlink()
        with pytest.raises(ValueError, match="is there already, and is not overwritten"):
            keygen(tmp_path / "new", "robot-1")
    assert secret.read_bytes() == before[1]
    for name in ("", "../x", "a/b", ".hidden", "a b", "x" * 200, "\n"):
        with pytest.raises(ValueError, match="name: expected letters, digits"):
            keygen(tmp_path, name)
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="cannot write"):
        keygen(tmp_path / "file", "x")


def test_wrong_keys(keys: Path, tmp_path: Path) -> None:
    (tmp_path / "wrong.key").write_bytes(b'public-key = "\xff\xfe"\n')
    swapped = (keys / "server.key_secret").read_text().replace("secret-key", "x").replace("public-key", "secret-key")
    (tmp_path / "swapped").write_text(swapped.replace("    x", "    public-key"))
    secret, public = keys / "good.key_secret", keys / "server.key"
    for wrong in (keys / "server.key", tmp_path / "wrong.key", tmp_path / "swapped", __file__):
        with pytest.raises(ValueError, match="expected a secret key as keygen makes it"):
            Publisher(keys=wrong, allowed=keys / "allowed")
    with pytest.raises(ValueError, match=r"wrong.key: expected a public key as keygen makes it"):
        Listener("tcp://127.0.0.1:1", keys=secret, server_key=tmp_path / "wrong.key")
    with pytest.raises(ValueError, match=r"wrong.key: expected a public key"):
        Publisher(keys=secret, allowed=tmp_path)
    for path, reason in ((tmp_path / "none", "no such file"), (tmp_path, "Is a directory")):
        with pytest.raises(ValueError, match=rf"cannot read the key \({reason}\)"):
            Listener("tcp://127.0.0.1:1", keys=path, server_key=public)
    with pytest.raises(ValueError, match="allowed: expected a folder of public keys"):
        Publisher(keys=secret, allowed=tmp_path / "none")
    for nobody in (keys / "nobody", []):
        if nobody:
            (keys / "nobody").mkdir()
        with pytest.raises(ValueError, match=r"allowed: expected at least one public key \(NAME.key\), got none"):
            Publisher(keys=secret, allowed=nobody)
    with pytest.raises(ValueError, match=r"keys, allowed .--keys, --allow.: expected both or neither"):
        Publisher(keys=secret)
    with pytest.raises(ValueError, match=r"keys, server_key .--keys, --server-key.: expected both or neither"):
        Listener("tcp://127.0.0.1:1", server_key=public)


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
