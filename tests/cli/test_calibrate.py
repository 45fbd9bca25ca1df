"""``occlib calibrate``: real photographs, wrong options, no pictures."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from helpers.commands import fails
from occlib.cli import main


def test_calibrate_on_real_photographs(
    shared_data: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = sorted(map(str, shared_data("opencv-checkerboard").glob("left*.jpg")))
    out = tmp_path / "camera.yaml"
    assert main(["calibrate", *images, "--pattern", "9x6", "--square", "0.025", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"{len(images)} of {len(images)} pictures used" in said
    fields = yaml.safe_load(out.read_text())
    assert {"size", "matrix", "distortion", "rms_px", "views_used"} <= set(fields)
    assert fields["size"] == [640, 480]
    assert fields["rms_px"] <= 0.41
    assert abs(fields["matrix"][0][0] - 535.9) <= 2
    assert len(fields["distortion"]) == 5
    assert fields["views_used"] == len(images)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--pattern", "9"], "pattern: expected COLUMNSxROWS of inner corners, such as 9x6, got '9'"),
        (["--pattern", "9x6x2"], "pattern: expected COLUMNSxROWS"),
        (["--pattern", "²x6"], "pattern: expected COLUMNSxROWS"),
        (["--pattern", "1x1"], "pattern: expected .* 3 or more each, got .1, 1"),
        (["--square", "0"], "square: expected metres > 0, got 0"),
        (["--square", "nan"], "square: expected metres > 0, got nan"),
        (["--square", "1e308"], r"square: expected metres > 0.*, got 1e\+308"),
    ],
)
def test_calibrate_says_what_is_wrong(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    image = tmp_path / "grey.png"
    assert cv2.imwrite(str(image), np.full((60, 80), 128, np.uint8))
    given = {"--pattern": "9x6", "--square": "0.025"} | dict([options])
    flat = [part for pair in given.items() for part in pair]
    assert re.search(message, fails(capfd, "calibrate", image, *flat, "--out", tmp_path / "camera.yaml"))
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.parametrize("content", [None, b"", b"hello"])
def test_calibrate_on_a_picture_that_is_none(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], content: bytes | None
) -> None:
    if content is not None:
        (tmp_path / "board.png").write_bytes(content)
    said = fails(capfd, "calibrate", tmp_path / "board.png", "--pattern", "9x6", "--square", "0.025")
    assert re.search(r"board.png: (cannot read the image|corrupt or not an image)", said)
