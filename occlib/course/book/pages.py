"""The Markdown of the repository as pages of the book: links, citations, marks and blocks that are filled in.

The sources in ``docs/`` are plain Markdown and read well where they are. What the book has more than they have is put in
here: a link to a file of the repository becomes a link to its page, a link into ``references.bib`` a citation, and a block
between two comments (``<!-- gallery -->`` ... ``<!-- end -->``) what the build knows to say there.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

_CODE = re.compile(r"^(?:```|~~~).*?^(?:```|~~~)[^\n]*$|`[^`\n]+`|\$\$.*?\$\$|\$[^$\n]+\$", re.M | re.S)
_CHAPTER = re.compile(r"\b([Cc]hapter )(\d\d)\b")
_LINK = re.compile(r"(?P<image>!?)\[(?P<text>(?:[^\[\]]|\[[^\]]*\]\([^)]*\)|\[[^\]]*\])*)\]\((?P<to>[^()\s]+)\)")
_BLOCK = "<!-- {name} -->.*?<!-- end -->"
_MARK = re.compile(r"<!-- ([a-z-]+(?:: [a-z-]+)?) -->")
_COMMENT = re.compile(r"<!--.*?-->", re.S)


@dataclass
class Links:
    """Rewrites the links of one file of the repository to those of its page.

    Parameters
    ----------
    root
        The project's folder.
    source
        The file of the repository, from ``root``: ``docs/howto/study.md``.
    page
        Its page, from the folder of the pages: ``howto/study.md``.
    pages
        The page of each file of the repository that has one.
    files
        Files without a page, that are copied beside the pages: filled here.
    """

    root: Path
    source: str
    page: str
    pages: Mapping[str, str]
    files: set[str] = field(default_factory=set)

    def rewritten(self, text: str) -> str:
        """The text with its links to pages, citations in place of links to ``references.bib``, and no comments."""
        code: list[str] = []

        def kept(found: re.Match[str]) -> str:
            code.append(found[0])
            return f"\0{len(code) - 1}\0"

        text = self._in_prose(_CODE.sub(kept, text))
        return re.sub(r"\0(\d+)\0", lambda found: code[int(found[1])], text)

    def _in_prose(self, text: str) -> str:
        """Links rewritten; what lies between them gets links of its own where it names a chapter."""
        parts, at = [], 0
        plain = _COMMENT.sub("", text)
        for found in _LINK.finditer(plain):
            parts += [self._with_chapters(plain[at : found.start()]), self._link(found)]
            at = found.end()
        return "".join([*parts, self._with_chapters(plain[at:])])

    def _with_chapters(self, text: str) -> str:
        """Each "chapter 07" as a link to that chapter, but for headings and the chapter's own page."""

        def link(found: re.Match[str]) -> str:
            line_start = text.rfind("\n", 0, found.start()) + 1
            page = next((page for page in self.pages.values() if page.startswith(f"chapters/{found[2]}_")), self.page)
            if page == self.page or text.startswith("#", line_start):
                return found[0]
            return f"[{found[0]}]({self._relative(page)})"

        return _CHAPTER.sub(link, text)

    def _relative(self, page: str) -> str:
        return os.path.relpath(page, PurePosixPath(self.page).parent).replace(os.sep, "/")

    def _link(self, found: re.Match[str]) -> str:
        to, image = found["to"], found["image"]
        inner = found["text"] if image else _LINK.sub(self._link, found["text"])
        if re.match(r"[a-z]+:|#", to):
            return f"{image}[{inner}]({to})"
        path, _, fragment = to.partition("#")
        target = os.path.normpath(PurePosixPath(self.source).parent / path).replace(os.sep, "/")
        page, place = self._page_of(target), self.root / target
        if target.startswith(("..", "/")) or not (place.exists() if page else place.is_file()):
            raise ValueError(f"{self.source}: link to {to!r}: there is no such file")
        if target.endswith("references.bib") and fragment:
            return f"{{cite:t}}`{fragment}`"
        if page is None:
            self.files.add(target)
            page = f"files/{target}"
        return f"{image}[{inner}]({self._relative(page)}{'#' + fragment if fragment else ''})"

    def _page_of(self, target: str) -> str | None:
        """The page of a file or folder; a module without a page of its own has that of its room."""
        path = PurePosixPath(target)
        for candidate in (path, *path.parents) if path.parts[:1] == ("occlib",) else (path,):
            if page := self.pages.get(str(candidate)):
                return page
        return None


def check_blocks(source: str, text: str) -> None:
    """``ValueError`` unless each block of a text is closed before the next begins: what lies between would be lost."""
    marks = _MARK.findall(text)
    for first, last in zip(marks[::2], [*marks[1::2], ""], strict=False):
        if first == "end":
            raise ValueError(f"{source}: expected no <!-- end --> before a block begins")
        if last != "end":
            raise ValueError(f"{source}: expected <!-- end --> behind <!-- {first} -->")


def page_text(text: str, links: Links, blocks: Mapping[str, Callable[[], str]]) -> str:
    """A text of the repository as that of its page, the content of each of its blocks replaced."""
    pattern = re.compile(_BLOCK.format(name="(?!end )([a-z-]+)"), re.S)
    for name in pattern.findall(text):
        if name not in blocks:
            raise ValueError(f"{links.source}: block {name!r}: expected one of {', '.join(blocks) or 'none'}")
    check_blocks(links.source, text)
    parts = pattern.split(text)
    parts[::2] = [links.rewritten(part) for part in parts[::2]]
    parts[1::2] = [blocks[name]() for name in parts[1::2]]
    return "".join(parts)


def title_of(text: str) -> str:
    """The first heading of a Markdown text.

    >>> title_of("# A title\\n\\ntext")
    'A title'
    """
    return next((line.lstrip("# ").strip() for line in text.splitlines() if line.startswith("# ")), "")
