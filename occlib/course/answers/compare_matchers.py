"""Exercises of chapter 04, "Compare matchers"."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from occlib import matching, study
from occlib.base.arrays import FloatArray
from occlib.course.checking import Mistake, exercise, number, numbers

ROW, BUMP = np.array([5, 5, 5, 1, 9, 1, 5, 5, 3, 19, 3, 5], float), np.array([1, 9, 1], float)
GAINS = np.arange(1.0, 0.25, -0.1).round(1)


@lru_cache(maxsize=4)
def _lowest_gain(method: str) -> float:
    """The lowest gain at which the best place is within 5 px of the truth."""
    kept = []
    for gain in GAINS:
        trial = study.make_trial("coins", 0, "gain", gain)
        if study.measured_trial(trial, matching.METHODS[method], 5.0)["found"]:
            kept.append(gain)
    return float(min(kept))


def _centred(*, image: bool = True, template: bool = True) -> FloatArray:
    """SSD after removing the means of the windows, of the template, or of both."""
    windows = np.lib.stride_tricks.sliding_window_view(ROW, len(BUMP))
    f = windows - (windows.mean(axis=1, keepdims=True) if image else 0.0)
    t = BUMP - (BUMP.mean() if template else 0.0)
    return np.asarray(np.mean((f - t) ** 2, axis=1))


@lru_cache(maxsize=1)
def _gain_trials() -> study.tables.pd.DataFrame:
    work = study.batches("default", sources=["coins", "four_robots"], conditions=["gain"], seeds=range(4))
    return study.run(work, ["ssd"], progress=False)


def _areas() -> FloatArray:
    means = study.areas(_gain_trials()).groupby("source")["area"].mean()
    return np.array([means["coins"], means["four_robots"]])


def _recalls() -> FloatArray:
    means = _gain_trials().groupby("source")["found"].mean()
    return np.array([means["coins"], means["four_robots"]])


exercise(
    "04.1",
    right=number(0.335 / 0.8, tol=0.002),
    example=0.335 / 0.8,
    otherwise="Add the trapezoids between neighbouring levels, and divide by the whole range of the levels.",
    mistakes=[
        Mistake("As a share of the whole: divide by the range of the levels.", number(0.335, tol=0.002), 0.335),
        Mistake(
            "That is the mean of the four recalls. The levels are not equally far apart, so they do not count alike.",
            number(0.55, tol=0.005),
            0.55,
        ),
        Mistake(
            "Between two levels recall falls in a line, not in a step.",
            lambda answer: any(number(area, tol=0.005)(answer) for area in (0.6125, 0.225)),
            0.6125,
        ),
        Mistake("An area is between 0 and 1, not a percentage.", number(41.875, tol=0.5), 41.9),
    ],
)

exercise(
    "04.2",
    right=number(lambda: _lowest_gain("ssd"), tol=0.001),
    example=lambda: _lowest_gain("ssd"),
    otherwise="For each gain take the best place of SSD and its distance from the true corner, then the lowest gain that is right.",
    mistakes=[
        Mistake(
            "There SSD has already lost it. The last gain at which it is right is asked for.",
            number(lambda: _lowest_gain("ssd") - 0.1, tol=0.001),
            lambda: _lowest_gain("ssd") - 0.1,
        ),
        Mistake(
            "That measure hardly knows the gain. Use SSD.",
            number(lambda: _lowest_gain("zncc"), tol=0.001),
            lambda: _lowest_gain("zncc"),
        ),
        Mistake(
            "No place is right? A place of the score is (row, column); the true corner is (x, y).",
            lambda answer: np.size(answer) == 0 or (np.isscalar(answer) and not np.isfinite(answer)),
            float("inf"),
        ),
    ],
)

exercise(
    "04.3",
    right=lambda answer: numbers(_centred, tol=0.01)(np.ravel(answer)),
    example=_centred,
    otherwise="Ten windows of three numbers: subtract from each its own mean, from the template its mean, then take Equation 2.",
    mistakes=[
        Mistake(
            "The windows keep their means. Each window has its own, which must go.",
            numbers(lambda: _centred(image=False), tol=0.01),
            lambda: _centred(image=False),
        ),
        Mistake(
            "The template keeps its mean, which must go, too.",
            numbers(lambda: _centred(template=False), tol=0.01),
            lambda: _centred(template=False),
        ),
        Mistake(
            "That is SSD as it was: nothing has been removed.",
            numbers(lambda: _centred(image=False, template=False), tol=0.01),
            lambda: _centred(image=False, template=False),
        ),
        Mistake(
            "Equation 2 takes the mean of the squares, not their sum.",
            numbers(lambda: 3 * _centred(), tol=0.01),
            lambda: 3 * _centred(),
        ),
        Mistake(
            "There are ten places for three numbers in twelve.", lambda answer: np.size(answer) != 10, np.zeros(12)
        ),
    ],
)

exercise(
    "04.4",
    right=numbers(_areas, tol=0.01),
    example=_areas,
    otherwise="One condition, one measure, two sources, four draws; the mean of the areas over the draws, for each source.",
    mistakes=[
        Mistake("The coins first, then the robots.", numbers(lambda: _areas()[::-1], tol=0.01), lambda: _areas()[::-1]),
        Mistake(
            "That is the mean recall. Let study.areas weigh the levels.",
            numbers(_recalls, tol=0.01),
            _recalls,
        ),
        Mistake("That is ZNCC, or another measure that does not know the gain.", numbers([1, 1], tol=0.02), (1.0, 1.0)),
        Mistake("A pair is asked for: one area for each source.", lambda answer: np.size(answer) != 2, 0.8),
    ],
)
