"""Object vectors M{p, V, C}: born, updated and gone (section 4 of the paper).

"We assign a parametric vector M_i{p(x_i, y_j), V, C} to each object, containing the centroid, velocity and
color information of the object. These dynamic vectors are created and destroyed based on the appearance and
disappearance of the objects." The paper does not say how a detection is joined to a vector, nor how V is
measured. Here: constant-velocity prediction, Hungarian assignment inside a gate, and a Kalman filter (Kalman
1960, doi:10.1115/1.3662552; piecewise white acceleration, Bar-Shalom et al. 2001, section 6.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from scipy.optimize import linear_sum_assignment

Point: TypeAlias = tuple[float, float]
Colour: TypeAlias = tuple[int, int, int]

_COLOUR_RANGE = 255 * math.sqrt(3)  # black to white
_BIRTH_SPEED = 1.0  # m/s, standard deviation of a new object's velocity
_FORBIDDEN = 1e9  # m, cost of a pair outside the gate


@dataclass(frozen=True)
class Observation:
    """One object as a single instant shows it, before it has an identity.

    Parameters
    ----------
    position_m
        Centroid (x, y) on the floor in m.
    area_m2
        Occupied floor area in m2.
    colour
        Mean (r, g, b), each 0 to 255.
    label
        Name of the template that it matched, if any.
    hidden_in
        Names of the cameras in which something hides it.
    """

    position_m: Point
    area_m2: float
    colour: Colour
    label: str | None = None
    hidden_in: tuple[str, ...] = ()


@dataclass(frozen=True)
class ObjectVector:
    """The paper's parametric vector ``M{p, V, C}`` of one object at one instant.

    Parameters
    ----------
    id
        1, 2, ... in order of appearance; never used again.
    position_m
        The centroid ``p`` (x, y) as measured at this instant, not filtered, in m.
    velocity_mps
        ``V`` (x, y) in m/s, filtered; (0, 0) at first sight.
    area_m2
        Occupied floor area in m2.
    colour
        ``C``, mean (r, g, b), each 0 to 255.
    label
        Name of the template that it matched last, or ``None`` if it never did.
    hidden_in
        Names of the cameras in which something hides it now.
    age
        Frames since it was born, 1 in its first.
    """

    id: int
    position_m: Point
    velocity_mps: Point
    area_m2: float
    colour: Colour
    label: str | None = None
    hidden_in: tuple[str, ...] = ()
    age: int = 1

    def to_dict(self) -> dict[str, Any]:
        """The object's entry in ``objects.jsonl``: m, m/s and m2, to 4 decimals.

        >>> ObjectVector(1, (0.5, 1.0), (0.1, 0.0), 0.04, (200, 30, 30), hidden_in=("cam2",)).to_dict()
        ... # doctest: +NORMALIZE_WHITESPACE
        {'id': 1, 'x': 0.5, 'y': 1.0, 'vx': 0.1, 'vy': 0.0, 'area': 0.04, 'colour': [200, 30, 30],
         'label': None, 'hidden_in': ['cam2']}
        """
        (x, y), (vx, vy) = self.position_m, self.velocity_mps
        numbers = {"x": x, "y": y, "vx": vx, "vy": vy, "area": self.area_m2}
        return {
            "id": self.id,
            **{name: round(float(value), 4) + 0.0 for name, value in numbers.items()},  # + 0.0: no "-0.0"
            "colour": [int(c) for c in self.colour],
            "label": self.label,
            "hidden_in": list(self.hidden_in),
        }


class _Track:
    """Kalman state of one object. x and y share one covariance, so it is three plain floats."""

    __slots__ = ("born", "colour", "id", "label", "pp", "pv", "time", "vv", "vx", "vy", "x", "y")

    def __init__(self, identity: int, seen: Observation, time: float, frame: int, noise_m: float) -> None:
        self.id, self.born = identity, frame
        (self.x, self.y), self.vx, self.vy = seen.position_m, 0.0, 0.0
        self.pp, self.pv, self.vv = noise_m**2, 0.0, _BIRTH_SPEED**2
        self.time, self.colour, self.label = time, seen.colour, seen.label

    def predict(self, time: float) -> Point:
        """Position in m at ``time`` if the velocity stays; the state is left as it is."""
        dt = time - self.time
        return self.x + self.vx * dt, self.y + self.vy * dt

    def update(self, seen: Observation, time: float, noise_m: float, acceleration: float) -> None:
        """Predict to ``time`` and correct by the measured position."""
        dt, q = time - self.time, acceleration**2
        (x, y), (zx, zy) = self.predict(time), seen.position_m
        pp = self.pp + dt * (2 * self.pv + dt * self.vv) + q * dt**4 / 4
        pv = self.pv + dt * self.vv + q * dt**3 / 2
        vv = self.vv + q * dt**2
        gain_p, gain_v = pp / (pp + noise_m**2), pv / (pp + noise_m**2)
        self.x, self.y = x + gain_p * (zx - x), y + gain_p * (zy - y)
        self.vx, self.vy = self.vx + gain_v * (zx - x), self.vy + gain_v * (zy - y)
        self.pp, self.pv, self.vv = (1 - gain_p) * pp, (1 - gain_p) * pv, vv - gain_v * pv
        self.time, self.colour, self.label = time, seen.colour, seen.label or self.label


class Tracker:
    """Gives detections their identity and velocity, frame after frame.

    Parameters
    ----------
    gate_m
        How far from its predicted position an object may be found, m.
    gate_growth_mps
        By how much the gate widens for each second since the object was last seen, m/s (no further than for
        ``max_missed_s``).
    max_missed_s
        An object is gone at the first frame that misses it after more than this many seconds unseen. Until
        then it coasts: it keeps its identity but is not reported.
    colour_weight_m
        Black against white counts as this many metres; decides between candidates at similar distance.
    position_noise_m, acceleration_mps2
        Standard deviations of a measured position and of an object's acceleration: a larger ratio gives a
        smoother, later velocity.

    Attributes
    ----------
    events : list of (float, int, str)
        Time in s, id, and "born" or "gone", in the order in which it happened.

    Examples
    --------
    >>> tracker = Tracker()
    >>> tracker.update([Observation((0.0, 0.0), 0.04, (200, 30, 30))], time=0.0)[0].id
    1
    >>> moved = tracker.update([Observation((0.1, 0.0), 0.04, (200, 30, 30))], time=0.1)[0]
    >>> moved.id, moved.position_m, moved.velocity_mps[0] > 0
    (1, (0.1, 0.0), True)
    """

    def __init__(
        self,
        *,
        gate_m: float = 0.5,
        gate_growth_mps: float = 1.0,
        max_missed_s: float = 1.0,
        colour_weight_m: float = 0.2,
        position_noise_m: float = 0.05,
        acceleration_mps2: float = 1.0,
    ) -> None:
        for name, value in (("gate_m", gate_m), ("position_noise_m", position_noise_m)):
            _check(name, value, positive=True)
        self.gate_m, self.position_noise_m = gate_m, position_noise_m
        self.gate_growth_mps = _check("gate_growth_mps", gate_growth_mps)
        self.max_missed_s = _check("max_missed_s", max_missed_s)
        self.colour_weight_m = _check("colour_weight_m", colour_weight_m)
        self.acceleration_mps2 = _check("acceleration_mps2", acceleration_mps2)
        self.events: list[tuple[float, int, str]] = []
        self._tracks: list[_Track] = []
        self._time = -math.inf
        self._frame = self._ids = 0

    def update(self, observations: Sequence[Observation], time: float) -> list[ObjectVector]:
        """Take one frame's observations; return their object vectors, in the same order.

        Parameters
        ----------
        observations
            What the frame shows, in any order; may be empty.
        time
            Seconds, later than in the last call.

        Raises
        ------
        ValueError
            ``time`` does not increase, or a position or area is not finite. The tracker stays as it was.
        """
        self.check_time(time)
        for index, seen in enumerate(observations):
            if not all(map(math.isfinite, (*seen.position_m, seen.area_m2))):
                raise ValueError(f"observations[{index}]: expected finite position and area, got {seen}")
        self._time, self._frame = time, self._frame + 1
        assigned = self._assign(observations, time)
        self._retire(set(assigned.values()), time)
        return [self._vector(seen, assigned.get(index), time) for index, seen in enumerate(observations)]

    def check_time(self, time: float) -> None:
        """Raise ``ValueError`` unless ``time`` is finite and later than in the last update."""
        if not (math.isfinite(time) and time > self._time):
            raise ValueError(f"time: expected finite seconds after {self._time}, got {time}")

    def _assign(self, observations: Sequence[Observation], time: float) -> dict[int, _Track]:
        """Index of each observation that is a known object -> its track: most pairs, then least cost."""
        if not (observations and self._tracks):
            return {}
        costs = [[_FORBIDDEN] * len(self._tracks) for _ in observations]
        weight = self.colour_weight_m / _COLOUR_RANGE
        for column, track in enumerate(self._tracks):
            predicted = track.predict(time)
            gate = self.gate_m + self.gate_growth_mps * min(time - track.time, self.max_missed_s)
            for row, seen in enumerate(observations):
                distance = math.dist(predicted, seen.position_m)
                if distance < gate:
                    costs[row][column] = distance + weight * math.dist(track.colour, seen.colour)
        rows, columns = linear_sum_assignment(costs)
        pairs = zip(rows.tolist(), columns.tolist(), strict=True)
        return {row: self._tracks[column] for row, column in pairs if costs[row][column] < _FORBIDDEN}

    def _retire(self, seen: set[_Track], time: float) -> None:
        """Drop the tracks that are unseen for too long."""
        gone = [t for t in self._tracks if t not in seen and time - t.time > self.max_missed_s]
        self.events += [(time, track.id, "gone") for track in gone]
        self._tracks = [track for track in self._tracks if track not in gone]

    def _vector(self, seen: Observation, track: _Track | None, time: float) -> ObjectVector:
        """The object vector of one observation, of a new object if it has no track."""
        if track is None:
            self._ids += 1
            track = _Track(self._ids, seen, time, self._frame, self.position_noise_m)
            self._tracks.append(track)
            self.events.append((time, track.id, "born"))
        else:
            track.update(seen, time, self.position_noise_m, self.acceleration_mps2)
        return ObjectVector(
            id=track.id,
            position_m=seen.position_m,
            velocity_mps=(track.vx, track.vy),
            area_m2=seen.area_m2,
            colour=seen.colour,
            label=track.label,
            hidden_in=seen.hidden_in,
            age=self._frame - track.born + 1,
        )


def _check(name: str, value: float, *, positive: bool = False) -> float:
    if not (math.isfinite(value) and (value > 0 if positive else value >= 0)):
        raise ValueError(f"{name}: expected a finite number {'> 0' if positive else '>= 0'}, got {value}")
    return value
