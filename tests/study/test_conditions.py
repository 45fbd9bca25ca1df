"""Conditions: what each does to a picture, and all that the study asks of them."""

from __future__ import annotations

import numpy as np
import pytest

from occlib.matching import search
from occlib.study import charts, conditions, tables, trials, work
from occlib.study.conditions import CHANGING_LIGHT, CONDITIONS, CONSTANT_LIGHT, Condition

BOX = (100, 60, 48, 48)
SQUARE = np.s_[60:108, 100:148]


@pytest.fixture(scope="module")
def picture():
    return trials._photograph("camera")[100:340, 100:420]


def degrade(picture, name, level, seed=0):
    before = picture.copy()
    changed = CONDITIONS[name].apply(picture, BOX, level, np.random.default_rng(seed))
    assert changed.dtype == np.uint8 and changed.shape == picture.shape
    assert np.array_equal(picture, before)
    return changed


def test_gain_and_offset_multiply_and_add_and_clip():
    values = np.tile(np.array([[0, 50, 101, 200]], np.uint8), (240, 80))
    assert degrade(values, "gain", 2)[0, :4].tolist() == [0, 100, 202, 255]
    assert degrade(values, "gain", 0.4)[0, :4].tolist() == [0, 20, 40, 80]
    assert degrade(values, "offset", 80)[0, :4].tolist() == [80, 130, 181, 255]
    assert degrade(values, "offset", -80)[0, :4].tolist() == [0, 0, 21, 120]


def test_gradient_rises_from_left_to_right_around_one():
    ramp = degrade(np.full((240, 321), 100, np.uint8), "gradient", 0.4)
    assert ramp[0, [0, 160, 320]].tolist() == [60, 100, 140]
    assert (np.diff(ramp.astype(int), axis=1) >= 0).all() and (ramp == ramp[0]).all()


def test_noise_and_blur_have_the_stated_standard_deviation():
    noise = degrade(np.full((240, 320), 128, np.uint8), "noise", 20).astype(float)
    assert noise.std() == pytest.approx(20, rel=0.03) and noise.mean() == pytest.approx(128, abs=0.5)
    point = np.zeros((241, 321), np.uint8)
    point[100:141, 150:171] = 255
    spread = degrade(point, "blur", 4).astype(float).sum(axis=0)
    variance = (21**2 - 1) / 12 + 4**2  # of a box of 21 px, and of the blur
    assert np.average((np.arange(321) - 160) ** 2, weights=spread) == pytest.approx(variance, rel=0.05)


@pytest.mark.parametrize("level", [0.2, 0.4, 0.6, 0.8])
@pytest.mark.parametrize("seed", range(4))
def test_occlusion_covers_the_stated_share_of_the_box_and_nothing_else(level, seed):
    marked = np.zeros((240, 320), np.uint8)
    marked[SQUARE] = 255  # whatever comes from elsewhere is 0
    changed = degrade(marked, "occlusion", level, seed)
    assert (changed[SQUARE] == 0).sum() == round(level * 48 * 48)
    assert (np.delete(changed, np.s_[60:108], axis=0) == 0).all()


@pytest.mark.parametrize(("name", "level"), [("rotation", 30), ("rotation", 45), ("scale", 0.6), ("scale", 1.6)])
def test_rotation_and_scale_keep_the_centre_of_the_target(name, level):
    rows, columns = np.mgrid[:240, :320]
    spot = np.rint(250 * np.exp(-((columns - 123.5) ** 2 + (rows - 83.5) ** 2) / 50)).astype(np.uint8)
    changed = degrade(spot, name, level).astype(float)
    assert np.average(columns, weights=changed) == pytest.approx(123.5, abs=0.1)
    assert np.average(rows, weights=changed) == pytest.approx(83.5, abs=0.1)


def test_rotation_is_anticlockwise_and_scale_magnifies():
    bar = np.zeros((240, 320), np.uint8)
    bar[78:90, 124:190] = 255  # from the centre of the box to the right
    turned = degrade(bar, "rotation", 45)
    assert turned[50, 157] == 255 and turned[117, 157] == 0
    assert (degrade(bar, "scale", 1.6) > 127).sum() == pytest.approx(1.6**2 * (bar > 127).sum(), rel=0.05)


def test_clutter_pastes_turned_copies_beside_the_target(picture):
    changed = degrade(picture, "clutter", 1)
    assert np.array_equal(changed[SQUARE], picture[SQUARE])
    assert 0 < (changed != picture).sum() <= 48 * 48
    copies = [np.rot90(p, k) for p in (picture[SQUARE], picture[SQUARE][:, ::-1]) for k in range(4)]
    best = [search.similarity(changed, np.ascontiguousarray(c), "ssd") for c in copies[1:]]
    assert min(score.min() for score in best) == 0
    more = degrade(picture, "clutter", 8)
    assert (more != picture).sum() > 3 * (changed != picture).sum()


