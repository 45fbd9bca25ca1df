"""Cost of ``Pipeline.process`` as ratios, each measured in one run on one thread: to the bare OpenCV calls, of the
recommended rule to AND, and of eight cameras to two.

Run with ``make bench``. Not a test: timings belong to a machine, ratios to a table.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count, cycle
from typing import Any

import cv2
import numpy as np
import pandas as pd

from occlib.lab.crowds import wall_rig
from occlib.lab.scenes import load_scene
from occlib.lab.truth import silhouettes
from occlib.pipeline import PROFILES, Pipeline, backgrounds_of, settings_for
from occlib.recordings import open_recording

FRAMES = range(40, 64)
"""Of four_robots: all four drive, some hidden, played forwards and backwards so that nothing jumps."""
GREY = 170

Images = Mapping[str, Any]


def median_ms(*functions: Callable[[], object], repeats: int = 300) -> list[float]:
    """Median time of a call of each function in ms; they take turns, so that a busy machine slows them alike."""
    times = np.empty((repeats, len(functions)))
    for row in times:
        for i, function in enumerate(functions):
            start = time.perf_counter()
            function()
            row[i] = time.perf_counter() - start
    return [float(t) for t in np.median(times[repeats // 10 :], axis=0) * 1e3]


def playing(pipeline: Pipeline, instants: Sequence[Images]) -> Callable[[], object]:
    """Calls that process a sequence's instants one after the other, there and back, at 10 a second."""
    clock, shown = count(), cycle(chain(instants, instants[-2:0:-1]))
    return lambda: pipeline.process(next(shown), next(clock) / 10)


def against_opencv() -> None:
    """Both profiles against the bare calls, for one VGA pair."""
    recording = open_recording("ball_and_oval", ["left", "right"])
    backgrounds = backgrounds_of(recording)
    _, images = next(recording.images())
    to_cells = np.linalg.inv(recording.rig.floor.cell_to_floor)
    homographies = {name: to_cells @ camera.image_to_floor for name, camera in recording.rig.cameras.items()}
    ny, nx = recording.rig.floor.shape

    def bare() -> object:
        masks = []
        for name, image in images.items():
            difference = cv2.absdiff(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), backgrounds[name].grey)
            mask = cv2.threshold(cv2.GaussianBlur(difference, (5, 5), 0), 0, 255, cv2.THRESH_OTSU)[1]
            masks.append(cv2.warpPerspective(mask, homographies[name], (nx, ny)))
        return cv2.connectedComponentsWithStats(cv2.bitwise_and(*masks))

    clock = count()
    pipelines = [Pipeline(recording.rig, backgrounds, settings) for settings in PROFILES.values()]
    calls = [lambda p=pipeline: p.process(images, next(clock) / 10) for pipeline in pipelines]  # type: ignore[misc]
    reference, *whole = median_ms(bare, *calls)
    table = pd.DataFrame({"pipeline (ms)": whole, "bare OpenCV (ms)": reference}, index=list(PROFILES))
    table["ratio"] = table["pipeline (ms)"] / table["bare OpenCV (ms)"]
    print(f"One VGA pair to a {nx} x {ny} map, one thread, OpenCV {cv2.__version__}")
    print(table.round(2).to_string())


def rules() -> None:
    """The recommended profile against the same with AND, for a VGA pair over a sequence of four robots."""
    recording = open_recording("four_robots", ["left", "right"])
    backgrounds = backgrounds_of(recording)
    instants = [images for _, images in recording.images(FRAMES)]
    best = PROFILES["recommended"].finder.rule
    pipelines = [Pipeline(recording.rig, backgrounds, settings_for(rule=rule)) for rule in (best, "and")]
    times = median_ms(*(playing(pipeline, instants) for pipeline in pipelines), repeats=150)
    table = pd.DataFrame({"pipeline (ms)": times}, index=[f"rule {best}", "rule and"])
    table["ratio"] = table["pipeline (ms)"] / times[1]
    print(f"\nRecommended profile, a VGA pair over {len(FRAMES)} frames of four_robots")
    print(table.round(2).to_string())


def drawn(names: Sequence[str], frame: int, scene: Any) -> dict[str, Any]:
    """Each camera's exact silhouettes in the robots' colours on a flat floor."""
    images = {name: np.full((480, 640, 3), GREY, np.uint8) for name in names}
    for name, things in silhouettes(scene, frame).items():
        for thing in scene.objects:
            images[name][things[thing.id][1]] = thing.colour
    return images


def cameras() -> None:
    """The recommended profile with eight cameras against two, over a drawn sequence."""
    rig = wall_rig(8)
    scene = replace(load_scene("four_robots"), rig=rig)
    instants = [drawn(list(rig.cameras), frame, scene) for frame in FRAMES[::2]]
    floor = {name: np.full((480, 640, 3), GREY, np.uint8) for name in rig.cameras}
    two = rig.select(list(rig.cameras)[:2])
    pairs = [{name: images[name] for name in two.cameras} for images in instants]
    times = median_ms(playing(Pipeline(two, floor), pairs), playing(Pipeline(rig, floor), instants), repeats=100)
    table = pd.DataFrame({"pipeline (ms)": times}, index=["2 cameras", "8 cameras"])
    table["ratio"] = table["pipeline (ms)"] / times[0]
    ny, nx = rig.floor.shape
    print(f"\nRecommended profile, exact silhouettes of four_robots drawn at VGA, to a {nx} x {ny} map")
    print(table.round(2).to_string())


def main() -> None:
    """Print the tables."""
    cv2.setNumThreads(1)
    against_opencv()
    rules()
    cameras()


if __name__ == "__main__":
    main()
