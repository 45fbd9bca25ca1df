"""Cost of the similarity measures as ratios to OpenCV's calls, measured in one run on one thread.

Run with ``make bench``, which also writes the table to ``runs/bench_matching.csv``. Not a test: timings belong to a
machine, ratios to a table.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd
from bench_pipeline import median_ms
from skimage.feature import match_template

from occlib.base.files import write_file
from occlib.foreground.intensity import to_grey
from occlib.matching.measures import METHODS
from occlib.matching.search import find, similarity
from occlib.recordings import open_recording
from occlib.reproduce.runner import find_root

Array = npt.NDArray[Any]
SIDE = 64


def edge_distance(image: Array, template: Array) -> Array:
    """Mean SED by bare calls: edges, exact distance transform, one correlation."""
    edges = cv2.Canny(image, 40, 40)
    distance = cv2.distanceTransform(255 - edges, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    mask = (cv2.Canny(template, 100, 100) > 0).astype(np.float32)
    return np.asarray(cv2.matchTemplate(distance * distance, mask, cv2.TM_CCORR))


def peak_memory(function: Callable[[], object]) -> int:
    """Bytes in use at the worst moment of a call, beyond those before it; OpenCV's arrays are numpy's here."""
    function()
    tracemalloc.start()
    function()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def main() -> None:
    """Print the table and write it."""
    cv2.setNumThreads(1)
    recording = open_recording("robot", ["left"])
    image = to_grey(next(recording.images())[1]["left"])
    corner = np.s_[150 : 150 + SIDE, 290 : 290 + SIDE]
    template = np.ascontiguousarray(image[corner])
    disc = np.hypot(*np.ogrid[-1 : 1 : SIDE * 1j, -1 : 1 : SIDE * 1j]) < 1  # type: ignore[misc]
    weights = np.random.default_rng(0).random(disc.shape) * disc
    calls: dict[str, Callable[[], object]] = {
        "TM_SQDIFF": lambda: cv2.matchTemplate(image, template, cv2.TM_SQDIFF),
        "TM_CCORR_NORMED": lambda: cv2.matchTemplate(image, template, cv2.TM_CCORR_NORMED),
        "TM_CCOEFF_NORMED": lambda: cv2.matchTemplate(image, template, cv2.TM_CCOEFF_NORMED),
        "distance + TM_CCORR": lambda: edge_distance(image, template),
        "match_template": lambda: match_template(image, template),
    }
    against = {"ssd": "TM_SQDIFF", "sad": "TM_SQDIFF", "ncc": "TM_CCORR_NORMED", "zncc": "TM_CCOEFF_NORMED",
               "sed": "distance + TM_CCORR"}  # fmt: skip
    for name in against:
        calls[name] = lambda name=name: similarity(image, template, name)  # type: ignore[misc]
        calls[f"{name} masked"] = lambda name=name: similarity(image, template, name, disc)  # type: ignore[misc]
        calls[f"{name} weighted"] = lambda name=name: similarity(image, template, name, weights)  # type: ignore[misc]
    ms = dict(zip(calls, median_ms(*calls.values(), repeats=40), strict=True))
    rows = [(name, other, ms[name], ms[other], ms[name] / ms[other]) for name, other in against.items()]
    rows.append(("match_template", "zncc", ms["match_template"], ms["zncc"], ms["match_template"] / ms["zncc"]))
    for kind in ("masked", "weighted"):
        rows += [(f"{m} {kind}", m, ms[f"{m} {kind}"], ms[m], ms[f"{m} {kind}"] / ms[m]) for m in against]
    rows += pyramid_rows(image)
    table = pd.DataFrame(rows, columns=["call", "against", "ms", "against (ms)", "ratio"])
    print(f"{image.shape[1]} x {image.shape[0]} uint8, template {SIDE} x {SIDE}, one thread, OpenCV {cv2.__version__}")
    print(table.round(2).to_string(index=False))
    megabyte = image.size * 8
    memory = {name: peak_memory(call) / megabyte for name, call in calls.items() if name.split()[0] in METHODS}
    print(f"peak memory at most {max(memory.values()):.1f} times the image in float64 ({max(memory, key=memory.__getitem__)})")  # fmt: skip
    write_file(find_root() / "runs" / "bench_matching.csv", table.to_csv(index=False, float_format="%.4g"))


def pyramid_rows(image: Array) -> list[tuple[str, str, float, float, float]]:
    """Search for a robot in twelve headings, from coarse to fine against in full."""
    template = image[120:220, 260:380]
    rows = []
    for name in ("ssd", "sad", "zncc"):
        full, fast = median_ms(
            lambda name=name: find(image, template, name, angles=range(0, 360, 30)),  # type: ignore[misc]
            lambda name=name: find(image, template, name, angles=range(0, 360, 30), pyramid=3),  # type: ignore[misc]
            repeats=5,
        )
        rows.append((f"{name}, 12 angles", "with pyramid=3", full, fast, full / fast))
    return rows


if __name__ == "__main__":
    main()
