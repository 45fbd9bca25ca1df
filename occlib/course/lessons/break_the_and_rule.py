"""Chapter 10: where AND claims too much, invents and deletes; measured on crowds of exact silhouettes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure

from occlib import lab, metrics, occlusion, plotting
from occlib.base.arrays import FloatArray, Mask
from occlib.base.extras import pandas as pd
from occlib.geometry import Camera, Floor, Rig

Crowd = Sequence[lab.SceneObject]

AXIS_LABELS = {
    "objects": "number of objects",
    "angle": "angle between the cameras (degrees)",
    "height": "height of the cameras (m)",
}
"""What :func:`ghost_study` varies."""

SMEAR_LABELS = {"h": "object's height h (m)", "d": "distance d of its far edge (m)", "H": "camera's height H (m)"}

MEASURED = "#D55E00"


def umbra_figure(shadows: Mapping[str, Mask], crowd: Crowd, floor: Floor, *, close_up: tuple[float, ...]) -> Figure:
    """Shadows on the floor with true outlines, and a part of it, ``close_up`` = ``(x_min, x_max, y_min, y_max)`` in m."""
    fig, axes = plotting.new_figure(2, width=10, height=4)
    for ax, title in zip(axes, ("the whole floor", "below the ball"), strict=True):
        plotting.show_views_on_floor(ax, shadows, floor, title)
        plotting.show_footprints(ax, lab.truth_of([crowd]).frames[0])
        ax.get_legend().remove()
    axes[1].set(xlim=close_up[:2], ylim=close_up[2:])
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=11)
    return fig


def worst_coverage(rig: Rig, crowds: Sequence[Crowd]) -> pd.Series[float]:
    """The least covered share of any base under AND, for shadows by rays through cells and for masks of pixels."""
    simulation, least = lab.Simulation(rig), {"rays through cells": 1.0, "masks of pixels": 1.0}
    for crowd in crowds:
        shadows = [exact_shadow(camera, crowd, rig.floor) for camera in rig.cameras.values()]
        maps = (occlusion.fuse(shadows), simulation.occupied(simulation.masks(crowd)))
        for name, occupied in zip(least, maps, strict=True):
            covered = metrics.footprint_coverage(occupied, rig.floor, [lab.base_m(each) for each in crowd])
            least[name] = min(least[name], float(covered.min()))
    return pd.Series(least, name="least covered share")


def exact_shadow(camera: Camera, crowd: Crowd, floor: Floor) -> Mask:
    """Cells that any of the objects hides from the camera, bool (ny, nx), by rays."""
    return np.asarray(np.any([lab.shadow_mask(camera, each, floor) for each in crowd], axis=0))


def ball_coverage(heights: Sequence[float], *, diameter: float = 0.6) -> FloatArray:
    """Share of a ball's vertical projection that AND covers under two opposite cameras, one value a camera height in m."""
    ball, shares = lab.upright("ellipsoid", (0.0, 0.0), diameter, diameter), []
    for height in heights:
        rig = lab.wall_rig(2, height=height)
        umbra = occlusion.fuse([lab.shadow_mask(camera, ball, rig.floor) for camera in rig.cameras.values()])
        shares.append(float(metrics.footprint_coverage(umbra, rig.floor, [lab.base_m(ball)])[0]))
    return np.array(shares)


def smear_table(varied: Mapping[str, Sequence[float]], **case: float) -> pd.DataFrame:
    """Smear of a cylinder, predicted and measured on the map, in m.

    Parameters
    ----------
    varied
        Values in m of ``h`` (object), ``d`` (distance of its far edge) or ``H`` (camera), one varied at a time.
    case
        ``h``, ``d`` and ``H`` where they are not varied.
    """
    rows = []
    for name, values in varied.items():
        for value in values:
            now = {**case, name: float(value)}
            camera = lab.Simulation(lab.wall_rig(1, height=now["H"]))
            cylinder = lab.upright("cylinder", (-3.05 + now["d"] - 0.15, 0.0), 0.3, now["h"])
            predicted = float(lab.smear_m(now["d"], now["h"], now["H"]))
            measured = lab.measured_smear_m(camera, cylinder)
            rows.append({"varied": name, "value": float(value), "predicted": predicted, "measured": measured})
    return pd.DataFrame(rows)


def smear_figure(table: pd.DataFrame, **case: float) -> Figure:
    """Prediction (line) and measurement (dots) of :func:`smear_table`, which was given the same ``case``."""
    fig, axes = plotting.new_figure(3, width=10, height=3.2)
    for ax, (name, label) in zip(axes, SMEAR_LABELS.items(), strict=True):
        part = table[table["varied"] == name]
        fine = np.linspace(part["value"].min(), part["value"].max(), 200)
        now: dict[str, Any] = {**case, name: fine}
        ax.plot(fine, lab.smear_m(now["d"], now["h"], now["H"]), color="0.1", label="d h / (H - h)")
        ax.plot(part["value"], part["measured"], "o", color=MEASURED, label="measured")
        ax.set(xlabel=label, ylim=(0, 1.6))
    axes[0].set(ylabel="smear (m)")
    axes[0].legend(loc="upper left", fontsize=11)
    return fig


