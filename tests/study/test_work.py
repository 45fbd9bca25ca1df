"""Batches: which there are, and that their numbers depend on nothing else; and the sweep that writes them."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest

from occlib.formats import SweepManifest, convert
from occlib.matching import measures
from occlib.study import sweeps, tables, trials
from occlib.study import work as work_module
from occlib.study.conditions import CONDITIONS

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
        ssd, seen = measures.METHODS["ssd"], set()
        score = lambda *arrays: seen.add(cv2.getNumThreads()) or ssd.score(*arrays)  # noqa: E731
        own = replace(ssd, name="own", score=score)
        table = work_module.run_batch(work_module.batches("fast", **SMALL)[0], [own, "sad"])
        assert cv2.getNumThreads() == 2 and seen == {1}
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


def test_a_sweep_writes_what_it_returns(tmp_path):
    options = {"seeds": [0, 1], "conditions": ["offset", "occlusion", "absent"], "sources": ["coins"]}
    found = sweeps.sweep(tmp_path, "fast", **options, methods=["zncc", "ssd"], progress=False)
    assert found.files == (
        "trials.csv", "summary.csv", "thresholds.csv", "verdicts.csv", "verdicts.png", "recall.png"
    )  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*found.files, "batches", "manifest.json"])
    expected = work_module.run(work_module.batches("fast", **options), ["zncc", "ssd"], progress=False)
    assert (tmp_path / "trials.csv").read_text() == expected.to_csv(index=False, lineterminator="\n")
    pd.testing.assert_frame_equal(found.trials, expected)
    for name, table in (
        ("summary", tables.summarise(expected)), ("thresholds", tables.thresholds(expected)),
        ("verdicts", tables.verdicts(expected)),
    ):  # fmt: skip
        assert (tmp_path / f"{name}.csv").read_text() == table.to_csv(index=False, lineterminator="\n")
        pd.testing.assert_frame_equal(getattr(found, name), table)
    manifest = convert(json.loads((tmp_path / "manifest.json").read_text()), SweepManifest)
    assert manifest.methods == ["zncc", "ssd"] and len(manifest.occlib) == 64 and manifest.recordings == {}


def test_a_sweep_without_a_curve_leaves_no_picture_of_an_earlier_one(tmp_path):
    (tmp_path / "recall.png").write_bytes(b"of an earlier sweep")
    options = {"seeds": [0], "conditions": ["time"], "sources": ["four_robots"], "methods": ["ssd"], "progress": False}
    assert "recall.png" in sweeps.sweep(tmp_path, "fast", **options).files
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(CONDITIONS, "time", replace(CONDITIONS["time"], levels=(0,)))
        assert "recall.png" not in sweeps.sweep(tmp_path, "fast", **options).files
    assert not (tmp_path / "recall.png").exists()


def test_other_levels_of_some_conditions():
    chosen = {"seeds": [0], "sources": ["coins"], "conditions": ["gain", "noise"]}
    (batch,) = work_module.batches("fast", **chosen, levels={"gain": [0.5, 1]})
    assert dict(batch.levels) == {"gain": (0.5, 1), "noise": CONDITIONS["noise"].few_levels}
    with pytest.raises(ValueError, match="levels: expected one of gain"):
        work_module.batches("fast", **chosen, levels={"glare": [1]})
