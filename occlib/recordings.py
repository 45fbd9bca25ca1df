"""Recordings: folders of pictures or videos in, synchronised frames out; files written whole or not at all.

The layout of a recording (``rig.yaml``, ``background/``, ``frames/``, ``truth.json``) is part of the
contract in the README.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from occlib.base.arrays import Image
from occlib.base.files import file_hash, read_image, read_yaml, write_file
from occlib.geometry import Rig

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")


VIDEO_SUFFIXES = (".mp4", ".avi")


DATA = Path(str(resources.files("occlib") / "data"))
"""What comes with the package: the catalogue of public recordings, and the calibration and truth made for them."""


def lab_folder() -> Path:
    """The folder ``data/lab`` of the repository: the recordings that ship with it, and not with the package.

    The repository is the one that the package stands in, else the one in or above the current folder: an installed
    copy finds it from there. ``OCCLIB_LAB`` goes before both. Where there is none, the path leads nowhere.
    """
    if folder := os.environ.get("OCCLIB_LAB"):
        return Path(folder).resolve()
    try:
        here = Path.cwd()
    except OSError:  # it was removed
        here = DATA
    folders = [place / "data" / "lab" for place in (DATA.parents[1], here, *here.parents)]
    return next((folder for folder in folders if (folder / "manifest.json").is_file()), here / "data" / "lab")


LAB = lab_folder()


FETCH_TIMEOUT_S = 30.0
"""A server that says nothing for so long is given up."""


DEFAULT_FPS = 10.0


os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # a corrupt video is reported here, in one line, not by FFmpeg


@dataclass(frozen=True)
class Recording:
    """A recording on disk: where each camera's frames are, and which instants there are.

    Parameters
    ----------
    path
        The folder.
    rig
        Floor and cameras, in the order in which they were asked for.
    frames
        The number of every instant: the number in the picture's name, or the index in the video. Instants at which
        a camera dropped out are among them.
    fps
        Frames a second: of the video, or ``fps`` in ``rig.yaml``, else 10.
    sources
        For each camera its video, or its pictures in the order of ``frames``, ``None`` where it dropped out.
    """

    path: Path
    rig: Rig
    frames: tuple[int, ...]
    fps: float
    sources: dict[str, Path | tuple[Path | None, ...]]

    def time(self, frame: int) -> float:
        """Seconds since frame 0."""
        return frame / self.fps

    def images(self, frames: Sequence[int] | None = None) -> Iterator[tuple[int, dict[str, Image]]]:
        """Yield ``(frame, {camera: uint8 RGB (H, W, 3)})`` for the frames asked for, in order.

        A camera that has no picture of an instant is left out of its dictionary.
        """
        wanted = set(self.frames if frames is None else frames)
        unknown = sorted(wanted - set(self.frames))
        if unknown:
            raise ValueError(
                f"frames: {unknown[0]} is not in {self.path.name}, which has {self.frames[0]} to {self.frames[-1]}"
            )
        readers = {name: _reader(source, self.frames, wanted) for name, source in self.sources.items()}
        for frame in self.frames:
            if frame in wanted:
                read = {name: next(reader) for name, reader in readers.items()}
                images = {name: image for name, image in read.items() if image is not None}
                for name, image in images.items():
                    check_size(image, self.rig[name].size, f"{self.path.name} frame {frame} of {name}")
                yield frame, images

    def sample(self, count: int) -> dict[str, list[Image]]:
        """At most ``count`` frames of every camera, spread evenly over the recording; those it lacks are left out."""
        index = np.unique(np.linspace(0, len(self.frames) - 1, min(count, len(self.frames))).round().astype(int))
        pictures: dict[str, list[Image]] = {name: [] for name in self.sources}
        for _, images in self.images([self.frames[i] for i in index]):
            for name, image in images.items():
                pictures[name].append(image)
        return pictures

    @property
    def without_background(self) -> list[str]:
        """The cameras that have no picture of the empty floor."""
        return [name for name in self.sources if not _pictures(self.path / "background" / name)]

    def background_images(self) -> dict[str, list[Image]]:
        """The pictures of the empty floor for each camera; a camera without any is left out."""
        return empty_floor_images(self.path / "background", self.rig)


def empty_floor_images(folder: str | Path, rig: Rig) -> dict[str, list[Image]]:
    """The pictures ``folder/<camera>/*`` of the empty floor, uint8 RGB (H, W, 3); a camera without any is left out."""
    found: dict[str, list[Image]] = {}
    for name, camera in rig.cameras.items():
        for path in _pictures(Path(folder) / name):
            image = read_image(path)
            check_size(image, camera.size, f"{path}")
            found.setdefault(name, []).append(image)
    return found


def check_size(image: Image, size: tuple[int, int], what: str) -> None:
    """Raise ``ValueError`` unless the image is uint8 RGB of ``size = (width, height)``."""
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape != (size[1], size[0], 3):
        came = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f"{what}: expected uint8 {(size[1], size[0], 3)}, got {came}")


def open_recording(path: str | Path, cameras: Sequence[str] | None = None) -> Recording:
    """Open a recording and check that its views fit together.

    A camera may have dropped out for a while: of pictures that are numbered by their names, it may lack up to half, but
    not the first, if another camera has them all. Anything else that does not match is an error.

    Parameters
    ----------
    path
        The folder, or the name of one that ships in ``data/lab`` or was fetched.
    cameras
        Names to use, in this order; all those of the rig for ``None``.

    Raises
    ------
    ValueError
        In one line: no such folder, unreadable rig, a camera that is not in the rig or has no frames,
        views of different length.
    """
    folder = next((place for place in (Path(path), LAB / path, cache_folder() / path) if place.is_dir()), None)
    if folder is None:
        if str(path) in public_recordings():
            raise ValueError(f"{path}: not fetched yet; first: occlib data fetch {path}")
        raise ValueError(f"{path}: no such recording folder ({lab_recordings()})")
    rig = Rig.load(folder / "rig.yaml").select(cameras)
    sources: dict[str, Path | tuple[Path | None, ...]] = {}
    numbers: dict[str, tuple[int, ...]] = {}
    fps, named = read_yaml(folder / "rig.yaml").get("fps"), True
    for name in rig.cameras:
        pictures = _pictures(folder / "frames" / name)
        video = next((p for s in VIDEO_SUFFIXES if (p := folder / "frames" / f"{name}{s}").is_file()), None)
        if pictures:
            sources[name], numbers[name] = tuple(pictures), _numbers(pictures)
            named &= numbers[name] == tuple(_number(path) for path in pictures)
        elif video is not None:
            count, video_fps = _video_length(video)
            sources[name], numbers[name], named = video, tuple(range(count)), False
            fps = video_fps if fps is None else fps
        else:
            raise ValueError(f"{folder}: no frames for camera {name!r} (expected frames/{name}/*.png|jpg or .mp4|avi)")
    if any(isinstance(source, Path) for source in sources.values()):  # a video has no names, so its index is the number
        numbers = {name: tuple(range(len(frames))) for name, frames in numbers.items()}
    most = max(numbers, key=lambda name: len(numbers[name]))
    frames = numbers[most]
    for name, own in numbers.items():
        if own != frames and not (named and _has_gaps(own, frames)):
            views = ", ".join(f"{each} has {_span(numbers[each])}" for each in numbers if each in (name, most))
            raise ValueError(f"{folder}: views of different length or names: {views}")
        source = sources[name]
        if own != frames and isinstance(source, tuple):
            paths = dict(zip(own, source, strict=True))
            sources[name] = tuple(paths.get(frame) for frame in frames)
    fps = DEFAULT_FPS if fps is None else fps
    if not isinstance(fps, int | float) or isinstance(fps, bool) or not 1e-6 < fps < 1e6:
        raise ValueError(f"{folder / 'rig.yaml'}: fps: expected frames a second > 0, got {repr(fps)[:40]}")
    return Recording(folder, rig, frames, float(fps), sources)


def lab_recordings() -> str:
    """For messages: which recordings ``data/lab`` has, or why there is none."""
    if LAB.is_dir():
        return f"data/lab has {', '.join(sorted(p.parent.name for p in LAB.glob('*/rig.yaml')))}"
    return (
        "data/lab ships with the repository, not with the package: run this in the repository's folder, or set "
        "OCCLIB_LAB to its folder data/lab"
    )


