"""Cameras that cannot be trusted: every reason planted, and everything that must not be taken for one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.covers import PATTERNED, covers, hide, lit, noisy
from occlib.foreground.background import Background
from occlib.foreground.health import CameraMonitor
from occlib.pipeline import backgrounds_of
from occlib.recordings import Recording, open_recording

Array = np.ndarray[Any, Any]
LAB = ("four_robots", "long_occlusion", "ball_and_oval", "robot")
VIEWS = ("left", "right", "front", "back")


def empty_rooms(recording: Recording) -> dict[str, Array]:
    return {name: images[0] for name, images in recording.background_images().items()}


ROOMS = empty_rooms(open_recording("four_robots"))
MONITOR = CameraMonitor(ROOMS)


def verdict(picture: Array, room: Array) -> str:
    """What one camera's picture is called at first sight, so that nothing is frozen."""
    return CameraMonitor({"a": room}).check({"a": picture}).get("a", "")


def crowd(picture: Array, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """The room full of people, the near ones large, and the share of the picture that they hide."""
    full, hidden = picture.copy(), np.zeros(picture.shape[:2], np.uint8)
    height, width = hidden.shape
    for foot in np.sort(rng.uniform(0.45, 1.2, count)) * height:
        tall, at = 0.55 * foot, rng.uniform(0, width)
        colours = rng.integers(20, 230, (3, 3)).tolist()
        for share, size, colour in ((0.3, 0.3, colours[0]), (0.62, 0.25, colours[1]), (0.93, 0.07, colours[2])):
            centre, axes = (int(at), int(foot - share * tall)), (int(tall * min(size, 0.14)), int(tall * size))
            cv2.ellipse(full, centre, axes, 0, 0, 360, colour, -1)
            cv2.ellipse(hidden, centre, axes, 0, 0, 360, 1, -1)
    return noisy(full, rng), float(hidden.mean())


# --- missing -----------------------------------------------------------------------------------------
def test_a_camera_without_a_picture_is_missing() -> None:
    monitor = CameraMonitor(ROOMS)
    assert monitor.check({}) == dict.fromkeys(VIEWS, "missing")
    assert monitor.check({"back": None, **{name: ROOMS[name] for name in VIEWS[:3]}}) == {"back": "missing"}
    assert monitor.check(ROOMS) == {}
    assert monitor.check(ROOMS | {"top": np.zeros(3)}) == {}  # nobody's camera


def test_reasons_come_in_the_order_of_the_backgrounds() -> None:
    black = np.zeros_like(ROOMS["left"])
    assert list(MONITOR.check({"back": black, "left": black}).items()) == [
        ("left", "black"),
        ("right", "missing"),
        ("front", "missing"),
        ("back", "black"),
    ]


# --- black and covered -------------------------------------------------------------------------------
@pytest.mark.parametrize("view", VIEWS)
def test_black(view: str) -> None:
    rng = np.random.default_rng(1)
    room = ROOMS[view]
    assert verdict(np.zeros_like(room), room) == "black"
    assert verdict(noisy(np.full_like(room, 8), rng, 4.0), room) == "black"
    assert verdict(noisy(lit(room, 0.08, 0), rng), room) == "black"  # the lights are out


def test_a_dark_room_is_not_black_until_the_camera_is() -> None:
    rng = np.random.default_rng(2)
    for gain in (0.02, 0.05, 0.1, 0.2):
        dark = lit(ROOMS["left"], gain, 0)
        assert verdict(noisy(dark, rng, 1.0), dark) == ""
        assert verdict(np.zeros_like(dark), dark) == "black"


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS)
def test_covered(view: str) -> None:
    rng = np.random.default_rng(3)
    room = ROOMS[view]
    for name, cover in covers(room.shape, rng).items():
        expected = "black" if name == "cap" else "covered"
        assert verdict(cover, room) == expected, name
        for share in (0.95,) if name in PATTERNED else (0.9, 0.95):
            for hidden in hide(noisy(room, rng), cover, share):
                assert verdict(hidden, room) in (expected, "covered"), (name, share)


