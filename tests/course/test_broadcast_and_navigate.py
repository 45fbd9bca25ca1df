"""Chapter 09: messages, the corridor, and what is counted of missions."""

from __future__ import annotations

import numpy as np
import pytest

from occlib import lab, live
from occlib.course.lessons import broadcast_and_navigate as lesson
from occlib.geometry import Floor
from occlib.mapping import OccupancyMap


def outcome(seed: int, kind: str, finished: int, way: float = 1.1, collisions: int = 0) -> lab.Outcome:
    data = np.zeros(lab.MISSION_FLOOR.shape, np.int8)
    paths = [np.array([[0.0, 0.0], [1.0, 0.0]])]
    return lab.Outcome(seed, kind, 1, finished, collisions, way, 0.2, 5.0, paths, data)


def test_four_spoiled_messages_are_refused() -> None:
    with live.Publisher() as publisher:
        sent = publisher.send(np.zeros((4, 4), np.int8), Floor((0.0, 0.4), (0.0, 0.4), 0.1), [], 0.0)
    answers = lesson.refusals(*live.encode(sent))
    assert len(answers) == 4 and answers["answer"].str.len().min() > 10


def test_the_late_one_gets_the_first_and_counts_what_it_missed() -> None:
    table = lesson.late_and_slow(30)
    assert table["number of the first message received"] == 1 and table["received twice"] == 0
    assert table["sent"] == 31
    assert table["received"] + table["missed"] == table["number of the last message received"] <= 31


def test_the_corridor_makes_the_second_give_way() -> None:
    walls, floor, ends = lesson.corridor()
    tracks = lab.drive_together(walls, floor, ends)
    assert np.linalg.norm(tracks["A"] - tracks["B"], axis=1).min() >= 2 * lab.RADIUS_M
    assert tracks["B"][:, 1].max() > 0.7 > tracks["A"][:, 1].max()
    assert len(lesson.corridor_figure(walls, floor, tracks).axes) == 2


def test_hard_missions_and_differences() -> None:
    outcomes = [outcome(0, "one view", 0), outcome(0, "and", 1, 1.2), outcome(0, "truth", 1, 1.0),
                outcome(1, "one view", 1), outcome(1, "and", 1, 1.3, 1), outcome(1, "truth", 1, 1.2)]  # fmt: skip
    assert lesson.hard_missions(outcomes).tolist() == [1, 0]
    assert lesson.way_differences(outcomes, ["truth"]).loc["truth"].iloc[0] == pytest.approx(0.15)
    assert len(lesson.missions_figure(lab.summary(outcomes), outcomes).axes) == 2
    mission = lab.Mission(0, (), ((0.0, 0.0),), ((1.0, 0.0),))
    assert len(lesson.mission_figure(mission, outcomes, ["truth", "one view"]).axes) == 2


def test_more_objects_refuse_more_and_two_views_less() -> None:
    few, many = lesson.refused_shares([1, 4], crowds=2)
    assert 0 < few < many < 0.5
    assert (lesson.refused_shares([1, 4], crowds=2, rule="and") < [few, many]).all()


def test_the_way_is_drawn_on_the_grown_map() -> None:
    grid = OccupancyMap(np.zeros((10, 10), np.int8), Floor((0.0, 1.0), (0.0, 1.0), 0.1))
    ways = {"over the cells": np.array([[0.1, 0.1], [0.9, 0.9]])}
    fig = lesson.path_figure(grid, [], 0.12, ways)
    assert [text.get_text() for text in fig.axes[1].get_legend().get_texts()] == list(ways)
