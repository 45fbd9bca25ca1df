"""Chapter 13: two rooms scored alike, thresholds tried, verdicts counted."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb

from occlib import formats, lab, metrics, occlusion
from occlib.finding import Regions
from occlib.pipeline import Pipeline, Settings, backgrounds_of
from occlib.plotting import camera_colours, new_figure, outline_on_image, show_floor, show_footprints, show_image
from occlib.registration import FloorWarp
from occlib.reproduce import find_root, recorded_metrics

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from occlib.base.arrays import Image, Mask
    from occlib.foreground import Background
    from occlib.formats import TrueObject
    from occlib.geometry import Rig
    from occlib.recordings import Recording

VERDICT_COLOURS = ("#009E73", "#56B4E9", "#E69F00", "#D55E00", "#999999", "#DDDDDD")
"""Of the verdicts, from "holds" to "the paper is silent"."""

SHOWN_PX = (70, 570, 390, 50)
"""The part of a view that :func:`rooms_figure` shows: left, right, bottom, top."""

HOLDS_OR_NOT: tuple[tuple[str, str, str, str, str], ...] = (
    ("hidden robot on the map", "whole masks", "13/vinyl_paper_hidden", "a mask that breaks", "13/wooden_paper_hidden"),
    ("objects found, MODA", "vinyl, dark cabinet", "13/vinyl_paper_moda", "planks, window, pale cabinet", "13/wooden_paper_moda"),
    ("ghosts a frame", "4 objects", "10/ghosts_objects_4_measured", "12 objects", "10/ghosts_objects_12_measured"),
    ("MODA of crowds", "opposite cameras", "10/moda_angle_180", "15 degrees apart", "10/moda_angle_15"),
    ("MODA of crowds", "cameras at 4 m", "10/moda_height_4", "cameras at 1.2 m", "10/moda_height_1.2"),
    ("base covered by the map", "upright objects", "10/worst_coverage_rays", "a ball", "10/worst_coverage_ball"),
    ("robots of 6 found by SSD", "background subtracted", "03/difference_right", "plain grey picture", "03/grey_right"),
    ("found under changed light", "intensity adjusted", "03/light_found_chain_ssd", "plain", "03/light_found_ssd"),
    ("robots that arrive", "maps of two views", "09/and_arrive", "maps of one view", "09/one_view_arrive"),
)  # fmt: skip
"""What was measured, a condition under which it holds and its metric, one under which it does not and its metric."""


def score_room(
    recording: Recording, settings: Mapping[str, Settings], *, frames: Sequence[int], radius: float = 0.3
) -> pd.DataFrame:
    """Each set of settings run over the same frames of a rendered recording.

    Template matching is left out: it names objects and measures them, and neither name nor size is scored.

    Returns
    -------
    DataFrame
        By the name of the settings: ``hidden on the map``, the share of frames with a robot hidden entirely from one camera that have it
        on the map; ``MODA``; ``ghosts a frame``; ``found``, the recall of all objects. A match is closer than ``radius`` m.
    """
    import pandas as pd

    truth = formats.load_truth(recording.path / "truth.json").select(frames)
    backgrounds, pictures, rows = backgrounds_of(recording), dict(recording.images(frames)), {}
    for name, one in settings.items():
        pipeline = Pipeline(recording.rig, backgrounds, _without_labels(one))
        found = {f: pipeline.process(images, recording.time(f)).objects for f, images in pictures.items()}
        score = metrics.evaluate(found, truth, radius=radius)
        (hidden,) = metrics.recall_by_hidden_fraction(
            found, truth, edges=(0.999, 1.0), best_below=0.9, radius=radius, cameras=list(recording.rig.cameras)
        )
        rows[name] = {
            "hidden on the map": hidden["recall"],
            "MODA": score.moda,
            "ghosts a frame": score.ghosts_per_frame,
            "found": score.recall,
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def _without_labels(settings: Settings) -> Settings:
    finder = settings.finder
    return replace(settings, finder=replace(finder, identify=None)) if isinstance(finder, Regions) else settings


def mask_shares(
    recording: Recording, settings: Mapping[str, Settings], *, camera: str, object_id: str, frames: Sequence[int]
) -> pd.Series[float]:
    """The share of an object's visible pixels that a view's foreground has, by the name of the settings.

    Each is the mean over some frames of a rendered recording.
    """
    import pandas as pd

    scene, background = lab.load_scene(recording.path), backgrounds_of(recording)[camera]
    scene = replace(scene, rig=scene.rig.select([camera]))
    shares: dict[str, list[float]] = {name: [] for name in settings}
    for frame, images in recording.images(frames):
        visible = lab.silhouettes(scene, frame)[camera][object_id][1]
        for name, one in settings.items():
            evidence = one.foreground.evidence(images[camera], background)
            shares[name].append(float((evidence.values > evidence.level)[visible].mean()))
    return pd.DataFrame(shares).mean()


def views_on_floor(recording: Recording, images: Mapping[str, Image], settings: Settings) -> dict[str, Mask]:
    """Each view's foreground on the floor: its evidence warped, then thresholded, bool (ny, nx)."""
    return _on_floor(images, settings, backgrounds_of(recording), _warps(recording))


def _warps(recording: Recording) -> dict[str, FloorWarp]:
    return {name: FloorWarp(camera, recording.rig.floor) for name, camera in recording.rig.cameras.items()}


def _on_floor(
    images: Mapping[str, Image],
    settings: Settings,
    backgrounds: Mapping[str, Background],
    warps: Mapping[str, FloorWarp],
) -> dict[str, Mask]:
    seen = {name: settings.foreground.evidence(images[name], backgrounds[name]) for name in warps}
    return {name: warps[name].warp(one.values) > one.level for name, one in seen.items()}