@pytest.mark.parametrize("level", [30, 100, 200, 255])
def test_a_uniform_picture_is_covered_even_in_a_room_with_little_structure(level: int) -> None:
    plain = np.full((120, 160, 3), 90, np.uint8)
    plain[60:] = 160  # floor and wall, and nothing else
    assert verdict(np.full_like(plain, level), plain) == "covered"
    assert verdict(plain, plain) == verdict(lit(plain, 0.6, -30), plain) == verdict(lit(plain, 1.5, 30), plain) == ""
    assert verdict(np.zeros_like(plain), plain) == "black"


def test_a_bare_floor_cannot_be_told_from_a_cover() -> None:
    bare = np.full((120, 160, 3), 170, np.uint8)
    assert verdict(bare, bare) == verdict(np.full_like(bare, 90), bare) == ""
    assert verdict(np.zeros_like(bare), bare) == "black"


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS)
def test_an_object_over_half_of_the_view_is_no_cover(view: str) -> None:
    rng = np.random.default_rng(4)
    for name, cover in covers(ROOMS[view].shape, rng).items():
        for hidden in hide(noisy(ROOMS[view], rng), cover, 0.5):
            assert verdict(hidden, ROOMS[view]) == "", name


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.sampled_from(VIEWS), st.floats(0.6, 1.5), st.floats(-30, 30), st.integers(0, 2**32 - 1))
def test_light_and_exposure_do_not_matter(view: str, gain: float, offset: float, seed: int) -> None:
    picture = noisy(lit(ROOMS[view], gain, offset), np.random.default_rng(seed))
    assert verdict(picture, ROOMS[view]) == ""


@pytest.mark.parametrize("view", VIEWS)
def test_a_room_full_of_people_is_not_covered(view: str) -> None:
    rng = np.random.default_rng(5)
    for count in (5, 20, 60):
        picture, share = crowd(ROOMS[view], count, rng)
        assert verdict(picture, ROOMS[view]) == "", share
    assert share > 0.6


@pytest.mark.parametrize("shift", [(1, 0), (0, 1), (2, 2), (-3, 3), (4, 4)])
def test_a_camera_that_trembles_is_usable(shift: tuple[int, int]) -> None:
    for recording in map(open_recording, LAB):
        for name, room in empty_rooms(recording).items():
            assert verdict(np.roll(room, shift, (0, 1)), room) == "", (recording.path.name, name)


@pytest.mark.parametrize("shift", [(6, 0), (0, 6), (6, 6), (-6, 4), (10, -8)])
def test_a_camera_that_was_bumped_is_usable_and_a_cover_stays_one(shift: tuple[int, int]) -> None:
    rng = np.random.default_rng(15)
    for name, room in ROOMS.items():
        assert verdict(noisy(lit(np.roll(room, shift[::-1], (0, 1)), 0.9, 5), rng), room) == "", name
        assert verdict(noisy(np.full_like(room, 120), rng), room) == "covered"
        other = ROOMS[VIEWS[VIEWS.index(name) - 1]]  # turned away: no shift makes it the same
        assert verdict(noisy(other, rng), room) == "covered", name


