"""Loops that NumPy has no words for, compiled by Numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on first use and keep the result, where there is a folder to write to; else compile in each process."""
    try:
        return numba.njit(cache=True, nogil=True)(function)  # type: ignore[no-any-return, unused-ignore]
    except RuntimeError:  # no place for the cache
        return numba.njit(nogil=True)(function)  # type: ignore[no-any-return, unused-ignore]
