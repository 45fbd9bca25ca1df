"""Tables of the study: accuracy, thresholds, areas and verdicts, by hand and on real trials."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from occlib.base import intervals
from occlib.study import tables
from occlib.study import work as work_module


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


def test_a_verdict_tells_the_best_from_what_is_tied_and_from_what_is_worse():
    places = pd.MultiIndex.from_product([["coins"], range(4)], names=["source", "seed"])
    near, far = [0.8, 1.0, 0.9, 0.9], [0.1, 0.2, 0.1, 0.2]
    values = pd.DataFrame({"zncc": [0.9] * 4, "ssd": near, "mine": near, "sad": far, "ncc": far}, index=places)
    values["zncc"] += 0.01
    verdict = tables._verdict("noise", values)
    assert verdict["statement"] == "zncc best; ssd and mine cannot be told from it; sad and ncc worse"
    assert verdict["tied"] == "ssd, mine"
    three = tables._verdict("noise", values[["zncc", "ssd", "mine"]])["statement"]
    assert three == "zncc best; ssd and mine cannot be told from it"
    assert tables._verdict("noise", values[["zncc", "ssd", "mine"]].assign(own=near))["statement"].startswith(
        "zncc best; ssd, mine and own cannot"
    )


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


@pytest.mark.slow
def test_a_situation_is_the_mean_of_its_conditions(light):
    table = tables.verdicts_of(light, {"one": ["offset"], "all": ["offset", "noise"]}).set_index("situation")
    alone = tables.verdicts(light).set_index("condition")
    assert table.loc["one", ["best", "tied", "area"]].equals(alone.loc["offset", ["best", "tied", "area"]])
    both = (alone.loc["offset", "ssd"] + alone.loc["noise", "ssd"]) / 2
    assert table.loc["all", "ssd"] == pytest.approx(both)
