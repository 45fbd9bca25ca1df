"""Tables of chapter 02 on planted pictures."""

from __future__ import annotations

import numpy as np
import pytest

from occlib import foreground
from occlib.course.lessons import subtract_the_background as lesson

FLOOR = np.full((60, 80, 3), 180, np.uint8)


@pytest.fixture
def planted() -> lesson.LabelledView:
    """A black square of 20 px on the grey floor."""
    image, silhouette = FLOOR.copy(), np.zeros((60, 80), bool)
    silhouette[20:40, 30:50] = True
    image[silhouette] = 30
    return lesson.LabelledView(0, "left", image, silhouette)


def test_the_robot_is_in_its_silhouette() -> None:
    recording = lesson.open_recording("robot", ["left", "right"])
    views = lesson.labelled_views(recording, "robot", [1])
    assert [(view.instant, view.camera) for view in views] == [(1, "left"), (1, "right")]
    for view in views:
        empty = foreground.average_background(recording.background_images()[view.camera])
        difference = foreground.subtract_background(view.image, empty)
        assert difference[view.silhouette].mean() > 50 > 5 > difference[~view.silhouette].mean()


def test_adjusting_undoes_an_exposure() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(60, 200, (60, 80, 3), np.uint8)
    table = lesson.exposure_table(image, foreground.as_background(image), [1.1, 1.0], size=1)
    assert list(table.index) == [1.0, 1.1]
    assert table["foreground (%)", "not adjusted"].tolist()[0] == 0 < 50 < table["foreground (%)", "not adjusted"][1.1]
    assert table["foreground (%)", "adjusted"].max() == 0


def test_smoothing_removes_a_speck_and_leaves_a_plateau() -> None:
    difference, silhouette = np.zeros((200, 200), np.uint8), np.zeros((200, 200), bool)
    silhouette[90:110, 90:110] = True
    difference[60:140, 60:140] = 20
    difference[5, 5] = 100
    table = lesson.smoothing_table(difference, silhouette, 30, sizes=(1, 5))
    assert table["regions"].tolist() == [1, 0]
    assert table["noise (std)"][5] < table["noise (std)"][1]
    assert table["reflection (mean)"].tolist() == [20, 20]


def test_between_class_variance_is_otsus() -> None:
    values = np.array([1, 2, 3, 2, 80, 90], np.uint8)
    by_level = {k: lesson.between_class_variance(values, k) for k in range(256)}
    assert max(by_level, key=lambda k: by_level[k]) == foreground.otsu_threshold(values.reshape(1, -1)) == 3
    assert by_level[3] == pytest.approx(4 / 6 * 2 / 6 * 83**2) and by_level[0] == by_level[90] == 0


def test_scores_of_a_perfect_threshold(planted: lesson.LabelledView) -> None:
    backgrounds = {"left": foreground.as_background(FLOOR)}
    curve = lesson.f_measure_curve([planted], backgrounds, 1)
    assert curve.shape == (256,) and (curve[:150] == 1).all() and (curve[150:] == 0).all()
    table = lesson.threshold_table([planted], backgrounds, {"fixed": 30.0, "high": 200.0}, sizes=(1,))
    assert table["F", 1].tolist() == [1, 0] and table["missed (%)", 1].tolist() == [0, 100]
    assert table["regions", 1].tolist() == [1, 0]


def test_an_empty_difference_under_two_rules() -> None:
    nothing = np.random.default_rng(0).integers(0, 5, (60, 80), np.uint8)
    table = lesson.empty_table(nothing, {"otsu": "otsu", "fixed": 1.0}, 8.0)
    assert table["level", "with noise floor"].tolist() == [8, 1]
    assert table["foreground (%)", "with noise floor"]["otsu"] == 0 < 20 < table["foreground (%)", "alone"]["otsu"]


def test_a_median_keeps_who_parks_for_more_than_half(planted: lesson.LabelledView) -> None:
    pictures = [planted.image, *(np.roll(planted.image, shift, axis=1) for shift in (25, -25))]
    table = lesson.parking_table(pictures, planted.silhouette, FLOOR, (3, 9))
    assert table["median"].tolist() == [0, 150] and list(table.index) == ["3 of 12", "9 of 12"]


def test_figures_show_what_they_are_given(planted: lesson.LabelledView) -> None:
    background = foreground.as_background(FLOOR)
    difference = foreground.subtract_background(planted.image, background)
    figures = [
        lesson.show_pair({"left": planted.image, "right": FLOOR}, "instant 0"),
        lesson.show_difference(difference, difference, planted.silhouette, size=1),
        lesson.show_decisions(planted.image, difference, planted.silhouette, dict.fromkeys(lesson.STYLES, 30.0)),
        lesson.show_levels(difference, planted.silhouette, {"otsu": 75.0}, {"raw": np.ones(256)}),
        lesson.show_shadows(planted, background),
        lesson.show_ghosts({"median": FLOOR}, planted.image, planted.silhouette, size=1),
    ]
    titles = [[ax.get_title() for ax in figure.axes] for figure in figures]
    assert titles[0] == ["left camera, instant 0", "right camera, instant 0"]
    assert "otsu (30): F = 1.00" in titles[2]
