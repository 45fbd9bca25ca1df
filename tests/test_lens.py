"""The lens: there and back, OpenCV as the reference, and what lies beyond the fold of the distortion."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occlib.lens import Lens

Array = np.ndarray[Any, Any]
MATRIX = np.array([[420.0, 0, 322.0], [0, 425.0, 236.0], [0, 0, 1]])
STRONG = np.array([-0.33, 0.11, 0.002, -0.0015, -0.012])
LENS = Lens(MATRIX, STRONG)
XS, YS = np.meshgrid(np.arange(0, 640, 20), np.arange(0, 480, 20))
PICTURE = np.column_stack([XS.ravel(), YS.ravel()]).astype(float)


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(-0.003, 0.003), st.floats(-0.003, 0.003))
def test_distorting_takes_undistorting_back(k1: float, k2: float, p1: float, p2: float) -> None:
    lens = Lens(MATRIX, np.array([k1, k2, p1, p2, 0.0]))
    straight = PICTURE * 0.8 + [64, 48]
    raw = lens.distort(straight)
    kept = lens.valid(straight)
    assert kept.sum() > 100
    assert np.abs(lens.undistort(raw[kept]) - straight[kept]).max() < 1e-3


def test_points_in_the_cameras_axes_are_seen_where_opencv_sees_them() -> None:
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(-1, 1, (200, 2)), rng.uniform(2, 4, 200)])
    reference = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, STRONG)[0][:, 0]
    assert np.abs(LENS.project(points) - reference).max() < 1e-9
    assert np.abs(LENS.distort(LENS.pinhole(points)) - reference).max() < 1e-9


def test_directions_are_the_way_back_from_the_projection() -> None:
    directions = LENS.directions(PICTURE)
    assert directions.shape == (len(PICTURE), 3) and (directions[:, 2] == 1).all()
    assert np.abs(LENS.project(3.0 * directions) - PICTURE).max() < 1e-4


def test_behind_the_camera_and_beyond_the_fold_there_is_no_picture() -> None:
    lens = Lens(MATRIX, np.array([-1 / 3, 0, 0, 0, 0]))  # r (1 - r^2 / 3) rises until r = 1 and then comes back
    points = np.array([[0.9, 0, 1], [1.1, 0, 1], [0, 0, -1.0], [0, 0, 0]])
    assert np.isfinite(lens.project(points)).all(axis=1).tolist() == [True, False, False, False]
    assert lens.valid(lens.pinhole(points)).tolist() == [True, False, False, False]
    assert np.isfinite(lens.pinhole(points)).all(axis=1).tolist() == [True, True, False, False]
    for almost_none in (0.0, 2e-311, 1e-200):
        assert Lens(MATRIX, np.full(5, -almost_none)).valid([[1e4, 1e4]]).all()


def test_a_straight_lens_leaves_pictures_as_they_are() -> None:
    picture = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    kept = picture.copy()
    assert np.array_equal(Lens(MATRIX, np.zeros(5)).undistort_image(picture), picture)
    assert not np.array_equal(LENS.undistort_image(picture), picture)
    assert np.array_equal(picture, kept)


def test_an_undistorted_picture_shows_a_dot_where_undistorted_points_say() -> None:
    dot = np.zeros((480, 640), np.uint8)
    cv2.circle(dot, (500, 90), 6, 255, -1)
    moments = cv2.moments(LENS.undistort_image(dot))
    seen = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    assert np.abs(seen - LENS.undistort([[500, 90]])[0]).max() < 0.5 < np.abs(seen - [500, 90]).max()


def test_a_pose_that_was_moved_is_refined_back() -> None:
    turn = cv2.Rodrigues(np.array([0.4, -0.3, 0.2]))[0]
    shift = np.array([0.1, -0.1, 2.0])
    plane = np.array([[x, y, 0.0] for x in np.linspace(-0.5, 0.5, 5) for y in np.linspace(-0.4, 0.4, 4)])
    pixels = LENS.project(plane @ turn.T + shift)
    solved = LENS.solve_pose(plane, pixels)
    moved = cv2.Rodrigues(np.array([0.42, -0.31, 0.22]))[0], shift + np.array([0.02, 0.01, -0.05])
    refined = LENS.refine_pose(plane, pixels, *moved)
    for rotation, translation in (solved, refined):
        assert np.abs(rotation - turn).max() < 1e-5 and np.abs(translation - shift).max() < 1e-5


def test_no_points_give_no_points_and_inputs_stay_as_they_were() -> None:
    for method in (LENS.distort, LENS.undistort):
        assert method([]).shape == (0, 2)
    assert LENS.directions([]).shape == (0, 3)
    assert LENS.project([]).shape == (0, 2) and LENS.valid([]).shape == (0,)
    points, kept = np.array([[0.0, 0, -1], [0.1, 0.1, 1]]), np.array([[0.0, 0, -1], [0.1, 0.1, 1]])
    LENS.project(points)
    assert np.array_equal(points, kept)


def test_fields_of_rig_yaml_and_back() -> None:
    again = Lens.from_dict(LENS.to_dict())
    assert np.array_equal(again.matrix, MATRIX) and np.array_equal(again.distortion, STRONG)
    assert not Lens.from_dict({"matrix": MATRIX.tolist()}).distortion.any()
    with pytest.raises(ValueError, match=r"cameras.left.matrix: expected \[\[fx, 0, cx\].*, got \[\[1.0, 2.0"):
        Lens.from_dict({"matrix": [[1, 2, 3], [0, 1, 0], [0, 0, 1]]}, "cameras.left.")
    with pytest.raises(ValueError, match=r"^distortion: expected 5 finite numbers, got"):
        Lens.from_dict({"matrix": MATRIX.tolist(), "distortion": [0, 0, 0, 0]})
