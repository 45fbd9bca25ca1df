"""Calibration: planted cameras come back, boards are found where they were drawn, the floor fits its marks."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from occlib import calibration
from occlib.base.files import encode_image, write_file
from occlib.geometry import Camera
from occlib.lens import Lens

SHARED = Path(__file__).parents[2] / "shared/data"
BOARDS, UFES = SHARED / "opencv-checkerboard", SHARED / "ufes-lab"
needs_boards = pytest.mark.skipif(not BOARDS.is_dir(), reason=f"real photographs not at {BOARDS}")
needs_ufes = pytest.mark.skipif(not UFES.is_dir(), reason=f"real recording not at {UFES}")

PATTERN, SQUARE, SIZE = (9, 6), 0.025, (640, 480)
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


def planted_views(count: int = 12) -> list[np.ndarray[Any, Any]]:
    rng = np.random.default_rng(7)
    board = calibration.board_points(PATTERN, SQUARE)
    views = []
    for _ in range(count):
        turn = rotation(*rng.uniform(-0.5, 0.5, 3))
        shift = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.3, 0.5)]) - turn @ board.mean(axis=0)
        views.append(seen(board, turn, shift))
    return views


def drawn_board(corner: tuple[float, float] = (60.0, 50.0), square: float = 22.0, tilt: float = 0.1) -> Any:
    """A 9x6 board under a known affine map, 4x4 samples a pixel, and the true corners."""
    along = np.array([np.cos(tilt), np.sin(tilt)]) * square
    across = np.array([-np.sin(tilt), np.cos(tilt)]) * square
    offsets = (np.arange(4) - 1.5) / 4
    v, u = np.meshgrid(*((np.arange(n)[:, None] + offsets).ravel() for n in (240, 320)), indexing="ij")
    cells = (np.stack([u, v], -1) - corner) @ np.linalg.inv(np.stack([along, across]))
    i, j = np.floor(cells[..., 0]), np.floor(cells[..., 1])
    on_board = (i >= -1) & (i < 9) & (j >= -1) & (j < 6)
    grey = np.where(on_board & ((i + j) % 2 == 0), 30.0, 220.0).reshape(240, 4, 320, 4).mean(axis=(1, 3))
    truth = np.array([np.asarray(corner) + a * along + b * across for b in range(6) for a in range(9)])
    return np.round(grey).astype(np.uint8), truth


# --- corners ---------------------------------------------------------------------------------------
def test_board_is_found_where_it_was_drawn() -> None:
    grey, truth = drawn_board()
    before = grey.copy()
    found = calibration.find_checkerboard(grey, PATTERN)
    assert found is not None and found.shape == (54, 2) and found.dtype == np.float64
    assert np.abs(found - truth).max() < 0.1
    assert np.array_equal(grey, before)
    rgb = calibration.find_checkerboard(np.dstack([grey] * 3), PATTERN)
    assert rgb is not None and np.allclose(rgb, found, atol=0.01)


def test_neighbouring_corners_of_a_small_board_do_not_pull() -> None:
    grey, truth = drawn_board(square=12.0)
    found = calibration.find_checkerboard(grey, PATTERN)
    assert found is not None and np.abs(found - truth).max() < 0.15
    assert np.abs(calibration.refine_corners(grey, truth, window_px=11) - truth).max() > 1  # what a fixed window does


def test_the_order_of_corners_depends_on_the_picture_only() -> None:
    grey, truth = drawn_board()
    turned = calibration.find_checkerboard(np.ascontiguousarray(grey[::-1, ::-1]), PATTERN)
    assert turned is not None
    assert np.abs(turned - ([319, 239] - truth[::-1])).max() < 0.1  # again from the top left
    again = calibration.find_checkerboard(np.ascontiguousarray(grey[::-1, ::-1]), PATTERN)
    assert again is not None and np.array_equal(turned, again)


def test_no_board_is_none() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), dtype=np.uint8)
    assert calibration.find_checkerboard(noise, PATTERN) is None
    assert calibration.find_checkerboard(np.full((240, 320, 3), 128, np.uint8), PATTERN) is None


def test_hand_marks_move_to_the_corner() -> None:
    grey, truth = drawn_board()
    marks = truth + np.random.default_rng(3).uniform(-2, 2, truth.shape)
    before = marks.copy()
    refined = calibration.refine_corners(grey, marks)
    assert np.abs(refined - truth).max() < 0.1 < np.abs(marks - truth).max()
    assert np.array_equal(marks, before)
    assert calibration.refine_corners(grey, np.empty((0, 2))).shape == (0, 2)


def test_a_mark_on_a_flat_patch_stays() -> None:
    assert calibration.refine_corners(np.full((60, 60), 99, np.uint8), [[30.0, 31.0]]).tolist() == [[30.0, 31.0]]


@pytest.mark.parametrize("text", ["9", "9x", "axb", "9x6x2", "-9x6", "2x6", ""])
def test_wrong_pattern_texts(text: str) -> None:
    with pytest.raises(ValueError, match="pattern: expected"):
        calibration.parse_pattern(text)


def test_wrong_images_and_marks() -> None:
    grey, _ = drawn_board()
    with pytest.raises(ValueError, match=r"image: expected uint8 \(H, W\) or \(H, W, 3\), got float64 \(240, 320\)"):
        calibration.find_checkerboard(grey.astype(float), PATTERN)
    with pytest.raises(ValueError, match=r"pattern: expected \(columns, rows\).*got \(2, 6\)"):
        calibration.find_checkerboard(grey, (2, 6))
    with pytest.raises(ValueError, match=r"marks_px: expected points in the 320x240 image, got \[400.0, 5.0\]"):
        calibration.refine_corners(grey, [[10, 10], [400, 5]])
    with pytest.raises(ValueError, match="marks_px: expected points in the 320x240 image"):
        calibration.refine_corners(grey, [[np.nan, 10]])
    with pytest.raises(ValueError, match="window_px: expected half a side in px >= 1, got 0"):
        calibration.refine_corners(grey, [[10, 10]], window_px=0)
    with pytest.raises(ValueError, match="image: expected at least 15 px a side, got 9x9"):
        calibration.refine_corners(grey[:9, :9], [[3, 3]])
    with pytest.raises(ValueError, match="square: expected metres > 0, got 0"):
        calibration.board_points(PATTERN, 0)


# --- intrinsics ------------------------------------------------------------------------------------
def test_planted_camera_is_recovered_from_exact_corners() -> None:
    views, board = planted_views(), calibration.board_points(PATTERN, SQUARE)
    before = [view.copy() for view in views]
    found = calibration.calibrate(views, board, SIZE)
    assert found.rms_px < 1e-3 and found.views_used == 12
    assert np.abs(found.matrix - MATRIX).max() < 0.05
    assert np.abs(found.distortion[:4] - DISTORTION[:4]).max() < 5e-3
    assert all(np.array_equal(a, b) for a, b in zip(views, before, strict=True))
    for i, view in enumerate(views):  # the poses explain the views, by our own reckoning
        errors = calibration.reprojection_error(found, found.rotations[i], found.translations[i], board, view)
        assert np.sqrt((errors**2).mean()) == pytest.approx(found.view_rms_px[i], abs=1e-5)


def test_noise_shows_in_the_rms() -> None:
    rng = np.random.default_rng(5)
    views = [view + rng.normal(0, 0.2, view.shape) for view in planted_views()]
    found = calibration.calibrate(views, calibration.board_points(PATTERN, SQUARE), SIZE)
    assert found.rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
    assert np.sqrt((found.view_rms_px**2).mean()) == pytest.approx(found.rms_px)
    assert found.matrix[0, 0] == pytest.approx(530, abs=5)


def test_the_unit_of_the_board_does_not_change_the_camera() -> None:
    views = planted_views(5)
    small, large = (calibration.calibrate(views, calibration.board_points(PATTERN, s), SIZE) for s in (0.025, 0.05))
    assert large.matrix == pytest.approx(small.matrix, abs=0.01)
    assert large.translations == pytest.approx(2 * small.translations, rel=1e-4)


def test_views_that_do_not_fix_the_camera() -> None:
    views, board = planted_views(3), calibration.board_points(PATTERN, SQUARE)
    frontal = seen(board, np.eye(3), np.array([-0.1, -0.06, 0.4]))
    cases: list[tuple[list[Any], str]] = [
        (views[:2], "corner_sets: expected at least 3 views, got 2"),
        ([*views[:2], views[2][:50]], r"corner_sets\[2\]: expected 54 finite corners, got shape \(50, 2\)"),
        ([*views[:2], views[2] * np.nan], r"corner_sets\[2\]: expected 54 finite corners"),
        ([np.zeros((54, 2))] * 3, "corner_sets: OpenCV cannot calibrate from these views"),
        ([frontal] * 3, "corner_sets: the board must be tilted differently from view to view"),
    ]
    for corner_sets, message in cases:
        with pytest.raises(ValueError, match=message):
            calibration.calibrate(corner_sets, board, SIZE)


def write_image(path: Path, image: np.ndarray[Any, Any]) -> Path:
    return write_file(path, encode_image(path.suffix, image))


def test_images_without_a_board_are_skipped_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    paths = [write_image(tmp_path / "empty.png", np.full((240, 320), 128, np.uint8))]
    paths += [write_image(tmp_path / f"{i}.png", drawn_board(tilt=0.1 * i)[0]) for i in range(2)]
    message = "images: a 9x6 board is in 2 of 3 images, at least 3 are needed"
    with pytest.raises(ValueError, match=message):
        calibration.calibrate_images(paths, PATTERN, SQUARE, progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert [line.rpartition(": ")[2] for line in lines] == ["no board, skipped", "board found", "board found"]
    with pytest.raises(ValueError, match="images: a 9x6 board is in 0 of 0 images"):
        calibration.calibrate_images([], PATTERN, SQUARE)


def test_images_of_different_size_or_not_images(tmp_path: Path) -> None:
    first = write_image(tmp_path / "a.png", drawn_board()[0])
    second = write_image(tmp_path / "b.png", drawn_board()[0][:200])
    with pytest.raises(ValueError, match=r"b.png: expected 320x240 px like .*a.png, got 320x200"):
        calibration.calibrate_images([first, second], PATTERN, SQUARE)
    (tmp_path / "c.png").write_text("no picture")
    with pytest.raises(ValueError, match=r"c.png: corrupt or not an image"):
        calibration.calibrate_images([tmp_path / "c.png"], PATTERN, SQUARE)


@needs_boards
def test_real_photographs_reach_opencvs_own_reference(tmp_path: Path) -> None:
    paths = sorted(BOARDS.glob("left*.jpg"))
    blank = write_image(tmp_path / "blank.png", np.full((480, 640), 128, np.uint8))
    found = calibration.calibrate_images([*paths, blank], PATTERN, SQUARE)
    assert found.rms_px <= 0.41
    assert found.matrix[0, 0] == pytest.approx(535.9, abs=2.0)
    assert (found.views_used, len(found.images_used)) == (13, 13)
    assert found.images_skipped == ("blank.png",)


def test_reprojection_error_is_the_distance_in_px() -> None:
    turn, shift = rotation(0.1, -0.2, 0.3), np.array([0.1, 0.0, 0.5])
    points = np.random.default_rng(11).uniform([-0.7, -0.5, 2], [1.0, 1.0, 3], (9, 3))
    pixels = seen(points, turn, shift)
    assert calibration.reprojection_error(lens(), turn, shift, points, pixels).max() < 1e-9
    assert calibration.reprojection_error(lens(), turn, shift, points, pixels + np.array([3, 4])) == pytest.approx(5.0)
    with pytest.raises(ValueError, match="pixels: expected 2 points like points_m, got 9"):
        calibration.reprojection_error(lens(), turn, shift, points[:2], pixels)


# --- files -----------------------------------------------------------------------------------------
def planted_calibration() -> calibration.Calibration:
    return calibration.Calibration(SIZE, Lens(MATRIX, DISTORTION), 0.25, 13)


def test_calibration_reads_back(tmp_path: Path) -> None:
    path = calibration.save_calibration(tmp_path / "camera.yaml", planted_calibration())
    assert list(yaml.safe_load(path.read_text())) == ["size", "matrix", "distortion", "rms_px", "views_used"]
    found = calibration.load_calibration(path)
    assert (found.size, found.rms_px, found.views_used) == (SIZE, 0.25, 13)
    assert np.array_equal(found.matrix, MATRIX) and np.array_equal(found.distortion, DISTORTION)
    camera = found.camera("left", np.eye(3))
    assert (camera.name, camera.size, camera.lens) == ("left", SIZE, found.lens)
    with pytest.raises(ValueError, match="image_to_floor: expected an invertible 3x3"):
        found.camera("left", np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("size", [640], "size: expected 2 finite numbers, got [640]"),
        ("matrix", [[1, 0], [0, 1]], "matrix: expected 3x3 finite numbers"),
        ("matrix", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "matrix: expected [[fx, 0, cx]"),
        ("distortion", None, "distortion: expected 5 finite numbers, got None"),
        ("rms_px", "low", "rms_px: expected px >= 0, got 'low'"),
        ("rms_px", float("nan"), "rms_px: expected px >= 0, got nan"),
        ("views_used", ["a.png"], "views_used: expected a number of views"),
    ],
)
def test_malformed_calibrations(tmp_path: Path, name: str, value: Any, message: str) -> None:
    path = calibration.save_calibration(tmp_path / "camera.yaml", planted_calibration())
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), name: value}))
    with pytest.raises(ValueError, match=f"camera.yaml: {re.escape(message)}"):
        calibration.load_calibration(path)


def test_other_files_are_one_line_errors(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    with pytest.raises(ValueError, match=r"camera.yaml: cannot read"):
        calibration.load_calibration(path)
    path.write_text("- 1")
    with pytest.raises(ValueError, match=r"camera.yaml: expected a mapping with 'size'"):
        calibration.load_calibration(path)
