"""The exercises of chapter 05."""

from __future__ import annotations

from functools import cache

import numpy as np

from occlib.base.arrays import FloatArray, Mask
from occlib.course.checking import Mistake, exercise, number, numbers
from occlib.course.lessons.localize_objects import away_and_sideways, largest_region
from occlib.foreground import foreground_mask
from occlib.formats import load_truth
from occlib.geometry import Camera
from occlib.localization import Region, scale_table
from occlib.pipeline import backgrounds_of
from occlib.recordings import open_recording

TOLERANCE_M = 0.002


@cache
def _robot() -> tuple[Camera, Mask, Region, FloatArray]:
    """The left camera, the robot's mask and region in pose 0, and its true place in m."""
    recording = open_recording("robot", ["left"])
    ((_, images),) = recording.images([0])
    own, region = largest_region(foreground_mask(images["left"], backgrounds_of(recording)["left"]))
    true = load_truth(recording.path / "truth.json").frames[0][0]
    return recording.rig["left"], own, region, np.array([true.x, true.y])


def _away_m(row: float) -> float:
    """Error of the robot's place in m, away from the camera, if it is taken from this row below its centroid's column."""
    camera, _, region, place = _robot()
    return float(away_and_sideways(camera.pixels_to_floor([[region.centroid[0], row]])[0], place, camera)[0])


def _bottom() -> int:
    box = _robot()[2].box
    return box[1] + box[3] - 1


@cache
def _factors() -> FloatArray:
    """The scale factor of each pixel of the left camera: one pixel a cell, slow."""
    return scale_table(_robot()[0], cell_px=1).factors


@cache
def _weighted_m(power: float, *, on_floor: bool = True) -> float:
    """The same for the mean of all pixels, weighted by a power of their scale factors, on the floor or in the picture."""
    camera, own, _, place = _robot()
    pixels = np.argwhere(own)[:, ::-1].astype(float)
    weights = _factors()[own] ** power
    if on_floor:
        mean = np.average(camera.pixels_to_floor(pixels), axis=0, weights=weights)
    else:
        mean = camera.pixels_to_floor([np.average(pixels, axis=0, weights=weights)])[0]
    return float(away_and_sideways(mean, place, camera)[0])


exercise(
    "05.1",
    right=numbers([11.6, 6.4], tol=0.01),
    example=(11.6, 6.4),
    otherwise="Pad `tiny` with zeros above and to the left, find its one region again, and take its `centroid`.",
    mistakes=[
        Mistake(
            "These are (row, column). A point is (x, y), the column first.", numbers([6.4, 11.6], tol=0.01), (6.4, 11.6)
        ),
        Mistake(
            "You moved it 10 rows and 5 columns: the first pair of `np.pad` is for the rows.",
            numbers([6.6, 11.4], tol=0.01),
            (6.6, 11.4),
        ),
        Mistake(
            "This is where the letter was. Padding on the right or below does not move it.",
            numbers([1.6, 1.4], tol=0.01),
            (1.6, 1.4),
        ),
        Mistake("Do not round: a centroid lies between pixels.", numbers([12, 6], tol=0.01), (12, 6)),
        Mistake(
            "This is only how far the letter was moved. Add where it was before.", numbers([10, 5], tol=0.01), (10, 5)
        ),
    ],
)

exercise(
    "05.2",
    right=number(lambda: _away_m(_bottom()), tol=TOLERANCE_M),
    example=lambda: _away_m(_bottom()),
    otherwise="Project (column of the centroid, last row of the box) to the floor, and take the first of the two errors, in m.",
    mistakes=[
        Mistake(
            "Right in size, but mind the sign: is the near edge of the robot further from the camera than its middle?",
            number(lambda: -_away_m(_bottom()), tol=TOLERANCE_M),
            lambda: -_away_m(_bottom()),
        ),
        Mistake(
            "One row too far down: a box of `height` rows that begins at `top` ends before row `top + height`.",
            number(lambda: _away_m(_bottom() + 1), tol=TOLERANCE_M),
            lambda: _away_m(_bottom() + 1),
        ),
        Mistake(
            "This is the highest row. Rows grow downwards, so `top` is the far end.",
            number(lambda: _away_m(_robot()[2].box[1]), tol=TOLERANCE_M),
            lambda: _away_m(_robot()[2].box[1]),
        ),
        Mistake(
            "This is still the centroid's error.",
            number(lambda: _away_m(_robot()[2].centroid[1]), tol=TOLERANCE_M),
            lambda: _away_m(_robot()[2].centroid[1]),
        ),
        Mistake(
            "This looks like centimetres: give it in m.",
            lambda answer: number(lambda: _away_m(_bottom()), rel=0.02)(float(np.asarray(answer).item()) / 100),
            lambda: 100 * _away_m(_bottom()),
        ),
        Mistake(
            "These are both errors, along the direction of sight and across it. Only the first is asked for.",
            lambda answer: (
                np.size(answer) == 2 and number(lambda: _away_m(_bottom()), tol=TOLERANCE_M)(np.ravel(answer)[0])
            ),
            lambda: (_away_m(_bottom()), -0.001),
        ),
        Mistake(
            "More than half a metre off: `pixels_to_floor` takes (column, row).",
            lambda answer: 0.5 < abs(float(answer)) < 10,
            -1.32,
        ),
    ],
)

