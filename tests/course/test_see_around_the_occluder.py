"""Tables of chapter 00 on planted results."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from occlib.course.lessons import see_around_the_occluder as lesson
from occlib.formats import TrueObject, Truth
from occlib.geometry import Floor
from occlib.pipeline import Pipeline, backgrounds_of, settings_for
from occlib.recordings import open_recording

FLOOR = Floor((0.0, 2.0), (0.0, 1.0), 0.1)


def box(x: float, identity: str) -> TrueObject:
    """A true box of 0.4 m x 0.2 m with its middle at (x, 0.3)."""
    outline = ((x - 0.2, 0.2), (x + 0.2, 0.2), (x + 0.2, 0.4), (x - 0.2, 0.4))
    return TrueObject(x=x, y=0.3, id=identity, label=identity, footprint=outline, hidden_fraction={"left": 1.0})


def vector(x: float, number: int, label: str | None = None) -> Any:
    return SimpleNamespace(position_m=(x, 0.3), id=number, label=label, x=x, y=0.3)


def test_a_map_is_scored_against_the_footprints() -> None:
    truth = Truth({3: [box(0.4, "a"), box(1.4, "b")]})
    data = np.zeros(FLOOR.shape, np.int8)
    data[FLOOR.polygon_mask(truth.frames[3][0].footprint)] = 100
    data[2:4, 10:14] = 100  # 0.2 m of b is covered, 0.2 m beside it is not b
    result: Any = SimpleNamespace(objects=[vector(0.4, 1, "a"), vector(1.2, 2)], map=SimpleNamespace(data=data))
    row = lesson.score_maps({"planted": result}, truth, 3, FLOOR, radius=0.1).loc["planted"]
    assert row[["objects", "labelled", "found"]].tolist() == [2, 1, 1]
    assert row[["claimed (m2)", "claimed / true", "least coverage"]].tolist() == pytest.approx([0.16, 1.0, 0.5])


def test_recall_counts_what_the_camera_cannot_see() -> None:
    truth = Truth({frame: [box(0.4, "a")] for frame in range(4)})
    objects = {"half": {frame: [vector(0.4, 7 + frame // 2)] if frame % 2 else [] for frame in range(4)}}
    row = lesson.recall_while_hidden(objects, truth, "left", radius=0.1).loc["half"]
    assert row.tolist() == [0.5, 2]


def test_following_keeps_what_it_is_told_to_keep(tiny_recording: Path) -> None:
    recording = open_recording(tiny_recording)
    backgrounds, settings = backgrounds_of(recording), settings_for("and")
    chains = {"left": Pipeline(recording.rig.select(["left"]), backgrounds, settings)}
    chains["both"] = Pipeline(recording.rig, backgrounds, settings)
    frames = recording.frames[:3]
    followed = lesson.follow(recording, chains, frames, keep=frames[1:2])
    assert [list(one) for one in followed.objects.values()] == [list(frames)] * 2
    assert list(followed.images) == list(followed.results) == list(frames[1:2])
    assert set(followed.results[frames[1]].views) == {"left", "right"}


def test_scores_are_recorded_under_the_names_of_rows_and_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OCCLIB_RUN_DIR", str(tmp_path))
    table = pd.DataFrame(
        {"objects": [1, 2], "claimed / true": [2.5, 1.5], "claimed (m2)": [0.1, 0.2]}, index=["l", "r"]
    )
    lesson.record_scores(table, "{column}_{row}")
    kept = {row["metric"]: row["value"] for row in json.loads((tmp_path / "metrics.json").read_text())}
    assert kept == {"objects_l": "1", "objects_r": "2", "claimed_ratio_l": "2.5", "claimed_ratio_r": "1.5"}
