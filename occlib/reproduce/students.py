"""Copies of the notebooks for students: the exercises without their solutions."""

from __future__ import annotations

import json
from pathlib import Path

from occlib.base.files import write_file
from occlib.reproduce.runner import read_notebook, select_notebooks, tags


def student_copy(notebook: str | Path, out: str | Path) -> Path:
    """Write a notebook without its solutions: each cell tagged ``solution`` becomes an empty one to fill in."""
    content = read_notebook(notebook)
    stubs = {"code": "# Your solution here", "markdown": "*Your answer here.*"}
    for cell in content["cells"]:
        if cell["cell_type"] == "code":
            cell.update(outputs=[], execution_count=None)
        if "solution" in tags(cell):
            cell.pop("attachments", None)
            cell["source"] = [stubs.get(cell["cell_type"], "")]
            cell["metadata"] = {"tags": ["exercise"]}
    return write_file(out, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def student_copies(out: str | Path, root: str | Path | None = None) -> list[Path]:
    """A student copy of every notebook, below ``out``."""
    return [student_copy(path, Path(out) / path.name) for path in select_notebooks(None, root)]
