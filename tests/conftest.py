"""A tiny recording with exact silhouettes and truth, made anew for each test, which may damage it at will.

Two cameras of 160x120 px with lens distortion look from opposite walls at a floor of 4 m x 3 m. Boxes stand on it.
Files are written with OpenCV alone, so that a wrong channel order or layout in the library cannot cancel out.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from occlib.geometry import Camera, Floor, Rig
from occlib.lens import Lens
from occlib.pipeline import Pipeline, backgrounds_of
from occlib.recordings import open_recording

pytest.register_assert_rewrite("helpers")
collect_ignore_glob = ["bench_*.py"]  # scripts, without tests
if not os.environ.get("OCCLIB_BROWSER"):
    collect_ignore_glob.append("browser/*")  # they need Chromium: `make test-browser`
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    # As in `nohup make test &`. Whatever is ignored is so in child processes, too, and tests interrupt theirs; a handler,
    # even one that does nothing, is not inherited.
    signal.signal(signal.SIGINT, lambda *_: None)
SHARED = Path(__file__).parents[2] / "shared/data"
SIZE, FLOOR_GREY = (160, 120), (170, 170, 170)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the loops of the chain once, before several processes would each do so while others watch the clock."""
    if not hasattr(session.config, "workerinput") and not session.config.option.collectonly:
        recording = open_recording("ball_and_oval", ["left", "right"])
        pipeline = Pipeline(recording.rig, backgrounds_of(recording))
        for frame, images in recording.images(recording.frames[:2]):
            pipeline.process(images, recording.time(frame))


@dataclass(frozen=True)
class Box:
    """An upright prism on the floor: centre, side and height in m, colour RGB."""

    id: str
    x: float
    y: float
    side: float = 0.4
    height: float = 0.3
    colour: tuple[int, int, int] = (120, 20, 20)

    @property
    def footprint(self) -> list[list[float]]:
        half = self.side / 2
        return [[self.x + half * i, self.y + half * j] for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


Draw = Callable[[Sequence[Box]], dict[str, np.ndarray[Any, Any]]]


def boxes_at(frame: int) -> list[Box]:
    """What stands on the floor in a frame: A moves by 0.1 m a frame, B (dark blue) stays."""
    return [Box("A", 1.2 + 0.1 * frame, 0.9), Box("B", 2.6, 2.1, colour=(20, 20, 60))]


def camera_at(name: str, centre: Sequence[float], target: Sequence[float]) -> Camera:
    forward = np.subtract(target, centre) / np.linalg.norm(np.subtract(target, centre))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.array([[105.0, 0, 80.5], [0, 104.0, 59.0], [0, 0, 1]])
    lens = Lens(matrix, np.array([-0.2, 0.04, 0.001, -0.001, 0.0]))
    return Camera.from_pose(name, SIZE, lens, rotation, -rotation @ centre)


@pytest.fixture(scope="session")
def box() -> type[Box]:
    """The class ``Box``, as test files cannot import this one."""
    return Box


@pytest.fixture(scope="session")
def tiny_rig() -> Rig:
    """Cameras ``left`` and ``right``; both see the whole floor of 80 x 60 cells."""
    cameras = [
        camera_at("left", (-1.5, 1.5, 2.5), (2.0, 1.5, 0.0)),
        camera_at("right", (5.5, 1.3, 2.6), (2.0, 1.5, 0.0)),
    ]
    return Rig(Floor((0.0, 4.0), (0.0, 3.0), 0.05), {camera.name: camera for camera in cameras})


@pytest.fixture(scope="session")
def draw(tiny_rig: Rig) -> Draw:
    """``draw(boxes) -> {camera: uint8 RGB}``: every pixel whose ray meets a box has its colour; later boxes on top."""
    xs, ys = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    pixels = np.column_stack([xs.ravel(), ys.ravel()])
    rays = {name: camera.lens.undistort(pixels) for name, camera in tiny_rig.cameras.items()}

    def views(boxes: Sequence[Box]) -> dict[str, np.ndarray[Any, Any]]:
        images = {}
        for name, camera in tiny_rig.cameras.items():
            images[name] = np.full((SIZE[1], SIZE[0], 3), FLOOR_GREY, np.uint8)
            rotation, translation = camera.pose
            for box in boxes:
                corners = np.array([[x, y, z] for x, y in box.footprint for z in (0, box.height)])
                seen = (corners @ rotation.T + translation) @ camera.matrix.T
                hull = cv2.convexHull((seen[:, :2] / seen[:, 2:]).astype(np.float32))[:, 0].astype(float)
                edges = np.roll(hull, -1, axis=0) - hull
                offsets = rays[name][:, None] - hull
                side = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
                inside = (side >= 0).all(axis=1) | (side <= 0).all(axis=1)
                images[name][inside.reshape(SIZE[::-1])] = box.colour
        return images

    return views


@pytest.fixture
def tiny_recording(tmp_path: Path, tiny_rig: Rig, draw: Draw) -> Path:
    """A folder in the contract's layout: frames 0 to 4 of both cameras, two backgrounds each, truth, 10 fps."""
    folder = tmp_path / "tiny"
    pictures = {f"frames/{{}}/{frame:04d}.png": boxes_at(frame) for frame in range(5)}
    pictures |= {f"background/{{}}/{i}.png": [] for i in range(2)}
    for pattern, boxes in pictures.items():
        for name, image in draw(boxes).items():
            path = folder / pattern.format(name)
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), image[..., ::-1])
    (folder / "rig.yaml").write_text(tiny_rig.to_yaml(), encoding="utf-8")
    truth = {
        str(frame): [{"id": box.id, "x": box.x, "y": box.y, "footprint": box.footprint} for box in boxes_at(frame)]
        for frame in range(5)
    }
    roi = {"south": [[0, 0], [4, 0], [4, 1.5], [0, 1.5]]}
    (folder / "truth.json").write_text(json.dumps({"units": "m", "frames": truth, "roi": roi}), encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """``shared_data(name)``: the folder of a real recording, or the test is skipped."""

    def find(name: str) -> Path:
        if not (SHARED / name).is_dir():
            pytest.skip(f"real data not at {SHARED / name}")
        return SHARED / name

    return find


@pytest.fixture
def hide_package(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """``hide_package(name)``: from now on the package cannot be imported, as if it were not installed."""

    def hide(package: str) -> None:
        loaded = [name for name in sys.modules if name.startswith(f"{package}.")]
        for name in (package, *loaded):
            monkeypatch.setitem(sys.modules, name, None)

    return hide
