"""Trials: search images with a known answer, and what is measured on them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from occlib import geometry, recordings
from occlib.lens import Lens
from occlib.matching import measures, search
from occlib.study import trials, work
from occlib.study.conditions import CONDITIONS


@pytest.mark.slow
@pytest.mark.parametrize("source", [*trials.PHOTOGRAPHS, "robot", "four_robots"])
def test_clean_trial_holds_the_template_at_the_true_place(source):
    for side in (16, 48, 128):
        trial = trials.make_trial(source, 3, side=side)
        assert trial.image.shape == (240, 320) and trial.image.dtype == trial.template.dtype == np.uint8
        assert trial.template.shape == (side, side)
        x, y = np.floor(trial.corner).astype(int)
        right, down = trial.corner - (x, y)  # the template as it looks when displaced by the rest of a pixel
        warp = np.array([[1, 0, right], [0, 1, down]])
        expected = cv2.warpAffine(trial.template, warp, (side, side), flags=cv2.INTER_LANCZOS4)[3:-3, 3:-3]
        difference = trial.image[y : y + side, x : x + side][3:-3, 3:-3].astype(float) - expected
        assert difference.std() < 1.3 * trials.SENSOR_NOISE and abs(difference.mean()) < 2


def test_the_search_image_is_displaced_by_a_fraction_of_a_pixel_and_noisy():
    corners = np.array([trials.make_trial("camera", seed).corner for seed in range(20)])
    fractions = corners - np.rint(corners)
    assert 0.2 < fractions.std() < 0.4 and abs(fractions).max() <= 0.5
    one, other = (trials.make_trial("camera", 0, name, CONDITIONS[name].levels[-1]) for name in ("side", "jpeg"))
    clean = trials.make_trial("camera", 0)
    assert np.array_equal(other.image, clean.image) and (other.corner == clean.corner).all()
    assert one.image.astype(float).std() > clean.image.astype(float).std()  # tried under more noise


@pytest.mark.parametrize(
    "name, level", [("noise", 0), ("rotation", 45), ("rotation", 10), ("scale", 1.6), ("scale", 0.8)]
)
def test_the_truth_is_where_the_target_is(name, level, monkeypatch):
    """Measured independently: the centre of gravity of a spot that is the target."""
    rows, columns = np.mgrid[:400, :500]
    spot = np.rint(250 * np.exp(-((columns - 230) ** 2 + (rows - 190) ** 2) / 30)).astype(np.uint8)
    view = trials.View(spot, np.array([230.0, 190.0]), np.eye(2))
    monkeypatch.setattr(trials, "_views", lambda source, seed: {0: view})
    monkeypatch.setattr(trials, "SENSOR_NOISE", 0.0)
    for seed in range(6):
        trial = trials.make_trial("camera", seed, name, level, side=49)
        weights = trial.image.astype(float)
        y, x = (np.average(axis, weights=weights) for axis in np.mgrid[:240, :320])
        assert (x, y) == pytest.approx(trial.corner + 24, abs=0.02)


def test_one_seed_has_the_same_target_under_every_condition():
    start = trials.make_trial("camera", 5)
    for name, condition in CONDITIONS.items():
        if name in ("side", "time"):
            continue
        trial = trials.make_trial("camera", 5, name, condition.levels[-1])
        assert np.array_equal(trial.template, start.template), name
        assert (trial.corner is None) if name == "absent" else (trial.corner == start.corner).all(), name
    assert not np.array_equal(trials.make_trial("camera", 6).template, start.template)


@pytest.mark.slow
def test_robots_move_with_their_silhouettes():
    for seed in range(3):
        now, later = (trials.make_trial("four_robots", seed, "time", level) for level in (0, 32))
        assert np.array_equal(now.template, later.template)
        assert not np.array_equal(now.image, later.image)
        views = trials._views("four_robots", seed)
        assert np.hypot(*(views[32].centre - views[0].centre)) > 10  # px; drove for 3.2 s
        x, y = np.rint(views[32].centre - 23.5).astype(int)
        column, row = np.rint(later.corner).astype(int)
        robot = views[32].grey[y : y + 48, x : x + 48]
        gap = later.image[row - 1 : row + 49, column - 1 : column + 49]  # the corner may round the other way
        assert search.similarity(gap, robot, "zncc").max() > 0.9 and robot.min() < 60  # the dark chassis


def test_real_people_are_found_where_the_truth_says(shared_data, monkeypatch):
    monkeypatch.setenv("OCCLIB_CACHE", str(shared_data("ufes-lab").parent))
    assert "ufes-lab" in trials.sources()
    views = trials._views("ufes-lab", 0)
    assert set(views) == {0, 4, 8, 16, 32} and views[0].grey.shape == (364, 644)
    table = work.run_batch(work.Batch("ufes-lab", 0, 48, (("time", (0.0, 4.0)),)), ["zncc"])
    assert table["found"].tolist()[0] and table["error_cm"].notna().all()


def test_sources_without_the_real_recording(monkeypatch, tmp_path):
    monkeypatch.setenv("OCCLIB_CACHE", str(tmp_path))
    assert "ufes-lab" not in trials.sources() and set(trials.PHOTOGRAPHS) < set(trials.sources())
    with pytest.raises(ValueError, match="occlib data fetch ufes-lab"):
        work.batches(sources=["ufes-lab"])


def test_floor_error_against_a_hand_computation():
    homography = np.array([[0.02, 0, 1], [0, 0.03, 2], [0, 0, 1.0]])  # 2 cm a px in x, 3 cm in y
    camera = geometry.Camera("above", (320, 240), Lens(np.diag([100.0, 100, 1]), np.zeros(5)), homography)
    assert trials.cm_per_px(camera, np.array([50.0, 60.0])) == pytest.approx(np.diag([2, 3]), abs=1e-6)
    template = trials._photograph("camera")[200:248, 200:248]
    image = np.zeros((240, 320), np.uint8)
    image[64:112, 53:101] = template  # 3 px right of and 4 px below the truth
    moved = trials.Trial(image, template, np.array([50.0, 60.0]), np.diag([2.0, 3.0]))
    row = trials.measured_trial(moved, measures.METHODS["ssd"], 5.0)
    assert (row["dx"], row["dy"]) == pytest.approx((3, 4), abs=0.3)  # refined below the pixel
    assert row["error_px"] == np.hypot(row["dx"], row["dy"])
    assert row["error_cm"] == pytest.approx(np.hypot(2 * row["dx"], 3 * row["dy"]))
    assert row["score_target"] == 0 and row["optimum"] and row["wrong_1"] > 0
    assert trials.measured_trial(moved, measures.METHODS["ssd"], row["error_px"])["found"]
    assert not trials.measured_trial(moved, measures.METHODS["ssd"], row["error_px"] - 1e-6)["found"]


def test_peak_ratio_is_the_second_cost_over_the_first():
    template = np.zeros((16, 16), np.uint8)
    template[4:12, 4:12] = 100
    image = np.zeros((240, 320), np.uint8)
    image[50:66, 40:56], image[150:166, 240:256] = template + 2, template + 6
    trial = trials.Trial(image, template, np.array([40.0, 50.0]), np.full((2, 2), np.nan))
    assert trials.measured_trial(trial, measures.METHODS["sad"], 5.0)["peak_ratio"] == pytest.approx(3)
    assert trials.measured_trial(trial, measures.METHODS["ssd"], 5.0)["peak_ratio"] == pytest.approx(9)
    assert trials.measured_trial(trial, measures.METHODS["zncc"], 5.0)["peak_ratio"] == 1  # both are perfect


def test_runtime_grows_with_the_side():
    table = trials.runtime([16, 128], ["ssd", "sad"], repeats=3)
    assert list(table.columns) == ["side", "method", "median_ms"] and len(table) == 4
    assert (table["median_ms"] > 0).all()


def test_recordings_are_found_from_any_directory(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert isinstance(recordings.open_recording("robot"), recordings.Recording) and Path.cwd() == tmp_path
