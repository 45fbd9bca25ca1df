"""The book in a real browser, from ``file://`` and without the network. Needs ``make book``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

HTML = Path(__file__).resolve().parents[2] / "docs/_build/html"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (HTML / "index.html").exists(), reason="needs the book: make book"),
]

PAGES = (
    *("index", "gallery", "results", "architecture", "teaching", "glossary", "bibliography", "explorable", "api"),
    *("howto/own-cameras", "howto/formats", "howto/command-line", "api/matching", "api/geometry"),
    *("chapters/00_see_around_the_occluder", "chapters/04_compare_matchers", "chapters/07_resolve_occlusion"),
)
SCREEN_READ = PAGES[:4] + PAGES[6:8] + PAGES[9:10] + PAGES[12:13] + PAGES[14:15] + PAGES[16:]
"""Ten pages, of each kind one."""

SIDEWAYS = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
BROKEN = """
() => [...document.images].filter(image => image.complete && image.naturalWidth === 0).map(image => image.src)
"""


def address(name: str) -> str:
    return (HTML / f"{name}.html").as_uri()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_whole_without_the_network(page: Any, refused: list[str], name: str) -> None:
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("requestfailed", lambda request: faults.append(request.url))
    page.goto(address(name))
    page.wait_for_load_state("load")
    assert page.locator(".bd-article h1").count() == 1
    assert page.evaluate(BROKEN) == []
    assert (faults, refused) == ([], [])


def test_mathematics_is_drawn(page: Any, refused: list[str]) -> None:
    page.goto(address("chapters/07_resolve_occlusion"))
    page.wait_for_selector("mjx-container svg", state="attached")
    page.wait_for_function("MathJax.startup.promise.then(() => true)")
    left = page.evaluate(
        "[...document.querySelectorAll('.math')].filter(e => !e.querySelector('mjx-container')).length"
    )
    assert left == 0 and page.locator("mjx-merror, merror").count() == 0
    assert refused == []


def test_search_finds_a_chapter(page: Any, refused: list[str]) -> None:
    page.goto(address("search") + "?q=falsified+occupancy")
    page.wait_for_selector("ul.search li a")
    found = page.locator("ul.search li a").evaluate_all("links => links.map(link => link.getAttribute('href'))")
    assert any("glossary" in link for link in found) and any("chapters/" in link for link in found)
    assert refused == []


def test_a_thumbnail_leads_to_the_cell_that_makes_it(page: Any) -> None:
    page.goto(address("gallery"))
    page.locator('a.thumbnail-link[href*="fig11"]').click()
    page.wait_for_url("**/07_resolve_occlusion.html#figure-fig11*")
    top = page.evaluate("document.querySelector(decodeURIComponent(location.hash)).getBoundingClientRect().top")
    assert -50 <= top <= 400


def test_a_solution_is_closed_until_it_is_asked_for(page: Any) -> None:
    page.goto(address("chapters/07_resolve_occlusion"))
    solution = page.locator("details", has_text="Show the solution").first
    assert solution.get_attribute("open") is None
    solution.locator("summary").click()
    solution.locator("pre").first.wait_for(state="visible")


@pytest.mark.parametrize("name", PAGES)
def test_a_narrow_screen_does_not_scroll_sideways(page: Any, name: str) -> None:
    page.set_viewport_size({"width": 400, "height": 800})
    page.goto(address(name))
    page.wait_for_load_state("load")
    assert page.evaluate(SIDEWAYS) == 0
    assert page.evaluate("parseFloat(getComputedStyle(document.querySelector('.bd-article p')).fontSize)") >= 14


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", SCREEN_READ)
def test_axe_finds_no_serious_fault(page: Any, name: str, scheme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs the extra browser")
    page.emulate_media(color_scheme=scheme)
    page.goto(address(name))
    page.wait_for_load_state("load")
    if name.startswith("chapters/"):
        page.wait_for_function("MathJax.startup.promise.then(() => true)")
    assert page.locator("html").get_attribute("data-theme") == scheme
    faults = axe.Axe().run(page).response["violations"]
    assert [
        (fault["id"], fault["nodes"][0]["target"]) for fault in faults if fault["impact"] in ("serious", "critical")
    ] == []
