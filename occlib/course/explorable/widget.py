"""The explorable in a notebook: Python hears of every move and answers with the library's own map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from occlib.base.extras import import_extra
from occlib.course.explorable.page import START, frame_of, module_source, preset_scene
from occlib.course.explorable.scene import (
    checked_cameras,
    checked_floor,
    checked_objects,
    floor_values,
    library_map,
)
from occlib.geometry import Floor
from occlib.lab import FLOOR


def library_answer(
    cameras: Sequence[Mapping[str, Any]], objects: Sequence[Mapping[str, Any]], floor: Floor
) -> dict[str, Any]:
    """What the library says of a room, as the front end takes it: the places it is about, the map in runs, the counts."""
    found = library_map(cameras, objects, floor)
    return {
        "cameras": list(cameras),
        "objects": list(objects),
        "runs": found.runs(),
        "regions": found.regions,
        "ghosts": found.ghosts,
        "ratio": found.ratio,
        "explained": None if found.explained is None else [list(one) for one in found.explained],
    }


def explorable(
    preset: str = START,
    *,
    cameras: Sequence[Mapping[str, Any]] | None = None,
    objects: Sequence[Mapping[str, Any]] | None = None,
    floor: Floor = FLOOR,
) -> Any:
    """A room to explore, as a widget: drag cameras and objects or move them by keys.

    Shadows, the AND map, ghosts, blind cells and the objects that explain the shadows follow at once, in the browser.
    When something was moved, Python answers with the map that the library makes of the same room. In an executed notebook
    without a kernel, as in the book, the same room works in a frame.

    Parameters
    ----------
    preset
        The scene that it begins with: ``"hide the small one"``, ``"make a ghost"``, ``"a third camera"``,
        ``"raise the cameras"`` or ``"one mask has a hole"``.
    cameras
        Instead of the preset's: 2 to 4 of ``{"name": "A", "x", "y", "height", "view"}``, m and degrees; names A to D.
    objects
        Instead of the preset's: at most 8 of ``{"x", "y", "radius", "height", "missed"}``, m; ``missed`` lists cameras
        whose mask has a hole there.
    floor
        Of the map.

    Returns
    -------
    A widget with the traits ``cameras``, ``objects``, ``floor``, ``preset`` and ``answer``.

    Raises
    ------
    ValueError
        No such preset, a wrong camera, object or floor; anywidget is not installed.

    Examples
    --------
    >>> from occlib.course.explorable import explorable
    >>> room = explorable("make a ghost")
    >>> room.answer["regions"], room.answer["ghosts"]
    (3, 1)
    """
    scene = preset_scene(preset)
    return _widget_class()(
        preset=preset,
        cameras=checked_cameras(scene["cameras"] if cameras is None else cameras),
        objects=checked_objects(scene["objects"] if objects is None else objects),
        floor=floor_values(checked_floor(floor_values(floor))),
    )


@cache
def _widget_class() -> Any:
    """The widget's class, made when first used: anywidget comes with an extra."""
    anywidget, traitlets = import_extra("anywidget", "notebooks"), import_extra("traitlets", "notebooks")

    class Explorable(anywidget.AnyWidget):  # type: ignore[misc, name-defined]
        """Cameras and objects as the reader moved them, and the library's answer."""

        _esm = module_source()
        cameras = traitlets.List().tag(sync=True)
        objects = traitlets.List().tag(sync=True)
        floor = traitlets.Dict().tag(sync=True)
        preset = traitlets.Unicode().tag(sync=True)
        answer = traitlets.Dict().tag(sync=True)

        def __init__(self, **values: Any) -> None:
            super().__init__(**values)
            self._follow()
            self.observe(self._follow, ["cameras", "objects", "floor"])

        @traitlets.validate("cameras", "objects", "floor")  # type: ignore[untyped-decorator]
        def _check(self, proposal: Any) -> Any:
            name, value = proposal["trait"].name, proposal["value"]
            try:
                if name == "floor":
                    return floor_values(checked_floor(value))
                return checked_cameras(value) if name == "cameras" else checked_objects(value)
            except ValueError as error:  # after any other error traitlets would keep a message's wrong value
                raise traitlets.TraitError(str(error)) from None

        def _follow(self, change: Any = None) -> None:
            """Answer, once where cameras and objects change together."""
            asked = (self.cameras, self.objects, self.floor)
            if asked != getattr(self, "_asked", None):
                self._asked = asked
                self.answer = library_answer(self.cameras, self.objects, checked_floor(self.floor))

        def _repr_mimebundle_(self, **options: Any) -> Any:
            """The widget, and for a page without a kernel the same room in a frame."""
            bundle = super()._repr_mimebundle_(**options)
            if bundle is None:
                return None
            state = {name: getattr(self, name) for name in ("cameras", "objects", "floor", "preset")}
            return {**bundle[0], "text/html": frame_of(state)}, bundle[1]

    return Explorable
