"""The exercises of chapter 00."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from occlib import metrics
from occlib.course.answers.resolve_occlusion import scene
from occlib.course.checking import Mistake, exercise, number
from occlib.course.lessons import resolve_occlusion
from occlib.pipeline import FrameResult, Pipeline, settings_for

# --- 00.1: a shadow that ends at x = 0.48 m


def _height(shadow: float = 0.48 - 0.2, distance: float = 0.2 + 3.05) -> float:
    """Of the box whose shadow is so long, in m, from s = d h / (H - h)."""
    return shadow * 2.5 / (distance + shadow)


exercise(
    "00.1",
    right=number(_height, tol=0.002),
    example=_height,
    otherwise="The shadow may reach from the far edge of the box to the front edge of the flat object. "
    "Put this length for s and solve s (H - h) = d h for h.",
    mistakes=[
        Mistake(
            "That is the length of the shadow. The exercise asks for the height of the box that casts it.",
            number(0.28, tol=1e-6),
            0.28,
        ),
        Mistake("That looks like cm. The answer is in m.", number(lambda: 100 * _height(), tol=0.5), 19.8),
        Mistake(
            "The shadow begins at the far edge of the box, not at x = 0.",
            number(lambda: _height(0.48), tol=0.002),
            lambda: _height(0.48),
        ),
        Mistake(
            "d is the distance from the foot of the lamp, which hangs 3.05 m to the left of x = 0.",
            number(lambda: _height(distance=0.2), tol=0.002),
            lambda: _height(distance=0.2),
        ),
        Mistake(
            "With this height the shadow ends at the far edge of the flat object. Its front edge is to be seen.",
            number(lambda: _height(0.72 - 0.2), tol=0.002),
            lambda: _height(0.72 - 0.2),
        ),
        Mistake(
            "That is how much lower the box must become. How high is it then?",
            number(lambda: 0.6 - _height(), tol=0.003),
            lambda: 0.6 - _height(),
        ),
        Mistake(
            "You divided by d alone, as if the shadow were d h / H. The ray comes from the lamp down to the floor: H - h.",
            number(lambda: 0.28 * 2.5 / 3.25, tol=0.002),
            lambda: 0.28 * 2.5 / 3.25,
        ),
    ],
)

# --- 00.2: what the second camera turns to free


@cache
def _both(threshold: float | None = None) -> FrameResult:
    rig, images, backgrounds, _ = scene()
    return Pipeline(rig, backgrounds, settings_for("and", threshold=threshold)).process(images, 0.0)


def _freed(camera: str = "left") -> float:
    views = _both().views
    return 1 - float((views["left"] & views["right"]).sum() / views[camera].sum())


def _other_shares() -> list[float]:
    """What the second camera frees over the cells of either view, and of the whole map."""
    left, right = (_both().views[name] for name in ("left", "right"))
    freed = (left & ~right).sum()
    return [float(freed / (left | right).sum()), float(freed / left.size)]


exercise(
    "00.2",
    right=number(_freed, tol=0.005),
    example=_freed,
    otherwise="Count the cells that the left view claims and the right view does not, and divide by all that the left view claims.",
    mistakes=[
        Mistake(
            "That is the share that stays occupied. Which share becomes free?",
            number(lambda: 1 - _freed(), tol=0.005),
            lambda: 1 - _freed(),
        ),
        Mistake(
            "That is a percentage. The exercise asks for a share from 0 to 1.",
            number(lambda: 100 * _freed(), tol=0.5),
            lambda: 100 * _freed(),
        ),
        Mistake(
            "That is a number of cells. Divide it by the number of cells that the left view claims.",
            number(lambda: _freed() * _both().views["left"].sum(), tol=1),
            lambda: _freed() * _both().views["left"].sum(),
        ),
        Mistake(
            "By what did you divide? All cells that the left view claims are the whole, not the map and not both views together.",
            lambda answer: any(number(share, tol=0.005)(answer) for share in _other_shares()),
            lambda: _other_shares()[0],
        ),
        Mistake(
            "That is the right view's share. The exercise asks for the left one's.",
            number(lambda: _freed("right"), tol=0.005),
            lambda: _freed("right"),
        ),
    ],
)

# --- 00.3: a ratio of 1 is no proof

LEVELS = (25, 40, 55, 70, 85)


def _ratio_and_coverage(level: float) -> tuple[float, Any]:
    rig, _, _, truth = scene()
    footprints = [true.footprint for true in truth]
    occupied = _both(float(level)).map.data == 100
    ratio = metrics.claimed_area_ratio(occupied, rig.floor, footprints) or 0.0
    return ratio, metrics.footprint_coverage(occupied, rig.floor, footprints)


def _best_level() -> int:
    return min(LEVELS, key=lambda level: abs(_ratio_and_coverage(level)[0] - 1))


def _ball_covered() -> float:
    return float(_ratio_and_coverage(_best_level())[1][0])


exercise(
    "00.3",
    right=number(_ball_covered, tol=0.01),
    example=_ball_covered,
    otherwise="For each threshold: a new pipeline, its map, the claimed area ratio. Take the threshold whose ratio is closest to 1, "
    "and there the first number of metrics.footprint_coverage.",
    mistakes=[
        Mistake(
            "That is the threshold. How much of the ball's footprint does its map cover?",
            number(_best_level),
            _best_level,
        ),
        Mistake(
            "That is the claimed area ratio. The coverage of the ball at this threshold is asked for.",
            number(lambda: _ratio_and_coverage(_best_level())[0], tol=0.005),
            lambda: _ratio_and_coverage(_best_level())[0],
        ),
        Mistake(
            "Is this the ball? footprint_coverage has one number for each object, in the order of the truth. "
            "Or is it a threshold at which the map claims far too much?",
            number(1.0, tol=1e-3),
            1.0,
        ),
        Mistake(
            "At this threshold the map claims much less than the true area. Which one comes closest to 1?",
            number(lambda: float(_ratio_and_coverage(70)[1][0]), tol=0.01),
            lambda: float(_ratio_and_coverage(70)[1][0]),
        ),
        Mistake(
            "That is a percentage. The exercise asks for a number from 0 to 1.",
            number(lambda: 100 * _ball_covered(), tol=1),
            lambda: 100 * _ball_covered(),
        ),
        Mistake(
            "That is the part that is missing. Which part is covered?",
            number(lambda: 1 - _ball_covered(), tol=0.01),
            lambda: 1 - _ball_covered(),
        ),
        Mistake(
            "Those are the coverages of both objects. Only the ball's is asked for, one number.",
            lambda answer: np.shape(answer) == (2,),
            lambda: _ratio_and_coverage(_best_level())[1],
        ),
    ],
)

# --- 00.4: out of the ball's shadow


def _first_in_sight(half_length: float = 0.12) -> float:
    """The first of 0.6, 0.7, ... m at which an oval of this half length lies beyond the far end of the ball's shadow."""
    far = resolve_occlusion.grazing_ends(scene()[0], centre_x=-0.1, radius_m=0.3).to_numpy()[0, 1]
    return float(next(x for x in np.arange(0.6, 1.35, 0.1).round(1) if x - half_length > far))


exercise(
    "00.4",
    right=number(_first_in_sight, tol=0.01),
    example=_first_in_sight,
    otherwise="Move the oval object, ask lab.ground_truth for its hidden_fraction in the left view, and take the first x for which it is 0.",
    mistakes=[
        Mistake(
            "There its middle is in sight already, but a small part of it is still hidden.",
            number(lambda: _first_in_sight(0.0), tol=0.01),
            lambda: _first_in_sight(0.0),
        ),
        Mistake(
            "There a part of it is in sight. The exercise asks for the first place with all of it.",
            lambda answer: any(number(x, tol=0.01)(answer) for x in (0.8, 0.9)),
            0.9,
        ),
        Mistake(
            "There the left view still hides all of it.",
            lambda answer: any(number(x, tol=0.01)(answer) for x in (0.6, 0.7)),
            0.6,
        ),
        Mistake(
            "It is in sight there, but is there a smaller x?",
            lambda answer: any(number(x, tol=0.01)(answer) for x in (1.2, 1.3)),
            1.2,
        ),
    ],
)
