"""Notebooks run with parameters: metrics and figures, published only when every notebook succeeded.

In a notebook::

    from occlib.reproduce import record, save, show_versions

    save(fig, "fig07_contour")                              # a figure
    record("centroid_error", 0.012, unit="m", tolerance=0.002)   # a number that a text quotes

:func:`reproduce` is behind ``occlib reproduce``. Each notebook runs in a process of its own, in an empty scratch
folder, one thread, without the user's Jupyter or matplotlib settings. Its executed copy, figures, metrics and
manifest go to ``runs/<notebook>/``. ``figures/`` changes after the last notebook succeeded, never before.
"""

from __future__ import annotations

import csv
import hashlib
import importlib.metadata
import io
import json
import os
import platform
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

import occlib
from occlib.base.extras import check_extra
from occlib.base.files import file_hash, folder_hash, load_json, write_file
from occlib.base.interrupts import uninterrupted
from occlib.recordings import cache_folder, public_recordings
from occlib.reproduce.runner import (
    PACKAGE,
    Metrics,
    Run,
    check_copy,
    execute,
    find_root,
    notebook_parameters,
    order,
    override,
    select_notebooks,
)

if TYPE_CHECKING:
    import pandas as pd


COLUMNS = ("notebook", "metric", "value", "unit", "tolerance")


_LIBRARIES = ("numpy", "scipy", "scikit-image", "matplotlib", "pandas", "ipykernel", "papermill")


@dataclass(frozen=True)
class Report:
    """What :func:`reproduce` did. ``problems`` is filled by ``check`` only; ``str(report)`` is for the terminal."""

    runs: tuple[Run, ...]
    lines: tuple[str, ...]
    problems: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "\n".join([*self.lines, *self.problems])

    def metrics(self) -> pd.DataFrame:
        """Columns notebook, metric, value, unit, tolerance; one row a metric, sorted."""
        import pandas as pd

        rows = sorted((row for run in self.runs for row in run.metrics), key=order)
        return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"value": float, "tolerance": float})


def reproduce(
    notebooks: Iterable[str | Path] | None = None,
    *,
    parameters: Mapping[str, Any] | None = None,
    fast: bool = False,
    jobs: int = 1,
    force: bool = False,
    check: bool = False,
    root: str | Path | None = None,
    progress: bool = True,
) -> Report:
    """Run notebooks whose inputs changed since their last run, then publish or check their results.

    Parameters
    ----------
    notebooks
        Numbers, names or paths; all for ``None``.
    parameters
        Overrides of the notebooks' parameters; each selected notebook must have each of them. Text is parsed to the
        type of the default. With other than the default parameters nothing is published.
    fast
        Set each notebook's parameter ``fast``: smaller experiments, nothing published.
    jobs
        How many notebooks run at the same time; the results do not depend on it.
    force
        Run also what did not change.
    check
        Publish nothing; compare the metrics with the committed ``figures/metrics.csv``.
    root
        The project's folder.
    progress
        Show a bar on stderr.

    Raises
    ------
    ValueError
        In one line: an unknown notebook or parameter, a wrong type, a cell that failed, a folder that cannot be
        written. ``figures/`` is then as it was.
    """
    home = Path(root or find_root()).resolve()
    if jobs < 1:
        raise ValueError(f"jobs: expected a whole number >= 1, got {jobs}")
    runs = _plan(home, notebooks, {**(parameters or {}), **({"fast": True} if fast else {})})
    default = not any(run.overrides for run in runs)
    if check and not default:
        raise ValueError("check: the committed metrics are those of the default parameters; drop --fast and -p")
    for run in runs:
        run.skipped = not force and _is_current(run)
    started = time.monotonic()
    execute([run for run in runs if not run.skipped], jobs, home, progress)
    skipped = sum(run.skipped for run in runs)
    lines = [f"{len(runs) - skipped} notebooks run in {time.monotonic() - started:.0f} s, {skipped} unchanged"]
    problems: list[str] = []
    if check:
        problems = _differences(home, runs)
        count = sum(len(run.metrics) for run in runs)
        lines.append(f"{count} metrics checked: {len(problems) or 'no'} differences from figures/metrics.csv")
    elif default:
        changed = _publish(home, runs)
        lines.append(f"figures/: {', '.join(changed) or 'nothing'} changed")
    else:
        kept = ", ".join(str(run.folder.relative_to(home)) for run in runs)
        lines.append(f"not the default parameters: results stay in {kept}, figures/ is as it was")
    return Report(tuple(runs), tuple(lines), tuple(problems))


def notebook_results(name: str | Path, **options: Any) -> dict[str, float]:
    """Metrics of one notebook by name, run if need be; ``options`` as in :func:`reproduce`."""
    table = reproduce([name], progress=False, **options).metrics()
    return dict(zip(table["metric"], table["value"], strict=True))


def _plan(home: Path, notebooks: Iterable[str | Path] | None, given: Mapping[str, Any]) -> list[Run]:
    check_extra("papermill", "notebooks")
    check_copy(home)
    versions = {"occlib": occlib.__version__, "cv2": cv2.__version__, "python": platform.python_version()}
    versions |= {library: importlib.metadata.version(library) for library in _LIBRARIES}
    versions |= {"platform": f"{platform.system()} {platform.machine()}"}
    shared = {"versions": versions, "occlib_sha256": folder_hash(PACKAGE)}
    fetched = [name for name in public_recordings() if (cache_folder() / name).is_dir()]
    shared |= {"data_sha256": folder_hash(home / "data"), "fetched": fetched}
    runs = []
    for path in select_notebooks(notebooks, home):
        defaults = notebook_parameters(path)
        values = override(path.stem, defaults, given)
        overrides = {name: value for name, value in values.items() if value != defaults[name]}
        chosen = {**defaults, **overrides}
        mark = hashlib.sha256(json.dumps(chosen, sort_keys=True).encode()).hexdigest()[:8]
        suffix = "" if not overrides else "__fast" if list(overrides) == ["fast"] else f"__{mark}"
        source = path.read_bytes()
        inputs = {"parameters": chosen, "notebook_sha256": hashlib.sha256(source).hexdigest(), **shared}
        runs.append(Run(path.stem, source, overrides, inputs, home / "runs" / f"{path.stem}{suffix}"))
    return runs


