"""Answers of chapter 01, "Calibrate the cameras"."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from occlib import calibration, lab
from occlib.base import read_image
from occlib.base.arrays import FloatArray
from occlib.course.checking import Mistake, between, exercise, number, numbers
from occlib.geometry import Rig, apply_homography
from occlib.recordings import LAB

POINT_M = [1.0, 0.5]


@cache
def rig() -> Rig:
    """The exact cameras."""
    return Rig.load(LAB / "calibration" / "rig.yaml")


@cache
def ratios() -> tuple[float, float]:
    """Focal length and distance of the first board, with squares of 0.10 m over the true ones."""
    size = calibration.parse_pattern("9x6")
    paths = sorted((LAB / "calibration" / "frames" / "left").glob("*.jpg"))[:8]
    corners = [found for path in paths if (found := calibration.find_checkerboard(read_image(path), size)) is not None]
    boards = [calibration.board_points(size, side) for side in (0.10, lab.load_scene("calibration").boards[0].square)]
    new, old = (calibration.calibrate(corners, board, rig()["left"].size) for board in boards)
    distances = [float(np.linalg.norm(lens.translations[0])) for lens in (new, old)]
    return float(new.matrix[0, 0] / old.matrix[0, 0]), distances[0] / distances[1]


def pixel(camera: str = "left", *, distort: bool = True) -> FloatArray:
    """Where a camera sees the point."""
    seen = rig()[camera].floor_to_pixels([POINT_M])
    return np.asarray((seen if distort else rig()[camera].lens.undistort(seen))[0], dtype=np.float64)


def homogeneous() -> FloatArray:
    """The undistorted pixel before the division by its third coordinate."""
    return np.asarray(np.linalg.inv(rig()["left"].image_to_floor) @ [*POINT_M, 1.0], dtype=np.float64)


def not_inverted() -> list[list[float]]:
    """The pixels that come of H itself, without the lens and with it."""
    raw = apply_homography(rig()["left"].image_to_floor, [POINT_M])
    return [raw[0].tolist(), rig()["left"].lens.distort(raw)[0].tolist()]


def swapped() -> list[list[float]]:
    """The pixels of the floor point with x and y exchanged, with the lens and without it."""
    seen = rig()["left"].floor_to_pixels([POINT_M[::-1]])
    return [seen[0].tolist(), rig()["left"].lens.undistort(seen)[0].tolist()]


def not_divided(answer: Any) -> bool:
    """Whether the answer, with or without the lens, was not divided by the third coordinate."""
    raw = homogeneous()[:2]
    wrongs = [raw.tolist(), rig()["left"].lens.distort([raw])[0].tolist()]
    return any(numbers(wrong, rel=0.01)(answer) for wrong in wrongs)


exercise(
    "01.1",
    right=number(2500 / 450, rel=0.02),
    example=2500 / 450,
    otherwise="One pixel is to the focal length as its piece of floor is to the height.",
    mistakes=[
        Mistake("That is in metres; the answer is in millimetres.", number(2.5 / 450, rel=0.02), example=2.5 / 450),
        Mistake(
            "That is how many pixels there are to a millimetre: the other way round.",
            number(450 / 2500, rel=0.02),
            example=450 / 2500,
        ),
        Mistake(
            "That is how many pixels there are to a metre: the other way round.",
            number(450 / 2.5, rel=0.02),
            example=180.0,
        ),
        Mistake(
            "That is in centimetres; the answer is in millimetres.", number(250 / 450, rel=0.02), example=250 / 450
        ),
        Mistake(
            "That is an area. The side of the piece of floor is asked for.",
            number((2500 / 450) ** 2, rel=0.02),
            example=(2500 / 450) ** 2,
        ),
        Mistake("A ratio is asked for, not a product.", number(450 * 2.5, rel=0.02), example=450 * 2.5),
    ],
)

exercise(
    "01.2",
    right=numbers(ratios, rel=0.005),
    example=ratios,
    otherwise="Calibrate with board_points(size, 0.10) and divide its fx and its first distance by those of lenses['left'].",
    mistakes=[
        Mistake(
            "The ratios are the wrong way up: new over old.",
            numbers(lambda: (1 / ratios()[0], 1 / ratios()[1]), rel=0.005),
            example=lambda: (1 / ratios()[0], 1 / ratios()[1]),
        ),
        Mistake(
            "The order: first the focal length, then the distance.",
            numbers(lambda: ratios()[::-1], rel=0.005),
            example=lambda: ratios()[::-1],
        ),
        Mistake(
            "Did the focal length really change with the distance? The pixels of the corners are the same as before.",
            numbers(lambda: (ratios()[1], ratios()[1]), rel=0.005),
            example=lambda: (ratios()[1], ratios()[1]),
        ),
        Mistake(
            "Those are the new values. Divide each by the old one.",
            lambda answer: 400 < answer[0] < 500,
            example=(452.5, 1.21),
        ),
        Mistake(
            "Nothing changed at all: was the calibration made with the new board?",
            numbers([1.0, 1.0], rel=0.005),
            example=[1.0, 1.0],
        ),
    ],
)

exercise(
    "01.3",
    right=numbers(pixel, tol=0.1),
    example=pixel,
    otherwise="Invert H, apply it to (x, y, 1), divide by the third coordinate, then distort.",
    mistakes=[
        Mistake(
            "That is the undistorted pixel. The lens still bends the ray.",
            numbers(lambda: pixel(distort=False), tol=0.1),
            example=lambda: pixel(distort=False),
        ),
        Mistake("Swapped: u is the column and comes first.", numbers(lambda: pixel()[::-1], tol=0.1), example=lambda: pixel()[::-1]),
        Mistake(
            "x and y of the floor point are swapped: x = 1.0 m comes first.",
            lambda answer: any(numbers(wrong, tol=0.1)(answer) for wrong in swapped()),
            example=lambda: swapped()[0],
        ),
        Mistake(
            "You took the distortion away once more. The lens adds it: distort, not undistort.",
            numbers(lambda: rig()["left"].lens.undistort([pixel(distort=False)])[0], tol=0.1),
            example=lambda: rig()["left"].lens.undistort([pixel(distort=False)])[0],
        ),
        Mistake("Do not round to whole pixels.", numbers(lambda: pixel().round(), tol=0.01), example=lambda: pixel().round()),
        Mistake("That is the right camera.", numbers(lambda: pixel("right"), tol=0.1), example=lambda: pixel("right")),
        Mistake("Divide by the third coordinate before you distort.", not_divided, example=lambda: homogeneous()[:2]),
        Mistake(
            "H takes pixels to the floor. To go from the floor to the picture, invert it.",
            lambda answer: any(numbers(wrong, tol=0.5)(answer) for wrong in not_inverted()),
            example=lambda: not_inverted()[0],
        ),
    ],
)  # fmt: skip

exercise(
    "01.4",
    right=between(15.0, 40.0),
    example=27.8,
    otherwise="20 times: marks[0] plus rng.normal(0, 1, marks[0].shape), refit, largest of floor_error_mm; then the median.",
    mistakes=[
        Mistake("That is in metres; the answer is in millimetres.", between(0.015, 0.04), example=0.0278),
        Mistake(
            "That is the error at a typical point of the floor. Take the largest on the grid, then the median over the trials.",
            between(4.0, 13.0),
            example=8.1,
        ),
        Mistake("That is in centimetres; the answer is in millimetres.", between(1.5, 3.9), example=2.78),
        Mistake("Those are all the trials. Take their median.", lambda answer: np.size(answer) == 20, example=np.full(20, 27.0)),
        Mistake("That is the error with the marks as they are. Add the noise to their pixels.", between(0.4, 0.8), example=0.55),
        Mistake("That is the worst of the trials, or twice the noise. Take the median of the trials.", between(40.1, 110.0), example=42.6),
    ],
)  # fmt: skip

exercise(
    "01.5",
    right=number(1),
    example=1,
    otherwise="Leave one mark out, refit, and look at the largest residual of the other seven. Without which mark is it small?",
    mistakes=[
        Mistake(
            "That one misses by most when it is left out, but the wrong mark took part in predicting it. Do the others agree without it?",
            number(2),
            example=2,
        ),
        Mistake(
            "That is the mark that the chapter moved. This list is another one: lesson.mismeasured(marks[1]).",
            number(0),
            example=0,
        ),
    ],
)
