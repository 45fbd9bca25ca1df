"""Recordings: folders of pictures or videos in, synchronised frames out.

The layout of a recording (``rig.yaml``, ``background/``, ``frames/``, ``truth.json``) is part of the
contract in the README. How a camera's pictures may be stored is a matter of :mod:`occlib.formats.footage`.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from occlib.base import checks
from occlib.base.arrays import Image
from occlib.base.files import file_hash, read_yaml, sha256, write_file
from occlib.formats.footage import DEFAULT_FPS, Footage, expected_files, open_footage
from occlib.geometry import Rig

EMPTY_FRAMES = 60
"""At most this many pictures of the empty floor are read: their mean is as sure as the camera's noise lets it be."""

MOST_NAMES = 4
"""Files that a warning names before it counts the rest: what fits on a line or two."""

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

ROOMS = LAB.parent / "rooms"
"""The random rooms that ship with the repository, beside the lab."""


FETCH_TIMEOUT_S = 30.0
"""A server that says nothing for so long is given up."""


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

        A camera that has no picture of an instant, or a damaged one, is left out of its dictionary. Which are damaged is told
        at the end, in a ``Notice``; if no picture was whole, that is a ``ValueError``.
        """
        damaged: dict[str, list[str]] = {}
        whole = 0
        for frame, images in self._read(self.frames if frames is None else frames):
            for name, image in images.items():
                if image is None:
                    source = self.sources[name]
                    damaged.setdefault(name, []).append(source.name(source.numbers.index(frame)))
            seen = {name: image for name, image in images.items() if image is not None}
            whole += len(seen)
            yield frame, seen
        for name, files in damaged.items():
            told = f"{self.path / 'frames'}: {name} is missing where its pictures cannot be read: {_some(files)}"
            if not whole:
                raise ValueError(told)
            _notice(told)

    def _read(self, frames: Sequence[int]) -> Iterator[tuple[int, dict[str, Image | None]]]:
        """As :meth:`images`, with ``None`` for what is damaged."""
        wanted = set(frames)
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
                    if image is not None:
                        check_size(image, self.rig[name].size, f"{self.path.name} frame {frame} of {name}")
                yield frame, images

    def sample(self, count: int) -> dict[str, list[Image]]:
        """At most ``count`` frames of every camera, spread evenly over the recording; those it lacks or that are damaged are left out."""
        pictures: dict[str, list[Image]] = {name: [] for name in self.sources}
        for _, images in self._read([self.frames[i] for i in _spread(len(self.frames), count)]):
            for name, image in images.items():
                if image is not None:
                    pictures[name].append(image)
        return pictures

    @property
    def without_background(self) -> list[str]:
        """The cameras that have no picture of the empty floor."""
        return [name for name in self.sources if name not in self._backgrounds]

    @cached_property
    def _backgrounds(self) -> dict[str, Footage]:
        """The pictures of the empty floor by camera, opened once: of a video the end is looked for."""
        return _footage_in(self.path / "background", self.sources)

    def background_images(self) -> dict[str, list[Image]]:
        """The pictures of the empty floor for each camera; a camera without any is left out.

        What lies in ``background/`` and belongs to no camera, or cannot be read, is named in a ``Notice``.
        """
        folder, cameras = self.path / "background", Rig.load(self.path / "rig.yaml").cameras
        if ignored := _ignored(folder, self._backgrounds, set(cameras) - set(self.rig.cameras)):
            _notice(f"{folder}: ignored {_some(ignored)} (expected {expected_files('CAMERA')} of {', '.join(cameras)})")
        return {name: _empty_floor(source, self.rig[name].size) for name, source in self._backgrounds.items()}


def empty_floor_images(folder: str | Path, rig: Rig) -> dict[str, list[Image]]:
    """The empty floor in ``folder/<camera>``, pictures or a video: for each camera uint8 RGB (H, W, 3) images.

    Of more than :data:`EMPTY_FRAMES` as many are read, spread evenly. A camera without any is left out. A damaged picture, one
    of the wrong size, or both pictures and a video of one camera are a ``ValueError``.
    """
    sources = _footage_in(Path(folder), rig.cameras)
    return {name: _empty_floor(source, rig[name].size) for name, source in sources.items()}


def _footage_in(folder: Path, cameras: Iterable[str]) -> dict[str, Footage]:
    """The pictures of those cameras that have some in a folder."""
    return {name: source for name in cameras if (source := open_footage(folder / name)) is not None}


def _empty_floor(source: Footage, size: tuple[int, int]) -> list[Image]:
    """Pictures of the empty floor; of a video those that can be decoded."""
    positions, images = _spread(len(source.numbers), EMPTY_FRAMES), []
    for i, image in zip(positions, source.read(positions), strict=True):
        what = source.files if isinstance(source.files, Path) else source.files[i]
        if image is not None:
            check_size(image, size, f"{what}")
            images.append(image)
        elif what != source.files:
            raise ValueError(f"{what}: corrupt or not an image (expected PNG or JPEG)")
    if not images:
        raise ValueError(f"{source.files}: corrupt video, no frame can be read")
    if source.promised > len(source.numbers):
        _notice(f"{source.files}: {len(source.numbers)} of {source.promised} promised frames can be read")
    return images


def _ignored(folder: Path, sources: Mapping[str, Footage], others: set[str]) -> list[str]:
    """What lies in the folder, or in that of a camera, and is none of the pictures; hidden files and other cameras' aside."""
    own = {source.entry(folder / name): source.files for name, source in sources.items()}
    names: list[str] = []
    for entry in _visible(folder):
        files = own.get(entry)
        if isinstance(files, tuple):
            names += [f"{entry.name}/{path.name}" for path in _visible(entry) if path not in files]
        elif files is None and not {entry.name, entry.stem} & others and (entry.is_file() or _visible(entry)):
            names.append(f"{entry.name}/" if entry.is_dir() else entry.name)
    return names


