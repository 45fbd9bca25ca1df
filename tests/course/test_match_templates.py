"""What chapter 03 calls: searches, light and thresholds on pictures whose answer is planted."""

from __future__ import annotations

import numpy as np
import pytest

from occlib.course.lessons import match_templates as lesson
from occlib.foreground import average_background
from occlib.localization import Region

RNG = np.random.default_rng(0)
PATCH = RNG.integers(0, 256, (9, 11)).astype(np.uint8)
FLOOR = np.full((60, 80), 120, np.uint8)


def planted(x: int, y: int) -> tuple[np.ndarray, Region]:
    picture = FLOOR.copy()
    picture[y : y + 9, x : x + 11] = PATCH
    return picture, Region(1, 99, (x + 5.0, y + 4.0), (x, y, 11, 9))


PICTURES = {frame: planted(x, y) for frame, (x, y) in {0: (5, 8), 1: (40, 30), 2: (60, 45)}.items()}
IMAGES = {frame: picture for frame, (picture, _) in PICTURES.items()}
ROBOTS = {frame: robot for frame, (_, robot) in PICTURES.items()}
STACKED = np.clip(np.sum([i.astype(int) - 120 for i in IMAGES.values()], axis=0) + 120, 0, 255).astype(np.uint8)


def test_a_window_is_the_box_and_its_margin() -> None:
    rows, columns = lesson.window_around(ROBOTS[1], 4)
    assert (rows.start, rows.stop, columns.start, columns.stop) == (26, 43, 36, 55)


@pytest.mark.parametrize("method", lesson.GREY)
def test_each_search_finds_what_was_planted(method: str) -> None:
    table = lesson.search_each(IMAGES, PATCH, ROBOTS, 3.0, method)
    assert table["right"].all() and (table["error (px)"] == 0).all()
    moved = {frame: np.roll(image, 10, axis=1) for frame, image in IMAGES.items() if frame < 2}
    table = lesson.search_each(moved, PATCH, ROBOTS, 3.0, method)
    assert not table["right"].any() and table["error (px)"].tolist() == [10, 10]


def test_right_by_measure_counts_pictures() -> None:
    counts = lesson.right_by_measure({**IMAGES, 2: FLOOR}, PATCH, ROBOTS, 3.0)
    assert counts[["ssd", "sad", "zncc"]].tolist() == [2, 2, 2]


def test_thresholds_count_matches_right_and_false() -> None:
    table = lesson.by_threshold(STACKED, PATCH, ROBOTS, [-1.0, 0.0, 1e6], 3.0)
    assert table[["matches", "right", "false"]].to_numpy().tolist() == [[0, 0, 0], [3, 3, 0], [1, 1, 0]]
    assert np.isnan(table["mean error (px)"].iloc[0]) and table["mean error (px)"].iloc[1] == 0
    far = {frame: Region(1, 1, (0.0, 0.0), (70, 0, 3, 3)) for frame in ROBOTS}
    assert lesson.by_threshold(STACKED, PATCH, far, [0.0], 3.0)["false"].tolist() == [3]


def test_light_is_multiplied_added_and_clipped() -> None:
    image = np.array([[10, 100, 200, 250]], np.uint8)
    assert lesson.lit(image, 0.5, 30).tolist() == [[35, 80, 130, 155]]
    assert lesson.lit(image, 1.0, -40).tolist() == [[0, 60, 160, 210]]
    assert lesson.half_lit(image, 0.5).tolist() == [[10, 100, 100, 125]]


def test_under_light_tells_found_rejected_and_wrong() -> None:
    picture, robot = PICTURES[1]
    colour = np.stack([picture] * 3, axis=2)
    empty = np.stack([FLOOR] * 3, axis=2)
    background = average_background([empty, empty])
    table = lesson.under_light(colour, background, (PATCH, PATCH), robot, [(1.0, 0), (0.6, 0), (0.2, 0)], 3.0)
    assert table["zncc"].tolist() == ["found"] * 3
    assert table["ssd"].tolist()[0] == "found" and table["ssd"].tolist()[-1] != "found"
    away = Region(1, 1, (0.0, 0.0), (0, 0, 3, 3))
    assert set(lesson.under_light(colour, background, (PATCH, PATCH), away, [(1.0, 0)], 3.0)["ssd"]) == {"wrong"}


def test_unexplained_shares_have_templates_in_rows() -> None:
    windows = {frame: lesson.window_around(robot, 0) for frame, robot in ROBOTS.items()}
    other = IMAGES[1].copy()
    other[windows[1]] = PATCH[::-1]
    shares = lesson.unexplained_shares({0: IMAGES[0], 1: other}, {0: windows[0], 1: windows[1]})
    assert shares.loc[0, 0] == shares.loc[1, 1] == 0 and shares.loc[0, 1] > 0.5
    wider = {0: lesson.window_around(ROBOTS[0], 4), 1: windows[1]}
    shares = lesson.unexplained_shares({0: IMAGES[0], 1: IMAGES[1]}, wider)
    assert shares.loc[0, 1] == shares.loc[1, 0] == 0  # the same patch, and floor around it in both


def test_a_turn_by_nothing_explains_everything() -> None:
    picture, robot = PICTURES[1]
    shares = lesson.turned_or_scaled(picture, lesson.window_around(robot, 0), robot.middle, [0, 45], [1.0, 0.5])
    assert shares.loc[("rotation", 0), "ssd"] == shares.loc[("size", 1.0), "ssd"] == 0
    assert (shares.loc[[("rotation", 45), ("size", 0.5)]] > 0.3).all(axis=None)


def test_the_score_against_gain_is_best_at_one() -> None:
    picture, robot = PICTURES[1]
    curves = lesson.score_against_gain(picture, PATCH, robot, [0.5, 1.0, 1.4])
    assert curves["ssd"].idxmin() == 1.0 and curves.loc[1.0, "ssd"] == 0
    assert curves["zncc"].min() > 0.9 and (curves["ssd anywhere"] <= curves["ssd"]).all()
