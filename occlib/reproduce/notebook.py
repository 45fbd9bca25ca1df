"""What a notebook calls to keep its results::

from occlib import reproduce

reproduce.save(fig, "fig07_contour")                                   # a figure
reproduce.record("centroid_error", 0.012, unit="m", tolerance=0.002)   # a number that a text quotes
"""

from __future__ import annotations

import base64
import html
import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

import occlib
from occlib.base import checks
from occlib.base.arrays import Image
from occlib.base.files import load_json, write_file
from occlib.recordings import Recording, open_recording
from occlib.reproduce.runner import COLUMNS, IMAGE_DESCRIPTION, find_root

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


SHOWN_DPI = 80
"""Pixels an inch at which a saved figure is shown."""


def save(fig: Figure, name: str, *, dpi: float = 120) -> None:
    """Write a figure as ``<name>.png``, the same bytes every time, and show it.

    Under ``occlib reproduce`` it lands in ``runs/`` and is published to ``figures/`` later; run by hand, it lands in
    ``runs/interactive/``. A name used twice in one run raises ``ValueError``.
    """
    folder, by_runner = _run_folder()
    target = folder / f"{_checked_name(name)}.png"
    if by_runner and target.exists():
        raise ValueError(f"save: figure {name!r} was saved before in this notebook")
    stream = io.BytesIO()
    metadata = {"Software": None, "Source": folder.name}  # Source: whose figure it is, see publish.py
    fig.savefig(stream, format="png", dpi=dpi, bbox_inches="tight", metadata=metadata)
    write_file(target, stream.getvalue())
    if fig.canvas.manager is None:  # not one of pyplot's, which a notebook shows by itself
        _display(stream.getvalue(), width=round(SHOWN_DPI * fig.get_figwidth()))


def _display(png: bytes, *, width: int) -> None:
    """Show a picture in the cell's output, ``width`` px wide; outside a notebook do nothing."""
    with suppress(ImportError):
        from IPython import get_ipython
        from IPython.display import Image as Picture
        from IPython.display import display

        if get_ipython() is not None:
            display(Picture(data=png, format="png", width=width))


class Film:
    """A film in a notebook's output."""

    def __init__(self, content: bytes, alt: str) -> None:
        """``content`` is a WebP file, ``alt`` what it shows, in a few words."""
        self.content, self.alt = content, alt

    def _repr_html_(self) -> str:
        data = base64.b64encode(self.content).decode("ascii")
        return f'<img alt="{html.escape(self.alt)}" style="max-width: 100%" src="data:image/webp;base64,{data}">'


def save_film(frames: Sequence[Image], name: str, *, fps: float = 10.0) -> Film:
    """Write pictures, RGB uint8 of one size, as the endless film ``<name>.webp`` and return it; else as :func:`save`."""
    from PIL import Image as Pillow
    from PIL import features

    folder, by_runner = _run_folder()
    target = folder / f"{_checked_name(name)}.webp"
    if by_runner and target.exists():
        raise ValueError(f"save_film: film {name!r} was saved before in this notebook")
    if not len(frames) or len({frame.shape for frame in frames}) > 1:
        raise ValueError(f"save_film: frames: expected pictures of one size, got {[frame.shape for frame in frames]}")
    if frames[0].shape[2:] != (3,) or any(frame.dtype != np.uint8 for frame in frames):
        raise ValueError(f"save_film: frames: expected RGB uint8, got {frames[0].dtype} {frames[0].shape}")
    duration = round(1000 / checks.number("save_film: fps", fps, least=0.1, most=1000, unit="frames a second"))
    if not features.check("webp"):
        raise ValueError(
            "save_film: this Pillow cannot write WebP; first: pip install --upgrade --force-reinstall pillow"
        )
    first, *others = [Pillow.fromarray(frame) for frame in frames]
    owner = Pillow.Exif()
    owner[IMAGE_DESCRIPTION] = folder.name
    stream = io.BytesIO()
    first.save(stream, "WEBP", save_all=True, append_images=others, duration=duration, loop=0, quality=60,
               method=4, exif=owner)  # fmt: skip
    write_file(target, stream.getvalue())
    return Film(stream.getvalue(), f"{name}, a film of {len(frames)} pictures")


def record(name: str, value: float, *, unit: str = "", tolerance: float | None = None) -> None:
    """Keep a number for ``metrics.csv``.

    Parameters
    ----------
    name
        What was measured, letters, digits and ``_ . -``; once in a notebook.
    value
        One finite number or truth value (kept as 1 or 0). With parameters that a reader has changed, a number that is
        not finite is left out, and a line says so.
    unit
        For example ``"m"`` or ``"px"``; empty for a ratio or a count.
    tolerance
        How far, in the value's unit, a fresh run may differ before ``--check`` complains. Default: none for whole
        numbers, else a millionth of the value. ``math.inf`` for what differs by machine, such as a run time.
    """
    array = np.asarray(value)
    if not _own_parameters() and array.dtype.kind == "f" and not array.ndim and not np.isfinite(array):
        print(f"not recorded: {name} is {value}")
        return
    if array.ndim or array.dtype.kind not in "biuf" or not np.isfinite(array):
        raise ValueError(f"record: {name}: expected one finite number, got {value!r}")
    number = int(array) if array.dtype.kind in "biu" else float(array)
    if tolerance is None:
        tolerance = 0.0 if isinstance(number, int) else 1e-6 * abs(number)
    if not tolerance >= 0:
        raise ValueError(f"record: {name}: tolerance: expected a number >= 0, got {tolerance!r}")
    folder, by_runner = _run_folder()
    path = folder / "metrics.json"
    metrics = {row["metric"]: row for row in (load_json(path) if path.exists() else [])}
    if by_runner and name in metrics:
        raise ValueError(f"record: metric {name!r} was recorded before in this notebook")
    texts = (_text(number), str(unit), _text(tolerance))
    metrics[name] = dict(zip(COLUMNS[1:], (_checked_name(name), *texts), strict=True))
    write_file(path, json.dumps(list(metrics.values()), indent=1))


