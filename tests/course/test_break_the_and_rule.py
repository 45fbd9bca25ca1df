"""Chapter 10: its tables agree with what can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from occlib import lab, plotting
from occlib.course.lessons import break_the_and_rule as lesson

OPPOSITE = lab.wall_rig(2)


def test_exact_shadows_cover_every_base_and_pixels_nearly() -> None:
    worst = lesson.worst_coverage(OPPOSITE, lab.random_crowds(2, 4, 3))
    assert worst["rays through cells"] == 1 and 0.85 < worst["masks of pixels"] <= 1


def test_a_ball_is_covered_the_more_the_higher_the_lamps() -> None:
    low, high = lesson.ball_coverage([1.5, 6.0])
    assert 0 < low < high < 1


def test_the_smear_is_tabled_one_length_at_a_time() -> None:
    case = {"h": 0.4, "d": 2.5, "H": 2.5}
    table = lesson.smear_table({"h": [0.5], "H": [4.0]}, **case)
    assert table["predicted"].tolist() == pytest.approx([2.5 * 0.5 / 2.0, 2.5 * 0.4 / 3.6])
    assert (table["measured"] - table["predicted"]).abs().max() < 0.03
    whole = lesson.smear_table({"h": [0.2, 0.4], "d": [1.5, 2.5], "H": [2.0, 3.0]}, **case)
    assert len(lesson.smear_figure(whole, **case).axes) == 3


def test_two_tall_boxes_cross_once_at_right_angles() -> None:
    pair = [lab.upright("box", at, 0.2, 0.9) for at in [(-0.6, 0.3), (0.0, -0.4)]]
    rigs = {"square": lab.wall_rig({"left": 180, "front": 270})}
    assert lesson.crossings_both_ways(rigs["square"], [pair, pair]).tolist() == [0, 2, 0]
    shapes = lesson.ghost_shapes(rigs, [pair])
    assert shapes.loc["square", "ghosts a crowd"] == 1 and shapes.loc["square", "median length / width"] >= 1
    assert len(lesson.ghost_figure(rigs | {"again": rigs["square"]}, [pair]).axes) == 2


def test_the_middle_of_the_three_series_is_one_case() -> None:
    study = lesson.ghost_study([8], [90, 180], [2.5, 4.0], crowds=2, seed=0)
    for middle in (("angle", 180), ("height", 2.5)):
        assert study.loc[middle].tolist() == study.loc[("objects", 8)].tolist()
    heights = study["law"].loc["height"].tolist()
    assert heights[1] < heights[0]
    assert len(lesson.ghost_count_figure(study).axes) == 3 and len(lesson.placement_figure(study).axes) == 6


def test_a_mask_loses_the_part_that_is_named() -> None:
    mask = np.zeros((20, 4), bool)
    mask[5:15, 1:3] = True
    assert lesson.mask_without(mask, 0, 0).tolist() == mask.tolist()
    assert np.flatnonzero(lesson.mask_without(mask, 0, 0.3).any(axis=1)).tolist() == list(range(5, 12))
    assert np.flatnonzero(lesson.mask_without(mask, 0.5, 1).any(axis=1)).tolist() == list(range(10, 15))


def test_a_hole_at_the_foot_deletes_and_one_at_the_top_does_not() -> None:
    simulation, each = lab.Simulation(OPPOSITE), lab.upright("cylinder", (0.6, 0.2), 0.4, 0.5)
    holes = {"no hole": (0.0, 0.0), "top": (0.5, 1.0), "foot": (0.0, 0.3)}
    covered = lesson.hole_study(simulation, each, holes)["covered share of the base"]
    assert covered["top"] == covered["no hole"] > 0.95 and covered["foot"] < 0.2
    assert len(lesson.hole_figure(simulation, each, holes).axes) == 3


def test_the_umbra_figure_closes_in() -> None:
    crowd = [lab.upright("box", (0.0, 0.0), 0.4, 0.4)]
    shadows = {name: lesson.exact_shadow(camera, crowd, OPPOSITE.floor) for name, camera in OPPOSITE.cameras.items()}
    fig = lesson.umbra_figure(shadows, crowd, OPPOSITE.floor, close_up=(-0.5, 0.5, -0.4, 0.4))
    assert fig.axes[1].get_xlim() == (-0.5, 0.5)
    plotting.figure_png(fig)
