"""The book: the executed notebooks and the texts of ``docs/`` as pages that need no network and no server.

:func:`build_pages` prepares the sources, :func:`build_book` lets Sphinx make the pages and checks them. The notebooks
are taken as ``occlib reproduce`` left them in ``runs/``; nothing is executed here.
"""

from __future__ import annotations

import html
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from occlib.base import check_extra, load_json, write_file
from occlib.base.files import read_text
from occlib.course.book import reference
from occlib.course.book.chapters import chapter_page, figures_not_shown
from occlib.course.book.gallery import Figure, figures_of, gallery, thumbnail
from occlib.course.book.pages import Links, page_text, title_of
from occlib.course.book.schemas import schema_tables
from occlib.course.book.site import check_site
from occlib.course.explorable import standalone_page
from occlib.reproduce import Run, find_root, is_current, plan_runs, read_notebook

PARTS = {
    "See": ("00",),
    "The stages": ("01", "02", "03", "04", "05", "06", "07"),
    "The map at work": ("08", "09"),
    "Where it fails, and more": ("10", "11", "12"),
    "Judgement": ("13",),
}
"""Chapters of each part of the book, by their numbers."""

SECTIONS = {
    "Move it": ("explorable",),
    "Do it yourself": (
        *("howto/own-cameras", "howto/own-matcher", "howto/map-on-the-air", "howto/study", "howto/formats"),
        "howto/command-line",
    ),
    "Teach it": ("teaching",),
    "Look it up": (
        *("ledger", "results", "rooms", "gallery", "architecture", "api", "glossary", "bibliography"),
        *("environment", "lab", "contributing", "changelog"),
    ),
}
"""Pages after the chapters, in order; one whose source is not there is left out."""

