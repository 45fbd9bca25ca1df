"""Tables of chapter 01 on planted cameras and boards."""

from __future__ import annotations

import numpy as np
import pytest

from occlib import calibration, floor_marks
from occlib.course.lessons import calibrate_the_cameras as lesson
from occlib.geometry import Camera, Floor, look_at
from occlib.lens import Lens

BOARD = calibration.board_points((9, 6), 0.09)
SIZE = (640, 480)


def camera(at: tuple[float, float, float] = (-3.0, 0.0, 2.5), focal: float = 450.0) -> Camera:
    """A camera without distortion that looks at the middle of the floor."""
    rotation = look_at(at, (0.0, 0.0, 0.0))
    lens = Lens(np.array([[focal, 0, 320], [0, focal, 240], [0, 0, 1.0]]), np.zeros(5))
    return Camera.from_pose("left", SIZE, lens, rotation, -rotation @ np.array(at))


@pytest.fixture(scope="module")
def corners() -> list[np.ndarray]:
    """The board, tilted in six ways before the camera's lens, without noise."""
    lens, seen = camera().lens, []
    for turn in np.random.default_rng(0).uniform(-0.6, 0.6, (6, 2)):
        (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in turn)
        rotation = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        seen.append(lens.project(BOARD @ rotation.T + [-0.3, -0.2, 1.2]))
    return seen


def test_focal_error_is_that_of_the_worse_axis(corners: list[np.ndarray]) -> None:
    lens = calibration.calibrate(corners, BOARD, SIZE)
    assert lesson.focal_error(lens, camera()) == pytest.approx(0, abs=1e-3)
    assert lesson.focal_error(lens, camera(focal=500.0)) == pytest.approx(10, abs=1e-2)


def test_noise_of_the_hand_is_what_the_table_shows(corners: list[np.ndarray]) -> None:
    rng = np.random.default_rng(0)
    hands = [lesson.hand_marks(corners, 1.0, rng) for _ in range(2)]
    table = lesson.corner_table({"exact": [corners], "hand": hands}, BOARD, camera())
    assert table["sets"].tolist() == [1, 2]
    assert table.loc["exact", "median rms (px)"] < 1e-3 and table.loc["hand", "median rms (px)"] == pytest.approx(
        1.4, abs=0.2
    )
    assert table.loc["hand", "worst focal error (%)"] >= table.loc["hand", "median focal error (%)"] > 0.01


def test_pictures_are_chosen_without_repetition(corners: list[np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    given, corner_table = {}, lesson.corner_table
    monkeypatch.setattr(lesson, "corner_table", lambda sets, *rest: given.update(sets) or corner_table(sets, *rest))
    table = lesson.picture_table(corners, BOARD, camera(), (4, 6), 3, np.random.default_rng(0))
    assert table.index.tolist() == [4, 6] and table["worst focal error (%)"].max() < 1e-2
    assert {count: [len({id(one) for one in chosen}) for chosen in sets] for count, sets in given.items()} == {
        4: [4, 4, 4],
        6: [6, 6, 6],
    }
    assert len(lesson.show_pictures(table).axes) == 2


def test_both_orders_are_half_a_turn_apart() -> None:
    found = np.arange(108.0).reshape(54, 2)
    orders = lesson.both_orders(found, 9)
    rows, columns = orders["rows reversed"], orders["columns reversed"]
    assert np.array_equal(rows[0], found[45]) and np.array_equal(columns[0], found[8])
    assert np.array_equal(rows[::-1], columns)


def test_end_grey_tells_the_black_end() -> None:
    image = np.full((300, 400, 3), 200, np.uint8)
    grid = np.array([[[100 + 20 * c, 100 + 20 * r] for c in range(9)] for r in range(6)], dtype=float)
    for u, v in ((90, 90), (90, 210)):
        image[v - 8 : v + 8, u - 8 : u + 8] = 10
    assert lesson.end_grey(image, grid.reshape(-1, 2), 9) == 10
    assert lesson.end_grey(image, grid[:, ::-1].reshape(-1, 2), 9) == 200


def test_floor_error_of_a_shifted_homography() -> None:
    exact, grid = camera(), Floor((-1.0, 1.0), (-1.0, 1.0), 0.25)
    shift = np.array([[1, 0, 0.003], [0, 1, 0.004], [0, 0, 1.0]])
    moved = Camera("left", SIZE, exact.lens, shift @ exact.image_to_floor)
    error = lesson.floor_error_mm(moved, exact, grid)
    assert error.shape == grid.shape and np.allclose(error, 5, atol=1e-3)
    table = lesson.floor_error_table({("left", "marks"): error})
    assert table.loc[("left", "marks"), "largest error (mm)"] == pytest.approx(5, abs=1e-3)


def test_one_written_mark_is_wrong_and_its_removal_tells() -> None:
    exact = camera()
    places = np.array([[x, y] for x in (-1.8, 0.0, 1.8) for y in (-1.3, 0.0, 1.3) if (x, y) != (0, 0)])
    written, pixels = lesson.mismeasured(places), exact.floor_to_pixels(places)
    assert np.linalg.norm(written - places, axis=1).round(3).tolist() == [0, 0.05, 0, 0, 0, 0, 0, 0]
    fits = [
        floor_marks.floor_homography_from_marks(exact, np.delete(pixels, k, 0), np.delete(written, k, 0))
        for k in range(8)
    ]
    assert np.argmin([fit.error_m.max() for fit in fits]) == 1
    table = lesson.mark_table(floor_marks.floor_homography_from_marks(exact, pixels, written), written)
    assert table["when left out (mm)"].idxmax() != 1 and table["when left out (mm)"][1] == pytest.approx(50, abs=1)
