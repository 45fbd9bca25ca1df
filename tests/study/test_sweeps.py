"""Sweeps: the same bytes however they are run, resumed or not; one line for what goes wrong; no process left behind."""

from __future__ import annotations

import errno
import json
import os
import re
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest

from occlib.cli import main
from occlib.matching import measures
from occlib.study import sweeps
from occlib.study.sweeps import load_matchers, run_batches

pytestmark = pytest.mark.slow

# Workers cannot import test files, but a run file travels by value: as a user's own matchers do.
TOY = """
import os, sys, time
from dataclasses import dataclass
import numpy as np
import pandas as pd

@dataclass(frozen=True)
class Toy:
    n: int
    log: str
    do: str = ""
    seconds: float = 0.0

    @property
    def key(self):
        return f"toy-{self.n}"

def work(toy):
    with open(toy.log, "a") as log:
        log.write(f"{toy.key}\\n")
    time.sleep(toy.seconds)
    if toy.do == "raise":
        raise RuntimeError("no\\nway")
    if toy.do == "exit":
        sys.exit(3)
    if toy.do == "die":
        os.kill(os.getpid(), 9)
    noise = np.random.default_rng(toy.n).standard_normal((300, 300))
    table = pd.DataFrame({"n": toy.n, "value": (noise @ noise).sum(axis=0)[:3], "what": ["none", "a,b", None]})
    return table.rename(columns={"n": "m"}) if toy.do == "rename" else table
"""

MATCHERS = """
import os, time
import numpy as np
from occlib.matching import matcher

SLOW = {slow}

def difference(image, template, mask):
    windows = np.lib.stride_tricks.sliding_window_view(image[::1, ::1, 0], mask.shape)[:, :, 8::16, 8::16]
    return abs(windows.astype(float) - template[8::16, 8::16, 0]).mean(axis=(2, 3))

@matcher("mine", higher_is_better=False)
def mine(image, template, mask):
    "A difference at a few places."
    with open({log!r}, "a") as log:
        log.write("x")
    time.sleep(SLOW)
    return difference(image, template, mask)
"""
FEW = ["--sources", "camera", "coins", "--conditions", "noise", "--methods", "ssd", "mine"]
CALLS = 6  # of the matcher in a batch: three levels, each once more for the default threshold


