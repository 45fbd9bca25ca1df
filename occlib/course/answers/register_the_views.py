"""The exercises of chapter 06."""

from __future__ import annotations

from functools import cache

import numpy as np

from occlib.course.checking import Mistake, between, exercise, number, numbers
from occlib.course.lessons.register_the_views import views_on_plane
from occlib.geometry import Floor, apply_homography
from occlib.lab import load_scene, silhouettes
from occlib.recordings import open_recording

CORNERS_M = np.array([[-2, -1.5], [2, -1.5], [2, 1.5], [-2, 1.5]])
SMALLEST_M = 8 * np.radians(0.5)
"""The least error at 4 m for half a degree: 2 d times the angle, at H = d."""


@cache
def _careless_m(name: str = "left") -> np.ndarray:
    """How far the corners of the floor land from the truth if a camera's lens is forgotten, (4,) in m."""
    camera = open_recording("ball_and_oval", [name]).rig[name]
    landed = apply_homography(camera.image_to_floor, camera.floor_to_pixels(CORNERS_M))
    return np.linalg.norm(landed - CORNERS_M, axis=1)


@cache
def _largest_at_m() -> float:
    """The height at which both views of the cabinet agree on most of the plane, to 1 cm."""
    scene = load_scene("long_occlusion")
    masks = {name: shapes["cabinet"][0] for name, shapes in silhouettes(scene, 50).items()}
    floor = Floor(scene.rig.floor.x, scene.rig.floor.y, 0.02)
    heights = np.arange(0.3, 0.61, 0.01)
    areas = [np.all(list(views_on_plane(scene.rig, masks, floor, height).values()), axis=0).sum() for height in heights]
    return float(heights[int(np.argmax(areas))])


exercise(
    "06.1",
    right=numbers([0, 12], tol=0.01),
    example=(0, 12),
    otherwise="Divide both coordinates by w = 1 - v / 4, or let `geometry.apply_homography` do it for the point (0, 3).",
    mistakes=[
        Mistake(
            "So it would be if the transform only stretched everything twice. The divisor w depends on v.",
            numbers([0, 6], tol=0.01),
            (0, 6),
        ),
        Mistake("You forgot to divide by w.", numbers([0, 3], tol=0.01), (0, 3)),
        Mistake(
            "That is homogeneous: divide the first two numbers by the third.",
            lambda answer: np.size(answer) == 3,
            np.array([0, 3, 0.25]),
        ),
        Mistake("The point is (0, 3): u is 0 and v is 3.", numbers([3, 0], tol=0.01), (3, 0)),
        Mistake("That is one coordinate. A place has two: x and y.", lambda answer: np.size(answer) == 1, 3.0),
        Mistake("You multiplied by w instead of dividing by it.", numbers([0, 0.75], tol=0.01), (0, 0.75)),
        Mistake("That is x and y in the other order.", numbers([12, 0], tol=0.01), (12, 0)),
        Mistake(
            "NaN belongs to (0, 4), the horizon. The first point has a place.",
            lambda answer: bool(np.isnan(np.asarray(answer, dtype=float)).any()),
            (np.nan, np.nan),
        ),
    ],
)

