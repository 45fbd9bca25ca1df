"""The station: what it publishes of a recording and of live cameras, and how it ends; and the picture of the newest map."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from occlib.geometry import Floor, Rig
from occlib.live import Feed, MapPicture, Message, draw_message, live_feed, publish_maps, recorded_feed
from occlib.pipeline import settings_for
from occlib.recordings import open_recording

SETTINGS = settings_for("and")


class Sent(list[tuple[Any, ...]]):
    """A publisher, or a topic, that keeps what it is given."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.stop_after = stop_after

    def send(self, *message: Any) -> None:
        if len(self) == self.stop_after:
            raise KeyboardInterrupt
        self.append(message)


@pytest.fixture
def feed(tiny_recording: Path) -> Feed:
    """The recording, as fast as it goes."""
    return recorded_feed(open_recording(tiny_recording), rate=0)


def test_every_map_of_a_recording_is_published(feed: Feed) -> None:
    publisher, topic, begun = Sent(), Sent(), time.time()
    with feed:
        published = publish_maps(feed, SETTINGS, publisher, topic)  # type: ignore[arg-type]
    assert (published.maps, len(publisher), len(topic)) == (5, 5, 5)
    assert (published.skew_s, published.ended) == (0.0, {})
    assert published.dropped == {"left": 0, "right": 0}
    for (data, floor, objects, taken, coasting), (grid, stamp) in zip(publisher, topic, strict=True):
        assert np.array_equal(data, grid.data) and floor == feed.rig.floor == grid.floor
        assert len(objects) == 2 and coasting == []
        assert begun <= taken <= time.time() and abs(stamp - taken) < 0.1
    ids = [[thing["id"] for thing in objects] for _, _, objects, _, _ in publisher]
    assert ids == [[1, 2]] * 5  # what was run to warm up has left no trace


def test_what_coasts_is_published_beside_the_objects(tiny_recording: Path) -> None:
    for name in ("left", "right"):
        shutil.copyfile(tiny_recording / f"background/{name}/0.png", tiny_recording / f"frames/{name}/0003.png")
    publisher = Sent()
    publish_maps(recorded_feed(open_recording(tiny_recording), rate=0), SETTINGS, publisher)  # type: ignore[arg-type]
    listed = [
        [[each["id"] for each in some] for some in (objects, coasting)] for _, _, objects, _, coasting in publisher
    ]
    assert listed == [[[1, 2], []]] * 3 + [[[], [1, 2]]] + [[[1, 2], []]]


def test_ctrl_c_ends_it_in_peace(feed: Feed) -> None:
    for stop_after in (0, 2):
        published = publish_maps(feed, SETTINGS, Sent(stop_after))  # type: ignore[arg-type]
        assert published.maps == stop_after
        assert published.dropped == {"left": 0, "right": 0}


def test_cameras_that_are_left_out_are_counted(tiny_recording: Path) -> None:
    for frame in (2, 4):
        (tiny_recording / f"frames/right/{frame:04d}.png").unlink()
    feed = recorded_feed(open_recording(tiny_recording), rate=0)
    published = publish_maps(feed, SETTINGS, Sent())  # type: ignore[arg-type]
    assert published.excluded == {("right", "missing"): 2}


def test_how_many_instants_there_will_be(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording)
    assert recorded_feed(recording).count == 5
    assert recorded_feed(recording, loop=True).count is None


# --- live cameras ------------------------------------------------------------------------------------
class Eye:
    """A camera that shows its four pictures, one every 20 ms; they are given by the name of the device."""

    opened: list[Eye] = []  # noqa: RUF012

    def __init__(self, device: Path, *, size: tuple[int, int]) -> None:
        if device.name == "none":
            raise ValueError("device none: cannot be opened")
        assert size == (160, 120)
        self.pictures = [cv2.imread(str(path)) for path in sorted(device.iterdir())[:4]]
        self.released = 0
        self.opened.append(self)

    def read(self) -> tuple[bool, Any]:
        time.sleep(0.02)
        if not self.pictures:
            raise EOFError
        return True, self.pictures.pop(0)

    def release(self) -> None:
        self.released += 1


@pytest.fixture
def eyes(monkeypatch: pytest.MonkeyPatch) -> type[Eye]:
    monkeypatch.setattr("occlib.live.capture.Device", Eye)
    monkeypatch.setattr(Eye, "opened", [])
    return Eye