@pytest.fixture(scope="session")
def toy_file(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = tmp_path_factory.mktemp("toy") / "toy.py"
    path.write_text(TOY)
    return runpy.run_path(str(path))


@pytest.fixture
def work(toy_file: dict[str, Any]) -> Callable[[Any], pd.DataFrame]:
    return toy_file["work"]  # type: ignore[no-any-return]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "log.txt"


@pytest.fixture
def toys(toy_file: dict[str, Any], log: Path) -> Callable[..., list[Any]]:
    """``toys(count, n="what goes wrong in batch n")``."""

    def make(count: int, seconds: float = 0.0, **troubles: str) -> list[Any]:
        return [toy_file["Toy"](n, str(log), troubles.get(f"n{n}", ""), seconds) for n in range(count)]

    return make


def counted(log: Path) -> list[str]:
    """The keys of the batches that were computed since the last time."""
    keys = sorted(log.read_text().split()) if log.exists() else []
    log.unlink(missing_ok=True)
    return keys


def workers(process: psutil.Process | None = None) -> list[psutil.Process]:
    """Child processes, but for those that only watch over semaphores until this process ends."""
    found = []
    for child in (process or psutil.Process()).children(recursive=True):
        with suppress(psutil.Error):
            if child.status() != psutil.STATUS_ZOMBIE and "resource_tracker" not in " ".join(child.cmdline()):
                found.append(child)
    return found


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The address of a Dask cluster of two processes."""
    distributed = pytest.importorskip("distributed")
    before = workers()
    options = {"n_workers": 2, "threads_per_worker": 2, "processes": True, "dashboard_address": ":0"}
    with distributed.LocalCluster(host="127.0.0.1", scheduler_port=0, silence_logs=50, **options) as cluster:
        yield cluster.scheduler_address
    assert [p for p in workers() if p not in before] == []


# --- the same result ---------------------------------------------------------------------------------
def test_here_in_processes_and_on_a_cluster_the_same_bytes(
    tmp_path: Path, toys: Any, work: Any, log: Path, scheduler: str
) -> None:
    before = workers()
    ways: dict[str, dict[str, Any]] = {"one": {}, "two": {"jobs": 2}, "dask": {"scheduler": scheduler}}
    for name, options in ways.items():
        run_batches(toys(7), work, tmp_path / name, progress=False, **options)
        assert counted(log) == [f"toy-{n}" for n in range(7)]
        assert [p for p in workers() if p not in before] == []
    first, *others = [(tmp_path / name / "trials.csv").read_bytes() for name in ways]
    assert first.count(b"\n") == 1 + 3 * 7
    assert all(other == first for other in others)


def test_the_trials_are_what_the_function_returned(tmp_path: Path, toys: Any, work: Any) -> None:
    trials = run_batches(toys(3), work, tmp_path, progress=False)
    expected = pd.concat([work(toy) for toy in toys(3)], ignore_index=True)
    assert trials["what"].isna().tolist() == 3 * [False, False, True]  # "none" is a word
    np.testing.assert_array_equal(trials["value"], expected["value"])  # to the last bit
    np.testing.assert_array_equal(trials["n"], expected["n"])


def test_tables_are_written_with_the_trials(tmp_path: Path, toys: Any, work: Any) -> None:
    trials = run_batches(toys(2), work, tmp_path, tables=lambda t: {"n.csv": t[["n"]]}, progress=False)
    assert pd.read_csv(tmp_path / "n.csv")["n"].tolist() == trials["n"].tolist()


def test_one_thread_everywhere(tmp_path: Path, toys: Any, scheduler: str) -> None:
    namespace: dict[str, Any] = {}
    source = """
    def threads(toy):
        import cv2, numpy, numba, pandas, threadpoolctl
        pools = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
        return pandas.DataFrame({"threads": [cv2.getNumThreads(), numba.get_num_threads(), max(pools)]})
    """
    exec("\n".join(line[4:] for line in source.splitlines()), namespace)  # by value, as above
    for name, options in {"one": {}, "two": {"jobs": 2}, "dask": {"scheduler": scheduler}}.items():
        trials = run_batches(toys(2), namespace["threads"], tmp_path / name, progress=False, **options)  # type: ignore[arg-type]
        assert trials["threads"].tolist() == [1] * 6, name


# --- going on ------------------------------------------------------------------------------------------
def test_only_what_is_missing_is_computed(
    tmp_path: Path, toys: Any, work: Any, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_batches(toys(5), work, tmp_path / "whole", progress=False)
    counted(log)
    out = tmp_path / "parts"
    run_batches(toys(5)[3:1:-1], work, out)
    assert counted(log) == ["toy-2", "toy-3"]
    run_batches(toys(5), work, out)
    assert counted(log) == ["toy-0", "toy-1", "toy-4"]
    assert capsys.readouterr().out == f"{out}: 2 of 5 batches kept\n"
    assert (out / "trials.csv").read_bytes() == (tmp_path / "whole/trials.csv").read_bytes()  # in the batches' order
    run_batches(toys(5), work, out, jobs=2, progress=False)
    assert counted(log) == []
    assert (out / "trials.csv").read_bytes() == (tmp_path / "whole/trials.csv").read_bytes()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


STALE: dict[str, tuple[Callable[[Path], object], int, str]] = {
    "cut": (lambda out: cut(out / "batches/toy-1.csv"), 1, "1 done again (damaged)"),
    "emptied": (lambda out: (out / "batches/toy-1.csv").write_text(""), 1, "1 done again (damaged)"),
    "edited": (lambda out: edit(out / "batches/toy-1.csv", "none", "None"), 1, "1 done again (damaged)"),
    "removed": (lambda out: (out / "batches/toy-1.csv").unlink(), 1, "3 of 4 batches kept"),
    "manifest removed": (lambda out: (out / "manifest.json").unlink(), 4, ""),
    "manifest cut": (lambda out: cut(out / "manifest.json"), 4, ""),
    "manifest of another kind": (lambda out: (out / "manifest.json").write_text('{"batches": [1]}'), 4, ""),
}


@pytest.mark.parametrize("what", STALE)
def test_what_is_damaged_is_done_again(
    tmp_path: Path, toys: Any, work: Any, log: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    run_batches(toys(4), work, tmp_path, progress=False)
    before = (tmp_path / "trials.csv").read_bytes()
    damage, count, said = STALE[what]
    damage(tmp_path)
    counted(log)
    run_batches(toys(4), work, tmp_path)
    assert len(counted(log)) == count
    assert said in capsys.readouterr().out
    assert (tmp_path / "trials.csv").read_bytes() == before


@pytest.mark.parametrize("library", ["numpy", "occlib"])
def test_results_of_another_version_are_done_again(
    tmp_path: Path, toys: Any, work: Any, log: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch, library: str,
) -> None:  # fmt: skip
    with monkeypatch.context() as patch:
        other = sweeps.versions() | {library: "0"}
        patch.setattr(sweeps, "versions", lambda: other)
        run_batches(toys(4), work, tmp_path, progress=False)
    counted(log)
    run_batches(toys(2), work, tmp_path)
    run_batches(toys(4), work, tmp_path)
    assert len(counted(log)) == 4
    assert f"0 of 2 batches kept, 2 done again (other {library})\n" in capsys.readouterr().out


def test_other_inputs_and_other_definitions_are_done_again(
    tmp_path: Path, toys: Any, work: Any, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_batches(toys(3), work, tmp_path, inputs={"methods": ("ssd",)})
    run_batches(toys(3), work, tmp_path, inputs={"methods": ("ssd",)})
    assert len(counted(log)) == 3
    run_batches(toys(3), work, tmp_path, inputs={"methods": ("sad",)})
    assert len(counted(log)) == 3
    run_batches(toys(3, seconds=0.01), work, tmp_path, inputs={"methods": ("sad",)})
    assert len(counted(log)) == 3
    said = capsys.readouterr().out.splitlines()
    assert [line.partition(": ")[2] for line in said] == [
        "3 of 3 batches kept",
        "0 of 3 batches kept, 3 done again (other methods)",
        "0 of 3 batches kept, 3 done again (other batch definition)",
    ]


# --- what goes wrong ---------------------------------------------------------------------------------
@pytest.mark.parametrize(("do", "message"), [("raise", "RuntimeError: no way"), ("exit", "SystemExit: 3")])
@pytest.mark.parametrize("way", ["one", "two", "dask"])
def test_a_batch_that_fails(
    tmp_path: Path, toys: Any, work: Any, log: Path, scheduler: str, way: str, do: str, message: str
) -> None:
    options: dict[str, Any] = {"one": {}, "two": {"jobs": 2}, "dask": {"scheduler": scheduler}}[way]
    before = workers()
    with pytest.raises(ValueError, match=f"^batch toy-3: {message}$"):
        run_batches(toys(20, seconds=0.1, n3=do), work, tmp_path / "out", progress=False, **options)
    assert [p for p in workers() if p not in before] == []
    kept = [p.stem for p in (tmp_path / "out/batches").iterdir()]
    assert set(kept) >= {"toy-0"}
    assert "toy-3" not in kept
    assert not (tmp_path / "out/trials.csv").exists()
    time.sleep(0.2)  # the cluster ends what it has begun
    counted(log)
    run_batches(toys(5, seconds=0.1), work, tmp_path / "out", progress=False)
    assert set(counted(log)) == {f"toy-{n}" for n in range(5)} - set(kept)


def test_a_worker_that_is_killed(tmp_path: Path, toys: Any, work: Any) -> None:
    before = workers()
    with pytest.raises(ValueError, match=r"^a worker was killed or crashed \(out of memory\?\)"):
        run_batches(toys(9, n3="die"), work, tmp_path, jobs=2, progress=False)
    assert (tmp_path / "batches/toy-0.csv").exists()
    assert [p for p in workers() if p not in before] == []


def test_other_columns(tmp_path: Path, toys: Any, work: Any) -> None:
    with pytest.raises(ValueError, match=r"^batch toy-1: expected the columns n,value,what, got m,value,what"):
        run_batches(toys(3, n1="rename"), work, tmp_path, progress=False)
    assert not (tmp_path / "trials.csv").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"jobs": 0}, "jobs: expected a whole number >= 1, got 0"),
        ({"jobs": -1}, "jobs: expected a whole number >= 1, got -1"),
        ({"jobs": 2.5}, "jobs: expected a whole number >= 1, got 2.5"),
        ({"jobs": 2, "scheduler": "tcp://127.0.0.1:1"}, "jobs: .* give either jobs or a scheduler"),
        ({"scheduler": "nowhere"}, "scheduler: expected an address such as tcp://127.0.0.1:8786, got 'nowhere'"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "scheduler 'tcp://127.0.0.1:1': no answer within 0.5 s"),
    ],
)
def test_wrong_arguments(
    tmp_path: Path, toys: Any, work: Any, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any], message: str
) -> None:
    monkeypatch.setattr(sweeps, "CONNECT_S", 0.5)
    with pytest.raises(ValueError, match=message):
        run_batches(toys(2), work, tmp_path / "out", progress=False, **options)
    assert not (tmp_path / "out").exists()


def test_a_cluster_without_workers(tmp_path: Path, toys: Any, work: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(sweeps, "PATIENCE_S", 1)
    options = {"n_workers": 0, "dashboard_address": ":0", "host": "127.0.0.1"}
    with distributed.LocalCluster(scheduler_port=0, silence_logs=50, **options) as cluster:
        with pytest.raises(ValueError, match=r"no worker for 1 s; start some with dask worker$"):
            run_batches(toys(2), work, tmp_path, scheduler=cluster.scheduler_address, progress=False)


def test_wrong_batches(tmp_path: Path, toys: Any, work: Any) -> None:
    class Named:
        def __init__(self, key: str) -> None:
            self.key = key

    for keys, message in {
        (): "expected one or more",
        ("a/b",): "'a/b'",
        ("..",): "file name",
        ("a", "A"): "of its own",
    }.items():
        with pytest.raises(ValueError, match=message):
            run_batches([Named(key) for key in keys], work, tmp_path, progress=False)


def test_two_sweeps_in_one_folder(tmp_path: Path, toys: Any, work: Any) -> None:
    if sys.platform == "win32":
        pytest.skip("folders are not locked there")
    seen = []

    def second(toy: Any) -> pd.DataFrame:
        with pytest.raises(ValueError, match="out: another sweep is running there; wait for it, or give --out"):
            run_batches(toys(1), work, tmp_path / "out", progress=False)
        seen.append(toy)
        return work(toy)  # type: ignore[no-any-return]

    run_batches(toys(2), second, tmp_path / "out", progress=False)
    assert len(seen) == 2
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["batches", "manifest.json", "trials.csv"]


def test_out_that_is_a_file(tmp_path: Path, toys: Any, work: Any) -> None:
    (tmp_path / "file").write_text("keep")
    with pytest.raises(ValueError, match=r"file/batches: cannot write \((File exists|Not a directory)"):
        run_batches(toys(2), work, tmp_path / "file", progress=False)
    assert (tmp_path / "file").read_text() == "keep"


@pytest.mark.parametrize("room", range(8))  # files: a table and a manifest for each of two batches, trials twice
def test_a_disk_that_fills_up(
    tmp_path: Path, toys: Any, work: Any, log: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    out, real, left = tmp_path / "out", os.replace, room

    def limited(*args: Any) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(*args)

    with monkeypatch.context() as patch:
        patch.setattr("occlib.base.files.os.replace", limited)
        if room < 6:
            with pytest.raises(ValueError, match="cannot write \\(No space left on device"):
                run_batches(toys(2), work, out, progress=False)
            assert not (out / "trials.csv").exists()
    assert not list(tmp_path.rglob(".*"))
    counted(log)
    run_batches(toys(2), work, out, progress=False)
    assert len(counted(log)) == (2 - min(room, 4) // 2 if room < 6 else 2)
    assert (out / "trials.csv").exists()


# --- the command ---------------------------------------------------------------------------------------
def matchers(tmp_path: Path, slow: float = 0.0) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(MATCHERS.format(log=str(tmp_path / "calls.txt"), slow=slow))
    return path


@pytest.fixture(autouse=True)
def own_matchers_leave(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    before = dict(measures.METHODS)
    yield
    for name in set(measures.METHODS) - set(before):
        del measures.METHODS[name]


def sweep(out: Path, *options: object) -> int:
    return main(["sweep", "--out", str(out), *map(str, options)])


def test_the_study_with_a_matcher_of_ones_own(
    tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = matchers(tmp_path)
    ways = {"one": ["--jobs", 1], "two": ["--jobs", 2], "dask": ["--scheduler", scheduler]}
    for name, options in ways.items():
        assert sweep(tmp_path / name, "--seeds", "0:2", "--fast", "--matchers", mine, *FEW, *options) == 0
        said = capsys.readouterr()
        assert said.err == ""
        assert re.search(r"noise +\w+ best", said.out)
        assert said.out.endswith(
            f"{name}: trials.csv (24 rows), summary.csv, thresholds.csv, verdicts.csv, verdicts.png, recall.png\n"
        )
        measures.METHODS.pop("mine")
    for file in ("trials.csv", "summary.csv", "thresholds.csv", "verdicts.csv"):
        first, *others = [(tmp_path / name / file).read_bytes() for name in ways]
        assert all(other == first for other in others), file
    trials = pd.read_csv(tmp_path / "one/trials.csv")
    assert set(trials["method"]) == {"ssd", "mine"}
    assert len((tmp_path / "calls.txt").read_text()) == len(ways) * 4 * CALLS


def started(tmp_path: Path, out: Path, *options: object) -> tuple[subprocess.Popen[str], list[psutil.Process]]:
    """``occlib sweep --jobs 2`` in a process group of its own, when two batches are finished; and its workers."""
    command = [sys.executable, "-m", "occlib.cli", "sweep", "--out", str(out), "--jobs", "2", *map(str, options)]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, start_new_session=True, **pipes)
    deadline = time.monotonic() + 60
    while not (manifest := out / "manifest.json").exists() or len(json.loads(manifest.read_text())["batches"]) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return process, workers(psutil.Process(process.pid))


@pytest.mark.parametrize("how", ["SIGKILL", "SIGINT"])
def test_a_sweep_that_is_stopped_goes_on(tmp_path: Path, how: str, capsys: pytest.CaptureFixture[str]) -> None:
    if sys.platform == "win32":
        pytest.skip("no such signals there")
    out, mine = tmp_path / "out", matchers(tmp_path, slow=0.03)
    options = ["--seeds", "0:4", "--fast", "--matchers", mine, *FEW]
    process, running = started(tmp_path, out, *options)
    assert len(running) == 2
    if how == "SIGINT":  # as a terminal does: to all processes
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(getattr(signal, how))
    try:
        _, err = process.communicate(timeout=20)
    finally:
        process.kill()
        process.wait()
    assert psutil.wait_procs(running, timeout=5)[1] == []
    kept = {p.name: p.stat().st_mtime_ns for p in (out / "batches").iterdir()}
    vouched = json.loads((out / "manifest.json").read_text())["batches"]
    assert 2 <= len(vouched) <= len(kept) < 8
    assert not (out / "trials.csv").exists()
    if how != "SIGKILL":
        assert process.returncode == 130
        line = f"occlib sweep: interrupted; {len(vouched)} of 8 batches are kept in {out}, the same command goes on from there\n"
        assert err == line
    (tmp_path / "calls.txt").unlink()
    assert sweep(out, *options) == 0
    assert f"{out}: {len(vouched)} of 8 batches kept\n" in capsys.readouterr().out
    assert len((tmp_path / "calls.txt").read_text()) == CALLS * (8 - len(vouched))
    for key in vouched:
        assert (out / f"batches/{key}.csv").stat().st_mtime_ns == kept[f"{key}.csv"]
    if how == "SIGKILL":
        assert sweep(tmp_path / "whole", *options) == 0
        for file in ("trials.csv", "verdicts.csv"):
            assert (out / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seeds", "5:2"], "--seeds: expected START:STOP, as in 0:8, or one number, got '5:2'"),
        (["--seeds", "a"], "--seeds: expected START:STOP"),
        (["--seeds", "3:"], "--seeds: expected START:STOP"),
        (["--seeds", ""], "--seeds: expected START:STOP"),
        (["--seeds", "0:99999999"], "--seeds: expected START:STOP"),
        (["--methods", "best"], "method.*: expected one of ssd, .*, got 'best'"),
        (["--sources", "moon"], "source.*: expected one of camera, .*, got 'moon'"),
        (["--conditions", "rain"], "condition.*: expected one of gain, .*, got 'rain'"),
        (["--jobs", "0"], "jobs: expected a whole number >= 1, got 0"),
        (["--scheduler", "localhost"], "scheduler: expected an address such as"),
        (["--matchers", "nowhere.py"], "nowhere.py: No such file or directory"),
    ],
)
def test_sweep_says_what_is_wrong(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert sweep(tmp_path / "out", *options) == 2
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 1
    assert re.match(f"occlib sweep: {message}", lines[0]), lines
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("x = 1", "registers no matcher; expected a function under @matching.matcher"),
        ("x = ", r"SyntaxError: invalid syntax \(mine.py, line 1\)"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("exit(2)", "SystemExit: 2"),
    ],
)
def test_matchers_that_do_not_run(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "mine.py").write_text(content)
    with pytest.raises(ValueError, match=f"mine.py: {message}"):
        load_matchers(tmp_path / "mine.py")
