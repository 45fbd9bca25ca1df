"""Tables and drawings of chapter 07: shadows of solids, what the AND keeps of them, and what it loses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from occlib import localization, metrics, occlusion, plotting
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.extras import pandas as pd
from occlib.course.drawings import fill_hull
from occlib.foreground import Background
from occlib.formats import TrueObject
from occlib.geometry import Floor, Rig
from occlib.pipeline import FrameResult, Pipeline, settings_for

ALONG, ACROSS, ASPECT = "along (m)", "across (m)", "along / across"


# --- solids and their shadows


def box_corners(x: tuple[float, float], y: tuple[float, float], height: float) -> FloatArray:
    """The eight corners of an upright box on the floor, (8, 3) in m."""
    return np.array(list(product(x, y, (0.0, height))))


def cast_shadows(rig: Rig, solids: Mapping[str, npt.ArrayLike]) -> dict[str, dict[str, Mask]]:
    """The shadow on the floor of each convex solid, for each camera as a lamp.

    Parameters
    ----------
    rig
        Floor and cameras.
    solids
        ``{name: corners}``, (N, 3) in m. Each corner's shadow is where its pixel lands on the floor.

    Returns
    -------
    ``{camera: {name: bool (ny, nx)}}``.
    """
    from scipy.spatial import ConvexHull

    shadows: dict[str, dict[str, Mask]] = {name: {} for name in rig.cameras}
    for (name, camera), (solid, corners) in product(rig.cameras.items(), solids.items()):
        landing = camera.pixels_to_floor(camera.project(corners))
        shadows[name][solid] = rig.floor.polygon_mask(landing[ConvexHull(landing).vertices])
    return shadows


def draw_figure_8(
    rig: Rig, empty: Mapping[str, Image], solids: Mapping[str, npt.ArrayLike], views: Mapping[str, Mask]
) -> Figure:
    """Two views of some solids on the empty floor, and their shadows from above: the arrangement of Fig 8.

    Parameters
    ----------
    rig
        Floor and two cameras.
    empty
        A picture of the empty floor for each camera.
    solids
        ``{name: corners}``, (N, 3) in m; the first one light, the others dark.
    views
        All solids' shadows, for each camera.
    """
    fig = Figure(figsize=(10, 3.4), layout="constrained")
    axes = fig.subplots(1, 3, width_ratios=(1, 1, 1.45))
    colours = plotting.camera_colours(list(rig.cameras))
    shades = dict(zip(solids, ["#56B4E9", *["0.15"] * len(solids)], strict=False))
    for ax, (name, camera), letter in zip(axes, rig.cameras.items(), "ab", strict=False):
        plotting.show_image(ax, empty[name], "", colour=colours[name])
        ax.set_title(f"({letter}) {name} view", color=colours[name], fontsize=12)
        distances = {
            solid: np.linalg.norm(np.asarray(corners, dtype=float).mean(axis=0) - camera.centre_m)
            for solid, corners in solids.items()
        }
        for solid in sorted(solids, key=distances.__getitem__, reverse=True):  # the far one first
            fill_hull(ax, camera.project(solids[solid]), facecolor=shades[solid])
        ax.set(xlim=(180, 460), ylim=(340, 110))
    plotting.show_views_on_floor(axes[2], views, rig.floor)
    axes[2].set_title("(c) top view after resolving", fontsize=12)
    axes[2].set(xlim=(-1.3, 1.3), ylim=(-0.8, 0.8))
    axes[2].legend(loc="upper right", fontsize=11)
    return fig


def draw_views_on_floor(
    views: Mapping[str, Mapping[str, Mask]],
    floor: Floor,
    truth: Sequence[TrueObject | npt.ArrayLike],
    window_m: tuple[float, float, float, float],
) -> Figure:
    """A panel for each set of views: their foreground on the floor and the true footprints, one legend below.

    Parameters
    ----------
    views
        ``{title: {camera: bool (ny, nx)}}``.
    floor, truth
        As for :func:`occlib.plotting.show_views_on_floor` and :func:`occlib.plotting.show_footprints`.
    window_m
        ``(x_min, x_max, y_min, y_max)`` that is shown.
    """
    width, height = window_m[1] - window_m[0], window_m[3] - window_m[2]
    fig, axes = plotting.new_figure(len(views), width=10, height=10 / len(views) * height / width + 1.3)
    for ax, (title, masks) in zip(np.atleast_1d(axes), views.items(), strict=True):
        plotting.show_views_on_floor(ax, masks, floor)
        plotting.show_footprints(ax, truth)
        ax.set_title(title, fontsize=12)
        ax.set(xlim=window_m[:2], ylim=window_m[2:])
        ax.get_legend().remove()
    for ax in np.atleast_1d(axes)[1:]:
        ax.set_ylabel("")
    entries: dict[str, Any] = {}
    for ax in np.atleast_1d(axes):
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    fig.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=len(entries), fontsize=11)
    return fig


# --- what the maps claim


def claims(
    masks: Mapping[str, Mapping[str, Mask]], floor: Floor, footprints: Sequence[npt.ArrayLike], names: Sequence[str]
) -> pd.DataFrame:
    """Claimed over true area, and the covered part of each footprint, for every map.

    Parameters
    ----------
    masks
        ``{masks: {map: bool (ny, nx)}}``.
    floor, footprints
        As for :func:`occlib.metrics.claimed_area_ratio`.
    names
        Of the footprints.
    """
    rows = {
        (case, source): [
            metrics.claimed_area_ratio(mask, floor, footprints),
            *metrics.footprint_coverage(mask, floor, footprints),
        ]
        for case, named in masks.items()
        for source, mask in named.items()
    }
    columns = ["claimed / true", *(f"{name} covered" for name in names)]
    return _table(rows, columns, ["masks", "map"])


def position_errors(results: Mapping[str, FrameResult], truth: Sequence[TrueObject], *, radius: float) -> pd.DataFrame:
    """Each detection of each profile with the true object it is matched to, and how far it is off.

    Parameters
    ----------
    results
        By profile.
    truth
        The true objects of this instant.
    radius
        A detection this close, in m, counts as found.
    """
    rows: dict[tuple[str, str], list[object]] = {}
    places = [(true.x, true.y) for true in truth]
    for profile, result in results.items():
        for i, j, distance in metrics.match_points([one.position_m for one in result.objects], places, radius):
            one = result.objects[i]
            rows[profile, str(truth[j].id)] = [100 * distance, one.area_m2, ", ".join(one.hidden_in)]
    return _table(rows, ["error (cm)", "area (m2)", "hidden in"], ["profile", "object"])


def largest_region(mask: Mask) -> localization.Region:
    """The largest connected region of a mask."""
    return max(localization.find_regions(mask)[1], key=lambda region: region.area)


def extents(masks: Mapping[str, Mapping[str, Mask]], floor: Floor) -> pd.DataFrame:
    """Extent of the largest region along x and along y, and their ratio, for every map."""
    rows = {}
    for case, named in masks.items():
        for source, mask in named.items():
            along, across = (cells * floor.resolution for cells in largest_region(mask).box[2:])
            rows[case, source] = [along, across, along / across]
    return _table(rows, [ALONG, ACROSS, ASPECT], ["masks", "map"])


# --- the ball


def grazing_ends(rig: Rig, *, centre_x: float, radius_m: float) -> pd.DataFrame:
    """Where the shadow of a ball on the floor begins and ends along x, for cameras that hang on the x axis.

    Parameters
    ----------
    rig
        Cameras with ``y = 0``.
    centre_x, radius_m
        Of the ball, in m.

    Returns
    -------
    A row for each camera, with ``near`` and ``far`` end in m.
    """
    ends = {}
    for name, camera in rig.cameras.items():
        x, _, height = camera.centre_m
        away, distance = np.sign(centre_x - x), abs(centre_x - x)
        phi = np.arctan2(height - radius_m, distance)
        delta = np.arcsin(radius_m / np.hypot(distance, height - radius_m))
        ends[name] = x + away * height / np.tan([phi + delta, phi - delta])
    return pd.DataFrame.from_dict(ends, orient="index", columns=["near", "far"])


def draw_ball_in_section(rig: Rig, ends: pd.DataFrame, *, centre_x: float, radius_m: float) -> Figure:
    """A ball in section with the grazing rays of two cameras, and below the floor the shadows and their overlap.

    Parameters
    ----------
    rig
        Two cameras, ``ends.index``.
    ends
        What :func:`grazing_ends` returns.
    centre_x, radius_m
        Of the ball, in m.
    """
    fig, ax = plotting.new_figure(width=10, height=4)
    ax.add_patch(Circle((centre_x, radius_m), radius_m, color="0.75"))
    colours = plotting.camera_colours(list(rig.cameras))
    for row, (name, (near, far)) in enumerate(ends.iterrows()):
        x, _, height = rig[str(name)].centre_m
        for landing in (near, far):
            ax.plot([x, landing], [height, 0], color=colours[str(name)], lw=1.5)
        _bar(ax, sorted((near, far)), row, colours[str(name)], f"{name} shadow")
    shared = [ends.max(axis=1).nsmallest(1).item(), ends.min(axis=1).nlargest(1).item()]
    _bar(ax, sorted(shared), len(ends), "0.1", "both")
    _bar(ax, (centre_x - radius_m, centre_x + radius_m), len(ends) + 1, "0.75", "the ball's diameter")
    ax.axhline(0, color="0.3", lw=1)
    ax.set(xlim=(-1.6, 1.9), ylim=(-0.6, 0.8), yticks=[0, 0.3, 0.6], aspect="equal")
    ax.set(xlabel="x (m), along the cameras' axis", ylabel="height (m)")
    return fig


def _bar(ax: Axes, ends: Sequence[float], row: int, colour: str, label: str) -> None:
    top = -0.04 - 0.14 * row
    ax.fill_between(ends, top - 0.1, top, color=colour, lw=0)
    ax.annotate(label, (1.05, top - 0.05), va="center", fontsize=11, color="0.2" if colour == "0.75" else colour)


# --- settings varied


def sweep_threshold(
    rig: Rig,
    backgrounds: Mapping[str, Background],
    images: Mapping[str, Image],
    levels: Iterable[float],
    footprints: Sequence[npt.ArrayLike],
) -> pd.DataFrame:
    """What the profile ``and`` claims with one fixed threshold in every view, and the shape of its largest region.

    Parameters
    ----------
    rig, backgrounds, images
        What the pipeline is given.
    levels
        Thresholds in grey levels.
    footprints
        The true ones.

    Returns
    -------
    A row for each threshold: claimed over true area of each view and ``fused``, number of ``objects``, ``aspect``.
    """
    rows = {}
    for level in levels:
        result = Pipeline(rig, backgrounds, settings_for("and", threshold=float(level))).process(images, 0.0)
        maps = {**result.views, "fused": result.occupied}
        box = largest_region(result.occupied).box
        rows[level] = {
            **{name: metrics.claimed_area_ratio(mask, rig.floor, footprints) for name, mask in maps.items()},
            "objects": len(result.objects),
            "aspect": box[2] / box[3],
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("threshold")


def draw_sweep(sweep: pd.DataFrame, *, otsu: float, ideal_aspect: float) -> Figure:
    """What :func:`sweep_threshold` returns, in three panels, with Otsu's threshold and the ideal silhouettes' aspect."""
    fig, axes = plotting.new_figure(3, width=10, height=3.8)
    cameras = [name for name in sweep.columns if name not in ("fused", "objects", "aspect")]
    for name, colour in {**plotting.camera_colours(cameras), "fused": "0.1"}.items():
        axes[0].plot(sweep.index, sweep[name], color=colour, marker=".", label=name)
    axes[1].step(sweep.index, sweep["objects"], color="0.1", where="mid")
    axes[2].plot(sweep.index, sweep["aspect"], color="0.1", marker=".", label="fused")
    axes[2].axhline(ideal_aspect, color="0.5", ls=":", label="ideal silhouettes")
    titles = ("claimed area / true area", "objects on the map", "ball: along / across")
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, fontsize=12)
        ax.set(xlabel="threshold (grey levels)")
        ax.axvline(otsu, color="#D55E00", ls="--", label="Otsu, left view")
    for ax in (axes[0], axes[2]):
        ax.axhline(1, color="0.6", lw=0.8)
        ax.legend(fontsize=10)
    axes[0].set(ylim=(0, None))
    axes[1].set(yticks=[0, 1, 2, 3])
    axes[2].set(ylim=(0.4, None))
    return fig


def draw_maps(results: Mapping[str, FrameResult], truth: Sequence[TrueObject]) -> Figure:
    """The map of each result with its objects, side by side; the title says how much of it is unknown."""
    fig, axes = plotting.new_figure(len(results), width=10, height=4.4)
    for ax, (title, result) in zip(np.atleast_1d(axes), results.items(), strict=True):
        plotting.show_map(ax, result.map, result.objects, truth=truth)
        ax.set_title(f"{title}: {len(result.objects)} on the map, {unknown_share(result):.0%} unknown", fontsize=12)
        ax.legend(loc="upper right", fontsize=11)
    for ax in np.atleast_1d(axes)[1:]:
        ax.set_ylabel("")
    return fig


def unknown_share(result: FrameResult) -> float:
    """The share of the map's cells that are unknown."""
    return float((result.map.data == -1).mean())


