"""The sources of the book, made from a project of one chapter; the links of a site."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlib.base import encode_image, file_hashes
from occlib.course.book.build import PARTS, SECTIONS, build_pages, finished_runs, write_sources
from occlib.course.book.chapters import NOT_RUN, chapter_page, figure_of, figures_not_shown
from occlib.course.book.house import house_svg
from occlib.course.book.pages import Links, page_text
from occlib.course.book.reference import public_names, room_page, rooms
from occlib.course.book.schemas import schema_tables
from occlib.course.book.site import check_site
from occlib.formats import SCHEMAS, json_schema
from occlib.reproduce import plan_runs

ROOT = Path(__file__).resolve().parents[2]
WIDGET = "application/vnd.jupyter.widget-view+json"


def code(source: str, *tags: str, outputs: Any = ()) -> dict[str, Any]:
    return {
        "cell_type": "code",
        "execution_count": 1,
        "metadata": {"tags": list(tags), "papermill": {"duration": 1.5}},
        "outputs": list(outputs),
        "source": source.splitlines(keepends=True),
    }


def prose(source: str, *tags: str) -> dict[str, Any]:
    return {"cell_type": "markdown", "metadata": {"tags": list(tags)}, "source": source.splitlines(keepends=True)}


def shows(**data: str) -> dict[str, Any]:
    named = {kind.replace("_", "/"): value for kind, value in data.items()}
    return {"output_type": "display_data", "metadata": {}, "data": named}


PRINTED = {"output_type": "stream", "name": "stdout", "text": "ten"}
WARNED = {"output_type": "stream", "name": "stderr", "text": "a warning"}

CELLS = [
    prose("# 00. See\n\nSee chapter 00, [the page](../docs/a.md#part) and [data](../data/x.csv), 2.8<!--00/x--> m."),
    code("from occlib import reproduce\nreproduce.show_versions()", outputs=[PRINTED, WARNED]),
    code("seed = 0  # start\nfast = False  # less", "parameters"),
    code("seed = 1", "injected-parameters"),
    code("levels = 3", "fast"),
    code('# Figure: a lamp\n# and its shadow\nreproduce.save(fig, "nb00_lamps")', outputs=[shows(image_png="aGk=")]),
    code('reproduce.record("x", 2.8)', "bookkeeping"),
    code("interact(draw)", "slider", outputs=[shows(**{WIDGET.replace("/", "_", 1): "{}", "text_plain": "x"})]),
    code("explore()", outputs=[{**shows(text_html="<p>room</p>"), "data": {WIDGET: "{}", "text/html": "<p>room</p>"}}]),
    prose("**00.1** (one line) How many?", "exercise"),
    code("answer_1 = 2", "solution"),
    prose("Because of *two*.", "solution"),
    code('course.check("00.1", answer_1)', "check", outputs=[PRINTED]),
]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with one chapter, run, and two texts."""
    notebook = {"cells": CELLS, "metadata": {"widgets": {"state": {}}}, "nbformat": 4, "nbformat_minor": 5}
    for path, text in {
        "notebooks/00_see.ipynb": json.dumps(notebook),
        "docs/index.md": "# Home\n\n<!-- chapters -->\nin the folder\n<!-- end -->\n",
        "docs/a.md": "# A\n\n## Part\n\n[chapter](../notebooks/00_see.ipynb), chapter 00, [home](index.md), [`x`](../data/x.csv)\n",
        "docs/gallery.md": "# Gallery\n\n<!-- gallery --><!-- end -->\n",
        "docs/references.bib": "@book{me,title={T}}",
        "data/x.csv": "1\n",
    }.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text, encoding="utf-8")
    (run,) = plan_runs(tmp_path, None, {})
    run.folder.mkdir(parents=True)
    (run.folder / "00_see.ipynb").write_text(json.dumps(notebook), encoding="utf-8")
    (run.folder / "nb00_lamps.png").write_bytes(encode_image(".png", np.full((90, 200, 3), 200, np.uint8)))
    manifest = {"inputs": run.inputs, "seconds": 1.0, "files": file_hashes(run.folder), "metrics": []}
    (run.folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    return tmp_path


def page(project: Path) -> list[dict[str, Any]]:
    build_pages(project / "pages", project)
    return list(json.loads((project / "pages/chapters/00_see.ipynb").read_text(encoding="utf-8"))["cells"])


def test_a_chapter_shows_the_lesson_and_folds_the_rest(project: Path) -> None:
    cells = page(project)
    texts = [cell["source"] for cell in cells]
    for left_out in ("seed = 1", "levels = 3", "record("):
        assert not any(left_out in text for text in texts), left_out
    by_text = {cell["source"].split("\n")[0]: cell["metadata"] for cell in cells if cell["cell_type"] == "code"}
    assert by_text["from occlib import reproduce"]["tags"] == ["hide-input"]
    assert by_text["seed = 0  # start"]["tags"] == ["hide-input"]
    assert by_text["answer_1 = 2"]["tags"] == ["hide-cell"]
    assert by_text["answer_1 = 2"]["mystnb"]["code_prompt_show"] == "Show the solution"
    assert by_text['course.check("00.1", answer_1)']["tags"] == ["hide-cell"]
    assert any("{dropdown}" in text and "Because of *two*." in text for text in texts)
    assert by_text["# Figure: a lamp"]["mystnb"]["image"]["alt"] == "Figure: a lamp and its shadow"
    assert texts[texts.index(next(t for t in texts if "nb00_lamps" in t)) - 1] == "(figure-nb00-lamps)=\n"


def test_a_chapter_has_no_widget_no_warning_and_nothing_of_papermill(project: Path) -> None:
    build_pages(project / "pages", project)
    text = (project / "pages/chapters/00_see.ipynb").read_text(encoding="utf-8")
    for absent in ("widget", "a warning", "papermill", "<!--"):
        assert absent not in text, absent
    assert "<p>room</p>" in text and "JupyterLab this cell shows a slider" in text


def test_links_lead_to_pages_and_files(project: Path) -> None:
    first = page(project)[0]["source"]
    assert "[the page](../a.md#part)" in first and "[data](../files/data/x.csv)" in first
    assert "See chapter 00," in first  # not to itself
    text = (project / "pages/a.md").read_text(encoding="utf-8")
    assert "[chapter](chapters/00_see.ipynb), [chapter 00](chapters/00_see.ipynb), [home](index.md)" in text
    assert "[`x`](files/data/x.csv)" in text
    assert (project / "pages/files/data/x.csv").read_text() == "1\n"


def test_the_gallery_links_each_figure_to_its_cell(project: Path) -> None:
    page(project)
    text = (project / "pages/gallery.md").read_text(encoding="utf-8")
    assert 'href="chapters/00_see.html#figure-nb00-lamps"' in text and "A lamp and its shadow" in text
    assert (project / "pages/_extra/_thumbnails/nb00_lamps.jpg").stat().st_size > 100


def test_the_landing_page_has_the_chapters_in_their_parts(project: Path) -> None:
    page(project)
    text = (project / "pages/index.md").read_text(encoding="utf-8")
    assert "- **See**: [00. See](chapters/00_see.ipynb)" in text and "in the folder" not in text
    assert ":caption: See\n\nchapters/00_see\n" in text


def test_building_twice_changes_nothing_and_clears_what_is_old(project: Path) -> None:
    written = build_pages(project / "pages", project)
    before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in written}
    (project / "pages/old.md").write_text("old")
    assert build_pages(project / "pages", project) == written
    assert {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in written} == before
    assert not (project / "pages/old.md").exists()


