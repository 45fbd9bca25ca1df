"""Recordings: pictures and videos come back in order and in RGB, damage is named, files are whole or not there."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import re
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.videos import SIZE, save_video, use_videos
from occlib import recordings
from occlib.base import files as files_module
from occlib.base.files import DamagedImageError, encode_image, read_image, read_yaml, staged_folder, write_file
from occlib.formats import Footage, footage, input_format
from occlib.geometry import Rig
from occlib.identification import read_templates
from occlib.recordings import check_size, fetch, open_recording, parse_frames

Array = np.ndarray[Any, Any]


def plain(colour: tuple[int, int, int], size: tuple[int, int] = SIZE) -> Array:
    return np.full((size[1], size[0], 3), colour, np.uint8)


def save_rgb(path: Path, image: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])


def numbers_of(folder: Path) -> list[int]:
    return [frame for frame, _ in open_recording(folder).images()]


def change_rig(folder: Path, **fields: Any) -> None:
    content = yaml.safe_load((folder / "rig.yaml").read_text(encoding="utf-8"))
    (folder / "rig.yaml").write_text(yaml.safe_dump(content | fields), encoding="utf-8")


# --- pictures --------------------------------------------------------------------------------------
def test_a_red_picture_reads_red(tmp_path: Path) -> None:
    save_rgb(tmp_path / "red.png", plain((200, 10, 30)))
    assert read_image(tmp_path / "red.png")[0, 0].tolist() == [200, 10, 30]
    write_file(tmp_path / "again.png", encode_image(".png", plain((200, 10, 30))))
    stored = cv2.imread(str(tmp_path / "again.png"))
    assert stored is not None
    assert stored[0, 0].tolist() == [30, 10, 200]  # OpenCV reads BGR


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".pgm"])
def test_pictures_round_trip(tmp_path: Path, suffix: str) -> None:
    ramp = np.tile(np.arange(160, dtype=np.uint8), (120, 1))
    image = ramp if suffix == ".pgm" else np.dstack([ramp, ramp // 2, 255 - ramp])
    path = write_file(tmp_path / f"picture{suffix}", encode_image(suffix, image))
    expected = np.dstack([ramp] * 3) if suffix == ".pgm" else image
    error = np.abs(read_image(path).astype(int) - expected)
    assert error.max() <= (8 if suffix == ".jpg" else 0)


def test_grey_and_16_bit_pictures_read_as_rgb(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "grey.png"), np.full((4, 5), 77, np.uint8))
    assert cv2.imwrite(str(tmp_path / "deep.png"), np.full((4, 5, 3), 128 * 257, np.uint16))
    for name, level in (("grey.png", 77), ("deep.png", 128)):
        image = read_image(tmp_path / name)
        assert (image.dtype, image.shape) == (np.uint8, (4, 5, 3))
        assert (image == level).all()


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpeg_that_does_not_end_is_no_picture(tmp_path: Path, progressive: int) -> None:
    noise = cv2.blur(np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8), (5, 5))
    whole = cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1].tobytes()
    thumbnail = b"\xff\xe1" + (2 + len(whole)).to_bytes(2, "big") + whole  # ends inside the picture that it is of
    half = len(whole) // 2
    path = tmp_path / "picture.jpg"
    for content in (whole, whole + b"more", whole[:2] + thumbnail + whole[2:]):
        path.write_bytes(content)
        assert read_image(path).shape == (120, 160, 3)
    for content in (
        whole[:-2],
        whole[:half],
        whole[:half] + bytes(9 * half),
        whole[:2] + thumbnail + whole[2:half] + bytes(9 * half),
        whole[:7],
    ):
        path.write_bytes(content + bytes(2))
        with pytest.raises(DamagedImageError, match=r"picture.jpg: corrupt or not an image"):
            read_image(path)


def test_pictures_that_are_none(tmp_path: Path) -> None:
    save_rgb(tmp_path / "whole.png", np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8))
    whole = (tmp_path / "whole.png").read_bytes()
    for name, content in {"empty": b"", "text": b"hello", "cut": whole[: len(whole) // 2]}.items():
        (tmp_path / f"{name}.png").write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}.png: corrupt or not an image"):
            read_image(tmp_path / f"{name}.png")
    (tmp_path / "folder.png").mkdir()
    for name in ("folder.png", "gone.png", "empty.png/below.png"):
        with pytest.raises(ValueError, match=f"{name}: cannot read the image"):
            read_image(tmp_path / name)


@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.zeros((4, 4, 3, 1), np.uint8), np.zeros((0, 4), np.uint8)])
def test_only_uint8_pictures_are_encoded(image: Array) -> None:
    with pytest.raises(ValueError, match=r"image: expected uint8 \(H, W\) or \(H, W, 3\), got"):
        encode_image(".png", image)


def test_check_size_names_both_sizes() -> None:
    check_size(plain((0, 0, 0)), SIZE, "view")
    for bad in (plain((0, 0, 0), (120, 160)), plain((0, 0, 0)).astype(float), plain((0, 0, 0))[..., 0]):
        with pytest.raises(ValueError, match=r"view: expected uint8 \(120, 160, 3\), got (uint8|float64) \("):
            check_size(bad, SIZE, "view")
    with pytest.raises(ValueError, match="got list"):
        check_size([1], SIZE, "view")  # type: ignore[arg-type]


# --- recordings of pictures ------------------------------------------------------------------------
def test_folder_of_pictures(tiny_recording: Path, tiny_rig: Rig) -> None:
    recording = open_recording(tiny_recording)
    assert recording.frames == (0, 1, 2, 3, 4)
    assert recording.fps == 10
    assert recording.time(3) == pytest.approx(0.3)
    assert list(recording.sources) == list(tiny_rig.cameras)
    seen = list(recording.images())
    assert [frame for frame, _ in seen] == [0, 1, 2, 3, 4]
    for frame, images in seen:
        for name, image in images.items():
            stored = cv2.imread(str(tiny_recording / f"frames/{name}/{frame:04d}.png"))
            assert stored is not None
            assert np.array_equal(image, stored[..., ::-1])


def test_cameras_in_the_order_asked_for(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording, ["right", "left"])
    assert list(recording.sources) == ["right", "left"]
    assert list(next(recording.images())[1]) == ["right", "left"]
    shutil.rmtree(tiny_recording / "frames/left")  # a camera that nobody asked for may lack its frames
    assert open_recording(tiny_recording, ["right"]).frames == (0, 1, 2, 3, 4)


def test_some_frames_only(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording)
    whole = dict(recording.images())
    some = dict(recording.images([3, 1]))
    assert list(some) == [1, 3]
    assert all(np.array_equal(some[f][c], whole[f][c]) for f in some for c in some[f])
    with pytest.raises(ValueError, match="frames: 7 is not in tiny, which has 0 to 4"):
        next(recording.images([1, 7]))


def test_frames_are_numbered_by_their_names(tiny_recording: Path) -> None:
    for name in ("left", "right"):
        folder = tiny_recording / "frames" / name
        for old, new in ((4, "f_120"), (3, "f_20"), (1, "f_9")):
            (folder / f"{old:04d}.png").rename(folder / f"{new}.png")
        (folder / ".hidden.png").write_bytes(b"not a picture")
        (folder / "notes.txt").write_text("neither")
    recording = open_recording(tiny_recording)
    assert recording.frames == (0, 2, 9, 20, 120)  # by number, not by name: 9 before 20 before 120
    assert recording.time(120) == pytest.approx(12)
    images = dict(recording.images([20]))[20]
    stored = cv2.imread(str(tiny_recording / "frames/left/f_20.png"))
    assert stored is not None
    assert np.array_equal(images["left"], stored[..., ::-1])


def test_names_without_a_number_are_counted(tiny_recording: Path) -> None:
    for name in ("left", "right"):
        folder = tiny_recording / "frames" / name
        for i, letter in enumerate("edcba"):
            (folder / f"{i:04d}.png").rename(folder / f"{letter}.png")
    recording = open_recording(tiny_recording)
    assert recording.frames == (0, 1, 2, 3, 4)
    stored = cv2.imread(str(tiny_recording / "frames/left/a.png"))
    assert stored is not None
    assert np.array_equal(next(recording.images())[1]["left"], stored[..., ::-1])


def test_numbers_that_come_twice_are_counted(tiny_recording: Path) -> None:
    for name in ("left", "right"):
        folder = tiny_recording / "frames" / name
        (folder / "0004.png").rename(folder / "b_0001.png")
    assert numbers_of(tiny_recording) == [0, 1, 2, 3, 4]


def test_jpg_and_upper_case_names(tiny_recording: Path) -> None:
    for name in ("left", "right"):
        path = tiny_recording / "frames" / name / "0004.png"
        write_file(path.with_suffix(".jpg"), encode_image(".jpg", read_image(path)))
        path.unlink()
        path.with_name("0003.png").rename(path.with_name("0003.PNG"))
    assert numbers_of(tiny_recording) == [0, 1, 2, 3, 4]


def test_sample_is_spread_over_the_recording(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording)
    whole = dict(recording.images())
    sample = recording.sample(3)
    assert [len(images) for images in sample.values()] == [3, 3]
    for image, frame in zip(sample["left"], (0, 2, 4), strict=True):
        assert np.array_equal(image, whole[frame]["left"])
    assert len(recording.sample(100)["right"]) == 5


def test_background_images(tiny_recording: Path) -> None:
    shutil.rmtree(tiny_recording / "background/right")
    backgrounds = open_recording(tiny_recording).background_images()
    assert {name: len(images) for name, images in backgrounds.items()} == {"left": 2}
    assert (backgrounds["left"][0] == 170).all()
    save_rgb(tiny_recording / "background/left/2.png", plain((0, 0, 0), (80, 60)))
    with pytest.raises(ValueError, match=r"background/left/2.png: expected uint8 \(120, 160, 3\), got uint8 \(60, 80"):
        open_recording(tiny_recording).background_images()
    (tiny_recording / "background/left/2.png").write_bytes(b"")
    with pytest.raises(ValueError, match=r"background/left/2.png: corrupt"):
        open_recording(tiny_recording).background_images()


def test_frames_per_second(tiny_recording: Path) -> None:
    change_rig(tiny_recording, fps=4)
    assert open_recording(tiny_recording).time(6) == pytest.approx(1.5)


@pytest.mark.parametrize("fps", [0, -1, "ten", float("nan"), float("inf"), [1], {}, True, 1e-300])
def test_impossible_frames_per_second(tiny_recording: Path, fps: Any) -> None:
    change_rig(tiny_recording, fps=fps)
    with pytest.raises(ValueError, match=r"rig.yaml: fps: expected frames a second > 0, got " + re.escape(repr(fps))):
        open_recording(tiny_recording)


# --- recordings that do not fit together -----------------------------------------------------------
def lose(name: str) -> Callable[[Path], object]:
    return lambda folder: [path.unlink() for path in (folder / "frames/left").glob(name)]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lose("0000.png"), "views of different length or names: left has 4 frames .1 to 4., right has 5 frames"),
        (lose("000[1-3].png"), "views of different length or names: left has 2 frames .0 to 4., right has 5 frames"),
        (lambda f: (f / "frames/left/0004.png").rename(f / "frames/left/0009.png"), "left has 5 frames .0 to 9."),
        (lambda f: shutil.rmtree(f / "frames/left"), "no frames for camera 'left' .expected frames/left/"),
        (lambda f: [p.unlink() for p in (f / "frames/left").iterdir()], "no frames for camera 'left'"),
        (lambda f: shutil.rmtree(f / "frames"), "no frames for camera 'left'"),
        (lambda f: (f / "rig.yaml").unlink(), "rig.yaml: cannot read"),
        (lambda f: (f / "rig.yaml").write_text("[1"), "rig.yaml: not valid YAML"),
    ],
)
def test_views_that_do_not_fit(tiny_recording: Path, damage: Callable[[Path], object], message: str) -> None:
    damage(tiny_recording)
    with pytest.raises(ValueError, match=message):
        open_recording(tiny_recording)


@pytest.mark.parametrize("camera", ["left", "right"])
@pytest.mark.parametrize("lost", [{2}, {4}, {1, 2}, {3, 4}, {1, 4}])
def test_a_camera_that_drops_out(tiny_recording: Path, camera: str, lost: set[int]) -> None:
    whole = dict(open_recording(tiny_recording).images())
    for frame in lost:
        (tiny_recording / f"frames/{camera}/{frame:04d}.png").unlink()
    recording = open_recording(tiny_recording)
    assert recording.frames == (0, 1, 2, 3, 4)
    seen = dict(recording.images())
    assert list(seen) == [0, 1, 2, 3, 4]
    for frame, images in seen.items():
        assert list(images) == [name for name in ("left", "right") if name != camera or frame not in lost]
        assert all(np.array_equal(image, whole[frame][name]) for name, image in images.items())
    some = min(lost)
    assert [list(images) for _, images in recording.images([0, some])] == [["left", "right"], list(seen[some])]
    sample = recording.sample(100)
    assert {name: len(images) for name, images in sample.items()} == {"left": 5, "right": 5} | {camera: 5 - len(lost)}
    assert open_recording(tiny_recording, [camera]).frames == tuple(sorted({0, 1, 2, 3, 4} - lost))


def test_a_camera_that_keeps_half_of_the_pictures_dropped_out(tiny_recording: Path) -> None:
    (tiny_recording / "frames/right/0004.png").unlink()
    for frame in (1, 3):
        (tiny_recording / f"frames/left/{frame:04d}.png").unlink()
    with pytest.raises(ValueError, match=r"left has 3 frames \(0 to 4\), right has 4 frames \(0 to 3\)"):
        open_recording(tiny_recording)  # each has what the other lacks: who is to say that the numbers mean the same?
    (tiny_recording / "frames/left/0004.png").unlink()
    assert [list(images) for _, images in open_recording(tiny_recording).images()] == [["left", "right"], ["right"]] * 2


def test_without_numbers_nobody_knows_which_picture_is_lost(tiny_recording: Path) -> None:
    for name in ("left", "right"):
        for path in (tiny_recording / "frames" / name).iterdir():
            path.rename(path.with_stem("abcde"[int(path.stem)]))
    lose("e.png")(tiny_recording)
    with pytest.raises(ValueError, match=r"left has 4 frames \(0 to 3\), right has 5 frames \(0 to 4\)"):
        open_recording(tiny_recording)


def test_a_recording_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "nowhere", tmp_path / "file"):
        with pytest.raises(ValueError, match=f"{path.name}: no such recording folder"):
            open_recording(path)


def test_a_camera_that_is_not_in_the_rig(tiny_recording: Path) -> None:
    with pytest.raises(ValueError, match="camera 'top' is not in the rig; it has left, right"):
        open_recording(tiny_recording, ["left", "top"])


def test_damaged_frames_are_named(tiny_recording: Path) -> None:
    path = tiny_recording / "frames/right/0002.png"
    save_rgb(path, plain((0, 0, 0), (80, 60)))
    recording = open_recording(tiny_recording)
    with pytest.raises(ValueError, match=r"tiny frame 2 of right: expected uint8 \(120, 160, 3\), got uint8 \(60, 80"):
        list(recording.images())
    assert len(list(recording.images([0, 1, 3, 4]))) == 4  # what nobody asked for is not read
    path.unlink()
    with pytest.raises(ValueError, match=r"right/0002.png: cannot read"):
        list(recording.images())


# --- videos ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_videos_read_in_order_and_in_rgb(tiny_recording: Path, suffix: str) -> None:
    use_videos(tiny_recording, {"left": 5, "right": 5}, suffix, fps=20.0)
    recording = open_recording(tiny_recording)
    assert recording.frames == (0, 1, 2, 3, 4)
    assert recording.fps == pytest.approx(20)
    for wanted in (None, [1, 4]):
        for frame, images in recording.images(wanted):
            for image in images.values():
                assert (image.shape, image.dtype) == ((120, 160, 3), np.uint8)
                assert np.abs(image.mean(axis=(0, 1)) - [40 * frame, 0, 0]).max() < 12
    change_rig(tiny_recording, fps=5)
    assert open_recording(tiny_recording).fps == 5
    change_rig(tiny_recording, fps=0)
    with pytest.raises(ValueError, match="fps: expected frames a second > 0, got 0"):
        open_recording(tiny_recording)


def test_a_video_beside_pictures(tiny_recording: Path) -> None:
    use_videos(tiny_recording, {"left": 5})
    assert len(list(open_recording(tiny_recording).images())) == 5
    (tiny_recording / "frames/left.mp4").unlink()
    save_video(tiny_recording / "frames/left.mp4", 3)
    with pytest.raises(ValueError, match=r"left has 3 frames \(0 to 2\), right has 5 frames"):
        open_recording(tiny_recording)


def test_video_of_the_wrong_size(tiny_recording: Path) -> None:
    use_videos(tiny_recording, {"left": 5}, size=(80, 64))
    with pytest.raises(ValueError, match=r"tiny frame 0 of left: expected uint8 \(120, 160, 3\), got uint8 \(64, 80"):
        next(open_recording(tiny_recording).images())


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
@pytest.mark.parametrize("content", [b"", b"x" * 1000])
def test_a_file_that_is_no_video(
    tiny_recording: Path, suffix: str, content: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(tiny_recording / "frames/left")
    (tiny_recording / f"frames/left{suffix}").write_bytes(content)
    with pytest.raises(ValueError, match=f"frames/left{suffix}: corrupt or empty video"):
        open_recording(tiny_recording)
    assert capfd.readouterr().err == ""  # FFmpeg must not add lines of its own


def test_an_empty_floor_may_be_a_video(tiny_recording: Path) -> None:
    shutil.rmtree(tiny_recording / "background/left")
    save_video(tiny_recording / "background/left.avi", 70)
    recording = open_recording(tiny_recording)
    assert recording.without_background == []
    backgrounds = recording.background_images()
    assert {name: len(images) for name, images in backgrounds.items()} == {"left": 60, "right": 2}
    assert backgrounds["left"][0].mean() < backgrounds["left"][3].mean()
    (tiny_recording / "background/left.avi").unlink()
    save_video(tiny_recording / "background/left.avi", 2, size=(80, 64))
    with pytest.raises(ValueError, match=r"background/left.avi: expected uint8 \(120, 160, 3\), got uint8 \(64, 80"):
        recording.background_images()


def test_the_pictures_of_the_empty_floor_are_opened_once(tiny_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening a video looks for its end, which takes a while."""
    opened: list[Path] = []
    monkeypatch.setattr(recordings, "open_footage", lambda place: opened.append(place) or footage.open_footage(place))
    recording = open_recording(tiny_recording)
    opened.clear()
    assert recording.without_background == [] and len(recording.background_images()["left"]) == 2
    assert recording.without_background == []
    assert sorted(opened) == [tiny_recording / "background" / name for name in ("left", "right")]


