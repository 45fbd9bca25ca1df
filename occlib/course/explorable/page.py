"""The explorable without Python: a page of its own, and the same in a frame for executed notebooks."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from occlib.base import checks
from occlib.course.explorable.scene import floor_values

MODULE = Path(__file__).with_name("explorable.js")
"""The front end, a module in anywidget's format."""

START = "hide the small one"
"""The first preset."""

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>occlib: cameras, shadows and their AND</title>
<style>html { color-scheme: light dark } body { margin: 0; background: #fff }
@media (prefers-color-scheme: dark) { body { background: #14181d } }
[data-theme=light] body { background: #fff } [data-theme=dark] body { background: #14181d }</style>
</head>
<body>
<main><h1 style="position: absolute; width: 1px; height: 1px; overflow: hidden">Cameras, shadows and their AND</h1>
<div id="explorable"></div>
<noscript><p>%(fallback)s</p></noscript></main>
<script type="module">
%(module)s
const state = %(state)s;
const model = { get: (name) => state[name], set: (name, value) => { state[name] = value; }, on() {}, off() {}, save_changes() {} };
widget.render({ model, el: document.getElementById("explorable") });
Object.assign(window, { model, geometry, presets });
%(fit)s</script>
</body>
</html>
"""

_FALLBACK = (
    "A room from above: cameras on the walls are lamps, their foreground on the floor is the shadow of what stands there, and "
    "AND keeps what lies in the shadow of every lamp. To move cameras and objects, open this page in a browser with JavaScript."
)

_FIT = """try {
  const frame = window.frameElement, root = document.querySelector("main");
  const follow = () => { if (frame) { frame.style.height = `${root.scrollHeight + 4}px`; document.documentElement.dataset.theme = parent.document.documentElement.dataset.theme ?? ""; } };
  new ResizeObserver(follow).observe(root);
  if (frame) new MutationObserver(follow).observe(parent.document.documentElement, { attributeFilter: ["data-theme"] });
} catch { /* a page of another origin around the frame: it scrolls */ }
"""


@cache
def module_source() -> str:
    """The front end's source."""
    return MODULE.read_text(encoding="utf-8")


@cache
def presets() -> dict[str, Any]:
    """The presets by name, as the front end has them: caption, cameras, objects, the item chosen first."""
    found = re.search(r"^export const presets = (\{.*?^\});$", module_source(), re.DOTALL | re.MULTILINE)
    if found is None:
        raise ValueError(f"{MODULE.name}: expected presets in JSON, found none")
    return dict(json.loads(found[1]))


def preset_scene(name: str) -> dict[str, list[dict[str, Any]]]:
    """Cameras and objects of a preset, all values named.

    >>> preset_scene("a third camera")["cameras"][2]
    {'name': 'C', 'x': 3.05, 'y': 0, 'height': 2.5, 'view': 150}
    """
    preset = presets()[checks.choice("preset", name, presets())]
    return {
        "cameras": [
            dict(zip(("name", "x", "y", "height"), one, strict=True)) | {"view": 150} for one in preset["cameras"]
        ],
        "objects": [
            dict(zip(("x", "y", "radius", "height", "missed"), [*one, []][:5], strict=True))
            for one in preset["objects"]
        ],
    }


def page_of(state: Mapping[str, Any]) -> str:
    """A complete page that shows a state of the widget and asks no host for anything."""
    module = module_source().replace("export default {", "const widget = {").replace("export const ", "const ")
    return _PAGE % {
        "fallback": html.escape(_FALLBACK),
        "module": module,
        "state": json.dumps(dict(state)).replace("<", "\\u003c"),
        "fit": _FIT,
    }


def standalone_page(preset: str = START) -> str:
    """A complete HTML page with the explorable in it; works from a file, without a kernel, and asks no host for anything.

    Parameters
    ----------
    preset
        The scene that it begins with, one of :func:`presets`.

    Raises
    ------
    ValueError
        No such preset.

    Examples
    --------
    >>> page = standalone_page("make a ghost")
    >>> page[:15], len(page) < 60_000
    ('<!doctype html>', True)
    """
    return page_of({**preset_scene(preset), "floor": floor_values(), "preset": preset})


def frame_of(state: Mapping[str, Any]) -> str:
    """The page in a frame that grows with it, for an executed notebook."""
    return (
        f'<iframe srcdoc="{html.escape(page_of(state))}" title="Explorable: cameras, shadows and their AND" '
        'style="width: 100%; height: 860px; border: 0"></iframe>'
    )
