"""Colours along axes, templates that fit, and boxes around cylinders; see ``tests/lab/test_crowds.py`` for ghosts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from occlib.explaining.appearance import _box, _likeness, axis_colours, colour_agreement
from occlib.explaining.prisms import Prism
from occlib.geometry import Rig
from occlib.identification import opaque_part, read_templates
from occlib.lab import wall_rig


def pictures(rig: Rig, **colours: tuple[int, int, int]) -> dict[str, Any]:
    return {name: np.full((*rig[name].size[::-1], 3), colour, np.uint8) for name, colour in colours.items()}


def test_the_colour_is_read_along_the_axis_and_nowhere_else(tiny_rig: Rig) -> None:
    images = pictures(tiny_rig, left=(10, 10, 10), right=(20, 20, 20))
    bottom, top = np.rint(tiny_rig["left"].project([[2.0, 1.5, 0.15], [2.0, 1.5, 0.35]])).astype(int)
    cv2.line(images["left"], bottom.tolist(), top.tolist(), (200, 30, 60), 3)
    colours = axis_colours([[2.0, 1.5], [90.0, 1.5]], 0.5, images, tiny_rig)
    assert colours.shape == (2, 2, 3)
    np.testing.assert_array_equal(colours[:, 0], [[200, 30, 60], [20, 20, 20]])
    assert np.isnan(colours[:, 1]).all()  # no view sees it


def test_views_of_one_colour_agree_and_others_are_as_far_apart_as_their_colours(tiny_rig: Rig) -> None:
    same = pictures(tiny_rig, left=(50, 60, 70), right=(50, 60, 70))
    other = pictures(tiny_rig, left=(50, 60, 70), right=(53, 64, 70))
    assert colour_agreement([[2.0, 1.5]], 0.3, same, tiny_rig).tolist() == [0]
    assert colour_agreement([[2.0, 1.5]], 0.3, other, tiny_rig).tolist() == [5]


def test_of_several_views_the_two_that_differ_most_count() -> None:
    rig, greys = wall_rig(3), (50, 53, 90)
    images = {n: np.full((*rig[n].size[::-1], 3), grey, np.uint8) for n, grey in zip(rig.cameras, greys, strict=True)}
    assert colour_agreement([[0.0, 0.0]], 0.3, images, rig) == pytest.approx([40 * np.sqrt(3)])


def test_the_box_holds_the_cylinder_and_is_no_larger(tiny_rig: Rig) -> None:
    cylinder = Prism(2.0, 1.5, 0.2, 0.5)
    left, top, right, bottom = _box(cylinder, tiny_rig, "left")
    turn = np.linspace(0, 2 * np.pi, 200)
    ring = np.column_stack([2.0 + 0.2 * np.cos(turn), 1.5 + 0.2 * np.sin(turn)])
    rims = tiny_rig["left"].project(np.vstack([np.column_stack([ring, np.full(200, z)]) for z in (0.0, 0.5)]))
    assert np.abs(rims.min(axis=0) - [left, top]).max() < 1.2
    assert np.abs(rims.max(axis=0) - [right, bottom]).max() < 1.2


def test_a_template_is_like_its_own_picture_at_its_own_size() -> None:
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 256, (40, 30, 3)).astype(np.uint8), (0, 0), 3)
    window = np.full((60, 50, 3), 128, np.uint8)
    window[10:50, 12:42] = picture
    assert _likeness(window, picture, None, 40) == 0
    assert _likeness(window, picture, np.ones((40, 30), bool), 40) == 0
    assert 0 < _likeness(window, 255 - picture, None, 40) < 255
    assert _likeness(window, picture, None, 200) == np.inf  # larger than the window
    assert _likeness(window, picture, None, 3) == np.inf  # too small to say anything


def test_transparent_pixels_do_not_count() -> None:
    picture = np.zeros((8, 6, 4), np.uint8)
    assert opaque_part("A", picture[..., :3])[1] is None
    picture[2:5, :, 3] = 128
    colours, mask = opaque_part("A", picture)
    assert colours.shape == (8, 6, 3) and mask is not None and mask.sum() == 18


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((8, 8, 3)), r"templates\['A'\]: expected uint8 RGB or RGBA of 4 x 4 px or more, got float64"),
        (np.zeros((8, 8), np.uint8), r"got uint8 \(8, 8\)"),
        (np.zeros((8, 8, 2), np.uint8), r"got uint8 \(8, 8, 2\)"),
        (np.zeros((3, 8, 3), np.uint8), r"got uint8 \(3, 8, 3\)"),
        (np.zeros((8, 8, 4), np.uint8), "expected pixels that are more opaque than not, got none"),
    ],
)
def test_what_is_no_template_is_named(picture: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        opaque_part("A", picture)


def test_templates_are_read_by_label_with_alpha(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "plain.png"), np.full((5, 6, 3), (1, 2, 3), np.uint8))  # BGR
    cv2.imwrite(str(tmp_path / "cut.png"), np.full((5, 6, 4), (1, 2, 3, 9), np.uint8))
    templates = read_templates(tmp_path)
    assert list(templates) == ["cut", "plain"]
    assert templates["plain"][0, 0].tolist() == [3, 2, 1, 255] and templates["cut"][0, 0].tolist() == [3, 2, 1, 9]
    with pytest.raises(ValueError, match=r"expected pictures named LABEL\.png, found none"):
        read_templates(tmp_path / "nowhere")
