"""Search images with a known answer: real and rendered pictures, one target each, degraded by one condition.

Targets: on rendered robots the centre of the exact silhouette; in ``ufes-lab`` the midpoint between a person's
visible feet (frames halved to 644 x 364 px); in photographs a place drawn from the more textured half, that is,
where the smaller eigenvalue of the structure tensor over 48 x 48 px (Shi and Tomasi 1994) is not below the
picture's median: a place without corners could not be told from its neighbours by any measure.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np

from occlib import formats, lab, matching, recordings
from occlib.base.arrays import FloatArray, Image
from occlib.base.extras import import_extra
from occlib.base.extras import pandas as pd
from occlib.foreground.intensity import to_grey
from occlib.geometry import Camera
from occlib.matching.sums import once
from occlib.study.conditions import CONDITIONS

Methods: TypeAlias = Iterable[matching.Method | str] | None


SEARCH_PX = (320, 240)  # width, height of the search image
SENSOR_NOISE = 5.0  # grey levels, standard deviation: no camera takes the same picture twice
SIDES_PX = (16, 128)  # smallest and largest template
ROOM_PX = 66  # from a target to the border of its picture: half of the largest template, and the tolerance of rounding
TEXTURE_PX = 48  # side of the square over which texture is measured: that of the usual template
WRONG = 5  # wrong optima kept for each trial: false alarms are counted up to here
PEAK_CAP = 100.0  # largest peak ratio: the second best place of a perfect match costs infinitely more
HIDDEN_MAX = 0.1  # share of a target that may be hidden in the frames that it is cut from and looked for

PHOTOGRAPHS = ("camera", "astronaut", "coins", "brick", "chelsea", "coffee", "china", "flower")
TIMED = ("four_robots", "ufes-lab")  # recordings in which targets move
SHIPPED = (*PHOTOGRAPHS, "robot", "four_robots")
SOURCES = (*SHIPPED, "ufes-lab")


class View(NamedTuple):
    """A grey picture, the true centre ``(x, y)`` of the target, and cm on the floor per px there (2, 2), or NaN."""

    grey: Image
    centre: FloatArray
    cm_per_px: FloatArray


def sources() -> tuple[str, ...]:
    """The sources at hand: all of :data:`SOURCES`, without ``ufes-lab`` where it was not fetched."""
    found = []
    for name in SOURCES:
        try:
            check_at_hand([name])
        except ValueError:
            continue
        found.append(name)
    return tuple(found)


def check_at_hand(names: Iterable[str]) -> None:
    """Raise ``ValueError``, saying how to fetch it, for a recording that is not on this machine."""
    for name in names:
        if name not in PHOTOGRAPHS:
            recordings.open_recording(name)


def _stream(seed: int, *names: object) -> np.random.Generator:
    """Random numbers that depend on seed and names only, not on the order of the work."""
    return np.random.default_rng([seed, zlib.crc32("/".join(map(str, names)).encode())])


@lru_cache(maxsize=8)
def _views(source: str, seed: int) -> dict[int, View]:
    """The target that a seed draws from a source: frames elapsed -> view (photographs: only 0)."""
    rng = _stream(seed, source, "target")
    if source not in PHOTOGRAPHS:
        return _recorded_views(source, rng)
    grey = _photograph(source)
    texture = cv2.cornerMinEigenVal(grey, TEXTURE_PX)[ROOM_PX:-ROOM_PX, ROOM_PX:-ROOM_PX]
    places = np.argwhere(texture >= np.median(texture))
    return {0: View(grey, places[rng.integers(len(places))][::-1] + float(ROOM_PX), np.full((2, 2), np.nan))}


@lru_cache(maxsize=len(PHOTOGRAPHS))
def _photograph(name: str) -> Image:
    import skimage.data

    if name in ("china", "flower"):
        picture = import_extra("sklearn.datasets", "study").load_sample_image(f"{name}.jpg")
    else:
        picture = getattr(skimage.data, name)()
    return picture if picture.ndim == 2 else to_grey(np.ascontiguousarray(picture))


def _recorded_views(source: str, rng: np.random.Generator) -> dict[int, View]:
    """A robot or a person that nothing hides, now and after each delay, with room around it in the picture."""
    recording = recordings.open_recording(source)
    truth = formats.load_truth(recording.path / "truth.json").frames
    targets = {
        (camera, frame, target.id): target
        for frame in truth
        for target in truth[frame]
        for camera in recording.rig.cameras
        if target.hidden_fraction.get(camera, 0) <= HIDDEN_MAX and target.state.get(camera, "visible") == "visible"
    }
    delays = _delays() if source in TIMED else [0]
    places = [key for key in sorted(targets) if all((key[0], key[1] + d, key[2]) in targets for d in delays)]
    zoom = 2 if source == "ufes-lab" else 1
    for i in rng.permutation(len(places)):
        name, frame, target = places[i]
        camera, keys = recording.rig[name], [(name, frame + d, target) for d in delays]
        centres = np.array([_centre(source, camera, key[1], target, targets[key]) for key in keys])
        size = np.array(camera.size)
        if np.all((centres >= zoom * ROOM_PX) & (centres < size - zoom * ROOM_PX)):
            break
    else:
        raise ValueError(f"{source}: no target is visible for {max(delays)} frames and {ROOM_PX} px from the border")
    images = dict(recordings.open_recording(source, [name]).images([frame + d for d in delays]))
    views = {}
    for delay, centre in zip(delays, centres, strict=True):
        grey = to_grey(images[frame + delay][name])
        grey = cv2.resize(grey, None, fx=1 / zoom, fy=1 / zoom, interpolation=cv2.INTER_AREA) if zoom > 1 else grey
        views[delay] = View(grey, (centre + 0.5) / zoom - 0.5, zoom * cm_per_px(camera, centre))
    return views


def _delays() -> list[int]:
    """Frames after which the conditions look at a target again."""
    return sorted({condition.delay(level) for condition in CONDITIONS.values() for level in condition.levels})


@lru_cache(maxsize=2)
def _scene(source: str) -> lab.Scene:
    return lab.load_scene(source)


def _centre(source: str, camera: Camera, frame: int, name: str, target: formats.TrueObject) -> FloatArray:
    """Middle of the silhouette's bounding box, or the floor point of hand-marked truth, ``(x, y)`` in px."""
    if source == "ufes-lab":
        return camera.floor_to_pixels([[target.x, target.y]])[0]
    scene = _scene(source)
    robot = next(o for o in scene.objects if o.id == name)
    depth, (rows, columns) = lab.depth_image(scene, scene.rig[camera.name], robot, frame)
    inside = np.argwhere(np.isfinite(depth))
    row, column = (inside.min(axis=0) + inside.max(axis=0)) / 2
    return np.array([column + columns.start, row + rows.start])


