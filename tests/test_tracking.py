"""Object vectors: planted paths keep their identity, velocity comes out right, the gone stay gone."""

from __future__ import annotations

import itertools
import json
import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib.tracking import Colour, ObjectVector, Observation, Tracker

RED: Colour = (220, 30, 30)
BLUE: Colour = (30, 30, 220)


def at(x: float, y: float = 0.0, colour: Colour = RED, **more: Any) -> Observation:
    return Observation((x, y), 0.04, colour, **more)


def ids(vectors: list[ObjectVector]) -> list[int]:
    return [vector.id for vector in vectors]


def test_identity_and_velocity_of_a_planted_straight_path() -> None:
    tracker = Tracker()
    for k in range(30):
        (vector,) = tracker.update([at(0.08 * k, -0.03 * k)], time=0.1 * k)
        assert (vector.id, vector.age) == (1, k + 1)
        assert vector.position_m == (0.08 * k, -0.03 * k)  # the measurement: no lag
    assert vector.velocity_mps == pytest.approx((0.8, -0.3), abs=0.01)
    assert tracker.events == [(0.0, 1, "born", "in a new scene")]


def test_velocity_is_zero_at_first_sight_and_less_noisy_than_differences() -> None:
    rng = random.Random(1)
    tracker = Tracker()
    xs = [0.05 * k + rng.gauss(0, 0.03) for k in range(100)]
    filtered = [tracker.update([at(x)], time=0.1 * k)[0].velocity_mps[0] for k, x in enumerate(xs)]
    assert filtered[0] == 0.0
    worst_difference = max(abs((b - a) / 0.1 - 0.5) for a, b in itertools.pairwise(xs))
    assert max(abs(v - 0.5) for v in filtered[20:]) < worst_difference / 2


def test_velocity_does_not_depend_on_the_frame_rate() -> None:
    for step in (0.04, 0.1, 0.4):
        tracker = Tracker()
        for k in range(40):
            vector = tracker.update([at(0.6 * step * k)], time=5 + step * k)[0]
        assert vector.velocity_mps[0] == pytest.approx(0.6, abs=0.02)


def test_velocity_agrees_with_the_textbook_kalman_filter() -> None:
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.uniform(0.05, 0.5, 30))
    xs = 0.4 * times + rng.normal(0, 0.05, 30)
    tracker = Tracker(position_noise_m=0.07, acceleration_mps2=0.8)
    state, covariance, before = np.array([xs[0], 0.0]), np.diag([0.07**2, 1.0]), times[0]
    for time, x in zip(times, xs, strict=True):
        vector = tracker.update([at(float(x))], float(time))[0]
        if time > before:
            dt = time - before
            transition, push = np.array([[1, dt], [0, 1]]), np.array([dt**2 / 2, dt])
            state = transition @ state
            covariance = transition @ covariance @ transition.T + 0.8**2 * np.outer(push, push)
            gain = covariance[:, 0] / (covariance[0, 0] + 0.07**2)
            state, covariance = state + gain * (x - state[0]), covariance - np.outer(gain, covariance[0])
        assert vector.velocity_mps[0] == pytest.approx(state[1], abs=1e-12)
        before = time


def test_two_objects_that_cross_keep_their_identity_by_motion() -> None:
    tracker = Tracker(colour_weight_m=0.0)
    for k in range(41):
        x = -1 + 0.05 * k
        vectors = tracker.update([at(x, 0.1), at(-x, -0.1)][:: 1 if k % 2 else -1], time=0.1 * k)
        assert sorted(ids(vectors)) == [1, 2]
    right_going = next(v for v in vectors if v.velocity_mps[0] > 0)
    assert right_going.position_m[0] == pytest.approx(1.0)
    assert len(tracker.events) == 2


def test_colour_decides_between_candidates_at_similar_distance() -> None:
    seen = [at(0.0, 0.1, RED), at(0.0, -0.1, BLUE)]
    swapped = [at(0.0, 0.01, BLUE), at(0.0, -0.01, RED)]
    tracker, colour_blind = Tracker(), Tracker(colour_weight_m=0.0)
    tracker.update(seen, 0.0)
    colour_blind.update(seen, 0.0)
    assert ids(tracker.update(swapped, 0.1)) == [2, 1]
    assert ids(colour_blind.update(swapped, 0.1)) == [1, 2]