exercise(
    "06.2",
    right=number(lambda: _careless_m().mean(), tol=0.004),
    example=lambda: float(_careless_m().mean()),
    otherwise="Take the corners to raw pixels, those through the homography, and compare with the corners in m.",
    mistakes=[
        Mistake(
            "No error at all: `pixels_to_floor` undistorts. Apply the homography `image_to_floor` itself.",
            between(0, 0.001),
            0.0,
        ),
        Mistake(
            "This is the largest of the four distances; the mean is asked for.",
            number(lambda: _careless_m().max(), tol=0.002),
            lambda: float(_careless_m().max()),
        ),
        Mistake("These are the four distances. Take their mean.", lambda answer: np.size(answer) == 4, _careless_m),
        Mistake(
            "That is the right camera.",
            number(lambda: _careless_m("right").mean(), tol=0.0005),
            lambda: float(_careless_m("right").mean()),
        ),
        Mistake(
            "This is the norm of all eight differences together. Take the distance of each corner (axis=1), then the mean.",
            number(lambda: float(np.linalg.norm(_careless_m())), tol=0.002),
            lambda: float(np.linalg.norm(_careless_m())),
        ),
        Mistake(
            "This looks like mm or cm. Give it in m.",
            lambda answer: 15 < float(answer) < 200,
            lambda: 1000 * float(_careless_m().mean()),
        ),
        Mistake(
            "This is the mean over x and y apart. A distance is the root of the sum of the squares of the two.",
            lambda answer: 0.05 < float(answer) < 0.15,
            0.12,
        ),
    ],
)

exercise(
    "06.3",
    right=lambda answer: np.size(answer) == 2 and all(np.abs(np.ravel(answer) - [4, SMALLEST_M]) < [0.15, 0.001]),
    example=(4.0, SMALLEST_M),
    otherwise="Compute (H² + d²) / H times the angle for many H at d = 4 m, and find the smallest.",
    mistakes=[
        Mistake(
            "The height is right, but the error is in degrees times metres: the formula wants the angle in radians.",
            numbers([4, 4], tol=0.15),
            (4.0, 4.0),
        ),
        Mistake(
            "The height comes first, then the error.",
            lambda answer: abs(answer[1] - 4) < 0.15 and answer[0] < 1,
            (SMALLEST_M, 4.0),
        ),
        Mistake(
            "The height is right. The error lacks a factor: the formula is (H² + d²) / H *times* the angle.",
            numbers([4, 8], tol=0.15),
            (4.0, 8.0),
        ),
        Mistake(
            "The height is right. Give the error in m.",
            lambda answer: abs(answer[0] - 4) < 0.15 and answer[1] > 5,
            (4.0, 6.98),
        ),
        Mistake(
            "The height is right. In the error, put this height and d = 4 m into the formula once more.",
            lambda answer: abs(answer[0] - 4) < 0.15,
            (4.0, 0.035),
        ),
        Mistake(
            "That is the place in the list. Give the height there.", lambda answer: answer[0] > 31, (300, SMALLEST_M)
        ),
        Mistake(
            "This is the height of our own cameras. Let H vary.",
            lambda answer: abs(answer[0] - 2.5) < 0.01,
            (2.5, 0.0777),
        ),
        Mistake(
            "Higher is not always better: look at the error over the whole range of heights.",
            lambda answer: answer[0] > 20,
            (30.0, 0.266),
        ),
    ],
)

exercise(
    "06.4",
    right=number(_largest_at_m, tol=0.035),
    example=0.45,
    otherwise="Count the cells that both views claim on each plane, and take the height of the plane with the most.",
    mistakes=[
        Mistake(
            "Exactly half the height would be right if the rays were parallel. They are not: measure it.",
            number(0.36, tol=0.02),
            0.36,
        ),
        Mistake(
            "On the floor both views agree on the base only. Look at the planes above it.", number(0.0, tol=0.02), 0.0
        ),
        Mistake(
            "That is the area in m². The height at which it is so large is asked for.",
            between(0.815, 0.84),
            example=0.83,
        ),
        Mistake(
            "A step beside the best one: compare the areas of the neighbouring planes.",
            lambda answer: between(0.39, 0.41)(answer) or between(0.49, 0.51)(answer),
            example=0.5,
        ),
        Mistake("Up there the views do not meet any more. Did you take the smallest area?", between(0.8, 1.0), 0.85),
        Mistake(
            "At the top both views agree on the top's outline only. There is a plane with more.",
            between(0.66, 0.76),
            0.7,
        ),
        Mistake(
            "This looks like a number of the step or centimetres. Give the height in m.",
            lambda answer: 5 < float(answer) < 1000,
            45,
        ),
    ],
)
