"""Ways to damage a recording; each is made for ``tiny_recording`` and takes its folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import yaml

from helpers.commands import Array

Damage = Callable[[Path], object]


def paint(folder: Path, camera: str, frames: Sequence[int], change: Callable[[Array], Array]) -> None:
    for frame in frames:
        path = next((folder / "frames" / camera).glob(f"*{frame:04d}.*"))
        assert cv2.imwrite(str(path), change(cv2.imread(str(path))))


def repeat(folder: Path, camera: str, frames: Sequence[int]) -> None:
    """The first of the frames in the place of all."""
    old = next((folder / "frames" / camera).glob(f"*{frames[0]:04d}.*"))
    for frame in frames[1:]:
        shutil.copyfile(old, next((folder / "frames" / camera).glob(f"*{frame:04d}.*")))


def picture(name: str, content: bytes | Array) -> Damage:
    """Put something else in the place of a picture."""

    def change(folder: Path) -> None:
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            assert cv2.imwrite(str(folder / name), content)

    return change


def cut(name: str) -> Damage:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:150])


def folder_for(name: str) -> Damage:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).mkdir()

    return change


def text(name: str, content: str) -> Damage:
    return lambda folder: (folder / name).write_text(content, encoding="utf-8")


def rig(**fields: Any) -> Damage:
    """Change fields of the left camera, or of the rig itself."""

    def change(folder: Path) -> None:
        content = yaml.safe_load((folder / "rig.yaml").read_text())
        for name, value in fields.items():
            (content["cameras"]["left"] if name in content["cameras"]["left"] else content)[name] = value
        (folder / "rig.yaml").write_text(yaml.safe_dump(content))

    return change


def video(content: bytes) -> Damage:
    def change(folder: Path) -> None:
        shutil.rmtree(folder / "frames/left")
        (folder / "frames/left.mp4").write_bytes(content)

    return change


def gone(name: str) -> Damage:
    return lambda f: shutil.rmtree(f / name) if (f / name).is_dir() else (f / name).unlink()


def lost(camera: str, *frames: int) -> Damage:
    def change(folder: Path) -> None:
        for frame in frames:
            (folder / f"frames/{camera}/{frame:04d}.png").unlink()

    return change