# --- formats ---------------------------------------------------------------------------------------
def test_a_format_of_ones_own(tiny_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = dict(open_recording(tiny_recording).images())
    monkeypatch.setattr(footage, "FORMATS", dict(footage.FORMATS))

    @input_format(".npy")
    def _stack(place: Path) -> Footage | None:
        path = place.with_name(place.name + ".npy")
        if not path.is_file():
            return None
        stack = np.load(path, mmap_mode="r")
        return Footage(path, tuple(range(len(stack))), lambda positions: (np.array(stack[i]) for i in positions))

    shutil.rmtree(tiny_recording / "frames/left")
    with pytest.raises(
        ValueError, match=r"left' \(expected frames/left/\*.png\|jpg or frames/left.mp4\|avi or .*npy\)"
    ):
        open_recording(tiny_recording)
    np.save(tiny_recording / "frames/left.npy", np.stack([images["left"] for images in whole.values()]))
    recording = open_recording(tiny_recording)
    assert recording.frames == (0, 1, 2, 3, 4) and recording.fps == 10
    for frame, images in recording.images([1, 4]):
        assert all(np.array_equal(images[name], whole[frame][name]) for name in ("left", "right"))


def test_numbers_in_one_view_and_letters_in_the_other_do_not_fit(tiny_recording: Path) -> None:
    for path in (tiny_recording / "frames/left").iterdir():
        path.rename(path.with_stem(f"{int(path.stem) + 40}"))
    for path in (tiny_recording / "frames/right").iterdir():
        path.rename(path.with_stem("abcde"[int(path.stem)]))
    with pytest.raises(ValueError, match=r"left has 5 frames \(40 to 44\), right has 5 frames \(0 to 4\)"):
        open_recording(tiny_recording)


# --- which frames ----------------------------------------------------------------------------------
BOUND = st.none() | st.integers(-5, 30)


@settings(max_examples=300, deadline=None)
@given(st.sets(st.integers(0, 25), min_size=1), BOUND, BOUND, st.none() | st.integers(1, 9))
def test_parse_frames_is_a_range_of_numbers(
    have: set[int], start: int | None, stop: int | None, step: int | None
) -> None:
    frames = sorted(have)
    text = ":".join("" if part is None else str(part) for part in (start, stop, step))
    numbers = range(frames[0] if start is None else start, frames[-1] + 1 if stop is None else stop, step or 1)
    expected = [frame for frame in numbers if frame in have]
    if expected:
        assert parse_frames(text, frames) == expected
        if step is None:
            assert parse_frames(text.removesuffix(":"), frames) == expected
    else:
        with pytest.raises(ValueError, match="selects none of the frames"):
            parse_frames(text, frames)


def test_parse_frames_single_numbers_and_huge_ranges() -> None:
    assert parse_frames("7", [3, 7, 9]) == [7]
    assert parse_frames(":", [3, 7, 9]) == [3, 7, 9]
    assert parse_frames("4:" + "9" * 400, [3, 7, 9]) == [7, 9]
    assert parse_frames("0:10:1" + "0" * 400, [0, 5]) == [0]
    for text in ("4", "-1", "5:1", "10:"):
        with pytest.raises(ValueError, match=f"--frames: '{text}' selects none of the frames 3 to 9"):
            parse_frames(text, [3, 7, 9])


@pytest.mark.parametrize("text", ["", " ", "abc", "1.5", "1:2:3:4", "::0", "::-1", "4:0:-1", "1:x", "1-3", "9" * 5000])
def test_parse_frames_that_are_none(text: str) -> None:
    with pytest.raises(
        ValueError, match=r"--frames: expected a number or START:STOP:STEP with STEP > 0, got '"
    ) as caught:
        parse_frames(text, range(10))
    assert len(str(caught.value)) < 150


# --- files whole or not at all ---------------------------------------------------------------------
def test_write_file_makes_folders_and_replaces(tmp_path: Path) -> None:
    path = write_file(tmp_path / "a/b/file.txt", "grün\n")
    assert path.read_bytes() == "grün\n".encode()
    assert write_file(path, b"\x00\x01").read_bytes() == b"\x00\x01"
    assert [p.name for p in path.parent.iterdir()] == ["file.txt"]
    assert path.stat().st_mode & 0o777 == 0o666 & ~current_umask()  # as open() would make it


def current_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


class FullDisk(io.BytesIO):
    def write(self, content: Any, /) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def full_disk(monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    def fail(*args: Any, **options: Any) -> Any:
        if where == "fdopen":
            os.close(args[0])
            return FullDisk()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(f"occlib.base.files.{'tempfile' if where == 'mkstemp' else 'os'}.{where}", fail)


@pytest.mark.parametrize("where", ["fdopen", "replace", "mkstemp", "chmod"])
def test_a_full_disk_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    path = write_file(tmp_path / "results/old.txt", "old")
    full_disk(monkeypatch, where)
    for name in ("old.txt", "new.txt"):
        with pytest.raises(ValueError, match=rf"{name}: cannot write \(No space left on device\)"):
            write_file(path.with_name(name), "new")
    assert [p.name for p in path.parent.iterdir()] == ["old.txt"]
    assert path.read_text() == "old"


def test_an_interrupted_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*args: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("occlib.base.files.os.replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_file(tmp_path / "file.txt", "new")
    assert not list(tmp_path.iterdir())


def test_folders_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("keep")
    with pytest.raises(ValueError, match=r"file/below/x.txt: cannot write \("):
        write_file(tmp_path / "file/below/x.txt", "new")
    with pytest.raises(ValueError, match=r"cannot write \("):
        write_file(tmp_path, "a folder is there")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_read_only_folder(tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    if os.access(locked, os.W_OK):
        pytest.skip("this user may write to read-only folders")
    with pytest.raises(ValueError, match=r"locked/x.txt: cannot write \(Permission denied\)"):
        write_file(locked / "x.txt", "new")


def test_staged_files_appear_together(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_file(out / "a.txt", "old")
    with staged_folder(out) as stage:
        write_file(stage / "a.txt", "new")
        write_file(stage / "maps/b.txt", "new")
        assert (out / "a.txt").read_text() == "old"
    assert sorted(str(p.relative_to(out)) for p in out.rglob("*")) == ["a.txt", "maps", "maps/b.txt"]
    assert (out / "a.txt").read_text() == "new"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_staged_files_vanish_on_failure(tmp_path: Path, error: type[BaseException]) -> None:
    write_file(tmp_path / "old/a.txt", "old")
    for name in ("old", "new"):
        with pytest.raises(error), staged_folder(tmp_path / name) as stage:
            write_file(stage / "a.txt", "new")
            raise error
    assert [str(p.relative_to(tmp_path)) for p in sorted(tmp_path.rglob("*"))] == ["old", "old/a.txt"]
    assert (tmp_path / "old/a.txt").read_text() == "old"


def test_read_yaml_names_the_file(tmp_path: Path) -> None:
    for name, content in {"a": b"[1", "b": b"\xff\xfe\x81", "c": b"[" * 20_000, "d": b"x: 2001-99-99"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}: not valid YAML") as caught:
            read_yaml(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"gone: cannot read \(No such file"):
        read_yaml(tmp_path / "gone")


# --- public data, from a server of our own ---------------------------------------------------------
class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A catalogue with the recording ``demo``, served from this machine; the cache is a folder of the test's."""
    public = tmp_path / "public"
    files = {"frames/left.mp4": b"left" * 1000, "frames/right.mp4": b"right" * 1000}
    for target, content in files.items():
        write_file(public / Path(target).name, content)
    write_file(tmp_path / "data/demo/rig.yaml", "units: m\n")
    monkeypatch.setattr(recordings, "DATA", tmp_path / "data")
    monkeypatch.setenv("OCCLIB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(QuietHandler, directory=str(public)))
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    entries = {
        "demo": {
            "about": "a test",
            "url": f"http://127.0.0.1:{server.server_port}/",
            "files": {
                target: {"name": Path(target).name, "sha256": hashlib.sha256(content).hexdigest()}
                for target, content in files.items()
            },
        }
    }
    yield write_file(tmp_path / "sources.yaml", yaml.safe_dump(entries))
    server.shutdown()
    server.server_close()
    thread.join()


def change_catalogue(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    content = yaml.safe_load(path.read_text())
    change(content["demo"])
    path.write_text(yaml.safe_dump(content))


def test_fetch_downloads_once_and_adds_our_files(catalogue: Path, tmp_path: Path) -> None:
    folder = fetch("demo", catalogue=catalogue)
    assert folder == tmp_path / "cache/demo"
    stored = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert stored == {
        "frames/left.mp4": b"left" * 1000,
        "frames/right.mp4": b"right" * 1000,
        "rig.yaml": b"units: m\n",
    }
    shutil.rmtree(tmp_path / "public")  # what is in the cache needs no server
    assert fetch("demo", catalogue=catalogue) == folder


def test_fetch_mends_a_damaged_file(catalogue: Path) -> None:
    path = fetch("demo", catalogue=catalogue) / "frames/left.mp4"
    path.write_bytes(b"damaged")
    fetch("demo", catalogue=catalogue)
    assert path.read_bytes() == b"left" * 1000


def test_fetch_refuses_a_wrong_checksum(catalogue: Path, tmp_path: Path) -> None:
    (tmp_path / "public/right.mp4").write_bytes(b"changed by somebody")
    with pytest.raises(ValueError, match=r"demo: cannot fetch frames/right.mp4 \(.*hash"):
        fetch("demo", catalogue=catalogue)
    assert [p.name for p in (tmp_path / "cache").rglob("*") if p.is_file()] == ["left.mp4"]


def test_fetch_of_a_file_that_the_server_lacks(catalogue: Path, tmp_path: Path) -> None:
    (tmp_path / "public/left.mp4").unlink()
    with pytest.raises(ValueError, match=r"demo: cannot fetch frames/left.mp4 \(HTTP Error 404"):
        fetch("demo", catalogue=catalogue)
    assert not [p for p in (tmp_path / "cache").rglob("*") if p.is_file()]


def test_fetch_without_a_server(catalogue: Path, tmp_path: Path) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    change_catalogue(catalogue, lambda demo: demo.update(url=f"http://127.0.0.1:{port}/"))
    with pytest.raises(ValueError, match=r"demo: cannot fetch frames/left.mp4"):
        fetch("demo", catalogue=catalogue)
    assert not [p for p in (tmp_path / "cache").rglob("*") if p.is_file()]


def test_fetch_into_a_cache_that_cannot_be_written(
    catalogue: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("OCCLIB_CACHE", str(tmp_path / "file/cache"))
    with pytest.raises(ValueError, match=r"demo: cannot fetch frames/left.mp4"):
        fetch("demo", catalogue=catalogue)


def test_fetch_of_an_unknown_name(catalogue: Path) -> None:
    with pytest.raises(ValueError, match="nothing: not a public recording; there are demo"):
        fetch("nothing", catalogue=catalogue)


def test_the_catalogue_that_ships_is_complete() -> None:
    known = recordings.public_recordings()
    assert {"ufes-lab", "opencv-checkerboard"} <= set(known)
    for source in known.values():
        assert source["about"]
        assert source["url"].startswith("https://")
        assert source["url"].endswith("/")
        for target, file in source["files"].items():
            assert not Path(target).is_absolute()
            assert ".." not in Path(target).parts
            assert re.fullmatch("[0-9a-f]{64}", file["sha256"])


def test_a_fetched_recording_opens_by_name(
    tiny_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OCCLIB_CACHE", str(tmp_path / "cache"))
    shutil.copytree(tiny_recording, tmp_path / "cache/demo")
    monkeypatch.chdir(tmp_path)
    assert open_recording("demo").frames == (0, 1, 2, 3, 4)


def test_a_png_that_is_cut_or_damaged_anywhere_is_refused_in_silence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    whole = files_module.encode_image(".png", picture)
    path = tmp_path / "0000.png"
    for bad in [whole[:at] for at in range(0, len(whole), 97)] + [whole[:60] + b"?" + whole[61:]]:
        path.write_bytes(bad)
        with pytest.raises(ValueError, match=r"0000\.png: corrupt or not an image"):
            files_module.read_image(path)
    path.write_bytes(whole)
    np.testing.assert_array_equal(files_module.read_image(path), picture)
    assert capfd.readouterr().err == ""


def test_a_folder_in_the_way_stops_everything_before_anything_moves(tmp_path: Path) -> None:
    (tmp_path / "out" / "b.txt" / "x").mkdir(parents=True)
    with pytest.raises(ValueError, match=r"b\.txt: cannot write \(is a directory\)"):
        with files_module.staged_folder(tmp_path / "out") as stage:
            for name in ("a.txt", "b.txt"):
                (stage / name).write_text("new")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["b.txt"]


def test_a_number_anywhere_in_the_name_counts_if_it_is_the_only_one(tiny_recording: Path) -> None:
    for folder in (tiny_recording / "frames").iterdir():
        for path in sorted(folder.iterdir()):
            path.rename(path.with_name(f"{int(path.stem) + 40:04d}_{folder.name}{path.suffix}"))
    assert recordings.open_recording(tiny_recording).frames[:2] == (40, 41)


def test_pictures_beside_a_video_are_counted_from_its_first_frame(tiny_recording: Path) -> None:
    pictures = sorted((tiny_recording / "frames/right").iterdir())
    for path in reversed(pictures):
        path.rename(path.with_stem(f"{int(path.stem) + 1:04d}"))
    use_videos(tiny_recording, {"left": len(pictures)}, ".avi")
    assert recordings.open_recording(tiny_recording).frames == tuple(range(len(pictures)))


def test_templates_are_read_with_what_counts_of_them(tmp_path: Path) -> None:
    colours = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    alpha = np.full((4, 4, 1), 255, np.uint8)
    alpha[0] = 0
    cv2.imwrite(str(tmp_path / "cut.png"), np.dstack([colours[..., ::-1], alpha]))
    cv2.imwrite(str(tmp_path / "whole.png"), colours[..., ::-1])
    templates = read_templates(tmp_path)
    assert list(templates) == ["cut", "whole"]
    assert np.array_equal(templates["cut"], np.dstack([colours, alpha]))
    assert (templates["whole"][..., 3] == 255).all()
    with pytest.raises(ValueError, match=r"nowhere: expected pictures named LABEL.png, found none"):
        read_templates(tmp_path / "nowhere")


def test_a_file_in_the_way_of_a_folder_leaves_the_old_results(tmp_path: Path) -> None:
    (tmp_path / "maps").write_text("a file")
    (tmp_path / "map.pgm").write_text("old")
    with pytest.raises(ValueError, match=r"maps: cannot write \(a file is in the way of the folder\)"):
        with staged_folder(tmp_path) as stage:
            (stage / "map.pgm").write_text("new")
            (stage / "maps").mkdir()
            (stage / "maps/0.pgm").write_text("new")
    assert (tmp_path / "map.pgm").read_text() == "old"
