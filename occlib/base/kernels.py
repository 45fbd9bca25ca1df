"""Loops that NumPy has no words for, compiled by Numba; what it keeps on disk may fail without harm."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on first use and keep the result, where there is a folder to write to; else compile in each process.

    A kept result that is damaged, or cannot be written (a full disk), costs the time to compile again and no more.
    """
    try:
        dispatcher = numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # no place for the cache
        return numba.njit(nogil=True)(function)  # type: ignore[no-any-return, unused-ignore]
    if hasattr(dispatcher, "_cache"):
        dispatcher._cache = _ForgivingCache(dispatcher._cache)
    return dispatcher  # type: ignore[no-any-return, unused-ignore]


class _ForgivingCache:
    """Numba's cache of one function on disk: an index (``.nbi``) and a data file a signature (``.nbc``).

    Numba lets every error through: that of a truncated file, in each process until somebody removes it, and that of
    a full disk. Here the function is then compiled in memory, and the index removed, so that the next process begins
    the cache anew.
    """

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled function for these types of arguments, or ``None`` if it is not there, or damaged."""
        try:
            loaded = self._cache.load_overload(signature, target_context)
            # Two processes that write at the same time may leave one's code under the other's types.
            if loaded is None or tuple(loaded.signature.args) == tuple(getattr(signature, "args", signature)):
                return loaded
        except Exception:  # of garbage, unpickling may raise anything
            pass
        self._remove_index()
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep a compiled function, if that can be."""
        try:
            self._cache.save_overload(signature, result)
        except Exception:  # no space, no permission, or an index that another process damaged meanwhile
            self._remove_index()  # it may name a data file that was not written, and is that of an older source

    def _remove_index(self) -> None:
        with suppress(Exception):  # a read-only folder: it is then passed over each time
            Path(self._cache._cache_file._index_path).unlink()
