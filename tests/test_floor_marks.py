"""The floor from marks on it: planted homographies and poses come back, and bad marks stand out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib import floor_marks
from occlib.calibration import board_points
from occlib.geometry import Camera, Rig, apply_homography
from occlib.lens import Lens

UFES = Path(__file__).parents[2] / "shared/data/ufes-lab"
needs_ufes = pytest.mark.skipif(not UFES.is_dir(), reason=f"real recording not at {UFES}")

PATTERN, SIZE = (9, 6), (640, 480)
MATRIX = np.array([[530.0, 0, 322.0], [0, 534.0, 238.0], [0, 0, 1]])
DISTORTION = np.array([-0.26, 0.08, 0.001, -0.0005, -0.02])


def rotation(rx: float, ry: float, rz: float) -> np.ndarray[Any, Any]:
    turns = []
    for axis, angle in enumerate((rx, ry, rz)):
        c, s, (i, j) = np.cos(angle), np.sin(angle), [k for k in range(3) if k != axis]
        turn = np.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        turns.append(turn)
    return turns[2] @ turns[1] @ turns[0]


def seen(points: np.ndarray[Any, Any], turn: np.ndarray[Any, Any], shift: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Raw px of world points: pinhole, then Brown-Conrady, written out without cv2."""
    xyz = points @ turn.T + shift
    assert (xyz[:, 2] > 0).all()
    return lens().lens.distort(xyz[:, :2] / xyz[:, 2:] * MATRIX[[0, 1], [0, 1]] + MATRIX[:2, 2])


def lens() -> Camera:
    return Camera("planted", SIZE, Lens(MATRIX, DISTORTION), np.eye(3))


def planted_pose(height: float = 2.5) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """A camera ``height`` m over the floor at (0.3, -1.5) that looks forward and down."""
    turn = rotation(0.0, 0.0, 0.2).T @ rotation(np.pi / 2 + 0.9, 0.0, 0.0)
    return turn, -turn @ np.array([0.3, -1.5, height])


def planted_marks(count: int = 9) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    floor = np.random.default_rng(11).uniform([-0.7, -0.5], [1.0, 1.0], (count, 2))
    return seen(np.column_stack([floor, np.zeros(count)]), *planted_pose()), floor


def planted_homography() -> np.ndarray[Any, Any]:
    turn, shift = planted_pose()
    homography = np.linalg.inv(MATRIX @ np.column_stack([turn[:, 0], turn[:, 1], shift]))
    return homography / homography[2, 2]


def test_planted_floor_homography_is_recovered_from_marks() -> None:
    pixels, floor = planted_marks()
    before = pixels.copy(), floor.copy()
    fit = floor_marks.floor_homography_from_marks(lens(), pixels, floor)
    assert np.abs(fit.image_to_floor - planted_homography()).max() < 1e-6
    assert fit.leave_one_out_m is not None
    assert max(fit.error_m.max(), fit.leave_one_out_m.max()) < 1e-6 and fit.error_px.max() < 1e-5
    assert np.array_equal(before[0], pixels) and np.array_equal(before[1], floor)


def test_four_marks_fit_exactly_and_leave_none_to_check_with() -> None:
    floor = np.array([[-0.5, -0.4], [0.9, -0.4], [0.8, 0.9], [-0.6, 0.7]])
    pixels = seen(np.column_stack([floor, np.zeros(4)]), *planted_pose())
    fit = floor_marks.floor_homography_from_marks(lens(), pixels, floor)
    assert np.abs(fit.image_to_floor - planted_homography()).max() < 1e-6 and fit.leave_one_out_m is None


def test_one_bad_mark_stands_out_when_left_out() -> None:
    pixels, floor = planted_marks()
    pixels[4] += [6.0, 0.0]
    fit = floor_marks.floor_homography_from_marks(lens(), pixels, floor)
    assert fit.leave_one_out_m is not None
    assert int(np.argmax(fit.leave_one_out_m)) == 4
    assert fit.leave_one_out_m[4] > 1.5 * fit.error_m[4] > 0


