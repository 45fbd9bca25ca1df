"""Tables and drawings of chapter 08: recordings run through several chains, and what their vectors say against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from occlib import metrics, plotting, reproduce
from occlib.base.extras import pandas as pd
from occlib.formats import TrueObject, Truth
from occlib.geometry import Floor, Rig
from occlib.lab import Scene
from occlib.mapping import OccupancyMap
from occlib.pipeline import Pipeline
from occlib.recordings import Recording
from occlib.tracking import ObjectVector, Observation, Tracker

RED, BLUE = (200, 30, 30), (30, 30, 200)


@dataclass
class Run:
    """What one chain said of a recording, by frame, and its tracker's events."""

    objects: dict[int, list[ObjectVector]] = field(default_factory=dict)
    maps: dict[int, OccupancyMap] = field(default_factory=dict)
    coasting: dict[int, list[ObjectVector]] = field(default_factory=dict)
    events: pd.DataFrame = field(default_factory=lambda: pd.DataFrame())

    @property
    def identities(self) -> int:
        """How many different numbers it has given to objects."""
        return len({one.id for found in self.objects.values() for one in found})


def run_chains(
    recording: Recording, chains: Mapping[str, Pipeline], frames: Mapping[str, Iterable[int]]
) -> dict[str, Run]:
    """Run a recording through several chains, the frames in order.

    Parameters
    ----------
    recording
        Its cameras must include those of the chains.
    chains
        New pipelines by name.
    frames
        For each of them the frames that it is shown.
    """
    runs = {name: Run() for name in chains}
    wanted = {name: set(frames[name]) for name in chains}
    for frame, images in recording.images(sorted(set().union(*wanted.values()))):
        for name, chain in chains.items():
            if frame in wanted[name]:
                seen = {camera: images[camera] for camera in chain.rig.cameras}
                result = chain.process(seen, recording.time(frame))
                run = runs[name]
                run.objects[frame], run.maps[frame] = result.objects, result.map
                run.coasting[frame] = list(chain.tracker.coasting())
    for name, chain in chains.items():
        runs[name].events = pd.DataFrame(chain.tracker.events, columns=["time (s)", "id", "event", "reason"])
    return runs


# --- invented objects


def velocities(x: npt.ArrayLike, times: npt.ArrayLike, tracker: Tracker) -> list[float]:
    """The velocity along x that a tracker reports for a dot that it sees at ``x`` at ``times``."""
    pairs = zip(np.asarray(x, dtype=float), np.asarray(times, dtype=float), strict=True)
    return [tracker.update([Observation((at, 0.0), 0.04, RED)], time)[0].velocity_mps[0] for at, time in pairs]


def two_robots(
    absent: Sequence[tuple[float, float]] = ((1.0, 1.5), (2.5, 4.0)),
) -> Iterator[tuple[float, list[Observation]]]:
    """Time and sights of two invented robots over 5 s, ten times a second.

    Robot A is red and always there; B is blue and missing ``from <= t < to`` for each pair of ``absent``.
    """
    for time in np.arange(0, 5, 0.1).round(1).tolist():
        sights = [Observation((0.2 * time, 0.5), 0.04, RED)]
        if not any(start <= time < end for start, end in absent):
            sights.append(Observation((-0.2 * time, -0.5), 0.04, BLUE))
        yield time, sights


def head_on(tracker: Tracker) -> list[int]:
    """The number of a red robot that meets a blue one, stops short of touching it and turns back, in 21 frames."""
    numbers = []
    for k in range(21):
        x = abs(1 - 0.1 * k) + 0.02
        pair = [Observation((-x, 0.0), 0.04, RED), Observation((x, 0.0), 0.04, BLUE)]
        numbers.append(tracker.update(pair, 0.1 * k)[0].id)
    return numbers


def draw_velocities(
    times: npt.ArrayLike, noisy_x: npt.ArrayLike, truth: npt.ArrayLike, estimates: Mapping[str, Sequence[float]]
) -> Figure:
    """Velocities against time: truth, those of a few trackers, and the difference of two positions."""
    fig, ax = plotting.new_figure(width=10, height=4.2)
    ax.step(times, truth, color="#F0E442", lw=6, where="post", label="truth")
    naive = np.diff(np.asarray(noisy_x)) / np.diff(np.asarray(times))
    ax.plot(np.asarray(times)[1:], naive, ".", color="0.65", ms=8, label="difference of two positions")
    for (name, values), style in zip(estimates.items(), ("-", "--", ":"), strict=False):
        ax.plot(times, values, style, color="0.1", lw=1.8, label=name)
    ax.set(xlabel="time (s)", ylabel="velocity (m/s)", ylim=(-1.7, 1.7))
    fig.legend(loc="outside lower center", ncols=3, fontsize=11)
    return fig


