"""Notebooks run with parameters: metrics and figures, published only when every notebook succeeded.

In a notebook::

    from occlib.experiments import record, save, show_versions

    save(fig, "fig07_contour")                              # a figure
    record("centroid_error", 0.012, unit="m", tolerance=0.002)   # a number that a text quotes

:func:`reproduce` is behind ``occlib reproduce``. Each notebook runs in a process of its own, in an empty scratch
folder, one thread, without the user's Jupyter or matplotlib settings. Its executed copy, figures, metrics and
manifest go to ``runs/<notebook>/``. ``figures/`` changes after the last notebook succeeded, never before.
"""

from __future__ import annotations

import ast
import csv
import hashlib
import importlib.metadata
import io
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

import occlib
from occlib.recordings import write_file

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

PACKAGE = Path(__file__).parent
COLUMNS = ("notebook", "metric", "value", "unit", "tolerance")
_LIBRARIES = ("numpy", "scipy", "scikit-image", "matplotlib", "pandas", "ipykernel", "papermill")
_ONE_THREAD = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"),
    *("VECLIB_MAXIMUM_THREADS", "OPENCV_FOR_THREADS_NUM"),
)

Metrics = list[dict[str, str]]


# --- in a notebook


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
    metadata = {"Software": None, "Source": folder.name}  # Source: whose figure it is, see _publish
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
    metrics = {row["metric"]: row for row in (_load_json(path) if path.exists() else [])}
    if by_runner and name in metrics:
        raise ValueError(f"record: metric {name!r} was recorded before in this notebook")
    texts = (_text(number), str(unit), _text(tolerance))
    metrics[name] = dict(zip(COLUMNS[1:], (_checked_name(name), *texts), strict=True))
    write_file(path, json.dumps(list(metrics.values()), indent=1))


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


# --- which notebooks, with which parameters


def find_root(start: str | Path | None = None) -> Path:
    """The project's folder: the one with ``notebooks/`` that holds the package, else above ``start`` (or here)."""
    here = Path(start or Path.cwd()).resolve()
    for folder in (PACKAGE.parent, here, *here.parents):
        if (folder / "notebooks").is_dir():
            return folder
    raise ValueError(f"no notebooks/ folder in or above {here}: run this in the project's folder")


def select_notebooks(names: Iterable[str | Path] | None = None, root: str | Path | None = None) -> list[Path]:
    """Notebooks by number (``03``), name (``03_match_templates``) or path; all of them for ``None``."""
    there = {path.stem: path for path in sorted((Path(root or find_root()) / "notebooks").glob("*.ipynb"))}
    chosen = set(there) if names is None else set()
    for name in names or ():
        text, path = str(name), Path(name)
        stem_wanted = path.name.removesuffix(".ipynb")
        found = [stem for stem in there if stem == stem_wanted or (text.isdigit() and stem.startswith(f"{text:0>2}_"))]
        if len(found) != 1 or (len(path.parts) > 1 and path.resolve() != there[found[0]].resolve()):
            raise ValueError(f"notebook {str(name)!r}: expected one of {', '.join(there) or '(none there)'}")
        chosen.add(found[0])
    if not chosen:
        raise ValueError(f"no notebooks to run in {Path(root or find_root()) / 'notebooks'}")
    return [there[stem] for stem in sorted(chosen)]


def notebook_parameters(path: str | Path) -> dict[str, Any]:
    """Names and default values from the one cell tagged ``parameters``; empty without such a cell."""
    cells = [cell for cell in _read_notebook(path)["cells"] if "parameters" in _tags(cell)]
    if len(cells) > 1:
        raise ValueError(f"{Path(path).stem}: expected one cell tagged 'parameters', got {len(cells)}")
    defaults: dict[str, Any] = {}
    try:
        for line in ast.parse("".join(cells[0]["source"])).body if cells else ():
            if isinstance(line, ast.Assign | ast.AnnAssign) and line.value is not None:
                target = line.target if isinstance(line, ast.AnnAssign) else line.targets[0]
                value = defaults[ast.unparse(target)] = ast.literal_eval(line.value)
                if not isinstance(value, bool | int | float | str | None):
                    raise ValueError
    except (SyntaxError, ValueError):
        raise ValueError(
            f"{Path(path).stem}: parameters cell: expected lines like 'seed = 0  # unit, meaning'"
        ) from None
    return defaults


