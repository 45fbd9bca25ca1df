"""Answers of chapter 12, "Enter a real laboratory"; none needs the recording."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from occlib import floor_marks, formats, metrics
from occlib.course.checking import Mistake, between, exercise, number, word
from occlib.course.lessons.enter_a_real_laboratory import seen_today
from occlib.geometry import Rig
from occlib.recordings import DATA
from occlib.registration import registration_error_m

HOME = DATA / "ufes-lab"
TILT_DEG = float(np.degrees(0.03 * 2.9 / (4**2 + 2.9**2)))
GHOST_M = (0.0, 0.0)
REGION = "cam2+cam3 wide"


@cache
def errors_cm() -> dict[str, np.ndarray]:
    """How far off each camera's marks land today, cm."""
    rig, marks = Rig.load(HOME / "rig.yaml"), floor_marks.load_marks(HOME / "floor_marks.yaml")
    today = seen_today(rig, marks)
    return {name: 100 * registration_error_m(rig[name], today[name], marks[name][1]) for name in today}


def knocked_camera() -> tuple[str, float]:
    """The camera with the largest median error, and that error."""
    medians = {name: float(np.median(error)) for name, error in errors_cm().items()}
    worst = max(medians, key=lambda name: medians[name])
    return worst, medians[worst]


def named(answer: Any, value: float, *, name: str | None = None) -> bool:
    """Whether an answer is the knocked camera (or ``name``) and this number within 5 %."""
    said, told = answer
    return bool(word(name or knocked_camera()[0])(said) and number(value, rel=0.05)(told))


@cache
def score(region: str | None = REGION, *, every: int = 2) -> metrics.Score:
    """A pipeline that reports A exactly, B never, and a ghost in every so many marked frames, or never for 0."""
    truth = formats.load_truth(HOME / "truth.json")
    told = {f: [(p.x, p.y) for p in people if p.id == "A"] for f, people in truth.frames.items()}
    for frame in list(truth.frames)[::every] if every else ():
        told[frame].append(GHOST_M)
    return metrics.evaluate(told, truth, roi=region)


exercise(
    "12.1",
    right=number(TILT_DEG, rel=0.03),
    example=TILT_DEG,
    otherwise="Solve the equation of the knocked camera for the angle, with all lengths in metres, and give it in degrees.",
    mistakes=[
        Mistake("That is in radians; the answer is in degrees.", number(np.radians(TILT_DEG), rel=0.02), example=np.radians(TILT_DEG)),
        Mistake("Three centimetres are 0.03 m, not 0.3 m or 3 m.", lambda a: any(number(k * TILT_DEG, rel=0.02)(a) for k in (10, 100)), example=100 * TILT_DEG),
        Mistake(
            "The slant matters: the equation has the squared distance *and* the squared height.",
            number(np.degrees(0.03 * 2.9 / 4**2), rel=0.02),
            example=np.degrees(0.03 * 2.9 / 4**2),
        ),
        Mistake(
            "That would be the angle if the camera looked at the point from the side: 3 cm over the distance. It looks at a slant.",
            lambda a: any(number(np.degrees(0.03 / d), rel=0.02)(a) for d in (4.0, np.hypot(4, 2.9))),
            example=np.degrees(0.03 / 4),
        ),
    ],
)  # fmt: skip

exercise(
    "12.2",
    right=lambda answer: named(answer, knocked_camera()[1]),
    example=knocked_camera,
    otherwise="For each camera the median of registration_error_m of today's pixels; the camera with the largest, and that in cm.",
    mistakes=[
        Mistake(
            "The camera is right, but the number is in metres. The answer is in cm.",
            lambda answer: named(answer, knocked_camera()[1] / 100),
            example=lambda: (knocked_camera()[0], knocked_camera()[1] / 100),
        ),
        Mistake(
            "The camera is right. Take the median over its marks, not the mean.",
            lambda answer: named(answer, float(errors_cm()[knocked_camera()[0]].mean())),
            example=lambda: (knocked_camera()[0], float(errors_cm()[knocked_camera()[0]].mean())),
        ),
        Mistake(
            "The camera is right. Take the median over its marks, not the largest.",
            lambda answer: named(answer, float(errors_cm()[knocked_camera()[0]].max())),
            example=lambda: (knocked_camera()[0], float(errors_cm()[knocked_camera()[0]].max())),
        ),
        Mistake(
            "That camera still agrees with its marks to a few centimetres. Compare all four.",
            lambda answer: answer[0] in errors_cm() and answer[0] != knocked_camera()[0],
            example=("cam0", 1.0),
        ),
        Mistake(
            "A pair is asked for: the camera's name and its error.", lambda answer: np.size(answer) == 1, example="cam2"
        ),
        Mistake(
            "Order: first the camera's name, a text, then the number.",
            lambda answer: isinstance(answer[1], str),
            example=lambda: knocked_camera()[::-1],
        ),
    ],
)

exercise(
    "12.3",
    right=number(lambda: score().moda or 0.0, tol=0.005),
    example=lambda: score().moda,
    otherwise="Build {frame: [A's place, the ghost]} and call metrics.evaluate with the truth and the region; then its moda.",
    mistakes=[
        Mistake("That is the recall, or the MODA without the ghosts. MODA counts each ghost like a person missed.", number(lambda: score().recall or 0.0, tol=0.005), example=lambda: score().recall),
        Mistake("That is the precision: the missed people do not count in it.", number(lambda: score().precision or 0.0, tol=0.005), example=lambda: score().precision),
        Mistake(
            "That is the score on the whole floor. Give evaluate the region (roi).",
            number(lambda: score(None).moda or 0.0, tol=0.005),
            example=lambda: score(None).moda,
        ),
        Mistake(
            "That is with a ghost in every frame, or in those of an even number. Take every second one of truth.frames.",
            number(lambda: score(every=1).moda or 0.0, tol=0.005),
            example=lambda: score(every=1).moda,
        ),
        Mistake(
            "That is the small region. The wide one is asked for.",
            number(lambda: score("cam2+cam3").moda or 0.0, tol=0.005),
            example=lambda: score("cam2+cam3").moda,
        ),
        Mistake("That is the whole score. Which of its fields is asked for?", lambda a: isinstance(a, metrics.Score), example=score),
        Mistake("A fraction is asked for, not a percentage.", number(lambda: 100 * (score().moda or 0.0), rel=0.02), example=26.4),
        Mistake("That is the F-measure.", number(lambda: score().f1 or 0.0, tol=0.005), example=lambda: score().f1),
    ],
)  # fmt: skip

exercise(
    "12.4",
    right=between(1.4, 3.0),
    example=2.0,
    otherwise="200 times: four marks at random, refit, median error of the other marks in cm; then the median over all fits that were made.",
    mistakes=[
        Mistake("That is in metres; the answer is in cm.", between(0.014, 0.03), example=0.02),
        Mistake(
            "That is about what all marks together give. Fit only four, and measure at the others.",
            between(0.6, 1.39),
            example=0.9,
        ),
        Mistake("That is no typical draw: some four nearly lie on a line. Take the median over the draws.", between(3.01, 1e6), example=40.0),
        Mistake("Measured at the four marks that were fitted? Four marks fix a homography exactly.", number(0.0, tol=0.001), example=0.0),
    ],
)  # fmt: skip