def _visible(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if not p.name.startswith(".")) if folder.is_dir() else []


def _notice(text: str) -> None:
    warnings.warn(text, checks.Notice, stacklevel=2)


def _some(names: Sequence[str]) -> str:
    """The first few names, and how many more there are."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


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
    not the first, if another camera has them all. Videos may be shorter than others, or than they promise: the recording
    ends with the shortest, and a ``Notice`` says so. Anything else that does not match is an error.

    Parameters
    ----------
    path
        The folder, or the name of one that ships in ``data/lab`` or ``data/rooms``, was fetched, or was rendered to the cache.
    cameras
        Names to use, in this order; all those of the rig for ``None``.

    Raises
    ------
    ValueError
        In one line: no such folder, unreadable rig, a camera that is not in the rig or has no frames,
        views of different length.
    """
    folder = find_folder(path)
    if folder is None:
        if str(path) in public_recordings():
            raise ValueError(f"{path}: not fetched yet; first: occlib data fetch {path}")
        if number := re.fullmatch(r"room_(\d+)", str(path)):
            raise ValueError(f"{path}: not rendered yet; first: python -m occlib.lab {number[1]}")
        raise ValueError(f"{path}: no such recording folder ({lab_recordings()})")
    rig = Rig.load(folder / "rig.yaml").select(cameras)
    sources = {name: _footage_of(folder, name) for name in rig.cameras}
    if any(isinstance(source.files, Path) for source in sources.values()):  # in a video, the position is the number
        sources = {n: replace(s, numbers=tuple(range(len(s.numbers)))) for n, s in sources.items()}
    sources = _to_the_shortest(folder, sources)
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


def _to_the_shortest(folder: Path, sources: dict[str, Footage]) -> dict[str, Footage]:
    """Where videos are shorter than others or than they promise, all views end with the shortest, and a ``Notice`` says so."""
    lengths = {name: len(source.numbers) for name, source in sources.items()}
    end = min(lengths.values())
    short = {name for name, source in sources.items() if source.promised > lengths[name]}
    videos = all(isinstance(source.files, Path) for source in sources.values())
    if not (short or (videos and max(lengths.values()) > end)):
        return sources
    views: dict[str, list[str]] = {}
    for name, source in sources.items():
        if name in short or lengths[name] > end:
            promised = f" of {source.promised} promised" if name in short else ""
            file = source.entry(folder / "frames" / name).name
            views.setdefault(f"{lengths[name]}{promised} frames can be read", []).append(file)
    told = "; ".join(f"{', '.join(files)}: {state}" for state, files in views.items())
    _notice(f"{folder}: ends at frame {end - 1} ({told})")
    return {name: replace(source, numbers=source.numbers[:end]) for name, source in sources.items()}


def find_folder(path: str | Path) -> Path | None:
    """A folder, or that of a recording by its name: in ``data/lab``, in ``data/rooms``, or in the cache; ``None`` if there is none."""
    places = (Path(path), LAB / path, ROOMS / path, cache_folder() / path)
    return next((place for place in places if place.is_dir()), None)


def lab_recordings() -> str:
    """For messages: which recordings ``data/lab`` and ``data/rooms`` have, or why there are none."""
    if LAB.is_dir():
        names = {folder: sorted(p.parent.name for p in folder.glob("*/rig.yaml")) for folder in (LAB, ROOMS)}
        return "; ".join(f"data/{folder.name} has {', '.join(found)}" for folder, found in names.items() if found)
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
        raise ValueError(f"{folder}: no frames for camera {name!r} (expected {expected_files(f'frames/{name}')})")
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