def parse_frames(text: str, frames: Sequence[int]) -> list[int]:
    """Frame numbers chosen by ``start:stop:step`` (stop excluded, step at least 1) or a single number.

    >>> parse_frames("2:8:3", range(10))
    [2, 5]
    """
    shown = repr(text if len(text) <= 40 else f"{text[:37]}...")
    try:
        parts = [int(part) if part.strip() else None for part in text.split(":")]
    except ValueError:
        parts = []
    if not 1 <= len(parts) <= 3 or parts == [None] or (len(parts) == 3 and parts[2] is not None and parts[2] < 1):
        raise ValueError(f"--frames: expected a number or START:STOP:STEP with STEP > 0, got {shown}")
    if len(parts) == 1:
        chosen = [frame for frame in frames if frame == parts[0]]
    else:
        start, stop, step = (*parts, None)[:3]
        wanted = range(min(frames) if start is None else start, max(frames) + 1 if stop is None else stop, step or 1)
        chosen = [frame for frame in frames if frame in wanted]
    if not chosen:
        raise ValueError(f"--frames: {shown} selects none of the frames {min(frames)} to {max(frames)}")
    return chosen


def _pictures(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")),
        key=lambda p: (_number(p) is None, _number(p) or 0, p.name),
    )


def _number(path: Path) -> int | None:
    digits = re.findall(r"\d+$", path.stem) or re.findall(r"\d+", path.stem)
    return int(digits[0]) if len(digits) == 1 else None