def test_assignment_keeps_as_many_objects_as_it_can() -> None:
    tracker = Tracker(gate_growth_mps=0.0)
    tracker.update([at(0.0), at(-0.4)], 0.0)
    # Greedy nearest would join 0.0 with 0.05 and leave -0.4 and 0.4 (0.8 m apart) alone.
    assert ids(tracker.update([at(-0.05), at(0.4)], 0.1)) == [2, 1]


def test_the_gate_is_strict_and_widens_while_unseen() -> None:
    tracker = Tracker(gate_m=0.5, gate_growth_mps=0.0)
    tracker.update([at(0.0)], 0.0)
    assert ids(tracker.update([at(0.5)], 0.1)) == [2]
    wider = Tracker(gate_m=0.5, gate_growth_mps=1.0)
    wider.update([at(0.0)], 0.0)
    wider.update([], 0.4)
    assert ids(wider.update([at(1.2)], 0.8)) == [1]
    still = Tracker(gate_m=0.5, gate_growth_mps=1.0, max_missed_s=1.0)
    still.update([at(0.0)], 0.0)
    assert ids(still.update([at(3.0)], 50.0)) == [2]  # the growth ends at max_missed_s


def test_an_unseen_object_coasts_and_comes_back_as_itself() -> None:
    tracker = Tracker(gate_growth_mps=0.0, gate_m=0.2, max_missed_s=1.0)
    for k in range(10):
        tracker.update([at(0.1 * k)], 0.1 * k)
    for k in range(10, 18):
        assert tracker.update([], 0.1 * k) == []
    (back,) = tracker.update([at(1.8)], 1.8)
    assert (back.id, back.age) == (1, 19)


def test_ids_are_never_used_again() -> None:
    tracker = Tracker(max_missed_s=0.25)
    tracker.update([at(0.0)], 0.0)
    tracker.update([], 0.2)
    tracker.update([], 0.4)
    assert ids(tracker.update([at(0.0)], 0.6)) == [2]
    assert tracker.events == [
        (0.0, 1, "born", "in a new scene"),
        (0.4, 1, "gone", "unseen for 0.4 s"),
        (0.6, 2, "born", "in a new scene"),
    ]


def test_slow_recordings_still_get_one_chance() -> None:
    tracker = Tracker(max_missed_s=0.5)
    assert [ids(tracker.update([at(0.0)], float(k))) for k in range(3)] == [[1], [1], [1]]


def test_vectors_come_in_the_order_of_the_observations_and_keep_what_was_seen() -> None:
    tracker = Tracker()
    tracker.update([at(0.0, label="robot"), at(3.0, colour=BLUE)], 0.0)
    second, first = tracker.update([at(3.0, colour=BLUE), at(0.0, hidden_in=("cam2",))], 0.1)
    assert (second.id, first.id) == (2, 1)
    assert (first.label, first.hidden_in, first.colour) == ("robot", ("cam2",), RED)
    assert (second.label, second.hidden_in, second.area_m2) == (None, (), 0.04)


def test_what_is_new_is_a_candidate_until_it_was_seen_for_long_enough() -> None:
    tracker = Tracker(confirm_s=0.2)
    for k in range(5):  # 1 is in a new scene; another comes at 0.2 s
        vectors = tracker.update([at(0.0), at(2.0)][: 1 if k < 2 else 2], 0.1 * k)
        assert ids(vectors) == [1] + [0] * (1 < k < 4) + [2] * (k == 4)
    assert vectors[1].age == 3
    assert tracker.events[1] == (0.4, 2, "born", "seen for 0.2 s")


def test_a_ghost_dies_young_and_uses_up_no_id() -> None:
    tracker = Tracker(confirm_s=0.2)
    for k, seen in enumerate(([0.0], [0.0, 2.0], [0.0, 2.0], [0.0], [0.0, 2.0], [0.0, 2.0], [0.0, 2.0])):
        vectors = tracker.update([at(x) for x in seen], 0.1 * k)
        assert ids(vectors) == ([1] + [0] * (len(seen) - 1) if k < 6 else [1, 2])
    assert tracker.rejected == 1 and [e.what for e in tracker.events] == ["born", "born"]


