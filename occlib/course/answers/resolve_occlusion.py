"""The exercises of chapter 07."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from occlib import foreground, metrics, occlusion
from occlib.base.arrays import FloatArray, Mask
from occlib.course.checking import Mistake, array, exercise, number, numbers
from occlib.course.lessons import resolve_occlusion as lesson
from occlib.formats import load_truth
from occlib.pipeline import Pipeline, backgrounds_of, settings_for
from occlib.recordings import open_recording
from occlib.registration import FloorWarp


@cache
def scene() -> tuple[Any, dict[str, Any], dict[str, Any], list[Any]]:
    """Rig, pictures, backgrounds and true objects of the ball and the oval."""
    recording = open_recording("ball_and_oval", ["left", "right"])
    frame, images = next(recording.images())
    truth = load_truth(recording.path / "truth.json").frames[frame]
    return recording.rig, dict(images), dict(backgrounds_of(recording)), list(truth)


@cache
def _views(profile: str) -> dict[str, Mask]:
    """Each view's foreground on the floor, with the threshold and channels of a profile."""
    rig, images, backgrounds, _ = scene()
    settings = settings_for(profile).foreground
    evidence = {name: settings.evidence(image, backgrounds[name]) for name, image in images.items()}
    return {name: FloorWarp(rig[name], rig.floor).warp(one.values) > one.level for name, one in evidence.items()}


def _ratio(profile: str, rule: str = "or", names: tuple[str, ...] = ("left", "right")) -> float:
    rig, _, _, truth = scene()
    fused = occlusion.fuse([_views(profile)[name] for name in names], rule)
    return metrics.claimed_area_ratio(fused, rig.floor, [true.footprint for true in truth]) or 0.0


exercise(
    "07.1",
    right=number(lambda: _ratio("paper"), rel=0.02),
    example=lambda: _ratio("paper"),
    otherwise="Fuse both masks of views['paper'] with the rule 'or', then take metrics.claimed_area_ratio of the result.",
    mistakes=[
        Mistake(
            "That is the map of the AND. Which cells does OR keep besides those?",
            number(lambda: _ratio("paper", "and"), rel=0.02),
            lambda: _ratio("paper", "and"),
        ),
        Mistake(
            "That is a single view. OR takes both.",
            lambda answer: any(number(_ratio("paper", "or", (name,)), rel=0.02)(answer) for name in ("left", "right")),
            lambda: _ratio("paper", "or", ("right",)),
        ),
        Mistake(
            "You added the two views' ratios. A cell that both views claim is then counted twice.",
            number(lambda: sum(_ratio("paper", "or", (name,)) for name in ("left", "right")), rel=0.01),
            lambda: sum(_ratio("paper", "or", (name,)) for name in ("left", "right")),
        ),
        Mistake(
            "Those are the masks of the profile 'and', whose threshold is lower. Take views['paper'].",
            number(lambda: _ratio("and"), rel=0.02),
            lambda: _ratio("and"),
        ),
    ],
)


@cache
def _difference(colour: bool = True, camera: str = "left") -> Any:
    _, images, backgrounds, _ = scene()
    return foreground.smooth(foreground.subtract_background(images[camera], backgrounds[camera], colour=colour))


def _count(compare: Any, difference: Any) -> int:
    return int(compare(difference, foreground.otsu_threshold(difference)).sum())


exercise(
    "07.2",
    right=number(lambda: _count(np.equal, _difference())),
    example=lambda: _count(np.equal, _difference()),
    otherwise="Compare the array `difference` with `otsu` by == and count the True values.",
    mistakes=[
        Mistake(
            "Those are the pixels above or at the threshold: the whole foreground. How many are exactly at it?",
            lambda answer: any(
                number(_count(compare, _difference()))(answer) for compare in (np.greater_equal, np.greater)
            ),
            lambda: _count(np.greater_equal, _difference()),
        ),
        Mistake(
            "That is the count for the gray difference (colour=False) and its own threshold. Take the colour difference.",
            number(lambda: _count(np.equal, _difference(colour=False))),
            lambda: _count(np.equal, _difference(colour=False)),
        ),
        Mistake(
            "That is the right view. The exercise asks for the left one.",
            number(lambda: _count(np.equal, _difference(camera="right"))),
            lambda: _count(np.equal, _difference(camera="right")),
        ),
    ],
)


def _overlap(*, centre_m: float = 0.3, opening: float = 1.0) -> FloatArray:
    """The overlap of the shadows of a ball under two cameras 3 m away, at four heights."""
    heights, distance, radius = np.array([1.5, 2.5, 4.0, 8.0]), 3.0, 0.3
    phi = np.arctan2(heights - centre_m, distance)
    delta = np.arcsin(radius / np.hypot(distance, heights - centre_m))
    return np.asarray(2 * (distance - heights / np.tan(phi + opening * delta)))