def test_live_cameras(tiny_recording: Path, tiny_rig: Rig, eyes: type[Eye]) -> None:
    devices = {name: tiny_recording / "frames" / name for name in tiny_rig.cameras}
    pictures = open_recording(tiny_recording).background_images()
    publisher = Sent()
    with live_feed(tiny_rig, devices, pictures) as feed:
        published = publish_maps(feed, SETTINGS, publisher)  # type: ignore[arg-type]
    assert feed.count is None
    assert published.ended == {"left": "no more pictures", "right": "no more pictures"}
    assert 0 <= published.maps == len(publisher) <= 3  # the first instant warms up
    assert 0 <= published.skew_s <= 0.05
    assert [eye.released for eye in eyes.opened] == [1, 1]


def test_a_device_that_cannot_be_opened_closes_the_others(tiny_recording: Path, tiny_rig: Rig, eyes: type[Eye]) -> None:
    devices = {"left": tiny_recording / "frames/left", "right": Path("none")}
    with pytest.raises(ValueError, match="device none: cannot be opened"):
        live_feed(tiny_rig, devices, open_recording(tiny_recording).background_images())
    assert [eye.released for eye in eyes.opened] == [1]


@pytest.mark.parametrize("missing", ["devices", "pictures"])
def test_a_camera_without_device_or_pictures(tiny_rig: Rig, missing: str, eyes: type[Eye]) -> None:
    given: dict[str, Any] = {"devices": {"left": 0, "right": 1}, "pictures": {"left": [], "right": []}}
    del given[missing]["right"]
    with pytest.raises(ValueError, match=f"{missing}: expected one for every camera, missing right"):
        live_feed(tiny_rig, **given)
    assert eyes.opened == []


# --- the picture of the newest map -------------------------------------------------------------------
def message(sequence: int) -> Message:
    """A map whose occupied cells are as many as its sequence says."""
    data = np.zeros((4, 5), np.int8)
    data.ravel()[:sequence] = 100
    thing = {"id": 1, "x": 0.5, "y": 0.5, "vx": 0.3, "vy": 0.0, "area": 0.1, "colour": [9, 9, 200], "label": None}
    things = [{**thing, "hidden_in": []}]
    return Message(sequence, 1.0, 1.1, data, Floor((0.0, 5.0), (0.0, 4.0), 1.0), things, 32 * "a")


def test_the_newest_map_is_drawn_at_most_once_a_second_and_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn, now = list[int](), [100.0]
    monkeypatch.setattr("occlib.live.drawing.draw_message", lambda message, path: drawn.append(message.sequence))
    monkeypatch.setattr("occlib.live.drawing.time.monotonic", lambda: now[0])
    with MapPicture(tmp_path / "map.png") as picture:
        for sequence, at in enumerate((100.0, 100.5, 101.0, 101.9, 102.1, 102.2), start=1):
            now[0] = at
            picture.show(message(sequence))
            assert picture._drawing is not None
            picture._drawing.result(5)
    assert drawn == [1, 3, 5, 6]


def test_the_picture_shows_what_coasts(tmp_path: Path) -> None:
    usual = message(3)
    waiting = replace(usual, objects=[], coasting=usual.objects)
    drawn = {
        draw_message(one, tmp_path / "map.png").read_bytes() for one in (usual, waiting, replace(usual, objects=[]))
    }
    assert len(drawn) == 3


def test_the_picture_and_its_failure(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    with MapPicture(path) as picture:
        picture.show(message(3))
    assert path.read_bytes() == draw_message(message(3), tmp_path / "same.png").read_bytes()
    (tmp_path / "file").write_text("in the way")
    with MapPicture(tmp_path / "file" / "map.png") as picture:
        picture.show(message(1))
        assert picture._drawing is not None
        picture._drawing.exception(5)
        picture._drawn_s -= 1
        with pytest.raises(ValueError, match="cannot write"):
            picture.show(message(2))
        (tmp_path / "file").unlink()
    assert (tmp_path / "file" / "map.png").is_file()  # of message 2


@pytest.mark.slow
def test_a_listener_waits_for_neither_pipeline_nor_plots() -> None:
    code = "import occlib.live, sys; print([n for n in ('occlib.pipeline', 'matplotlib', 'numba') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