# --- light -------------------------------------------------------------------------------------------
def sun(shape: tuple[int, ...], period: int) -> Array:
    """Gains of stripes of sun that falls through a blind."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.where((x + 0.4 * y) % period < 0.5 * period, 1.8, 1.0)[..., None]


def coloured_spots(shape: tuple[int, ...], count: int, rng: np.random.Generator) -> Array:
    """Gains of spotlights of many colours, all over the room."""
    gains, (y, x) = np.ones(shape), np.mgrid[: shape[0], : shape[1]]
    for _ in range(count):
        row, column, radius = rng.uniform(0, shape[0]), rng.uniform(0, shape[1]), rng.uniform(40, 90)
        gains[np.hypot(y - row, x - column) < radius] *= rng.uniform(0.4, 2.2, 3)
    return gains


@pytest.mark.parametrize("view", VIEWS)
def test_stripes_of_sun_and_coloured_spots_are_light_that_nothing_explains(view: str) -> None:
    rng, room = np.random.default_rng(16), ROOMS[view]
    for gains in (sun(room.shape, 80), sun(room.shape, 120), coloured_spots(room.shape, 60, rng)):
        assert verdict(noisy(np.clip(room * gains, 0, 255), rng), room) == "light"


@pytest.mark.parametrize("view", VIEWS)
def test_light_that_varies_slowly_a_lamp_and_a_shaded_patch_are_explained(view: str) -> None:
    rng, room = np.random.default_rng(17), ROOMS[view]
    y, x = (np.linspace(-1, 1, side) for side in room.shape[:2])
    lamp, patch = np.ones(room.shape[:2]), np.ones(room.shape[:2])
    lamp[:, 330:], patch[200:400, 200:450] = 1.4, 0.5
    surface = 1 + 0.2 * x[None] - 0.2 * y[:, None] + 0.1 * x[None] * y[:, None]
    fields = {"lamp": lamp, "patch": patch, "surface": surface} | {
        f"gain {g}": g * np.ones_like(lamp) for g in (0.6, 1.0, 1.5)
    }
    for name, gains in fields.items():
        assert verdict(noisy(np.clip(room * gains[..., None], 0, 255), rng), room) == "", name
    for offset in (-30, 30):
        assert verdict(noisy(lit(room, 1.0, offset), rng), room) == ""


@pytest.mark.slow
@pytest.mark.parametrize("size", [(640, 480), (1288, 728), (320, 240), (160, 120), (90, 300), (64, 48)])
def test_any_size_of_picture(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(6)
    for view in ROOMS.values():
        room = cv2.resize(view, size, interpolation=cv2.INTER_AREA)
        assert verdict(noisy(room, rng), room) == ""
        for cover in covers(room.shape, rng).values():
            assert verdict(cover, room) in ("covered", "black")


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 9, 3), (7, 1, 3), (3, 4000, 3)])
def test_tiny_pictures(shape: tuple[int, int, int]) -> None:
    picture = np.random.default_rng(7).integers(0, 256, shape, np.uint8)
    assert verdict(picture, picture) == ""


# --- frozen ------------------------------------------------------------------------------------------
def instants(changes: Sequence[Sequence[bool]]) -> Iterator[dict[str, Array]]:
    """Frames of the cameras 0, 1, ...: a new noisy picture where it changes, else the last one again."""
    rng, last = np.random.default_rng(8), {}
    for row in changes:
        for camera, change in enumerate(row):
            if change or camera not in last:
                last[camera] = noisy(ROOMS[VIEWS[camera]], rng)
        yield {VIEWS[camera]: picture.copy() for camera, picture in last.items()}


def frozen_at(changes: Sequence[Sequence[bool]], repetitions: int = 3) -> list[list[str]]:
    monitor = CameraMonitor({name: ROOMS[name] for name in VIEWS[: len(changes[0])]}, repetitions=repetitions)
    found = [monitor.check(images) for images in instants(changes)]
    assert all(reason == "frozen" for reasons in found for reason in reasons.values())
    return [list(reasons) for reasons in found]


@pytest.mark.parametrize("repetitions", [1, 3, 7])
def test_frozen_from_so_many_repetitions_on_until_it_changes(repetitions: int) -> None:
    changes = [(True, True)] * 3 + [(False, True)] * (repetitions + 2) + [(True, True)] * 2
    found = frozen_at(changes, repetitions)
    assert found == [[]] * (2 + repetitions) + [["left"]] * 3 + [[]] * 2


def test_a_recording_that_pauses_is_not_frozen() -> None:
    assert frozen_at([(True, True)] * 2 + [(False, False)] * 20 + [(True, True)] * 2) == [[]] * 24
    # one camera is back a little sooner than the other
    assert frozen_at([(True, True)] + [(False, False)] * 20 + [(False, True)] * 2 + [(True, True)]) == [[]] * 24
    # each picture twice, as when it is shown at twice its rate, or three times
    assert frozen_at([(True, True), (False, False)] * 5) == [[]] * 10
    assert frozen_at([(True, True), (False, False), (False, True)] * 5) == [[]] * 15


def test_a_pause_neither_thaws_nor_counts() -> None:
    changes = [(True, True)] + [(False, True)] * 2 + [(False, False)] * 4 + [(False, True)] + [(False, False)] * 2
    assert frozen_at(changes) == [[]] * 7 + [["left"]] * 3


def test_a_single_camera_is_never_frozen() -> None:
    assert frozen_at([(True,)] + [(False,)] * 30) == [[]] * 31


def test_two_frozen_cameras_are_found_by_a_third() -> None:
    assert frozen_at([(True, True, True)] + [(False, False, True)] * 4) == [[]] * 3 + [["left", "right"]] * 2


def test_the_same_with_one_dropped_out() -> None:
    monitor = CameraMonitor({name: ROOMS[name] for name in VIEWS[:2]})
    *_, last = (monitor.check(images) for images in instants([(False, True)] * 4))
    assert last == {"left": "frozen"}
    stale, new = ROOMS["left"], list(instants([(True, True)] * 6))
    monitor = CameraMonitor({name: ROOMS[name] for name in VIEWS[:2]})
    for images in new[:4]:
        monitor.check(images | {"left": stale})
    assert monitor.check({"right": new[4]["right"]}) == {"left": "missing"}
    assert monitor.check({"left": stale, "right": new[5]["right"]}) == {"left": "frozen"}  # back, with the old picture
    assert monitor.check({"left": stale}) == {"left": "frozen", "right": "missing"}
    assert monitor.check({"left": new[5]["left"]}) == {"right": "missing"}


def naive_frozen(changes: Sequence[Sequence[bool]], repetitions: int) -> list[list[str]]:
    """Of every camera: count back the instants at which only others changed, to its last change."""
    found = []
    for now in range(len(changes)):
        names = []
        for camera, name in enumerate(VIEWS[: len(changes[0])]):
            last = max([0] + [i for i in range(now + 1) if changes[i][camera]])
            if sum(any(row) for row in changes[last + 1 : now + 1]) >= repetitions:
                names.append(name)
        found.append(names)
    return found


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.integers(1, 4).flatmap(lambda n: st.lists(st.tuples(*[st.booleans()] * n), min_size=1, max_size=12)))
def test_frozen_as_counted_naively(changes: list[tuple[bool, ...]]) -> None:
    assert frozen_at(changes, 2) == naive_frozen(changes, 2)


def test_slow_change_adds_up() -> None:
    rng = np.random.default_rng(9)
    monitor = CameraMonitor({name: ROOMS[name] for name in VIEWS[:2]})
    scene = ROOMS["left"].copy()  # without noise: 300 px an instant, 1e-3 of the picture, change for good
    order = rng.permutation(scene.shape[0] * scene.shape[1])
    for i in range(30):
        scene.reshape(-1, 3)[order[300 * i : 300 * (i + 1)]] ^= 64
        assert monitor.check({"left": scene, "right": noisy(ROOMS["right"], rng)}) == {}


def test_a_codec_may_touch_up_a_frozen_picture() -> None:
    rng = np.random.default_rng(10)
    monitor = CameraMonitor({name: ROOMS[name] for name in VIEWS[:2]})
    found = []
    for _ in range(8):
        left = ROOMS["left"].copy()
        left[rng.integers(0, 480, 40), rng.integers(0, 640, 40)] += np.uint8(1)
        found.append(monitor.check({"left": left, "right": noisy(ROOMS["right"], rng)}))
    assert found == [{}] * 3 + [{"left": "frozen"}] * 5


def test_a_buffer_that_is_used_again_is_no_repetition() -> None:
    rng = np.random.default_rng(11)
    monitor = CameraMonitor({name: ROOMS[name] for name in VIEWS[:2]})
    buffer = ROOMS["left"].copy()
    for _ in range(6):
        buffer[:] = noisy(ROOMS["left"], rng)
        assert monitor.check({"left": buffer, "right": noisy(ROOMS["right"], rng)}) == {}


@pytest.mark.slow
@pytest.mark.parametrize(("codec", "suffix"), [("mp4v", "mp4"), ("MJPG", "avi")])
def test_a_quiet_room_on_video_is_not_frozen(tmp_path: Path, codec: str, suffix: str) -> None:
    rng = np.random.default_rng(12)
    path = tmp_path / f"quiet.{suffix}"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10, (640, 480))
    if not writer.isOpened():
        pytest.skip(f"this OpenCV cannot write {codec}")
    for _ in range(30):
        writer.write(noisy(ROOMS["left"], rng, 0.5)[..., ::-1].copy())
    writer.release()
    monitor, video, count = CameraMonitor({name: ROOMS[name] for name in VIEWS[:2]}), cv2.VideoCapture(str(path)), 0
    while (read := video.read())[0]:
        left = cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB)
        assert monitor.check({"left": left, "right": noisy(ROOMS["right"], rng)}) == {}, count
        count += 1
    video.release()
    assert count == 30


# --- recordings --------------------------------------------------------------------------------------
def spoil(recording: Recording, camera: str, start: int, change: Callable[[Array], Array | None]) -> list[str]:
    """What a camera is called at each instant when it is changed from ``start`` on, for six instants."""
    monitor, found, first = CameraMonitor(backgrounds_of(recording)), [], None
    for i, (_, images) in enumerate(recording.images(recording.frames[: start + 9])):
        first = images[camera] if i <= start else first
        spoilt = change(first if first is not None else images[camera]) if start < i <= start + 6 else images[camera]
        reasons = monitor.check({**images, camera: spoilt})
        assert set(reasons) <= {camera}
        found.append(reasons.get(camera, ""))
    return found


CASES: dict[str, tuple[Callable[[Array], Array | None], int]] = {
    "missing": (lambda image: None, 0),
    "black": (lambda image: np.zeros_like(image), 0),
    "covered": (lambda image: np.full_like(image, 128), 0),
    "frozen": (lambda image: image.copy(), 2),
    "light": (lambda image: np.clip(image * sun(image.shape, 80), 0, 255).astype(np.uint8), 0),
}


@pytest.mark.parametrize("reason", CASES)
def test_a_failure_in_a_recording_is_noticed_and_so_is_its_end(reason: str) -> None:
    change, delay = CASES[reason]
    found = spoil(open_recording("long_occlusion"), "right", 5, change)
    assert found == [""] * (6 + delay) + [reason] * (6 - delay) + [""] * 2


@pytest.mark.slow
@pytest.mark.parametrize("name", LAB)
def test_nothing_is_wrong_in_the_recordings_that_ship(name: str) -> None:
    recording = open_recording(name)
    monitor = CameraMonitor(backgrounds_of(recording))
    for frame, images in recording.images():
        assert monitor.check(images) == {}, frame


def test_nothing_is_wrong_in_a_scene_without_noise(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording)
    monitor = CameraMonitor(backgrounds_of(recording))
    assert [monitor.check(images) for _, images in recording.images()] == [{}] * 5


# --- arguments ---------------------------------------------------------------------------------------
def test_pictures_are_not_changed() -> None:
    images = {name: room.copy() for name, room in ROOMS.items()}
    for picture in images.values():
        picture.flags.writeable = False
    monitor = CameraMonitor(images)
    monitor.check(images)
    assert all(np.array_equal(images[name], ROOMS[name]) for name in VIEWS)


@pytest.mark.parametrize(
    ("image", "came"),
    [
        (np.zeros((480, 640), np.uint8), r"uint8 \(480, 640\)"),
        (np.zeros((480, 640, 3)), r"float64 \(480, 640, 3\)"),
        (np.zeros((240, 320, 3), np.uint8), r"uint8 \(240, 320, 3\)"),
        ([[1]], "list"),
    ],
)
def test_a_wrong_picture_is_an_error_and_no_instant(image: Any, came: str) -> None:
    monitor = CameraMonitor({name: ROOMS[name] for name in VIEWS[:2]}, repetitions=1)
    rng = np.random.default_rng(14)
    monitor.check(ROOMS)
    with pytest.raises(ValueError, match=rf"image of right: expected uint8 \(480, 640, 3\), got {came}"):
        monitor.check({"left": noisy(ROOMS["left"], rng), "right": image})
    assert monitor.check(ROOMS) == {}  # nothing has changed since the last valid instant


@pytest.mark.parametrize(
    "background",
    [np.zeros((4, 5), np.uint8), np.zeros((4, 5, 3)), Background(np.zeros((4, 5, 3))), Background(np.zeros((0, 5, 3)))],
)
def test_a_wrong_background(background: Any) -> None:
    with pytest.raises(ValueError, match=r"expected uint8 RGB \(H, W, 3\), got (uint8|float64) \("):
        CameraMonitor({"left": background})


def test_wrong_settings() -> None:
    with pytest.raises(ValueError, match="backgrounds: expected one for every camera, got none"):
        CameraMonitor({})
    for wrong in (0, -1, 1.5, True, "3", None):
        with pytest.raises(ValueError, match=f"repetitions: expected a whole number >= 1, got {wrong!r}"):
            CameraMonitor(ROOMS, repetitions=wrong)  # type: ignore[arg-type]
