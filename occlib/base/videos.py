"""Videos as they are on disk: how many frames can be read, however many the file promises, and the frames themselves."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2

from occlib.base.arrays import Image

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # a corrupt video is reported here, in one line, not by FFmpeg


LONGEST_GAP = 1000
"""Frames in a row that cannot be decoded before the rest is given up: 20 s and more, and no endless wait where a damaged
header promises billions."""


def measure_video(path: Path) -> tuple[int, int, float]:
    """Frames that can be read, frames that the file promises, and frames a second (0 if the file says nothing).

    An MP4 file counts its frames in an index, and is trusted if it is whole. The header of an AVI file also counts what the
    camera dropped, so the last frame is sought and decoded. Only where that fails is the video decoded from its start.

    Raises ``ValueError`` if not one frame can be read.
    """
    video = cv2.VideoCapture(str(path))
    try:
        promised, fps = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), float(video.get(cv2.CAP_PROP_FPS))
        whole = promised > 0 and (_whole_mp4(path) or _reaches(video, promised - 1))
    finally:
        video.release()
    readable = promised if whole else 0
    if promised > 0 and not whole:
        video = cv2.VideoCapture(str(path))
        try:
            readable = max(_decodable(video, promised), default=-1) + 1
        finally:
            video.release()
    if readable < 1:
        raise ValueError(f"{path}: corrupt or empty video")
    return readable, promised, fps


def video_frames(path: Path, positions: Sequence[int]) -> Iterator[Image | None]:
    """The frames at these positions, ascending: uint8 RGB (H, W, 3), or ``None`` for one that cannot be decoded.

    All frames up to the last position are decoded, as seeking is not exact.
    """
    left = list(reversed(positions))
    video = cv2.VideoCapture(str(path))
    try:
        for position in _decodable(video, int(video.get(cv2.CAP_PROP_FRAME_COUNT))) if left else ():
            while left and left[-1] < position:
                left.pop()
                yield None
            if left and left[-1] == position:
                left.pop()
                image = video.retrieve()[1]  # colours take time, and only what is wanted needs them
                yield None if image is None else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            if not left:
                return
    finally:
        video.release()
    yield from [None] * len(left)


def _decodable(video: cv2.VideoCapture, promised: int) -> Iterator[int]:
    """Go through a video from its start; yield the position of each frame that can be decoded, ready to be retrieved.

    After one that cannot, time stamps tell the position: a decoder that looks ahead reports a damaged frame before it gives
    the frames in front of it.
    """
    period = 1000.0 / (video.get(cv2.CAP_PROP_FPS) or 1.0)  # ms
    position, time, lost, gap = -1, -period, 0, 0
    for _ in range(promised):
        if not video.grab():
            lost, gap = lost + 1, gap + 1
            if gap > LONGEST_GAP:
                return
            continue
        now = video.get(cv2.CAP_PROP_POS_MSEC)
        skipped = min(lost, max(0, round((now - time) / period) - 1)) if now > time else lost
        position, time, lost, gap = position + 1 + skipped, now, lost - skipped, 0
        yield position


def _reaches(video: cv2.VideoCapture, position: int) -> bool:
    """Whether a frame is there and can be decoded, by seeking: a no may be wrong, if the file is damaged before it."""
    video.set(cv2.CAP_PROP_POS_FRAMES, position)
    return bool(int(video.get(cv2.CAP_PROP_POS_FRAMES)) == position and video.grab())


def _whole_mp4(path: Path) -> bool:
    """Whether a file is a row of MP4 boxes, each with its length in front, that ends where the file does."""
    at, size = 0, path.stat().st_size
    with path.open("rb") as file:
        while at < size:
            file.seek(at)
            head = file.read(16)
            length = int.from_bytes(head[:4], "big")
            if length == 1:  # too long for four bytes
                length = int.from_bytes(head[8:16], "big")
            elif length == 0:  # up to the end, wherever that is
                length = size - at
            if length < 8 or (at == 0 and head[4:8] != b"ftyp"):
                return False
            at += length
    return at == size > 0