def cm_per_px(camera: Camera, point_px: FloatArray) -> FloatArray:
    """Jacobian (2, 2) of the camera's image-to-floor map at a pixel: ``floor_cm = J @ error_px``."""
    x, y = point_px
    floor = camera.pixels_to_floor([[x - 0.5, y], [x + 0.5, y], [x, y - 0.5], [x, y + 0.5]])
    return np.asarray(100 * np.column_stack([floor[1] - floor[0], floor[3] - floor[2]]))


@dataclass(frozen=True)
class Trial:
    """A search image and a template, both grey uint8.

    ``corner`` is the true place ``(x, y)`` of the template's top-left pixel, float px, or ``None`` if the target
    is absent; ``cm_per_px`` (2, 2) turns an error in px into cm on the floor, NaN for photographs.
    """

    image: Image
    template: Image
    corner: FloatArray | None
    cm_per_px: FloatArray


def make_trial(source: str, seed: int, condition: str = "noise", level: float | None = None, side: int = 48) -> Trial:
    """The trial of a seed: the same target at the same place of the search image for every condition and level.

    The search image is never the template's own picture again: it is displaced by a fraction of a pixel and carries
    the noise of a sensor, 5 grey levels, or of the condition's ``under``.

    Parameters
    ----------
    source
        One of :data:`SOURCES`.
    seed
        Which target, 0 to 2^32.
    condition, level
        What disturbs the search, and how much; ``None`` is the clean level.
    side
        Of the template, 16 to 128 px, unless the level is the side.

    Raises
    ------
    ValueError
        An unknown name, a delay that was not filmed, or a side out of range.
    """
    (name,) = known_names([condition], CONDITIONS, "condition")
    known_names([source], SOURCES, "source")
    chosen = CONDITIONS[name]
    level = chosen.clean if level is None else level
    side, delay = chosen.side(level, side), chosen.delay(level)
    views = _views(source, whole_numbers([seed], "seeds", 0, 2**32)[0])
    whole_numbers([side], "sides", *SIDES_PX)
    if delay not in views:
        raise ValueError(f"level: expected one of {', '.join(map(str, views))} frames for {source}, got {level:g}")
    start, view = views[0], views[delay]
    cut = np.floor(start.centre - side / 2 + 1).astype(int)  # the square whose centre is nearest
    template = start.grey[cut[1] : cut[1] + side, cut[0] : cut[0] + side]
    fraction = _stream(seed, source, "fraction").uniform(-0.5, 0.5, 2)
    truth = view.centre - start.centre + cut + fraction
    x, y = np.rint(truth - fraction).astype(int).tolist()
    rng = _stream(seed, source, name)
    image = chosen.degrade("scene", view.grey, (x, y, side, side), level, rng)
    image = once(_displaced, image, fraction)
    free = np.subtract(SEARCH_PX, side)
    inside = np.rint(_stream(seed, source, "place").random(2) * free).astype(int)
    left, top = np.clip((x, y) - inside, 0, np.maximum(np.subtract(image.shape[1::-1], SEARCH_PX), 0)).tolist()
    image = np.ascontiguousarray(image[top : top + SEARCH_PX[1], left : left + SEARCH_PX[0]])
    noise = _sensor(source, seed, image.shape) * np.hypot(SENSOR_NOISE, chosen.under)
    box = x - left, y - top, side, side
    image = chosen.degrade("light", image, box, level, rng)
    image = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
    image = chosen.degrade("file", image, box, level, rng)
    gone = chosen.removes_target and level != chosen.clean
    return Trial(image, template, None if gone else truth - (left, top), view.cm_per_px)


