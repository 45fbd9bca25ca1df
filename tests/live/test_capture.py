"""Live capture with cameras that do not exist: pictures paired by time, and no camera that holds up the others."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from occlib.live.capture import Capture, Device, Paired, Player
from occlib.recordings import open_recording

Array = np.ndarray[Any, Any]


def picture(number: int, camera: int = 0) -> Array:
    """BGR whose red is a number, and whose blue is a camera's."""
    image = np.zeros((6, 8, 3), np.uint8)
    image[..., 2], image[..., 0] = number, camera
    return image


class Fake:
    """A camera that gives a picture every ``period`` s, ``count`` of them, and then does what ``end`` says."""

    def __init__(self, period: float = 0.02, count: int = 10**6, end: str = "eof", camera: int = 0) -> None:
        self.period, self.count, self.end, self.camera = period, count, end, camera
        self.given, self.released, self.free = 0, 0, threading.Event()

    def read(self) -> tuple[bool, Any]:
        time.sleep(self.period)
        if self.given < self.count:
            self.given += 1
            return True, picture(self.given % 256, self.camera)
        if self.end == "eof":
            raise EOFError
        if self.end == "error":
            raise RuntimeError("the driver\nfell over")
        if self.end == "grey":
            return True, np.zeros((2, 2), np.uint8)
        if self.end == "hang":
            self.free.wait()
        return False, None

    def release(self) -> None:
        self.released += 1


@pytest.fixture
def silent() -> Iterator[Capture]:
    """Three cameras that say nothing: what is in their queues is put there by a test."""
    sources = {name: Fake(0.0, 0, "hang") for name in "abc"}
    capture = Capture(sources, tolerance_s=0.05)
    try:
        yield capture
    finally:
        for source in sources.values():
            source.free.set()
        capture.close()


def put(capture: Capture, **times: Sequence[float]) -> None:
    for name, queue in times.items():
        capture._queues[name].extend((at, picture(i)) for i, at in enumerate(queue))


def groups(capture: Capture, now: float) -> list[dict[str, float]]:
    found = []
    while group := capture._group(now):
        found.append({name: taken for name, (taken, _) in group.items()})
    return found


# --- which pictures make an instant --------------------------------------------------------------------
def test_pictures_are_paired_as_soon_as_all_are_there(silent: Capture) -> None:
    put(silent, a=[1.00, 1.10], b=[1.02, 1.13], c=[1.01])
    assert groups(silent, 1.02) == [{"a": 1.00, "b": 1.02, "c": 1.01}]
    assert groups(silent, 1.149) == []  # c may still come
    put(silent, c=[1.12])
    assert groups(silent, 1.149) == [{"a": 1.10, "b": 1.13, "c": 1.12}]
    assert silent.dropped == {"a": 0, "b": 0, "c": 0}


def test_a_silent_camera_is_left_out_after_the_tolerance(silent: Capture) -> None:
    put(silent, a=[1.00], b=[1.02])
    assert groups(silent, 1.049) == []
    assert groups(silent, 1.051) == [{"a": 1.00, "b": 1.02}]
    put(silent, a=[1.2])
    silent.ended.update({"b": "gone", "c": "gone"})
    assert groups(silent, 1.2) == [{"a": 1.2}]  # nobody to wait for
    assert silent.dropped == {"a": 0, "b": 0, "c": 0}


def test_one_that_is_alone_is_dropped_if_others_are_alive(silent: Capture) -> None:
    put(silent, a=[1.00, 1.10], b=[1.09], c=[1.12])
    assert groups(silent, 1.2) == [{"a": 1.10, "b": 1.09, "c": 1.12}]
    assert silent.dropped == {"a": 1, "b": 0, "c": 0}


def test_the_nearest_is_taken(silent: Capture) -> None:
    silent.ended["c"] = "gone"
    put(silent, a=[1.00, 1.03, 1.06], b=[1.04])
    assert groups(silent, 1.07) == [{"a": 1.03, "b": 1.04}]
    assert silent.dropped == {"a": 1, "b": 0, "c": 0}


def test_a_picture_that_comes_too_late_does_not_turn_back_the_time(silent: Capture) -> None:
    put(silent, a=[1.00], b=[1.00])
    assert groups(silent, 2.0) == [{"a": 1.00, "b": 1.00}]
    put(silent, c=[0.99])
    assert groups(silent, 2.0) == []
    assert silent.dropped == {"a": 0, "b": 0, "c": 1}