def test_after_a_gap_all_is_confirmed_at_once() -> None:
    tracker = Tracker(confirm_s=0.2, max_missed_s=1.0)
    tracker.update([at(0.0)], 0.0)
    assert ids(tracker.update([at(3.0)], 4.0)) == [2]
    assert ids(tracker.update([at(0.0), at(3.0)], 5.0)) == [0, 2]  # 1 s is no gap


def test_unrelated_pictures_are_confirmed_one_by_one() -> None:
    rng, tracker = np.random.default_rng(5), Tracker(confirm_s=0.2)
    frames = [rng.uniform(-2, 2, (8, 2)) for _ in range(50)]
    shown = [sum(v.id > 0 for v in tracker.update([at(*p) for p in f], 0.1 * k)) for k, f in enumerate(frames)]
    assert min(shown) == 8  # though four of five find a track within the gate


def test_a_coasting_object_is_expected_on_its_way_ever_less_surely() -> None:
    tracker = Tracker(confirm_s=0.2)
    for k in range(20):
        (vector,) = tracker.update([at(0.05 * k)], 0.1 * k)
        assert tracker.coasting() == []
    spreads = [np.sqrt(vector.covariance[0, 0])]
    for k in range(20, 25):
        assert tracker.update([], 0.1 * k) == []
        (unseen,) = tracker.coasting()
        assert unseen.id == 1 and unseen.position_m == pytest.approx((0.05 * k, 0), abs=0.02)
        spreads.append(np.sqrt(unseen.covariance[0, 0]))
    assert (np.diff(spreads) > 0).all() and spreads[0] < 0.05 < spreads[-1]
    assert vector.covariance.shape == (4, 4) and (np.linalg.eigvalsh(vector.covariance) > 0).all()
    assert vector.covariance[0, 2] == vector.covariance[1, 3] > 0 == vector.covariance[0, 1]
    tracker.update([at(2.0)], 2.5)
    tracker.update([at(2.0), at(5.0)], 2.6)
    tracker.update([], 2.7)
    assert len(tracker.coasting()) == 1  # a candidate does not coast


def test_the_covariance_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(300):
        tracker, x, v = Tracker(position_noise_m=0.05, acceleration_mps2=1.0), 0.0, rng.normal()
        for k in range(20):
            push = rng.normal()
            x, v = x + 0.1 * v + 0.005 * push, v + 0.1 * push
            vector = tracker.update([at(x + rng.normal(0, 0.05))], 0.1 * k)[0]
        errors.append((vector.velocity_mps[0] - v) / np.sqrt(vector.covariance[2, 2]))
    assert np.std(errors) == pytest.approx(1, abs=0.1)


def test_a_label_brings_its_id_back() -> None:
    tracker = Tracker(confirm_s=0.1, max_missed_s=0.3)
    first, second = tracker.update([at(0.0), at(3.0)], 0.0, lambda index: "red")
    assert (first.label, second.label) == ("red", None)  # one object, one label
    for k in range(1, 6):
        tracker.update([at(3.0)], 0.1 * k)
    assert tracker.events[-1][1:3] == (1, "gone")
    (new, _) = tracker.update([at(1.5), at(3.0)], 0.6, {0: "red"}.get)
    assert (new.id, new.label) == (0, "red")
    back, _ = tracker.update([at(1.5), at(3.0)], 0.7)
    assert (back.id, back.label) == (1, "red") and tracker.events[-1].reason == "known as red"


@settings(max_examples=50, deadline=None)
@given(st.lists(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), max_size=5), min_size=1, max_size=8))
def test_every_observation_gets_one_identity(frames: list[list[tuple[float, float]]]) -> None:
    def run() -> list[list[ObjectVector]]:
        tracker = Tracker()
        return [tracker.update([at(*p) for p in points], 0.1 * k) for k, points in enumerate(frames)]

    vectors = run()
    assert vectors == run()
    for points, frame in zip(frames, vectors, strict=True):
        assert [v.position_m for v in frame] == points
        assert len(set(ids(frame))) == len(points)
        assert all(math.isfinite(v) for vector in frame for v in vector.velocity_mps)
    seen = [i for frame in vectors for i in ids(frame)]
    assert sorted(set(seen)) == list(range(1, len(set(seen)) + 1))


