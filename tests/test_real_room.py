"""A real room, ``ufes-lab``, whose background is learned once for all of these tests, which takes 20 s."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from helpers.covers import PATTERNED, covers, hide, lit
from occlib import formats, metrics
from occlib.foreground.background import Background
from occlib.foreground.health import CameraMonitor
from occlib.pipeline import Pipeline, backgrounds_of, settings_for
from occlib.recordings import open_recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def real_room(shared_data: Callable[[str], Path]) -> dict[str, Background]:
    """The backgrounds of ``ufes-lab``, learned for each of its four cameras from frames that are never empty."""
    return backgrounds_of(open_recording(shared_data("ufes-lab")))


FLOOR_WINDOWS = [  # camera, x, y, width, height, samples of 60 in which the place was seen to be empty
    ("cam1", 355, 285, 70, 90, [2, 3, 4, 5, 6, 7, 8]),
    ("cam1", 560, 300, 120, 100, [3, 4, 5, 6, 7, 8, 9]),
    ("cam2", 570, 330, 80, 200, [3, 4, 5, 6, 7, 8]),
    ("cam2", 800, 420, 120, 100, [10, 11, 12, 13, 15, 16, 17]),
    ("cam3", 885, 330, 60, 60, [0, 38, 39, 40, 52, 57]),
    ("cam3", 560, 300, 120, 100, [2, 3, 4, 5, 9, 10, 11, 12]),
]


def test_ufes_lab_nobody_stands_on_the_learned_floor(
    shared_data: Callable[[str], Path], real_room: dict[str, Background]
) -> None:
    pictures = open_recording(shared_data("ufes-lab"), ["cam1", "cam2", "cam3"]).sample(60)
    ghosts = 0
    for camera, x, y, width, height, samples in FLOOR_WINDOWS:
        window = np.s_[y : y + height, x : x + width]
        empty = cv2.blur(np.median([pictures[camera][k][window] for k in samples], axis=0), (5, 5))
        error = np.abs(cv2.blur(real_room[camera].image[window], (5, 5)) - empty).max(axis=2)
        assert np.percentile(error, 99) < 12 and error.mean() < 6, (camera, x, y)
        plain = np.median([frame[window] for frame in pictures[camera]], axis=0)
        ghosts += np.percentile(np.abs(cv2.blur(plain, (5, 5)) - empty).max(axis=2), 99) > 30
    assert ghosts >= 2  # in the plain median, people do


def test_a_real_room(shared_data: Callable[[str], Path], real_room: dict[str, Background]) -> None:
    recording = open_recording(shared_data("ufes-lab"))
    monitor, rng = CameraMonitor(real_room), np.random.default_rng(13)
    for frame, images in recording.images():
        assert monitor.check(images) == {}, frame
        if frame == 100:
            busy = {name: image.copy() for name, image in images.items()}
    for name, image in busy.items():
        one = CameraMonitor({name: real_room[name]})
        for gain, offset in ((0.6, -30), (0.6, 30), (1.5, -30), (1.5, 30)):
            assert one.check({name: lit(image, gain, offset)}) == {}, (name, gain, offset)
        for kind, cover in covers(image.shape, rng).items():
            assert one.check({name: cover})[name] == ("black" if kind == "cap" else "covered")
            halves = [one.check({name: hidden}) for hidden in hide(image, cover, 0.5)]
            assert all(told in ({}, {name: "light"}) for told in halves), (name, kind, halves)  # strange light, at most
            assert kind in PATTERNED or all(one.check({name: hidden}) for hidden in hide(image, cover, 0.9))


UFES = {
    ("cam2", "cam3"): ("cam2+cam3", "cam2+cam3 wide"),
    ("cam1", "cam2"): ("cam1+cam2",),
    ("cam1", "cam3"): ("cam1+cam3",),
    ("cam1", "cam2", "cam3"): ("cam1+cam2+cam3",),
}
"""The cameras of the table in the results, and the regions that they are scored in."""


@pytest.mark.parametrize("cameras", UFES, ids="+".join)
def test_ufes_lab_two_people_in_a_real_room(
    shared_data: Callable[[str], Path], real_room: dict[str, Background], cameras: tuple[str, ...]
) -> None:
    recording = open_recording(shared_data("ufes-lab"), cameras)
    truth = formats.load_truth(recording.path / "truth.json")
    backgrounds, frames = {name: real_room[name] for name in cameras}, range(20, 149)
    pipelines = {
        name: Pipeline(recording.rig, backgrounds, settings_for(name)) for name in ("paper", "and", "recommended")
    }
    detections: dict[str, dict[int, Any]] = {name: {} for name in pipelines}
    for frame, images in recording.images(frames):
        for name, pipeline in pipelines.items():
            result = pipeline.process(images, recording.time(frame))
            detections[name][frame] = result.objects
    truth = truth.select(frames)
    results = (Path(__file__).parents[1] / "docs/results.md").read_text(encoding="utf-8")
    moda, error = {}, {}
    for roi in UFES[cameras]:
        scores = {name: metrics.evaluate(detections[name], truth, roi=roi, radius=0.5) for name in pipelines}
        moda[roi], error[roi] = scores["recommended"].moda or 0.0, scores["recommended"].error_median_m or 1.0
        row = [f"{score.moda:.2f}" for score in scores.values()] + [f"{100 * error[roi]:.1f} cm"]
        assert f"| {'+'.join(cameras)} | {roi} | {' | '.join(row)} |" in results
    least = {"cam2+cam3": 0.97, "cam2+cam3 wide": 0.90, "cam1+cam2": 0.95, "cam1+cam3": 0.97, "cam1+cam2+cam3": 0.95}
    assert all(moda[roi] >= least[roi] for roi in UFES[cameras])
    assert all(error[roi] <= (0.06 if len(cameras) == 2 else 0.05) for roi in UFES[cameras])
    if cameras == ("cam1", "cam2", "cam3"):
        seen = [(f, thing) for f, things in detections["recommended"].items() if f >= 40 for thing in things]
        inside = metrics.inside_polygon([thing.position_m for _, thing in seen], truth.region("cam1+cam2+cam3"))
        assert len({thing.id for (_, thing), there in zip(seen, inside, strict=True) if there}) <= 3  # two people
