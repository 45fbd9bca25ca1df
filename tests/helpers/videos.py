"""Small videos, and ways to damage them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

SIZE = (160, 120)


def save_video(path: Path, count: int, *, fps: float = 10.0, size: tuple[int, int] = SIZE, step: int = 40) -> None:
    """A video whose frame i is red of level ``step * i``; skips where OpenCV has no encoder."""
    codec = {".mp4": "mp4v", ".avi": "MJPG"}[path.suffix.lower()]
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, size)
    if not writer.isOpened():
        pytest.skip(f"this OpenCV cannot write {codec}")
    for i in range(count):
        writer.write(np.full((size[1], size[0], 3), (0, 0, step * i % 256), np.uint8))
    writer.release()


def use_videos(folder: Path, counts: dict[str, int], suffix: str = ".mp4", **options: Any) -> None:
    """Videos in the place of cameras' pictures."""
    for name, count in counts.items():
        shutil.rmtree(folder / "frames" / name)
        save_video(folder / "frames" / f"{name}{suffix}", count, **options)


def as_videos(folder: Path, suffix: str = ".avi") -> None:
    """The recording's own pictures, as videos."""
    for pictures in sorted((folder / "frames").iterdir()):
        codec = {".mp4": "mp4v", ".avi": "MJPG"}[suffix]
        images = [cv2.imread(str(path)) for path in sorted(pictures.iterdir())]
        size = (images[0].shape[1], images[0].shape[0])
        writer = cv2.VideoWriter(str(pictures.with_suffix(suffix)), cv2.VideoWriter.fourcc(*codec), 10, size)
        if not writer.isOpened():
            pytest.skip(f"this OpenCV cannot write {codec}")
        for image in images:
            writer.write(image)
        writer.release()
        shutil.rmtree(pictures)


def promise(path: Path, count: int) -> None:
    """Another number of frames in the header of an AVI file."""
    content = bytearray(path.read_bytes())
    for chunk, field in ((b"avih", 16), (b"strh", 32)):
        at = content.index(chunk) + 8 + field
        content[at : at + 4] = count.to_bytes(4, "little")
    path.write_bytes(content)


def spoil(path: Path, frame: int) -> None:
    """Zeros in the place of a frame, as coded."""
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    for _ in range(frame + 1):
        if not video.grab():
            pytest.skip("this OpenCV does not give what is coded")
    coded = video.retrieve()[1].tobytes()
    video.release()
    content = path.read_bytes()
    known = coded if coded in content else coded[-60:]  # of H.264, the beginning is made up
    assert content.count(known) == 1
    end = content.index(known) + len(known)
    path.write_bytes(content[: end - len(coded)] + bytes(len(coded)) + content[end:])


def index_first(path: Path) -> None:
    """The index of an MP4 file in front of the frames, so that the file can be cut."""
    content = path.read_bytes()
    at, boxes = 0, {}
    while at < len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        boxes[content[at + 4 : at + 8]] = content[at : at + length]
        at += length
    index = bytearray(boxes.pop(b"moov"))
    table = index.index(b"stco") + 8
    for i in range(int.from_bytes(index[table : table + 4], "big")):
        place = table + 4 + 4 * i
        index[place : place + 4] = (int.from_bytes(index[place : place + 4], "big") + len(index)).to_bytes(4, "big")
    path.write_bytes(boxes.pop(b"ftyp") + index + b"".join(boxes.values()))
