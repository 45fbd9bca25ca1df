"""Where the other robots will be: trajectories, and whether discs that move along them stay apart.

A *trajectory* is a list of ``(t, x, y)`` in s and m, straight and even in between; before its first point the robot
stands there, and after its last it stands there for ever. That every trajectory ends in standing still is what keeps
robots apart: each holds one that is clear of all the others', and takes a new one only if that is clear, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Mask

Point: TypeAlias = tuple[float, float]


Trajectory: TypeAlias = list[tuple[float, float, float]]


TOUCH_M = 1e-6
"""Two discs may overlap by so much and still count as apart: rounding."""


def position_at(trajectory: Sequence[Sequence[float]], time_s: float) -> Point:
    """Where a trajectory is at a time, ``(x, y)`` in m.

    >>> position_at([(0.0, 1.0, 2.0), (2.0, 3.0, 2.0)], 0.5)
    (1.5, 2.0)
    """
    t, x, y = _trajectory(trajectory).T
    return float(np.interp(time_s, t, x)), float(np.interp(time_s, t, y))


class Reservations:
    """Where the other robots will be: discs that move along trajectories.

    Examples
    --------
    >>> others = Reservations()
    >>> others.reserve("B", [(0.0, 0.0, 0.0), (2.0, 2.0, 0.0)], 0.2)
    >>> others.clear([(0.0, 1.0, 0.5)], 0.2), others.clear([(0.0, 1.0, 0.3)], 0.2)
    (True, False)
    """

    def __init__(self) -> None:
        self._held: dict[str, tuple[FloatArray, FloatArray | None, float]] = {}

    def reserve(
        self,
        name: str,
        trajectory: Sequence[Sequence[float]],
        radius_m: float,
        *,
        intention: Sequence[Sequence[float]] | None = None,
    ) -> None:
        """Hold, or replace, what a robot has announced.

        Parameters
        ----------
        name
            Of the robot.
        trajectory
            What it will do: nobody may come in its way.
        radius_m
            Of its disc.
        intention
            What it would do if nobody of lower priority stood in its way. Given for robots of *higher* priority than
            one's own, and only for them: it is kept free if that can be done, which is how robots that meet in a
            corridor make way.
        """
        checks.number("radius_m", radius_m, above=0, unit="metres")
        self._held[name] = _trajectory(trajectory), None if intention is None else _trajectory(intention), radius_m

    def release(self, name: str) -> None:
        """Forget a robot; no matter if it is not there."""
        self._held.pop(name, None)

    def higher(self) -> Reservations:
        """Only the robots of higher priority, those with an intention."""
        return self._with({name: held for name, held in self._held.items() if held[1] is not None})

    def firm(self) -> Reservations:
        """All robots, without their intentions."""
        return self._with({name: (path, None, radius) for name, (path, _, radius) in self._held.items()})

    def discs(self, time_s: float) -> list[tuple[float, float, float]]:
        """``(x, y, radius)`` of each robot at a time, in m."""
        return [(*position_at(path.tolist(), time_s), radius) for path, _, radius in self._held.values()]

    def clear(self, trajectory: Sequence[Sequence[float]], radius_m: float) -> bool:
        """Whether a disc on a trajectory never touches another's, from its first point on; intentions do not count."""
        own = _trajectory(trajectory)
        return all(
            _gap(own, path) >= min(radius_m + radius, _apart(own, path)) - TOUCH_M
            for path, _, radius in self._held.values()
        )

    def gaps(self, start_m: npt.ArrayLike, time_s: float, radius_m: float) -> list[tuple[FloatArray, float]]:
        """Every trajectory and intention, ``(n, 3)``, and how far in m a disc that starts there has to keep from it.

        That is the sum of the radii, or what there is now if the two already touch.
        """
        own = np.array([[time_s, *np.asarray(start_m, dtype=np.float64)]])
        return [
            (path, max(min(radius_m + held[2], _apart(own, path)) - TOUCH_M / 2, 0.0))
            for held in self._held.values()
            for path in held[:2]
            if path is not None
        ]

    @staticmethod
    def _with(held: dict[str, tuple[FloatArray, FloatArray | None, float]]) -> Reservations:
        made = Reservations()
        made._held = held
        return made


def _trajectory(points: Sequence[Sequence[float]]) -> FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array) or not np.isfinite(array).all():
        raise ValueError(f"trajectory: expected one or more (t, x, y), got shape {array.shape}")
    if (np.diff(array[:, 0]) <= 0).any():
        raise ValueError("trajectory: expected times that rise")
    return array


def _at(path: FloatArray, times: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(times, path[:, 0], path[:, k]) for k in (1, 2)])


def _apart(own: FloatArray, other: FloatArray) -> float:
    """Distance of two centres at the first point of the former: who is too close already only may not come closer."""
    return float(np.hypot(*(own[0, 1:] - _at(other, own[:1, 0])[0])))


def _gap(own: FloatArray, other: FloatArray) -> float:
    """Least distance of two centres from the first point of the former on; exact."""
    times = np.unique(np.concatenate([own[:, 0], other[:, 0]]))
    times = times[times >= own[0, 0]]
    apart = _at(own, times) - _at(other, times)
    a, d = apart[:-1], np.diff(apart, axis=0)
    s = np.clip(-(a * d).sum(axis=1) / np.maximum((d * d).sum(axis=1), 1e-300), 0, 1)
    return float(np.hypot(*np.vstack([apart[-1:], a + s[:, None] * d]).T).min())


def pieces_of(
    others: Iterable[tuple[FloatArray, float]], start: float, dt: float, steps: int
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """The others' trajectories cut at our steps and at their own points, and where each step's pieces begin.

    A row is ``(s0, s1, x0, y0, x1, y1, gap)``: even motion over a part ``s0`` to ``s1`` of the step.
    """
    grid = start + dt * np.arange(steps + 1)
    rows, owner = [np.empty((0, 7))], [np.empty(0, np.int64)]
    for path, gap in others:
        knots = np.unique(np.concatenate([grid, path[(path[:, 0] > grid[0]) & (path[:, 0] < grid[-1]), 0]]))
        places = _at(path, knots)
        step = np.clip(((knots[1:] + knots[:-1]) / 2 - start) // dt, 0, steps - 1)
        fraction = [(end - start) / dt - step for end in (knots[:-1], knots[1:])]
        rows.append(np.column_stack([*fraction, places[:-1], places[1:], np.full(len(step), gap)]))
        owner.append(step.astype(np.int64))
    order = np.argsort(np.concatenate(owner), kind="stable")
    return np.vstack(rows)[order], np.searchsorted(np.concatenate(owner)[order], np.arange(steps + 1))


def stands_clear(xy: FloatArray, others: Iterable[tuple[FloatArray, float]], time_s: float) -> Mask:
    """Which places nobody comes near after a time."""
    clear = np.ones(len(xy), bool)
    for path, gap in others:
        later = np.vstack([[time_s, *_at(path, np.array([time_s]))[0]], path[path[:, 0] > time_s]])[:, 1:]
        for a, d in zip(later, np.diff(later, axis=0, append=later[-1:]), strict=True):
            s = np.clip(((xy - a) @ d) / max(float(d @ d), 1e-300), 0, 1)
            clear &= np.hypot(*(xy - a - s[:, None] * d).T) >= gap
    return clear
