"""Sweeps: many independent batches, in this process, in several or on a Dask cluster, with the same result.

A *batch* is a few seconds of work: a small frozen object with a ``key``, turned into a table by a pure function.
The main process writes each finished table to ``OUT/batches/<key>.csv`` and vouches for it in ``OUT/manifest.json``,
so a sweep that was stopped goes on where it was; at the end it joins them, in the order of the batches, to
``OUT/trials.csv``. Whoever does the work, it does so with one thread, and hands back text: the same bytes everywhere.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.metadata
import io
import itertools
import json
import logging
import os
import platform
import re
import runpy
import signal
import sys
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

from occlib.base.extras import check_extra, import_extra
from occlib.base.files import folder_hash, load_json, staged_folder, write_file
from occlib.base.interrupts import stoppable, uninterrupted

if TYPE_CHECKING:
    import pandas as pd


PACKAGE = Path(__file__).resolve().parents[1]
TRIALS = "trials.csv"


CONNECT_S = 5  # a scheduler that does not answer within this is not there


PATIENCE_S = 30  # a cluster without a worker for so long has lost them


POLL_S = 0.05


_ALONE = threading.Lock()  # number of threads and registered matchers are the process's: one batch at a time in each


_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "scikit-image", "scikit-learn", "numba", "pandas")


class Keyed(Protocol):
    """What a batch must have: a key that is a file name, and a ``repr`` that says all that it stands for."""

    @property
    def key(self) -> str: ...


B = TypeVar("B", bound=Keyed)


Done: TypeAlias = tuple[str, str, str]  # key, table as CSV, what went wrong


Work: TypeAlias = Callable[[Any], Done]


def run_batches(
    batches: Sequence[B],
    function: Callable[[B], pd.DataFrame],
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
        Picklable, each with a ``key`` of its own; its ``repr`` is its definition.
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
    The trials as they stand in ``trials.csv``.

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
    expected = versions()
    with _locked(Path(out)), stoppable():
        store = _Store(Path(out), json.loads(json.dumps({"versions": expected, **(inputs or {})})))
        texts = store.kept(batches, say=print if progress else lambda line: None)
        todo = [batch for batch in batches if batch.key not in texts]
        work = partial(_work, function, expected)
        try:
            for key, text in _results(work, todo, len(batches), jobs, scheduler, progress):
                store.keep(key, text)
                texts[key] = text
        except KeyboardInterrupt:
            kept = f"{len(texts)} of {len(batches)} batches are kept in {out}"
            raise KeyboardInterrupt(f"interrupted; {kept}, the same command goes on from there") from None
        return _publish(Path(out), {batch.key: texts[batch.key] for batch in batches}, tables)


def load_matchers(path: str | Path) -> dict[str, Any]:
    """Run a file that registers matchers (:func:`occlib.matching.registry.matcher`); those that are new, by name.

    Their functions travel to the workers by value, with whatever of the file they use; modules that they import
    must be installed there.
    """
    from occlib.matching.measures import METHODS

    before = dict(METHODS)
    try:
        runpy.run_path(str(path))
    except (Exception, SystemExit) as error:
        reason = getattr(error, "strerror", None) if isinstance(error, OSError) else None
        raise ValueError(f"{path}: {reason or ' '.join(f'{type(error).__name__}: {error}'.split())}") from None
    found = {name: method for name, method in METHODS.items() if before.get(name) is not method}
    if not found:
        raise ValueError(f"{path}: registers no matcher; expected a function under @matching.matcher(...)")
    return found


def _check(batches: Sequence[Keyed], jobs: int, scheduler: str | None) -> None:
    keys = [batch.key for batch in batches]
    if not keys:
        raise ValueError("batches: expected one or more, got none")
    if wrong := [key for key in keys if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.,=+-]{0,199}", key)]:
        raise ValueError(f"batch {wrong[0]!r}: expected a key that is a file name")
    if len({key.casefold() for key in keys}) < len(keys):
        raise ValueError(f"batch {max(keys, key=keys.count)!r}: expected a key of its own")
    if not isinstance(jobs, int) or jobs < 1:
        raise ValueError(f"jobs: expected a whole number >= 1, got {jobs}")
    if scheduler is not None and not re.fullmatch(r"(tcp|tls|wss?)://\S+:\d+", scheduler):
        raise ValueError(f"scheduler: expected an address such as tcp://127.0.0.1:8786, got {scheduler!r}")
    if scheduler is not None and jobs > 1:
        raise ValueError("jobs: the workers of a scheduler are its own; give either jobs or a scheduler")


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """The code and the libraries of this process: results of others are not mixed with its own."""
    found = {"occlib": folder_hash(PACKAGE, "*.py"), "python": platform.python_version()}
    found["platform"] = f"{platform.system()} {platform.machine()}"
    for library in _LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[library] = importlib.metadata.version(library)
    return found


def _differing(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    return [name for name in {**one, **other} if one.get(name) != other.get(name)]


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    """The folder for the finished batches, for this sweep alone."""
    folder, made = out / "batches", not out.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{folder}: cannot write ({error.strerror})") from None
    handle = _lock(folder)
    try:
        yield
    finally:
        for empty in (folder, out) if made else (folder,):
            with suppress(OSError):  # rmdir takes empty folders only
                empty.rmdir()
        if handle is not None:
            os.close(handle)


def _lock(folder: Path) -> int | None:
    """A handle that keeps other sweeps out until it is closed, if only by a kill: no lock file stays behind."""
    if sys.platform == "win32":
        return None
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise ValueError(f"{folder.parent}: another sweep is running there; wait for it, or give --out") from None
    except OSError:
        pass  # some network file systems cannot lock folders: then the user takes care
    return handle


@dataclass
class _Store:
    """Finished batches on disk, and the manifest that vouches for each: made of what, and the file's hash."""

    out: Path
    inputs: dict[str, Any]
    marks: dict[str, str] = field(default_factory=dict)
    vouched: dict[str, dict[str, str]] = field(default_factory=dict)

    def kept(self, batches: Sequence[Keyed], say: Callable[[str], object]) -> dict[str, str]:
        """The tables that are there, whole and made of the same; in one line what is not."""
        self.marks = {b.key: _hash(json.dumps([repr(b), self.inputs], sort_keys=True).encode()) for b in batches}
        before, reasons = self._load(), dict[str, int]()
        texts: dict[str, str] = {}
        for key, mark in self.marks.items():
            file, entry = self._file(key), self.vouched.get(key)
            content = file.read_bytes() if file.is_file() else None
            if entry is None or content is None:
                continue
            if entry["made_of"] != mark:
                names = ", ".join(before) or "batch definition"
                reasons[f"other {names}"] = reasons.get(f"other {names}", 0) + 1
            elif entry["sha256"] != _hash(content):
                reasons["damaged"] = reasons.get("damaged", 0) + 1
            else:
                texts[key] = content.decode()
        again = [f"{count} done again ({reason})" for reason, count in reasons.items()]
        if texts or again:
            say(", ".join([f"{self.out}: {len(texts)} of {len(batches)} batches kept", *again]))
        return texts

    def _load(self) -> list[str]:
        """Read the manifest and return which of the inputs are not those of now."""
        with suppress(
            ValueError, TypeError, KeyError, AttributeError
        ):  # none there, or damaged: it vouches for nothing
            manifest = load_json(self.out / "manifest.json")
            found = {k: {n: str(v[n]) for n in ("made_of", "sha256")} for k, v in manifest["batches"].items()}
            now, then = ({**i, **i["versions"], "versions": 0} for i in (self.inputs, manifest["inputs"]))
            self.vouched = found
            return _differing(now, then)
        return []

    def keep(self, key: str, text: str) -> None:
        """Write a finished table, and then the manifest: what it vouches for is there."""
        content = text.encode()
        write_file(self._file(key), content)
        self.vouched[key] = {"made_of": self.marks[key], "sha256": _hash(content)}
        manifest = {"inputs": self.inputs, "batches": self.vouched}
        write_file(self.out / "manifest.json", json.dumps(manifest, indent=1) + "\n")

    def _file(self, key: str) -> Path:
        return self.out / "batches" / f"{key}.csv"


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _publish(
    out: Path, texts: Mapping[str, str], tables: Callable[[pd.DataFrame], Mapping[str, pd.DataFrame]] | None
) -> pd.DataFrame:
    """Join the tables and write what is made of them: all files or none."""
    import pandas as pd

    heads = {key: text.partition("\n")[0] for key, text in texts.items()}
    first = next(iter(heads.values()))
    if odd := [key for key, head in heads.items() if head != first]:
        raise ValueError(f"batch {odd[0]}: expected the columns {first}, got {heads[odd[0]]}")
    joined = "".join([first, "\n", *(text.partition("\n")[2] for text in texts.values())])
    # Only an empty field is missing: a condition may well be called "none". Newer pandas reads floats exactly anyway.
    exact: Any = {} if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else {"float_precision": "round_trip"}
    trials = pd.read_csv(io.StringIO(joined), keep_default_na=False, na_values=[""], **exact)
    contents = {TRIALS: joined} | {name: _csv(table) for name, table in (tables(trials) if tables else {}).items()}
    with uninterrupted(), staged_folder(out) as stage:
        for name, text in contents.items():
            write_file(stage / name, text)
    return trials


