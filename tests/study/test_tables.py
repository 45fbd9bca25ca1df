"""The study: degradations, trials with a known answer, intervals, thresholds, verdicts."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from occlib import geometry, recordings
from occlib.base import intervals
from occlib.lens import Lens
from occlib.matching import measures, search
from occlib.study import tables, trials
from occlib.study import work as work_module
from occlib.study.conditions import CONDITIONS

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


# --- degradations ------------------------------------------------------------------------------------


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


# --- trials ------------------------------------------------------------------------------------------


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
    table = work_module.run_batch(work_module.Batch("ufes-lab", 0, 48, (("time", (0.0, 4.0)),)), ["zncc"])
    assert table["found"].tolist()[0] and table["error_cm"].notna().all()


def test_sources_without_the_real_recording(monkeypatch, tmp_path):
    monkeypatch.setenv("OCCLIB_CACHE", str(tmp_path))
    assert "ufes-lab" not in trials.sources() and set(trials.PHOTOGRAPHS) < set(trials.sources())
    with pytest.raises(ValueError, match="occlib data fetch ufes-lab"):
        work_module.batches(sources=["ufes-lab"])


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


# --- work --------------------------------------------------------------------------------------------

SMALL = {"seeds": [0, 1], "conditions": ["offset", "occlusion", "absent"], "sources": ["coins"]}


@pytest.fixture(scope="module")
def small():
    return work_module.run(work_module.batches("fast", **SMALL), progress=False)


@pytest.mark.slow
def test_same_numbers_in_any_order_and_beside_other_work(small):
    trials._views.cache_clear()
    work = work_module.batches("fast", **SMALL)[::-1]
    again = pd.concat([work_module.run_batch(batch) for batch in work][::-1], ignore_index=True)
    assert again.to_csv() == small.to_csv()
    alone = work_module.run(
        work_module.batches("fast", **{**SMALL, "seeds": [1], "conditions": ["occlusion"]}), ["zncc"], progress=False
    )
    same = small.query("seed == 1 and condition == 'occlusion' and method == 'zncc'")
    assert alone.to_csv(index=False) == same.to_csv(index=False)


def test_threads_and_methods_are_restored(small):
    threads = cv2.getNumThreads()
    cv2.setNumThreads(2)
    before = dict(measures.METHODS)
    try:
        own = measures.Method(**{**vars(measures.METHODS["ssd"]), "name": "own"})
        table = work_module.run_batch(work_module.batches("fast", **SMALL)[0], [own, "sad"])
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(threads)
    assert dict(measures.METHODS) == before and set(table["method"]) == {"own", "sad"}
    columns = ["score", "dx", "wrong_1", "otsu", "default"]
    ours, theirs = table.query("method == 'own'")[columns], small.query("method == 'ssd' and seed == 0")[columns]
    assert ours.to_csv(index=False) == theirs.to_csv(index=False)


def test_a_perfect_and_an_absurd_matcher(monkeypatch):
    """They are told the true place through the trial that is being measured."""
    current = {}
    measured = trials.measured_trial

    def spying(trial, method, tau_px):
        current["trial"] = trial
        return measured(trial, method, tau_px)

    def distance_to(right):
        def score(image, template, weights):
            trial = current["trial"]
            shape = image.shape[0] - template.shape[0] + 1, image.shape[1] - template.shape[1] + 1
            x, y = (-1e3, -1e3) if trial.corner is None else trial.corner
            rows, columns = np.ogrid[: shape[0], : shape[1]]
            distance = np.hypot(columns - x, rows - y)
            return distance if right else -distance

        return score

    monkeypatch.setattr(work_module, "measured_trial", spying)
    base = vars(measures.METHODS["ssd"])
    free = {"bounds": (-np.inf, np.inf), "default_threshold": lambda *_: 3.0}
    oracle, fool = (
        measures.Method(**{**base, **free, "name": n, "score": distance_to(n == "oracle")}) for n in ("oracle", "fool")
    )
    table = work_module.run(work_module.batches("fast", **SMALL), [oracle, fool], progress=False)
    recall = tables.summarise(table, ["method"]).set_index("method")["recall"]
    assert recall.to_dict() == {"oracle": 1, "fool": 0}
    rules = tables.thresholds(table, ["method", "condition"]).set_index(["rule", "method", "condition"])
    assert rules.loc[("default", "oracle", "offset"), "f1"] == 1
    assert rules.loc[("default", "oracle", "absent"), "false_alarms"] == 0
    table["seed"] %= 2
    told = tables.verdicts(table).set_index("condition")
    assert told.loc["offset", "best"] == "oracle" and told.loc["offset", "tied"] == ""
    assert 0 < told.loc["offset", "low"] < told.loc["offset", "high"] == 1


def test_batches_and_keys():
    for preset, count in (("fast", 6), ("default", 6 * 10), ("full", 36 * 10)):
        assert len(work_module.batches(preset)) == count
    work = work_module.batches()
    keys = [batch.key for batch in work]
    assert len(set(keys)) == len(keys) == len(set(work)) and keys == [b.key for b in work_module.batches()]
    assert work_module.batches(tau_px=4)[0].key != keys[0] and all("/" not in key and " " not in key for key in keys)
    levels = dict(work_module.batches(sources=["four_robots"])[0].levels)
    assert levels["time"] == (0, 4, 8, 16, 32) and levels["side"][0] == 16
    assert "time" not in dict(work_module.batches(sources=["coins"])[0].levels)
    assert all(
        condition.clean in condition.levels and condition.clean in condition.few_levels
        for condition in CONDITIONS.values()
    )


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"conditions": ["fog"]}, "condition: expected one of gain, .*, got 'fog'"),
        ({"conditions": []}, "condition: expected at least one of gain"),
        ({"sources": ["lena"]}, "source: expected one of camera, .*, got 'lena'"),
        ({"preset": "huge"}, "preset: expected one of fast, default, full, got 'huge'"),
        ({"seeds": []}, "seeds: expected at least one"),
        ({"seeds": [-1]}, "seeds: expected whole numbers from 0 .* got -1"),
        ({"seeds": [1.5]}, "seeds: .* got 1.5"),
        ({"sides": [200]}, "sides: expected whole numbers from 16 to 128, got 200"),
        ({"tau_px": 0}, "tau_px: expected px > 0, got 0"),
        ({"conditions": ["time"], "sources": ["coins"]}, "conditions: time cannot be tried on coins"),
    ],
)
def test_wrong_arguments_are_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        work_module.batches(**wrong)


def test_wrong_methods_levels_and_tables_are_named(small):
    with pytest.raises(ValueError, match=r"method: expected one of ssd, .*, got 'ssdd'"):
        work_module.run_batch(work_module.batches("fast", **SMALL)[0], ["ssdd"])
    with pytest.raises(ValueError, match="level: expected one of 0 frames for coins, got 8"):
        trials.make_trial("coins", 0, "time", 8)
    with pytest.raises(ValueError, match="work: expected at least one batch"):
        work_module.run([])
    with pytest.raises(ValueError, match=r"by: expected one of source, .*, got 'colour'"):
        tables.summarise(small, ["colour"])
    with pytest.raises(ValueError, match="no row"):
        tables.summarise(small[:0])


def test_runtime_grows_with_the_side():
    table = trials.runtime([16, 128], ["ssd", "sad"], repeats=3)
    assert list(table.columns) == ["side", "method", "median_ms"] and len(table) == 4
    assert (table["median_ms"] > 0).all()


# --- tables ------------------------------------------------------------------------------------------


def table_of(rows):
    """Trials from ``(seed, level, target score or None, wrong score)`` of a distance, at rank 1 where best."""
    full = []
    for seed, level, target, wrong in rows:
        here = target is not None
        row = {"source": "coins", "seed": seed, "side": 48, "tau_px": 5.0, "condition": "noise" if here else "absent"}
        row |= {"level": float(level), "method": "ssd", "higher_is_better": False, "present": here, "optimum": here}
        row |= {"score": wrong, "score_target": target if here else np.nan, "found": here and target <= wrong}
        row |= {
            "error_px": 3.0 if level else 0.0,
            "error_cm": np.nan,
            "peak_ratio": 2.0 + seed,
            "default": 5.0,
            "otsu": 8.0,
        }
        row |= {f"wrong_{i}": wrong if i == 1 else np.nan for i in range(1, 6)} | {"mad": np.nan}
        full.append(row)
    return pd.DataFrame(full)


def test_wilson_interval_by_hand():
    low, high = intervals.wilson_interval([0, 5, 0], [10, 10, 0])
    z2 = 1.959964**2
    assert low[0] == 0 and high[0] == pytest.approx(z2 / (10 + z2))
    assert (low[1] + high[1]) / 2 == pytest.approx(0.5) and high[1] == pytest.approx(0.763, abs=1e-3)
    assert np.isnan(low[2]) and np.isnan(high[2])


def test_t_interval_by_hand():
    assert intervals.t_interval([4.0, 6.0]) == pytest.approx((5, 5 - 12.7062, 5 + 12.7062), rel=1e-4)  # t(1) = 12.706
    mean, low, high = intervals.t_interval([7.0, np.nan])
    assert mean == 7 and np.isnan(low) and np.isnan(high) and np.isnan(intervals.t_interval([])).all()


def test_stratified_interval_ignores_what_differs_between_sources():
    index = pd.MultiIndex.from_product([["a", "b"], [0, 1, 2]], names=["source", "seed"])
    one = intervals.stratified_interval(pd.Series([1, 2, 3, 1, 2, 3.0], index))
    far = intervals.stratified_interval(pd.Series([1, 2, 3, 101, 102, 103.0], index))
    half = 2.776445 * np.sqrt(1 * (1 / 3 + 1 / 3)) / 2  # t(4), variance 1
    assert one == pytest.approx((2, 2 - half, 2 + half)) and far == pytest.approx((52, 52 - half, 52 + half))
    still = 2.776445 * np.sqrt(3 / 6 * 0.05**2 * (1 / 3 + 1 / 3)) / 2  # nothing varies: the rule of three
    assert intervals.stratified_interval(pd.Series([1, 1, 1, 2, 2, 2.0], index)) == pytest.approx(
        (1.5, 1.5 - still, 1.5 + still)
    )
    single = intervals.stratified_interval(pd.Series([1, 2.0], index[[0, 3]]))
    assert single[0] == 1.5 and np.isnan(single[1:]).all()


def test_summary_by_hand():
    table = table_of([(0, 0, 0.0, 9.0), (0, 10, 4.0, 6.0), (1, 10, 7.0, 6.0), (1, 10, 5.0, 6.0), (0, 1, None, 4.0)])
    summary = tables.summarise(table).set_index(["condition", "level"])
    assert set(summary.index) == {("noise", 0.0), ("noise", 10.0)}  # nothing to find when absent
    row = summary.loc[("noise", 10.0)]
    assert row["trials"] == 3 and row["recall"] == pytest.approx(2 / 3)
    assert (row["recall_low"], row["recall_high"]) == pytest.approx(tuple(map(float, intervals.wilson_interval(2, 3))))
    assert row["rmse_px"] == pytest.approx(3) and np.isnan(row["rmse_cm"])
    assert row["peak_ratio"] == 2.5 and row["peak_ratio_high"] == pytest.approx(2.5 + 12.7062 * 0.5, rel=1e-4)


def test_rmse_intervals_are_those_of_logarithms():
    table = table_of([(0, 10, 0.0, 9.0), (1, 10, 0.0, 9.0)]).assign(error_px=[1.0, 4.0])
    row = tables.summarise(table).iloc[0]
    factor = np.exp(12.7062 * np.log(2))  # t(1); the logarithms are log 2 on either side of log 2
    assert row["rmse_px"] == pytest.approx(2)
    assert (row["rmse_px_low"], row["rmse_px_high"]) == pytest.approx((2 / factor, 2 * factor), rel=1e-4)


def test_fixed_threshold_is_tuned_on_clean_trials_only():
    clean = [(0, 0, 1.0, 9.0), (1, 0, 3.0, 20.0), (2, 0, 12.0, 30.0)]
    # Accepting 1 and 3: F1 4/5; accepting 9 too: 4/6; 12 as well: 6/7, the best; the next is 20.
    assert tables.fixed_thresholds(table_of(clean)) == {"ssd": 16}
    assert tables.fixed_thresholds(table_of([*clean, (0, 10, 15.0, 15.5), (0, 1, None, 2.0)])) == {"ssd": 16}
    assert np.isnan(tables.fixed_thresholds(table_of([(0, 10, 1.0, 2.0)]))["ssd"])
    correlation = table_of([(0, 0, -0.9, -0.5)]).assign(higher_is_better=True)
    correlation[["score_target", "wrong_1"]] *= -1
    assert tables.fixed_thresholds(correlation) == {"ssd": pytest.approx(0.7)}


def test_fixed_threshold_leaves_out_what_is_tried_under_noise():
    rows = [(0, 0, 1.0, 9.0), (1, 0, 3.0, 20.0)]
    clutter = table_of([(0, 0, 500.0, 900.0), (1, 0, 700.0, 990.0)]).assign(condition="clutter")
    both = [clutter, table_of(rows)]
    assert tables.fixed_thresholds(pd.concat(both)) == tables.fixed_thresholds(pd.concat(both[::-1])) == {"ssd": 6}


def test_threshold_rules_by_hand():
    table = table_of([(0, 0, 0.0, 6.0), (0, 10, 4.0, 7.0), (1, 10, 6.0, 12.0), (0, 1, None, 4.0)])
    rules = tables.thresholds(table).set_index(["rule", "condition", "level"])
    default = rules.loc[("default", "noise", 10.0)]  # accepts up to 5
    assert (default["recall"], default["precision"], default["false_alarms"]) == (0.5, 1, 0)
    assert default["f1"] == pytest.approx(2 / 3) and default["limit"] == 5
    otsu = rules.loc[("otsu", "noise", 10.0)]  # up to 8: both targets, and the 7
    assert (otsu["recall"], otsu["false_alarms"]) == (1, 0.5) and otsu["f1"] == pytest.approx(4 / 5)
    assert rules.loc[("mad", "noise", 10.0), "recall"] == 0  # NaN accepts nothing
    assert rules.loc[("fixed", "noise", 0.0), "limit"] == 3
    absent = rules.loc[("default", "absent", 1.0)]
    assert absent["false_alarms"] == 1 and np.isnan(absent["recall"]) and np.isnan(absent["f1"])
    hidden = tables.thresholds(table.assign(optimum=False)).set_index(["rule", "condition", "level"])
    assert hidden.loc[("otsu", "noise", 10.0), "recall"] == 0  # the slope of another optimum is no detection


def test_precision_recall_by_hand():
    curve = tables.precision_recall(table_of([(0, 0, 1.0, 3.0), (1, 10, 3.0, 5.0)]))
    assert curve["threshold"].tolist() == [1, 3, 5]
    assert curve["recall"].tolist() == [0.5, 1, 1]
    assert curve["precision"].tolist() == pytest.approx([1, 2 / 3, 0.5])  # equal scores are accepted together


def test_area_is_the_trapezoid_over_the_levels():
    table = table_of([(0, 0, 0.0, 9.0), (0, 10, 0.0, 9.0), (0, 40, 9.9, 9.0), (0, 1, None, 4.0), (0, 1, None, 6.0)])
    area = tables.areas(table).set_index("condition")["area"]
    assert area["noise"] == pytest.approx((10 * 1 + 30 * 0.5) / 40)
    assert area["absent"] == 0.5  # one of two empty pictures is beyond the default threshold of 5


# --- conclusions -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def light():
    work = work_module.batches(seeds=[0, 1, 2], conditions=["offset", "noise"], sources=["camera", "coins", "chelsea"])
    return work_module.run(work, ["ssd", "zncc"], progress=False)


@pytest.mark.slow
def test_zncc_stands_a_change_of_light_and_ssd_does_not(light):
    recall = tables.summarise(light).set_index(["condition", "method", "level"])["recall"].sort_index()
    assert recall["offset", "zncc"].loc[[-20, 20]].min() == 1 and recall["offset", "ssd"].loc[[-80, 80]].max() < 0.7
    clean = light.query("level == 0")["error_px"]
    assert (clean < 0.5).all() and clean.median() < 0.15  # refined below the pixel
    told = tables.verdicts(light).set_index("condition")
    assert told.loc["offset", "best"] == "zncc" and told.loc["offset", "tied"] == ""
    claim = told.loc["claim: ssd is reliable at constant light"]
    assert claim["low"] > 0 and "less reliable" in claim["statement"]
    assert claim["area"] == pytest.approx(told.loc["constant light", "ssd"] - told.loc["changing light", "ssd"])


@pytest.mark.slow
def test_a_fixed_threshold_fails_for_ssd_where_otsu_does_not(light):
    rules = tables.thresholds(light).set_index(["condition", "method", "level", "rule"])["recall"]
    assert rules["noise", "ssd", 40.0, "fixed"] < 0.2 < 0.9 < rules["noise", "ssd", 40.0, "otsu"]


def test_recordings_are_found_from_any_directory(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert isinstance(recordings.open_recording("robot"), recordings.Recording) and Path.cwd() == tmp_path
