"""Sweeps: many independent batches, in this process, in several or on a Dask cluster, with the same result.

A *batch* is a few seconds of work: a small frozen object with a ``key``, turned into a table by a pure function.
The main process writes each finished table to ``OUT/batches/<key>.csv``, whole, with a last line that says what it was
made of, so a sweep that was stopped goes on where it was. At the end it joins them, in the order of the batches, to
``OUT/trials.csv``. Whoever does the work does it with one thread and hands back text: the same bytes everywhere.

The processes are joblib's. Its ``Memory`` is not used: it keeps results as pickles, and a folder of results that comes
from elsewhere must not run code. Nor is its Dask backend: it waits for ever for a batch that kills its worker.
"""

from __future__ import annotations

import importlib.metadata
import io
import json
import logging
import os
import platform
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from tqdm import tqdm

from occlib.base.extras import check_extra, import_extra
from occlib.base.extras import pandas as pd
from occlib.base.files import file_hash, folder_hash, sha256, staged_folder, write_file
from occlib.base.interrupts import stoppable, uninterrupted
from occlib.matching.measures import METHODS
from occlib.matching.registry import load_matchers
from occlib.plotting import figure_png
from occlib.recordings import open_recording
from occlib.study import charts, tables
from occlib.study.trials import PHOTOGRAPHS, known_names
from occlib.study.work import batches, run_batch

__all__ = ["Sweep", "load_matchers", "run_batches", "sweep", "versions"]

LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "scikit-image", "scikit-learn", "numba", "pandas")
CONNECT_S = 5  # a scheduler that does not answer within this is not there
PATIENCE_S = 30  # a cluster that has no worker for so long has none
POLL_S = 0.05  # between two looks of a worker whether the main process still lives


class Unit(Protocol):
    """One unit of work: small, frozen, picklable; its ``repr`` is its definition."""

    @property
    def key(self) -> str:
        """A name for files, its own."""


Done: TypeAlias = tuple[str, str, str]  # key, table as CSV, and in one line what went wrong
Work: TypeAlias = "Callable[[Unit], Done]"

_ALONE = threading.Lock()  # number of threads and registered matchers are the process's: one batch at a time in each


def run_batches(
    batches: Sequence[Unit],
    function: Callable[[Any], pd.DataFrame],
    out: str | Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    inputs: Mapping[str, Any] | None = None,
    tables: Callable[[pd.DataFrame], Mapping[str, pd.DataFrame]] | None = None,
    progress: bool = True,
) -> pd.DataFrame:
    """Run the batches that ``out`` does not hold yet and join all of them to ``out/trials.csv``.

    Parameters
    ----------
    batches
        Picklable, each with a ``key`` of its own, a file name; the ``repr`` is the batch's definition.
    function
        ``function(batch)`` returns a table with the same columns for each batch, and depends on nothing but the
        batch and ``inputs``. Functions from a run file travel to the workers by value.
    out
        A folder. One sweep at a time may use it.
    jobs
        Processes on this machine; 1 is this process.
    scheduler
        Address of a Dask scheduler whose workers do the work instead. They must have this Python, this occlib and
        these libraries.
    inputs
        What else the results depend on, as JSON: a finished batch is kept only if it was made with the same.
    tables
        Further tables by file name, made from the trials and written together with them.
    progress
        Show a bar on stderr, and say what is kept and what is done again.

    Returns
    -------
    The trials as they stand in ``trials.csv``; ``manifest.json`` beside it says what they were made with.

    Raises
    ------
    ValueError
        In one line: a wrong argument, a batch that failed, workers that died, no scheduler, a folder that cannot be
        written or is in use. Finished batches are kept.
    KeyboardInterrupt
        On Ctrl-C, SIGTERM or SIGHUP; its message says how to go on. No worker is left behind.
    """
    _check(batches, jobs, scheduler)
    for package in ("joblib", "pandas", "psutil", "threadpoolctl"):
        check_extra(package, "study")
    folder, made_of = Path(out) / "batches", {**versions(), **(inputs or {})}
    work = partial(_work, function, versions())
    with _locked(folder), stoppable():
        texts, stale = _kept(folder, batches, made_of)
        if progress and (texts or stale):
            again = f", {stale} done again (damaged, or made with other code, libraries or options)" if stale else ""
            print(f"{out}: {len(texts)} of {len(batches)} batches kept{again}")
        todo = {batch.key: batch for batch in batches if batch.key not in texts}
        done = _results(work, list(todo.values()), jobs, scheduler)
        bar = tqdm(total=len(batches), initial=len(texts), unit="batch", disable=None if progress else True)
        try:
            with bar, closing(done):
                for key, text, problem in done:
                    if problem:
                        raise ValueError(f"batch {key}: {problem}")
                    write_file(folder / f"{key}.csv", _sealed(text, todo[key], made_of))
                    texts[key] = text
                    bar.update()
        except KeyboardInterrupt:
            kept = f"{len(texts)} of {len(batches)} batches are kept in {out}"
            raise KeyboardInterrupt(f"interrupted; {kept}, the same command goes on from there") from None
        return _publish(Path(out), {batch.key: texts[batch.key] for batch in batches}, made_of, tables)


