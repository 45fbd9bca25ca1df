"""The house as a drawing: the layers of the imports, from the roof down."""

from __future__ import annotations

import tomllib
from html import escape
from pathlib import Path

WORDS = {
    "cli": "the command line",
    "course": "the book, the exercises",
    "reproduce": "notebooks run, figures published",
    "study": "which measure, when",
    "lab": "scenes with exact truth",
    "running": "a recording in, files out",
    "live": "cameras in, the map on the air",
    "robots": "paths and right of way",
    "metrics": "scores against the truth",
    "plotting": "maps, views, overviews",
    "pipeline": "Fig 3: frames in, map and objects out",
    "settings": "the three profiles",
    "explaining": "beyond AND",
    "finding": "objects as regions of the evidence",
    "memory": "objects not seen now stay on the map",
    "identification": "known objects in each view",
    "calibration": "§2",
    "floor_marks": "§2",
    "foreground": "§2, §4",
    "matching": "§3",
    "localization": "§4",
    "registration": "§5, §6",
    "occlusion": "§5",
    "tracking": "§4",
    "mapping": "§5",
    "recordings": "folders of pictures",
    "geometry": "camera, floor, rig",
    "lens": "distortion",
    "formats": "files, typed",
    "base": "files, arrays, loops",
}
"""What stands below the name of a room."""

WIDTH, ROW, GAP, LEFT = 720, 50, 8, 8
SINGLE_ROW = 32
"""Height of a row with one room, whose name and words share a line."""

MOST = 5
"""So many rooms stand beside one another; the paper's stages take two lines."""


def layers_of(pyproject: str | Path) -> list[list[str]]:
    """The layers of the house from the roof down, each with its rooms, as ``pyproject.toml`` declares them."""
    contracts = tomllib.loads(Path(pyproject).read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    return [[room.strip() for room in layer.split("|")] for layer in layers]


def house_svg(layers: list[list[str]]) -> str:
    """The drawing as an SVG: a row a layer, the paper's stages in colour; an import goes down, never up or sideways.

    >>> house_svg([["cli"], ["live", "robots"]]).count("<rect")
    4
    """
    stages = max(layers, key=len)
    lines = [(rooms[at : at + MOST], rooms) for rooms in layers for at in range(0, len(rooms), MOST)]
    boxes, y = [], GAP
    for rooms, layer in lines:
        height = SINGLE_ROW if len(layer) == 1 else ROW
        width = (WIDTH - 2 * LEFT - GAP * (len(rooms) - 1)) / len(rooms)
        for column, room in enumerate(rooms):
            fill = "#d6e8f5" if layer is stages else "#f0efe9"
            boxes += _box(room, LEFT + column * (width + GAP), y, width, height, fill)
        y += height + GAP
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y}" font-family="sans-serif" role="img">',
            "<title>The rooms of occlib in layers; an import goes down, never up and never sideways</title>",
            f'<rect width="{WIDTH}" height="{y}" fill="#ffffff"/>',
            *boxes,
            "</svg>\n",
        ]
    )


def _box(room: str, x: float, y: float, width: float, height: float, fill: str) -> list[str]:
    """A room: its frame, its name, and what it is."""
    frame = f'<rect x="{x:.1f}" y="{y}" width="{width:.1f}" height="{height}" rx="5" fill="{fill}" stroke="#7a7a7a"/>'
    words = WORDS.get(room, "")
    if height == SINGLE_ROW:
        name, about = _line(x + 210, y + 21, room, "bold", "end"), _line(x + 225, y + 21, words, "normal", "start")
    else:
        middle = x + width / 2
        name, about = _line(middle, y + 21, room, "bold", "middle"), _line(middle, y + 39, words, "normal", "middle")
    return [frame, name, about]


def _line(x: float, y: float, text: str, weight: str, anchor: str) -> str:
    style = f'font-size="{15 if weight == "bold" else 14}" fill="#1a1a1a" font-weight="{weight}" text-anchor="{anchor}"'
    return f'<text x="{x:.1f}" y="{y}" {style}>{escape(text)}</text>'
