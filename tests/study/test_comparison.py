"""Two files compared: read, measured, drawn, or refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from occlib.base.files import read_image
from occlib.matching.search import compare
from occlib.study.comparison import compare_pictures


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """A noisy picture in colour and a piece of it."""
    picture = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    for name, part in (("image.png", picture), ("template.png", picture[20:40, 30:54])):
        cv2.imwrite(str(tmp_path / name), part)
    return tmp_path / "image.png", tmp_path / "template.png"


@pytest.mark.parametrize("colour", [False, True])
def test_files_are_compared_as_their_arrays(pair: tuple[Path, Path], tmp_path: Path, colour: bool) -> None:
    results = compare_pictures(*pair, tmp_path / "a.png", methods=["zncc", "ssd"], colour=colour)
    assert list(results) == ["zncc", "ssd"]
    assert [(match.x, match.y) for match in results["ssd"].matches] == [(30, 20)]
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    if colour:
        expected = compare(*map(read_image, pair), ["ssd"])["ssd"]
        np.testing.assert_array_equal(results["ssd"].score, expected.score)


@pytest.mark.slow
def test_a_mask_and_a_matcher_of_ones_own(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from occlib.matching.measures import METHODS

    image = cv2.imread(str(pair[0]))
    image[20:30] = 0  # half of the target
    cv2.imwrite(str(pair[0]), image)
    mask = np.zeros((20, 24), np.uint8)
    mask[10:] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    (tmp_path / "own.py").write_text(
        "from occlib import matching\n"
        "@matching.matcher('half', higher_is_better=False)\n"
        "def half(image, template, mask):\n"
        "    return matching.METHODS['ssd'].score(image, template, mask) / 2\n"
    )
    options: dict[str, Any] = {"mask": tmp_path / "mask.png", "matchers": tmp_path / "own.py"}
    try:
        results = compare_pictures(*pair, tmp_path / "a.png", **options)
    finally:
        METHODS.pop("half", None)
    assert list(results)[-1] == "half" and results["half"].score[20, 30] == 0
    np.testing.assert_array_equal(results["half"].score, results["ssd"].score / 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"out": "picture.jpg"}, r"out: expected a file name that ends in \.png, got picture.jpg"),
        ({"image": "nowhere.png"}, "nowhere.png: cannot read the image"),
        ({"mask": "nowhere.png"}, "nowhere.png: cannot read the image"),
        ({"matchers": "nowhere.py"}, "nowhere.py: No such file or directory"),
        ({"methods": ["zssd"]}, "method: expected one of ssd, .*, got 'zssd'"),
    ],
)
def test_what_is_wrong_is_told_and_nothing_written(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        compare_pictures(**{"image": pair[0], "template": pair[1], "out": "a.png", **options})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["image.png", "template.png"]