# --- the truth beside it


def true_object(truth: Truth, frame: int, identity: str) -> TrueObject:
    """The object of that id in a frame of the truth."""
    return next(true for true in truth.frames[frame] if true.id == identity)


def presence(runs: Mapping[str, Run], truth: Truth, identity: str, camera: str, *, radius: float) -> pd.DataFrame:
    """For each frame: how much of an object each camera hides (truth), whether it is on each run's map, and flagged.

    Parameters
    ----------
    runs
        The first one's flag is looked at: whether its vector says that the object is hidden in ``camera`` and nowhere else.
    truth, identity
        The object.
    camera
        The one that loses sight of it.
    radius
        A vector this close, in m, is the object's.
    """
    rows = {}
    first = next(iter(runs))
    for frame in next(iter(runs.values())).objects:
        true = true_object(truth, frame, identity)
        rows[frame] = {**true.hidden_fraction}
        for name, run in runs.items():
            objects = run.objects.get(frame)
            if objects is None:  # a chain that was not shown this frame
                rows[frame][name] = np.nan
                continue
            pairs = metrics.match_points([one.position_m for one in objects], [(true.x, true.y)], radius)
            rows[frame][name] = float(bool(pairs))
            if name == first:
                rows[frame]["flagged"] = float(bool(pairs) and objects[pairs[0][0]].hidden_in == (camera,))
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("frame")


def draw_timeline(line: pd.DataFrame, rows: Mapping[str, tuple[str, str]], fps: float) -> Figure:
    """Columns of a table from 0 to 1 as bars over time.

    ``rows``: ``{label: (column, colour)}``, from the top; the table's index are frames.
    """
    fig, ax = plotting.new_figure(width=10, height=3.6)
    seconds = line.index.to_numpy() / fps
    for row, (column, colour) in enumerate(rows.values()):
        bar = row + 0.8 - 0.8 * line[column].to_numpy(dtype=float)
        ax.fill_between(seconds, row + 0.8, bar, step="post", color=colour, lw=0)
        ax.axhline(row + 0.8, color="0.8", lw=0.8)
    ax.set(yticks=np.arange(len(rows)) + 0.4, xlim=(0, seconds[-1]), xlabel="time (s)")
    ax.set_yticklabels(list(rows), fontsize=12)
    ax.invert_yaxis()
    ax.spines[["top", "right", "left"]].set_visible(False)
    return fig


def life_of(runs: Mapping[str, Run], truth: Truth, identity: str, fps: float, *, radius: float) -> pd.DataFrame:
    """Every vector near an object, seen or coasting: what each camera sees of it, and how sure its position is.

    Parameters
    ----------
    runs
        By name.
    truth, identity
        The object.
    fps
        Frames a second.
    radius
        A vector further than this from the object, in m, is not the object's.

    Returns
    -------
    A row for each vector and frame: ``time``, ``way`` (the run), ``id``, ``state``, ``sd (cm)``, and each camera's visible share.
    """
    rows: list[dict[str, object]] = []
    for way, run in runs.items():
        for frame, objects in run.objects.items():
            true = true_object(truth, frame, identity)
            for vector in [*objects, *run.coasting[frame]]:
                if np.hypot(vector.x - true.x, vector.y - true.y) < radius:
                    state = "coasting" if vector in run.coasting[frame] else "seen"
                    sure = 100 * float(np.sqrt(vector.covariance[0, 0]))
                    row = {"time": frame / fps, "way": way, "id": vector.id, "state": state, "sd (cm)": sure}
                    rows.append({**row, **vector.visible})
    return pd.DataFrame(rows)


