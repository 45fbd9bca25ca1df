"""``occlib compare``: the table, the picture, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.commands import fails
from occlib.cli import main


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """A picture with a blob pattern twice, once at half the light, and the pattern as the template."""
    rng = np.random.default_rng(0)
    image = rng.integers(90, 110, (120, 160)).astype(np.uint8)
    pattern = np.kron(rng.integers(0, 2, (6, 6)), np.ones((4, 4))) * 160 + 40
    image[20:44, 30:54], image[80:104, 110:134] = pattern, pattern / 2
    paths = tmp_path / "image.png", tmp_path / "template.png"
    for path, picture in zip(paths, (image, image[20:44, 30:54]), strict=True):
        cv2.imwrite(str(path), picture)
    return paths


def test_compare_prints_a_table_and_draws_a_picture(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new folder" / "picture.png"
    assert main(["compare", *map(str, pair), "--out", str(out)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0].split() == ["best", "x", "y", "threshold", "matches", "ms"]
    rows = {line.split()[0]: line.split()[1:] for line in table[2:7]}
    assert list(rows) == ["ssd", "sad", "ncc", "zncc", "sed"]
    assert [rows["ssd"][i] for i in (0, 1, 2, 4)] == ["0", "30", "20", "1"]
    assert [rows["zncc"][i] for i in (0, 1, 2, 4)] == ["1", "30", "20", "2"]  # the dark one, too
    picture = cv2.imread(str(out))
    assert picture is not None and picture.shape[1] > 1000


def test_compare_as_json_with_a_rule_a_threshold_and_a_mask(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), np.pad(np.full((12, 24), 255, np.uint8), ((0, 12), (0, 0))))
    options = ["--methods", "zncc", "ncc", "--threshold", "0.99", "--rule", "nms", "--mask", str(mask), "--json"]
    assert main(["compare", *map(str, pair), *options, "--out", str(tmp_path / "a.png")]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert list(rows) == ["zncc", "ncc"] and rows["zncc"]["threshold"] == 0.99
    assert [match["centre_px"] for match in rows["zncc"]["found"]] == [[41.5, 31.5], [121.5, 91.5]]
    assert rows["zncc"]["found"][0]["score"] == 1.0


@pytest.mark.slow
def test_compare_a_template_without_contrast(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flat = tmp_path / "flat.png"
    cv2.imwrite(str(flat), np.full((20, 20), 100, np.uint8))
    options = ["--methods", "sad", "zncc", "sed", "--out", str(tmp_path / "a.png")]
    assert main(["compare", str(pair[0]), str(flat), *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].split()[:4] == ["zncc", "-", "-", "-"] and lines[2].split()[1] != "-"
    assert lines[5].startswith("zncc, sed: the same score everywhere")
    assert main(["compare", str(pair[0]), str(flat), *options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["zncc"]["best"] is None


@pytest.mark.slow
def test_compare_with_a_matcher_of_ones_own(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from occlib.matching.measures import METHODS

    own = tmp_path / "own.py"
    own.write_text(
        "from occlib import matching\n"
        "@matching.matcher('half', higher_is_better=False)\n"
        "def half(image, template, mask):\n"
        "    return matching.METHODS['ssd'].score(image, template, mask) / 2\n"
    )
    try:
        options = ["--matchers", str(own), "--methods", "ssd", "half", "--out", str(tmp_path / "a.png")]
        assert main(["compare", *map(str, pair), *options]) == 0
    finally:
        METHODS.pop("half", None)
    assert capsys.readouterr().out.splitlines()[3].split()[:4] == ["half", "0", "30", "20"]


@pytest.mark.parametrize(
    "options, message",
    [
        (["--methods", "zssd"], "method: expected one of ssd, sad, ncc, zncc, sed, got 'zssd'"),
        (["--threshold", "-1"], "threshold: expected 0 to inf for ssd, got -1.0"),
        (["--threshold", "half"], "threshold: expected a finite number, 'otsu', 'mad' or None, got 'half'"),
        (["--rule", "best"], "rule: expected one of components, nms, got 'best'"),
        (["--out", "picture.jpg"], "--out: expected a file name that ends in .png, got picture.jpg"),
        (["--mask", "nowhere.png"], "nowhere.png: cannot read the image"),
        (["--matchers", "nowhere.py"], "nowhere.py"),
    ],
)
def test_compare_says_what_is_wrong(
    pair: tuple[Path, Path], options: list[str], message: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, "compare", *pair, *options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["image.png", "template.png"]


def test_compare_template_larger_than_the_image_or_no_picture(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, template = pair
    out = tmp_path / "a.png"
    message = fails(capsys, "compare", template, image, "--out", out)
    assert message == "template: expected no larger than the image (24, 24), got (120, 160)"
    template.write_text("no picture")
    assert "template.png" in fails(capsys, "compare", image, template, "--out", out)
    assert not out.exists()