exercise(
    "05.3",
    right=number(lambda: _weighted_m(1), tol=TOLERANCE_M),
    example=lambda: _weighted_m(1),
    otherwise="Weight each pixel's floor point by its own scale factor; compare the weighted mean with the true place, in m.",
    mistakes=[
        Mistake(
            "You averaged the pixels and then projected the mean. Project each pixel first: the projection is not linear.",
            number(lambda: _weighted_m(1, on_floor=False), tol=TOLERANCE_M),
            lambda: _weighted_m(1, on_floor=False),
        ),
        Mistake(
            "Here every pixel still counts the same. Give `np.average` the weights.",
            number(lambda: _weighted_m(0), tol=TOLERANCE_M),
            lambda: _weighted_m(0),
        ),
        Mistake(
            "This is the error of the plain centroid, Eq 3 and 4.",
            number(lambda: _away_m(_robot()[2].centroid[1]), tol=TOLERANCE_M),
            lambda: _away_m(_robot()[2].centroid[1]),
        ),
        Mistake(
            "You divided by the scale factors. The far pixels are to count more, not less.",
            number(lambda: _weighted_m(-1), tol=TOLERANCE_M),
            lambda: _weighted_m(-1),
        ),
        Mistake(
            "This looks like centimetres: give it in m.",
            number(lambda: 100 * _weighted_m(1), rel=0.02),
            lambda: 100 * _weighted_m(1),
        ),
        Mistake(
            "More than a metre off: `np.argwhere` gives (row, column), `pixels_to_floor` takes (column, row).",
            lambda answer: number(0.0, tol=10.0)(answer) and abs(float(np.asarray(answer).item())) > 1,
            -1.33,
        ),
        Mistake(
            "These are both errors, along the direction of sight and across it. Only the first is asked for.",
            lambda answer: (
                np.size(answer) == 2 and number(lambda: _weighted_m(1), tol=TOLERANCE_M)(np.ravel(answer)[0])
            ),
            lambda: (_weighted_m(1), -0.001),
        ),
        Mistake(
            "This is how much larger or smaller the error is. The error itself is asked for.",
            number(lambda: _weighted_m(1) - _away_m(_robot()[2].centroid[1]), tol=TOLERANCE_M),
            lambda: _weighted_m(1) - _away_m(_robot()[2].centroid[1]),
        ),
    ],
)

exercise(
    "05.4",
    right=numbers([1.0, np.sqrt(2)], tol=0.06),
    example=(1.02, 1.414),
    otherwise="For each shape divide the largest distance by the smallest, measured from its own centroid.",
    mistakes=[
        Mistake("In the other order: the disc comes first.", numbers([np.sqrt(2), 1.0], tol=0.06), (1.414, 1.02)),
        Mistake(
            "You divided the smallest by the largest distance.", numbers([1.0, np.sqrt(0.5)], tol=0.04), (0.98, 0.707)
        ),
        Mistake(
            "Here the mean is one of the two distances: take the largest over the smallest.",
            numbers([1.0, 1.25], tol=0.06),
            (1.01, 1.24),
        ),
        Mistake(
            "This ratio for the disc is far from round: measure from its centroid, not from a corner of the array.",
            lambda answer: np.shape(answer) == (2,) and float(np.asarray(answer)[0]) > 1.5,
            (4.2, 5.0),
        ),
    ],
)