def _override(notebook: str, defaults: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The given parameters in the type of their defaults; text, as a command line gives it, is parsed."""
    checked = {}
    for name, value in given.items():
        if name not in defaults:
            raise ValueError(f"{notebook}: no parameter {name!r}; it has {', '.join(defaults) or 'none'}")
        kind = type(defaults[name])
        parsed = value
        if isinstance(value, str) and kind is not str:
            with suppress(ValueError, SyntaxError):
                parsed = ast.literal_eval(value.capitalize() if kind is bool else value)
        if kind is float and type(parsed) is int:
            parsed = float(parsed)
        if defaults[name] is not None and type(parsed) is not kind:
            raise ValueError(f"{notebook}: parameter {name}: expected {kind.__name__}, got {value!r}")
        checked[name] = parsed
    return checked


def _read_notebook(path: str | Path) -> dict[str, Any]:
    content = _load_json(Path(path))
    if not isinstance(content, dict) or not isinstance(content.get("cells"), list):
        raise ValueError(f"{path}: not a notebook of format 4")
    return content


def _load_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot read ({error.strerror})") from None
    except ValueError:
        raise ValueError(f"{path}: not valid JSON") from None


def _tags(cell: Mapping[str, Any]) -> Sequence[str]:
    return cell.get("metadata", {}).get("tags", ())


# --- running


@dataclass
class Run:
    """One notebook with one set of parameters, and the folder of its results."""

    notebook: str
    source: bytes = field(repr=False)
    overrides: dict[str, Any]
    inputs: dict[str, Any] = field(repr=False)
    folder: Path
    manifest: dict[str, Any] = field(default_factory=dict, repr=False)
    skipped: bool = False

    @property
    def metrics(self) -> Metrics:
        """Rows of ``metrics.csv``, all values as text."""
        return [{"notebook": self.notebook, **row} for row in self.manifest["metrics"]]


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

        rows = sorted((row for run in self.runs for row in run.metrics), key=_order)
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
    _execute([run for run in runs if not run.skipped], jobs, home, progress)
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
    versions = {"occlib": occlib.__version__, "cv2": cv2.__version__, "python": platform.python_version()}
    versions |= {library: importlib.metadata.version(library) for library in _LIBRARIES}
    versions |= {"platform": f"{platform.system()} {platform.machine()}"}
    shared = {"versions": versions, "occlib_sha256": _folder_hash(PACKAGE)}
    shared |= {"data_sha256": _folder_hash(home / "data" / "lab")}
    runs = []
    for path in select_notebooks(notebooks, home):
        defaults = notebook_parameters(path)
        values = _override(path.stem, defaults, given)
        overrides = {name: value for name, value in values.items() if value != defaults[name]}
        chosen = {**defaults, **overrides}
        mark = hashlib.sha256(json.dumps(chosen, sort_keys=True).encode()).hexdigest()[:8]
        suffix = "" if not overrides else "__fast" if list(overrides) == ["fast"] else f"__{mark}"
        source = path.read_bytes()
        inputs = {"parameters": chosen, "notebook_sha256": hashlib.sha256(source).hexdigest(), **shared}
        runs.append(Run(path.stem, source, overrides, inputs, home / "runs" / f"{path.stem}{suffix}"))
    return runs


def _folder_hash(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            digest.update(f"{path.relative_to(folder).as_posix()}\0{_file_hash(path)}\n".encode())
    return digest.hexdigest()


def _file_hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _is_current(run: Run) -> bool:
    """Whether the folder holds the complete results of exactly these inputs; then they are loaded."""
    with suppress(ValueError, TypeError, KeyError, AttributeError):
        manifest = _load_json(run.folder / "manifest.json")
        files = manifest["files"].items()
        if manifest["inputs"] == run.inputs and all(_file_hash(run.folder / name) == value for name, value in files):
            run.manifest = manifest
            return True
    return False


def _execute(runs: Sequence[Run], jobs: int, home: Path, progress: bool) -> None:
    """Run each notebook in a process of its own, at most ``jobs`` at a time; after a failure start no more."""
    from tqdm import tqdm

    queue = list(runs)
    failures: list[str] = []
    running: dict[subprocess.Popen[bytes], tuple[Run, Path, float]] = {}
    bar = tqdm(total=len(runs), unit="notebook", disable=not (progress and runs), file=sys.stderr)
    with bar, tempfile.TemporaryDirectory(prefix="occlib-", ignore_cleanup_errors=True) as scratch, _stoppable():
        try:
            while running or (queue and not failures):
                while queue and len(running) < jobs and not failures:
                    run = queue.pop(0)
                    work = Path(scratch) / run.folder.name
                    running[_start(run, work)] = (run, work, time.monotonic())
                    bar.set_description(", ".join(run.notebook for run, _, _ in running.values()))
                for process in [process for process in running if process.poll() is not None]:
                    run, work, started = running.pop(process)
                    if process.returncode:
                        failures.append(f"{run.notebook}: {_failure(run, work, home)}")
                    else:
                        _collect(run, work, time.monotonic() - started)
                    bar.update()
                time.sleep(0.02)
        finally:
            for process in running:
                _kill(process)
    if failures:
        others = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        raise ValueError(failures[0] + others)


@contextmanager
def _stoppable() -> Iterator[None]:
    """Let SIGTERM (``timeout``, a closing terminal) stop the notebooks as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


def _start(run: Run, work: Path) -> subprocess.Popen[bytes]:
    kernel = {"argv": [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"], "language": "python"}
    kernel["display_name"] = "occlib"
    write_file(work / "jupyter/kernels/python3/kernel.json", json.dumps(kernel))
    write_file(work / "cwd/matplotlibrc", "")
    write_file(work / "source.ipynb", run.source)
    results = work / run.notebook
    results.mkdir()
    python_path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    environment = os.environ | dict.fromkeys(_ONE_THREAD, "1")
    environment |= {"OCCLIB_RUN_DIR": str(results), "PYTHONPATH": python_path, "PYTHONHASHSEED": "0"}
    environment |= {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    own = {"MATPLOTLIBRC": "cwd/matplotlibrc", "JUPYTER_PATH": "jupyter", "JUPYTER_CONFIG_DIR": "config"}
    own |= {"JUPYTER_RUNTIME_DIR": "runtime", "IPYTHONDIR": "ipython"} | dict.fromkeys(("TMPDIR", "TMP", "TEMP"), ".")
    environment |= {name: str(work / path) for name, path in own.items()}
    code = "import sys; from occlib.experiments import _work; _work(*sys.argv[1:])"
    command = [sys.executable, "-c", code, str(work), f"{run.notebook}.ipynb", json.dumps(run.overrides)]
    with (work / "log.txt").open("wb") as log:
        options: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": subprocess.STDOUT}
        return subprocess.Popen(command, cwd=work, env=environment, start_new_session=True, **options)


def _work(folder: str, output: str, parameters: str) -> None:
    """The process of one notebook: papermill, and the reason in ``error.json`` where a cell failed."""
    import papermill

    work = Path(folder)
    options = {"kernel_name": "python3", "language": "python", "progress_bar": False, "cwd": work / "cwd"}
    try:
        papermill.execute_notebook(work / "source.ipynb", work / output, json.loads(parameters), **options)
    except papermill.PapermillExecutionError as error:
        line = next(iter(error.source.strip().splitlines()), "")
        what = f"{error.ename}: {error.evalue}".strip().splitlines()[0]
        write_file(work / "error.json", json.dumps(f"cell {error.exec_count} ({line[:60].strip()}) failed: {what}"))
        sys.exit(1)


def _failure(run: Run, work: Path, home: Path) -> str:
    """What went wrong, in one line; the half-executed copy is kept beside the last good results."""
    if (work / "error.json").exists():
        reason = str(_load_json(work / "error.json"))
    else:
        log = (work / "log.txt").read_text(encoding="utf-8", errors="replace").strip()
        reason = f"stopped: {log.splitlines()[-1] if log else 'no message'}"
    half = work / f"{run.notebook}.ipynb"
    if half.exists():
        write_file(run.folder / "failed.ipynb", half.read_bytes())
        reason += f"; see {(run.folder / 'failed.ipynb').relative_to(home)}"
    return reason


def _collect(run: Run, work: Path, seconds: float) -> None:
    """Replace the folder of results; the manifest comes last and vouches for every other file."""
    results = work / run.notebook
    recorded = results / "metrics.json"
    metrics = sorted(_load_json(recorded), key=_order) if recorded.exists() else []
    recorded.unlink(missing_ok=True)  # the manifest has them
    shutil.move(work / f"{run.notebook}.ipynb", results)
    files = {path.name: _file_hash(path) for path in sorted(results.iterdir())}
    run.manifest = {"inputs": run.inputs, "seconds": round(seconds, 1), "files": files, "metrics": metrics}
    try:
        shutil.rmtree(run.folder, ignore_errors=True)
        shutil.copytree(results, run.folder, dirs_exist_ok=True)
    except (OSError, shutil.Error) as error:
        raise ValueError(f"{run.folder}: cannot write the results ({error})") from None
    write_file(run.folder / "manifest.json", json.dumps(run.manifest, indent=1))


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a notebook's process and its kernel, which lives in a session of its own."""
    import psutil

    with suppress(psutil.NoSuchProcess):
        for child in psutil.Process(process.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                child.kill()
    process.kill()
    process.wait()


# --- publishing and checking


def _order(row: Mapping[str, str]) -> tuple[str, str]:
    return row.get("notebook", ""), row["metric"]


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
    table.writerows(sorted(rows + [row for run in runs for row in run.metrics], key=_order))
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
            for name in changed:
                os.replace(Path(aside) / name, figures / name)
            for name in stale:
                (figures / name).unlink()
    except OSError as error:
        raise ValueError(f"{figures}: cannot write ({error.strerror})") from None
    return [*changed, *(f"{name} (removed)" for name in stale)]


def _differences(home: Path, runs: Sequence[Run]) -> list[str]:
    """One line for each metric that is out of tolerance, new or missing, and each figure new or missing."""
    names = {run.notebook for run in runs}
    before = {_order(row): row for row in _published_metrics(home) if row["notebook"] in names}
    after = {_order(row): row for run in runs for row in run.metrics}
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


# --- student copies


def student_copy(notebook: str | Path, out: str | Path) -> Path:
    """Write a notebook without its solutions: each cell tagged ``solution`` becomes an empty one to fill in."""
    content = _read_notebook(notebook)
    stubs = {"code": "# Your solution here", "markdown": "*Your answer here.*"}
    for cell in content["cells"]:
        if cell["cell_type"] == "code":
            cell.update(outputs=[], execution_count=None)
        if "solution" in _tags(cell):
            cell.pop("attachments", None)
            cell["source"] = [stubs.get(cell["cell_type"], "")]
            cell["metadata"] = {"tags": ["exercise"]}
    return write_file(out, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def student_copies(out: str | Path, root: str | Path | None = None) -> list[Path]:
    """A student copy of every notebook, below ``out``."""
    return [student_copy(path, Path(out) / path.name) for path in select_notebooks(None, root)]