def _numbers(pictures: Sequence[Path]) -> tuple[int, ...]:
    """Numbers in the names where each has one of its own, else the position in the sorted list."""
    numbers = [_number(p) for p in pictures]
    if None in numbers or len(set(numbers)) < len(numbers):
        return tuple(range(len(pictures)))
    return tuple(n for n in numbers if n is not None)


def _has_gaps(numbers: Sequence[int], whole: Sequence[int]) -> bool:
    """Whether a camera that took part from the start only missed some of the instants, at most half."""
    return set(numbers) < set(whole) and numbers[0] == whole[0] and 2 * len(numbers) >= len(whole)


def _span(numbers: Sequence[int]) -> str:
    return f"{len(numbers)} frames ({numbers[0]} to {numbers[-1]})" if numbers else "0 frames"


def _video_length(path: Path) -> tuple[int, float]:
    video = cv2.VideoCapture(str(path))
    try:
        count, fps = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), float(video.get(cv2.CAP_PROP_FPS))
    finally:
        video.release()
    if count < 1:
        raise ValueError(f"{path}: corrupt or empty video")
    return count, fps or DEFAULT_FPS


def _reader(source: Path | tuple[Path | None, ...], frames: Sequence[int], wanted: set[int]) -> Iterator[Image | None]:
    if isinstance(source, tuple):
        yield from (
            None if p is None else read_image(p) for frame, p in zip(frames, source, strict=True) if frame in wanted
        )
        return
    video = cv2.VideoCapture(str(source))
    try:
        for frame in range(max(wanted, default=-1) + 1):
            read = video.grab()  # decoding is the slow part, and only what is wanted needs it
            image = video.retrieve()[1] if read and frame in wanted else None
            if not read or (frame in wanted and image is None):
                raise ValueError(f"{source}: corrupt or short video, frame {frame} of {len(frames)} cannot be read")
            if image is not None:
                yield cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    finally:
        video.release()


def cache_folder() -> Path:
    """Where fetched recordings are kept: ``OCCLIB_CACHE``, or the user's cache folder."""
    if folder := os.environ.get("OCCLIB_CACHE"):
        return Path(folder)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/AppData/Local"), "occlib/occlib/Cache")
    if sys.platform == "darwin":
        return Path(os.path.expanduser("~/Library/Caches/occlib"))
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "occlib")


def public_recordings(path: str | Path = DATA / "sources.yaml") -> dict[str, Any]:
    """The public recordings by name: ``about``, ``url`` and ``files`` with their checksums."""
    return dict(read_yaml(path))


def fetch(name: str, *, catalogue: str | Path = DATA / "sources.yaml", progress: bool = False) -> Path:
    """Download a public recording to the cache, unless it is there, and check every file's SHA-256.

    Calibration and truth that were made for a recording (``occlib/data/NAME``) are put beside its frames.

    Returns
    -------
    The recording's folder.

    Raises
    ------
    ValueError
        In one line: unknown name, no network, or a file whose checksum is wrong (it is not kept).
    """
    from tqdm import tqdm

    known = public_recordings(catalogue)
    if name not in known:
        raise ValueError(f"{name}: not a public recording; there are {', '.join(known)}")
    source, folder = known[name], cache_folder() / name
    for target, file in tqdm(source["files"].items(), desc=name, unit="file", disable=not progress):
        if file_hash(folder / target) == file["sha256"]:
            continue
        try:
            write_file(folder / target, _download(source["url"] + file["name"], file["sha256"]))
        except ValueError as error:
            raise ValueError(f"{name}: cannot fetch {target} ({error})") from None
    for extra in sorted((DATA / name).glob("*")):
        write_file(folder / extra.name, extra.read_bytes())
    return folder


def _download(url: str, sha256: str) -> bytes:
    """The content of a URL; ``ValueError`` if there is none, or another than the checksum says."""
    from http.client import HTTPException
    from urllib.request import urlopen

    try:
        with urlopen(url, timeout=FETCH_TIMEOUT_S) as response:
            content = bytes(response.read())
    except (OSError, HTTPException) as error:
        raise ValueError(str(error)) from None
    if (found := hashlib.sha256(content).hexdigest()) != sha256:
        raise ValueError(f"its SHA-256 hash is {found}, expected {sha256}")
    return content
