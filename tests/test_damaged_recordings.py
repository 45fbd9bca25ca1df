"""Recordings that are damaged, or hold what does not belong there: the rest is used, and what is not is named."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from helpers.commands import error_lines, fails, run
from helpers.damages import cut, picture
from helpers.videos import as_videos, promise, save_video, spoil, use_videos
from occlib.base.checks import Notice
from occlib.base.files import encode_image, read_image, write_file
from occlib.cli import main
from occlib.formats import load_truth
from occlib.live import Player
from occlib.pipeline import backgrounds_of
from occlib.recordings import open_recording

AND = ["--profile", "and"]  # quick


# --- pictures of the empty floor -------------------------------------------------------------------
def test_a_video_of_the_empty_floor_is_used(tiny_recording: Path, tmp_path: Path) -> None:
    expected = backgrounds_of(open_recording(tiny_recording))["left"].image
    shutil.rmtree(tiny_recording / "background/left")
    save_video(tiny_recording / "background/left.AVI", 2)  # in capitals, as some cameras write them
    recording = open_recording(tiny_recording)
    assert recording.without_background == []
    taken = backgrounds_of(recording)["left"].image
    assert taken[..., 1:].max() < 20 < expected[..., 1:].min()  # the red of the video


@pytest.mark.parametrize("folder", ["background", "frames"])
def test_two_sources_for_one_camera_are_refused(
    tiny_recording: Path, tmp_path: Path, folder: str, capfd: pytest.CaptureFixture[str]
) -> None:
    save_video(tiny_recording / folder / "left.mp4", 5)
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "out")
    assert f"tiny/{folder}: expected one source of pictures for camera 'left', got left/ and left.mp4" in said
    shutil.rmtree(tiny_recording / folder / "left")
    save_video(tiny_recording / folder / "left.avi", 5)
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "out")
    assert f"tiny/{folder}: expected one source of pictures for camera 'left', got left.avi and left.mp4" in said


def test_pictures_of_the_empty_floor_may_be_png_and_jpeg(tiny_recording: Path) -> None:
    for i, suffix in enumerate([".jpg", ".jpeg", ".JPG"]):
        image = np.full((120, 160, 3), 180 + i, np.uint8)
        write_file(tiny_recording / f"background/left/more_{i}{suffix}", encode_image(suffix.lower(), image))
    levels = [int(image.mean().round()) for image in open_recording(tiny_recording).background_images()["left"]]
    assert sorted(levels) == [170, 170, 180, 181, 182]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("other.avi", b"x"),
        ("left.mkv", b"x"),
        ("right/video.avi", b"x"),
        ("left/notes.txt", b"x"),
        ("top/0.png", b"x"),
    ],
)
def test_what_lies_in_the_background_and_is_not_used_is_named(tiny_recording: Path, name: str, content: bytes) -> None:
    (tiny_recording / "background" / name).parent.mkdir(exist_ok=True)
    (tiny_recording / "background" / name).write_bytes(content)
    (tiny_recording / "background/.hidden").write_bytes(b"")
    (tiny_recording / "background/empty").mkdir()
    named = "top/" if name.startswith("top") else name
    expected = rf"tiny/background: ignored {named} \(expected CAMERA/\*.png\|jpg or CAMERA.mp4\|avi of left, right\)$"
    with pytest.warns(Notice, match=expected) as caught:
        images = open_recording(tiny_recording).background_images()
    assert len(caught) == 1
    assert {camera: len(pictures) for camera, pictures in images.items()} == {"left": 2, "right": 2}


def test_other_cameras_have_pictures_of_the_empty_floor_too(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording, ["right"])
    assert list(recording.background_images()) == ["right"]  # and no warning of left/
    save_video(tiny_recording / "background/top.avi", 2)
    with pytest.warns(Notice, match="ignored top.avi "):
        recording.background_images()


def test_a_folder_without_a_picture_is_named(tiny_recording: Path) -> None:
    for path in (tiny_recording / "background/left").iterdir():
        path.rename(path.with_suffix(".bmp"))
    with pytest.warns(Notice, match="ignored left/ "):
        assert list(backgrounds_of(open_recording(tiny_recording))) == ["left", "right"]


def test_a_damaged_video_of_the_empty_floor(tiny_recording: Path) -> None:
    shutil.rmtree(tiny_recording / "background/left")
    path = tiny_recording / "background/left.avi"
    save_video(path, 6)
    spoil(path, 2)
    assert len(open_recording(tiny_recording).background_images()["left"]) == 5
    promise(path, 9)
    with pytest.warns(Notice, match="background/left.avi: 6 of 9 promised frames can be read$"):
        assert len(open_recording(tiny_recording).background_images()["left"]) == 5


# --- videos that end early -------------------------------------------------------------------------
def test_a_recording_ends_where_its_videos_can_no_longer_be_read(tiny_recording: Path) -> None:
    as_videos(tiny_recording)
    for name in ("left", "right"):
        promise(tiny_recording / f"frames/{name}.avi", 8)
    with pytest.warns(Notice) as caught:
        recording = open_recording(tiny_recording)
    assert [str(one.message) for one in caught] == [
        f"{tiny_recording}: ends at frame 4 (left.avi, right.avi: 5 of 8 promised frames can be read)"
    ]
    assert recording.frames == (0, 1, 2, 3, 4)
    assert [sorted(images) for _, images in recording.images()] == [["left", "right"]] * 5
    assert [len(images) for images in recording.sample(60).values()] == [5, 5]
    assert len(list(Player(recording, rate=0))) == 5
    shutil.rmtree(tiny_recording / "background")
    assert list(backgrounds_of(recording)) == ["left", "right"]
    with pytest.raises(ValueError, match="frames: 5 is not in tiny, which has 0 to 4"):
        next(recording.images([4, 5]))


@pytest.mark.parametrize(
    ("counts", "promised", "told"),
    [
        ((5, 3), (8, 6), r"ends at frame 2 \(left.avi: 5 of 8 promised frames can be read; right.avi: 3 of 6 promised"),
        ((5, 3), (5, 5), r"ends at frame 2 \(left.avi: 5 frames can be read; right.avi: 3 of 5 promised frames can be"),
        ((3, 5), (3, 5), r"ends at frame 2 \(right.avi: 5 frames can be read\)"),
    ],
)
def test_a_recording_ends_with_its_shortest_video(
    tiny_recording: Path, counts: tuple[int, int], promised: tuple[int, int], told: str
) -> None:
    use_videos(tiny_recording, dict(zip(("left", "right"), counts, strict=True)), ".avi")
    for name, count in zip(("left", "right"), promised, strict=True):
        promise(tiny_recording / f"frames/{name}.avi", count)
    with pytest.warns(Notice, match=told) as caught:
        recording = open_recording(tiny_recording)
    assert len(caught) == 1
    assert [(frame, sorted(images)) for frame, images in recording.images()] == [
        (frame, ["left", "right"]) for frame in range(3)
    ]


def test_pictures_end_with_a_video_beside_them_that_is_short(tiny_recording: Path) -> None:
    use_videos(tiny_recording, {"left": 3}, ".avi")
    promise(tiny_recording / "frames/left.avi", 5)
    with pytest.warns(Notice, match=r"ends at frame 2 \(left.avi: 3 of 5 promised frames can be read; right: 5 frames"):
        assert open_recording(tiny_recording).frames == (0, 1, 2)


def test_a_video_cut_short(tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    as_videos(tiny_recording)
    path = tiny_recording / "frames/left.avi"
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.index(b"movi") + (len(whole) - whole.index(b"movi")) * 6 // 10])
    lines = run(tiny_recording, tmp_path / "out", *AND)
    assert [line["frame"] for line in lines] == list(range(len(lines)))
    assert 1 <= len(lines) < 5
    (said,) = error_lines(capfd)
    assert f"tiny: ends at frame {len(lines) - 1} (left.avi: {len(lines)} of 5 promised frames can be read" in said


def test_run_ends_where_the_videos_do(tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    as_videos(tiny_recording)
    for name in ("left", "right"):
        promise(tiny_recording / f"frames/{name}.avi", 9)
    shutil.rmtree(tiny_recording / "background")  # learned, from frames spread over the recording
    warning = (
        f"occlib run: warning: {tiny_recording}: ends at frame 4 "
        "(left.avi, right.avi: 5 of 9 promised frames can be read)"
    )
    for options, frames in (((), range(5)), (("--frames", "3:30"), range(3, 5)), (("--frames", "0:2"), range(2))):
        lines = run(tiny_recording, tmp_path / "out", *AND, *options)
        assert [line["frame"] for line in lines] == list(frames)
        assert not any("excluded" in line for line in lines)
        assert error_lines(capfd) == [warning]
    arguments = ["run", str(tiny_recording), "--out", str(tmp_path / "none"), "--frames", "5:9"]
    assert main(arguments) == 2
    assert error_lines(capfd) == [
        warning,
        "occlib run: --frames: '5:9' selects none of the frames 0 to 4",
    ]


# --- pictures that cannot be read ------------------------------------------------------------------
def cut_jpeg(folder: Path, *, zeros: bool) -> None:
    path = folder / "frames/right/0002.png"
    content = encode_image(".jpg", read_image(path))
    path.unlink()
    rest = bytes(len(content) // 2) if zeros else b""
    path.with_suffix(".jpg").write_bytes(content[: len(content) // 2] + rest)


DAMAGED: dict[str, Callable[[Path], object]] = {
    "right/0002.png": picture("frames/right/0002.png", b""),
    "right/0002.png, of text": picture("frames/right/0002.png", b"hello"),
    "right/0002.png, cut": cut("frames/right/0002.png"),
    "right/0002.jpg, cut": lambda folder: cut_jpeg(folder, zeros=False),
    "right/0002.jpg, cut, with zeros in the place of the rest": lambda folder: cut_jpeg(folder, zeros=True),
    "frame 2 of right.avi": lambda folder: (as_videos(folder), spoil(folder / "frames/right.avi", 2)),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_a_camera_is_missing_where_its_picture_is_damaged(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], what: str
) -> None:
    DAMAGED[what](tiny_recording)
    recording = open_recording(tiny_recording)
    told = f"tiny/frames: right is missing where its pictures cannot be read: {what.split(',')[0]}"
    with pytest.warns(Notice, match=f"{told}$") as caught:
        images = dict(recording.images())
    assert len(caught) == 1
    assert [sorted(images[frame]) for frame in range(5)] == [["left", "right"]] * 2 + [["left"]] + [
        ["left", "right"]
    ] * 2
    assert {name: len(pictures) for name, pictures in recording.sample(9).items()} == {"left": 5, "right": 4}
    assert len(list(recording.images([0, 1, 3, 4]))) == 4  # what nobody asked for is not missed
    lines = run(tiny_recording, tmp_path / "out", *AND)
    assert [line.get("excluded") for line in lines] == [None, None, {"right": "missing"}, None, None]
    assert error_lines(capfd) == [
        f"occlib run: warning: {tiny_recording.parent}/{told}",
        "occlib run: warning: right: missing in frame 2, left out",
    ]


def test_a_view_of_which_no_picture_is_whole(
    tiny_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for path in (tiny_recording / "frames/right").iterdir():
        path.write_bytes(b"")
    run(tiny_recording, tmp_path / "out", *AND)
    told = "right is missing where its pictures cannot be read: right/0000.png, right/0001.png, right/0002.png, right/0003.png and 1 more"
    assert error_lines(capfd) == [
        f"occlib run: warning: {tiny_recording}/frames: {told}",
        "occlib run: warning: right: missing in all frames, left out",
    ]
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "none", *AND, "--cameras", "right")
    assert said == f"{tiny_recording}/frames: {told}"  # with no picture at all there is nothing to go on with
    shutil.rmtree(tiny_recording / "background")
    said = fails(capfd, "run", tiny_recording, "--out", tmp_path / "none", *AND)
    assert said == f"{tiny_recording}/frames: no picture of right can be read"
    assert not (tmp_path / "none").exists()


def test_broadcasting_goes_on(tiny_recording: Path, capfd: pytest.CaptureFixture[str]) -> None:
    as_videos(tiny_recording)
    spoil(tiny_recording / "frames/right.avi", 2)
    promise(tiny_recording / "frames/left.avi", 7)
    address = ["--address", "tcp://127.0.0.1:*"]
    assert main(["broadcast", str(tiny_recording), *address, "--rate", "0", *AND]) == 0
    first, second, third, fourth = error_lines(capfd)
    assert "warning" in first and "ends at frame 4 (left.avi: 5 of 7 promised frames can be read)" in first
    assert second.startswith("publishing at")
    assert "right is missing where its pictures cannot be read: frame 2 of right.avi" in third
    assert fourth == "occlib broadcast: warning: right: missing in 1 maps, left out"


# --- a real one ------------------------------------------------------------------------------------
@pytest.fixture
def horse(tmp_path: Path, shared_data: Callable[[str], Path]) -> Path:
    """A real recording whose videos promise 428 frames, of which 426 can be decoded, without its background."""
    source, folder = shared_data("uu-horse"), tmp_path / "horse"
    folder.mkdir()
    for name in ("rig.yaml", "truth.json", "frames"):
        (folder / name).symlink_to(source / name)
    return folder


HORSE = "cam1.avi, cam2.avi, cam3.avi, cam4.avi: 426 of 428 promised frames can be read"


@pytest.mark.slow
def test_a_real_recording_that_promises_more_than_it_has(
    horse: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.warns(Notice) as caught:
        recording = open_recording(horse)
    assert [str(one.message) for one in caught] == [f"{horse}: ends at frame 425 ({HORSE})"]
    assert recording.frames == tuple(range(426))
    video = cv2.VideoCapture(str(horse / "frames/cam4.avi"))
    direct = [video.read()[1] for _ in range(426)]
    video.release()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [len(pictures) for pictures in recording.sample(60).values()] == [60] * 4
        for frame, images in recording.images():
            assert list(images) == ["cam1", "cam2", "cam3", "cam4"]
            assert np.array_equal(images["cam4"], direct[frame][..., ::-1])


@pytest.mark.slow
def test_a_real_recording_is_run_to_its_end(horse: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for options, frames in ((("--frames", "0:30:10"), [0, 10, 20]), (("--frames", "405::10"), [405, 415, 425])):
        lines = run(horse, tmp_path / "out", "--cameras", "cam1", "cam4", *AND, *options)
        assert [line["frame"] for line in lines] == frames
        expected = HORSE.replace(" cam2.avi, cam3.avi,", "")
        assert error_lines(capfd) == [f"occlib run: warning: {horse}: ends at frame 425 ({expected})"]
    assert main(["evaluate", str(tmp_path / "out/objects.jsonl"), str(horse / "truth.json"), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["frames"] >= 0
    assert max(load_truth(horse / "truth.json").frames) == 420


def test_nothing_is_said_of_a_whole_recording(shared_data: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(open_recording(shared_data("ufes-lab")).frames) == 268
        open_recording(shared_data("p2s-multi")).background_images()
