"""Chapter 10: exercises on the failures of AND."""

from __future__ import annotations

from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray, Mask
from occlib.course.checking import Mistake, array, exercise, number, numbers
from occlib.course.lessons.break_the_and_rule import ball_coverage
from occlib.occlusion import fuse

HEIGHTS_M = (1.5, 2.5, 4.0, 8.0)


def _objects() -> Mask:
    objects = np.zeros((4, 4), bool)
    objects[[2, 0, 3, 1], [0, 1, 2, 3]] = True
    return objects


def _shadows(objects: Mask) -> list[Mask]:
    return [np.logical_or.accumulate(objects, axis=axis) for axis in (1, 0)]


def _ghosts(objects: Mask | None = None) -> Mask:
    stand = _objects() if objects is None else objects
    return np.asarray(fuse(_shadows(stand)) & ~stand)


def _as_truth(answer: Any) -> Any:
    """An array of 0 and 1 read as truth values; everything else as it is."""
    values = np.asarray(answer)
    return values.astype(bool) if values.shape == (4, 4) and np.isin(values, (0, 1)).all() else values


def _coverage() -> FloatArray:
    return ball_coverage(HEIGHTS_M)


exercise(
    "10.1",
    right=number(lambda: 1.7 + 2.5 * 1.7 / 2, rel=0.01),
    example=lambda: 1.7 + 2.5 * 1.7 / 2,
    otherwise="Solve d h / (H - h) = 2 m for H.",
    mistakes=[
        Mistake("You divided by H alone. The shadow begins at the top edge: which height is left above it?",
                number(2.5 * 1.7 / 2, rel=0.005), example=2.125),
        Mistake("Your number looks like centimetres. The answer is wanted in m.",
                number(382.5, rel=0.005), example=382.5),
        Mistake("You solved for the height of the object. The person is given; how high must the camera hang?",
                number(2.0 * 2.5 / (2.5 + 2.0), rel=0.005), example=1.111),
        Mistake("You let the object's height and its distance change places.",
                number(2.5 + 2.5 * 1.7 / 2, rel=0.005), example=4.625),
    ],
)  # fmt: skip

exercise(
    "10.2",
    right=lambda answer: array(_ghosts)(_as_truth(answer)),
    example=_ghosts,
    otherwise="Take the pairs one by one: the shadow of the one to the right, that of the other upwards. Where do they meet?",
    mistakes=[
        Mistake("The objects themselves are in your array. Ghosts are cells of the AND where nothing stands.",
                lambda answer: array(lambda: fuse(_shadows(_objects())))(_as_truth(answer)), example=lambda: fuse(_shadows(_objects()))),
        Mistake("Rows and columns are exchanged: the first index is y, the row.",
                lambda answer: array(lambda: _ghosts(_objects().T))(_as_truth(answer)), example=lambda: _ghosts(_objects().T)),
        Mistake("Your array is upside down: row 0 is the lowest, y = 0.",
                lambda answer: array(lambda: _ghosts()[::-1])(_as_truth(answer)), example=lambda: _ghosts()[::-1]),
        Mistake("That is what any view claims. A ghost needs both views.",
                lambda answer: array(lambda: np.logical_or(*_shadows(_objects())) & ~_objects())(_as_truth(answer)),
                example=lambda: np.logical_or(*_shadows(_objects())) & ~_objects()),
        Mistake("That is how many there are. Which cells are they? An array of shape (4, 4) is wanted.",
                number(lambda: _ghosts().sum()), example=lambda: int(_ghosts().sum())),
        Mistake("Those are places. Mark them in an array of truth values of shape (4, 4): its first index is y, its second x.",
                lambda answer: np.shape(answer) in {(3, 2), (2, 3)}, example=lambda: np.argwhere(_ghosts())),
    ],
)  # fmt: skip

exercise(
    "10.3",
    right=number(14),
    example=14,
    otherwise="AND needs all k views: which power of 0.95 falls below one half first?",
    mistakes=[
        Mistake("With so many cameras it still keeps a little more than half.",
                number(13), example=13),
        Mistake("Solved, but not a count of cameras yet: cameras come whole, and the share must be below one half.",
                number(float(np.log(0.5) / np.log(0.95)), tol=0.05), example=13.51),
        Mistake("You subtracted 5 % for each camera. Independent probabilities multiply.",
                lambda answer: any(number(count)(answer) for count in (10, 11)), example=11),
        Mistake("You asked when all views miss an object at once. AND loses it as soon as one of them does.",
                number(1), example=1),
    ],
)  # fmt: skip

exercise(
    "10.4",
    right=numbers(_coverage, tol=0.02),
    example=_coverage,
    otherwise="For each height: shadow_mask of both cameras, fuse, then footprint_coverage of the ball's base_m.",
    mistakes=[
        Mistake("These are per cent. Shares from 0 to 1 are wanted.",
                numbers(lambda: 100 * _coverage(), tol=2), example=lambda: 100 * _coverage()),
        Mistake("The order is wrong: the lowest camera comes first.",
                numbers(_coverage, tol=0.02, ordered=False), example=lambda: _coverage()[::-1]),
        Mistake("Your ball is twice too large: 0.6 m is its diameter.",
                numbers(lambda: ball_coverage(HEIGHTS_M, diameter=1.2), tol=0.005),
                example=lambda: ball_coverage(HEIGHTS_M, diameter=1.2)),
        Mistake("That is the uncovered share.", numbers(lambda: 1 - _coverage(), tol=0.02), example=lambda: 1 - _coverage()),
        Mistake("Everything is covered? You joined the views with OR, or looked at one view only.",
                lambda answer: np.shape(answer) == (4,) and float(np.min(answer)) > 0.9, example=np.ones(4)),
    ],
)  # fmt: skip