def _is_current(run: Run) -> bool:
    """Whether the folder holds the complete results of exactly these inputs; then they are loaded."""
    with suppress(ValueError, TypeError, KeyError, AttributeError):
        manifest = load_json(run.folder / "manifest.json")
        files = manifest["files"].items()
        if manifest["inputs"] == run.inputs and all(file_hash(run.folder / name) == value for name, value in files):
            run.manifest = manifest
            return True
    return False


def _published_figures(home: Path) -> dict[str, str]:
    """File name of each PNG in ``figures/`` that :func:`save` made, and the notebook it came from."""
    from PIL import Image

    owners = {}
    for path in sorted((home / "figures").glob("*.png")):
        with suppress(OSError), Image.open(path) as image:
            if owner := image.info.get("Source"):
                owners[path.name] = str(owner)
    return owners


def _published_metrics(home: Path) -> Metrics:
    path = home / "figures" / "metrics.csv"
    if not path.exists():
        return []
    try:
        reader = csv.DictReader(path.read_text(encoding="utf-8").splitlines(), strict=True)
        rows = list(reader)
        numbers = [float(row[name]) for row in rows for name in ("value", "tolerance")]
        if reader.fieldnames != list(COLUMNS) or any(number != number for number in numbers):
            raise ValueError
    except (OSError, csv.Error, KeyError, TypeError, ValueError):
        raise ValueError(f"{path}: expected a table with the columns {', '.join(COLUMNS)}") from None
    return rows


def _figures(home: Path, runs: Sequence[Run]) -> tuple[dict[str, Path], list[str]]:
    """The figures of ``runs`` by file name, and the published ones that their notebook no longer makes.

    Raises ``ValueError`` if two notebooks make the same figure.
    """
    names = {run.notebook for run in runs}
    others = {path.stem for path in select_notebooks(None, home)} - names
    published = _published_figures(home)
    owners = {name: owner for name, owner in published.items() if owner in others}
    made: dict[str, Path] = {}
    for run in runs:
        for name in (name for name in run.manifest["files"] if name.endswith(".png")):
            if owners.setdefault(name, run.notebook) != run.notebook:
                raise ValueError(f"figure {name}: both {owners[name]} and {run.notebook} make it")
            made[name] = run.folder / name
    return made, [name for name in published if name not in owners]


def _publish(home: Path, runs: Sequence[Run]) -> list[str]:
    """Bring ``figures/`` up to date and return what changed: first everything is written aside, then renamed."""
    made, stale = _figures(home, runs)
    others = {path.stem for path in select_notebooks(None, home)} - {run.notebook for run in runs}
    rows = [row for row in _published_metrics(home) if row["notebook"] in others]
    stream = io.StringIO()
    table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(sorted(rows + [row for run in runs for row in run.metrics], key=order))
    contents = {name: path.read_bytes() for name, path in made.items()}
    contents["metrics.csv"] = stream.getvalue().encode()
    figures = home / "figures"
    changed = {
        name: content
        for name, content in contents.items()
        if not (figures / name).is_file() or (figures / name).read_bytes() != content
    }
    if not changed and not stale:
        return []
    try:
        figures.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=figures, prefix=".publish-") as aside:
            for name, content in changed.items():
                write_file(Path(aside) / name, content)
            if blocked := [name for name in changed if (figures / name).is_dir()]:
                raise ValueError(f"{figures / blocked[0]}: cannot write (is a directory)")
            with uninterrupted():
                for name in changed:
                    os.replace(Path(aside) / name, figures / name)
                for name in stale:
                    (figures / name).unlink()
    except OSError as error:
        raise ValueError(f"{figures}: cannot write ({error.strerror})") from None
    return [*changed, *(f"{name} (removed)" for name in stale)]


def _differences(home: Path, runs: Sequence[Run]) -> list[str]:
    """One line for each metric that is out of tolerance, new or missing, and each figure new or missing."""
    others = {path.stem for path in select_notebooks(None, home)} - {run.notebook for run in runs}
    before = {order(row): row for row in _published_metrics(home) if row["notebook"] not in others}
    after = {order(row): row for run in runs for row in run.metrics}
    lines = []
    for key in sorted(before | after):
        old, new, label = before.get(key), after.get(key), ": ".join(key)
        if old is None or new is None:
            lines.append(f"{label}: {'new, not in metrics.csv' if old is None else 'missing, only in metrics.csv'}")
        elif old["unit"] != new["unit"]:
            lines.append(f"{label}: unit is {new['unit']!r}, metrics.csv says {old['unit']!r}")
        elif abs(float(new["value"]) - float(old["value"])) > float(old["tolerance"]) * (1 + 1e-9):
            lines.append(
                f"{label}: {new['value']}, metrics.csv says {old['value']} +- {old['tolerance']} {old['unit']}"
            )
    made, stale = _figures(home, runs)
    lines += [f"figure {name}: not in figures/" for name in sorted(set(made) - set(_published_figures(home)))]
    return lines + [f"figure {name}: no notebook makes it" for name in stale]
