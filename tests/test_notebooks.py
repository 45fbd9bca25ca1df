"""Every notebook keeps the house's conventions, runs through the same runner as ``reproduce``, and delivers its numbers."""

from __future__ import annotations

import ast
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from occlib.experiments import reproduce
from occlib.notebooks import notebook_parameters, select_notebooks

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = select_notebooks(root=ROOT)
PAPER_FIGURES = {f"fig{number:02d}" for number in range(1, 12)}


def cells(path: Path, kind: str | None = None) -> list[dict[str, Any]]:
    """The notebook's cells, each with its source as one text."""
    found = json.loads(path.read_text(encoding="utf-8"))["cells"]
    for cell in found:
        cell["text"] = "".join(cell["source"])
        cell["tags"] = cell["metadata"].get("tags", [])
    return [cell for cell in found if kind in (None, cell["cell_type"])]


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request: pytest.FixtureRequest) -> Path:
    return Path(request.param)


def test_opening(notebook: Path) -> None:
    title, imports = cells(notebook)[:2]
    assert re.match(rf"# {notebook.stem[:2]}\b", title["text"])
    for promise in ("do", "learn", "need"):
        assert re.search(rf"what you will {promise}|you will {promise}|\b{promise}\b", title["text"], re.IGNORECASE)
    assert imports["cell_type"] == "code" and "show_versions()" in imports["text"].splitlines()[-1]


def test_parameters(notebook: Path) -> None:
    assert {"seed", "fast"} <= set(notebook_parameters(notebook))
    (cell,) = (cell for cell in cells(notebook) if "parameters" in cell["tags"])
    assert all(re.search(r"#\s*\S+, \S+", line) for line in cell["text"].splitlines() if line.strip())


def test_code_cells_are_short_and_define_nothing(notebook: Path) -> None:
    for cell in cells(notebook, "code"):
        assert len(cell["text"].splitlines()) <= 15, cell["text"]
        for node in ast.walk(ast.parse(cell["text"])):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):  # a matcher of the reader's own is the exception
                assert any("matching.matcher(" in ast.unparse(line) for line in node.decorator_list), cell["text"]
        assert not re.search(r"(^|[\"'(\s])(/work|/home|/tmp|/root|[A-Z]:\\)", cell["text"]), cell["text"]


def test_half_of_it_is_prose(notebook: Path) -> None:
    prose = sum(len(cell["text"]) for cell in cells(notebook, "markdown"))
    code = sum(len(cell["text"]) for cell in cells(notebook, "code"))
    assert prose / (prose + code) >= 0.4


def test_figures_are_named_and_saved_once(notebook: Path) -> None:
    saving = [cell["text"] for cell in cells(notebook, "code") if re.search(r"\bsave\(", cell["text"])]
    assert saving
    for text in saving:
        assert text.startswith("# Figure") and len(re.findall(r"\bsave\(", text)) == 1
        assert re.search(r"\bsave\(", text.splitlines()[-1]), text


def test_exercises_have_solutions(notebook: Path) -> None:
    assert len([cell for cell in cells(notebook) if "solution" in cell["tags"]]) >= 3


def test_stored_without_outputs(notebook: Path) -> None:
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells(notebook, "code"))


@pytest.fixture(scope="session")
def fast_metrics(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """Metrics of every notebook, run with ``fast=True`` in a project folder of their own."""
    home = tmp_path_factory.mktemp("project")
    shutil.copytree(ROOT / "notebooks", home / "notebooks", ignore=shutil.ignore_patterns(".*"))
    table = reproduce(root=home, fast=True, jobs=2, progress=False).metrics()
    assert not (home / "figures").exists()
    return table


def test_every_notebook_runs_and_records(fast_metrics: pd.DataFrame) -> None:
    assert set(fast_metrics["notebook"]) == {path.stem for path in NOTEBOOKS}
    assert fast_metrics["value"].notna().all()


@pytest.fixture(scope="module")
def committed() -> dict[str, float]:
    table = pd.read_csv(ROOT / "figures" / "metrics.csv", keep_default_na=False)
    return {f"{row.notebook[:2]}/{row.metric}": float(row.value) for row in table.itertuples()}


def test_every_figure_of_the_paper_is_there() -> None:
    assert PAPER_FIGURES <= {path.stem[:5] for path in (ROOT / "figures").glob("fig*.png")}


def test_readme_quotes_recorded_metrics(committed: dict[str, float]) -> None:
    rows = re.findall(r"^\|.*\|\s*([-\d.]+)[^|]*\|\s*`(\d\d/[\w.-]+)`\s*\|$", (ROOT / "README.md").read_text(), re.M)
    assert len(rows) >= 10
    for text, name in rows:
        digits = len(text.partition(".")[2])
        assert round(committed[name], digits) == float(text), name
