"""Which notebooks there are, with which parameters, whether their results are current, and one process for each.

A notebook runs in an empty scratch folder, one thread, without the user's Jupyter or matplotlib settings, and with the
Python that runs this. Its executed copy, figures, metrics and manifest go to ``runs/<notebook>/``.
"""

from __future__ import annotations

import ast
import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

import occlib
from occlib.base.extras import check_extra, import_extra
from occlib.base.files import file_hashes, folder_hash, load_json, sha256, write_file
from occlib.base.interrupts import stoppable
from occlib.recordings import LAB, cache_folder, public_recordings

PACKAGE = Path(__file__).resolve().parents[1]

_LIBRARIES = ("numpy", "scipy", "scikit-image", "matplotlib", "pandas", "ipykernel", "papermill")
"""Whose versions a notebook's results depend on."""

_ONE_THREAD = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"),
    *("VECLIB_MAXIMUM_THREADS", "OPENCV_FOR_THREADS_NUM"),
)

Metrics = list[dict[str, str]]
"""Rows of ``metrics.csv``, each with :data:`COLUMNS`, all values as text."""

IMAGE_DESCRIPTION = 0x010E
"""The Exif field of a film that names the notebook that made it; a PNG says so in its text ``Source``."""

COLUMNS = ("notebook", "metric", "value", "unit", "tolerance")


def find_root(start: str | Path | None = None) -> Path:
    """The project's folder: the one with ``notebooks/`` that holds the package, else above ``start`` (or here)."""
    here = Path(start or Path.cwd()).resolve()
    for folder in (PACKAGE.parent, here, *here.parents):
        if (folder / "notebooks").is_dir():
            return folder
    raise ValueError(f"no notebooks/ folder in or above {here}: run this in the project's folder")


def check_copy(root: Path) -> None:
    """``ValueError`` if this package is a copy, as of ``pip install .``, and not the same as the project's own."""
    own = root / PACKAGE.name
    if own.is_dir() and own != PACKAGE and folder_hash(own, "*.py") != folder_hash(PACKAGE, "*.py"):
        raise ValueError(f"occlib runs from {PACKAGE}, a copy that differs from {own}; first: pip install -e .")


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
    cells = [cell for cell in read_notebook(path)["cells"] if "parameters" in tags(cell)]
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


