"""Object vectors M{p, V, C}: born, updated and gone (section 4 of the paper).

"We assign a parametric vector M_i{p(x_i, y_j), V, C} to each object, containing the centroid, velocity and
color information of the object. These dynamic vectors are created and destroyed based on the appearance and
disappearance of the objects." The paper does not say how a detection is joined to a vector, nor how V is
measured. Here: constant-velocity prediction, Hungarian assignment inside a gate, and a Kalman filter (Kalman
1960, doi:10.1115/1.3662552; piecewise white acceleration, Bar-Shalom et al. 2001, section 6.3). What appears is first a
candidate, so that a ghost of a frame or two never becomes an object; what disappears coasts for a while.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlib.base import checks
from occlib.base.arrays import FloatArray

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
    size_m2
        Actual size by the look-up table of scale factors in m2, where one is used.
    hidden_in
        Names of the cameras in which something hides it.
    visible
        The share of it that each camera sees, 0 to 1, where that is known.
    """

    position_m: Point
    area_m2: float
    colour: Colour
    label: str | None = None
    size_m2: float | None = None
    hidden_in: tuple[str, ...] = ()
    visible: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ObjectVector:
    """The paper's parametric vector ``M{p, V, C}`` of one object at one instant.

    Parameters
    ----------
    id
        1, 2, ... in order of confirmation; only an object with the same label gets it again. 0: a candidate, not confirmed.
    position_m
        The centroid ``p`` (x, y) as measured at this instant, not filtered, in m; predicted while it coasts.
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
    size_m2
        Actual size by the look-up table in m2 at this instant, where one is used and a view identifies the object.
    age
        Frames since it was first seen, 1 in the first.
    visible
        The share of it that each camera sees, 0 to 1, where that is known.
    spread
        Variance of the filtered position in m2, its covariance with the velocity in m2/s, and the velocity's variance in m2/s2; the
        same for x and y.
    """

    id: int
    position_m: Point
    velocity_mps: Point
    area_m2: float
    colour: Colour
    label: str | None = None
    hidden_in: tuple[str, ...] = ()
    size_m2: float | None = None
    age: int = 1
    visible: Mapping[str, float] = field(default_factory=dict)
    spread: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def x(self) -> float:
        """First coordinate of the position in m."""
        return self.position_m[0]

    @property
    def y(self) -> float:
        """Second coordinate of the position in m."""
        return self.position_m[1]

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state (x, y, vx, vy), float64 (4, 4), in m and m/s."""
        pp, pv, vv = self.spread
        return np.kron(np.array([[pp, pv], [pv, vv]], np.float64), np.eye(2)).astype(np.float64)

    def to_dict(self) -> dict[str, Any]:
        """The object's entry in ``objects.jsonl``: m, m/s and m2, to 4 decimals.

        >>> ObjectVector(1, (0.5, 1.0), (0.1, 0.0), 0.04, (200, 30, 30), hidden_in=("cam2",)).to_dict()
        ... # doctest: +NORMALIZE_WHITESPACE
        {'id': 1, 'x': 0.5, 'y': 1.0, 'vx': 0.1, 'vy': 0.0, 'area': 0.04, 'colour': [200, 30, 30],
         'label': None, 'hidden_in': ['cam2'], 'size': None}
        """
        (x, y), (vx, vy) = self.position_m, self.velocity_mps
        numbers = {"x": x, "y": y, "vx": vx, "vy": vy, "area": self.area_m2}
        return {
            "id": self.id,
            **{name: round(float(value), 4) + 0.0 for name, value in numbers.items()},  # + 0.0: no "-0.0"
            "colour": [int(c) for c in self.colour],
            "label": self.label,
            "hidden_in": list(self.hidden_in),
            "size": None if self.size_m2 is None else round(float(self.size_m2), 4),
        }


class Event(NamedTuple):
    """One line of the tracker's log: when, which object, ``"born"`` or ``"gone"``, and why."""

    time: float
    id: int
    what: str
    reason: str


