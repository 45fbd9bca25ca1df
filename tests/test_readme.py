"""What the README shows works as it stands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from occlib.calibration import Calibration, save_calibration
from occlib.geometry import Rig
from occlib.lens import Lens
from occlib.matching.measures import METHODS
from occlib.matching.search import find

README = (Path(__file__).resolve().parent.parent / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_a_rig_is_made_as_the_readme_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = (text for text in PYTHON if "floor_homography_from_marks" in text)
    fields = yaml.safe_load(README[README.index("    units: m") :].split("\n\n")[0].replace("...", "null"))
    lens = fields["cameras"]["left"]
    matrix, distortion = np.array(lens["matrix"], float), np.array(lens["distortion"], float)
    save_calibration("left.yaml", Calibration(tuple(lens["size"]), Lens(matrix, distortion), rms_px=0.1, views_used=10))
    exec(compile(code, "README.md", "exec"), {})
    left = Rig.load("rig.yaml")["left"]
    np.testing.assert_allclose(left.pixels_to_floor([[120, 400], [430, 180]]), [[-1, -1], [1, 1]], atol=1e-6)


def test_the_chain_runs_as_the_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = (text for text in PYTHON if "pipeline.process" in text)
    exec(compile(code.replace("four_robots", "ball_and_oval"), "README.md", "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_links_lead_somewhere() -> None:
    root = Path(__file__).resolve().parent.parent
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if "://" not in link]
    assert len(links) > 20
    assert [link for link in links if not (root / link).exists()] == []


def test_coins_are_found_as_the_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = (text for text in PYTHON if "data.coins" in text)
    exec(compile(code, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "[270.5 130.5] 0.0 1.0 1.0"  # an exact copy of itself
    assert len(lines) == 24  # coins in the picture


def test_a_matcher_joins_as_the_readme_says() -> None:
    (code,) = (text for text in PYTHON if "@matching.matcher" in text)
    image: Any = np.kron(np.random.default_rng(0).integers(0, 256, (20, 30)), np.ones((5, 5))).astype(np.uint8)
    try:
        exec(compile(code, "README.md", "exec"), {})
        (match,) = find(image // 2 + 30, image[20:50, 40:80], "direction", rule="nms", max_count=1)
    finally:
        METHODS.pop("direction", None)
    assert (match.x, match.y) == (40, 20) and match.score > 0.5
