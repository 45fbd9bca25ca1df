"""JupyterLab in Chromium: the explorable hears Python's answer, and notebooks run to the end."""

from __future__ import annotations

import os
import secrets
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import nbformat
import pytest

from occlib.course.explorable import library_map, preset_scene

ROOT = Path(__file__).parents[2]
CELLS = """() => jupyterapp.shell.currentWidget.content.widgets.filter((one) => one.model.type === "code").map((one) => ({
    source: one.model.sharedModel.getSource(), count: one.model.executionCount,
    errors: one.model.outputs.toJSON().filter((o) => o.output_type === "error").map((o) => `${o.ename}: ${o.evalue}`) }))"""


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str, Path]]:
    """JupyterLab on this machine, with settings of its own: its address, its token and the folder it shows."""
    home = tmp_path_factory.mktemp("lab")
    folder = home / "notebooks"
    folder.mkdir()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    token = secrets.token_hex(16)
    own = {name: str(home / name.lower()) for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR")}
    own |= {"HOME": str(home), "IPYTHONDIR": str(home / "ipython"), "JUPYTER_TOKEN": token}
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", "--ip=127.0.0.1", f"--port={port}", "--allow-root",
               f"--ServerApp.root_dir={folder}", "--expose-app-in-browser", "--LabApp.news_url=", "--ServerApp.port_retries=0",
               "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate"]  # fmt: skip
    with (home / "log").open("w") as log:
        server = subprocess.Popen(command, env=os.environ | own, cwd=folder, stdout=log, stderr=subprocess.STDOUT)
    address = f"http://127.0.0.1:{port}"
    try:
        for _ in range(120):
            try:
                urlopen(f"{address}/api", timeout=5)
                break
            except (URLError, OSError):
                assert server.poll() is None, (home / "log").read_text()[-2000:]
                time.sleep(0.5)
        yield address, token, folder
    finally:
        server.terminate()
        try:
            server.wait(20)
        except subprocess.TimeoutExpired:
            server.kill()


@pytest.fixture
def run_all(lab: tuple[str, str, Path], new_page: Callable[..., Any]) -> Callable[[str], Any]:
    """``run_all(name)``: a notebook of the folder, opened and run to the end: the page, and no error in any cell."""

    def run(name: str) -> Any:
        address, token, _ = lab
        page = new_page(1400, 1000)
        page.goto(f"{address}/lab/tree/{name}?token={token}&reset")
        page.wait_for_function(
            "window.jupyterapp?.shell.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'", timeout=90_000
        )
        page.evaluate("() => { jupyterapp.commands.execute('notebook:run-all-cells'); }")
        left = "some((one) => one.source.trim() && !one.count && !one.errors.length)"
        page.wait_for_function(
            f"(() => {{ const cells = ({CELLS})(); return cells.some((one) => one.errors.length) || !cells.{left} "
            "&& jupyterapp.shell.currentWidget.sessionContext.session.kernel.status === 'idle'; })()",
            timeout=280_000,
        )
        errors = [error for cell in page.evaluate(CELLS) for error in cell["errors"]]
        assert not errors
        return page

    return run


def test_python_answers_when_something_is_moved_by_keys(
    lab: tuple[str, str, Path], run_all: Callable[[str], Any], refused: list[str]
) -> None:
    notebook = nbformat.v4.new_notebook()
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook.cells = [
        nbformat.v4.new_code_cell(
            'from occlib.course.explorable import explorable\n\nroom = explorable("make a ghost")\nroom'
        )
    ]
    nbformat.write(notebook, lab[2] / "explorable.ipynb")
    page = run_all("explorable.ipynb")
    answer = page.locator(".occ section p")
    answer.wait_for()
    assert answer.inner_text().startswith("3 regions, 1 ghost")
    page.locator("[role=button][aria-label^='object 1:']").focus()
    for _ in range(6):
        page.keyboard.press("ArrowDown")
    scene = preset_scene("make a ghost")
    scene["objects"][0]["y"] -= 0.6
    library = library_map(scene["cameras"], scene["objects"], explain=False)
    assert library.ghosts == 0
    page.wait_for_function(
        f"document.querySelector('.occ section p').textContent.startsWith('{library.regions} regions, 0 ghosts')"
    )
    assert "100.0 % of the cells" in answer.inner_text()
    assert len(page.evaluate(CELLS)) == 1  # the keys were the room's, not the notebook's
    assert not refused
    pixel = (
        "(([x, y]) => [...document.querySelector('.occ-plan canvas').getContext('2d').getImageData(x, y, 1, 1).data])"
    )
    assert page.evaluate(f"{pixel}([40, 40])") == [241, 238, 232, 255]  # the floor's colour: the style is known
    read = page.locator("[data-read=and]")
    assert read.bounding_box()["y"] > page.locator("dt", has_text="Regions in AND").bounding_box()["y"] + 10


@pytest.mark.timeout(400)
@pytest.mark.parametrize("number", ["00", "07"])
def test_a_notebook_runs_to_the_end(lab: tuple[str, str, Path], run_all: Callable[[str], Any], number: str) -> None:
    (source,) = (ROOT / "notebooks").glob(f"{number}_*.ipynb")
    notebook = nbformat.read(source, 4)
    notebook.metadata.setdefault("kernelspec", {"name": "python3", "display_name": "Python 3", "language": "python"})
    nbformat.write(notebook, lab[2] / source.name)
    page = run_all(source.name)
    assert page.evaluate(CELLS)
