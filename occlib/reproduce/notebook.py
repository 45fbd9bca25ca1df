"""What a notebook calls to keep its results::

from occlib import reproduce

reproduce.save(fig, "fig07_contour")                                   # a figure
reproduce.record("centroid_error", 0.012, unit="m", tolerance=0.002)   # a number that a text quotes
"""

from __future__ import annotations

import io
import json
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

import occlib
from occlib.base.files import load_json, write_file
from occlib.recordings import Recording, open_recording
from occlib.reproduce.runner import COLUMNS, find_root

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


def save(fig: Figure, name: str, *, dpi: float = 120) -> None:
    """Write a figure as ``<name>.png``, the same bytes every time.

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


def record(name: str, value: float, *, unit: str = "", tolerance: float | None = None) -> None:
    """Keep a number for ``metrics.csv``.

    Parameters
    ----------
    name
        What was measured, letters, digits and ``_ . -``; once in a notebook.
    value
        One finite number or truth value (kept as 1 or 0).
    unit
        For example ``"m"`` or ``"px"``; empty for a ratio or a count.
    tolerance
        How far, in the value's unit, a fresh run may differ before ``--check`` complains. Default: none for whole
        numbers, else a millionth of the value. ``math.inf`` for what differs by machine, such as a run time.
    """
    array = np.asarray(value)
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
    """The recording; where it was not fetched, a line that says so, and the rest of the notebook does nothing.

    The run then succeeds, in Jupyter as under papermill: every later cell is emptied before it is executed, until the
    recording is there. To be called in a cell's last line.

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
        print(f"{error}. Without it this notebook ends here.")
    with suppress(ImportError):
        from IPython import get_ipython

        if shell := get_ipython():
            shell.input_transformers_cleanup.append(lambda lines: lines if _at_hand(name) else ["pass\n"])
    return None


def _at_hand(name: str | Path) -> bool:
    with suppress(ValueError):
        open_recording(name)
        return True
    return False
