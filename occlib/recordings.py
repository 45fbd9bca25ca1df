"""Recordings: folders of pictures or videos in, synchronised frames out.

The layout of a recording (``rig.yaml``, ``background/``, ``frames/``, ``truth.json``) is part of the
contract in the README. How a camera's pictures may be stored is a matter of the :data:`FORMATS`.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from occlib.base import checks
from occlib.base.arrays import Image
from occlib.base.files import file_hash, read_image, read_yaml, sha256, write_file
from occlib.geometry import Rig

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Of the pictures in a folder, in small or capital letters."""

VIDEO_SUFFIXES = (".mp4", ".avi")
"""Of videos; the first that is there is taken."""

EMPTY_FRAMES = 60
"""At most this many pictures of the empty floor are read: their mean is as sure as the camera's noise lets it be."""

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
"""Frames a second of pictures whose ``rig.yaml`` says nothing."""


os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # a corrupt video is reported here, in one line, not by FFmpeg


# --- one camera's pictures ----------------------------------------------------------------------------
@dataclass(frozen=True)
class Footage:
    """One camera's pictures on disk, in order.

    Parameters
    ----------
    files
        The file of each picture, or the one file that holds them all.
    numbers
        The number of each picture, ascending: from its name, or else its position, from 0.
    read
        ``read(positions)`` yields the pictures at these positions, ascending, uint8 RGB (H, W, 3). A picture that cannot be
        read is a ``ValueError`` that names the file.
    named
        Whether the numbers come from names. Only then can it be told which pictures a camera lacks.
    fps
        Frames a second, if the file says so.
    """

    files: Path | tuple[Path, ...]
    numbers: tuple[int, ...]
    read: Callable[[Sequence[int]], Iterator[Image]]
    named: bool = False
    fps: float | None = None


FORMATS: dict[str, Callable[[Path], Footage | None]] = {}
"""Ways to store a camera's pictures: what follows ``frames/<camera>``, and the function that opens it. The first that fits counts."""


def input_format(pattern: str) -> Callable[[Callable[[Path], Footage | None]], Callable[[Path], Footage | None]]:
    """Decorator: a function that opens a camera's pictures joins :data:`FORMATS`.

    Parameters
    ----------
    pattern
        What a user is told to put after ``frames/<camera>``, such as ``.mp4|avi``.

    Notes
    -----
    The function gets ``frames/<camera>``, a path without suffix, and returns the :class:`Footage` there, or ``None`` if there
    is none of its kind. ``background/<camera>`` is opened in the same way.
    """

    def register(function: Callable[[Path], Footage | None]) -> Callable[[Path], Footage | None]:
        FORMATS[pattern] = function
        return function

    return register


def open_footage(place: Path) -> Footage | None:
    """A camera's pictures at ``frames/<camera>`` or ``background/<camera>``, in whichever of :data:`FORMATS`; ``None`` if there are none."""
    return next((found for open_format in FORMATS.values() if (found := open_format(place)) is not None), None)


@input_format("/*.png|jpg")
def _pictures(folder: Path) -> Footage | None:
    if not folder.is_dir():
        return None
    paths = sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")),
        key=lambda p: (_number(p) is None, _number(p) or 0, p.name),
    )
    if not paths:
        return None
    numbers = [number for number in map(_number, paths) if number is not None]
    named = len(set(numbers)) == len(paths)  # each has a number of its own
    return Footage(
        tuple(paths),
        tuple(numbers) if named else tuple(range(len(paths))),
        lambda positions: (read_image(paths[i]) for i in positions),
        named,
    )


def _number(path: Path) -> int | None:
    """The number at the end of a picture's name, or the only one in it."""
    digits = re.findall(r"\d+$", path.stem) or re.findall(r"\d+", path.stem)
    return int(digits[0]) if len(digits) == 1 else None


@input_format(".mp4|avi")
def _video(place: Path) -> Footage | None:
    path = next((p for s in VIDEO_SUFFIXES if (p := place.with_name(place.name + s)).is_file()), None)
    if path is None:
        return None
    video = cv2.VideoCapture(str(path))
    try:
        count, fps = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), float(video.get(cv2.CAP_PROP_FPS))
    finally:
        video.release()
    if count < 1:
        raise ValueError(f"{path}: corrupt or empty video")
    return Footage(path, tuple(range(count)), lambda positions: _frames(path, positions, count), fps=fps or DEFAULT_FPS)


def _frames(path: Path, positions: Sequence[int], count: int) -> Iterator[Image]:
    wanted = set(positions)
    video = cv2.VideoCapture(str(path))
    try:
        for position in range(max(wanted, default=-1) + 1):
            read = video.grab()  # decoding is the slow part, and only what is wanted needs it
            image = video.retrieve()[1] if read and position in wanted else None
            if not read or (position in wanted and image is None):
                raise ValueError(f"{path}: corrupt or short video, frame {position} of {count} cannot be read")
            if image is not None:
                yield cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    finally:
        video.release()


