"""Checks of arguments and of fields of files: a wrong one is a ``ValueError`` in one line.

Every message reads ``name: expected ..., got ...``. ``True`` and ``False`` are no numbers here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray, Mask


class Notice(UserWarning):
    """A warning in one line that names what is wrong with the input, though the work goes on. A command prints it on stderr."""


_SHOWN = 60
"""Characters of a wrong value that a message shows; the rest is cut off."""


def number(
    name: str,
    value: Any,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    unit: str = "a number",
    expected: str | None = None,
) -> float:
    """The value as a float, if it is a finite number within bounds.

    Parameters
    ----------
    name
        Of the argument or field, for the message.
    value
        What came.
    above, least, most
        Bounds, or None: greater than ``above``, no less than ``least``, no greater than ``most``.
    unit
        What the number counts, for the message: ``metres``, ``px``, ``frames a second``.
    expected
        What the message says instead of unit and bounds, where these only keep out what nobody can mean.

    >>> number("radius_m", 2, above=0, unit="metres")
    2.0
    >>> number("radius_m", -1, above=0, unit="metres")
    Traceback (most recent call last):
    ValueError: radius_m: expected metres > 0, got -1
    """
    if not _is_number(value, Real) or not _within(float(value), above, least, most):
        raise ValueError(f"{name}: expected {expected or unit + _bounds(above, least, most)}, got {shown(value)}")
    return float(value)


def whole(
    name: str, value: Any, *, least: int | None = None, most: int | None = None, unit: str = "a whole number"
) -> int:
    """The value as an int, if it is a whole number (of a whole-number type) from ``least`` to ``most``.

    >>> whole("jobs", 0, least=1)
    Traceback (most recent call last):
    ValueError: jobs: expected a whole number >= 1, got 0
    """
    if not _is_number(value, Integral) or not _within(value, None, least, most):
        raise ValueError(f"{name}: expected {unit}{_bounds(None, least, most)}, got {shown(value)}")
    return int(value)


def numbers(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """The value as a float64 array, if it is made of finite numbers and has this shape; ``()`` is a single number.

    >>> numbers("floor.x", [0, 4], (2,))
    array([0., 4.])
    >>> numbers("matrix", [[1, 0], [0, 1]], (3, 3))
    Traceback (most recent call last):
    ValueError: matrix: expected 3x3 finite numbers, got [[1, 0], [0, 1]]
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        what = f"{'x'.join(map(str, shape))} finite numbers" if shape else "a finite number"
        raise ValueError(f"{name}: expected {what}, got {shown(value)}")
    return array


def mask(name: str, value: Any, shape: tuple[int, ...]) -> Mask:
    """The value itself, if it is a bool array of this shape.

    >>> mask("blocked", np.zeros((2, 3)), (2, 3))
    Traceback (most recent call last):
    ValueError: blocked: expected bool (2, 3), got float64 (2, 3)
    """
    if not isinstance(value, np.ndarray) or value.dtype != np.bool_ or value.shape != shape:
        came = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise ValueError(f"{name}: expected bool {shape}, got {came}")
    return value


def choice(name: str, value: Any, known: Iterable[str]) -> str:
    """The value itself, if it is one of the known names.

    >>> choice("rule", "xor", ["and", "or"])
    Traceback (most recent call last):
    ValueError: rule: expected one of and, or, got 'xor'
    """
    known = list(known)
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name}: expected one of {', '.join(known)}, got {shown(value)}")
    return value


def shown(value: Any) -> str:
    """A wrong value as messages show it: numbers plain, all else by ``repr``, cut to 60 characters."""
    text = str(value) if isinstance(value, Real) else repr(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


def _is_number(value: Any, kind: Any) -> bool:
    """A whole number of 400 digits is none: no float is as large."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, kind):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _within(value: float, above: float | None, least: float | None, most: float | None) -> bool:
    return (above is None or value > above) and (least is None or value >= least) and (most is None or value <= most)


def _bounds(above: float | None, least: float | None, most: float | None) -> str:
    if least is not None and most is not None:
        return f" from {least:g} to {most:g}"
    limits = ((">", above), (">=", least), ("<=", most))
    return " and".join(f" {sign} {limit:g}" for sign, limit in limits if limit is not None)
