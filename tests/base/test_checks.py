"""Checks of arguments: what passes comes back, what does not is named in one line."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from occlib.base import checks


@pytest.mark.parametrize("value", [1, 2.5, np.float32(1.5), np.int64(3), np.float64(1)])
def test_numbers_of_every_type_come_back_as_floats(value: Any) -> None:
    found = checks.number("x", value, above=0, most=3)
    assert type(found) is float and found == value


@pytest.mark.parametrize("value", [True, np.True_, None, "1", [1], float("nan"), float("inf"), 10**400, 1j, np.ones(1)])
def test_what_is_no_number_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^x: expected a number, got ") as caught:
        checks.number("x", value)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 100
    with pytest.raises(ValueError, match=r"^x: expected a whole number, got "):
        checks.whole("x", value)


@pytest.mark.parametrize(
    ("bounds", "good", "bad", "message"),
    [
        ({"above": 0}, 1e-300, 0, "x: expected metres > 0, got 0"),
        ({"least": 0}, 0, -1e-300, "x: expected metres >= 0, got -1e-300"),
        ({"most": 2}, 2, 2.5, "x: expected metres <= 2, got 2.5"),
        ({"least": 1, "most": 2}, 1.0, 0.5, "x: expected metres from 1 to 2, got 0.5"),
        ({"above": 0, "most": 1}, 1, 2, "x: expected metres > 0 and <= 1, got 2"),
        ({"above": 0}, np.float64(1), np.float64(-1), "x: expected metres > 0, got -1.0"),
    ],
)
def test_bounds_are_kept_and_said(bounds: dict[str, float], good: float, bad: float, message: str) -> None:
    assert checks.number("x", good, **bounds) == good
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        checks.number("x", bad, **bounds, unit="metres")


def test_a_message_may_say_less_than_the_bounds() -> None:
    with pytest.raises(ValueError, match=r"^fps: expected frames a second > 0, got 1e\+300$"):
        checks.number("fps", 1e300, least=1e-6, most=1e6, expected="frames a second > 0")


def test_whole_numbers() -> None:
    assert type(checks.whole("n", np.int32(4), least=0, most=4)) is int
    for value in (4.0, 5, -1, "4"):
        with pytest.raises(ValueError, match=f"^n: expected a count from 0 to 4, got {value!r}$"):
            checks.whole("n", value, least=0, most=4, unit="a count")


def test_arrays_of_numbers() -> None:
    found = checks.numbers("v", (1, 2), (2,))
    assert found.dtype == np.float64 and found.tolist() == [1, 2]
    assert float(checks.numbers("v", 3, ())) == 3
    for value in (None, [1], [1, "a"], [1, np.nan], [[1, 2]], {"x": 1}, [[1], [1, 2]], [10**400, 1]):
        with pytest.raises(ValueError, match=r"^v: expected 2 finite numbers, got "):
            checks.numbers("v", value, (2,))
    with pytest.raises(ValueError, match=r"^v: expected a finite number, got 'fine'$"):
        checks.numbers("v", "fine", ())


def test_masks() -> None:
    array = np.ones((2, 3), bool)
    assert checks.mask("m", array, (2, 3)) is array
    for value, came in ((array.T, "bool (3, 2)"), (array.astype(np.uint8), "uint8 (2, 3)"), ([[True]], "list")):
        with pytest.raises(ValueError, match=f"^{re.escape(f'm: expected bool (2, 3), got {came}')}$"):
            checks.mask("m", value, (2, 3))


def test_choices() -> None:
    assert checks.choice("rule", "and", {"and": 1, "or": 2}) == "and"
    for value in ("xor", None, 3, ["and"]):
        with pytest.raises(ValueError, match=re.escape(f"rule: expected one of and, or, got {value!r}")):
            checks.choice("rule", value, ("and", "or"))


def test_long_values_are_cut() -> None:
    assert checks.shown("x" * 100) == "'" + "x" * 56 + "..."
    assert checks.shown(np.float64(0.1)) == "0.1"