# --- all cameras together -----------------------------------------------------------------------------
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
        For each camera its pictures; those of a camera that dropped out have only some of the ``frames`` as ``numbers``.
    """

    path: Path
    rig: Rig
    frames: tuple[int, ...]
    fps: float
    sources: dict[str, Footage]

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
        own = {name: wanted & set(source.numbers) for name, source in self.sources.items()}
        readers = {
            name: source.read([i for i, number in enumerate(source.numbers) if number in own[name]])
            for name, source in self.sources.items()
        }
        for frame in self.frames:
            if frame in wanted:
                images = {name: next(reader) for name, reader in readers.items() if frame in own[name]}
                for name, image in images.items():
                    check_size(image, self.rig[name].size, f"{self.path.name} frame {frame} of {name}")
                yield frame, images

    def sample(self, count: int) -> dict[str, list[Image]]:
        """At most ``count`` frames of every camera, spread evenly over the recording; those it lacks are left out."""
        pictures: dict[str, list[Image]] = {name: [] for name in self.sources}
        for _, images in self.images([self.frames[i] for i in _spread(len(self.frames), count)]):
            for name, image in images.items():
                pictures[name].append(image)
        return pictures

    @property
    def without_background(self) -> list[str]:
        """The cameras that have no picture of the empty floor."""
        return [name for name in self.sources if open_footage(self.path / "background" / name) is None]

    def background_images(self) -> dict[str, list[Image]]:
        """The pictures of the empty floor for each camera; a camera without any is left out."""
        return empty_floor_images(self.path / "background", self.rig)


def empty_floor_images(folder: str | Path, rig: Rig) -> dict[str, list[Image]]:
    """The empty floor in ``folder/<camera>``, pictures or a video: for each camera uint8 RGB (H, W, 3) images.

    Of more than :data:`EMPTY_FRAMES` as many are read, spread evenly. A camera without any is left out.
    """
    found: dict[str, list[Image]] = {}
    for name, camera in rig.cameras.items():
        if (source := open_footage(Path(folder) / name)) is not None:
            positions = _spread(len(source.numbers), EMPTY_FRAMES)
            found[name] = list(source.read(positions))
            for i, image in zip(positions, found[name], strict=True):
                check_size(image, camera.size, f"{source.files if isinstance(source.files, Path) else source.files[i]}")
    return found


def _spread(length: int, count: int) -> list[int]:
    """At most ``count`` of the positions 0 to ``length - 1``, spread evenly, the first and the last among them."""
    return np.unique(np.linspace(0, length - 1, min(count, length)).round().astype(int)).tolist()


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
    sources = {name: _footage_of(folder, name) for name in rig.cameras}
    if any(isinstance(source.files, Path) for source in sources.values()):  # in a video, the position is the number
        sources = {n: replace(s, numbers=tuple(range(len(s.numbers)))) for n, s in sources.items()}
    named = all(source.named for source in sources.values())
    most = max(sources, key=lambda name: len(sources[name].numbers))
    frames = sources[most].numbers
    for name, source in sources.items():
        if source.numbers != frames and not (named and _has_gaps(source.numbers, frames)):
            views = ", ".join(f"{each} has {_span(sources[each].numbers)}" for each in sources if each in (name, most))
            raise ValueError(f"{folder}: views of different length or names: {views}")
    said = [read_yaml(folder / "rig.yaml").get("fps"), *(source.fps for source in sources.values()), DEFAULT_FPS]
    rate = next(fps for fps in said if fps is not None)
    fps = checks.number(f"{folder / 'rig.yaml'}: fps", rate, least=1e-6, most=1e6, expected="frames a second > 0")
    return Recording(folder, rig, frames, fps, sources)


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


def _footage_of(folder: Path, name: str) -> Footage:
    found = open_footage(folder / "frames" / name)
    if found is None:
        expected = " or ".join(f"frames/{name}{pattern}" for pattern in FORMATS)
        raise ValueError(f"{folder}: no frames for camera {name!r} (expected {expected})")
    return found


def _has_gaps(numbers: Sequence[int], whole: Sequence[int]) -> bool:
    """Whether a camera that took part from the start only missed some of the instants, at most half."""
    return set(numbers) < set(whole) and numbers[0] == whole[0] and 2 * len(numbers) >= len(whole)


def _span(numbers: Sequence[int]) -> str:
    return f"{len(numbers)} frames ({numbers[0]} to {numbers[-1]})" if numbers else "0 frames"


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


def _download(url: str, expected: str) -> bytes:
    """The content of a URL; ``ValueError`` if there is none, or another than the checksum says."""
    from http.client import HTTPException
    from urllib.request import urlopen

    try:
        with urlopen(url, timeout=FETCH_TIMEOUT_S) as response:
            content = bytes(response.read())
    except (OSError, HTTPException) as error:
        raise ValueError(str(error)) from None
    if (found := sha256(content)) != expected:
        raise ValueError(f"its SHA-256 hash is {found}, expected {expected}")
    return content