def test_dictionary_is_exactly_the_contract_and_json() -> None:
    (vector,) = Tracker().update([at(1 / 3, -1e-9, label="ball", hidden_in=("cam2", "cam3"))], 0.0)
    assert json.dumps(vector.to_dict()) == (
        '{"id": 1, "x": 0.3333, "y": 0.0, "vx": 0.0, "vy": 0.0, "area": 0.04, "colour": [220, 30, 30], '
        '"label": "ball", "hidden_in": ["cam2", "cam3"], "size": null}'
    )


def test_the_size_is_the_one_that_was_measured_last() -> None:
    tracker = Tracker()
    (first,) = tracker.update([at(0.0, size_m2=0.03)], 0.0)
    (second,) = tracker.update([at(0.0, size_m2=0.040001)], 0.1)
    assert (first.size_m2, second.to_dict()["size"]) == (0.03, 0.04)
    tracker.update([], 0.2)
    assert [vector.size_m2 for vector in tracker.coasting()] == [0.040001]
    with pytest.raises(ValueError, match=r"observations\[0\]: expected finite position, area and size"):
        tracker.update([at(0.0, size_m2=math.nan)], 0.3)


def test_inputs_are_unchanged() -> None:
    observations = [at(0.0), at(1.0)]
    before = list(observations)
    tracker = Tracker()
    tracker.update(observations, 0.0)
    tracker.update(observations, 0.1)
    assert observations == before


@pytest.mark.parametrize("time", [1.0, 0.5, math.nan, math.inf])
def test_time_must_increase(time: float) -> None:
    tracker = Tracker()
    tracker.update([at(0.0)], 1.0)
    with pytest.raises(ValueError, match=r"time: expected finite seconds after 1.0, got"):
        tracker.update([at(0.0)], time)
    assert ids(tracker.update([at(0.0)], 1.1)) == [1]


def test_bad_observations_leave_the_tracker_as_it_was() -> None:
    tracker = Tracker()
    with pytest.raises(ValueError, match=r"observations\[1\]: expected finite position, area and size"):
        tracker.update([at(0.0), at(math.nan)], 0.0)
    assert tracker.events == [] and ids(tracker.update([at(0.0)], 0.0)) == [1]


@pytest.mark.parametrize(
    ("name", "value"),
    [("gate_m", 0.0), ("position_noise_m", -1.0), ("max_missed_s", math.nan), ("colour_weight_m", -0.1)],
)
def test_wrong_settings(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected a finite number"):
        Tracker(**{name: value})


def test_a_label_brings_its_id_back_from_coasting() -> None:
    tracker = Tracker(confirm_s=0.2, max_missed_s=1.0)
    tracker.update([at(0.0), at(5.0)], 0.0, {0: "red"}.get)
    tracker.update([at(5.0)], 0.1)
    for k in range(2, 5):  # red is elsewhere, far beyond the gate
        moved, _ = tracker.update([at(3.0), at(5.0)], 0.1 * k, {0: "red"}.get)
    assert (moved.id, moved.label) == (1, "red")
    assert [event.reason for event in tracker.events[2:]] == ["seen again as red", "known as red"]
    tracker.update([at(3.0), at(5.0), at(9.0)], 0.5, {2: "red"}.get)
    assert [v.label for v in tracker.update([at(3.0), at(5.0), at(9.0)], 0.6)] == ["red", None, None]  # it is there


def test_times_beyond_reason_are_refused() -> None:
    with pytest.raises(ValueError, match="time: expected finite seconds"):
        Tracker().update([], 1e100)


def test_no_two_objects_of_a_frame_carry_one_label() -> None:
    tracker = Tracker()
    tracker.update([at(0.0, 0.0, label="cup"), at(2.0, 0.0)], 0.0)
    vectors = tracker.update([at(0.0, 0.0), at(2.0, 0.0, label="cup")], 0.1)
    assert [(one.id, one.label) for one in vectors] == [(1, None), (2, "cup")]
