"""A case run with each method and scored: one row for each method and region."""

from __future__ import annotations

import datetime
import os
import platform
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import Image, Mask
from occlib.base.extras import pandas as pd
from occlib.foreground import Background, average_background
from occlib.formats import DetectedObject, TrueObject, Truth, load_truth
from occlib.geometry import Floor, Rig
from occlib.mapping import FREE, MapData
from occlib.metrics import evaluate, evaluate_identity
from occlib.metrics.detections import Pair, matched_frames
from occlib.pipeline import FrameResult, Pipeline, Settings, backgrounds_of, settings_for
from occlib.recordings import Recording, open_recording
from occlib.study.rooms.cases import RADIUS_M, Case, facts
from occlib.study.rooms.lighting import LIGHTS
from occlib.tracking import ObjectVector

POINT_M = 0.05
"""Truth without a footprint stands on the cells within so much of its point: about what hand-marked truth is good to."""


@dataclass(frozen=True)
class Method:
    """A way to find objects, by name: a profile, or a profile with another rule."""

    name: str
    settings: Settings


def methods_of(profiles: Iterable[str] = ("paper", "and", "recommended"), rules: Iterable[str] = ()) -> list[Method]:
    """The profiles, then the profile ``and`` with each of the rules.

    >>> [method.name for method in methods_of(["and"], ["most"])]
    ['and', 'most']
    """
    own = [Method(name, settings_for(name)) for name in profiles]
    return own + [Method(rule, settings_for("and", rule=rule)) for rule in rules]


def run_case(case: Case, methods: Sequence[Method] = ()) -> pd.DataFrame:
    """Run a case with each method; a row for each method and region.

    Parameters
    ----------
    case
        What to run.
    methods
        By default all profiles.

    Returns
    -------
    DataFrame
        ``recording, kind, cameras, views, region, light, method``; ``moda`` to ``error_cm`` and ``switches`` as
        :func:`occlib.metrics.evaluate` has them; ``mislabelled``, matches under an id that belongs to another true object most of the
        time; ``free_under``, matched objects under which (:data:`POINT_M`) a cell is free on the map; ``iou``, the median overlap of
        their cells with the true footprints; ``outside``, objects beside the floor, of all frames; ``excluded``, (frame, camera) that were
        left out; ``ms``, the median CPU time of ``Pipeline.process``, one thread; ``peak``, its largest over its median, without the first frame;
        ``truth``, true objects; ``by_kind``, found and true objects for each label; ``worst_frame``; facts of the room; date and machine.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        recording = open_recording(case.path, case.cameras)
        truth = load_truth(recording.path / "truth.json")
        backgrounds = _backgrounds(recording, case.light)
        chosen = methods or methods_of()
        pipelines = [Pipeline(recording.rig, backgrounds, method.settings) for method in chosen]
        runs = [_Run(recording.rig) for _ in chosen]
        for frame, images in _frames(recording, case):
            for pipeline, run in zip(pipelines, runs, strict=True):
                run.add(frame, pipeline, images, recording.time(frame))
        truth = truth.select(runs[0].seen)
        rows = [
            {**_about(case, region), "method": method.name, **run.scores(truth, region, RADIUS_M[case.kind])}
            for method, run in zip(chosen, runs, strict=True)
            for region in case.regions
        ]
    finally:
        cv2.setNumThreads(threads)
    known = {**facts(case), "date": datetime.date.today().isoformat(), "machine": machine()}
    return pd.DataFrame([{**row, **known} for row in rows])


def machine() -> str:
    """Cores, and the versions that a result may depend on."""
    return f"{os.cpu_count()} cores, Python {platform.python_version()}, OpenCV {cv2.__version__}"


def worst_instant(
    case: Case, method: Method, frame: int
) -> tuple[Recording, Mapping[str, Image | None], FrameResult, list[TrueObject]]:
    """A case run up to a frame: recording, pictures, result and truth of that frame."""
    recording = open_recording(case.path, case.cameras)
    pipeline = Pipeline(recording.rig, _backgrounds(recording, case.light), method.settings)
    for each, images in _frames(recording, case):
        result = pipeline.process(images, recording.time(each))
        if each == frame:
            return recording, images, result, load_truth(recording.path / "truth.json").frames.get(frame, [])
    raise ValueError(f"frame: {frame} is not among those of {case.key}")


# --- pictures and backgrounds ---------------------------------------------------------------------------
def _frames(recording: Recording, case: Case) -> Iterable[tuple[int, dict[str, Image | None]]]:
    """The frames of a case, a picture or None for each camera, in its light."""
    light = LIGHTS.get(case.light)
    change = light.change if light and light.moment == "frames" else None
    there = set(recording.frames)
    for frame, images in recording.images([f for f in case.frames or recording.frames if f in there]):
        shown: dict[str, Image | None] = {name: images.get(name) for name in recording.rig.cameras}
        if change:
            shown = {n: None if im is None else change(im, recording.rig[n]) for n, im in shown.items()}
        yield frame, shown


def _backgrounds(recording: Recording, light: str) -> Mapping[str, Background]:
    """The backgrounds of a recording, changed if the light is one of the background."""
    about = LIGHTS.get(light)
    if about is None or about.moment == "frames":
        if recording.without_background:
            return {name: _learned(recording.path, name) for name in recording.sources}
        return backgrounds_of(recording)
    if about.change is None:
        _, images = next(recording.images(recording.frames[:1]))
        return {name: average_background([image]) for name, image in images.items()}
    return {
        name: average_background([about.change(image, recording.rig[name]) for image in images])
        for name, images in recording.background_images().items()
    }


@lru_cache(maxsize=16)
def _learned(path: Path, camera: str) -> Background:
    """A camera's background, learned once for all cases of a process: for ufes-lab it takes longer than a case."""
    return backgrounds_of(open_recording(path, [camera]))[camera]


