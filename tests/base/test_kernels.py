"""The cache of compiled loops saves time and is never fatal."""

from __future__ import annotations

import errno
import os
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlib.base import kernels

SOURCE = """
from occlib.base.kernels import compiled

@compiled
def doubled(values):
    total = values[0]
    for value in values[1:]:
        total += value
    return 2 * total
"""
WHOLE, HALVES = np.arange(4), np.arange(4) / 2  # int64 and float64: two signatures, two data files


@pytest.fixture
def load(tmp_path: Path) -> Callable[[], Any]:
    """``load()``: the compiled function as a new process would see it, with its cache in ``tmp_path``."""
    (tmp_path / "loops.py").write_text(SOURCE, encoding="utf-8")
    return lambda: runpy.run_path(str(tmp_path / "loops.py"))["doubled"]


def cached(folder: Path, suffix: str) -> list[Path]:
    return sorted((folder / "__pycache__").glob(f"*{suffix}"))


def from_disk(function: Any) -> int:
    """How many signatures were loaded and not compiled."""
    return sum(function.stats.cache_hits.values())


def damaged(content: bytes) -> list[bytes]:
    """A file cut after nothing, a byte, the middle and all but a byte; zeros; what was never such a file."""
    cut = [content[:length] for length in (0, 1, len(content) // 2, len(content) - 1)]
    return [*cut, bytes(len(content)), b"garbage\n" * 40, b"\x80\x05" + bytes(range(256))]


@pytest.mark.slow
def test_what_was_compiled_is_kept(load: Callable[[], Any]) -> None:
    assert load()(WHOLE) == 12
    again = load()
    assert again(WHOLE) == 12 and again(HALVES) == 6.0
    assert from_disk(again) == 1


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_a_damaged_file_is_passed_over_and_replaced(load: Callable[[], Any], tmp_path: Path, suffix: str) -> None:
    load()(WHOLE)
    (path,) = cached(tmp_path, suffix)
    for content in damaged(path.read_bytes()):
        path.write_bytes(content)
        mended, again = load(), load()
        assert mended(WHOLE) == 12 and from_disk(mended) == 0, content[:20]
        assert again(WHOLE) == 12 and from_disk(again) == 1, content[:20]


@pytest.mark.slow
def test_code_for_other_types_is_not_taken(load: Callable[[], Any], tmp_path: Path) -> None:
    """Two processes that write at the same time may give both results one number."""
    function = load()
    function(WHOLE)
    function(HALVES)
    first, second = cached(tmp_path, ".nbc")
    first.write_bytes(second.read_bytes())
    again = load()
    assert again(WHOLE) == 12 and again(HALVES) == 6.0


def test_a_full_disk_costs_the_cache_only(
    load: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)  # the last step of each write
        assert load()(WHOLE) == 12
    assert cached(tmp_path, ".nbi") == cached(tmp_path, ".nbc") == []


def test_an_index_without_its_data_does_not_lead_to_older_data(
    load: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The index is written first; the data file that it names may be there, of an older source."""
    load()(WHOLE)
    (tmp_path / "loops.py").write_text(SOURCE.replace("2 *", "3 *"), encoding="utf-8")
    real = os.replace

    def full_after_the_index(source: str, target: str) -> None:
        if target.endswith(".nbc"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full_after_the_index)
        assert load()(WHOLE) == 18
    assert load()(WHOLE) == 18


def test_a_damaged_file_in_a_read_only_folder_is_passed_over(
    load: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    load()(WHOLE)
    (path,) = cached(tmp_path, ".nbi")
    path.write_bytes(b"")
    for name in ("replace", "unlink", "remove"):  # not by mode bits, which mean nothing to root
        monkeypatch.setattr(os, name, refused)
    assert load()(WHOLE) == 12
    assert path.read_bytes() == b""


def test_without_a_folder_for_the_cache_it_compiles_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    real = kernels.numba.njit

    def njit(**options: Any) -> Any:
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return real(**options)

    monkeypatch.setattr(kernels.numba, "njit", njit)
    assert kernels.compiled(lambda x: x + 1)(2) == 3