def record_all(values: Mapping[str, float], *, unit: str = "", tolerance: float | None = None) -> None:
    """Keep several numbers of one unit: :func:`record` for each name."""
    for name, value in values.items():
        record(name, value, unit=unit, tolerance=tolerance)


def expect(holds: object) -> None:
    """Stop the run if what the chapter's text says does not hold.

    That is so under ``occlib reproduce`` with the chapter's own parameters. A reader who has changed one, or runs the
    chapter by hand, gets a line instead, and goes on.

    Raises
    ------
    AssertionError
        If it does not hold, with the chapter's own parameters.
    """
    if not holds:
        message = "something that the text says does not hold in this run"
        if _own_parameters():
            raise AssertionError(message)
        print(f"{message}: it was written for the chapter's own parameters")


def _own_parameters() -> bool:
    """Whether the runner runs this notebook with its own parameters, but for ``fast``."""
    return os.environ.get("OCCLIB_OWN_PARAMETERS") == "1"


def recorded_now() -> list[dict[str, str]]:
    """The rows that this notebook has recorded so far in this run; none outside a notebook."""
    folder, by_runner = _run_folder()
    path = folder / "metrics.json"
    return [{"notebook": folder.name, **row} for row in load_json(path)] if by_runner and path.exists() else []


def keep_table(table: pd.DataFrame, name: str) -> None:
    """Write a table as ``<name>.csv`` beside the executed notebook in ``runs/``, and nowhere else.

    For numbers that not every machine can make again, such as those of a recording that does not ship: they are neither
    published nor checked.
    """
    folder, _ = _run_folder()
    write_file(folder / f"{_checked_name(name)}.csv", table.to_csv())


def show_versions() -> None:
    """Print the versions that a reader needs to compare results."""
    print(f"occlib {occlib.__version__}, cv2 {cv2.__version__}, numpy {np.__version__}")


def _run_folder() -> tuple[Path, bool]:
    """Where this notebook's results go, and whether the runner decided it."""
    if folder := os.environ.get("OCCLIB_RUN_DIR"):
        return Path(folder), True
    notebook = Path(os.environ.get("JPY_SESSION_NAME", "session")).stem  # set by Jupyter
    return find_root() / "runs" / "interactive" / notebook, False


def _checked_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
        raise ValueError(f"name: expected letters, digits and _ . - only, got {name!r}")
    return name


def _text(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:.10g}"


def open_or_stop(name: str | Path) -> Recording | None:
    """The recording; where it was not fetched, a line that says so, and the cells that follow do nothing.

    The run then succeeds, in Jupyter as under papermill: every later cell is emptied before it is executed, until the
    recording is there, or until a cell that calls :func:`resume`. To be called in a cell's last line.

    Returns
    -------
    The recording, or ``None`` outside IPython, where nothing can be held back, if it was not fetched.

    Raises
    ------
    ValueError
        As :func:`occlib.recordings.open_recording`, for a recording that is there and damaged, or not known.
    """
    try:
        return open_recording(name)
    except ValueError as error:
        if "not fetched" not in str(error):
            raise
        print(f"{error}. Without it the cells that follow do nothing.")
    with suppress(ImportError):
        from IPython import get_ipython

        if shell := get_ipython():
            shell.input_transformers_cleanup.append(_HoldBack(name))
    return None


def resume() -> None:
    """The end of what :func:`open_or_stop` holds back: this cell and those after it need no recording.

    To be called in a cell that uses nothing of the recording. Does nothing where nothing is held back.
    """
    with suppress(ImportError):
        from IPython import get_ipython

        if shell := get_ipython():
            kept = [each for each in shell.input_transformers_cleanup if not isinstance(each, _HoldBack)]
            shell.input_transformers_cleanup[:] = kept


class _HoldBack:
    """Empties cells of IPython until a recording is at hand; a cell that calls :func:`resume` is let through."""

    def __init__(self, name: str | Path) -> None:
        self.name = name

    def __call__(self, lines: list[str]) -> list[str]:
        wanted = any(line.startswith("reproduce.resume()") for line in lines) or _at_hand(self.name)
        return lines if wanted else ["pass\n"]


def _at_hand(name: str | Path) -> bool:
    with suppress(ValueError):
        open_recording(name)
        return True
    return False
