"""Chapter 09: exercises on messages, inflation, right of way and refused floor."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.course.checking import Mistake, array, exercise, number, numbers, word
from occlib.course.lessons.broadcast_and_navigate import refused_shares
from occlib.geometry import Floor
from occlib.mapping import OccupancyMap, inflate

COUNTS = (2, 4, 8)
MESSAGE_BYTES = 121_000
"""About: 400 x 300 cells and a header."""


def _inflated(radius_m: float) -> Any:
    one = np.zeros((7, 7), np.int8)
    one[3, 3] = 100
    return inflate(OccupancyMap(one, Floor((0.0, 0.7), (0.0, 0.7), 0.1)), radius_m).data


@cache
def _shares(rule: str = "left") -> FloatArray:
    return refused_shares(COUNTS, rule=rule)


exercise(
    "09.1",
    right=number(10 * MESSAGE_BYTES, rel=0.02),
    example=10 * MESSAGE_BYTES,
    otherwise="Add up the bytes of the three pieces of a message. How many messages a second are there?",
    mistakes=[
        Mistake("That is a single message. How many are sent in a second?", number(MESSAGE_BYTES, rel=0.02), example=MESSAGE_BYTES),
        Mistake("These are bits. Bytes are wanted.", number(80 * MESSAGE_BYTES, rel=0.02), example=80 * MESSAGE_BYTES),
        Mistake("Your number looks like megabytes. Bytes are wanted.", number(1.21, rel=0.05), example=1.21),
        Mistake("You divided by the rate. Messages that come more often need more.",
                number(MESSAGE_BYTES / 10, rel=0.02), example=MESSAGE_BYTES / 10),
    ],
)  # fmt: skip

exercise(
    "09.2",
    right=array(lambda: _inflated(0.30)),
    example=lambda: _inflated(0.30),
    otherwise="Take the distance of each cell's centre from the centre of the occupied one. Nearer than 30 cm: 100, else 0.",
    mistakes=[
        Mistake("That is the map of the text, inflated by 0.25 m.", array(lambda: _inflated(0.25)), example=lambda: _inflated(0.25)),
        Mistake("Cells at exactly 30 cm are not nearer than 30 cm.", array(lambda: _inflated(0.305)), example=lambda: _inflated(0.305)),
        Mistake("The values of a map are 0 and 100, not truth values.",
                array(lambda: _inflated(0.30) == 100), example=lambda: _inflated(0.30) == 100),
        Mistake("That is how many cells are occupied or were added. The map itself is wanted.",
                lambda answer: number(25)(answer) or number(4)(answer), example=25),
        Mistake("You took 0.30 for a number of cells, or for centimetres: nothing has grown.",
                lambda answer: int((np.asarray(answer) == 100).sum()) == 1 and np.shape(answer) == (7, 7),
                example=lambda: _inflated(0.05)),
    ],
)  # fmt: skip

exercise(
    "09.3",
    right=word("A"),
    example="A",
    otherwise="Look at the tracks: whose y leaves the corridor and goes into a bay? Answer with its name, a string.",
    mistakes=[
        Mistake("That was so when A went first. The order of the dictionary decides who plans around whom.", word("B"), example="B"),
        Mistake("Only one of them leaves the straight line for long. Which?", word("both", "A and B"), example="both"),
    ],
)  # fmt: skip

exercise(
    "09.4",
    right=numbers(_shares, tol=0.006),
    example=_shares,
    otherwise="For each crowd: claimed by the left view and not under an object, over all cells that are not under an object.",
    mistakes=[
        Mistake("That is what AND refuses. Take the left view alone.",
                numbers(lambda: _shares("and"), tol=0.004), example=lambda: _shares("and")),
        Mistake("These are per cent. Shares from 0 to 1 are wanted.", numbers(lambda: 100 * _shares(), tol=0.6), example=lambda: 100 * _shares()),
        Mistake("The order is 2, 4, 8 obstacles.", numbers(_shares, tol=0.006, ordered=False), example=lambda: _shares()[::-1]),
        Mistake("That is an area in m². Divide by the area that is free.",
                lambda answer: numbers(lambda: 11.7 * _shares(), rel=0.06)(answer), example=lambda: 11.7 * _shares()),
    ],
)  # fmt: skip