# --- where the rule fails


def cut_hole(
    images: Mapping[str, Image],
    backgrounds: Mapping[str, Background],
    camera: str,
    centre_px: npt.ArrayLike,
    side_px: int,
) -> dict[str, Image]:
    """Copies of the pictures; in one of them, a square shows the empty background.

    Parameters
    ----------
    images, backgrounds
        For each camera.
    camera
        The one whose picture gets the hole.
    centre_px, side_px
        Of the square: ``(u, v)`` and its side, in px.
    """
    holed = {name: image.copy() for name, image in images.items()}
    u, v = np.rint(np.asarray(centre_px, dtype=float)).astype(int)
    half = side_px // 2
    hole = np.s_[max(0, v - half) : v + half, max(0, u - half) : u + half]
    holed[camera][hole] = backgrounds[camera].image[hole]
    return holed


def compare_rules(
    rig: Rig,
    backgrounds: Mapping[str, Background],
    pictures: Mapping[str, Mapping[str, Image]],
    footprints: Sequence[npt.ArrayLike],
    names: Sequence[str],
    rules: Sequence[str] = ("and", "or"),
) -> pd.DataFrame:
    """Objects, coverage and claimed area of the profile ``and`` with each rule, for each set of pictures.

    Parameters
    ----------
    rig, backgrounds
        What the pipeline is given.
    pictures
        ``{label: {camera: picture}}``.
    footprints, names
        The true footprints and what they are called.
    rules
        As for :func:`occlib.occlusion.fuse`.
    """
    rows = {}
    for rule, (label, images) in product(rules, pictures.items()):
        result = Pipeline(rig, backgrounds, settings_for("and", rule=rule)).process(images, 0.0)
        covered = metrics.footprint_coverage(result.occupied, rig.floor, footprints)
        ratio = metrics.claimed_area_ratio(result.occupied, rig.floor, footprints)
        rows[rule, label] = [len(result.objects), *covered, ratio]
    columns = ["objects", *(f"{name} covered" for name in names), "claimed / true"]
    return _table(rows, columns, ["rule", "left picture"])