def score_runs(runs: Mapping[str, Run], truth: Truth, floor: Floor, *, radius: float) -> pd.DataFrame:
    """Detection, coverage, claim and identity of each run against the truth of the frames that it was shown.

    Returns
    -------
    A row for each run: ``moda``, ``median_error`` in m, ``min_coverage``, ``median_claimed_ratio``, ``id_switches``.
    """
    rows = {}
    for name, run in runs.items():
        score = metrics.evaluate(dict(run.objects), truth.select(run.objects), radius=radius)
        covered, claimed = [], []
        for frame, grid in run.maps.items():
            footprints = [true.footprint for true in truth.frames[frame] if true.footprint is not None]
            covered.append(metrics.footprint_coverage(grid.data == 100, floor, footprints).min())
            claimed.append(metrics.claimed_area_ratio(grid.data == 100, floor, footprints))
        rows[name] = {
            "moda": score.moda,
            "median_error": score.error_median_m,
            "min_coverage": float(np.min(covered)),
            "median_claimed_ratio": float(np.median(np.array(claimed, dtype=float))),
            "id_switches": score.id_switches,
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def frames_with_fewer(run: Run, count: int) -> int:
    """In how many frames the map has fewer than ``count`` objects."""
    return sum(len(objects) < count for objects in run.objects.values())


def motion(run: Run, scene: Scene, fps: float, *, radius: float) -> pd.DataFrame:
    """Speed and colour of each vector and of the true object that it matches.

    Parameters
    ----------
    run
        The vectors.
    scene
        Where the true objects drive, and their paint.
    fps
        Frames a second.
    radius
        A vector this close to an object, in m, is the object's.
    """
    rows, last = [], max(run.objects)
    for frame, objects in run.objects.items():
        now = [one.pose(frame)[:2] for one in scene.objects]
        middle = float(np.clip(frame, 0.5, last - 0.5))  # an object rests before its first and after its last frame
        for i, j, _ in metrics.match_points([one.position_m for one in objects], now, radius):
            before, after = (np.array(scene.objects[j].pose(middle + step)[:2]) for step in (-0.5, 0.5))
            v, true_v = np.array(objects[i].velocity_mps), (after - before) * fps
            rows.append({"time": frame / fps, "object": scene.objects[j].label, "V (m/s)": np.hypot(*v),
                         "true (m/s)": np.hypot(*true_v), "error (m/s)": np.hypot(*(v - true_v)),
                         "colour": objects[i].colour, "paint": scene.objects[j].colour})  # fmt: skip
    return pd.DataFrame(rows)


def nearest_paint(moved: pd.DataFrame) -> pd.DataFrame:
    """How often the measured colour of each object is nearest to its own paint: in RGB, and by hue.

    ``moved``: what :func:`motion` returns. The hue is the direction of what is left of a colour without its grey.
    """
    paints = moved.groupby("object")["paint"].first()
    measured, painted = (np.stack(list(colours)).astype(float) for colours in (moved["colour"], paints))
    distance = np.linalg.norm(measured[:, None] - painted, axis=2)
    grey_free, hues = (colours - colours.mean(axis=1, keepdims=True) for colours in (measured, painted))
    alike = (
        grey_free @ (hues / np.linalg.norm(hues, axis=1, keepdims=True)).T
    )  # largest where the direction is the same
    right = pd.DataFrame({"object": moved["object"]})
    right["by RGB"] = paints.index[distance.argmin(axis=1)] == moved["object"]
    right["by hue"] = paints.index[alike.argmax(axis=1)] == moved["object"]
    table = right.groupby("object").mean()
    table.loc["all"] = right[["by RGB", "by hue"]].mean()
    return table


def record_scores(scores: pd.DataFrame) -> None:
    """Keep what :func:`score_runs` says, for a table with an index of recording and run."""
    names = {"both": "", "both, paper": "_paper", "left only": "_left_only"}
    tolerances = {
        "moda": 0.03, "median_error": 0.005, "min_coverage": 0.03, "median_claimed_ratio": 0.1, "id_switches": 3,
    }  # fmt: skip
    rows: dict[tuple[str, str], dict[str, float]] = scores.to_dict("index")  # type: ignore[assignment]
    for (recording, way), row in rows.items():
        for column, tolerance in tolerances.items():
            value = int(row[column]) if column == "id_switches" else row[column]
            unit, spread = "m" if "error" in column else "", 1 if way == "both" else 3
            reproduce.record(f"{recording}{names[way]}_{column}", value, unit=unit, tolerance=tolerance * spread)


def record_motion(moved: pd.DataFrame, paint: pd.DataFrame) -> None:
    """Keep the median error of the velocities after the first second, and how often the colours are right."""
    error = moved.loc[moved["time"] >= 1.0, "error (m/s)"].median()
    reproduce.record("four_robots_velocity_error", error, unit="m/s", tolerance=0.03)
    for way in ("by RGB", "by hue"):
        share = float(paint[way].to_numpy()[-1])
        reproduce.record(f"four_robots_colour_right_{way.replace(' ', '_')}", share, tolerance=0.08)


def record_hidden(runs: Mapping[str, Run], truth: Truth, *, radius: float) -> None:
    """Keep the recall of each run for what the worst of its views hides to 90 % or more."""
    cameras = {"both": ["left", "right"], "both, paper": ["left", "right"], "left only": ["left"]}
    for way, name in {"both": "", "both, paper": "paper_", "left only": "left_only_"}.items():
        found = dict(runs[way].objects)
        *_, worst = metrics.recall_by_hidden_fraction(
            found, truth.select(found), cameras=cameras[way], edges=(0, 0.5, 0.9, 1), radius=radius
        )
        reproduce.record(f"four_robots_{name}hidden_recall", worst["recall"] or 0.0, tolerance=0.15)


def identities_by_interval(run: Run, fps: float, every: Iterable[int], gates_m: Iterable[float]) -> pd.DataFrame:
    """How many identities a tracker gives if it gets only every n-th frame of a run, for a few gates.

    Returns
    -------
    A row for each interval in s, a column for each gate in m.
    """
    table = pd.DataFrame(dtype=float)
    for n in every:
        for gate in gates_m:
            tracker = Tracker(gate_m=gate, gate_growth_mps=0.0, max_missed_s=10.0)
            for frame in [frame for frame in run.objects if frame % n == 0]:
                sights = [Observation(one.position_m, one.area_m2, one.colour) for one in run.objects[frame]]
                tracker.update(sights, frame / fps)
            table.loc[n / fps, gate] = max(event.id for event in tracker.events)
    return table.astype(int).rename_axis(index="seconds between frames", columns="gate (m)")


# --- drawings of the recordings


def draw_instants(
    rows: Mapping[str, tuple[Recording, Run, Truth]], frame: int, window: tuple[int, int, int, int]
) -> Figure:
    """A row for each recording: its views, a ring where a vector says that it is hidden there, and the map.

    Parameters
    ----------
    rows
        ``{name: (recording, run, truth)}``; two cameras each.
    frame
        The instant.
    window
        ``(left, right, top, bottom)`` in px of the views that is shown.
    """
    fig, axes = plotting.new_figure(3, len(rows), width=10, height=3.0 * len(rows))
    for row, (name, (recording, run, truth)) in zip(axes, rows.items(), strict=True):
        _, images = next(recording.images([frame]))
        colours = plotting.camera_colours(list(recording.rig.cameras))
        for ax, (camera, image) in zip(row, images.items(), strict=False):
            if image is not None:
                plotting.show_image(ax, image)
            ax.set_title(f"{name}: {camera}", color=colours[camera], fontsize=12)
            gone = [one.position_m for one in run.objects[frame] if camera in one.hidden_in]
            pixels = recording.rig[camera].floor_to_pixels(np.reshape(gone, (-1, 2)))
            ax.plot(*pixels.T, "wo", ms=15, mfc="none", mew=2)
            ax.set(xlim=window[:2], ylim=(window[3], window[2]))
        plotting.show_map(row[2], run.maps[frame], run.objects[frame], truth=truth.frames[frame])
        row[2].set_title("map of both", fontsize=12)
        row[2].get_legend().remove()
    return fig


def draw_maps_of(
    runs: Mapping[str, Run], truth: Truth, frame: int, window_m: tuple[float, float, float, float]
) -> Figure:
    """The maps of an instant made in several ways, one above the other, with the true footprints dashed."""
    fig, axes = plotting.new_figure(1, len(runs), width=8, height=1.75 * len(runs))
    for ax, (name, run) in zip(axes, runs.items(), strict=True):
        plotting.show_map(ax, run.maps[frame], run.objects[frame], truth=truth.frames[frame])
        ax.set_title(f"{name}: {len(run.objects[frame])} objects", fontsize=12)
        ax.set(xlim=window_m[:2], ylim=window_m[2:], xlabel="")
        ax.get_legend().remove()
    axes[-1].set_xlabel("x (m)")
    return fig


def draw_paths(runs: Mapping[str, Run], truth: Truth, rig: Rig) -> Figure:
    """The true paths dashed, and the vectors' positions, one colour for each identity."""
    fig, axes = plotting.new_figure(len(runs), width=10, height=10 / len(runs) * 0.75 + 0.6)
    for ax, (name, run) in zip(axes, runs.items(), strict=True):
        for path in zip(*truth.frames.values(), strict=True):
            ax.plot([true.x for true in path], [true.y for true in path], "--", color="0.3", lw=1.4)
            ax.text(path[0].x, path[0].y - 0.2, path[0].label, ha="center", fontsize=11)
        vectors = [one for objects in run.objects.values() for one in objects]
        shades = [plotting.CAMERA_COLOURS[one.id % 8] for one in vectors]
        ax.scatter(*np.array([one.position_m for one in vectors]).T, c=shades, s=7)
        ax.set_title(f"{name}: {run.identities} identities", fontsize=12)
        ax.set(xlabel="x (m)", xlim=rig.floor.x, ylim=rig.floor.y, aspect="equal")
    axes[0].set_ylabel("y (m)")
    for ax in axes[1:]:
        ax.set_yticklabels([])
    return fig
