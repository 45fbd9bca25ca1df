"""Tables of chapter 12 on what ships with the package, and on planted detections."""

from __future__ import annotations

import numpy as np
import pytest

from occlib import floor_marks, foreground, formats
from occlib.course.lessons import enter_a_real_laboratory as lesson
from occlib.geometry import Rig
from occlib.recordings import DATA
from occlib.registration import registration_error_m
from occlib.tracking import ObjectVector

HOME = DATA / "ufes-lab"
GROUPS = {"cam2+cam3 wide": ("cam2", "cam3")}


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.load(HOME / "rig.yaml")


@pytest.fixture(scope="module")
def truth() -> formats.Truth:
    return formats.load_truth(HOME / "truth.json")


@pytest.fixture(scope="module")
def marks() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return floor_marks.load_marks(HOME / "floor_marks.yaml")


def vectors(places: list[tuple[float, float]]) -> list[ObjectVector]:
    return [ObjectVector(i, place, (0.0, 0.0), 0.1, (0, 0, 0)) for i, place in enumerate(places)]


def test_a_knock_of_no_degrees_changes_nothing_and_a_refit_heals(rig: Rig, marks: lesson.Marks) -> None:
    still = lesson.knocked(rig["cam1"], [0.0, 0.0, 0.0])
    assert np.allclose(still.image_to_floor, rig["cam1"].image_to_floor)
    table = lesson.knock_table(rig, marks, np.random.default_rng(0), degrees=2, count=5)
    smaller = lesson.knock_table(rig, marks, np.random.default_rng(0), degrees=1, count=5)
    assert (table["knocked, median"] / smaller["knocked, median"]).between(1.5, 2.5).all()
    assert (table["refitted"] < 1).all() and (table["refitted"] <= table["refitted, left out"]).all()


def test_one_camera_was_knocked_in_the_night(rig: Rig, marks: lesson.Marks) -> None:
    today = lesson.seen_today(rig, marks)
    off = {n: np.median(registration_error_m(rig[n], today[n], marks[n][1])) for n in today}
    refit = floor_marks.floor_homography_from_marks(rig["cam2"], today["cam2"], marks["cam2"][1])
    assert off.pop("cam2") > 0.08 > 0.02 > max(off.values())
    assert np.median(refit.error_m) < 0.001  # the marks of a turned camera still fit a homography


def test_plain_median_is_a_median() -> None:
    pictures = [np.full((4, 5, 3), level, np.uint8) for level in (10, 200, 30)]
    assert (lesson.plain_median(pictures) == 30).all()


def test_body_points_are_read_where_people_stand(rig: Rig, truth: formats.Truth) -> None:
    shape = rig["cam2"].size[::-1]
    left_half = np.zeros(shape, bool)
    people = truth.frames[124]
    columns = [rig["cam2"].project([[p.x, p.y, 0.9]])[0, 0] for p in people]
    split = float(np.mean(columns))
    left_half[:, : round(split)] = True
    table = lesson.body_table({("planted", 124, "cam2"): left_half}, rig, truth)
    expected = {p.id: float(u < split) for p, u in zip(people, columns, strict=True)}
    assert {person: table["cam2"][person]["planted"] for person in ("A", "B")} == pytest.approx(expected, abs=0.05)


def test_scores_and_faults_of_planted_objects(truth: formats.Truth) -> None:
    marked = truth.select([120, 124])
    ghost = (-1.0, -0.5)
    told = {
        f: vectors([(p.x, p.y) for p in marked.frames[f] if p.id == "A"] + [ghost] * (f == 124)) for f in (120, 124)
    }
    exact = {f: vectors([(p.x, p.y) for p in marked.frames[f]]) for f in (120, 124)}
    found: lesson.Found = {(("cam2", "cam3"), "half"): told, (("cam2", "cam3"), "all"): exact}
    table = lesson.score_table(found, marked, GROUPS, ("half", "all"), 0.5)["MODA"]
    inside = int(lesson.score_table(found, marked, GROUPS, ("all",), 0.5)["people"].iloc[0])
    assert table.tolist() == pytest.approx([1 - (inside - 2 + 1) / inside, 1])
    faults = lesson.fault_table(found, marked, GROUPS, ("half", "all"), 0.5)
    assert faults.loc[("cam2+cam3 wide", "half")].sum() == inside - 2 + 1
    assert faults.loc[("cam2+cam3 wide", "all")].sum() == 0


def test_people_in_one_line_are_no_degrees_apart(rig: Rig) -> None:
    x, y, _ = rig["cam2"].centre_m
    table = lesson.bearing_table(rig, ["cam2"], [(x, y - 1), (x, y - 3)])
    assert table["apart"].iloc[0] == pytest.approx(0, abs=1e-6)
    assert table["width of the nearer"].iloc[0] == pytest.approx(np.degrees(0.5))


def test_otsu_finds_a_dark_square() -> None:
    floor = np.full((40, 60, 3), 180, np.uint8)
    image = floor.copy()
    image[10:20, 20:30] = 20
    mask = lesson.otsu_mask(image, foreground.as_background(floor))
    assert mask[15, 25] and not mask[35, 50] and 64 <= mask.sum() <= 144


def test_a_miss_is_measured_to_the_nearest_object(truth: formats.Truth) -> None:
    people = truth.frames[124]
    told = {"near": vectors([(people[0].x + 0.03, people[0].y + 0.04), (9.0, 9.0)]), "none": []}
    table = lesson.miss_table(told, people)
    assert table.loc[str(people[0].id), "near"] == pytest.approx(5) and table["none"].isna().all()