def _csv(table: pd.DataFrame) -> str:
    return str(table.to_csv(index=False, lineterminator="\n"))


def _work(function: Callable[[Any], pd.DataFrame], expected: Mapping[str, str], batch: Keyed) -> Done:
    """One batch, here or in a worker. Text comes back, of errors too: no exception fails to travel."""
    try:
        if other := _differing(versions(), expected):
            raise ValueError(f"the worker has another {', '.join(other)} than this process")
        _keep_freed_memory()
        with _ALONE, _one_thread():
            return batch.key, _csv(function(batch)), ""
    except (Exception, SystemExit) as error:
        return batch.key, "", " ".join(f"{type(error).__name__}: {error}".split())


@lru_cache(maxsize=1)
def _keep_freed_memory() -> None:
    """Tell the C library of Linux not to return freed arrays to the system, only to ask for them again.

    Dask makes its workers return whatever is free above 64 KiB, and the study then takes twice its time.
    """
    with suppress(OSError, AttributeError):
        c_library = ctypes.CDLL("libc.so.6")
        c_library.mallopt(-1, 1 << 28)  # M_TRIM_THRESHOLD
        c_library.mallopt(-3, 1 << 25)  # M_MMAP_THRESHOLD, the largest it takes


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for OpenCV, BLAS, OpenMP and numba: sums in the same order, and no two workers for one core."""
    import cv2
    import numba

    threadpool_limits = import_extra("threadpoolctl", "study").threadpool_limits
    pools = [(cv2.setNumThreads, cv2.getNumThreads()), (numba.set_num_threads, numba.get_num_threads())]
    try:
        for limit, _ in pools:
            limit(1)
        with threadpool_limits(1):
            yield
    finally:
        for limit, threads in pools:
            limit(threads)


def _results(
    work: Work, todo: Sequence[Keyed], total: int, jobs: int, scheduler: str | None, progress: bool
) -> Iterator[tuple[str, str]]:
    """Key and table of each batch as it is done, with a bar; ``ValueError`` at the first that failed."""
    from tqdm import tqdm

    jobs = min(jobs, len(todo))
    done: Generator[Done, None, None]
    if scheduler is not None and todo:
        done = _on_cluster(work, todo, scheduler)
    else:
        done = _in_processes(work, todo, jobs) if jobs > 1 else (work(batch) for batch in todo)
    bar = tqdm(total=total, initial=total - len(todo), unit="batch", disable=None if progress else True)
    with bar, closing(done):
        for key, text, problem in done:
            if problem:
                raise ValueError(f"batch {key}: {problem}")
            yield key, text
            bar.update()


def _in_processes(work: Work, batches: Sequence[Keyed], jobs: int) -> Generator[Done, None, None]:
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.process_executor import BrokenProcessPool

    results: Any = None
    try:
        with (
            _quiet_tracker(),
            parallel_config("loky", inner_max_num_threads=1, initializer=_begin_worker, initargs=(os.getpid(),)),
        ):
            parallel = Parallel(n_jobs=jobs, batch_size=1, max_nbytes=None, return_as="generator_unordered")
            results = parallel(delayed(work)(batch) for batch in batches)
        for done in results:  # noqa: UP028 - `yield from` would close the results while the warnings are still on
            yield done
    except BrokenProcessPool:
        raise ValueError("a worker was killed or crashed (out of memory?); fewer jobs need less of it") from None
    finally:
        with uninterrupted(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # joblib would tell of the batches that are not wanted any more
            if results is not None:
                results.close()
            get_reusable_executor().shutdown(wait=True, kill_workers=True)


@contextmanager
def _quiet_tracker() -> Iterator[None]:
    """Joblib's tracker, a process of its own, tidies up after killed workers; it need not warn that it does."""
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [before, "ignore:resource_tracker:UserWarning"]))
    try:
        yield
    finally:
        os.environ.pop("PYTHONWARNINGS")
        if before is not None:
            os.environ["PYTHONWARNINGS"] = before


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


