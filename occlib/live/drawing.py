"""The newest map as a picture file, for who watches it with an image viewer."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Self

from occlib.base.files import write_file
from occlib.live.messages import Message
from occlib.mapping import OccupancyMap
from occlib.tracking import ObjectVector

DRAW_EVERY_S = 1.0
"""Shortest time between two drawings, s: drawing takes a third of a second, and the maps come ten times as often."""


def draw_message(message: Message, path: str | Path) -> Path:
    """Draw a map and its objects to a PNG file, written whole; return its path."""
    from occlib.plotting import figure_png, new_figure, show_map

    objects, coasting = (
        [ObjectVector(t["id"], (t["x"], t["y"]), (t["vx"], t["vy"]), t["area"], tuple(t["colour"])) for t in some]
        for some in (message.objects, message.coasting)
    )
    fig, ax = new_figure(width=6.0, height=5.0)
    grid = OccupancyMap(message.data, message.floor)
    show_map(ax, grid, objects, coasting=coasting, title=f"map {message.sequence}")
    return write_file(path, figure_png(fig))


class MapPicture:
    """A PNG file that shows the newest map: drawn in a thread, at most once a second, and once more at the end.

    Parameters
    ----------
    path
        The file.

    Examples
    --------
    ::

        with MapPicture("map.png") as picture, Listener("tcp://127.0.0.1:5599") as listener:
            for message in listener:
                picture.show(message)
    """

    def __init__(self, path: str | Path) -> None:
        import occlib.plotting  # noqa: F401  slow, and maps must not wait for it

        self.path = path
        self._thread = ThreadPoolExecutor(1)
        self._drawing: Future[Path] | None = None
        self._drawn_s = -DRAW_EVERY_S
        self._newest: Message | None = None

    def show(self, message: Message) -> None:
        """Draw this one if it is time to; never waits. Raises what the previous drawing failed with."""
        self._newest = message
        if time.monotonic() < self._drawn_s + DRAW_EVERY_S or not (self._drawing is None or self._drawing.done()):
            return
        if self._drawing is not None:
            self._drawing.result()  # the file may have failed
        self._drawing, self._drawn_s = self._thread.submit(draw_message, message, self.path), time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        self._thread.shutdown()
        if kind is None and self._newest is not None:
            draw_message(self._newest, self.path)
