"""Chapter 13's functions on a room with exact truth, and the numbers that its verdicts rest on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from occlib.course.ledger import VERDICTS, load_claims, verdict_counts
from occlib.course.lessons import judge_the_paper as judge
from occlib.pipeline import settings_for
from occlib.recordings import Recording, open_recording
from occlib.reproduce import recorded_metrics

ROOT = Path(__file__).resolve().parents[2]
PAPER = settings_for("paper")


@pytest.fixture(scope="module")
def vinyl() -> Recording:
    return open_recording("long_occlusion", ["left", "right"])


@pytest.fixture(scope="module")
def wooden() -> Recording:
    return open_recording("wooden_room", ["left", "right"])


def test_the_papers_chain_keeps_the_hidden_robot_in_one_room_and_loses_it_in_the_other(
    vinyl: Recording, wooden: Recording
) -> None:
    settings = {"paper": PAPER, "and": settings_for("and")}
    friendly = judge.score_room(vinyl, settings, frames=[44, 48, 52])
    assert (friendly[["hidden on the map", "MODA", "found"]] == 1).all(axis=None)
    assert (friendly["ghosts a frame"] == 0).all()
    hard = judge.score_room(wooden, settings, frames=[10, 12, 14])
    assert hard.loc["paper", "hidden on the map"] < 0.5 < hard.loc["and", "hidden on the map"]


def test_template_matching_changes_no_score(wooden: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    frames, settings = range(6, 14), {"paper": PAPER}
    fast = judge.score_room(wooden, settings, frames=frames)
    monkeypatch.setattr(judge, "_without_labels", lambda one: one)
    pd.testing.assert_frame_equal(fast, judge.score_room(wooden, settings, frames=frames))


def test_where_the_mask_is_whole_it_has_the_whole_cabinet(vinyl: Recording, wooden: Recording) -> None:
    cabinet = {"camera": "left", "object_id": "cabinet", "frames": [12]}
    tried = {"paper": PAPER, "everything": settings_for("paper", threshold=0.0)}
    assert judge.mask_shares(vinyl, tried, **cabinet)["paper"] > 0.98
    shares = judge.mask_shares(wooden, tried, **cabinet)
    assert shares["paper"] < 0.2 and shares["everything"] > 0.98


def test_the_lower_the_threshold_the_more_is_covered_and_claimed(wooden: Recording) -> None:
    tried = {level: settings_for("paper", threshold=float(level)) for level in (10, 40, 80)}
    table = judge.sweep_thresholds(wooden, tried, frame=12, object_id="rover")
    assert list(table.index) == [10, 40, 80]
    assert (np.diff(table, axis=0) <= 0).all()
    assert table["hidden robot covered"].iloc[0] == 1 and table["hidden robot covered"].iloc[-1] == 0


def test_a_frame_takes_time(vinyl: Recording) -> None:
    assert 0.5 < judge.frame_time_ms(vinyl, PAPER, frames=[0, 1, 2]) < 5000


def test_conditions_are_recorded_and_decide() -> None:
    table = judge.conditions_table()
    assert len(table) == len(judge.HOLDS_OR_NOT)
    known = recorded_metrics(ROOT)
    assert all(good in known and bad in known for _, _, good, _, bad in judge.HOLDS_OR_NOT)
    worse = np.where(table["measured"] == "ghosts a frame", -1, 1) * (table["value"] - table["value there"])
    assert (worse > 0.1).all()


def test_the_bars_are_the_counts_and_every_letter_is_legible() -> None:
    counts = verdict_counts(load_claims(root=ROOT))
    fig = judge.verdict_figure({"kind": counts})
    (ax,) = fig.axes
    widths = pd.Series([bar.get_width() for bar in ax.patches])
    assert widths.sum() == counts.to_numpy().sum() and len(widths) == counts.size
    assert [text.get_text() for text in fig.legends[0].get_texts()] == list(VERDICTS)
    assert min(text.get_fontsize() for text in [*ax.texts, *ax.get_yticklabels()]) >= 10


def test_the_rooms_are_drawn(vinyl: Recording, wooden: Recording) -> None:
    fig = judge.rooms_figure({"vinyl": (vinyl, 48), "wood": (wooden, 12)}, PAPER)
    titles = [ax.get_title() for ax in fig.axes]
    assert titles[0] == "vinyl: left view" and titles[4] == "wood: left view" and len(titles) == 8