def _check(batches: Sequence[Unit], jobs: int, scheduler: str | None) -> None:
    if not batches:
        raise ValueError("batches: expected one or more, got none")
    if not isinstance(jobs, int) or jobs < 1:
        raise ValueError(f"jobs: expected a whole number >= 1, got {jobs}")
    if scheduler is not None and "://" not in scheduler:
        raise ValueError(f"scheduler: expected an address such as tcp://127.0.0.1:8786, got {scheduler!r}")
    if scheduler is not None and jobs > 1:
        raise ValueError("jobs: the workers of a scheduler are its own; give either jobs or a scheduler")


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """The code and the libraries of this process: results of others are not mixed with its own."""
    found = {"occlib": folder_hash(Path(__file__).resolve().parents[1], "*.py"), "python": platform.python_version()}
    found["platform"] = f"{platform.system()} {platform.machine()}"
    for library in LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[library] = importlib.metadata.version(library)
    return found


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """A folder for this sweep alone, made where it is missing, and then removed again if it stays empty."""
    made = [path for path in (folder, folder.parent) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{folder}: cannot write ({error.strerror})") from None
    handle = None
    try:
        if sys.platform != "win32":
            import fcntl

            handle = os.open(folder, os.O_RDONLY)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until it is closed, if only by a kill
            except BlockingIOError:
                raise ValueError(
                    f"{folder.parent}: another sweep is running there; wait for it, or give --out"
                ) from None
            except OSError:
                pass  # some network file systems cannot lock folders: then the user takes care
        yield
    finally:
        for empty in made:
            with suppress(OSError):  # rmdir takes empty folders only
                empty.rmdir()
        if handle is not None:
            os.close(handle)


def _sealed(text: str, batch: Unit, made_of: Mapping[str, Any]) -> str:
    """A table with a last line that vouches for it: made of what, and its hash."""
    seal = {"batch": repr(batch), **made_of, "sha256": sha256(text)}
    return f"{text}# {json.dumps(seal)}\n"


def _kept(folder: Path, batches: Sequence[Unit], made_of: Mapping[str, Any]) -> tuple[dict[str, str], int]:
    """The tables that are there, whole and made of the same, by the batches' keys; and how many others are there."""
    texts, stale = {}, 0
    for batch in batches:
        with suppress(FileNotFoundError):
            content = (folder / f"{batch.key}.csv").read_bytes().decode(errors="replace")
            text = content.rpartition("\n# ")[0] + "\n"
            if content == _sealed(text, batch, made_of):
                texts[batch.key] = text
            else:
                stale += 1
    return texts, stale


def _publish(
    out: Path,
    texts: Mapping[str, str],
    made_of: Mapping[str, Any],
    tables: Callable[[pd.DataFrame], Mapping[str, pd.DataFrame]] | None,
) -> pd.DataFrame:
    """Join the tables and write what is made of them: all files or none."""
    heads = {key: text.partition("\n")[0] for key, text in texts.items()}
    first = next(iter(heads.values()))
    if odd := [key for key, head in heads.items() if head != first]:
        raise ValueError(f"batch {odd[0]}: expected the columns {first}, got {heads[odd[0]]}")
    joined = "".join([first, "\n", *(text.partition("\n")[2] for text in texts.values())])
    # Only an empty field is missing: a condition may well be called "none". Newer pandas reads floats exactly anyway.
    exact: Any = {} if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else {"float_precision": "round_trip"}
    trials = pd.read_csv(io.StringIO(joined), keep_default_na=False, na_values=[""], **exact)
    contents = {"trials.csv": joined, "manifest.json": json.dumps(made_of, indent=1) + "\n"}
    contents |= {name: _csv(table) for name, table in (tables(trials) if tables else {}).items()}
    with uninterrupted(), staged_folder(out) as stage:
        for name, text in contents.items():
            write_file(stage / name, text)
    return trials


def _csv(table: pd.DataFrame) -> str:
    return str(table.to_csv(index=False, lineterminator="\n"))


def _work(function: Callable[[Any], pd.DataFrame], expected: Mapping[str, str], batch: Unit) -> Done:
    """One batch, here or in a worker, with one thread: its table, or in one line what went wrong."""
    try:
        if other := [name for name, version in versions().items() if version != expected.get(name)]:
            raise ValueError(f"the worker has another {', '.join(other)} than this process")
        with (
            _ALONE,
            import_extra("threadpoolctl", "study").threadpool_limits(1),
        ):  # sums in the same order, and no two workers for one core
            return batch.key, _csv(function(batch)), ""
    except (Exception, SystemExit) as error:  # text comes back: no exception fails to travel
        return batch.key, "", _one_line(error)


def _one_line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


def _results(work: Work, batches: Sequence[Unit], jobs: int, scheduler: str | None) -> Generator[Done, None, None]:
    """What becomes of each batch, as soon as it is known."""
    if scheduler and batches:
        return _on_cluster(work, batches, scheduler)
    if min(jobs, len(batches)) > 1:
        return _in_processes(work, batches, min(jobs, len(batches)))
    return (work(batch) for batch in batches)


def _in_processes(work: Work, batches: Sequence[Unit], jobs: int) -> Generator[Done, None, None]:
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky import get_reusable_executor

    done: Any = None
    try:
        with parallel_config("loky", initializer=_begin_worker, initargs=(os.getpid(),)):
            parallel = Parallel(n_jobs=jobs, batch_size=1, max_nbytes=None, return_as="generator_unordered")
            done = parallel(delayed(work)(batch) for batch in batches)
        for one in done:  # noqa: UP028 - `yield from` would close it while joblib's warnings are still on
            yield one
    except BrokenExecutor:
        raise ValueError("a worker was killed or crashed (out of memory?); fewer jobs need less of it") from None
    finally:
        with uninterrupted(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # joblib would tell of the batches that are not wanted any more
            if done is not None:
                done.close()
            get_reusable_executor().shutdown(wait=True, kill_workers=True)


def _begin_worker(parent: int) -> None:
    """Leave Ctrl-C to the main process, and end with it even where it was killed."""
    for name in {"SIGINT", "SIGTERM", "SIGHUP"} & set(dir(signal)):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent, os.getppid()), daemon=True).start()