# --- scores ---------------------------------------------------------------------------------------------
def _about(case: Case, region: str | None) -> dict[str, Any]:
    return {
        "recording": case.name,
        "kind": case.kind,
        "cameras": "+".join(case.cameras),
        "views": len(case.cameras),
        "region": region or "",
        "light": case.light,
    }


@dataclass(frozen=True)
class _Seen:
    """What is kept of a frame's result; the rest would fill the memory."""

    objects: list[ObjectVector]
    labels: npt.NDArray[np.int16]
    map: MapData
    excluded: int


@dataclass(frozen=True)
class _Matched:
    """A frame of the truth in a region: what was found there, what is there, and their pairs."""

    frame: int
    found: list[Any]
    true: list[TrueObject]
    pairs: list[Pair]

    @property
    def wrong(self) -> int:
        return len(self.found) + len(self.true) - 2 * len(self.pairs)


class _Run:
    """What one method made of the frames, and what it cost."""

    def __init__(self, rig: Rig) -> None:
        self.floor = rig.floor
        self.seen: dict[int, _Seen] = {}
        self._ms: list[float] = []

    def add(self, frame: int, pipeline: Pipeline, images: Mapping[str, Image | None], at: float) -> None:
        start = time.process_time()  # a busy machine counts less than by the clock
        result = pipeline.process(images, at)
        self._ms.append(1000 * (time.process_time() - start))
        self.seen[frame] = _Seen(result.objects, result.labels.astype(np.int16), result.map.data, len(result.excluded))

    def scores(self, truth: Truth, region: str | None, radius: float) -> dict[str, Any]:
        """The columns of a row that depend on the method."""
        objects = {frame: seen.objects for frame, seen in self.seen.items()}
        score = evaluate(objects, truth, roi=region, radius=radius)
        each_frame = zip(sorted(truth.frames), matched_frames(objects, truth, region, radius), strict=True)
        matched = [_Matched(frame, found, true, pairs) for frame, (found, true, pairs) in each_frame]
        ms = self._ms[1:] or self._ms  # the first call compiles
        on_floor = [self.floor.contains(o.position_m) for seen in self.seen.values() for o in seen.objects]
        return {
            "moda": _digits(score.moda, 4),
            "precision": _digits(score.precision, 4),
            "recall": _digits(score.recall, 4),
            "ghosts": _digits(score.ghosts_per_frame, 4),
            "error_cm": _digits(None if score.error_median_m is None else 100 * score.error_median_m, 2),
            "switches": score.id_switches,
            "mislabelled": _mislabelled(matched, radius),
            **self._on_map(matched),
            "outside": on_floor.count(False),
            "excluded": sum(seen.excluded for seen in self.seen.values()),
            "ms": _digits(float(np.median(ms)), 1),
            "peak": _digits(max(ms) / max(float(np.median(ms)), 1e-9), 1),
            "frames": len(self.seen),
            "truth": score.truth_count,
            "by_kind": _by_kind(matched),
            "worst_frame": max(matched, key=lambda each: (each.wrong, each.frame)).frame,  # late: tracks are confirmed
        }

    def _on_map(self, matched: Sequence[_Matched]) -> dict[str, Any]:
        """What the map says where the matched objects truly are."""
        free_under, overlaps = 0, []
        for each in matched:
            for i, j, _ in each.pairs:
                seen, true = self.seen[each.frame], each.true[j]
                under = _cells_under(true, self.floor)
                free_under += bool((seen.map[under] == FREE).any())
                if true.footprint is not None and under.any():
                    index = next(k for k, thing in enumerate(seen.objects) if thing is each.found[i])
                    region = seen.labels == index + 1
                    overlaps.append(float((region & under).sum() / (region | under).sum()))
        return {"free_under": free_under, "iou": _digits(float(np.median(overlaps)) if overlaps else None, 3)}


def _cells_under(true: TrueObject, floor: Floor) -> Mask:
    if true.footprint is not None:
        return floor.polygon_mask(true.footprint)
    away = np.linalg.norm(floor.cell_centres_m() - [true.x, true.y], axis=1)
    return np.asarray(away.reshape(floor.shape) <= POINT_M)


def _mislabelled(matched: Sequence[_Matched], radius: float) -> int | None:
    """Matches under the id of another; None where the truth has no ids."""
    if any(true.id is None for each in matched for true in each.true):
        return None
    named = {e.frame: [DetectedObject(x=o.x, y=o.y, label=f"{o.id}") for o in e.found] for e in matched}
    return evaluate_identity(named, Truth({each.frame: each.true for each in matched}), radius=radius).wrong


def _by_kind(matched: Sequence[_Matched]) -> str:
    """Found and true objects by label, ``carton 8/10; cone 10/10``; empty without labels."""
    there = Counter(true.label for each in matched for true in each.true if true.label)
    seen = Counter(each.true[j].label for each in matched for _, j, _ in each.pairs)
    return "; ".join(f"{label} {seen[label]}/{count}" for label, count in sorted(there.items()))


def _digits(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