exercise(
    "07.3",
    right=numbers(_overlap, rel=0.02, tol=0.0051),
    example=_overlap,
    otherwise="For each height: phi, delta and x_near by the formulas of 'Why the ball becomes oval'. "
    "Each shadow begins D - x_near before the middle of the ball.",
    mistakes=[
        Mistake(
            "That is what one shadow reaches beyond the middle of the ball. The other camera adds the same on its side.",
            numbers(lambda: _overlap() / 2, rel=0.02),
            lambda: _overlap() / 2,
        ),
        Mistake(
            "Those are fractions of the diameter. The exercise asks for the overlap in m.",
            numbers(lambda: _overlap() / 0.6, rel=0.02),
            lambda: _overlap() / 0.6,
        ),
        Mistake(
            "Those look like cm. The answer is in m.",
            numbers(lambda: 100 * _overlap(), rel=0.02),
            lambda: 100 * _overlap(),
        ),
        Mistake(
            "The ray goes to the middle of the ball, which is a radius above the floor: phi takes H - R, not H.",
            numbers(lambda: _overlap(centre_m=0.0), rel=0.005),
            lambda: _overlap(centre_m=0.0),
        ),
        Mistake(
            "You took the far ends: phi - delta. The overlap lies between the near ends.",
            numbers(lambda: _overlap(opening=-1.0), rel=0.02),
            lambda: _overlap(opening=-1.0),
        ),
        Mistake(
            "You left delta out: the ray through the ball's middle does not graze it.",
            numbers(lambda: _overlap(opening=0.0), rel=0.02),
            lambda: _overlap(opening=0.0),
        ),
        Mistake(
            "Four numbers, please: one for each height, in an array of shape (4,).",
            lambda answer: np.shape(answer) != (4,),
            0.2,
        ),
    ],
)


def _cells(*values: int) -> Any:
    return array(lambda: np.array(values))


exercise(
    "07.4",
    right=_cells(100, 0, 0, 0, -1, -1),
    example=np.array([100, 0, 0, 0, -1, -1]),
    otherwise="Ask of each cell, in this order: do both views claim it? If not, does some view have it in its picture and not "
    "claim it? If not, it is unknown.",
    mistakes=[
        Mistake(
            "Six whole numbers, please, in an array of shape (6,), each 100, 0 or -1.",
            lambda answer: np.shape(answer) != (6,) or not np.isin(answer, (100, 0, -1)).all(),
            np.array([[100, 0, 0, 0, -1, -1]]),
        ),
        Mistake(
            "The second cell is the left camera's shadow. What does the right camera see there?",
            lambda answer: np.asarray(answer)[1] != 0,
            np.array([100, -1, 0, 0, -1, -1]),
        ),
        Mistake(
            "No camera has the last cell in its picture. Called free, it would say: drive here.",
            lambda answer: np.asarray(answer)[5] == 0,
            np.array([100, 0, 0, 0, -1, 0]),
        ),
        Mistake(
            "The fifth cell is claimed by the only view that has it in its picture. Has anybody seen bare floor there?",
            lambda answer: np.asarray(answer)[4] == 0,
            np.array([100, 0, 0, 0, 0, -1]),
        ),
        Mistake(
            "The fifth cell is claimed by one view only. Is that both?",
            lambda answer: np.asarray(answer)[4] == 100,
            np.array([100, 0, 0, 0, 100, -1]),
        ),
        Mistake(
            "The third cell is in both pictures, and nobody claims it. What do both cameras see there?",
            lambda answer: np.asarray(answer)[2] != 0,
            np.array([100, 0, -1, 0, -1, -1]),
        ),
        Mistake(
            "The fourth cell is in one picture only, and that view does not claim it. One look at bare floor is enough.",
            lambda answer: np.asarray(answer)[3] == -1,
            np.array([100, 0, 0, -1, -1, -1]),
        ),
    ],
)


@cache
def _objects_with_hole(side_px: int, rule: str = "and") -> int:
    rig, images, backgrounds, truth = scene()
    pixel = rig["left"].floor_to_pixels([[truth[1].x, truth[1].y]])[0]
    torn = lesson.cut_hole(images, backgrounds, "left", pixel, side_px)
    return len(Pipeline(rig, backgrounds, settings_for("and", rule=rule)).process(torn, 0.0).objects)


def _largest_hole_px() -> int:
    """The last side, in steps of 5 px, with which both objects are on the map."""
    side = 0
    while side < 60 and _objects_with_hole(side + 5) == 2:
        side += 5
    return side


exercise(
    "07.5",
    right=number(lambda: _largest_hole_px() + 5),
    example=lambda: _largest_hole_px() + 5,
    otherwise="For each side: cut the hole, run a new pipeline with settings_for('and'), count result.objects.",
    mistakes=[
        Mistake(
            "With this side both objects are still on the map. The exercise asks for the first side with fewer.",
            number(_largest_hole_px),
            _largest_hole_px,
        ),
        Mistake(
            "That is half of the side. `cut_hole` takes the whole side of the square.",
            number(lambda: (_largest_hole_px() + 5) / 2),
            lambda: (_largest_hole_px() + 5) / 2,
        ),
        Mistake(
            "With this side the coverage begins to fall, but the map still has two objects.",
            number(5),
            5,
        ),
        Mistake(
            "With this side an object is lost, but a smaller hole is enough.",
            lambda answer: any(number(side)(answer) for side in range(_largest_hole_px() + 10, 61, 5)),
            60,
        ),
        Mistake(
            "Did you run the rule 'or'? It counts one object already without a hole.",
            number(0),
            0,
        ),
    ],
)
