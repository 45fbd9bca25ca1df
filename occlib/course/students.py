"""Copies of the notebooks for students: the exercises without their solutions, made from the one master.

A copy that a student has filled in is never written over.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from occlib.base.files import sha256, write_file
from occlib.reproduce import find_root, read_notebook, select_notebooks, tags

_CHECK = re.compile(r'course\.check\("(\d\d\.\d)", (\w+)\)')
_FIGURE = re.compile(r'save\(\w+, "([\w.-]+)"')


def student_copy(notebook: str | Path, out: str | Path, *, figures: str | Path | None = None) -> bool:
    """Write a notebook without its solutions, unless a copy with a student's work lies there.

    Cells tagged ``bookkeeping`` are left out. The first code cell tagged ``solution`` of each exercise becomes a stub
    that assigns ``None`` to the name that the following check cell is given; the other solution cells are left out.
    Where a solution saves a figure, the copy shows it, from ``figures``, before the stub.

    Parameters
    ----------
    notebook, out
        The master, and the file to write.
    figures
        Folder of the published figures, ``<name>.png``; default: ``figures`` beside the master's folder.

    Returns
    -------
    Whether it was written: ``False`` if ``out`` holds a copy whose cells were changed since it was made.
    """
    content, out = read_notebook(notebook), Path(out)
    if out.exists() and not _untouched(out):
        return False
    shown = Path(figures) if figures is not None else Path(notebook).resolve().parent.parent / "figures"
    copied: list[dict[str, Any]] = []
    for index, cell in enumerate(content["cells"]):
        if "bookkeeping" in tags(cell):
            continue
        if "solution" in tags(cell):
            copied += _stub(content["cells"], index, shown)
            continue
        if cell["cell_type"] == "code":
            cell.update(outputs=[], execution_count=None)
        copied.append(cell)
    content["cells"] = copied
    content["metadata"]["occlib"] = {"made_from": Path(notebook).name, "cells_sha256": _cells_hash(copied)}
    write_file(out, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    return True


def student_copies(out: str | Path, root: str | Path | None = None) -> tuple[list[Path], list[Path]]:
    """A student copy of every notebook, below ``out``: those written, and those kept for the work that is in them."""
    written: list[Path] = []
    kept: list[Path] = []
    for path in select_notebooks(None, root or find_root()):
        target = Path(out) / path.name
        (written if student_copy(path, target) else kept).append(target)
    return written, kept


def _stub(cells: Sequence[dict[str, Any]], index: int, figures: Path) -> list[dict[str, Any]]:
    """What stands for the solution cell at ``index``: nothing, but for the first code cell of its exercise."""
    cell = cells[index]
    before = [i for i in range(index) if "exercise" in tags(cells[i])]
    earlier = cells[before[-1] if before else 0 : index]
    if cell["cell_type"] != "code" or any("solution" in tags(one) and one["cell_type"] == "code" for one in earlier):
        return []
    calls = (_CHECK.search("".join(one["source"])) for one in cells[index + 1 :] if "check" in tags(one))
    call = next(calls, None)
    if call is None:
        raise ValueError(f"solution in cell {index}: expected a check cell after it, course.check(number, answer)")
    number, name = call.groups()
    made: list[dict[str, Any]] = []
    if figure := _FIGURE.search("".join(cell["source"])):
        png = figures / f"{figure[1]}.png"
        if not png.is_file():
            raise ValueError(f"exercise {number}: its figure {png.name} is not in {figures}; first: make reproduce")
        made.append(_target(number, png, str(cell.get("id", index))))
    source = [f"# Exercise {number}: your code here; in the end, put your answer for None\n", f"{name} = None"]
    stub = {
        "cell_type": "code",
        "execution_count": None,
        "metadata": {"tags": ["stub"]},
        "outputs": [],
        "source": source,
    }
    return [*made, {**stub, **({"id": cell["id"]} if "id" in cell else {})}]


def _target(number: str, png: Path, name: str) -> dict[str, Any]:
    """A cell that shows the figure to be made, which travels within the notebook."""
    data = base64.b64encode(png.read_bytes()).decode("ascii")
    source = [
        f"This is the figure to make in exercise {number}:\n",
        "\n",
        f"![The figure to make](attachment:{png.name})",
    ]
    attachments = {png.name: {"image/png": data}}
    cell = {"cell_type": "markdown", "metadata": {}, "attachments": attachments, "source": source}
    return {**cell, "id": f"target-{name}"[:64]}


def _untouched(copy: Path) -> bool:
    """Whether a copy still has the cells that it was made with."""
    try:
        content = read_notebook(copy)
        return bool(content["metadata"]["occlib"]["cells_sha256"] == _cells_hash(content["cells"]))
    except (ValueError, KeyError, TypeError):
        return False


def _cells_hash(cells: Sequence[dict[str, Any]]) -> str:
    return sha256(json.dumps([[cell["cell_type"], "".join(cell["source"])] for cell in cells]))
