"""Cost of ``Pipeline.process`` as a ratio to the bare OpenCV calls, measured in one run on one thread.

Run with ``make bench``. Not a test: timings belong to a machine, ratios to a table.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import count

import cv2
import numpy as np
import pandas as pd

from occlib.pipeline import PROFILES, Pipeline, backgrounds_of
from occlib.recordings import open_recording


def median_ms(*functions: Callable[[], object], repeats: int = 300) -> list[float]:
    """Median time of a call of each function in ms; they take turns, so that a busy machine slows them alike."""
    times = np.empty((repeats, len(functions)))
    for row in times:
        for i, function in enumerate(functions):
            start = time.perf_counter()
            function()
            row[i] = time.perf_counter() - start
    return [float(t) for t in np.median(times[repeats // 10 :], axis=0) * 1e3]


def main() -> None:
    """Print the table."""
    cv2.setNumThreads(1)
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
    print(f"one VGA pair to a {nx} x {ny} map, one thread, OpenCV {cv2.__version__}")
    print(table.round(2).to_string())


if __name__ == "__main__":
    main()
