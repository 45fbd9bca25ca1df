"""The functions behind chapter 06, on planted points, cameras and discs."""

from __future__ import annotations

from collections.abc import Iterator

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text

from occlib.course.lessons import register_the_views as lesson
from occlib.geometry import Camera, Floor, Rig, apply_homography
from occlib.recordings import open_recording

CABINET = np.array([[-0.2, -0.3], [0.2, -0.3], [0.2, 0.3], [-0.2, 0.3]])
TALL = 0.6


@pytest.fixture(autouse=True)
def no_figure_stays_open() -> Iterator[None]:
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return open_recording("ball_and_oval", ["left", "right"]).rig


@pytest.fixture(scope="module")
def left(rig: Rig) -> Camera:
    return rig["left"]


@pytest.fixture(scope="module")
def boxes(rig: Rig) -> dict[str, np.ndarray]:
    """Each camera's silhouette of a box, from its projected corners."""
    from scipy.spatial import ConvexHull
    from skimage.draw import polygon2mask

    corners = np.vstack([np.column_stack([CABINET, np.full(4, height)]) for height in (0.0, TALL)])
    seen = {}
    for name, camera in rig.cameras.items():
        pixels = camera.project(corners)
        hull = pixels[ConvexHull(pixels).vertices]
        seen[name] = np.asarray(polygon2mask(camera.size[::-1], hull[:, ::-1]), dtype=bool)
    return seen


def test_eight_equations_hold_for_a_planted_homography() -> None:
    planted = np.array([[1.1, 0.2, -3.0], [0.1, 0.9, 2.0], [0.01, -0.02, 1.0]])
    source = np.array([[0, 0], [4, 0], [4, 3], [0, 3]], float)
    equations = lesson.eight_equations(source, apply_homography(planted, source))
    assert equations.shape == (8, 9)
    left_side = equations.drop(columns="equals").to_numpy() @ planted.ravel()[:8]
    np.testing.assert_allclose(left_side, equations["equals"])


def test_turning_there_and_back_blurs_edges_only() -> None:
    canvas = Floor((-1, 1), (-1, 1), 0.02)
    picture = np.full((100, 100), 40, np.uint8)
    picture[40:60, 40:60] = 200
    again = lesson.turned_and_back(picture, canvas, 30)
    assert again[50, 50] == 200 and again[50, 25] == 40
    assert (again[30:70, 30:70] != picture[30:70, 30:70]).sum() > 20
    np.testing.assert_array_equal(lesson.turned_and_back(picture, canvas, 0), picture)


def test_the_board_lands_where_it_lies(rig: Rig) -> None:
    landed = lesson.landed_corners_m(rig)
    assert all(np.linalg.norm(landed[name] - lesson.board_corners_m(), axis=1).max() < 0.01 for name in landed)
    errors = lesson.registration_errors(rig, landed).groupby("points")["median (mm)"].max()
    assert errors["tape marks, exact"] < errors["board, detected"] < errors["real lab, clicked"] < 10


def test_a_shifted_board_is_noticed(rig: Rig) -> None:
    landed = {name: lesson.board_corners_m() + np.array([0.004, 0.003]) for name in rig.cameras}
    errors = lesson.registration_errors(rig, landed).set_index("points")
    assert errors.loc["board, detected", "median (mm)"].to_numpy() == pytest.approx(5.0)
    assert errors.loc["board, left to right", "max (mm)"] == pytest.approx(0.0, abs=1e-9)


def test_a_far_pixel_covers_more_along_the_line_of_sight(left: Camera) -> None:
    table = lesson.pixel_on_floor_mm(left, [-2.0, 2.0])
    assert (table["along (mm)"] > table["across (mm)"]).all()
    assert table["along (mm)"][1] > 3 * table["along (mm)"][0]


def test_exact_clicks_leave_no_error_and_more_marks_less(left: Camera) -> None:
    assert lesson.clicked_marks(left, click_px=0.0, trials=1, seed=0)["mean (mm)"].max() < 1
    clicked = lesson.clicked_marks(left, click_px=0.5, trials=10, seed=1)["mean (mm)"]
    assert clicked["8 marks"] < clicked["4 marks"]