OUTSIDE = {
    "environment.md": "environment.md",
    "data/lab/README.md": "lab.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Texts that are not in ``docs/``, and their pages."""


ROOM = "explorable/room.html"
"""The explorable on a page of its own."""

DOORS = """\
::::{grid} 1 2 2 2
:gutter: 3

:::{grid-item-card} Learn
:link: chapters/00_see_around_the_occluder
:link-type: doc

The whole chain in ten steps; then one chapter a stage, with exercises that answer back.
:::

:::{grid-item-card} Reproduce
:link: gallery
:link-type: doc

Every figure, with the cell that makes it. The verdicts are in the ledger, the numbers in the results.
:::

:::{grid-item-card} Compare
:link: howto/study
:link-type: doc

Which measure of similarity, when? Bring one of your own and read its row.
:::

:::{grid-item-card} Use it
:link: howto/own-cameras
:link-type: doc

Two cameras of your own, the map on the air, robots that drive by it.
:::

:::{grid-item-card} Move it
:link: explorable
:link-type: doc

A room with cameras and objects to drag: shadows, ghosts and blind cells follow.
:::

:::{grid-item-card} Teach it
:link: teaching
:link-type: doc

One lesson, three, or a term: which sections, how long, what to skip.
:::
::::
"""
"""The doors of the landing page; in the repository they are a table."""


def build_pages(out: str | Path, root: str | Path | None = None) -> list[Path]:
    """Write the sources of the book to a folder: pages, chapters, thumbnails and the files that they link to.

    Files that did not change are left alone, and those of an earlier build that are no longer needed are removed.

    Parameters
    ----------
    out
        The folder, usually ``docs/_build/pages``.
    root
        The project's folder; found by itself if ``None``.

    Returns
    -------
    The files of the folder.

    Raises
    ------
    ValueError
        In one line, if a chapter was not run, its run is stale or does not show a figure that it makes, or if a text
        links to a file that is not there.
    """
    home = Path(root or find_root())
    return write_sources(Path(out), home, finished_runs(home))


def build_book(root: str | Path | None = None) -> Path:
    """Build the book into ``docs/_build/html``, and print what is done; the folder.

    Raises
    ------
    ValueError
        As :func:`build_pages`; also for a warning of Sphinx, and for a link, an anchor or a picture that leads nowhere.
    """
    home = Path(root or find_root())
    return make_html(home, finished_runs(home))


def finished_runs(home: Path, *, allow_stale: bool = False) -> list[Run]:
    """The runs of all notebooks with their own parameters; ``ValueError`` where one is missing, stale or hides a figure."""
    runs = plan_runs(home, None, {})
    missing = [run for run in runs if not _executed(run).exists()]
    stale = [run for run in runs if run not in missing and not is_current(run)]
    for word, wrong in (("not run", missing), ("stale", [] if allow_stale else stale)):
        if wrong:
            numbers = ", ".join(run.notebook[:2] for run in wrong)
            raise ValueError(f"chapter{'s' if len(wrong) > 1 else ''} {numbers}: {word}: first `make reproduce`")
    for run in [] if allow_stale else runs:
        if hidden := figures_not_shown(read_notebook(_executed(run))):
            raise ValueError(f"chapter {run.notebook[:2]}: figure {hidden[0]} is made and not shown")
    return runs


def make_html(home: Path, runs: Sequence[Run]) -> Path:
    """Pages, Sphinx and the check of what came out."""
    check_extra("sphinx", "book")
    started = time.monotonic()
    build = home / "docs/_build"
    pages, site = build / "pages", build / "html"
    print(f"{len(write_sources(pages, home, runs))} sources in {pages.relative_to(home)}", flush=True)
    for folder in (site, build / "doctrees"):  # nothing of an earlier build stays
        shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", "-j", "2"]
    command += ["-c", str(home / "docs"), "-d", str(build / "doctrees"), str(pages), str(site)]
    if subprocess.run(command, cwd=home, env=os.environ | {"PYTHONHASHSEED": "0"}).returncode:
        raise ValueError("the book: Sphinx found the faults above")
    problems = check_site(site)
    if problems:
        print("\n".join(problems), file=sys.stderr)
        raise ValueError(f"the book: {len(problems)} links or files that lead nowhere, see above")
    megabytes = sum(path.stat().st_size for path in site.rglob("*") if path.is_file()) / 1e6
    count = len(list(site.rglob("*.html")))
    print(f"{count} pages, {megabytes:.0f} MB, every link leads somewhere; {time.monotonic() - started:.0f} s")
    return site


def write_sources(out: Path, home: Path, runs: Sequence[Run]) -> list[Path]:
    """Write the pages, and remove what an earlier build left."""
    written = _sources(home, runs)
    for name, content in written.items():
        data = content if isinstance(content, bytes) else content.encode()
        target = out / name
        if not target.exists() or target.read_bytes() != data:
            write_file(target, data)
    for path in sorted(out.rglob("*")):
        if path.is_file() and path.relative_to(out).as_posix() not in written:
            path.unlink()
    return [out / name for name in written]


def _sources(home: Path, runs: Sequence[Run]) -> dict[str, bytes | str]:
    """Content of each file of the folder of pages."""
    rooms = reference.rooms() if (home / "occlib").is_dir() else []
    texts, pages, files = _texts(home), _pages(home, runs, rooms), set[str]()
    content: dict[str, bytes | str] = {}
    figures: dict[str, list[Figure]] = {}
    titles: dict[str, str] = {}
    for run in runs:
        notebook, page = read_notebook(_executed(run)), f"chapters/{run.notebook}.ipynb"
        links = Links(home, f"notebooks/{run.notebook}.ipynb", page, pages, files)
        content[page] = json.dumps(chapter_page(notebook, links), indent=1, ensure_ascii=False)
        titles[run.notebook] = title_of("".join(notebook["cells"][0]["source"])) or run.notebook
        figures[titles[run.notebook]] = figures_of(notebook, run.notebook, home / "figures", run.folder)
    for own in figures.values():
        content |= {f"_extra/_thumbnails/{figure.name}.jpg": thumbnail(figure.picture) for figure in own}
    blocks = _blocks(home, figures, titles, rooms)
    for source, page in texts.items():
        links = Links(home, source, page, pages, files)
        content[page] = page_text(read_text(home / source), links, blocks)
    content |= {f"api/{room}.rst": reference.room_page(room) for room in rooms}
    content["index.md"] = str(content["index.md"]) + _contents(titles, set(content))
    content[f"_extra/{ROOM}"] = standalone_page()
    return content | {f"files/{name}": (home / name).read_bytes() for name in sorted(files)}


def _pages(home: Path, runs: Sequence[Run], rooms: Sequence[str]) -> dict[str, str]:
    """The page of each file and folder of the repository that has one."""
    pages = _texts(home) | {f"notebooks/{run.notebook}.ipynb": f"chapters/{run.notebook}.ipynb" for run in runs}
    pages |= {f"occlib/{room}{end}": f"api/{room}.rst" for room in rooms for end in ("", ".py")}
    folders = {"docs": "index.md", "notebooks": "index.md", "README.md": "index.md", "figures": "gallery.md"}
    folders |= {"occlib": "api.md", "occlib/cli": "howto/command-line.md", "docs/schemas": "howto/formats.md"}
    return pages | folders


def _texts(home: Path) -> dict[str, str]:
    """The page of each Markdown text of the repository."""
    docs = home / "docs"
    own = [path for path in sorted(docs.rglob("*.md")) if "_build" not in path.parts]
    texts = {path.relative_to(home).as_posix(): path.relative_to(docs).as_posix() for path in own}
    return texts | {source: page for source, page in OUTSIDE.items() if (home / source).exists()}


def _executed(run: Run) -> Path:
    return run.folder / f"{run.notebook}.ipynb"


def _blocks(
    home: Path, figures: dict[str, list[Figure]], titles: dict[str, str], rooms: Sequence[str]
) -> dict[str, Callable[[], str]]:
    """What stands in the blocks of the texts; made where a text asks for it."""
    schemas = sorted((home / "docs/schemas").glob("*.json"))
    return {
        "bibliography": lambda: "```{bibliography}\n:all:\n```",
        "chapters": lambda: _chapter_list(titles),
        "commands": _commands,
        "doors": lambda: DOORS,
        "explorable": _explorable_frame,
        "gallery": lambda: gallery(figures),
        "rooms": lambda: reference.overview() + _toctree("", [f"api/{room}" for room in rooms]),
        "schemas": lambda: "\n".join(schema_tables(path.stem, load_json(path)) for path in schemas),
    }


def _chapter_list(titles: dict[str, str]) -> str:
    """The chapters in their parts, as a list of links."""
    lines = []
    for part, numbers in PARTS.items():
        own = [f"[{titles[name]}](chapters/{name}.ipynb)" for name in titles if name[:2] in numbers]
        lines += [f"- **{part}**: {'; '.join(own)}"] if own else []
    return "\n".join(lines)


def _contents(titles: dict[str, str], there: set[str]) -> str:
    """The tables of contents that the side bar shows."""
    trees = {part: [f"chapters/{name}" for name in titles if name[:2] in own] for part, own in PARTS.items()}
    trees |= {section: [page for page in own if f"{page}.md" in there] for section, own in SECTIONS.items()}
    return "".join(_toctree(caption, pages) for caption, pages in trees.items() if pages)


def _toctree(caption: str, pages: Sequence[str]) -> str:
    title = f":caption: {caption}\n" if caption else ""
    return "\n\n```{toctree}\n:hidden:\n" + title + "\n" + "\n".join(pages) + "\n```\n"


_HELP = """
import argparse, json
from occlib.cli import build_parser
parser = build_parser()
(commands,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
texts = {name: command.format_help() for name, command in commands.choices.items()}
print(json.dumps({"": parser.format_help(), **texts}))
"""
"""What the commands say of themselves; they are above this wing, which does not import them."""


def _commands() -> str:
    """What each command says of itself with ``--help``."""
    environment = os.environ | {"COLUMNS": "88", "NO_COLOR": "1"}
    answer = subprocess.run([sys.executable, "-c", _HELP], env=environment, capture_output=True, text=True, check=True)
    texts = json.loads(answer.stdout).items()
    return "\n\n".join(f"### occlib {name}".rstrip() + f"\n\n```text\n{text.strip()}\n```" for name, text in texts)


def _explorable_frame() -> str:
    """A link to the explorable alone, and the frame that shows it in its page.

    The page stands in the frame's ``srcdoc``: of a file in a frame, a browser would let it neither grow nor turn dark.
    """
    title = "A room with cameras and objects to move"
    frame = f'<iframe class="explorable" title="{title}" srcdoc="{html.escape(standalone_page())}"></iframe>'
    return f'````````{{raw}} html\n<p><a href="{ROOM}">Open it alone, on the whole window</a></p>\n{frame}\n````````'


def main() -> None:
    """``make book``."""
    try:
        build_book()
    except ValueError as error:
        sys.exit(f"book: {error}")