def crossings_both_ways(rig: Rig, crowds: Sequence[Crowd]) -> pd.Series[int]:
    """Pairs of objects whose shadows from two cameras cross never, once or twice."""
    pairs = [{frozenset(pair): 0 for pair in combinations(range(len(crowd)), 2)} for crowd in crowds]
    for count, crowd in zip(pairs, crowds, strict=True):
        for pair in lab.crossings(rig, crowd):
            count[frozenset(pair)] += 1
    found = [times for count in pairs for times in count.values()]
    return pd.Series({times: found.count(times) for times in (0, 1, 2)}, name="pairs").rename_axis("ghosts of a pair")


def ghost_shapes(rigs: Mapping[str, Rig], crowds: Sequence[Crowd]) -> pd.DataFrame:
    """Of all predicted ghosts of each rig: how many a crowd, their median area, and the median of length over width."""
    rows = {}
    for name, rig in rigs.items():
        outlines = [outline for crowd in crowds for outline in lab.crossings(rig, crowd).values()]
        boxes = np.array([cv2.minAreaRect(outline.astype(np.float32))[1] for outline in outlines])
        areas = [cv2.contourArea(outline.astype(np.float32)) for outline in outlines]
        rows[name] = {
            "ghosts a crowd": len(outlines) / len(crowds),
            "median area (m²)": float(np.median(areas)),
            "median length / width": float(np.median(boxes.max(axis=1) / boxes.min(axis=1))),
        }
    return pd.DataFrame(rows).T


def ghost_figure(rigs: Mapping[str, Rig], crowds: Sequence[Crowd]) -> Figure:
    """For each rig the crowd with the most predicted ghosts: the views on the floor, and the predicted outlines."""
    fig, axes = plotting.new_figure(len(rigs), width=10, height=4.3)
    everyone = list(dict.fromkeys(name for rig in rigs.values() for name in rig.cameras))  # each keeps its colour
    for ax, (name, rig) in zip(axes, rigs.items(), strict=True):
        crowd = max(crowds, key=lambda one, rig=rig: len(lab.crossings(rig, one)))  # type: ignore[misc]
        simulation, ghosts = lab.Simulation(rig), lab.crossings(rig, crowd)
        title = f"{name}: {len(crowd)} objects, {len(ghosts)} crossings predicted"
        seen = simulation.on_floor(simulation.masks(crowd))
        plotting.show_views_on_floor(ax, seen, rig.floor, title, cameras=everyone)
        plotting.show_footprints(ax, lab.truth_of([crowd]).frames[0])
        for outline in ghosts.values():
            ax.fill(*outline.T, facecolor="none", edgecolor="#F0E442", linewidth=3)
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=10, ncols=2)
        ax.set_title(title, fontsize=11)
    return fig


def ghost_study(
    numbers: Sequence[int], angles: Sequence[float], heights: Sequence[float], *, crowds: int, seed: int
) -> pd.DataFrame:
    """:func:`occlib.lab.two_view_study` against one of three quantities at a time; index ``varied`` and ``value``.

    Where it is not varied there are 8 objects, opposite cameras and 2.5 m.

    Parameters
    ----------
    numbers, angles, heights
        Of objects, between the cameras in degrees, of the cameras in m.
    crowds, seed
        How many crowds behind each row, always the same ones of 8.
    """
    eights, known = lab.random_crowds(crowds, 8, seed), dict[tuple[int, float, float], dict[str, float]]()
    cases: dict[tuple[str, float], tuple[int, float, float]] = {
        **{("objects", number): (number, 180.0, 2.5) for number in numbers},
        **{("angle", angle): (8, angle, 2.5) for angle in angles},
        **{("height", height): (8, 180.0, height) for height in heights},
    }
    for number, angle, height in cases.values():
        if (number, angle, height) not in known:  # the middle of all three series is one and the same
            rig = lab.wall_rig({"first": 180.0, "second": 180.0 + angle}, height=height)
            crowd_list = eights if number == 8 else lab.random_crowds(crowds, number, seed)
            known[number, angle, height] = lab.two_view_study(rig, crowd_list)
    index = pd.MultiIndex.from_tuples(list(cases), names=["varied", "value"])
    return pd.DataFrame([known[case] for case in cases.values()], index=index)


