"""A real browser for what readers see: Chromium with a fresh profile, and no way out but files and this machine.

The tests run with ``make test-browser``; `pytest` alone leaves the folder out (see ``tests/conftest.py``).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlparse

import pytest

pytestmark = pytest.mark.browser
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "/tests/browser/" in item.path.as_posix():
            item.add_marker(pytest.mark.browser)


def chromium() -> str:
    """Chromium's path; the run stops in one line where there is none."""
    found = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if not found or not os.access(found, os.X_OK):
        pytest.exit("the browser tests need Chromium: apt-get install chromium, or CHROMIUM=/path/to/chromium", 4)
    return found


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, started once."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        yield started
        started.close()


@pytest.fixture
def refused() -> list[str]:
    """The addresses that a page asked for in vain: all but files and this machine."""
    return []


@pytest.fixture
def new_page(browser: Any, refused: list[str]) -> Iterator[Any]:
    """``new_page(width=1200, ...)``: a page in a profile of its own; faults on it fail the test."""
    contexts, faults = [], []

    def guard(route: Any) -> None:
        address = urlparse(route.request.url)
        if address.scheme in ("file", "data", "blob", "about") or address.hostname in ("127.0.0.1", "localhost"):
            route.continue_()
        else:
            refused.append(route.request.url)
            route.abort()

    def make(width: int = 1200, height: int = 900, **options: Any) -> Any:
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        context.route("**/*", guard)
        page = context.new_page()
        page.on("pageerror", lambda error: faults.append(str(error)))
        return page

    yield make
    for context in contexts:
        context.close()
    assert not faults


@pytest.fixture
def page(new_page: Any) -> Any:
    """A page 1200 px wide."""
    return new_page()
