"""What chapter 04 calls: tables of a small study with a planted answer."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from occlib import study
from occlib.course.lessons import compare_matchers as lesson


@pytest.fixture(scope="module")
def trials() -> pd.DataFrame:
    chosen = ["gain", "noise", "absent"]
    return study.run(study.batches("fast", seeds=[0, 1, 2], sources=["coins"], conditions=chosen), progress=False)


def planted(trials: pd.DataFrame) -> pd.DataFrame:
    """SSD never lost, ZNCC always, but in clean pictures; no false alarm of any but ZNCC."""
    table = trials[trials["method"].isin(["ssd", "zncc"])].copy()
    changed = table["level"] != table["condition"].map({"gain": 1, "noise": 0, "absent": 0})
    table["found"] = (table["method"] == "ssd") | ~changed
    table["default"] = np.where(table["method"] == "ssd", -np.inf, -2.0)
    return table


def test_the_decision_table_names_the_best(trials: pd.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lesson, "SITUATIONS", {"light": ("gain",), "empty": ("absent",), "both": ("gain", "noise")})
    table = lesson.decision_table(planted(trials))
    assert table["use"].tolist() == ["ssd"] * 3 and table["or"].tolist() == ["none"] * 3
    assert table.loc["light", "ssd"] == 1 and table.loc["empty", "zncc"] == 0 and table.loc["light", "zncc"] < 0.6


def test_every_condition_has_its_row() -> None:
    table = lesson.condition_table()
    assert list(table.index) == list(study.CONDITIONS)
    assert table["what happens"].str.len().max() <= 50  # pandas cuts what is longer
    members = [name for names in lesson.SITUATIONS.values() for name in names]
    assert set(members) == set(study.CONDITIONS) - {"time"} and len(members) == len(set(members))


def test_best_places_agree_with_the_study(trials: pd.DataFrame) -> None:
    trial = study.make_trial("coins", 1, "gain", 0.4)
    places = lesson.best_places(trial, 5.0)
    rows = trials.query("condition == 'gain' and level == 0.4 and seed == 1").set_index("method")
    assert (places.loc[rows.index, "found"] == rows["found"]).all()
    assert np.allclose(places.loc[rows.index, "error_px"].astype(float), rows["error_px"])
    found = places[places["found"].astype(bool)]
    assert len(found) and np.allclose(found[["x", "y"]].astype(float), trial.corner, atol=5)


def test_failures_of_thresholds(trials: pd.DataFrame) -> None:
    table = lesson.threshold_failures(planted(trials))
    accepted, alarms = (table.loc[name] for name in table.index.unique(0))
    assert accepted.loc["default", "ssd"] == 0 < accepted.loc["default", "zncc"]
    assert alarms.loc["default", "ssd"] == 0 and alarms.loc["default", "zncc"] > 4


def test_the_best_f1_of_each_group(trials: pd.DataFrame) -> None:
    curves = lesson.grouped_curves(trials)
    table = lesson.best_f1(curves)
    assert set(table.index) == {"light", "picture quality", "scene"}
    assert list(table.columns) == list(trials["method"].unique())
    part = curves[(curves["group"] == "light") & (curves["method"] == "zncc")]
    assert table.loc["light", "zncc"] == part["f1"].max() > table.loc["light", "ssd"]


def test_the_claim_is_a_paired_difference() -> None:
    sources = ["coins", "robot"]
    work = study.batches("fast", seeds=[0, 1], sources=sources, conditions=["gain", "blur"])
    trials = study.run(work, ["ssd", "sad", "zncc"], progress=False)
    trials = pd.concat([trials, trials[trials["method"] == "zncc"].assign(method="direction")], ignore_index=True)
    table = lesson.claim_table(trials)
    assert table.loc[("changing light", "ssd - zncc")].equals(table.loc[("changing light", "ssd - direction")])
    halves = table.loc["changing light"].loc[["ssd - zncc, photographs", "ssd - zncc, robots"], "difference"]
    assert halves.mean() == pytest.approx(table.loc[("changing light", "ssd - zncc"), "difference"])
    assert (table["low"] <= table["difference"]).all() and (table["difference"] <= table["high"]).all()
