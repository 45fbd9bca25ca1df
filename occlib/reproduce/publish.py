"""``occlib reproduce``: run the notebooks, then publish their figures and metrics in ``figures/``, or check them.

``figures/`` changes after the last notebook succeeded, never before, and only where a result does not agree with what
is there (:mod:`occlib.reproduce.agreement`): a second machine leaves no trace in git.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from occlib.base.files import staged_folder, write_file
from occlib.reproduce.agreement import figure_agrees, metric_agrees, row_stays
from occlib.reproduce.notebook import recorded_now
from occlib.reproduce.runner import (
    COLUMNS,
    IMAGE_DESCRIPTION,
    Metrics,
    Run,
    execute,
    find_root,
    is_current,
    order,
    plan_runs,
    select_notebooks,
)

if TYPE_CHECKING:
    import pandas as pd

SUFFIXES = (".png", ".webp")
"""Of figures, and of figures that move."""


def recorded_metrics(root: str | Path) -> dict[str, float]:
    """What is known now: the published numbers by their key ``NN/name``, and those that the notebook that calls this has recorded."""
    rows = [*published_metrics(Path(root)), *recorded_now()]
    return {f"{row['notebook'][:2]}/{row['metric']}": float(row["value"]) for row in rows}


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

    Metrics that agree with ``figures/metrics.csv`` within their tolerance, and figures that look the same, stay as they
    are.

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
    runs = plan_runs(home, notebooks, {**(parameters or {}), **({"fast": True} if fast else {})})
    default = not any(run.overrides for run in runs)
    if check and not default:
        raise ValueError("check: the committed metrics are those of the default parameters; drop --fast and -p")
    for run in runs:
        run.skipped = not force and is_current(run)
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


def _published_figures(home: Path) -> dict[str, str]:
    """File name of each figure in ``figures/`` that :func:`save` or :func:`save_film` made, and its notebook."""
    from PIL import Image

    owners = {}
    for path in sorted(path for path in (home / "figures").glob("*") if path.suffix in SUFFIXES):
        with (
            suppress(OSError, SyntaxError, ValueError),
            Image.open(path) as image,
        ):  # what Pillow says of a damaged file
            if owner := image.info.get("Source") or image.getexif().get(IMAGE_DESCRIPTION):
                owners[path.name] = str(owner)
    return owners


def published_metrics(home: Path) -> Metrics:
    """The rows of ``figures/metrics.csv``; none without that file."""
    path = home / "figures" / "metrics.csv"
    return read_metrics(path) if path.exists() else []


def read_metrics(path: Path) -> Metrics:
    """The rows of a ``metrics.csv``; ``ValueError`` in one line if it is none."""
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
        for name in (name for name in run.manifest["files"] if name.endswith(SUFFIXES)):
            if owners.setdefault(name, run.notebook) != run.notebook:
                raise ValueError(f"figure {name}: both {owners[name]} and {run.notebook} make it")
            made[name] = run.folder / name
    return made, [name for name in published if name not in owners]


def _publish(home: Path, runs: Sequence[Run]) -> list[str]:
    """Bring ``figures/`` up to date, all or nothing, and return what changed; what agrees is left as it is."""
    made, stale = _figures(home, runs)
    figures, owners = home / "figures", _published_figures(home)
    changed = {}
    for name, path in made.items():
        content, published = path.read_bytes(), figures / name
        if published.is_file() and published.read_bytes() == content:
            continue
        same_owner = owners.get(name) == path.parent.name  # a run's folder has its notebook's name
        if not (same_owner and figure_agrees(path, published)):
            changed[name] = content
    table, published = _table(home, runs).encode(), figures / "metrics.csv"
    if not published.is_file() or published.read_bytes() != table:
        changed["metrics.csv"] = table
    if changed or stale:
        with staged_folder(figures, remove=stale) as stage:
            for name, content in changed.items():
                write_file(stage / name, content)
    return [*changed, *(f"{name} (removed)" for name in stale)]


def _table(home: Path, runs: Sequence[Run]) -> str:
    """``metrics.csv`` as it should be: other notebooks' rows as they are, and of ``runs`` those that agree, too."""
    published = {order(row): row for row in published_metrics(home)}
    others = {path.stem for path in select_notebooks(None, home)} - {run.notebook for run in runs}
    rows = [row for row in published.values() if row["notebook"] in others]
    for row in (row for run in runs for row in run.metrics):
        old = published.get(order(row))
        rows.append(old if old and row_stays(row, old) else row)
    stream = io.StringIO()
    table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(sorted(rows, key=order))
    return stream.getvalue()


def _differences(home: Path, runs: Sequence[Run]) -> list[str]:
    """One line for each metric that is out of tolerance, new or missing, and each figure new or missing."""
    others = {path.stem for path in select_notebooks(None, home)} - {run.notebook for run in runs}
    published = {order(row): row for row in published_metrics(home) if row["notebook"] not in others}
    fresh = {order(row): row for run in runs for row in run.metrics}
    lines = []
    for key in sorted(published | fresh):
        old, new, label = published.get(key), fresh.get(key), ": ".join(key)
        if old is None or new is None:
            lines.append(f"{label}: {'new, not in metrics.csv' if old is None else 'missing, only in metrics.csv'}")
        elif old["unit"] != new["unit"]:
            lines.append(f"{label}: unit is {new['unit']!r}, metrics.csv says {old['unit']!r}")
        elif not metric_agrees(new, old):
            lines.append(
                f"{label}: {new['value']}, metrics.csv says {old['value']} +- {old['tolerance']} {old['unit']}"
            )
    made, stale = _figures(home, runs)
    lines += [f"figure {name}: not in figures/" for name in sorted(set(made) - set(_published_figures(home)))]
    return lines + [f"figure {name}: no notebook makes it" for name in stale]
