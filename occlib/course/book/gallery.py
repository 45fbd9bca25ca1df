"""All figures of the notebooks on one page, each a door to the cell that makes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from occlib.base import encode_image, read_image
from occlib.course.book.chapters import anchor, figure_of

WIDTH_PX = 480
"""Width of a thumbnail: twice the width at which it is shown."""


@dataclass(frozen=True)
class Figure:
    """A figure, the chapter (``07_resolve_occlusion``) that makes it, and the file of its picture."""

    name: str
    caption: str
    chapter: str
    picture: Path

    @property
    def target(self) -> str:
        """Link to the cell that makes it, from the top of the book."""
        return f"chapters/{self.chapter}.html#{anchor(self.name)}"


def figures_of(notebook: Mapping[str, Any], chapter: str, *folders: Path) -> list[Figure]:
    """The figures that a notebook saves, in order; the picture is looked for in each folder in turn."""
    figures = []
    for name, caption in filter(None, map(figure_of, notebook["cells"])):
        files = [folder / f"{name}{suffix}" for folder in folders for suffix in (".png", ".webp")]
        there = [file for file in files if file.exists()]
        if there:
            figures.append(Figure(name, caption, chapter, there[0]))
    return figures


def thumbnail(picture: Path, width: int = WIDTH_PX) -> bytes:
    """The picture, or a film's first one, as a small JPEG on white, at most as high as wide, the top of what is higher."""
    image = read_image(picture)
    height = max(round(image.shape[0] * width / image.shape[1]), 1)
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return encode_image(".jpg", small[:width], quality=85)


def gallery(figures: Mapping[str, list[Figure]]) -> str:
    """The gallery in MyST Markdown: a grid of thumbnails for each chapter, titles of the chapters as keys."""
    parts = []
    for title, own in figures.items():
        if own:
            cards = "\n".join(map(_card, own))
            parts.append(f"## {title}\n\n::::{{grid}} 1 2 3 3\n:gutter: 3\n\n{cards}\n::::\n")
    return "\n".join(parts)


def _card(figure: Figure) -> str:
    words = figure.caption.removeprefix("Figure: ")
    words = words[:1].upper() + words[1:]
    alt = words.replace('"', "'")
    link = f"chapters/{figure.chapter}.html#{anchor(figure.name)}"
    picture = f'<img src="_thumbnails/{figure.name}.jpg" alt="" loading="lazy">'
    return (
        f":::{{grid-item}}\n:class: thumbnail\n"
        f'```{{raw}} html\n<a class="thumbnail-link" href="{link}" title="{alt}">{picture}<span>{_html(words)}</span></a>\n```\n:::'
    )


def _html(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
