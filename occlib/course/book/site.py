"""Whether a built site holds together: each link, anchor and picture resolves, and nothing is fetched from a host."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_FETCHED = {
    "script": ("src",),
    "link": ("href",),
    "img": ("src", "srcset"),
    "iframe": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
    "audio": ("src",),
    "object": ("data",),
    "embed": ("src",),
    "image": ("href", "xlink:href"),
}
"""What a browser loads by itself, and the attributes that say from where."""

_IN_STYLE = re.compile(r"url\(\s*['\"]?([^'\")]+)['\"]?\s*\)|@import\s+['\"]([^'\"]+)['\"]")
_IDLE_RELATIONS = {"canonical", "author", "license", "next", "prev", "search", "index", "copyright"}


@dataclass
class _Page(HTMLParser):
    """Anchors of a page, its links, and what it loads."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    in_style: bool = False

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        own = {name: value or "" for name, value in attributes}
        self.anchors |= {own[name] for name in ("id", "name") if own.get(name)}
        self.in_style = tag == "style"
        self.loaded += _in_style(own.get("style", ""))
        if tag == "a" and "href" in own:
            self.links.append(own["href"])
        relations = set(own.get("rel", "").split())
        if tag == "link" and relations and relations <= _IDLE_RELATIONS:
            self.links.append(own.get("href", ""))
            return
        for name in _FETCHED.get(tag, ()):
            if own.get(name):
                self.loaded += re.findall(r"(?:^|,)\s*([^\s,]\S*)", own[name]) if name == "srcset" else [own[name]]

    def handle_endtag(self, tag: str) -> None:
        self.in_style = self.in_style and tag != "style"

    def handle_data(self, data: str) -> None:
        if self.in_style:
            self.loaded += _in_style(data)


def check_site(folder: str | Path) -> list[str]:
    """What is wrong with the pages and style sheets below a folder, a line each; empty where all is well.

    A link must lead to a file that is there and to an anchor that the file has; what a page loads by itself (scripts,
    styles, fonts, pictures, frames) must be a file, too: a book is read without the network. Links to other sites,
    which a reader follows or not, are not followed here.
    """
    root = Path(folder).resolve()
    pages = {path: _read(path) for path in sorted(root.rglob("*.html")) if "_static" not in path.parts}
    if not pages:
        return [f"{folder}: no pages"]
    problems = []
    for path, page in pages.items():
        name = path.relative_to(root).as_posix()
        problems += [f"{name}: link {link!r}: {wrong}" for link in page.links if (wrong := _wrong(link, path, pages))]
        problems += [f"{name}: loads {link!r}: {wrong}" for link in page.loaded if (wrong := _unloadable(link, path))]
    for path in sorted(root.rglob("*.css")):
        name = path.relative_to(root).as_posix()
        text = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8", errors="replace"), flags=re.S)
        problems += [f"{name}: loads {to!r}: {wrong}" for to in _in_style(text) if (wrong := _unloadable(to, path))]
    return list(dict.fromkeys(problems))


def _read(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def _in_style(text: str) -> list[str]:
    return [first or second for first, second in _IN_STYLE.findall(text)]


def _wrong(link: str, path: Path, pages: dict[Path, _Page]) -> str:
    """Why a link of a page leads nowhere; empty where it leads somewhere, or out of the site."""
    try:
        parts = urlsplit(link)
    except ValueError:
        return "no address"
    if parts.scheme or parts.netloc:
        return "" if parts.scheme in ("http", "https", "mailto") else f"a link to {parts.scheme}:"
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.is_file():
        return "no such file"
    anchor = unquote(parts.fragment)
    if anchor and target in pages and anchor not in pages[target].anchors:
        return "no such anchor"
    return ""


def _unloadable(link: str, path: Path) -> str:
    """Why a page cannot load something without the network; empty where it can."""
    parts = urlsplit(link)
    if parts.scheme in ("data", "blob") or link.startswith(("about:", "#")):
        return ""
    if parts.scheme or parts.netloc:
        return "from a host"
    return "" if (path.parent / unquote(parts.path)).resolve().is_file() else "no such file"
