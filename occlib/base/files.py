"""Files and folders read and written whole, their SHA-256, and pictures as arrays."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from occlib.base.arrays import Image
from occlib.base.interrupts import uninterrupted


def read_text(path: str | Path) -> str:
    """The content of a text file in UTF-8; ``ValueError`` in one line if it cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path}: cannot read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text in UTF-8") from None


def read_yaml(path: str | Path) -> Any:
    """The content of a YAML file; ``ValueError`` in one line if it cannot be read or is not YAML."""
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot read ({error.strerror})") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: not UTF-8, an impossible date
        raise ValueError(f"{path}: not valid YAML ({str(error).splitlines()[0]})") from None


def load_json(path: Path) -> Any:
    """The content of a JSON file; ``ValueError`` in one line if it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot read ({error.strerror})") from None
    except ValueError:
        raise ValueError(f"{path}: not valid JSON") from None


def sha256(content: bytes | str) -> str:
    """SHA-256 of bytes, or of a text in UTF-8, as 64 hexadecimal digits.

    >>> sha256("")[:8]
    'e3b0c442'
    """
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a file, empty if there is none."""
    return sha256(path.read_bytes()) if path.is_file() else ""


def file_hashes(folder: Path, pattern: str = "*") -> dict[str, str]:
    """SHA-256 of each file in and below a folder, ``{"sub/name.png": hash}``; caches of Python are left out.

    This is what every manifest says of its files: with equal hashes nothing was changed, added or lost.
    """
    paths = [path for path in sorted(folder.rglob(pattern)) if path.is_file() and "__pycache__" not in path.parts]
    return {path.relative_to(folder).as_posix(): file_hash(path) for path in paths}


def folder_hash(folder: Path, pattern: str = "*") -> str:
    """SHA-256 of the names and contents of the files in and below a folder."""
    return sha256("".join(f"{name}\0{value}\n" for name, value in file_hashes(folder, pattern).items()))


class DamagedImageError(ValueError):
    """A file that is there, and no picture or only a part of one."""


PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def write_file(path: str | Path, content: bytes | str) -> Path:
    """Write a file whole: under a temporary name first, then renamed over ``path``.

    Raises ``ValueError`` in one line when the folder is read-only, missing or the disk is full; nothing
    half-written is left.
    """
    with writing(path) as write:
        write(content)
    return Path(path)