@lru_cache(maxsize=2)
def _sensor(source: str, seed: int, shape: tuple[int, ...]) -> FloatArray:
    """The sensor's noise, of standard deviation 1: the same at every level."""
    return _stream(seed, source, "sensor").standard_normal(shape)


def _displaced(image: Image, fraction: FloatArray) -> Image:
    """Moved right and down by a fraction of a pixel, by a windowed sinc: OpenCV's warps move in steps of 1/32 px."""
    taps = np.arange(-5, 6)
    kernels = [np.sinc(taps + d) * np.sinc((taps + d) / 5.5) for d in fraction]
    across, down = (kernel / kernel.sum() for kernel in kernels)
    return np.clip(np.rint(cv2.sepFilter2D(image, cv2.CV_64F, across, down)), 0, 255).astype(np.uint8)


@contextmanager
def registered(methods: Methods) -> Iterator[list[matching.Method]]:
    """The methods, known to :mod:`occlib.matching.search` meanwhile: a worker process has not seen the user's own."""
    given = list(matching.METHODS.values() if methods is None else [methods] if isinstance(methods, str) else methods)
    names = [method if isinstance(method, str) else method.name for method in given]
    own = {method.name: method for method in given if not isinstance(method, str)}
    known_names(names, {**matching.METHODS, **own}, "method")
    previous = {name: matching.METHODS.get(name) for name in own if matching.METHODS.get(name) is not own[name]}
    matching.METHODS.update(own)
    try:
        yield [matching.METHODS[name] for name in names]
    finally:
        for name, method in previous.items():
            matching.METHODS.pop(name) if method is None else matching.METHODS.update({name: method})


def _within(score: FloatArray, place: FloatArray, radius: float) -> FloatArray:
    """The scores at whole pixels no farther than ``radius`` from a place ``(x, y)``; none for a place of NaN."""
    if not np.isfinite(place).all():
        return np.empty(0)
    low = np.maximum(np.floor(place[::-1] - radius).astype(int), 0)
    high = np.minimum(np.ceil(place[::-1] + radius).astype(int) + 1, score.shape)
    rows, columns = np.mgrid[low[0] : high[0], low[1] : high[1]]
    window = score[low[0] : high[0], low[1] : high[1]]
    return window[np.hypot(rows - place[1], columns - place[0]) <= radius]