def sweep_thresholds(
    recording: Recording, settings: Mapping[int, Settings], *, frame: int, object_id: str
) -> pd.DataFrame:
    """What AND makes of one frame at each threshold.

    Returns
    -------
    DataFrame
        By grey levels: the share of the object's true footprint that is on the map, and claimed over true area.
    """
    import pandas as pd

    ((_, images),) = recording.images([frame])
    objects = formats.load_truth(recording.path / "truth.json").frames[frame]
    (own,) = (true.footprint or () for true in objects if true.id == object_id)
    outlines = [true.footprint or () for true in objects]
    rows, backgrounds, warps = {}, backgrounds_of(recording), _warps(recording)
    for level, one in settings.items():
        occupied = occlusion.fuse(list(_on_floor(images, one, backgrounds, warps).values()), "and")
        covered = metrics.footprint_coverage(occupied, recording.rig.floor, [own])[0]
        claimed = metrics.claimed_area_ratio(occupied, recording.rig.floor, outlines)
        rows[level] = {"hidden robot covered": covered, "claimed / true": claimed}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("threshold")


def frame_time_ms(recording: Recording, settings: Settings, *, frames: Sequence[int]) -> float:
    """Median time in ms that the chain takes for one instant, all cameras of the recording together; the first is left out."""
    pipeline, took = Pipeline(recording.rig, backgrounds_of(recording), settings), []
    for frame, images in recording.images(frames):
        start = time.perf_counter()
        pipeline.process(images, recording.time(frame))
        took.append(1000 * (time.perf_counter() - start))
    return float(np.median(took[1:]))


def conditions_table() -> pd.DataFrame:
    """When the paper's claims hold and when not: :data:`HOLDS_OR_NOT` with its numbers."""
    import pandas as pd

    known = recorded_metrics(find_root())
    rows = [(what, good, known[g], bad, known[b]) for what, good, g, bad, b in HOLDS_OR_NOT]
    return pd.DataFrame(rows, columns=["measured", "holds with", "value", "fails with", "value there"])


def rooms_figure(rooms: Mapping[str, tuple[Recording, int]], settings: Settings) -> Figure:
    """A row a room: the left view with the hidden robot's place, each view's foreground, and both on the floor.

    Parameters
    ----------
    rooms
        For each title a rendered recording and the frame that is shown.
    """
    fig, axes = new_figure(4, len(rooms), width=14, height=3.2 * len(rooms) + 0.5)
    for row, (title, (recording, frame)) in zip(np.atleast_2d(axes), rooms.items(), strict=True):
        ((_, images),) = recording.images([frame])
        truth = formats.load_truth(recording.path / "truth.json").frames[frame]
        backgrounds = backgrounds_of(recording)
        masks = {}
        for name in recording.rig.cameras:
            evidence = settings.foreground.evidence(images[name], backgrounds[name])
            masks[name] = evidence.values > evidence.level
        _room_row(row, recording.rig, images["left"], masks, views_on_floor(recording, images, settings), truth)
        row[0].set_title(f"{title}: left view", fontsize=13)
    return fig


def _room_row(
    row: Any,
    rig: Rig,
    image: Image,
    masks: Mapping[str, Mask],
    views: Mapping[str, Mask],
    truth: Sequence[TrueObject],
) -> None:
    view, *others = row
    colours = camera_colours(list(rig.cameras))
    show_image(view, image)
    for true in truth:
        if true.hidden_fraction.get("left", 0) > 0.9:
            for colour, width in (("black", 4), ("#F0E442", 2)):
                outline_on_image(view, rig["left"], true.footprint or (), color=colour, linewidth=width)
    for ax, (name, mask) in zip(others, masks.items(), strict=False):
        show_image(ax, mask)
        ax.set_title(f"{name} foreground", color=colours[name], fontsize=13)
    for ax in (view, *others[:-1]):
        ax.set(xlim=SHOWN_PX[:2], ylim=SHOWN_PX[2:])
    canvas = np.ones((*rig.floor.shape, 3))
    for name, seen in views.items():
        canvas[seen] = 0.45 + 0.55 * np.array(to_rgb(colours[name]))
    canvas[np.all(list(views.values()), axis=0)] = 0.0
    show_floor(others[-1], canvas, rig.floor)
    show_footprints(others[-1], truth)
    others[-1].set_title("on the floor: black is AND", fontsize=13)
    others[-1].get_legend().remove()
    others[-1].tick_params(labelsize=11)
    others[-1].set_xlabel("x (m)", fontsize=12)
    others[-1].set_ylabel("y (m)", fontsize=12)


def verdict_figure(counts: Mapping[str, pd.DataFrame]) -> Figure:
    """Verdicts as stacked bars, a panel for each table of :func:`occlib.course.verdict_counts`, each bar with its numbers."""
    fig, axes = new_figure(1, len(counts), width=11, height=2.9 * len(counts) + 0.8)
    for ax, (title, table) in zip(np.atleast_1d(axes), counts.items(), strict=True):
        start = np.zeros(len(table))
        for verdict, colour in zip(table.columns, VERDICT_COLOURS, strict=True):
            width = table[verdict].to_numpy()
            ax.barh(table.index, width, left=start, color=colour, edgecolor="white", label=verdict)
            for y, (left, value) in enumerate(zip(start, width, strict=True)):
                if value:
                    ax.text(left + value / 2, y, str(value), ha="center", va="center", fontsize=12)
            start += width
        ax.invert_yaxis()
        ax.set_xlim(0, 1.03 * start.max())
        ax.set_title(title, fontsize=13, loc="left")
        ax.set_xlabel("entries", fontsize=12)
        ax.tick_params(labelsize=12)
    handles, labels = np.atleast_1d(axes)[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=12, frameon=False)
    return fig
