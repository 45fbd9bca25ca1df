"""Videos: how many frames can be read, whatever the file promises, and each in its place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from helpers.videos import index_first, promise, save_video, spoil
from occlib.base import videos
from occlib.base.videos import measure_video, video_frames


def levels(path: Path, positions: list[int], step: int = 12) -> list[int | None]:
    """Which frame is at each position, as told by its colour."""
    images = video_frames(path, positions)
    return [None if image is None else round(float(image[..., 0].mean()) / step) for image in images]


@pytest.fixture(params=[".mp4", ".avi"])
def video(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / f"video{request.param}"
    save_video(path, 20, step=12)
    return path


def test_a_whole_video(video: Path) -> None:
    assert measure_video(video) == (20, 20, 10.0)
    assert levels(video, list(range(20))) == list(range(20))
    assert levels(video, [3, 7, 19]) == [3, 7, 19]
    assert levels(video, []) == []


@pytest.mark.parametrize("promised", [21, 28, 500, 2**31 - 1, 2**32 - 1])
def test_a_header_that_promises_more(tmp_path: Path, promised: int) -> None:
    path = tmp_path / "video.avi"
    save_video(path, 20, step=12)
    promise(path, promised)
    assert measure_video(path) == (20, promised, 10.0)
    assert levels(path, [0, 19, 20]) == [0, 19, None]


@pytest.mark.parametrize("frame", [0, 1, 7, 18, 19])
def test_a_frame_that_cannot_be_decoded_leaves_the_others_in_place(video: Path, frame: int) -> None:
    spoil(video, frame)
    readable, promised, _ = measure_video(video)
    assert promised == 20
    assert readable == (19 if frame == 19 and video.suffix == ".avi" else 20)  # an MP4 file is taken at its word
    kept = levels(video, list(range(20)))
    assert kept[frame] is None
    if video.suffix == ".avi":  # each frame stands for itself; in MPEG-4 those after a lost first one look like it
        assert kept == [None if i == frame else i for i in range(20)]


def test_a_gap_has_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "video.avi"
    save_video(path, 20, step=12)
    for frame in (8, 9, 10):
        spoil(path, frame)
    assert levels(path, [7, 9, 12, 19]) == [7, None, 12, 19]
    monkeypatch.setattr(videos, "LONGEST_GAP", 2)
    assert levels(path, [7, 9, 12, 19]) == [7, None, None, None]


def test_an_mp4_file_cut_short(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    save_video(path, 20, step=12)
    index_first(path)
    whole = path.read_bytes()
    assert measure_video(path) == (20, 20, 10.0)
    path.write_bytes(whole[: len(whole) * 7 // 10])
    readable, promised, _ = measure_video(path)
    assert promised == 20 and 2 < readable < 20
    assert levels(path, list(range(20)))[readable:] == [None] * (20 - readable)
    assert None not in levels(path, list(range(readable)))


class Coded:
    """A decoder that looks ahead: a damaged frame is reported two frames before it is due."""

    def __init__(self, damaged: int, *, clock: bool = True) -> None:
        self.calls, self.damaged, self.clock, self.now = -1, damaged, clock, 0.0

    def get(self, field: int) -> float:
        return 25.0 if field == cv2.CAP_PROP_FPS else self.now

    def grab(self) -> bool:
        self.calls += 1
        order = [i for i in range(20) if i != self.damaged]
        order.insert(max(self.damaged - 2, 0), -1)
        self.now = 40.0 * order[self.calls] if self.clock and order[self.calls] >= 0 else 0.0
        return order[self.calls] >= 0


def test_a_decoder_that_looks_ahead_is_put_right_by_its_clock() -> None:
    def places(device: Any) -> list[int]:
        return list(videos._decodable(device, 20))

    assert places(Coded(10)) == [i for i in range(20) if i != 10]
    assert places(Coded(10, clock=False)) == [i for i in range(20) if i != 8]


@pytest.mark.parametrize("content", [b"", b"x" * 1000])
@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_what_is_no_video(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"video{suffix}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"video{suffix}: corrupt or empty video"):
        measure_video(path)


def test_not_one_frame_can_be_decoded(tmp_path: Path) -> None:
    path = tmp_path / "video.avi"
    save_video(path, 3)
    for frame in range(3):
        spoil(path, frame)
    with pytest.raises(ValueError, match=r"video.avi: corrupt or empty video"):
        measure_video(path)


@pytest.mark.slow
def test_a_damaged_frame_of_h264_is_lost_alone(tmp_path: Path, shared_data: Any) -> None:
    whole, path = shared_data("ufes-lab") / "frames/cam0.mp4", tmp_path / "cam0.mp4"
    path.write_bytes(whole.read_bytes())
    spoil(path, 100)  # it is shown as frame 99, and no other frame is coded as a difference from it
    around = list(range(95, 105))
    for i, one, other in zip(around, video_frames(whole, around), video_frames(path, around), strict=True):
        assert (other is None) == (i == 99)
        assert other is None or np.array_equal(np.asarray(one), other), i
