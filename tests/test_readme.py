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

README = (Path(__file__).resolve().parent.parent / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_a_rig_is_made_as_the_readme_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = (text for text in PYTHON if "floor_homography_from_marks" in text)
    fields = yaml.safe_load(README[README.index("    units: m") :].split("\n\n")[0].replace("...", "null"))
    lens = fields["cameras"]["left"]
    matrix, distortion = np.array(lens["matrix"], float), np.array(lens["distortion"], float)
    save_calibration("left.yaml", Calibration(tuple(lens["size"]), matrix, distortion, rms_px=0.1, views_used=10))
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


def test_coins_are_found_and_a_matcher_joins_as_the_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    from occlib.matching import METHODS, reference_similarity, similarity

    (code,) = (text for text in PYTHON if "@matcher" in text)
    names: dict[str, Any] = {}
    try:
        exec(compile(code, "README.md", "exec"), names)
        image, template = np.random.default_rng(0).integers(0, 256, (2, 20, 30)).astype(np.uint8)
        score = similarity(image, template[:5, :6], "largest")
        assert score[3, 4] == np.abs(image[3:8, 4:10].astype(int) - template[:5, :6]).max()
        assert reference_similarity(image, template[:5, :6], "largest")[3, 4] == score[3, 4]
    finally:
        METHODS.pop("largest", None)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "[249.5 134.5] 0.0 1.0 1.0"  # an exact copy of itself
    assert len(lines) > 1