def test_the_newest_instant_is_handed_out(silent: Capture) -> None:
    silent.ended["c"] = "gone"
    start = time.perf_counter() - 1.0
    put(silent, a=[start, start + 0.1, start + 0.2, start + 0.3], b=[start + 0.01, start + 0.11, start + 0.21])
    pair = silent._next()
    assert pair and pair.time == start + 0.3  # of which b has none, and it is too late for it
    assert pair.images["b"] is None
    assert silent.dropped == {"a": 3, "b": 3, "c": 0}


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.lists(st.lists(st.floats(0, 0.3), max_size=8, unique=True), min_size=3, max_size=3))
def test_whatever_the_times(silent: Capture, times: list[list[float]]) -> None:
    silent._time = -np.inf
    silent.dropped.update(dict.fromkeys("abc", 0))
    put(silent, **{name: sorted(own) for name, own in zip("abc", times, strict=True)})
    found = groups(silent, 1.0)
    starts = [min(group.values()) for group in found]
    assert all(b > a for a, b in pairwise(starts))
    assert all(max(group.values()) - min(group.values()) <= 0.05 + 1e-9 for group in found)
    for name, own in zip("abc", times, strict=True):
        used = [group[name] for group in found if name in group]
        assert set(used) <= set(own)
        assert len(used) + silent.dropped[name] == len(own)
        assert used == sorted(set(used))


# --- cameras in threads --------------------------------------------------------------------------------
def test_pictures_arrive_in_rgb_with_their_skew() -> None:
    sources = {"left": Fake(0.02, 20, camera=7), "right": Fake(0.02, 20, camera=9)}
    before = time.perf_counter()
    with Capture(sources) as capture:
        pairs = list(capture)
    assert pairs
    for pair in pairs:
        assert list(pair.images) == ["left", "right"]
        assert before < pair.time == pair.taken < time.perf_counter()
        assert 0 <= pair.skew_s <= 0.05
        assert abs(pair.epoch() - (time.time() - time.perf_counter() + pair.taken)) < 0.01
        for name, image in pair.images.items():
            assert image is None or (image[0, 0, 2], image[0, 0, 1]) == (sources[name].camera, 0)
    numbers = [int(image[0, 0, 0]) for pair in pairs if (image := pair.images["left"]) is not None]
    assert numbers == sorted(set(numbers))
    for name, source in sources.items():
        used = sum(pair.images[name] is not None for pair in pairs)
        assert used + capture.dropped[name] == source.given == 20
        assert source.released == 1
    assert capture.ended == dict.fromkeys(sources, "no more pictures")


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        ("eof", "no more pictures"),
        ("error", "RuntimeError: the driver fell over"),
        ("grey", "ValueError: picture: expected uint8 BGR (H, W, 3), got uint8 (2, 2)"),
        ("unplugged", "no picture for 0.1 s"),
        ("hang", ""),
    ],
)
def test_a_camera_that_fails_does_not_hold_up_the_other(end: str, reason: str) -> None:
    good, bad = Fake(0.01), Fake(0.01, 5, end)
    alone: list[Paired] = []
    try:
        with Capture({"good": good, "bad": bad}, tolerance_s=0.03, give_up_s=0.1) as capture:
            start = time.monotonic()
            for pair in capture:
                assert pair.images["good"] is not None or not alone
                if pair.images["bad"] is None:
                    alone.append(pair)
                if (len(alone) >= 5 and (end == "hang" or "bad" in capture.ended)) or time.monotonic() > start + 4:
                    break
            assert len(alone) >= 5
            assert time.perf_counter() - alone[-1].time < 1.0
            assert capture.ended.get("bad", "").startswith(reason)
    finally:
        bad.free.set()
    assert good.released == 1
    assert bad.released == (end != "hang")  # what is being read must not be released


def test_all_have_ended() -> None:
    with Capture({"a": Fake(0.0, 0), "b": Fake(0.0, 0, "error")}) as capture:
        assert list(capture) == []
    assert set(capture.ended) == {"a", "b"}


def test_who_is_slow_gets_the_newest() -> None:
    with Capture({"a": Fake(0.005), "b": Fake(0.005)}, tolerance_s=0.02) as capture:
        for pair in islice(capture, 4):
            assert time.perf_counter() - pair.time < 0.5
            time.sleep(0.15)
        assert min(capture.dropped.values()) > 20


def test_wrong_arguments() -> None:
    with pytest.raises(ValueError, match="sources: expected one or more cameras, got none"):
        Capture({})
    for wrong in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match=f"tolerance_s: expected seconds > 0, got {wrong}"):
            Capture({"a": Fake()}, tolerance_s=wrong)
        with pytest.raises(ValueError, match=f"give_up_s: expected seconds > 0, got {wrong}"):
            Capture({"a": Fake()}, give_up_s=wrong)


