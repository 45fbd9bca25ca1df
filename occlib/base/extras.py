"""Packages that only some commands need: they come with an extra, which is named where one is missing."""

from __future__ import annotations

import importlib
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, Any


class MissingExtraError(ImportError, ValueError):
    """A package is not installed that an extra brings: an ``ImportError`` in Python, one line in a command."""


def import_extra(package: str, extra: str) -> Any:
    """Import a package, or a module in one, that ``pip install "occlib[EXTRA]"`` brings.

    Raises ``MissingExtraError`` if it is not installed, or with the reason if it is and cannot be imported.

    >>> import_extra("nowhere", "live")
    Traceback (most recent call last):
    occlib.base.extras.MissingExtraError: needs the extra live: pip install "occlib[live]"
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        absent = isinstance(error, ModuleNotFoundError) and f"{package}.".startswith(f"{error.name}.")
        raise MissingExtraError(_remedy(extra) if absent else f"{_remedy(extra)} ({error})") from None


def check_extra(package: str, extra: str) -> None:
    """``MissingExtraError`` unless the package is installed; it is not imported, which may be slow."""
    if find_spec(package) is None:
        raise MissingExtraError(_remedy(extra))


def lazy_extra(package: str, extra: str) -> Any:
    """A stand-in for the module, which :func:`import_extra` imports when something in it is first used."""
    return _LazyModule(package, extra)


def _remedy(extra: str) -> str:
    return f'needs the extra {extra}: pip install "occlib[{extra}]"'


class _LazyModule(ModuleType):
    def __init__(self, package: str, extra: str) -> None:
        super().__init__(package)
        self._extra = extra

    def __getattr__(self, name: str) -> Any:
        return getattr(import_extra(self.__name__, self._extra), name)


if TYPE_CHECKING:
    import pandas
else:  # for tables: `from occlib.base.extras import pandas as pd`
    pandas = lazy_extra("pandas", "study")