def _end_with(parent: int, adopted_by: int) -> None:
    psutil = import_extra("psutil", "study")
    while psutil.pid_exists(parent) and os.getppid() == adopted_by:  # the dead have a pid until somebody asks for them
        time.sleep(POLL_S)
    os._exit(1)


def _on_cluster(work: Work, batches: Sequence[Unit], scheduler: str) -> Generator[Done, None, None]:
    distributed = import_extra("distributed", "dask")
    for name in ("distributed", "distributed.client"):  # what goes wrong is told here, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except Exception:  # refused, timed out, or something else at that address
        raise ValueError(f"scheduler {scheduler!r}: no answer within {CONNECT_S} s") from None
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
        futures = client.map(work, batches, pure=False)  # pure: it would answer with what another sweep computed
        keys = {future: batch.key for future, batch in zip(futures, batches, strict=True)}
        for future in distributed.as_completed(futures, loop=client.loop):
            problem = future.exception()  # the cluster has given the batch up, or cannot load it
            yield (keys[future], "", _one_line(problem)) if problem else future.result()
    except (CancelledError, distributed.CancelledError):
        raise ValueError(f"scheduler {scheduler!r}: the connection was lost") from None
    except TimeoutError:
        raise ValueError(
            f"scheduler {scheduler!r}: no worker for {PATIENCE_S} s; start some with dask worker"
        ) from None
    finally:
        with uninterrupted(), suppress(Exception):  # a client that lost its scheduler cannot even say good-bye
            client.close(timeout=CONNECT_S)  # which cancels what is not finished


