"""How a camera's pictures may be stored: a folder of pictures, or a video."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from occlib.base.arrays import Image
from occlib.base.files import DamagedImageError, read_image
from occlib.base.videos import measure_video, video_frames

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Of the pictures in a folder, in small or capital letters."""


VIDEO_SUFFIXES = (".mp4", ".avi")
"""Of videos, in small or capital letters."""


DEFAULT_FPS = 10.0
"""Frames a second of pictures whose ``rig.yaml`` says nothing."""


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
        ``read(positions)`` yields the pictures at these positions, ascending, uint8 RGB (H, W, 3), or ``None`` for one that is
        damaged.
    named
        Whether the numbers come from names. Only then can it be told which pictures a camera lacks.
    fps
        Frames a second, if the file says so.
    promised
        How many pictures the file says that it has, if it says so. ``numbers`` are those that can be read.
    """

    files: Path | tuple[Path, ...]
    numbers: tuple[int, ...]
    read: Callable[[Sequence[int]], Iterator[Image | None]]
    named: bool = False
    fps: float | None = None
    promised: int = 0

    def name(self, position: int) -> str:
        """What to call a picture in a message: its folder and file, or its place in the video."""
        if isinstance(self.files, Path):
            return f"frame {position} of {self.files.name}"
        return f"{self.files[position].parent.name}/{self.files[position].name}"

    def entry(self, place: Path) -> Path:
        """The file or folder beside ``place`` that holds the pictures."""
        file = self.files if isinstance(self.files, Path) else self.files[0]
        return next(path for path in (file, *file.parents) if path.parent == place.parent)


FORMATS: dict[str, Callable[[Path], Footage | None]] = {}
"""Ways to store a camera's pictures: what follows ``frames/<camera>``, and the function that opens it."""


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


def expected_files(start: str) -> str:
    """For messages: what may follow ``start``, which stands for ``frames/<camera>``."""
    return " or ".join(f"{start}{pattern}" for pattern in FORMATS)


def open_footage(place: Path) -> Footage | None:
    """A camera's pictures at ``frames/<camera>`` or ``background/<camera>``, in whichever of :data:`FORMATS`; ``None`` if there are none.

    Raises ``ValueError`` if there are some in two formats: who is to say which count?
    """
    found = [footage for open_format in FORMATS.values() if (footage := open_format(place)) is not None]
    if len(found) > 1:
        raise _ambiguous(place, [footage.entry(place) for footage in found])
    return found[0] if found else None


def _ambiguous(place: Path, entries: Iterable[Path]) -> ValueError:
    names = " and ".join(f"{entry.name}/" if entry.is_dir() else entry.name for entry in entries)
    return ValueError(f"{place.parent}: expected one source of pictures for camera {place.name!r}, got {names}")


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
        lambda positions: (_whole_image(paths[i]) for i in positions),
        named,
    )


def _whole_image(path: Path) -> Image | None:
    try:
        return read_image(path)
    except DamagedImageError:
        return None


def _number(path: Path) -> int | None:
    """The number at the end of a picture's name, or the only one in it."""
    digits = re.findall(r"\d+$", path.stem) or re.findall(r"\d+", path.stem)
    return int(digits[0]) if len(digits) == 1 else None


@input_format(".mp4|avi")
def _video(place: Path) -> Footage | None:
    beside = place.parent.iterdir() if place.parent.is_dir() else ()
    paths = sorted(p for p in beside if p.stem == place.name and p.suffix.lower() in VIDEO_SUFFIXES and p.is_file())
    if not paths:
        return None
    if len(paths) > 1:
        raise _ambiguous(place, paths)
    readable, promised, fps = measure_video(paths[0])
    read = partial(video_frames, paths[0])
    return Footage(paths[0], tuple(range(readable)), read, fps=fps or DEFAULT_FPS, promised=promised)
