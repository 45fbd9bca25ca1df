"""Exercises of chapter 03, "Match templates"."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any

import numpy as np

from occlib import foreground, lab, matching, recordings
from occlib.base.arrays import Image, Mask
from occlib.course.checking import Mistake, exercise, number, numbers, word
from occlib.course.lessons import match_templates as lesson

SOURCE, TARGET, MARGIN_PX, NEAR_PX = 3, 2, 4, 25.0
FACTORS = np.arange(0.95, 0.49, -0.05).round(2)


@lru_cache(maxsize=1)
def _scene() -> dict[str, Any]:
    """The left camera's six instants of the recording, as in the chapter."""
    recording = recordings.open_recording("robot", ["left"])
    images = {frame: views["left"] for frame, views in recording.images()}
    robots = lesson.true_robots("robot", images, "left")
    background = foreground.average_background(recording.background_images()["left"])
    windows = {frame: lesson.window_around(robot, MARGIN_PX) for frame, robot in robots.items()}
    return {"images": images, "robots": robots, "windows": windows, "background": background}


@cache
def _silhouette() -> Mask:
    """The rover's visible pixels at the template's instant."""
    return lab.silhouettes(lab.load_scene("robot"), SOURCE)["left"]["rover"][1]


@cache
def _distance(*, masked: bool = True, differences: bool = False, corners: bool = False) -> float:
    """From the best place at instant 0 to the robot, px."""
    scene = _scene()
    window, robot = scene["windows"][SOURCE], scene["robots"][0]

    def picture(frame: int) -> Image:
        image = scene["images"][frame]
        return lesson.difference_of(image, scene["background"]) if differences else foreground.to_grey(image)

    template = picture(SOURCE)[window]
    mask = _silhouette()[window] if masked else None
    y, x = matching.best(matching.similarity(picture(0), template, "ssd", mask), "ssd")
    place = (x, y) if corners else (x + (template.shape[1] - 1) / 2, y + (template.shape[0] - 1) / 2)
    return float(np.hypot(*np.subtract(place, robot.middle)))


def _own_templates(threshold: str | None) -> list[int]:
    scene = _scene()
    stacked = np.min(list(scene["images"].values()), axis=0)
    image = lesson.difference_of(stacked, scene["background"])
    found = (matching.find(image, image[window], threshold=threshold) for window in scene["windows"].values())
    return [lesson.count_right(matches, scene["robots"], NEAR_PX) for matches in found]


def _lowest(*, decided: bool = True, grey: bool = False) -> float:
    """The lowest factor of the right half at which the place is right, and accepted."""
    scene = _scene()

    def picture(image: Image) -> Image:
        return foreground.to_grey(image) if grey else lesson.difference_of(image, scene["background"])

    template = picture(scene["images"][SOURCE])[scene["windows"][SOURCE]]
    kept = []
    for factor in FACTORS:
        half = picture(lesson.half_lit(scene["images"][TARGET], factor))
        row = lesson.search_each({TARGET: half}, template, scene["robots"], NEAR_PX).iloc[0]
        if row["right"] and (not decided or row["best ssd"] <= matching.default_threshold(half, template)):
            kept.append(factor)
    return float(min(kept))


exercise(
    "03.1",
    right=lambda answer: numbers([4, 1], tol=0.01)(np.ravel(answer)),
    example=(4.0, 1.0),
    otherwise="SSD first: square the three differences and take their mean. ZNCC: remove each mean, then compare the shapes.",
    mistakes=[
        Mistake("The SSD of Equation 2 is a mean, not a sum.", numbers([12, 1], tol=0.01), (12.0, 1.0)),
        Mistake(
            "SSD squares the differences; you took their size, which is SAD.", numbers([2, 1], tol=0.01), (2.0, 1.0)
        ),
        Mistake(
            "ZNCC removes the means of window and template first; what you have is NCC.",
            numbers([4, 0.925], tol=0.01),
            (4.0, 0.925),
        ),
        Mistake("The other way round: the SSD first, then the ZNCC.", numbers([1, 4], tol=0.01), (1.0, 4.0)),
        Mistake("Two numbers are asked for: the SSD and the ZNCC.", lambda answer: np.size(answer) == 1, 4.0),
    ],
)

exercise(
    "03.2",
    right=number(_distance, tol=1.5),
    example=_distance,
    otherwise="Cut the mask and the template with the same window, take the best place, and add half of the template's size.",
    mistakes=[
        Mistake(
            "That is the search without the mask. Pass it on to the search.",
            number(lambda: _distance(masked=False), tol=1.5),
            lambda: _distance(masked=False),
        ),
        Mistake(
            "That is from the top-left pixel of the best place. Take the centre of its window.",
            number(lambda: _distance(corners=True), tol=1.5),
            lambda: _distance(corners=True),
        ),
        Mistake(
            "Search the grey pictures, not the differences.",
            number(lambda: _distance(differences=True), tol=0.3),
            lambda: _distance(differences=True),
        ),
        Mistake("That is the template's own instant. Search instant 0.", number(0, tol=0.1), 0.0),
    ],
)

exercise(
    "03.3",
    right=numbers(lambda: _own_templates("otsu")),
    example=lambda: _own_templates("otsu"),
    otherwise='Six searches in the stacked difference, each with its own template and threshold="otsu"; count the robots found.',
    mistakes=[
        Mistake(
            'Those are the default thresholds. Ask for threshold="otsu".',
            numbers(lambda: _own_templates(None)),
            lambda: _own_templates(None),
        ),
        Mistake("One number for each of the six templates is asked for.", lambda answer: np.size(answer) != 6, 6),
        Mistake(
            "In the order of the instants, 0 to 5, please.",
            numbers(lambda: _own_templates("otsu"), ordered=False),
            lambda: _own_templates("otsu")[::-1],
        ),
    ],
)

exercise(
    "03.4",
    right=number(_lowest, tol=0.001),
    example=_lowest,
    otherwise="Compare the best SSD with half of the template's variance, for each factor in turn, from the top.",
    mistakes=[
        Mistake(
            "There the threshold already rejects the robot. The last factor at which it accepts is asked for.",
            number(lambda: _lowest() - 0.05, tol=0.001),
            lambda: _lowest() - 0.05,
        ),
        Mistake(
            "There the best place is still right, but does the threshold accept it?",
            number(lambda: _lowest(decided=False), tol=0.001),
            lambda: _lowest(decided=False),
        ),
        Mistake(
            "That is the grey picture. Subtract the background first, from the picture and for the template.",
            number(lambda: _lowest(grey=True), tol=0.001),
            lambda: _lowest(grey=True),
        ),
        Mistake(
            "Accepted down to the last factor? Darken the right half only, columns 320 and up: the robot stands in it.",
            number(0.5, tol=0.001),
            0.5,
        ),
        Mistake(
            "The factor is asked for, not a percentage.",
            number(lambda: 100 * _lowest(), tol=0.1),
            lambda: 100 * _lowest(),
        ),
        Mistake("A number is asked for.", word("no", "yes", "never"), "never"),
    ],
)