# --- the whole study ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Sweep:
    """What :func:`sweep` found, and the names of the files that it wrote into ``out``."""

    out: Path
    trials: pd.DataFrame
    summary: pd.DataFrame
    thresholds: pd.DataFrame
    verdicts: pd.DataFrame
    files: tuple[str, ...]


def sweep(
    out: str | Path,
    preset: str = "full",
    *,
    seeds: Iterable[int] | None = None,
    sides: Iterable[int] | None = None,
    conditions: Iterable[str] | None = None,
    sources: Iterable[str] | None = None,
    methods: Iterable[str] | None = None,
    matchers: str | Path | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: bool = True,
) -> Sweep:
    """The study in full, kept on disk: goes on where it was stopped.

    Parameters
    ----------
    out
        A folder. Gets ``trials.csv`` (columns: :func:`run_batch`), ``summary.csv`` (:func:`occlib.study.tables.summarise`),
        ``thresholds.csv``, ``verdicts.csv``, ``manifest.json`` (what they were made with), ``verdicts.png``, ``recall.png``
        unless each condition has one level only, and ``batches/``, the finished work.
    preset, seeds, sides, conditions, sources
        As for :func:`batches`; by default those of the preset.
    methods
        Names of measures, by default all.
    matchers
        A file that registers measures of your own, see :func:`occlib.matching.registry.load_matchers`. What it imports is
        not watched for changes.
    jobs, scheduler, progress
        As for :func:`occlib.study.sweeps.run_batches`. The results do not depend on them.

    Raises
    ------
    ValueError, KeyboardInterrupt
        As :func:`batches` and :func:`occlib.study.sweeps.run_batches`.
    """
    own = load_matchers(matchers) if matchers else {}
    names = known_names(METHODS if methods is None else methods, METHODS, "methods")
    work = batches(preset, seeds=seeds, sides=sides, conditions=conditions, sources=sources)
    recorded = sorted({batch.source for batch in work} - set(PHOTOGRAPHS))
    inputs = {
        "methods": names,
        "matchers": file_hash(Path(matchers)) if matchers else "",
        "recordings": {name: folder_hash(open_recording(name).path) for name in recorded},
    }
    made: dict[str, pd.DataFrame] = {}

    def tables_of(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
        made.update({"summary": tables.summarise(table), "thresholds": tables.thresholds(table)})
        made["verdicts"] = tables.verdicts(table)
        return {f"{name}.csv": frame for name, frame in made.items()}

    function = partial(run_batch, methods=tuple(own.get(name, name) for name in names))
    options: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler, "progress": progress}
    found = run_batches(work, function, out, inputs=inputs, tables=tables_of, **options)
    pictures = {"verdicts.png": charts.verdict_figure(made["verdicts"])}
    (Path(out) / "recall.png").unlink(missing_ok=True)
    if made["summary"].groupby("condition")["level"].nunique().max() > 1:  # one level a condition draws no curve
        pictures["recall.png"] = charts.level_curves(made["summary"])
    for name, picture in pictures.items():
        write_file(Path(out) / name, figure_png(picture))
    files = ("trials.csv", *(f"{name}.csv" for name in made), *pictures)
    return Sweep(Path(out), found, **made, files=files)