def override(notebook: str, defaults: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
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


def read_notebook(path: str | Path) -> dict[str, Any]:
    content = load_json(Path(path))
    if not isinstance(content, dict) or not isinstance(content.get("cells"), list):
        raise ValueError(f"{path}: not a notebook of format 4")
    return content


def tags(cell: Mapping[str, Any]) -> Sequence[str]:
    return cell.get("metadata", {}).get("tags", ())


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


def order(row: Mapping[str, str]) -> tuple[str, str]:
    """Sorting key of a row of ``metrics.csv``."""
    return row.get("notebook", ""), row["metric"]


def plan_runs(home: Path, notebooks: Iterable[str | Path] | None, given: Mapping[str, Any]) -> list[Run]:
    """The run of each notebook with the given parameters: its folder, and all that its results depend on."""
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
        mark = sha256(json.dumps(chosen, sort_keys=True))[:8]
        suffix = "" if not overrides else "__fast" if list(overrides) == ["fast"] else f"__{mark}"
        source = path.read_bytes()
        inputs = {"parameters": chosen, "notebook_sha256": sha256(source), **shared}
        if b"load_claims" in source:
            inputs["ledger_sha256"] = _ledger_hash(home, path.stem)
        runs.append(Run(path.stem, source, overrides, inputs, home / "runs" / f"{path.stem}{suffix}"))
    return runs


def _ledger_hash(home: Path, notebook: str) -> str:
    """Of what a chapter that shows the ledger reads besides: the claims, and the numbers that the others have published."""
    files = [path for path in (home / "docs/claims.yaml", home / "figures/metrics.csv") if path.exists()]
    lines = [line for path in files for line in path.read_text(encoding="utf-8").splitlines()]
    return sha256("\n".join(line for line in lines if not line.startswith(f"{notebook},")))


def is_current(run: Run) -> bool:
    """Whether the folder holds the complete results of exactly these inputs; then they are loaded."""
    with suppress(ValueError, TypeError, KeyError, AttributeError):
        manifest = load_json(run.folder / "manifest.json")
        if manifest["inputs"] == run.inputs and manifest["files"].items() <= file_hashes(run.folder).items():
            run.manifest = manifest
            return True
    return False


def execute(runs: Sequence[Run], jobs: int, home: Path, progress: bool) -> None:
    """Run each notebook in a process of its own, at most ``jobs`` at a time; after a failure start no more."""
    from tqdm import tqdm

    queue = list(runs)
    failures: list[str] = []
    running: dict[subprocess.Popen[bytes], tuple[Run, Path, float]] = {}
    bar = tqdm(total=len(runs), unit="notebook", disable=not (progress and runs), file=sys.stderr)
    with bar, tempfile.TemporaryDirectory(prefix="occlib-", ignore_cleanup_errors=True) as scratch, stoppable():
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
    environment["OCCLIB_OWN_PARAMETERS"] = str(int(set(run.overrides) <= {"fast"}))
    environment |= {"OCCLIB_LAB": str(LAB), "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    own = {"MATPLOTLIBRC": "cwd/matplotlibrc", "JUPYTER_PATH": "jupyter", "JUPYTER_CONFIG_DIR": "config"}
    own |= {"JUPYTER_RUNTIME_DIR": "runtime", "IPYTHONDIR": "ipython"} | dict.fromkeys(("TMPDIR", "TMP", "TEMP"), ".")
    environment |= {name: str(work / path) for name, path in own.items()}
    code = "import sys; from occlib.reproduce.runner import _work; _work(*sys.argv[1:])"
    command = [sys.executable, "-c", code, str(work), f"{run.notebook}.ipynb", json.dumps(run.overrides)]
    with (work / "log.txt").open("wb") as log:
        options: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": subprocess.STDOUT}
        return subprocess.Popen(command, cwd=work, env=environment, start_new_session=True, **options)


def _work(folder: str, output: str, parameters: str) -> None:
    """The process of one notebook: papermill, and the reason in ``error.json`` where a cell failed."""
    import papermill
    from nbclient import NotebookClient

    # nbclient answers an Output widget (a slider has one) on the channel that it waits on for the cell's end; now and
    # then it misses that end and waits for ever. Without an answer the slider's picture is an output as any other.
    NotebookClient.on_comm_open_jupyter_widget = lambda self, msg: None  # type: ignore[method-assign]
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
    half = work / f"{run.notebook}.ipynb"
    if (work / "error.json").exists():
        reason = str(load_json(work / "error.json"))
    else:
        log = (work / "log.txt").read_text(encoding="utf-8", errors="replace").strip()
        reason = f"stopped: {log.splitlines()[-1] if log else 'no message'}"
        if half.exists():  # a kernel that died says nothing: the first cell without a number was running
            code = [cell for cell in read_notebook(half)["cells"] if cell["cell_type"] == "code"]
            number = next((i for i, cell in enumerate(code, 1) if not cell.get("execution_count")), len(code))
            reason = f"cell {number} {reason}"
    if half.exists():
        write_file(run.folder / "failed.ipynb", half.read_bytes())
        reason += f"; see {(run.folder / 'failed.ipynb').relative_to(home)}"
    return reason


def _collect(run: Run, work: Path, seconds: float) -> None:
    """Replace the folder of results; the manifest comes last and vouches for every other file."""
    results = work / run.notebook
    recorded = results / "metrics.json"
    metrics = sorted(load_json(recorded), key=order) if recorded.exists() else []
    recorded.unlink(missing_ok=True)  # the manifest has them
    shutil.move(work / f"{run.notebook}.ipynb", results)
    seconds = round(seconds, 1)
    run.manifest = {"inputs": run.inputs, "seconds": seconds, "files": file_hashes(results), "metrics": metrics}
    try:
        shutil.rmtree(run.folder, ignore_errors=True)
        shutil.copytree(results, run.folder, dirs_exist_ok=True)
    except (OSError, shutil.Error) as error:
        raise ValueError(f"{run.folder}: cannot write the results ({error})") from None
    write_file(run.folder / "manifest.json", json.dumps(run.manifest, indent=1))


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a notebook's process and its kernel, which lives in a session of its own."""
    psutil = import_extra("psutil", "notebooks")
    with suppress(psutil.NoSuchProcess):
        for child in psutil.Process(process.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                child.kill()
    process.kill()
    process.wait()