def test_a_chapter_that_was_not_run_or_is_stale_is_an_error(project: Path) -> None:
    notebook = project / "notebooks/00_see.ipynb"
    notebook.write_text(notebook.read_text(encoding="utf-8") + " ", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^chapter 00: stale: first `make reproduce`$"):
        build_pages(project / "pages", project)
    assert write_sources(project / "pages", project, finished_runs(project, allow_stale=True))
    (project / "notebooks/01_more.ipynb").write_text(notebook.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"^chapter 01: not run: first `make reproduce`$"):
        build_pages(project / "pages", project)


def test_a_link_to_nothing_is_an_error(project: Path) -> None:
    (project / "docs/a.md").write_text("# A\n\n[b](../b.py)\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^docs/a\.md: link to '\.\./b\.py': there is no such file$"):
        build_pages(project / "pages", project)


@pytest.mark.parametrize("to", ["..", "../data", "{home}/data/x.csv"])
def test_a_link_to_a_folder_without_a_page_or_to_this_machine_is_an_error(project: Path, to: str) -> None:
    to = to.format(home=project)
    (project / "docs/a.md").write_text(f"# A\n\n[b]({to})\n", encoding="utf-8")
    with pytest.raises(ValueError, match=rf"^docs/a\.md: link to '{re.escape(to)}': there is no such file$"):
        build_pages(project / "pages", project)


def test_an_unknown_block_is_an_error(project: Path) -> None:
    links = Links(project, "docs/a.md", "a.md", {})
    with pytest.raises(ValueError, match=r"docs/a\.md: block 'other': expected one of it"):
        page_text("<!-- other -->x<!-- end -->", links, {"it": lambda: "y"})
    for text in ("<!-- it -->x", "<!-- it -->x and prose <!-- it -->y<!-- end -->"):
        with pytest.raises(ValueError, match=r"^docs/a\.md: expected <!-- end --> behind <!-- it -->$"):
            page_text(text, links, {"it": lambda: "y"})
    assert page_text("a <!-- it -->x<!-- end --> b<!--00/x-->", links, {"it": lambda: "y"}) == "a y b"


def test_a_citation_takes_the_place_of_a_link_into_the_bibliography(project: Path) -> None:
    text = "see [Me (2000)](references.bib#me) and `[Me](references.bib#me)`"
    links = Links(project, "docs/a.md", "a.md", {})
    assert links.rewritten(text) == "see {cite:t}`me` and `[Me](references.bib#me)`"


def test_the_notebook_is_not_changed(project: Path) -> None:
    before = json.dumps(CELLS)
    chapter_page(
        {"cells": CELLS}, Links(project, "notebooks/00_see.ipynb", "chapters/00_see.ipynb", {"docs/a.md": "a.md"})
    )
    assert json.dumps(CELLS) == before


def test_the_figure_of_a_cell() -> None:
    assert figure_of(code('fig = draw()\nsave(fig, "fig07")')) == ("fig07", "Figure: fig07")
    assert figure_of(code("print(1)")) is None and figure_of(prose('save(fig, "x")')) is None


def test_a_figure_that_is_made_and_not_shown_is_an_error(project: Path) -> None:
    cells = [*CELLS[:5], {**CELLS[5], "outputs": [PRINTED, shows(text_plain="<Figure>")]}, *CELLS[6:]]
    (run,) = plan_runs(project, None, {})
    executed = {"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}
    (run.folder / "00_see.ipynb").write_text(json.dumps(executed), encoding="utf-8")
    manifest = json.loads((run.folder / "manifest.json").read_text(encoding="utf-8"))
    manifest["files"] = {k: v for k, v in file_hashes(run.folder).items() if k != "manifest.json"}
    (run.folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(ValueError, match=r"^chapter 00: figure nb00_lamps is made and not shown$"):
        build_pages(project / "pages", project)


def test_pictures_and_films_are_shown_and_what_is_held_back_is_told() -> None:
    missing = {"output_type": "stream", "name": "stdout", "text": ["room: not fetched yet; first: fetch it"]}
    save = 'reproduce.save(fig, "nb00_{}")'
    cells = [
        code(save.format("a"), outputs=[shows(image_png="aGk=")]),
        code(save.format("b"), outputs=[shows(text_html='<img src="data:image/webp;base64,aGk=">')]),
        code("footage = reproduce.open_or_stop(name)", outputs=[missing]),
        code(save.format("c")),
        code("reproduce.resume()"),
        code(save.format("d")),
    ]
    assert figures_not_shown({"cells": cells}) == ["nb00_d"]
    links = Links(ROOT, "notebooks/00_see.ipynb", "chapters/00_see.ipynb", {})
    texts = [cell["source"] for cell in chapter_page({"cells": cells}, links)["cells"]]
    assert texts.count(NOT_RUN) == 1 and texts[texts.index(NOT_RUN) - 1] == save.format("c")


def test_a_picture_is_as_wide_as_its_cell_says(project: Path) -> None:
    output = {**shows(image_png="aGk="), "metadata": {"image/png": {"width": 480}}}
    links = Links(project, "notebooks/00_see.ipynb", "chapters/00_see.ipynb", {})
    (cell,) = chapter_page({"cells": [code("draw()", outputs=[output])]}, links)["cells"]
    assert cell["metadata"]["mystnb"]["image"]["width"] == "480px"


def test_every_number_of_a_chapter_is_in_one_part() -> None:
    numbers = [number for own in PARTS.values() for number in own]
    assert numbers == [f"{n:02}" for n in range(14)]
    pages = [page for own in SECTIONS.values() for page in own]
    assert len(pages) == len(set(pages))


def test_every_text_of_the_project_is_in_the_contents() -> None:
    texts = {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    texts = {text for text in texts if not text.startswith("_build")} - {"index"}
    assert texts <= {page for own in SECTIONS.values() for page in own}


# --- reference, formats, drawing ------------------------------------------------------------------------------
def test_every_public_name_has_a_place_in_the_reference() -> None:
    import importlib

    pages = {room: room_page(room) for room in rooms()}
    for room in rooms():
        for name in public_names(importlib.import_module(f"occlib.{room}")):
            assert any(f" occlib.{other}.{name}\n" in f"{text}\n" for other, text in pages.items()), (room, name)


def test_schemas_become_tables() -> None:
    text = schema_tables("objects", json_schema("objects"))
    assert "| `frame` | a whole number |  | required |" in text
    assert "| `x` | finite metres | Where it stands, m. | required |" in text
    for name in SCHEMAS:
        assert schema_tables(name, json_schema(name)).startswith(f"### {name}.json\n")


def test_the_house_is_drawn_from_the_roof_down() -> None:
    text = house_svg([["cli"], ["calibration", "matching"], ["base"]])
    assert text.index(">cli<") < text.index(">matching<") < text.index(">base<")
    assert text.count("#d6e8f5") == 2


# --- the check of the built site ------------------------------------------------------------------------------
def site(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        (folder / name.replace("_", ".")).write_text(text, encoding="utf-8")
    return folder


def test_a_whole_site_has_no_problem(tmp_path: Path) -> None:
    text = (
        '<html><a href="b.html#x">b</a><a href="#top">t</a><p id="top"><a href="https://example.org/">e</a>'
        '<img src="data:image/png;base64,aGk="><img src="p.png"><link rel="stylesheet" href="s.css?v=1">'
    )
    files = {
        "a_html": text,
        "b_html": '<p id="x">',
        "p_png": "",
        "s_css": "body { background: url(p.png) } /* url(q) */",
    }
    assert check_site(site(tmp_path, **files)) == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('<a href="c.html">', "a.html: link 'c.html': no such file"),
        ('<a href="a.html#y">', "a.html: link 'a.html#y': no such anchor"),
        ('<a href="#y">', "a.html: link '#y': no such anchor"),
        ('<a href="file:///tmp/x">', "a.html: link 'file:///tmp/x': a link to file:"),
        ('<img srcset="a.html 1x, q.png 2x, ">', "a.html: loads 'q.png': no such file"),
        ('<a href="http://[x">', "a.html: link 'http://[x': no address"),
        ('<img src="q.png">', "a.html: loads 'q.png': no such file"),
        ('<img src="https://example.org/q.png">', "a.html: loads 'https://example.org/q.png': from a host"),
        ('<script src="//example.org/q.js"></script>', "a.html: loads '//example.org/q.js': from a host"),
        (
            '<link rel="stylesheet" href="http://example.org/q.css">',
            "a.html: loads 'http://example.org/q.css': from a host",
        ),
        ("<style>@import 'http://example.org/q.css';</style>", "a.html: loads 'http://example.org/q.css': from a host"),
        ('<p style="background: url(q.png)">', "a.html: loads 'q.png': no such file"),
    ],
)
def test_a_fault_of_a_site_is_told(tmp_path: Path, text: str, problem: str) -> None:
    assert check_site(site(tmp_path, a_html=text)) == [problem]


def test_a_font_from_a_host_is_told(tmp_path: Path) -> None:
    faults = check_site(site(tmp_path, a_html="<p>", s_css="@font-face { src: url('https://example.org/f.woff2') }"))
    assert faults == ["s.css: loads 'https://example.org/f.woff2': from a host"]


def test_an_empty_site_is_told(tmp_path: Path) -> None:
    assert check_site(tmp_path) == [f"{tmp_path}: no pages"]
