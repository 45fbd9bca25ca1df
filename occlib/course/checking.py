"""Exercises that answer back: ``check("07.3", answer)`` says "not answered yet", "right", or "not yet" with a hint.

The exercises of a chapter stand in one module of :mod:`occlib.course.answers`. Each knows a test for the right answer
and one for every known mistake, with the hint for it::

    exercise(
        "07.3",
        right=number(lambda: lab.smear_m(2.5, 1.7, 3.8), rel=0.01),
        example=lambda: lab.smear_m(2.5, 1.7, 3.8),
        otherwise="Solve d h / (H - h) = 2 m for H.",
        mistakes=[Mistake("You solved for h, the object's height.", number(1.1, rel=0.05), example=1.1)],
    )
"""

from __future__ import annotations

import importlib
import pkgutil
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

Test = Callable[[Any], object]
"""Takes an answer; true in the sense of ``bool`` if it fits. One that raises does not fit."""

EXERCISES: dict[str, Exercise] = {}
"""All exercises by number, once :func:`exercises` was called."""


@dataclass(frozen=True)
class Mistake:
    """A known mistake.

    Parameters
    ----------
    hint
        What to think of again, in one or two sentences. Never the answer.
    found
        Recognises an answer with this mistake.
    example
        Such an answer, or a function without arguments that makes one; for the tests.
    """

    hint: str
    found: Test
    example: Any


@dataclass(frozen=True)
class Exercise:
    """An exercise: see :func:`exercise`."""

    number: str
    right: Test
    example: Any
    otherwise: str
    mistakes: tuple[Mistake, ...]
    invariant: str | None


@dataclass(frozen=True)
class Verdict:
    """What :func:`judge` says of an answer; ``str(verdict)`` is what :func:`check` prints."""

    number: str
    kind: str  # "not answered yet", "right" or "not yet"
    hint: str = ""

    def __str__(self) -> str:
        return f"{self.number}: {self.kind}" + (f". {self.hint}" if self.hint else "")


def exercise(
    number: str,
    *,
    right: Test,
    example: Any,
    otherwise: str,
    mistakes: Sequence[Mistake] = (),
    invariant: str | None = None,
) -> None:
    """Add an exercise.

    Parameters
    ----------
    number
        Chapter and place, as ``"07.3"``; once only.
    right
        Recognises a right answer.
    example
        A right answer, or a function without arguments that makes one; for the tests.
    otherwise
        The hint for an answer that is neither right nor a known mistake.
    mistakes
        Known mistakes, tried in this order once the answer is not right.
    invariant
        For an open exercise: what holds for every right answer, in words; ``right`` checks no more than that.

    Raises
    ------
    ValueError
        For a number that is malformed or taken.
    """
    if not re.fullmatch(r"\d\d\.\d", number) or number in EXERCISES:
        raise ValueError(f"exercise: number: expected one like '07.3' that is not taken, got {number!r}")
    EXERCISES[number] = Exercise(number, right, example, otherwise, tuple(mistakes), invariant)


def exercises() -> dict[str, Exercise]:
    """All exercises of the course by number, in order."""
    answers = importlib.import_module(f"{__package__}.answers")
    for module in pkgutil.iter_modules(answers.__path__):
        importlib.import_module(f"{answers.__name__}.{module.name}")
    return dict(sorted(EXERCISES.items()))


def judge(number: str, answer: Any) -> Verdict:
    """What is to be said of an answer; never raises for an answer of whatever kind.

    Raises
    ------
    ValueError
        If there is no such exercise.
    """
    found = exercises().get(number)
    if found is None:
        own = [known for known in EXERCISES if known[:2] == number[:2]]
        raise ValueError(f"no exercise {number!r}; this chapter has {', '.join(sorted(own)) or 'none'}")
    if answer is None or answer is ...:
        return Verdict(number, "not answered yet")
    if _fits(found.right, answer):
        return Verdict(number, "right", f"(What can be checked: {found.invariant}.)" if found.invariant else "")
    hints = (mistake.hint for mistake in found.mistakes if _fits(mistake.found, answer))
    return Verdict(number, "not yet", next(hints, found.otherwise))


def check(number: str, answer: Any) -> None:
    """Say whether an answer is right: "not answered yet", "right", or "not yet" and the hint for that mistake.

    Never raises and never shows the answer.

    >>> check("07.1", None)  # doctest: +SKIP
    07.1: not answered yet
    """
    try:
        print(judge(str(number), answer))
    except ValueError as error:
        print(error)


def _fits(test: Test, answer: Any) -> bool:
    """Whether the test says so; an answer of another kind than it expects does not fit, nor does one that it would use up."""
    if isinstance(answer, Iterator):
        return False
    with suppress(Exception), np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bool(test(answer))
    return False


# --- tests that many exercises need


def number(expected: float | Callable[[], float], *, rel: float = 0.0, tol: float = 0.0) -> Test:
    """One finite number within ``tol``, or ``rel`` times the expected one, of it: exactly it by default.

    A truth value, a text or an array of more than one element does not fit.
    """

    def test(answer: Any) -> bool:
        value = np.asarray(answer)
        if value.size != 1 or value.dtype.kind not in "iuf":
            return False
        wanted = float(_value(expected))
        return bool(abs(float(value.item()) - wanted) <= max(tol, rel * abs(wanted), 1e-9))

    return test


def numbers(
    expected: Sequence[float] | Callable[[], Any], *, rel: float = 0.0, tol: float = 0.0, ordered: bool = True
) -> Test:
    """As many finite numbers as expected, in the same shape, each within ``tol`` or ``rel`` of its own.

    Axes of length 1 do not count: one point as (2,) or as (1, 2) is the same answer. ``ordered=False`` compares the
    numbers sorted, whatever the shape.
    """

    def test(answer: Any) -> bool:
        value = np.asarray(answer, dtype=float).squeeze()
        wanted = np.asarray(_value(expected), dtype=float).squeeze()
        if not ordered:
            value, wanted = np.sort(value, axis=None), np.sort(wanted, axis=None)
        return value.shape == wanted.shape and np.allclose(value, wanted, rtol=rel, atol=max(tol, 1e-9))

    return test


def between(low: float, high: float) -> Test:
    """One finite number from ``low`` to ``high``, both included."""
    return number((low + high) / 2, tol=(high - low) / 2)


def word(*expected: str) -> Test:
    """One of these words, whatever the capitals and the space around it."""
    return lambda answer: isinstance(answer, str) and answer.strip().casefold() in {w.casefold() for w in expected}


def yes_no(expected: bool) -> Test:
    """A truth value (``True`` or ``False``, of Python or NumPy), and nothing that only counts as one."""
    return lambda answer: np.asarray(answer).dtype.kind == "b" and np.size(answer) == 1 and bool(answer) is expected


def array(expected: Callable[[], Any]) -> Test:
    """An array of the same shape and the same kind (truth values, numbers) with the same values."""

    def test(answer: Any) -> bool:
        value, wanted = np.asarray(answer), np.asarray(_value(expected))
        same_kind = (value.dtype.kind == "b") == (wanted.dtype.kind == "b")
        return same_kind and value.shape == wanted.shape and np.allclose(value, wanted)

    return test


def _value(expected: Any) -> Any:
    return expected() if callable(expected) else expected
