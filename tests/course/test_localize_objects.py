"""The functions behind chapter 05, on planted outlines, sheets and shadows."""

from __future__ import annotations

from collections.abc import Iterator

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text

from occlib.course.lessons import localize_objects as lesson
from occlib.geometry import Camera
from occlib.pipeline import backgrounds_of
from occlib.recordings import Recording, open_recording

LETTER = np.kron(np.array([[0, 1, 0, 0], [0, 1, 0, 0], [0, 1, 1, 1]]), np.ones((20, 20))).astype(bool)


@pytest.fixture(autouse=True)
def no_figure_stays_open() -> Iterator[None]:
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def robot() -> Recording:
    return open_recording("robot", ["left", "right"])


@pytest.fixture(scope="module")
def left(robot: Recording) -> Camera:
    return robot.rig["left"]


def test_largest_region_is_the_larger_one() -> None:
    mask = np.zeros((40, 60), bool)
    mask[2:14, 2:14] = mask[20:40, 20:50] = True
    own, region = lesson.largest_region(mask)
    assert region.area == own.sum() == 600 and region.box == (20, 20, 30, 20)
    with pytest.raises(ValueError, match="mask: expected a region"):
        lesson.largest_region(np.zeros((9, 9), bool))


def test_a_letter_has_ambiguous_directions_and_a_square_has_none() -> None:
    square = np.zeros((60, 60), bool)
    square[10:50, 10:50] = True
    assert lesson.ambiguous_directions(square) == 0
    assert lesson.ambiguous_directions(LETTER) > 10


def test_the_arrow_ends_on_the_contour_in_the_direction_asked_for() -> None:
    mask = np.zeros((60, 80), bool)
    mask[10:50, 10:70] = True  # its right edge is 29.5 px right of the centroid, its lower one 19.5 px below
    image = np.zeros((60, 80, 3), np.uint8)
    for theta, end in ((0, (69.0, None)), (90, (None, 49.0))):
        ax, graph = lesson.contour_graph(image, mask, theta).axes
        x, y = (line[-1] for line in ax.lines[-1].get_data())
        assert (end[0] is None or x == pytest.approx(end[0], abs=0.2)) and (
            end[1] is None or y == pytest.approx(end[1], abs=0.2)
        )
        assert graph.lines[-1].get_xdata()[0] == pytest.approx(theta, abs=1.5)


def test_the_printed_angle_covers_half_a_turn() -> None:
    printed, quadrant = lesson.two_inverse_tangents(LETTER[40:]).axes
    spans = [np.ptp(np.concatenate([line.get_xdata() for line in ax.lines])) for ax in (printed, quadrant)]
    assert spans[0] <= 180 < 350 < spans[1]


def test_a_sheet_has_its_area_where_each_pixel_has_its_own_factor(left: Camera) -> None:
    places = [[-1.0, 0.5], [0.0, 0.0], [1.0, -0.7]]
    errors = lesson.sheet_errors(left, places, 0.3, [1, 160])
    assert errors.shape == (3, 2)
    assert errors[1].abs().max() < 5 < errors[160].abs().max()


def test_displaced_is_where_the_camera_sees_a_lifted_point(left: Camera) -> None:
    points = np.array([[0.0, 0.0], [1.2, -0.8]])
    lifted = left.pixels_to_floor(left.project(np.column_stack([points, [0.4, 0.4]])))
    np.testing.assert_allclose(lesson.displaced(points, left, 0.4), lifted, atol=2e-3)


def test_the_shadow_of_a_prism(left: Camera) -> None:
    square = np.array([[0, -0.1], [0.2, -0.1], [0.2, 0.1], [0, 0.1]])
    assert lesson.prism_shadow_m2(square, left, 0.0) == pytest.approx(0.04)
    by_height = [lesson.prism_shadow_m2(square, left, height) for height in (0.1, 0.3)]
    assert 0.04 < by_height[0] < by_height[1]


def test_away_is_along_the_line_of_sight(left: Camera) -> None:
    place = np.array([0.5, 0.4])
    ray = (place - left.centre_m[:2]) / np.linalg.norm(place - left.centre_m[:2])
    assert lesson.away_and_sideways(place + 0.1 * ray, place, left) == pytest.approx([0.1, 0.0])
    assert lesson.away_and_sideways(place + 0.1 * np.array([-ray[1], ray[0]]), place, left) == pytest.approx([0.0, 0.1])


def test_the_robot_is_measured_in_every_pose_and_view(robot: Recording, left: Camera) -> None:
    poses = lesson.robot_poses(robot, backgrounds_of(robot), cell_px=40, height_m=0.18)
    assert len(poses) == 12 and set(poses["camera"]) == {"left", "right"}
    assert (poses["away"] > 0).all() and (poses["away"] > 3 * poses["sideways"].abs()).all()
    assert (poses["sum of factors"] / poses["predicted"]).between(0.85, 1.1).all()
    rule = np.column_stack([[1.0, 5.0], [0.05, 0.2]])
    arrows, dots = lesson.centroid_figure(poses, {}, rule).axes
    assert len(arrows.collections) == 2 and len(dots.lines) == 3


def test_flat_objects_have_the_right_size_in_the_chain() -> None:
    sizes = lesson.chain_sizes({"ball_and_oval": 1}).set_index("object")["size / footprint"]
    assert list(sizes.index) == ["oval", "ball"] and sizes["oval"] < 1.3 < 2 < sizes["ball"]


def test_the_list_has_the_truth_and_what_each_view_sees() -> None:
    listed = lesson.listed_objects(open_recording("ball_and_oval", ["left", "right"]), 0, cell_px=40)
    assert list(listed["source"]) == ["truth: ball", "truth: oval", "left", "right", "right"]
    assert listed["size (m2)"][0] == pytest.approx(np.pi * 0.3**2, rel=0.02)


def test_every_text_is_legible(robot: Recording) -> None:
    image = dict(robot.images())[0]["left"]
    figures = [lesson.contour_graph(image, LETTER, 30.0), lesson.two_inverse_tangents(LETTER)]
    assert all(text.get_fontsize() >= 10 for fig in figures for text in fig.findobj(Text) if text.get_text())