def measured_trial(trial: Trial, method: matching.Method, tau_px: float) -> dict[str, Any]:
    """A row of the study: everything that one similarity image tells (columns: :func:`occlib.study.work.run_batch`)."""
    score = matching.similarity(trial.image, trial.template, method.name)
    cost = -score if method.higher_is_better else score
    perfect = -method.bounds[1] if method.higher_is_better else method.bounds[0]
    everything = float(score.min() if method.higher_is_better else score.max())
    places = matching.optima(score, method.name, everything, "nms", size=trial.template.shape, max_count=WRONG + 3)
    row, column = matching.best(score, method.name)
    best = matching.refine(score, [(row, column)])[0, ::-1]
    true = np.full(2, np.nan) if trial.corner is None else trial.corner
    wrong = ~(np.hypot(*(places[:, ::-1] - true).T) <= tau_px)  # NaN: all are wrong
    dx, dy = best - true
    error = float(np.hypot(dx, dy))
    near = _within(score, true, tau_px)
    costs = cost[places[:, 0], places[:, 1]] - perfect
    ratio = float("nan")  # of a measure that has no perfect score
    if np.isfinite(perfect):
        ratio = min(costs[1] / max(costs[0], 1e-12), PEAK_CAP) if len(costs) > 1 else PEAK_CAP
        ratio = max(ratio, 1.0)
    scores = score[places[wrong, 0], places[wrong, 1]].tolist() + [np.nan] * WRONG
    return {
        "method": method.name, "higher_is_better": method.higher_is_better, "present": trial.corner is not None,
        "score": float(score[row, column]), "dx": dx, "dy": dy, "error_px": error,
        "error_cm": float(np.hypot(*(trial.cm_per_px @ (dx, dy)))), "found": error <= tau_px,
        "score_target": float((near.max() if method.higher_is_better else near.min()) if near.size else np.nan),
        "optimum": bool((~wrong).any()), "peak_ratio": float(ratio),
        **{f"wrong_{i + 1}": scores[i] for i in range(WRONG)},
        "default": matching.default_threshold(trial.image, trial.template, method.name),
        **{rule: matching.score_threshold(score, method.name, rule) for rule in ("otsu", "mad")},
    }  # fmt: skip


def runtime(
    sides: Iterable[int] = (16, 32, 48, 64, 96, 128), methods: Methods = None, *, repeats: int = 7
) -> pd.DataFrame:
    """Run time of :func:`occlib.matching.search.similarity` on 320 x 240 px, one thread: ``side, method, median_ms``.

    The calls take turns, so that a slow moment of the machine falls on all alike; the first turn is not counted.
    """
    lengths, threads = whole_numbers(sides, "sides", *SIDES_PX), cv2.getNumThreads()
    trials = {side: make_trial("camera", 0, side=side) for side in lengths}
    cv2.setNumThreads(1)
    try:
        with registered(methods) as chosen:
            spent: dict[tuple[int, str], list[float]] = {(side, m.name): [] for side in lengths for m in chosen}
            for _ in range(repeats + 1):
                for (side, name), times in spent.items():
                    start = time.perf_counter()
                    matching.similarity(trials[side].image, trials[side].template, name)
                    times.append(1000 * (time.perf_counter() - start))
    finally:
        cv2.setNumThreads(threads)
    return pd.DataFrame([{"side": s, "method": m, "median_ms": float(np.median(t[1:]))} for (s, m), t in spent.items()])


def known_names(names: Iterable[str], table: Iterable[str], what: str) -> tuple[str, ...]:
    """The names, each once; ``ValueError`` for one that is not in the table, and for none."""
    names, table = (names,) if isinstance(names, str) else tuple(names), tuple(table)
    for name in names:
        if name not in table:
            raise ValueError(f"{what}: expected one of {', '.join(table)}, got {name!r}")
    if not names:
        raise ValueError(f"{what}: expected at least one of {', '.join(table)}, got none")
    return tuple(dict.fromkeys(names))


def whole_numbers(values: Iterable[Any], name: str, low: int, high: int) -> tuple[int, ...]:
    """The numbers, each once; ``ValueError`` for one that is not whole or out of range, and for none."""
    numbers = tuple(dict.fromkeys(values))
    for value in numbers:
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
            raise ValueError(f"{name}: expected whole numbers from {low} to {high}, got {value!r}")
    if not numbers:
        raise ValueError(f"{name}: expected at least one, got none")
    return tuple(int(value) for value in numbers)