def test_homography_has_the_least_squares_in_px() -> None:
    pixels, floor = planted_marks()
    pixels = pixels + np.random.default_rng(4).normal(0, 2, pixels.shape)
    fit = floor_marks.floor_homography_from_marks(lens(), pixels, floor)
    ideal, best = lens().lens.undistort(pixels), np.linalg.inv(fit.image_to_floor)
    assert np.linalg.norm(apply_homography(best, floor) - ideal, axis=1) == pytest.approx(fit.error_px)
    for index in np.ndindex(3, 3):
        for step in (-1e-3, 1e-3):
            other = best.copy()
            other[index] *= 1 + step
            worse = np.linalg.norm(apply_homography(other, floor) - ideal, axis=1)
            assert (worse**2).sum() > (fit.error_px**2).sum() * (1 + 1e-9)


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.6, 0.6), st.floats(-0.3, 0.3), st.floats(-3, 3))
def test_a_board_on_the_floor_gives_pose_and_homography(x: float, y: float, angle: float) -> None:
    turn, shift = planted_pose()
    c, s = np.cos(angle), np.sin(angle)
    floor = board_points(PATTERN, 0.05)[:, :2] @ np.array([[c, s], [-s, c]]) + [x, y]
    pixels = seen(np.column_stack([floor, np.zeros(len(floor))]), turn, shift)
    found_turn, found_shift = floor_marks.solve_floor_pose(lens(), pixels, floor)
    assert np.abs(found_turn - turn).max() < 1e-5 and np.abs(found_shift - shift).max() < 1e-5
    homography = floor_marks.floor_homography_from_pose(lens(), found_turn, found_shift)
    assert apply_homography(homography, lens().lens.undistort(pixels)) == pytest.approx(floor, abs=1e-6)


def test_mirrored_points_are_refused() -> None:
    pixels, floor = planted_marks()
    with pytest.raises(ValueError, match="under the floor; the points are mirrored"):
        floor_marks.solve_floor_pose(lens(), pixels, floor * [1, -1])


def test_marks_that_do_not_fix_the_floor() -> None:
    pixels, floor = planted_marks()
    line = np.column_stack([np.linspace(-0.5, 0.8, 6), np.linspace(-0.2, 0.8, 6)])
    cases: list[tuple[Any, Any, str]] = [
        (pixels[:3], floor[:3], "expected 4 or more finite pairs, got 3 and 3"),
        (pixels, floor[:5], "expected 4 or more finite pairs, got 9 and 5"),
        (pixels * np.nan, floor, "expected 4 or more finite pairs"),
        (seen(np.column_stack([line, np.zeros(6)]), *planted_pose()), line, "do not fix a homography"),
        (np.tile(pixels[:1], (5, 1)), np.tile(floor[:1], (5, 1)), "do not fix a homography"),
    ]
    for raw, metres, message in cases:
        with pytest.raises(ValueError, match=message):
            floor_marks.floor_homography_from_marks(lens(), raw, metres)
    with pytest.raises(ValueError, match="pixels, floor_m: expected 4 or more pairs, got 3 and 3"):
        floor_marks.solve_floor_pose(lens(), pixels[:3], floor[:3])


@needs_ufes
def test_real_floor_marks_are_within_a_centimetre() -> None:
    rig, marks = Rig.load(UFES / "rig.yaml"), floor_marks.load_marks(UFES / "floor_marks.yaml")
    assert sorted(marks) == sorted(rig.cameras)
    for name, (pixels, floor) in marks.items():
        fit = floor_marks.floor_homography_from_marks(rig[name], pixels, floor)
        assert fit.leave_one_out_m is not None and np.median(fit.leave_one_out_m) < 0.011
        ideal = rig[name].lens.undistort(pixels)
        shipped = apply_homography(rig[name].image_to_floor, ideal)
        assert np.abs(apply_homography(fit.image_to_floor, ideal) - shipped).max() < 0.015


# --- files -----------------------------------------------------------------------------------------
def test_files_without_marks_are_one_line_errors(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text("- 1")
    with pytest.raises(ValueError, match=r"camera.yaml: expected a mapping 'marks' of cameras"):
        floor_marks.load_marks(path)
    for content in (
        "marks: {left: [{pixel: [1, 2]}]}",
        "marks: {left: 5}",
        "marks: {left: [{pixel: [1], floor: [1, 2]}]}",
    ):
        path.write_text(content)
        with pytest.raises(ValueError, match=r"camera.yaml: marks.left: expected a list of"):
            floor_marks.load_marks(path)
