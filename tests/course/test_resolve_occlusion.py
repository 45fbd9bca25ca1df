"""Tables of chapter 07 on planted scenes."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from occlib.course.lessons import resolve_occlusion as lesson
from occlib.foreground import average_background
from occlib.geometry import Floor, Rig
from occlib.lab import load_scene
from occlib.recordings import open_recording

FLOOR = Floor((0.0, 1.0), (0.0, 1.0), 0.1)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return open_recording("ball_and_oval", ["left", "right"]).rig


def test_a_boxs_shadow_holds_its_base_and_ends_where_similar_triangles_say(rig: Rig) -> None:
    shadow = lesson.cast_shadows(rig, {"box": lesson.box_corners((-0.4, 0.2), (-0.1, 0.1), 0.6)})["left"]["box"]
    xs = rig.floor.points(np.column_stack([np.flatnonzero(shadow.any(axis=0)), np.zeros(shadow.any(axis=0).sum())]))[
        :, 0
    ]
    assert xs.min() == pytest.approx(-0.4, abs=0.02)
    assert xs.max() == pytest.approx(0.2 + 3.25 * 0.6 / (2.5 - 0.6), abs=0.03)
    assert rig.floor.polygon_mask([[-0.39, -0.09], [0.19, -0.09], [0.19, 0.09], [-0.39, 0.09]])[shadow].sum() > 1000


def test_grazing_ends_are_those_of_the_rays_that_miss_the_ball(rig: Rig) -> None:
    """Brute force: the floor points whose ray to the lamp passes the ball's middle closer than its radius."""
    ends = lesson.grazing_ends(rig, centre_x=-0.1, radius_m=0.3)
    for name, camera in rig.cameras.items():
        lamp, middle = camera.centre_m[[0, 2]], np.array([-0.1, 0.3])
        x = np.linspace(-2, 2, 40001)
        ray = np.column_stack([lamp[0] - x, np.full(len(x), lamp[1])])
        to = middle - np.column_stack([x, np.zeros(len(x))])
        gap = np.abs(ray[:, 0] * to[:, 1] - ray[:, 1] * to[:, 0]) / np.linalg.norm(ray, axis=1)
        dark = x[gap < 0.3]
        assert sorted(ends.loc[name]) == pytest.approx([dark.min(), dark.max()], abs=1e-3)
        assert abs(ends.loc[name, "near"] - lamp[0]) < abs(ends.loc[name, "far"] - lamp[0])


def test_claims_and_extents() -> None:
    square = [[0.2, 0.2], [0.6, 0.2], [0.6, 0.4], [0.2, 0.4]]
    exact, half = FLOOR.polygon_mask(square), FLOOR.polygon_mask(square)
    half[:, 4:] = False
    masks = {"planted": {"exact": exact, "half": half}}
    table = lesson.claims(masks, FLOOR, [square], ["box"])
    assert table.loc[("planted", "exact")].tolist() == [1, 1]
    assert table.loc[("planted", "half"), "box covered"] == pytest.approx(0.5)
    assert lesson.extents(masks, FLOOR)[lesson.ASPECT].tolist() == pytest.approx([2, 1])


def test_a_hole_is_cut_into_one_copy_only() -> None:
    images = {name: np.full((60, 80, 3), 200, np.uint8) for name in ("left", "right")}
    backgrounds = {name: average_background([np.full((60, 80, 3), 9, np.uint8)] * 2) for name in images}
    holed = lesson.cut_hole(images, backgrounds, "left", (40.4, 29.6), 10)
    rows, columns = np.nonzero((holed["left"] == 9).all(axis=2))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (25, 34, 35, 44)
    assert (holed["right"] == 200).all() and all((image == 200).all() for image in images.values())


def test_between_two_boxes_only_the_ghost_is_behind_others_in_both_views() -> None:
    four = load_scene("four_robots").rig
    boxes = {
        "a": lesson.box_corners((-0.7, -0.4), (-0.15, 0.15), 0.5),
        "b": lesson.box_corners((0.4, 0.7), (-0.15, 0.15), 0.5),
    }
    cast = lesson.cast_shadows(four, boxes)
    table = lesson.behind_others(four, {name: cast[name]["a"] | cast[name]["b"] for name in ("left", "right")})
    assert table["x (m)"].tolist() == pytest.approx([-0.55, 0.0, 0.55], abs=0.02)
    assert (table[["behind, left", "behind, right"]].min(axis=1) > 0.5).tolist() == [False, True, False]
    assert isinstance(table, pd.DataFrame)
