"""The API reference: a page for each room of the house, from the docstrings of its public names."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from functools import cache
from types import ModuleType
from typing import Any

import occlib

LEFT_OUT = {"cli"}
"""Rooms without a Python interface; the command line has a page of its own."""


def rooms() -> list[str]:
    """The rooms of the house: modules and packages directly in ``occlib``."""
    names = sorted(module.name for module in pkgutil.iter_modules(occlib.__path__))
    return [name for name in names if name not in LEFT_OUT and not name.startswith("_")]


def public_names(module: ModuleType) -> list[str]:
    """What a room offers: its ``__all__``, else what is defined in it without a leading underscore."""
    if names := getattr(module, "__all__", None):
        return [name for name in names if not inspect.ismodule(getattr(module, name))]
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ] + [name for name in _documented_data(module) if not name.startswith("_")]


def room_page(room: str) -> str:
    """The page of a room in reStructuredText: its docstring, a table of its names, then each of them."""
    module = importlib.import_module(f"occlib.{room}")
    names = sorted(dict.fromkeys(public_names(module)), key=lambda name: (name.isupper(), name.lower()))
    title = f"occlib.{room}"
    rows = [f"   * - :py:obj:`~{_full_name(module, name)}`\n     - {_summary(module, name)}" for name in names]
    table = ".. list-table::\n   :widths: 30 70\n   :class: names\n\n" + "\n".join(rows) if rows else ""
    parts = [f"{title}\n{'=' * len(title)}", f".. automodule:: {title}\n   :no-members:", table]
    return "\n\n".join([*parts, *filter(None, (_entry(module, name) for name in names))]) + "\n"


def overview() -> str:
    """A list of the rooms with the first line of their docstrings, in MyST Markdown."""
    lines = []
    for room in rooms():
        doc = inspect.getdoc(importlib.import_module(f"occlib.{room}")) or ""
        lines.append(f"- [`occlib.{room}`](api/{room}.rst): {_markdown(doc.splitlines()[0] if doc else '')}")
    return "\n".join(lines)


def _entry(module: ModuleType, name: str) -> str:
    """The directive that documents a name; empty for what belongs to another room, which has it on its page."""
    value, full = getattr(module, name), _full_name(module, name)
    if not full.startswith(f"{module.__name__}."):
        return ""
    if _is_class(value):
        return f".. autoclass:: {full}\n   :members:\n   :show-inheritance:"
    if _is_function(value):
        return f".. autofunction:: {full}"
    text = _documented_data(_home(module, name)).get(name, "")
    indented = "\n".join(f"   {line}".rstrip() for line in text.splitlines())
    return f".. py:data:: {full}\n\n{indented}"


def _is_class(value: Any) -> bool:
    return isinstance(value, type) and not hasattr(value, "__origin__")


def _is_function(value: Any) -> bool:
    """Whether it is a function, one that Numba compiles included."""
    return inspect.isroutine(value) or hasattr(value, "py_func")


def _full_name(module: ModuleType, name: str) -> str:
    """Where a name is documented: in this room, or in the one that it comes from."""
    value = getattr(module, name)
    origin = str(getattr(value, "__module__", "")) if _is_class(value) or _is_function(value) else ""
    room = ".".join(origin.split(".")[:2])
    return f"{room if origin.startswith('occlib.') else module.__name__}.{name}"


def _home(module: ModuleType, name: str) -> ModuleType:
    """The module in and below ``module`` that assigns a constant and says in a docstring what it is."""
    if name in _documented_data(module) or not hasattr(module, "__path__"):
        return module
    for below in pkgutil.iter_modules(module.__path__):
        inner = importlib.import_module(f"{module.__name__}.{below.name}")
        if name in _documented_data(inner):
            return inner
    return module


@cache
def _documented_data(module: ModuleType) -> dict[str, str]:
    """The names that a module assigns, each with the docstring below the assignment, cleaned."""
    found: dict[str, str] = {}
    body = ast.parse(inspect.getsource(module)).body
    for line, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        targets: list[Any] = getattr(line, "targets", None) or [getattr(line, "target", None)]
        if not isinstance(line, ast.Assign | ast.AnnAssign) or not isinstance(targets[0], ast.Name):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
            found[targets[0].id] = inspect.cleandoc(after.value.value)
    return found


def _summary(module: ModuleType, name: str) -> str:
    value = getattr(module, name)
    home = _home(module, name)
    text = _documented_data(home).get(name) if name in _documented_data(home) else None
    if text is None and (_is_class(value) or _is_function(value)):
        text = inspect.getdoc(value)
    lines = (text or "").split("\n\n")[0]
    return " ".join(lines.split())


def _markdown(text: str) -> str:
    """A line of reStructuredText as Markdown, as far as a docstring's first line goes."""
    return re.sub(r":\w+:`~?([^`]*)`", r"`\1`", text).replace("``", "`")