def ghost_count_figure(study: pd.DataFrame) -> Figure:
    """Ghosts a frame: by the law, predicted and measured with its 95 % interval, for a table of :func:`ghost_study`."""
    fig, axes = plotting.new_figure(3, width=10, height=3.4)
    for ax, (varied, label) in zip(axes, AXIS_LABELS.items(), strict=True):
        part = study.loc[varied]
        ax.plot(part["law"], "--", color="0.5", label="the law")
        ax.plot(part["predicted"], "-", color="0.1", label="predicted")
        spread = [part["measured"] - part["measured, low"], part["measured, high"] - part["measured"]]
        ax.errorbar(part.index, part["measured"], yerr=spread, fmt="o", color=MEASURED, capsize=3, label="measured")
        ax.set(xlabel=label, ylim=(0, None), title="" if varied == "objects" else "8 objects")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("ghosts a frame")
    axes[0].legend(fontsize=11)
    return fig


def placement_figure(study: pd.DataFrame) -> Figure:
    """Accuracy, claimed area and position error against the angle and the height, for a table of :func:`ghost_study`."""
    fig, axes = plotting.new_figure(3, 2, width=10, height=5.2)
    columns = {"MODA": "MODA", "claimed / true": "claimed / true area", "median error (cm)": "median error (cm)"}
    for row, varied in zip(axes, ("angle", "height"), strict=True):
        for ax, (column, label) in zip(row, columns.items(), strict=True):
            ax.plot(study.loc[varied, column], "o-", color="#0072B2")
            ax.set(xlabel=AXIS_LABELS[varied], ylabel=label, ylim=(0.4, 1.0) if column == "MODA" else (0, None))
            ax.grid(alpha=0.3)
    return fig


def recall_figure(table: pd.DataFrame) -> Figure:
    """Share of the objects that AND keeps against the recall of one view: the law r^k, and what was counted."""
    fig, ax = plotting.new_figure(width=6.5, height=3.8)
    fine = np.linspace(table["r"].min(), 1, 100)
    groups = zip(table.groupby("cameras"), plotting.CAMERA_COLOURS, "os^D", (-1, 0, 1, 2), strict=False)
    for (k, part), colour, marker, step in groups:
        ax.plot(fine, fine**k, color=colour, label=f"{k} cameras: $r^{k}$")
        ax.plot(part["r"] + 0.006 * step, part["found"], marker, color=colour, markersize=7)  # apart, to be seen
    ax.plot(fine, fine, ":", color="0.5", label="one view: $r$")
    ax.set(xlabel="recall r of a single view", ylabel="share of the objects kept", ylim=(0, 1.03))
    ax.legend(fontsize=11)
    ax.grid(alpha=0.3)
    return fig


def mask_without(mask: Mask, low: float, high: float) -> Mask:
    """A copy of a mask without the part from ``low`` to ``high`` of its height, 0 its lowest row and 1 its highest."""
    rows = np.flatnonzero(mask.any(axis=1))
    bottom, tall = rows.max() + 1, len(rows)
    cut = mask.copy()
    cut[round(bottom - high * tall) : round(bottom - low * tall)] = False
    return cut


def hole_study(
    simulation: lab.Simulation, each: lab.SceneObject, holes: Mapping[str, tuple[float, float]]
) -> pd.DataFrame:
    """What AND keeps of an object when the first view's mask has a hole.

    Parameters
    ----------
    simulation, each
        Cameras, and the object that they see.
    holes
        For each name the part of the silhouette's height that is missing, as :func:`mask_without` takes it.
    """
    rows, masks, base = {}, simulation.masks([each]), lab.base_m(each)
    first, floor = next(iter(masks)), simulation.rig.floor
    for name, part in holes.items():
        occupied = simulation.occupied({**masks, first: mask_without(masks[first], *part)})
        covered = metrics.footprint_coverage(occupied, floor, [base])[0]
        rows[name] = {
            "covered share of the base": float(covered),
            "claimed area (m²)": float(occupied.sum() * floor.cell_area),
            "regions": len(lab.region_places(occupied, floor)),
        }
    return pd.DataFrame(rows).T


def hole_figure(
    simulation: lab.Simulation, each: lab.SceneObject, holes: Mapping[str, tuple[float, float]], *, reach_m: float = 0.8
) -> Figure:
    """The shadows on the floor for each hole of :func:`hole_study`, around the object."""
    fig, axes = plotting.new_figure(len(holes), width=10, height=2.8)
    masks, (x, y) = simulation.masks([each]), lab.places_m([each])[0]
    first = next(iter(masks))
    for ax, (name, part) in zip(axes, holes.items(), strict=True):
        views = simulation.on_floor({**masks, first: mask_without(masks[first], *part)})
        plotting.show_views_on_floor(ax, views, simulation.rig.floor, name)
        plotting.show_footprints(ax, lab.truth_of([[each]]).frames[0])
        ax.get_legend().remove()
        ax.set(xlim=(x - reach_m, x + reach_m), ylim=(y - reach_m / 2, y + reach_m / 2), ylabel="")
        ax.set_title(name, fontsize=11)
    axes[0].set_ylabel("y (m)")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=11)
    return fig
