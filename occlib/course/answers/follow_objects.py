"""The exercises of chapter 08."""

from __future__ import annotations

from functools import cache
from typing import Any

from occlib.course.checking import Mistake, exercise, number
from occlib.course.lessons import follow_objects as lesson
from occlib.formats import load_truth
from occlib.recordings import open_recording
from occlib.tracking import Observation, Tracker

# --- 08.1: how often must we look?

exercise(
    "08.1",
    right=number(0.1 / 0.5, tol=0.001),
    example=0.2,
    otherwise="At birth V is zero, so the prediction stays where the robot was seen. How long does it take to leave the gate?",
    mistakes=[
        Mistake("That is the number of frames a second. The exercise asks for the time between two of them.", number(5.0), 5.0),
        Mistake("That looks like ms. The answer is in s.", number(200.0), 200.0),
        Mistake("You multiplied: speed times distance is no time.", number(0.05), 0.05),
        Mistake("The gate reaches that far in each direction; do not double or halve it.",
                lambda answer: any(number(value)(answer) for value in (0.4, 0.1)), 0.4),
    ],
)  # fmt: skip

# --- 08.2: a sceptical filter


def _second_velocity(noise_m: float, forgotten: float = 1.0) -> float:
    """Velocity after the second frame by the formula; ``forgotten``: which part of the noise in the denominator is kept."""
    sigma, a, dt = 1.0, 1.0, 0.1
    p_pp = noise_m**2 + sigma**2 * dt**2 + a**2 * dt**4 / 4
    p_pv = sigma**2 * dt + a**2 * dt**3 / 2
    return p_pv / (p_pp + forgotten * noise_m**2) * 0.1


def _tracked(noise_m: float) -> float:
    tracker = Tracker(position_noise_m=noise_m)
    vectors = [tracker.update([Observation((x, 0.0), 0.04, (0, 0, 0))], x)[0] for x in (0.0, 0.1)]
    return float(vectors[1].velocity_mps[0])


exercise(
    "08.2",
    right=number(lambda: _tracked(0.2), rel=0.01),
    example=lambda: _tracked(0.2),
    otherwise="P_pp and k_V with r = 0.2 m, all else as above. The prediction is off by one step of the dot: V = k_V times that.",
    mistakes=[
        Mistake("That is the gain k_V. The velocity is the gain times what the prediction is off.",
                number(lambda: 10 * _tracked(0.2), rel=0.01), lambda: 10 * _tracked(0.2)),
        Mistake("That is the value for the default r. Put r = 0.2 m.", number(lambda: _tracked(0.05), rel=0.01),
                lambda: _tracked(0.05)),
        Mistake("r² comes twice in the denominator of k_V: once in P_pp, for the first sight, and once for the second.",
                number(lambda: _second_velocity(0.2, 0.0), rel=0.01), lambda: _second_velocity(0.2, 0.0)),
        Mistake("r is squared in both places.", number(lambda: 0.01005 / (2 * 0.2 + 0.010025), rel=0.01),
                lambda: 0.01005 / (2 * 0.2 + 0.010025)),
    ],
)  # fmt: skip

# --- 08.3: births and deaths

LIMITS = (0.25, 0.5, 1.0, 1.5, 2.0)


@cache
def _identities(limit: float) -> int:
    tracker = Tracker(max_missed_s=limit)
    for time, sights in lesson.two_robots():
        tracker.update(sights, time)
    return len({event.id for event in tracker.events})


def _smallest_limit() -> float:
    return next(limit for limit in LIMITS if _identities(limit) == 2)


exercise(
    "08.3",
    right=number(_smallest_limit),
    example=_smallest_limit,
    otherwise="For each value: a new Tracker, the whole script, and the different ids in tracker.events. A and B make two.",
    mistakes=[
        Mistake("That value works, but is there a smaller one?", number(2.0), 2.0),
        Mistake("That bridges the short absence only. After the long one B is a stranger again.",
                lambda answer: any(number(value)(answer) for value in (0.5, 1.0)), 1.0),
        Mistake("With this value B is a stranger after each of its absences.", number(0.25), 0.25),
        Mistake("That is a number of identities. The exercise asks for the limit in s.", number(3), 3),
    ],
)  # fmt: skip

# --- 08.4: what memory alone would have predicted


@cache
def _rover() -> tuple[dict[int, float], list[int], float]:
    """The rover's true y by frame, the frames in which it is hidden from the left, and frames a second."""
    recording = open_recording("long_occlusion", ["left", "right"])
    truth = load_truth(recording.path / "truth.json")
    rover = {frame: lesson.true_object(truth, frame, "rover") for frame in truth.frames}
    hidden = [frame for frame, true in rover.items() if true.hidden_fraction["left"] >= 0.9]
    return {frame: float(true.y) for frame, true in rover.items()}, hidden, float(recording.fps)


def _overshoot(per_second: bool = True) -> float:
    y, hidden, fps = _rover()
    start, end = hidden[0], hidden[-1]
    speed = (y[start - 1] - y[start - 2]) * (fps if per_second else 1.0)
    return y[start - 1] + speed * (end - start + 1) / fps - y[end]


def _driven() -> float:
    y, hidden, _ = _rover()
    return y[hidden[-1]] - y[hidden[0]]


def _predicted() -> float:
    y, hidden, _ = _rover()
    return _overshoot() + y[hidden[-1]]


def _near(value: Any, tol: float = 0.02) -> Any:
    return number(value, tol=tol)


exercise(
    "08.4",
    right=_near(_overshoot, 0.05),
    example=_overshoot,
    otherwise="Velocity: the difference of the last two true y before it is hidden, times fps. Prediction: last y plus velocity times "
    "the time until the last hidden frame. The answer is the prediction less the true y there.",
    mistakes=[
        Mistake("The sign: how far is the prediction ahead of the rover, prediction less truth?",
                _near(lambda: -_overshoot(), 0.05), lambda: -_overshoot()),
        Mistake("That is how far the rover drives while it is hidden. How far off is the prediction?", _near(_driven), _driven),
        Mistake("That is the predicted y. How far is it from the true one?", _near(_predicted), _predicted),
        Mistake("Is your velocity in m per frame? Then the time must be counted in frames, too.",
                _near(lambda: _overshoot(per_second=False)), lambda: _overshoot(per_second=False)),
    ],
)  # fmt: skip