def test_a_bumped_camera_keeps_its_place(left: Camera) -> None:
    nodded = lesson.bumped(left, 2.0)
    np.testing.assert_allclose(nodded.centre_m, left.centre_m, atol=1e-6)
    turn = nodded.pose[0] @ left.pose[0].T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(2.0, abs=1e-3)
    tilt = lesson.tilt_errors(left, 0.1, [-1.0, 1.5])
    np.testing.assert_allclose(tilt["measured (mm)"], tilt["predicted (mm)"], rtol=0.02)


def test_reach_by_similar_triangles(rig: Rig, left: Camera, boxes: dict[str, np.ndarray]) -> None:
    assert lesson.box_reach_m(left, 3.0, 0.0) == pytest.approx(3.0)
    top = left.pixels_to_floor(left.project([[0.2, 0.0, TALL]]))[0, 0] - left.centre_m[0]
    assert lesson.box_reach_m(left, 0.2 - left.centre_m[0], TALL) == pytest.approx(top, abs=1e-3)
    low = lesson.ball_reach_m(left, 3.0, 1e-6)
    assert low == pytest.approx(3.0, abs=1e-4) and lesson.ball_reach_m(left, 3.0, 0.3) > 3.3
    floor = Floor((-2, 2), (-1.5, 1.5), 0.01)
    shadows = lesson.views_on_plane(rig, boxes, floor, 0.0)
    table = lesson.reach_table(rig, floor, shadows, shadows, lid_m=(0.2, TALL), ball_m=(0, 0.3)).set_index("object")
    measured, predicted = table.loc["cabinet", "measured (m)"], table.loc["cabinet", "predicted (m)"]
    np.testing.assert_allclose(measured, predicted, atol=0.04)


def test_each_plane_shows_the_slice_and_the_shorter_smear(rig: Rig, boxes: dict[str, np.ndarray]) -> None:
    floor = Floor((-2, 2), (-1.5, 1.5), 0.02)
    both = [np.logical_and(*lesson.views_on_plane(rig, boxes, floor, height).values()) for height in (0, 0.38, TALL, 1)]
    slices = [mask.sum() * floor.cell_area for mask in both]
    base = 0.4 * 0.6
    assert slices[0] == pytest.approx(base, rel=0.15) and slices[2] == pytest.approx(base, rel=0.15)
    assert slices[1] > 2 * base and slices[3] == 0


def test_a_disc_keeps_its_area_and_warping_first_wins(left: Camera) -> None:
    picture = lesson.disc_picture(left, [1.0, 0.2], 0.3)
    mask = picture > 127
    rows, columns = np.nonzero(mask)
    middle = left.pixels_to_floor([[columns.mean(), rows.mean()]])[0]
    np.testing.assert_allclose(middle, [1.0, 0.2], atol=0.02)
    scores = lesson.grid_scores(left, picture, [1.0, 0.2], 0.3, [2, 32])
    assert list(scores.index) == [0.005, 0.08]
    assert 0.9 < scores["threshold first"].iloc[0] < scores["warp first"].iloc[0]
    assert scores["warp first"].iloc[1] < 0.85


def test_every_text_is_legible(rig: Rig, left: Camera, boxes: dict[str, np.ndarray]) -> None:
    floor = Floor((-2, 2), (-1.5, 1.5), 0.05)
    picture = lesson.disc_picture(left, [1.0, 0.2], 0.3)
    shadows = lesson.views_on_plane(rig, boxes, floor, 0.0)
    table = lesson.reach_table(rig, floor, shadows, shadows, lid_m=(0.2, TALL), ball_m=(0, 0.3))
    masks, truth = {"cabinet": shadows, "ball": shadows}, {"cabinet": [CABINET], "ball": [CABINET]}
    figures = [
        lesson.planes_figure(rig, boxes, floor, [0.0, 0.3], CABINET),
        lesson.threshold_figure(left, picture, [1.0, 0.2], 0.3),
        lesson.smear_figure(rig, floor, masks, truth, table),
        lesson.registration_error_figure({name: lesson.board_corners_m() for name in rig.cameras}),
    ]
    assert all(text.get_fontsize() >= 10 for fig in figures for text in fig.findobj(Text) if text.get_text())