def behind_others(rig: Rig, views: Mapping[str, Mask], *, min_area: int = 50) -> pd.DataFrame:
    """The regions of the AND, and how much of each every view has behind another one.

    Parameters
    ----------
    rig
        Floor and cameras.
    views
        ``{camera: bool (ny, nx)}``: foreground on the floor.
    min_area
        Of a region, in cells.

    Returns
    -------
    A row for each region: ``x (m)`` of its centroid, ``area (m2)``, ``behind, <camera>``.
    """
    labels, regions = localization.find_regions(occlusion.fuse(list(views.values())), min_area=min_area)
    stations = [rig.floor.cells(rig[name].centre_m[None, :2])[0] for name in views]
    hidden = occlusion.hidden_fractions(labels, list(views.values()), stations)
    table = pd.DataFrame(hidden, columns=[f"behind, {name}" for name in views])
    table.insert(0, "area (m2)", [region.area * rig.floor.cell_area for region in regions])
    table.insert(0, "x (m)", [float(rig.floor.points(region.centroid)[0]) for region in regions])
    return table.sort_values("x (m)", ignore_index=True)


def _table(rows: Mapping[tuple[str, str], Sequence[Any]], columns: Sequence[str], index: Sequence[str]) -> pd.DataFrame:
    labels = pd.MultiIndex.from_tuples(list(rows), names=list(index))
    return pd.DataFrame(list(rows.values()), index=labels, columns=list(columns))