class _Track:
    """Kalman state of one object. x and y share one covariance, so it is three plain floats."""

    __slots__ = (
        "area",
        "born",
        "colour",
        "id",
        "label",
        "pp",
        "pv",
        "since",
        "size",
        "time",
        "vv",
        "vx",
        "vy",
        "x",
        "y",
    )

    def __init__(self, seen: Observation, time: float, frame: int, noise_m: float) -> None:
        self.id, self.born, self.since, self.area = 0, frame, time, seen.area_m2
        (self.x, self.y), self.vx, self.vy = seen.position_m, 0.0, 0.0
        self.pp, self.pv, self.vv = noise_m**2, 0.0, _BIRTH_SPEED**2
        self.time, self.colour, self.label, self.size = time, seen.colour, seen.label, seen.size_m2

    def predict(self, time: float) -> Point:
        """Position in m at ``time`` if the velocity stays; the state is left as it is."""
        dt = time - self.time
        return self.x + self.vx * dt, self.y + self.vy * dt

    def spread(self, time: float, acceleration: float) -> tuple[float, float, float]:
        """Variances and covariance of position and velocity, predicted to ``time``."""
        dt, q = time - self.time, acceleration**2
        pp = self.pp + dt * (2 * self.pv + dt * self.vv) + q * dt**4 / 4
        return pp, self.pv + dt * self.vv + q * dt**3 / 2, self.vv + q * dt**2

    def update(self, seen: Observation, time: float, noise_m: float, acceleration: float) -> None:
        """Predict to ``time`` and correct by the measured position."""
        (x, y), (zx, zy) = self.predict(time), seen.position_m
        pp, pv, vv = self.spread(time, acceleration)
        gain_p, gain_v = pp / (pp + noise_m**2), pv / (pp + noise_m**2)
        self.x, self.y = x + gain_p * (zx - x), y + gain_p * (zy - y)
        self.vx, self.vy = self.vx + gain_v * (zx - x), self.vy + gain_v * (zy - y)
        self.pp, self.pv, self.vv = (1 - gain_p) * pp, (1 - gain_p) * pv, vv - gain_v * pv
        self.time, self.colour, self.label, self.area = time, seen.colour, seen.label or self.label, seen.area_m2
        self.size = seen.size_m2


