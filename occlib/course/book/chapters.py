"""A chapter of the book: an executed notebook, without what only the machine needs, and with its solutions folded."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from occlib.course.book.pages import Links
from occlib.reproduce import tags

Cell = dict[str, Any]

LEFT_OUT = {"bookkeeping", "fast", "injected-parameters"}
"""Tags of the cells that a reader of the book does not see."""

FOLDED = {"solution": "the solution", "check": "the check", "parameters": "the parameters"}
"""Tags of the code cells that are closed at first, and what opens them: "Show the solution"."""

WIDGET = "application/vnd.jupyter.widget-view+json"

NOT_RUN = "*Not run here: the recording is not fetched.*"
"""What stands below a cell that was held back, see :func:`occlib.reproduce.open_or_stop`."""

_SAVE = re.compile(r"""\bsave(?:_film)?\(\s*\w+\s*,\s*["']([\w.-]+)["']""")
_CAPTION = re.compile(r"#\s*(Figure[^\n]*(?:\n#[^\n]*)*)")


def figure_of(cell: Mapping[str, Any]) -> tuple[str, str] | None:
    """Name and caption of the figure that a code cell saves, or ``None``.

    >>> figure_of({"cell_type": "code", "source": '# Figure 7 of the paper: contour\\nreproduce.save(fig, "fig07")'})
    ('fig07', 'Figure 7 of the paper: contour')
    """
    text = source_of(cell)
    names = _SAVE.findall(text) if cell["cell_type"] == "code" else []
    if not names:
        return None
    caption = _CAPTION.match(text.lstrip())
    words = re.sub(r"\s*\n#\s*", " ", caption[1]) if caption else f"Figure: {names[-1]}"
    return names[-1], words.strip()


def anchor(name: str) -> str:
    """Where in its chapter a figure is made: the target of a link.

    >>> anchor("nb07_lamps")
    'figure-nb07-lamps'
    """
    return "figure-" + re.sub(r"[^a-z0-9]+", "-", name.lower())


def source_of(cell: Mapping[str, Any]) -> str:
    """The text of a cell."""
    return "".join(cell["source"])


def held_back(notebook: Mapping[str, Any]) -> set[int]:
    """Which cells of code did nothing, because the recording that they need was not fetched."""
    held: set[int] = set()
    holding = False
    for number, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] != "code":
            continue
        text = source_of(cell)
        holding = holding and "resume()" not in text
        if holding and not cell["outputs"]:
            held.add(number)
        if "open_or_stop(" in text:
            holding = any("not fetched" in "".join(output.get("text", "")) for output in cell["outputs"])
    return held


def figures_not_shown(notebook: Mapping[str, Any]) -> list[str]:
    """Names of the figures that a cell saves and whose picture is not in its output, but for cells held back."""
    held = held_back(notebook)
    return [
        figure[0]
        for number, cell in enumerate(notebook["cells"])
        if (figure := figure_of(cell)) and number not in held and not any(map(_is_picture, cell["outputs"]))
    ]


def _is_picture(output: Mapping[str, Any]) -> bool:
    data = output.get("data", {})
    return "image/png" in data or "<img" in "".join(data.get("text/html", ""))


def chapter_page(notebook: Mapping[str, Any], links: Links) -> dict[str, Any]:
    """The notebook as a page of the book; the given one stays as it is.

    Parameters
    ----------
    notebook
        An executed notebook of format 4.
    links
        Rewrites the links of its prose, see :class:`occlib.course.book.pages.Links`.
    """
    cells: list[Cell] = []
    held = held_back(notebook)
    for number, cell in enumerate(notebook["cells"]):
        if not LEFT_OUT & set(tags(cell)):
            cells += _page_cells(copy.deepcopy(cell), links)
            cells += [_prose(NOT_RUN)] if number in held else []
    for i, cell in enumerate(cells):
        cell["id"] = f"cell-{i}"
    language = {"name": "python", "pygments_lexer": "ipython3"}
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": language},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def _page_cells(cell: Cell, links: Links) -> list[Cell]:
    """What becomes of one cell: itself, with a target before it where it makes a figure."""
    marks = set(tags(cell))
    if cell["cell_type"] != "code":
        text = links.rewritten(source_of(cell))
        if "solution" in marks:
            text = f"::::::{{dropdown}} Show the explanation\n{text}\n::::::"
        return [_prose(text)]
    text = source_of(cell)
    if not text.strip():
        return []
    figure = figure_of(cell)
    own: dict[str, Any] = {}
    if show := next((FOLDED[tag] for tag in FOLDED if tag in marks), None):
        own |= {"code_prompt_show": f"Show {show}", "code_prompt_hide": f"Hide {show}"}
    if "show_versions()" in text:
        own |= {"code_prompt_show": "Show the imports", "code_prompt_hide": "Hide the imports"}
    own["image"] = {"alt": _as_alt(figure[1] if figure else _first_words(text)), **_width(cell["outputs"])}
    folding = ["hide-cell" if show != FOLDED["parameters"] else "hide-input"] if show else []
    folding += ["hide-input"] if "show_versions()" in text else []
    outputs = [output for output in map(_shown, cell["outputs"]) if output]
    page = {
        "cell_type": "code",
        "execution_count": cell.get("execution_count"),
        "metadata": {"tags": folding, "mystnb": own},
        "outputs": outputs,
        "source": text,
    }
    before = [_prose(f"({anchor(figure[0])})=\n")] if figure else []
    after = [_prose("*In JupyterLab this cell shows a slider.*")] if "slider" in marks and not outputs else []
    return [*before, page, *after]


def _width(outputs: list[Mapping[str, Any]]) -> dict[str, str]:
    """The width at which a cell says that its picture is shown."""
    widths = [output.get("metadata", {}).get("image/png", {}).get("width") for output in outputs]
    return {"width": f"{max(filter(None, widths))}px"} if any(widths) else {}


def _prose(text: str) -> Cell:
    return {"cell_type": "markdown", "metadata": {}, "source": text}


def _shown(output: Mapping[str, Any]) -> dict[str, Any] | None:
    """An output as the book shows it: no widgets, which need a kernel, and no messages of the machine."""
    if output.get("name") == "stderr":
        return None
    shown = {key: value for key, value in output.items() if key != "metadata"}
    if output["output_type"] in ("display_data", "execute_result"):
        data = dict(output["data"])
        if data.pop(WIDGET, None) is not None:
            data = {kind: value for kind, value in data.items() if kind == "text/html"}
        if not data:
            return None
        if "text/html" in data:
            data["text/html"] = one_header("".join(data["text/html"]))
        shown |= {"data": data, "metadata": {}}
    return shown


def one_header(text: str) -> str:
    r"""Tables of pandas with the name of their index beside the names of the columns, not in a row of its own below.

    >>> one_header("<thead><tr><th></th><th>a</th></tr><tr><th>n</th><th></th></tr></thead>")
    '<thead><tr><th>n</th><th>a</th></tr></thead>'
    >>> one_header("<thead><tr><th>c</th><th>a</th></tr><tr><th>n</th><th></th></tr></thead>")
    '<thead><tr><th>n \\ c</th><th>a</th></tr></thead>'
    """
    return re.sub(r"<thead>.*?</thead>", _merged, text, flags=re.S)


def _merged(head: re.Match[str]) -> str:
    """The head of a table, its last row, which names the index and no column, in the row above it."""
    rows = re.findall(r"<tr.*?</tr>", head[0], re.S)
    *_, above, last = [[], *([re.findall(r"<th>(.*?)</th>", row, re.S) for row in rows])]
    if len(rows) < 2 or len(above) != len(last) or last[-1] or not any(last):
        return head[0]
    cells = [" \\ ".join(filter(None, (name, column))) for column, name in zip(above, last, strict=True)]
    row = "".join(f"<th>{cell}</th>" for cell in cells)
    return f"<thead>{''.join(rows[:-2])}<tr>{row}</tr></thead>"


def _first_words(code: str) -> str:
    """What to say of a picture that has no caption: the comment or the call that makes it."""
    lines = code.strip().splitlines()
    comment = lines[0].lstrip("# ").strip() if lines[0].startswith("#") else ""
    return comment or f"Picture made by {lines[-1].strip()}"


def _as_alt(words: str) -> str:
    return " ".join(words.split()).replace('"', "'")[:300]