def _on_cluster(work: Work, batches: Sequence[Keyed], scheduler: str) -> Generator[Done, None, None]:
    distributed = import_extra("distributed", "dask")
    for name in ("distributed", "distributed.client"):  # what goes wrong is told here, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except Exception:  # refused, timed out, or something else at that address
        raise ValueError(f"scheduler {scheduler!r}: no answer within {CONNECT_S} s") from None
    waiting: dict[Any, Keyed] = {}
    try:
        for batch in batches:  # a new key each time: a scheduler answers a known one with the result of another sweep
            waiting[client.submit(work, batch, key=f"{batch.key}-{uuid.uuid4().hex}")] = batch
        while waiting:
            for future in _next_finished(client, list(waiting), scheduler):
                yield _received(future, waiting.pop(future), scheduler)
    finally:
        with uninterrupted(), suppress(Exception):  # a client that lost its scheduler cannot even say good-bye
            client.cancel(list(waiting))
        with uninterrupted(), suppress(Exception):
            client.close(timeout=CONNECT_S)


def _next_finished(client: Any, futures: Sequence[Any], scheduler: str) -> list[Any]:
    """Those of the futures that are done, one or more; ``ValueError`` when no worker is left to do them."""
    seen = time.monotonic()
    for tick in itertools.count():
        if done := [future for future in futures if future.done()]:
            return done
        time.sleep(POLL_S)
        if tick % round(1 / POLL_S) == 0:
            with suppress(OSError):  # the client is connecting again; its futures are cancelled if it fails
                seen = time.monotonic() if client.nthreads() else seen
        if time.monotonic() - seen > PATIENCE_S:
            raise ValueError(f"scheduler {scheduler!r}: no worker for {PATIENCE_S} s; start some with dask worker")
    raise AssertionError


def _received(future: Any, batch: Keyed, scheduler: str) -> Done:
    """What a worker sent, or why it could not: it died, or it cannot load the batch."""
    with suppress(Exception):
        if future.status == "finished":
            key, text, problem = future.result(CONNECT_S)
            return str(key), str(text), str(problem)
        if future.status == "error":
            problem = future.exception(CONNECT_S)
            return batch.key, "", " ".join(f"{type(problem).__name__}: {problem}".split())[:300]
    raise ValueError(f"scheduler {scheduler!r}: the connection was lost")