LARGEST = 1e6
"""No setting of the tracker may be larger, in its own unit: its squares are summed."""


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of :class:`Tracker`.

    Parameters
    ----------
    gate_m
        How far from its predicted position an object may be found, m.
    gate_growth_mps
        By how much the gate widens for each second since the object was last seen, m/s (no further than for
        ``max_missed_s``).
    max_missed_s
        An object is gone at the first frame that misses it after more than this many seconds unseen. Until
        then it coasts: it keeps its identity, is not among the objects, and its cells on the map are not free.
    colour_weight_m
        Black against white counts as this many metres; decides between candidates at similar distance.
    confirm_s
        What is new beside other objects is a candidate, of id 0, until it has been seen for so long without a miss. Where the scene
        is new, all is confirmed at once: in the first frame, after more than ``max_missed_s`` without any, or unless more than half
        of the last frame's objects are seen again within ``jump_m`` of where they were expected.
    jump_m
        No object gets so far, in m, from where it is expected in the next frame; an unrelated picture does.
    position_noise_m, acceleration_mps2
        Standard deviations of a measured position and of an object's acceleration: a larger ratio gives a
        smoother, later velocity.
    """

    gate_m: float = 0.5
    gate_growth_mps: float = 1.0
    max_missed_s: float = 1.0
    confirm_s: float = 0.0
    jump_m: float = 0.25
    colour_weight_m: float = 0.2
    position_noise_m: float = 0.05
    acceleration_mps2: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            positive = name in ("gate_m", "position_noise_m")
            low, least = (0, None) if positive else (None, 0)
            checks.number(name, value, above=low, least=least, most=LARGEST, unit="a finite number")


class Tracker:
    """Gives detections their identity and velocity, frame after frame.

    Parameters
    ----------
    settings
        Gate, patience and noise; the default ones for None.
    **changes
        Fields of :class:`TrackerSettings` that are to be different.

    Attributes
    ----------
    events : list of Event
        Births and deaths in the order in which they happened, each with its reason.
    rejected : int
        Candidates that were missed before they were confirmed: most of them ghosts.

    Examples
    --------
    >>> tracker = Tracker()
    >>> tracker.update([Observation((0.0, 0.0), 0.04, (200, 30, 30))], time=0.0)[0].id
    1
    >>> moved = tracker.update([Observation((0.1, 0.0), 0.04, (200, 30, 30))], time=0.1)[0]
    >>> moved.id, moved.position_m, moved.velocity_mps[0] > 0
    (1, (0.1, 0.0), True)
    """

    def __init__(self, settings: TrackerSettings | None = None, **changes: float) -> None:
        self.settings = replace(settings or TrackerSettings(), **changes)
        self.events: list[Event] = []
        self.rejected = 0
        self._tracks: list[_Track] = []
        self._gone: dict[str, int] = {}  # ids of labelled objects that are gone
        self._time = -math.inf
        self._frame = self._ids = 0

    def update(
        self, observations: Sequence[Observation], time: float, identify: Callable[[int], str | None] | None = None
    ) -> list[ObjectVector]:
        """Take one frame's observations; return their object vectors, in the same order.

        Parameters
        ----------
        observations
            What the frame shows, in any order; may be empty.
        time
            Seconds, later than in the last call.
        identify
            The label of observation ``index``, if it is recognised; asked for those whose object has none. No two objects on the
            floor get the same; what it raises passes through, and the frame is lost. What is recognised before it is confirmed gets the id again under which its label was last known.

        Raises
        ------
        ValueError
            ``time`` does not increase, or a position, area or size is not finite. The tracker stays as it was.
        """
        self.check_time(time)
        for index, seen in enumerate(observations):
            if not all(map(math.isfinite, (*seen.position_m, seen.area_m2, seen.size_m2 or 0.0))):
                raise ValueError(f"observations[{index}]: expected finite position, area and size, got {seen}")
        assigned = self._assign(observations, time)
        anew = self._is_new_scene(observations, assigned, time)
        self._time, self._frame = time, self._frame + 1
        self._retire(set(assigned.values()), time)
        tracks = []
        for index, seen in enumerate(observations):
            track = assigned.get(index)
            if track is None:
                track = _Track(seen, time, self._frame, self.settings.position_noise_m)
                self._tracks.append(track)
            else:
                track.update(seen, time, self.settings.position_noise_m, self.settings.acceleration_mps2)
            if seen.label is not None:  # a known object is where it was recognised last
                for other in self._tracks:
                    if other is not track and other.label == seen.label:
                        other.label = None
            if track.label is None and identify is not None and (label := identify(index)):
                self._name(track, label, time, set(assigned.values()))
            if track.id == 0 and (anew or time - track.since >= self.settings.confirm_s - 1e-9):
                self._confirm(track, time, anew)
            tracks.append(track)
        # once all labels are settled: a later observation may have taken one over
        return [self._vector(track, time, seen) for track, seen in zip(tracks, observations, strict=True)]

    def coasting(self) -> list[ObjectVector]:
        """The confirmed objects that the last call did not see, where they are expected, with a covariance that grows."""
        unseen = [track for track in self._tracks if track.id and track.time < self._time]
        return [self._vector(track, self._time) for track in unseen]

    def check_time(self, time: float) -> None:
        """Raise ``ValueError`` unless ``time`` is finite and later than in the last update."""
        if not (time > self._time and abs(time) < 1e12):
            raise ValueError(f"time: expected finite seconds after {self._time}, got {time}")

    def _assign(self, observations: Sequence[Observation], time: float) -> dict[int, _Track]:
        """Index of each observation that is a known object -> its track: most pairs, then least cost."""
        if not (observations and self._tracks):
            return {}
        costs = [[_FORBIDDEN] * len(self._tracks) for _ in observations]
        weight = self.settings.colour_weight_m / _COLOUR_RANGE
        for column, track in enumerate(self._tracks):
            predicted = track.predict(time)
            gate = self.settings.gate_m + self.settings.gate_growth_mps * min(
                time - track.time, self.settings.max_missed_s
            )
            for row, seen in enumerate(observations):
                distance = math.dist(predicted, seen.position_m)
                if distance < gate:
                    costs[row][column] = distance + weight * math.dist(track.colour, seen.colour)
        rows, columns = linear_sum_assignment(costs)
        pairs = zip(rows.tolist(), columns.tolist(), strict=True)
        return {row: self._tracks[column] for row, column in pairs if costs[row][column] < _FORBIDDEN}

    def _is_new_scene(self, observations: Sequence[Observation], assigned: Mapping[int, _Track], time: float) -> bool:
        """Whether this frame has little to do with the last one, of the objects on which alone that can be judged."""
        known = [track for track in self._tracks if track.id and track.time == self._time]
        again = [
            track
            for index, track in assigned.items()
            if track in known and math.dist(track.predict(time), observations[index].position_m) < self.settings.jump_m
        ]
        return time - self._time > self.settings.max_missed_s or 2 * len(again) <= len(known)

    def _name(self, track: _Track, label: str, time: float, seen: set[_Track]) -> None:
        """Label a track, unless another has that label; one that only coasts gives it up to a candidate, with its id."""
        held = next((other for other in self._tracks if other.label == label), None)
        if held and held.id and not track.id and held.time < time and held not in seen:
            self._leave(held, time, f"seen again as {label}")
            self._tracks.remove(held)
            held = None
        if held is None:
            track.label = label

    def _leave(self, track: _Track, time: float, reason: str) -> None:
        """Log that a confirmed object is gone; its label keeps its id."""
        self.events.append(Event(time, track.id, "gone", reason))
        if track.label:
            self._gone[track.label] = track.id

    def _confirm(self, track: _Track, time: float, anew: bool) -> None:
        """Give a candidate its id: the one that its label had before, or the next."""
        known = self._gone.pop(track.label, None) if track.label else None
        if known is None:
            self._ids += 1
        track.id = known or self._ids
        reason = "in a new scene" if anew else f"seen for {time - track.since:.2g} s"
        self.events.append(Event(time, track.id, "born", f"known as {track.label}" if known else reason))

    def _retire(self, seen: set[_Track], time: float) -> None:
        """Drop the tracks that are unseen for too long, and candidates at once."""
        gone = [t for t in self._tracks if t not in seen and (t.id == 0 or time - t.time > self.settings.max_missed_s)]
        for track in gone:
            if track.id:
                self._leave(track, time, f"unseen for {time - track.time:.2g} s")
            else:
                self.rejected += 1
        self._tracks = [track for track in self._tracks if track not in gone]

    def _vector(self, track: _Track, time: float, seen: Observation | None = None) -> ObjectVector:
        """The object vector of a track, as seen or as predicted."""
        vector = ObjectVector(
            id=track.id,
            position_m=track.predict(time),
            velocity_mps=(track.vx, track.vy),
            area_m2=track.area,
            colour=track.colour,
            label=track.label,
            age=self._frame - track.born + 1,
            spread=track.spread(time, self.settings.acceleration_mps2),
            size_m2=track.size,
        )
        if seen is None:
            return vector
        return replace(
            vector,
            position_m=seen.position_m,
            size_m2=seen.size_m2,
            hidden_in=seen.hidden_in,
            visible=seen.visible,
        )
