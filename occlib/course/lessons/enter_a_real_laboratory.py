"""Tables and figures of chapter 12, "Enter a real laboratory".

Whatever shows a picture of the recording covers the heads of the people in it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from occlib import floor_marks, foreground, metrics, plotting
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.extras import pandas as pd
from occlib.course.drawings import cover_heads, outline_cylinders
from occlib.explaining import PolarWarp, Prism
from occlib.foreground import Background
from occlib.formats import TrueObject, Truth
from occlib.geometry import Camera, Floor, Rig
from occlib.lab import rotation_xyz
from occlib.pipeline import FrameResult, Pipeline
from occlib.recordings import Recording
from occlib.registration import registration_error_m
from occlib.settings import Settings
from occlib.tracking import ObjectVector

Marks = Mapping[str, tuple[FloatArray, FloatArray]]
"""For each camera the floor marks in raw px and in m, both (N, 2)."""
Group = tuple[str, ...]
Found = dict[tuple[Group, str], dict[int, Sequence[ObjectVector]]]
"""For each set of cameras and way of fusing, the objects of each frame."""

TALLEST_ROW = 727
"""The last row of the recording's pictures that is not black, px."""


# --- the room


def rig_table(rig: Rig, marks: Marks) -> pd.DataFrame:
    """Place, picture size and number of floor marks of each camera."""
    rows = {name: [*rig[name].centre_m, *rig[name].size, len(marks[name][0])] for name in rig.cameras}
    columns = ["x (m)", "y (m)", "z (m)", "width (px)", "height (px)", "marks"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("camera")


def show_plan(rig: Rig, truth: Truth, marks: Marks, regions: Sequence[str]) -> Figure:
    """Cameras, map, marks, regions of interest and the true paths, from above."""
    colours = plotting.camera_colours(list(rig.cameras))
    fig, ax = plt.subplots(figsize=(8, 6.6), layout="constrained")
    plotting.show_floor(ax, np.full(rig.floor.shape, 0.08), rig.floor, vmax=1)
    for name, style in zip(regions, ("-", ":"), strict=False):
        outline = np.array([*truth.roi[name], truth.roi[name][0]])
        ax.plot(*outline.T, style, color="0.35", label=name)
    for name, camera in rig.cameras.items():
        place = (float(camera.centre_m[0]), float(camera.centre_m[1]))
        ax.plot(*place, "s", color=colours[name], markersize=10)
        ax.annotate(name, place, xytext=(9, 5), textcoords="offset points", color=colours[name])
    ax.plot(*np.vstack([points for _, points in marks.values()]).T, "+", color="0.2", markersize=7, label="floor mark")
    for person, shade, style in (("A", "#D55E00", ".-"), ("B", "#56B4E9", "x-")):
        path = [[true.x, true.y] for people in truth.frames.values() for true in people if true.id == person]
        ax.plot(*np.array(path).T, style, color=shade, label=f"path of {person}")
    ax.set(xlim=(-4.2, 4.7), ylim=(-5.4, 4.2))
    ax.legend(loc="lower right", fontsize=10)
    return fig


# --- a camera that is knocked


def knocked(camera: Camera, turn: npt.ArrayLike) -> Camera:
    """What one believes of a camera that was turned about its centre: its old homography.

    Parameters
    ----------
    camera
        As calibrated.
    turn
        Rotation vector in degrees, (3,), in the camera's frame.
    """
    wrong = camera.matrix @ rotation_xyz(np.asarray(turn, dtype=float)) @ np.linalg.inv(camera.matrix)
    return Camera(camera.name, camera.size, camera.lens, camera.image_to_floor @ wrong)


def knock_table(
    rig: Rig, marks: Marks, rng: np.random.Generator, *, degrees: float = 1.0, count: int = 20
) -> pd.DataFrame:
    """Errors of each camera's marks in cm: as calibrated, knocked in random directions, and refitted to the marks."""
    rows = {}
    for name, camera in rig.cameras.items():
        turns = rng.normal(size=(count, 3))
        turns *= degrees / np.linalg.norm(turns, axis=1, keepdims=True)
        stale = [np.median(registration_error_m(knocked(camera, turn), *marks[name])) for turn in turns]
        fit = floor_marks.floor_homography_from_marks(camera, *marks[name])
        if fit.leave_one_out_m is None:
            raise ValueError(f"marks: {name}: expected five or more")
        rows[name] = {
            "rig": np.median(registration_error_m(camera, *marks[name])),
            "knocked, median": np.median(stale),
            "knocked, worst": np.max(stale),
            "refitted": np.median(fit.error_m),
            "refitted, left out": np.median(fit.leave_one_out_m),
            "worst left out": np.max(fit.leave_one_out_m),
        }
    return 100 * pd.DataFrame.from_dict(rows, orient="index").rename_axis("camera")


def seen_today(rig: Rig, marks: Marks) -> dict[str, FloatArray]:
    """Where each camera sees its marks the morning after, raw px (N, 2): one of the cameras was knocked in the night."""
    rng, seen = np.random.default_rng(12), {}
    for name, (pixels, places) in marks.items():
        seen[name] = pixels + rng.normal(0, 0.3, pixels.shape)
        if name == "cam2":
            camera = rig[name]
            turn = camera.matrix @ rotation_xyz(np.array([0.9, -0.5, 0.3])) @ np.linalg.inv(camera.matrix)
            ideal = np.column_stack([camera.lens.undistort(camera.floor_to_pixels(places)), np.ones(len(places))])
            moved = ideal @ np.linalg.inv(turn).T
            seen[name] = camera.lens.distort(moved[:, :2] / moved[:, 2:])
    return seen


# --- background and foreground


def plain_median(pictures: Sequence[Image]) -> Image:
    """The median of each pixel and channel over time."""
    stack = np.stack(pictures)
    return foreground.weighted_median(stack, np.broadcast_to(np.ones((len(stack), 1, 1, 1), np.uint8), stack.shape))


def show_backgrounds(
    median: Image, learned: Background, camera: Camera, truth: Truth, frame: int, colour: str
) -> Figure:
    """Median over time, learned background, where they differ, and the learned spread; heads covered."""
    fig, axes = plt.subplots(2, 2, figsize=(10, 6.4), layout="constrained")
    ghost = cover_heads(median, camera, truth.frames[frame])
    plotting.show_image(axes[0, 0], ghost, "median over time", colour=colour)
    plotting.show_image(axes[0, 1], learned.image, "learned", colour=colour)
    differ = np.abs(median.astype(float) - learned.image).max(axis=2) > 30
    plotting.show_image(axes[1, 0], differ, "differ by more than 30 grey levels")
    varies = np.zeros(learned.image.shape[:2]) if learned.spread is None else learned.spread
    spread = plotting.show_image(axes[1, 1], varies, "spread over time", cmap="viridis", vmax=8)
    fig.colorbar(spread, ax=axes[1, 1], label="grey levels", shrink=0.8)
    for ax in axes.flat:
        ax.set(xlim=(230, 1230), ylim=(TALLEST_ROW, 130))
    return fig


def otsu_mask(image: Image, background: Background) -> Mask:
    """Foreground by the paper's chain: grey difference, smoothed, above Otsu's threshold."""
    difference = foreground.smooth(foreground.subtract_background(image, background, colour=False))
    return difference > foreground.otsu_threshold(difference)


def foreground_masks(
    pictures: Mapping[int, Mapping[str, Image]], backgrounds: Mapping[str, Background], names: Iterable[str]
) -> dict[tuple[str, int, str], Mask]:
    """The foreground of each picture by Otsu's threshold and by the evidence, ``{(way, frame, camera): mask}``."""
    masks = {}
    for name, (frame, images) in product(names, pictures.items()):
        evidence = foreground.foreground_evidence(images[name], backgrounds[name])
        masks["Otsu", frame, name] = otsu_mask(images[name], backgrounds[name])
        masks["evidence", frame, name] = evidence >= foreground.SURE
    return masks


def show_foregrounds(
    images: Mapping[str, Image], masks: Mapping[tuple[str, int, str], Mask], rig: Rig, truth: Truth, frame: int
) -> Figure:
    """Two views of one frame with covered heads, Otsu's foreground and the evidence."""
    names = list(dict.fromkeys(name for _, _, name in masks))
    colours = plotting.camera_colours(list(rig.cameras))
    fig, axes = plt.subplots(len(names), 3, figsize=(10, 5), layout="constrained")
    for row, name in zip(axes, names, strict=True):
        covered = cover_heads(images[name], rig[name], truth.frames[frame])
        plotting.show_image(row[0], covered, f"{name}, frame {frame}", colour=colours[name])
        plotting.show_image(row[1], masks["Otsu", frame, name], "difference and Otsu")
        plotting.show_image(row[2], masks["evidence", frame, name], "evidence of an object")
        u, v = rig[name].project([[true.x, true.y, 0.9] for true in truth.frames[frame]]).mean(axis=0)
        middle = float(np.clip(v, 270, TALLEST_ROW - 270))
        for ax in row:
            ax.set(xlim=(u - 400, u + 400), ylim=(middle + 270, middle - 270))
    return fig


def body_table(masks: Mapping[tuple[str, int, str], Mask], rig: Rig, truth: Truth) -> pd.DataFrame:
    """Share of the points along the middle of each body, knee to shoulder, that are foreground: by way, camera, person."""
    rows = []
    for (way, frame, name), mask in masks.items():
        for person in truth.frames[frame]:
            line = rig[name].project([[person.x, person.y, z] for z in np.arange(0.4, 1.45, 0.05)])
            u, v = np.rint(line[rig[name].inside(line)]).astype(int).T
            inside = (u < mask.shape[1]) & (v < mask.shape[0])
            rows.append([way, name, person.id, mask[v[inside], u[inside]].mean()])
    table = pd.DataFrame(rows, columns=["way", "camera", "person", "seen"])
    return table.pivot_table("seen", "way", ["camera", "person"])


# --- from two views to the floor


def show_planes(
    votes: Mapping[str, npt.NDArray[Any]], fused: Image, floor: Floor, heights: Sequence[float], people: Sequence[Any],
    cameras: Sequence[str], chosen: Sequence[int] = (0, 3, 5),
) -> Figure:  # fmt: skip
    """Both views on three parallel planes, and what the rule over the planes makes of them; crosses are the true feet."""
    fig, axes = plt.subplots(2, 2, figsize=(10, 8.6), layout="constrained", sharex=True, sharey=True)
    for ax, index in zip(axes.flat, chosen, strict=False):
        views = {name: vote[index] >= foreground.SURE for name, vote in votes.items()}
        plotting.show_views_on_floor(ax, views, floor, f"{heights[index]} m above the floor", cameras=cameras)
    plotting.show_floor(axes[1, 1], fused >= foreground.SURE, floor, "rule: half of the planes")
    for ax in axes.flat:
        for person in people:
            ax.plot(person.x, person.y, "+", color="#D55E00", markersize=12, markeredgewidth=2)
        if ax.get_legend():
            ax.legend(loc="lower right", fontsize=10)
    return fig


def show_polar(
    images: Mapping[str, Image], weights: npt.NDArray[Any], warps: Mapping[str, PolarWarp],
    cylinders: Sequence[Prism], rig: Rig, truth: Truth, frame: int,
) -> Figure:  # fmt: skip
    """Each camera's polar view with covered heads, and its evidence, with the cylinders that explain both."""
    colours = plotting.camera_colours(list(rig.cameras))
    fig, axes = plt.subplots(2, len(warps), figsize=(10, 5.4), layout="constrained")
    for k, (name, warp) in enumerate(warps.items()):
        covered = warp.warp(cover_heads(images[name], rig[name], truth.frames[frame]))
        plotting.show_image(axes[0, k], covered, f"{name}: polar view", colour=colours[name])
        limits: dict[str, Any] = {"cmap": "coolwarm", "vmin": -255, "vmax": 255}
        shown = plotting.show_image(axes[1, k], weights[k], "weight of the evidence", **limits)
        outline_cylinders(axes[0, k], warp, cylinders, color="#F0E442")
        outline_cylinders(axes[1, k], warp, cylinders, color="black")
        for ax in axes[:, k]:
            ax.invert_xaxis()  # azimuths run anticlockwise
    fig.colorbar(shown, ax=axes[1, :], label="background ... foreground", shrink=0.8)
    return fig


# --- which rule


def run_chains(
    footage: Recording, rig: Rig, backgrounds: Mapping[str, Background], groups: Iterable[Group],
    ways: Mapping[str, Settings], frames: Sequence[int],
) -> Found:  # fmt: skip
    """Every frame through a pipeline for each set of cameras and way."""
    chains = {
        (group, way): Pipeline(rig.select(group), backgrounds, settings)
        for group, (way, settings) in product(dict.fromkeys(groups), ways.items())
    }
    found: Found = {key: {} for key in chains}
    for frame, images in footage.images(frames):
        for key, chain in chains.items():
            found[key][frame] = chain.process(images, footage.time(frame)).objects
    return found


def score_table(
    found: Found, truth: Truth, groups: Mapping[str, Group], ways: Iterable[str], radius: float
) -> pd.DataFrame:
    """MODA, precision, recall, median error in cm and identity switches, by region and way."""
    rows = {}
    for (region, cameras), way in product(groups.items(), ways):
        score = metrics.evaluate(found[cameras, way], truth, roi=region, radius=radius)
        rows[region, way] = {
            "people": score.truth_count,
            "MODA": score.moda,
            "precision": score.precision,
            "recall": score.recall,
            "median error (cm)": np.nan if score.error_median_m is None else 100 * score.error_median_m,
            "id switches": score.id_switches,
        }
    table = pd.DataFrame.from_dict(rows, orient="index")
    return table.set_axis(pd.MultiIndex.from_tuples(rows, names=["region", "way"]))


def fault_table(
    found: Found, truth: Truth, groups: Mapping[str, Group], ways: Iterable[str], radius: float
) -> pd.DataFrame:
    """People missed plus false objects, a column for each marked frame, by region and way."""
    faults: dict[tuple[str, str], dict[int, int]] = defaultdict(dict)
    for (region, cameras), way, frame in product(groups.items(), list(ways), truth.frames):
        score = metrics.evaluate(found[cameras, way], truth.select([frame]), roi=region, radius=radius)
        faults[region, way][frame] = score.fn + score.fp
    return pd.DataFrame(faults).T.rename_axis(["region", "way"])


def show_faults(faults: pd.DataFrame) -> Figure:
    """:func:`fault_table` as a picture for each region."""
    regions = list(dict.fromkeys(faults.index.get_level_values("region")))
    fig, axes = plt.subplots(2, 2, figsize=(10, 6), layout="constrained", squeeze=False)
    for ax, region in zip(axes.flat, regions, strict=True):
        part = faults.loc[region]
        shown = ax.imshow(part, cmap="Purples", vmin=0, vmax=4, aspect="auto", interpolation="nearest")
        ax.set(title=region, yticks=range(len(part)), yticklabels=part.index, xlabel="frame")
        ax.set_xticks(range(0, part.shape[1], 5), part.columns[::5])
    fig.colorbar(shown, ax=axes, label="faults")
    return fig


def bearing_table(rig: Rig, names: Iterable[str], feet: Sequence[Sequence[float]]) -> pd.DataFrame:
    """The angle between two people as each camera sees them, and the angle that a person 0.5 m wide takes, in degrees."""
    rows = {}
    for name in names:
        views = np.asarray(feet, dtype=float) - rig[name].centre_m[:2]
        distances = np.linalg.norm(views, axis=1)
        apart = np.arccos(np.clip(views[0] @ views[1] / distances.prod(), -1, 1))
        rows[name] = {"apart": np.degrees(apart), "width of the nearer": np.degrees(0.5 / distances.min())}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("camera (degrees)")


def miss_table(told: Mapping[str, Sequence[ObjectVector]], people: Sequence[TrueObject]) -> pd.DataFrame:
    """Distance in cm from each person to the nearest object that each way reports, NaN if there is none."""
    rows = {}
    for person in people:
        place = np.array([person.x, person.y])
        rows[person.id] = {
            way: min((100 * float(np.linalg.norm(place - each.position_m)) for each in objects), default=np.nan)
            for way, objects in told.items()
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("person (cm)")


def show_worst(
    images: Mapping[str, Image], backgrounds: Mapping[str, Background], told: Mapping[str, Sequence[ObjectVector]],
    rig: Rig, names: Sequence[str], truth: Truth, frame: int,
) -> Figure:  # fmt: skip
    """Two views of a frame with covered heads, their evidence, and what each way puts on the floor."""
    colours = plotting.camera_colours(list(rig.cameras))
    people = truth.frames[frame]
    fig = plt.figure(figsize=(10, 6.2), layout="constrained")
    axes: Any = fig.subplot_mosaic("abm;cdm", width_ratios=[1, 1, 1.3])
    for (left, right), name in zip((("a", "b"), ("c", "d")), names, strict=True):
        covered = cover_heads(images[name], rig[name], people)
        plotting.show_image(axes[left], covered, f"{name}, frame {frame}", colour=colours[name])
        evidence = foreground.foreground_evidence(images[name], backgrounds[name])
        plotting.show_image(axes[right], evidence, "evidence")
        u, v = rig[name].project([[true.x, true.y, z] for true in people for z in (0, 1.8)]).mean(axis=0)
        middle = float(np.clip(v, 260, TALLEST_ROW - 260))
        for ax in (axes[left], axes[right]):
            ax.set(xlim=(u - 260, u + 260), ylim=(middle + 260, middle - 260))
    plan = axes["m"]
    plotting.show_floor(plan, np.full(rig.floor.shape, 0.05), rig.floor, "map: found and true", vmax=1)
    for (way, objects), mark in zip(told.items(), ("s", "o"), strict=True):
        spots = np.reshape([each.position_m for each in objects], (-1, 2))
        fill = "none" if mark == "s" else "0.2"
        plan.plot(*spots.T, mark, markerfacecolor=fill, color="0.2", markersize=9, label=way)
    plan.plot(*np.array([[true.x, true.y] for true in people]).T, "+", color="#D55E00", markersize=14, label="truth")
    plan.legend(loc="lower left", fontsize=10)
    return fig


# --- a camera that fails


class Failure(NamedTuple):
    """One frame of a trial in which a camera fails."""

    kind: str
    cameras: Group
    frame: int
    result: FrameResult


def fail(
    footage: Recording, trials: Mapping[tuple[str, Group], Pipeline], camera: str, span: range, broken: range
) -> list[Failure]:
    """Let a camera repeat its picture ("frozen") or send black ("black") during the frames ``broken``."""
    failures, held = [], None
    for frame, images in footage.images(span):
        held = images[camera] if held is None or frame <= broken.start else held
        for (kind, cameras), chain in trials.items():
            sent = images[camera]
            if frame in broken:
                sent = held if kind == "frozen" else np.zeros_like(held)
            result = chain.process({**images, camera: sent}, footage.time(frame))
            failures.append(Failure(kind, cameras, frame, result))
    return failures


def failure_table(failures: Iterable[Failure], camera: str) -> pd.DataFrame:
    """A row a frame: whether the camera was excluded and why, the unknown share of the map, the number of objects."""
    rows = [
        {
            "kind": each.kind,
            "cameras": "+".join(each.cameras),
            "frame": each.frame,
            "excluded": each.result.excluded.get(camera, ""),
            "unknown": float((each.result.map.data == -1).mean()),
            "objects": len(each.result.objects),
        }
        for each in failures
    ]
    return pd.DataFrame(rows)


def show_failures(failures: Iterable[Failure], truth: Truth, moments: Sequence[int], camera: str) -> Figure:
    """The map of each trial before and while the camera fails."""
    shown = [each for each in failures if each.frame in moments]
    shown.sort(key=lambda each: (each.kind, each.frame), reverse=False)
    fig, axes = plt.subplots(2, 2, figsize=(10, 8.6), layout="constrained", sharex=True, sharey=True)
    for ax, each in zip(axes.flat, shown, strict=True):
        state = f"{camera} {each.kind}" if each.result.excluded else "all well"
        title = f"{'+'.join(each.cameras)}, frame {each.frame}: {state}"
        people = truth.frames.get(each.frame, [])
        plotting.show_map(ax, each.result.map, each.result.objects, truth=people, title=title)
        if legend := ax.get_legend():
            legend.remove()
    return fig
