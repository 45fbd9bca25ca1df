"""Chapter 11: votes, explanations of a grid, and the tables of its studies."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from occlib import lab
from occlib.course.lessons import explain_the_silhouettes as lesson
from occlib.recordings import open_recording

DIAGONAL = np.eye(5, dtype=bool)[::-1] & (np.arange(5) % 2 == 0)


def test_votes_of_four_cameras() -> None:
    assert lesson.votes_table(["and", "most", "or"]).loc[4].tolist() == [4, 3, 1]


def test_the_smallest_world_is_the_truth_and_the_largest_is_and() -> None:
    left, front = lesson.cast(DIAGONAL)
    worlds = lesson.explaining_sets(left, front)
    assert [int(world.sum()) for world in worlds] == [3, 4, 4, 4, 5, 5, 5, 6]
    np.testing.assert_array_equal(worlds[0], DIAGONAL)
    np.testing.assert_array_equal(worlds[-1], left & front)
    for world in worlds:
        assert all(np.array_equal(a, b) for a, b in zip(lesson.cast(world), (left, front), strict=True))


def test_the_greedy_search_needs_the_objects_alone() -> None:
    table = lesson.greedy_on_grid(*lesson.cast(DIAGONAL))
    assert {tuple(cell) for cell in table["cell (x, y)"]} == {(0, 4), (2, 2), (4, 0)}
    assert table["left to explain"].iloc[-1] == 0 and table["explains"].sum() == sum(
        s.sum() for s in lesson.cast(DIAGONAL)
    )


def test_the_riddle_has_one_smallest_answer_with_a_hidden_object() -> None:
    left, front = lesson.riddle()
    worlds = lesson.explaining_sets(left, front)
    assert worlds[0].sum() == 4 < worlds[1].sum()
    assert left.any(axis=1).sum() == 3  # the rows alone show three


def test_the_search_explains_two_objects_and_stops() -> None:
    simulation, crowd = lab.Simulation(lab.wall_rig(2)), lab.random_crowd(2, np.random.default_rng(1))
    masks = simulation.masks(crowd)
    steps = lesson.search_steps(simulation, masks, (1, 4))
    told = lesson.explained_share(simulation, masks, steps, crowd)
    assert told["objects found"].tolist() == [1, 2]
    assert told.loc[4, "explained"] > 0.9 > told.loc[1, "explained"] > 0.3
    assert told.loc[4, "farthest from an object (cm)"] < 5
    assert len(lesson.search_figure(simulation, masks, steps, crowd).axes) == 4


def test_cameras_and_rules_are_scored_on_the_same_crowds() -> None:
    crowds, rig = lab.random_crowds(2, 3, 4), lab.wall_rig(3)
    more = lesson.camera_study(rig, crowds, {1.0: ["and"], 0.5: ["and", "most"]}, seed=[1])
    assert more.loc[(1.0, "and", 3), "MODA"] > 0.8 and more.loc[(0.5, "and", 3), "recall"] < 0.7
    settings = {"cameras": (2, 3), "recalls": (1.0, 0.5), "rules": ["and", *lab.EXPLAIN], "seed": [1]}
    table = lesson.rules_study(rig, crowds, **settings)  # type: ignore[arg-type]
    assert table.loc[(1.0, 3, "and")].drop(["MODA, low", "MODA, high"]).tolist() == pytest.approx(
        more.loc[(1.0, "and", 3)].tolist()
    )
    assert table.loc[(0.5, 2, lab.EXPLAIN[0])].equals(
        table.loc[(0.5, 2, lab.EXPLAIN[1])].rename((0.5, 2, lab.EXPLAIN[0]))
    )
    assert len(lesson.rules_figure(table).axes) == 2 and len(lesson.camera_figure(more, 0.5).axes) == 2


def test_colour_ranks_by_disagreement() -> None:
    kinds = ["real, in plain view"] * 20 + ["real, partly hidden"] * 4 + ["ghost to be"] * 10
    values = [*range(20), 0, 0, 100, 100, *([50] * 10)]
    judged = lesson.judged_by_colour(pd.DataFrame({"kind": kinds, "disagreement": values}))
    assert judged["ranked right, plain view"] == 1 and judged["ranked right, partly hidden"] == 0.5
    assert judged["ghosts removed"] == 1 and judged["real ones lost, partly hidden"] == 0.5


def test_costs_are_ratios_to_the_first_rule() -> None:
    step = lesson.fusion_cost(lab.wall_rig(2), lab.random_crowds(1, 2, 0), ["and", "explain"], repeats=1)
    chain = lesson.pipeline_cost("four_robots", ["and", "explain"], frames=3, cameras=["left", "right"])
    for table in (step, chain):
        assert table.loc["and", "ratio"] == 1 and table.loc["explain", "ms"] > 0
    assert step.loc["explain", "ratio"] > 5 * chain.loc["explain", "ratio"]


def test_figures_of_planes_votes_and_colours() -> None:
    simulation, crowd = lab.Simulation(lab.wall_rig(2)), lab.random_crowd(3, np.random.default_rng(2))
    views = simulation.on_floor(simulation.masks(crowd))
    fig = lesson.planes_figure(simulation, crowd, {0.0: views, 0.1: views}, window_m=(-1.0, 1.0, -0.5, 0.5))
    assert [ax.get_title() for ax in fig.axes] == ["on the floor", "10 cm above it"]
    rows = [{"cameras": k, "r": 0.9, "rule": "and", "expected": 0.9**k, "found": 0.9**k} for k in (2, 3)]
    assert len(lesson.vote_figure(pd.DataFrame(rows)).axes) == 2
    row = {"frame": 3, "cameras": "left + right", "kind": "ghost", "x": 0.1, "y": 0.2, "disagreement": 80.0}
    colours = pd.DataFrame([row, row | {"kind": "ghost to be"}, row | {"kind": "real, in plain view"},
                            row | {"kind": "real, partly hidden"}])  # fmt: skip
    assert len(lesson.colour_figure(open_recording("four_robots"), colours).axes) == 3