def test_jpeg_loses_more_at_lower_quality(picture):
    error = [np.abs(degrade(picture, "jpeg", q).astype(float) - picture).mean() for q in (2, 10, 30)]
    assert error[0] > error[1] > error[2] > 0.5


@pytest.mark.parametrize("corner", [(0, 0), (100, 60), (272, 192)])
def test_absent_leaves_nothing_of_the_target(corner):
    x, y = corner
    marked = np.zeros((240, 320), np.uint8)
    marked[y : y + 48, x : x + 48] = 255
    changed = CONDITIONS["absent"].apply(marked, (x, y, 48, 48), 1, np.random.default_rng(0))
    assert marked.max() == 255 and changed.max() == 0


# --- what the study asks of them -----------------------------------------------------------------------


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_condition_acts_at_its_moment_and_not_at_the_clean_level(name, picture):
    condition = CONDITIONS[name]
    assert condition.clean in condition.levels and condition.clean in condition.few_levels
    assert set(condition.few_levels) <= set(condition.levels) == set(sorted(condition.levels))
    worst = next(level for level in condition.levels if level != condition.clean)
    acts = {}
    for moment in ("scene", "light", "file"):
        rng = np.random.default_rng(0)
        assert condition.degrade(moment, picture, BOX, condition.clean, rng) is picture
        acts[moment] = condition.degrade(moment, picture, BOX, worst, rng) is not picture
    assert acts == {m: m == condition.moment and condition.level_is is None for m in acts}


def test_where_conditions_can_be_tried():
    assert [name for name, c in CONDITIONS.items() if not c.suits(48, filmed=False)] == ["time"]
    assert [name for name, c in CONDITIONS.items() if not c.suits(24, filmed=True)] == ["side"]


def test_what_else_a_level_stands_for():
    assert [name for name, c in CONDITIONS.items() if c.side(32, 48) == 32] == ["side"]
    assert [name for name, c in CONDITIONS.items() if c.delay(8) == 8] == ["time"]
    assert all(c.delay(8) == 0 for name, c in CONDITIONS.items() if name != "time")


def test_how_conditions_are_judged():
    groups = {title: [n for n, c in CONDITIONS.items() if c.group == title] for title in (CHANGING_LIGHT, None)}
    assert groups == {CHANGING_LIGHT: ["gain", "offset", "gradient"], None: ["time", "absent"]}
    assert [name for name, c in CONDITIONS.items() if c.removes_target] == ["absent"]
    assert [name for name, c in CONDITIONS.items() if c.worst_first] == ["jpeg"]
    assert [name for name, c in CONDITIONS.items() if not c.is_undisturbed(c.clean)] == ["clutter", "side"]
    assert not CONDITIONS["noise"].is_undisturbed(10)


def test_a_new_condition_is_one_entry(monkeypatch):
    """Tried, summarised, drawn and counted among the verdicts, though nothing else knows its name."""
    negative = Condition(
        "negative", "share", 1, (0, 0.5, 1), "how much of the contrast is left, from its negative to itself",
        lambda image, box, level, rng: conditions._bytes((1 - level) * (255.0 - image) + level * image),
        moment="file", group=CHANGING_LIGHT,
    )  # fmt: skip
    monkeypatch.setitem(CONDITIONS, "negative", negative)
    small = work.batches("fast", seeds=[0, 1], sources=["coins"], conditions=["negative", "blur"])
    table = work.run(small, ["ssd", "zncc"], progress=False)
    recall = tables.summarise(table).set_index(["condition", "level", "method"])["recall"]
    assert recall["negative", 1, "ssd"] == 1 and recall["negative", 0, "ssd"] == 0
    told = tables.verdicts(table).set_index("condition")
    assert told.loc[CHANGING_LIGHT, "ssd"] == told.loc["negative", "ssd"] < 1
    assert told.loc[CONSTANT_LIGHT, "ssd"] == told.loc["blur", "ssd"]
    panel = charts.level_curves(tables.summarise(table)).axes[0]
    assert (panel.get_title(), panel.get_xlabel()) == ("negative", "share")
    assert [text.get_text() for text in panel.get_xticklabels()] == ["1", "0.5", "0"]  # worse to the right


def test_a_new_condition_that_removes_the_target(monkeypatch):
    white = Condition(
        "white", "yes or no", 0, (0, 1), "nothing but white", lambda image, box, level, rng: np.full_like(image, 255),
        removes_target=True, group=None,
    )  # fmt: skip
    monkeypatch.setitem(CONDITIONS, "white", white)
    table = work.run(
        work.batches("fast", seeds=[0, 1], sources=["coins"], conditions=["white"]), ["zncc"], progress=False
    )
    assert table["present"].tolist() == [True, False, True, False]
    told = tables.verdicts(table).set_index("condition")
    assert told.loc["white", "criterion"] == "specificity" and told.loc["white", "zncc"] == 1
    assert list(told.index) == ["white"]
