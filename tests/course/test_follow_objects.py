"""Tables of chapter 08 on invented objects and a tiny recording."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from occlib.course.lessons import follow_objects as lesson
from occlib.formats import TrueObject, Truth
from occlib.geometry import Floor
from occlib.mapping import OccupancyMap
from occlib.pipeline import Pipeline, backgrounds_of, settings_for
from occlib.recordings import open_recording
from occlib.tracking import ObjectVector, Tracker

FLOOR = Floor((0.0, 2.0), (0.0, 1.0), 0.1)
SQUARE = ((0.2, 0.2), (0.4, 0.2), (0.4, 0.4), (0.2, 0.4))


def vector(x: float, number: int = 1, hidden: tuple[str, ...] = ()) -> ObjectVector:
    return ObjectVector(number, (x, 0.3), (0.3, 0.4), 0.04, (200, 20, 20), hidden_in=hidden)


def planted(frames: int = 4) -> Truth:
    hidden = [{"left": 1.0 if 1 <= frame <= 2 else 0.0} for frame in range(frames)]
    return Truth(
        {f: [TrueObject(x=0.3, y=0.3, id="a", footprint=SQUARE, hidden_fraction=hidden[f])] for f in range(frames)}
    )


def grid(x_to: int) -> OccupancyMap:
    data = np.zeros(FLOOR.shape, np.int8)
    data[2:4, 2:x_to] = 100
    return OccupancyMap(data, FLOOR)


def test_chains_get_the_frames_that_they_are_to_be_shown(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording)
    backgrounds, settings = backgrounds_of(recording), settings_for("and")
    chains = {"both": Pipeline(recording.rig, backgrounds, settings)}
    chains["left"] = Pipeline(recording.rig.select(["left"]), backgrounds, settings)
    runs = lesson.run_chains(recording, chains, {"both": [0, 1, 2], "left": [0, 2]})
    assert list(runs["both"].objects) == [0, 1, 2] and list(runs["left"].maps) == [0, 2]
    assert set(runs["both"].events["event"]) == {"born"} and runs["both"].identities > 0


def test_presence_says_what_is_hidden_flagged_and_on_the_map() -> None:
    both = lesson.Run({0: [vector(0.3)], 1: [vector(0.3, hidden=("left",))], 2: [vector(0.3)], 3: []})
    some = lesson.Run({0: [vector(1.5)], 2: [vector(0.3)]})
    line = lesson.presence({"both": both, "some": some}, planted(), "a", "left", radius=0.1)
    assert line["left"].tolist() == [0, 1, 1, 0]
    assert line["both"].tolist() == [1, 1, 1, 0] and line["flagged"].tolist() == [0, 1, 0, 0]
    assert line["some"].fillna(-1).tolist() == [0, -1, 1, -1]


def test_runs_are_scored_on_their_own_frames() -> None:
    half = lesson.Run({0: [vector(0.3)], 2: []}, {0: grid(4), 2: grid(3)})
    row = lesson.score_runs({"half": half}, planted(), FLOOR, radius=0.1).loc["half"]
    assert row["moda"] == 0.5 and row["min_coverage"] == pytest.approx(0.5)
    assert row["median_claimed_ratio"] == pytest.approx(0.75)
    assert lesson.frames_with_fewer(half, 1) == 1


def test_a_life_has_what_was_seen_and_what_coasted_near_the_object() -> None:
    run = lesson.Run({0: [vector(0.3), vector(1.5, 2)], 1: []}, coasting={0: [], 1: [vector(0.35)]})
    life = lesson.life_of({"both": run}, planted(2), "a", 10.0, radius=0.1)
    assert life[["time", "id", "state"]].to_numpy().tolist() == [[0.0, 1, "seen"], [0.1, 1, "coasting"]]


def test_the_script_and_the_robots_that_turn_back() -> None:
    script = list(lesson.two_robots(((1.0, 1.5),)))
    assert len(script) == 50 and [len(sights) for _, sights in script[9:16]] == [2, 1, 1, 1, 1, 1, 2]
    assert lesson.velocities([0, 0.1, 0.2], [0, 0.1, 0.2], Tracker())[0] == 0
    assert (
        lesson.head_on(Tracker(colour_weight_m=0.0))[-1] == 2 and lesson.head_on(Tracker(colour_weight_m=0.5))[-1] == 1
    )


def test_motion_is_that_of_the_object_that_is_matched() -> None:
    robot: Any = SimpleNamespace(label="r", colour=(255, 0, 0), pose=lambda frame: (0.3 + 0.03 * frame, 0.3, 0.0))
    scene: Any = SimpleNamespace(objects=[robot])
    run = lesson.Run({frame: [vector(0.3 + 0.03 * frame)] for frame in range(3)})
    moved = lesson.motion(run, scene, 10.0, radius=0.1)
    assert moved["true (m/s)"].tolist() == pytest.approx([0.3] * 3) and moved["V (m/s)"].tolist() == pytest.approx(
        [0.5] * 3
    )
    assert moved["error (m/s)"].tolist() == pytest.approx([0.4] * 3)


def test_a_darkened_colour_keeps_its_hue() -> None:
    moved = pd.DataFrame(
        {
            "object": ["blue", "grey-green"],
            "paint": [(20, 20, 220), (40, 70, 40)],
            "colour": [(30, 30, 70), (42, 71, 41)],
        }
    )
    table = lesson.nearest_paint(moved)
    assert table.loc["blue"].tolist() == [0, 1] and table.loc["grey-green"].tolist() == [1, 1]
    assert table.loc["all"].tolist() == [0.5, 1]


def test_too_long_an_interval_makes_strangers() -> None:
    run = lesson.Run({frame: [vector(0.03 * frame)] for frame in range(40)})
    table = lesson.identities_by_interval(run, 10.0, (1, 8), (0.1, 0.5))
    assert table.loc[0.1].tolist() == [1, 1] and table.loc[0.8].tolist() == [5, 1]
