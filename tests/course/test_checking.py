"""An answer gets one of three verdicts, whatever it is."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from occlib.course import checking
from occlib.course.checking import Mistake, array, between, check, exercise, judge, number, numbers, word, yes_no


@pytest.fixture(autouse=True)
def own_exercise() -> Iterator[None]:
    exercise(
        "98.1",
        right=number(2.5, rel=0.01),
        example=2.5,
        otherwise="Draw it.",
        mistakes=[Mistake("In metres.", number(250, rel=0.01), 250), Mistake("Never here.", lambda a: a.no_such, 0)],
    )
    yield
    del checking.EXERCISES["98.1"]


@pytest.mark.parametrize("answer", [None, ...])
def test_not_answered(answer: Any, capsys: pytest.CaptureFixture[str]) -> None:
    check("98.1", answer)
    assert capsys.readouterr().out == "98.1: not answered yet\n"


@pytest.mark.parametrize("answer", [2.5, 2.51, np.float32(2.5), np.array([2.5])])
def test_right(answer: Any) -> None:
    assert str(judge("98.1", answer)) == "98.1: right"


def test_a_generator_is_left_as_it_is() -> None:
    exercise("98.2", right=lambda answer: tuple(answer) == (1, 2), example=(1, 2), otherwise="A pair.")
    answer = (number for number in (1, 2))
    try:
        assert [str(judge("98.2", answer)) for _ in range(2)] == ["98.2: not yet. A pair."] * 2
    finally:
        del checking.EXERCISES["98.2"]
    assert list(answer) == [1, 2]


class Awkward:
    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("no")

    def __eq__(self, other: object) -> bool:
        raise RuntimeError("no")

    __hash__ = None  # type: ignore[assignment]


@pytest.mark.parametrize(
    "answer", [250, 0, "2.5", [2.5, 2.5], True, np.nan, np.inf, [], {}, Awkward(), object, 1j, "x"]
)
def test_not_yet_and_never_an_error(answer: Any, capsys: pytest.CaptureFixture[str]) -> None:
    check("98.1", answer)
    hint = "In metres." if isinstance(answer, int) and answer == 250 else "Draw it."
    assert capsys.readouterr().out == f"98.1: not yet. {hint}\n"


def test_unknown_number(capsys: pytest.CaptureFixture[str]) -> None:
    check("98.7", 1)
    assert capsys.readouterr().out == "no exercise '98.7'; this chapter has 98.1\n"


@pytest.mark.parametrize("taken", ["98.1", "7.1", "98.10", "x"])
def test_a_number_is_taken_once(taken: str) -> None:
    with pytest.raises(ValueError, match=r"expected one like '07\.3'"):
        exercise(taken, right=bool, example=1, otherwise="")


@pytest.mark.parametrize(
    ("test", "fits", "does_not"),
    [
        (number(lambda: 3), [3, 3.0], [3.01, True, "3", [3, 3], None]),
        (
            numbers([1, 2], tol=0.1),
            [(1, 2), np.array([1.05, 2]), [[1, 2]], [[1], [2]]],
            [[2, 1], [1, 2, 3], "12", [1, np.nan]],
        ),
        (numbers([1, 2], ordered=False), [[2, 1], [1, 2]], [[1, 1]]),
        (between(2, 3), [2, 3, 2.5], [1.99, 3.01]),
        (word("left", "the left"), ["left", " Left "], ["right", 1]),
        (yes_no(True), [True, np.True_], [False, 1, "yes"]),
        (array(lambda: np.array([True, False])), [[True, False]], [[1, 0], [True], [False, True]]),
    ],
)
def test_tests(test: checking.Test, fits: list[Any], does_not: list[Any]) -> None:
    assert all(checking._fits(test, answer) for answer in fits)
    assert not any(checking._fits(test, answer) for answer in does_not)