@contextmanager
def writing(path: str | Path) -> Iterator[Callable[[bytes | str], None]]:
    """What :func:`write_file` does, piece by piece: gives the function that writes the next piece.

    ``path`` stays as it was until the ``with`` block ends well.
    """
    target = Path(path)
    temporary = None
    with ExitStack() as closing:
        try:
            with _write_errors(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
                stream = closing.enter_context(os.fdopen(handle, "wb"))

            def write(content: bytes | str) -> None:
                with _write_errors(target):
                    stream.write(content.encode() if isinstance(content, str) else content)

            try:
                yield write
            finally:
                with _write_errors(target):
                    closing.close()
            with _write_errors(target):
                mask = os.umask(0)
                os.umask(mask)
                os.chmod(temporary, 0o666 & ~mask)  # mkstemp makes files that only their owner may read
                os.replace(temporary, target)
        finally:
            if temporary and os.path.exists(temporary):
                os.unlink(temporary)


@contextmanager
def _write_errors(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ValueError(f"{target}: cannot write ({error.strerror})") from None


@contextmanager
def staged_folder(path: str | Path, *, remove: Iterable[str] = ()) -> Iterator[Path]:
    """Publish files whole or not at all: a temporary folder inside ``path``, whose files move to ``path`` at the end.

    Where the ``with`` block fails or is interrupted, ``path`` stays as it was; once the files move, nothing but
    ``kill -9`` interrupts. The folder is made at once, so that one that cannot be written is found out before the work.

    Parameters
    ----------
    path
        The folder to publish to; made if need be.
    remove
        Names of files in ``path`` that go when the new ones have come.

    Raises
    ------
    ValueError
        In one line: the folder cannot be written, or a folder is in the way of a file or a file in that of a folder.
    """
    target = Path(path)
    made = not target.exists()
    temporary = None
    try:
        try:
            target.mkdir(parents=True, exist_ok=True)
            temporary = Path(tempfile.mkdtemp(dir=target, prefix=".occlib."))
        except OSError as error:
            raise ValueError(f"{target}: cannot write ({error.strerror})") from None
        yield temporary
        try:
            files = sorted(p for p in temporary.rglob("*") if p.is_file())
            targets = [target / file.relative_to(temporary) for file in files]
            if blocked := [final for final in targets if final.is_dir()]:
                raise ValueError(f"{blocked[0]}: cannot write (is a directory)")
            parents = {p for final in targets for p in final.parents if p.is_relative_to(target)}
            if blocked := sorted(p for p in parents if p.exists() and not p.is_dir()):
                raise ValueError(f"{blocked[0]}: cannot write (a file is in the way of the folder)")
            with uninterrupted():
                for file, final in zip(files, targets, strict=True):
                    final.parent.mkdir(parents=True, exist_ok=True)
                    os.replace(file, final)
                for name in remove:
                    (target / name).unlink(missing_ok=True)
        except OSError as error:
            raise ValueError(f"{target}: cannot write ({error.strerror})") from None
    finally:
        if temporary:
            shutil.rmtree(temporary, ignore_errors=True)
        if made and target.is_dir() and not any(target.iterdir()):
            target.rmdir()


def read_image(path: str | Path, *, alpha: bool = False) -> Image:
    """An image file as uint8 RGB, shape (H, W, 3).

    With ``alpha`` it is RGBA, (H, W, 4), 255 opaque, if the file has an alpha channel. ``ValueError`` in one line if there is
    none: a :class:`DamagedImageError` where the file can be read and is no whole picture.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot read the image ({error.strerror})") from None
    check = next((check for start, check in _WHOLE.items() if content.startswith(start)), bool)
    data = np.frombuffer(content, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if check(content) else None
    if image is None:
        raise DamagedImageError(f"{path}: corrupt or not an image (expected PNG or JPEG)")
    rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return np.dstack([rgb, *_alpha(data)]) if alpha else rgb


def _alpha(data: Image) -> list[Image]:
    """The alpha channel of an encoded picture, uint8 (H, W), or nothing if it has none."""
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 3 or image.shape[2] != 4:
        return []
    return [(image[..., 3] // (1 if image.dtype == np.uint8 else 257)).astype(np.uint8)]


def _whole_png(data: bytes) -> bool:
    """Whether every chunk of a PNG is there and has its checksum."""
    at = 8
    while len(data) >= at + 12:
        length = int.from_bytes(data[at : at + 4], "big")
        name, check = data[at + 4 : at + 8], data[at + 8 + length : at + 12 + length]
        if int.from_bytes(check, "big") != zlib.crc32(data[at + 4 : at + 8 + length]) or len(check) < 4:
            return False
        if name == b"IEND":
            return True
        at += 12 + length
    return False


def _whole_jpeg(data: bytes) -> bool:
    """Whether the end of the image is marked: one that was cut and filled with zeros decodes, its lower part grey."""
    at = 2
    while data[at : at + 1] == b"\xff" and data[at + 1 : at + 2] != b"\xda":  # the segments before the scan
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return data.find(b"\xff\xd9", at) > 0


_WHOLE = {PNG_SIGNATURE: _whole_png, b"\xff\xd8": _whole_jpeg}
"""Checks of a file by how it begins; a cut PNG would make libpng talk on stderr."""


def encode_image(suffix: str, image: Image, *, quality: int = 92) -> bytes:
    """A uint8 grey (H, W) or RGB (H, W, 3) image as the bytes of a .png, .jpg or .pgm file; RGBA (H, W, 4) as .png."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or image.size == 0:
        raise ValueError(f"image: expected uint8 (H, W) or (H, W, 3), got {image.dtype} {image.shape}")
    if image.ndim == 3 and image.shape[2] == 4 and suffix == ".png":
        bgr = cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA)
    else:
        bgr = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    jpeg = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    options = jpeg if suffix in (".jpg", ".jpeg") else [cv2.IMWRITE_PNG_COMPRESSION, 9] if suffix == ".png" else []
    done, data = cv2.imencode(suffix, bgr, options)
    if not done:
        raise ValueError(f"image: cannot encode as {suffix}")
    return bytes(data.tobytes())
