"""Chapter 11: exercises on votes and explanations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from occlib.base.arrays import Mask
from occlib.course.checking import Mistake, Test, array, exercise, number, numbers, word
from occlib.course.lessons.explain_the_silhouettes import explaining_sets, riddle

ODDS = 4**3 / 9


def _smallest() -> Mask:
    return explaining_sets(*riddle())[0]


def _first_of_rows() -> Mask:
    left, _ = riddle()
    return np.asarray(left & ~np.pad(left[:, :-1], ((0, 0), (1, 0))))


def _both() -> Mask:
    return np.asarray(np.logical_and(*riddle()))


def _world(expected: Callable[[], Mask]) -> Test:
    """The cells of a world, as truth values or as zeros and ones."""

    def test(answer: Any) -> bool:
        value = np.asarray(answer)
        return bool(np.isin(value, (0, 1)).all() and array(expected)(value.astype(bool)))

    return test


def _too_large(answer: Any) -> bool:
    """Whether it casts both shadows, but is not the smallest world that does."""
    return np.shape(answer) == (6, 6) and any(np.array_equal(answer, world) for world in explaining_sets(*riddle())[1:])


exercise(
    "11.1",
    right=number(lambda: ODDS / (1 + ODDS), tol=0.006),
    example=lambda: ODDS / (1 + ODDS),
    otherwise="Multiply the odds p / (1 - p) of the four views, then turn the odds back into a probability.",
    mistakes=[
        Mistake("These are the odds. Which probability has them?", number(ODDS, tol=0.15), example=ODDS),
        Mistake("That is the logarithm of the odds.", number(float(np.log(ODDS)), tol=0.02), example=1.96),
        Mistake("That is the mean of the four values. Witnesses multiply their odds.", number(0.625, tol=0.004), example=0.625),
        Mistake("You multiplied the probabilities themselves. Multiply odds.", number(0.0512, tol=0.001), example=0.0512),
        Mistake("That is the geometric mean of the probabilities, the rule called product.",
                number(0.0512**0.25, tol=0.004), example=0.4757),
        Mistake("A number from 0 to 1 is asked for, not a percentage.", number(100 * ODDS / (1 + ODDS), tol=0.6), example=87.7),
        Mistake("You left the view out that says no.", number(64 / 65, tol=0.004), example=0.985),
    ],
)  # fmt: skip

exercise(
    "11.2",
    right=numbers([2, 4]),
    example=[2, 4],
    otherwise="For each pair: by how much does one yes raise the odds, and by how much does one no lower them?",
    mistakes=[
        Mistake("The order is that of the text: first the views that say 0.9 and 0.3.", numbers([4, 2]), example=[4, 2]),
        Mistake("You let both have the worth 0.8 and 0.1 of the chapter.", numbers([3, 3]), example=[3, 3]),
        Mistake("You counted how many may say no. How many must say yes?", numbers([2, 0]), example=[2, 0]),
    ],
)  # fmt: skip

exercise(
    "11.3",
    right=_world(_smallest),
    example=_smallest,
    otherwise="Cast the shadows of your world with lesson.cast and compare both with the given ones.",
    mistakes=[
        Mistake("That is the AND, the largest world that explains the views. The smallest is wanted.",
                _world(_both), example=_both),
        Mistake("It casts both shadows, but so does a smaller world. Which object could go?",
                _too_large, example=lambda: explaining_sets(*riddle())[1]),
        Mistake("You took where the left lamp's shadows begin. Does your world cast the front lamp's shadows, too?",
                _world(_first_of_rows), example=_first_of_rows),
        Mistake("Your array is upside down: row 0 is the lowest, y = 0.",
                _world(lambda: _smallest()[::-1]), example=lambda: _smallest()[::-1]),
        Mistake("Rows and columns are exchanged: the first index is y, the row.",
                _world(lambda: _smallest().T), example=lambda: _smallest().T),
        Mistake("That is how many objects there are. Where do they stand?",
                number(lambda: _smallest().sum()), example=lambda: int(_smallest().sum())),
        Mistake("An array of shape (6, 6) is asked for, True where an object stands.",
                lambda answer: np.shape(answer) != (6, 6), example=lambda: np.argwhere(_smallest())),
    ],
)  # fmt: skip

exercise(
    "11.4",
    right=word("planes"),
    example="planes",
    otherwise="Compare the MODA of and, planes and explain, and give the name of the lowest.",
    mistakes=[
        Mistake("Low objects hardly smear, so the plain rule has few ghosts here. Higher MODA is better.",
                word("and"), example="and"),
        Mistake("The search fits cylinders of any height. Which rule demands that an object is tall?",
                word("explain", "explain, one spare"), example="explain"),
    ],
)  # fmt: skip