# --- devices -------------------------------------------------------------------------------------------
def video(path: Path, count: int, fps: float) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write MJPG")
    for i in range(count):
        writer.write(np.full((48, 64, 3), 10 * i, np.uint8))
    writer.release()
    return path


def test_a_video_plays_at_its_own_rate(tmp_path: Path) -> None:
    device = Device(video(tmp_path / "v.avi", 10, 25.0))
    start = time.perf_counter()
    levels = []
    with pytest.raises(EOFError):
        while True:
            read, image = device.read()
            assert read and image.shape == (48, 64, 3)
            levels.append(round(float(image.mean()) / 10))
    device.release()
    assert time.perf_counter() - start > 9 / 25
    assert levels == sorted(set(levels)) and set(levels) <= set(range(10))


def test_overdue_pictures_of_a_video_are_skipped(tmp_path: Path) -> None:
    device = Device(video(tmp_path / "v.avi", 20, 20.0))
    device.read()
    time.sleep(0.52)
    level = device.read()[1].mean() / 10
    device.release()
    assert level >= 9.5


@pytest.mark.parametrize("device", [97, "97", "no/such/file.avi", __file__, "", "-1"])
def test_a_device_that_cannot_be_opened(device: Any, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="cannot be opened") as error:
        Device(device)
    assert "\n" not in str(error.value)
    assert capfd.readouterr().err == ""


# --- recordings ----------------------------------------------------------------------------------------
def test_a_recording_plays_at_its_rate(tiny_recording: Path) -> None:
    player = Player(open_recording(tiny_recording), rate=40)
    start = time.perf_counter()
    pairs = list(player)
    assert time.perf_counter() - start >= 4 / 40 - 0.001
    times = [round(pair.time, 6) for pair in pairs]
    assert len(pairs) + player.dropped["left"] == 5
    assert set(times) <= {0.0, 0.025, 0.05, 0.075, 0.1} and times == sorted(times)  # by the clock of playing
    gaps = [(b.taken - a.taken) * 40 for a, b in pairwise(pairs)]
    assert gaps == pytest.approx([round(gap) for gap in gaps])  # due, whenever it was read
    assert all(start < pair.taken < time.perf_counter() and pair.skew_s == 0 for pair in pairs)


def test_as_fast_as_possible_and_again_and_again(tiny_recording: Path) -> None:
    player = Player(open_recording(tiny_recording), rate=0, loop=True)
    pairs = list(islice(player, 12))
    times, taken = np.array([pair.time for pair in pairs]), np.array([pair.taken for pair in pairs])
    again = np.array([0] * 5 + [10] * 5 + [20] * 2)  # when all has to be forgotten
    assert times - again == pytest.approx(taken - taken[0])
    assert player.dropped == {"left": 0, "right": 0}
    np.testing.assert_array_equal(pairs[1].images["left"], pairs[6].images["left"])


def test_what_is_overdue_is_skipped(tiny_recording: Path) -> None:
    (tiny_recording / "frames/right/0002.png").unlink()
    player = Player(open_recording(tiny_recording), rate=20)
    instants = iter(player)
    next(instants)
    time.sleep(0.17)
    assert next(instants).time == pytest.approx(0.15)
    assert player.dropped == {"left": 2, "right": 1}


def test_a_camera_that_dropped_out(tiny_recording: Path) -> None:
    (tiny_recording / "frames/right/0002.png").unlink()
    images = [pair.images["right"] for pair in Player(open_recording(tiny_recording), rate=0)]
    assert [image is None for image in images] == [False, False, True, False, False]


@pytest.mark.parametrize("rate", [-1.0, float("nan"), float("inf")])
def test_a_wrong_rate(rate: float, tiny_recording: Path) -> None:
    with pytest.raises(ValueError, match="rate: expected instants a second >= 0"):
        Player(open_recording(tiny_recording), rate=rate)


def test_what_is_read_too_slowly_is_late_and_not_skipped(tiny_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    player = Player(open_recording(tiny_recording), rate=100)
    instants = list(player._instants())

    def slowly() -> Iterator[Any]:
        for instant in instants:
            time.sleep(0.03)
            yield instant

    monkeypatch.setattr(player, "_instants", slowly)
    assert len(list(player)) == 5 and player.dropped == {"left": 0, "right": 0}
