"""Loops and long plots of the chapter on localisation: contours, sheets on the floor, the upright robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.extras import pandas as pd
from occlib.foreground import Background, foreground_mask
from occlib.formats import TrueObject, load_truth
from occlib.geometry import Camera, Floor
from occlib.lab import smear_m
from occlib.localization import Region, ScaleTable, contour, contour_polar, find_regions, scale_table
from occlib.metrics import evaluate_identity, polygon_area
from occlib.pipeline import Pipeline, backgrounds_of, settings_for
from occlib.plotting import (
    CAMERA_COLOURS,
    TRUTH_COLOUR,
    camera_colours,
    outline_on_image,
    show_floor,
    show_footprints,
    show_image,
)
from occlib.recordings import Recording, open_recording
from occlib.registration import FloorWarp

SMALLEST_PX = 100
"""Regions of fewer px are noise, in this chapter."""

_ESTIMATES = {"n x factor": ("x", "#CC79A7"), "sum of factors": ("o", "black"), "predicted": ("_", "#009E73")}


def largest_region(mask: Mask) -> tuple[Mask, Region]:
    """The largest region of a mask, bool (H, W), and its measures. Raises ``ValueError`` if there is none."""
    labels, regions = find_regions(mask, min_area=SMALLEST_PX)
    if not regions:
        raise ValueError(f"mask: expected a region of {SMALLEST_PX} px or more")
    region = max(regions, key=lambda one: one.area)
    return labels == region.label, region


def contour_graph(image: Image, mask: Mask, theta_deg: float | None = None) -> Figure:
    """The contour of a mask's largest region with its centroid, and beside it ``d = f(theta)``.

    Parameters
    ----------
    image, mask
        RGB (H, W, 3) and bool (H, W).
    theta_deg
        A direction to point out in both panels, in degrees clockwise from the right; none by default.
    """
    _, region = largest_region(mask)
    outline = contour(mask)
    theta, distance = contour_polar(outline, region.centroid)
    fig, (ax, graph) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    show_image(ax, image)
    ax.set_title("contour and centroid", fontsize=11)
    ax.plot(*np.vstack([outline, outline[:1]]).T, color="#F0E442", linewidth=2)
    ax.plot(*region.centroid, "+", color="white", markersize=14, markeredgewidth=2.5)
    left, top, width, height = region.box
    ax.set(xlim=(left - 15, left + width + 15), ylim=(top + height + 15, top - 15))
    graph.plot(np.degrees(theta), distance, color="#0072B2")
    graph.set(xlabel="angle θ (deg), clockwise from the right", ylabel="distance d (px)")
    graph.set(xlim=(-185, 185), xticks=range(-180, 181, 45), ylim=(0, 1.15 * distance.max()))
    graph.set_title("contour graph d = f(θ)", fontsize=11)
    if theta_deg is not None:
        turn = np.angle(np.exp(1j * (theta - np.radians(theta_deg))))
        nearest = int(np.abs(turn).argmin())
        angle, length = theta[nearest], distance[nearest]
        x, y = region.centroid
        ax.plot([x, x + length * np.cos(angle)], [y, y + length * np.sin(angle)], "o-", color="#D55E00", linewidth=2)
        graph.plot(np.degrees(angle), length, "o", color="#D55E00", markersize=9)
        graph.text(0.03, 0.06, f"θ = {np.degrees(angle):.0f}°, d = {length:.1f} px", transform=graph.transAxes)
    return fig


def point_out(image: Image, mask: Mask, theta_deg: float) -> None:
    """Show :func:`contour_graph` with one direction pointed out: for a slider."""
    contour_graph(image, mask, theta_deg)
    plt.show()


def two_inverse_tangents(mask: Mask) -> Figure:
    """The contour graph with the quotient of Eq 5 as printed, and with the four-quadrant inverse tangent."""
    _, region = largest_region(mask)
    dx, dy = (contour(mask) - region.centroid).T
    distance, right = np.hypot(dx, dy), dx >= 0
    with np.errstate(divide="ignore", invalid="ignore"):
        angles = {"Eq 5 as printed": np.arctan(dy / dx), "four-quadrant": np.arctan2(dy, dx)}
    fig, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    for ax, (title, angle) in zip(axes, angles.items(), strict=True):
        for half, mark, colour, name in ((right, "o", "#0072B2", "right"), (~right, "x", "#D55E00", "left")):
            label = f"{name} of the centroid"
            ax.plot(np.degrees(angle[half]), distance[half], mark, color=colour, markersize=4, label=label)
        ax.set(xlabel="angle θ (deg)", xlim=(-185, 185), xticks=range(-180, 181, 45), ylim=(0, 1.15 * distance.max()))
        ax.set_title(title, fontsize=11)
    axes[0].set_ylabel("distance d (px)")
    axes[1].legend(loc="lower right")
    return fig


def ambiguous_directions(mask: Mask, *, apart_px: float = 5.0) -> int:
    """In how many directions, in steps of 1 degree, a ray from the centroid meets the contour more than once.

    Two crossings count as two if they are more than ``apart_px`` apart.

    >>> ambiguous_directions(np.ones((20, 20), bool))
    0
    """
    theta, distance = contour_polar(contour(mask), largest_region(mask)[1].centroid)
    points = pd.DataFrame({"angle": np.degrees(theta).round(), "d": distance})
    return int((points.groupby("angle")["d"].agg(np.ptp) > apart_px).sum())


def scale_table_figure(image: Image, camera: Camera, table: ScaleTable, rim_m: npt.ArrayLike) -> Figure:
    """The grid cells over a picture, and the scale factor of each; ``rim_m`` outlines the mapped floor in both."""
    fig, (ax, heat) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    size, (width, height) = table.cell_px, camera.size
    show_image(ax, image)
    floor = np.arange(len(table.factors))[:, None] * size >= 70  # above lies the far wall
    shown = np.where(floor, table.factors * 1e4, np.nan)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    grid = heat.imshow(shown, extent=extent, norm="log", cmap="cividis_r")
    bar = fig.colorbar(grid, ax=heat, label="scale factor (cm² per px)", ticks=[0.4, 0.6, 1, 2, 4], format="%g")
    bar.ax.minorticks_off()
    for axis, colour in ((ax, CAMERA_COLOURS[0]), (heat, "white")):
        outline_on_image(axis, camera, rim_m, color=colour, linewidth=2)
        axis.set(xticks=range(0, width, 2 * size), yticks=range(0, height, 2 * size), xlabel="x (px)", ylabel="y (px)")
        axis.set(xticks=range(0, width, 4 * size), aspect="equal")
    for edge in range(0, width, size):
        ax.axvline(edge - 0.5, color="0.3", linewidth=0.4)
    for edge in range(0, height, size):
        ax.axhline(edge - 0.5, color="0.3", linewidth=0.4)
    ax.set_title(f"grid cells of {size} px", fontsize=11)
    heat.set_title("the look-up table (outlined: the mapped floor)", fontsize=11)
    return fig


def sheet_masks(camera: Camera, places_m: npt.ArrayLike, side_m: float) -> list[Mask]:
    """What a camera sees of a square sheet of side ``side_m`` that lies flat on the floor, at each place (N, 2) in m.

    Exact: a pixel belongs to the sheet if the floor point at its centre does. Bool (H, W) each.
    """
    centres = camera.pixel_centres()
    shown_m = camera.pixels_to_floor(centres.reshape(-1, 2)).reshape(centres.shape)
    return [(np.abs(shown_m - place) < side_m / 2).all(axis=-1) for place in np.asarray(places_m, dtype=float)]


def sheet_errors(camera: Camera, places_m: npt.ArrayLike, side_m: float, cells_px: Sequence[int]) -> pd.DataFrame:
    """Error in percent of a flat sheet's area by the look-up table: a row a place, a column a size of the grid cells."""
    sheets = [largest_region(mask)[1] for mask in sheet_masks(camera, places_m, side_m)]
    tables = {size: scale_table(camera, cell_px=size) for size in cells_px}
    return pd.DataFrame(
        {size: [100 * (tables[size].actual_area(sheet) / side_m**2 - 1) for sheet in sheets] for size in cells_px}
    ).rename_axis("sheet")


def sheet_error_figure(errors: pd.DataFrame, distances_m: npt.ArrayLike, shown_px: Sequence[int]) -> Figure:
    """The spread of :func:`sheet_errors` for each size of cell, and for ``shown_px`` against the distance."""
    fig, (ax, far) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    ax.boxplot([errors[size] for size in errors], tick_labels=list(errors), medianprops={"color": "#D55E00"})
    ax.set(xlabel="side of a grid cell (px)", ylabel="error of the area (%)")
    ax.set_title(f"{len(errors)} sheets on the floor", fontsize=11)
    marks = (("o", "black"), ("x", "#CC79A7"), ("^", "#009E73"))
    for size, (mark, colour) in zip(shown_px, marks, strict=True):
        far.plot(distances_m, errors[size], mark, color=colour, markersize=5, label=f"cells of {size} px")
    far.set(xlabel="distance from the camera along the floor (m)", ylim=ax.get_ylim())
    far.set_title("the same sheets, by distance", fontsize=11)
    far.legend(loc="upper left")
    for axis in (ax, far):
        axis.axhline(0, color="0.6", linewidth=0.8)
    return fig


def displaced(points_m: npt.ArrayLike, camera: Camera, height_m: float) -> FloatArray:
    """Where points (N, 2) of the floor seem to lie once they are lifted by ``height_m``: further from the camera."""
    points, station = np.asarray(points_m, dtype=float), camera.centre_m
    away = points - station[:2]
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    return np.asarray(points + away / distance * smear_m(distance, height_m, station[2]))


def prism_shadow_m2(footprint_m: npt.ArrayLike, camera: Camera, height_m: float) -> float:
    """Floor area in m2 that an upright prism hides from a camera, its own convex footprint included."""
    both = np.vstack([np.asarray(footprint_m, dtype=float), displaced(footprint_m, camera, height_m)])
    return float(ConvexHull(both).volume)  # SciPy's name for the area, in the plane


def away_and_sideways(found_m: npt.ArrayLike, true_m: npt.ArrayLike, camera: Camera) -> FloatArray:
    """A position's error in m, (2,): along the direction of sight, positive away from the camera, and across it."""
    found, true = np.asarray(found_m, dtype=float), np.asarray(true_m, dtype=float)
    ray = (true - camera.centre_m[:2]) / np.linalg.norm(true - camera.centre_m[:2])
    return np.array([(found - true) @ ray, (found - true) @ [-ray[1], ray[0]]])


def robot_poses(
    recording: Recording, backgrounds: Mapping[str, Background], *, cell_px: int, height_m: float
) -> pd.DataFrame:
    """The robot's size and place by section 4 of the paper, in each pose and view, beside what is true and predicted.

    Parameters
    ----------
    recording, backgrounds
        One object a frame, with truth, and each camera's background.
    cell_px
        Side of the look-up table's cells.
    height_m
        Of the prism on the true footprint, for the prediction.

    Returns
    -------
    A row for each pose and camera. Areas in m2: ``n x factor`` (the paper's), ``sum of factors`` (each pixel with its own),
    ``predicted`` and ``footprint``. Lengths in m: ``distance`` from the camera, the centroid on the floor ``x``, ``y``,
    the true place, the error ``away`` from the camera and ``sideways``.
    """
    truth = load_truth(recording.path / "truth.json").frames
    cameras = {name: recording.rig[name] for name in backgrounds}
    coarse = {name: scale_table(camera, cell_px=cell_px) for name, camera in cameras.items()}
    exact = {name: scale_table(camera, cell_px=1) for name, camera in cameras.items()}
    rows = []
    for pose, images in recording.images():
        true = truth[pose][0]
        footprint, place = np.array(true.footprint), np.array([true.x, true.y])
        for name, image in images.items():
            own, region = largest_region(foreground_mask(image, backgrounds[name]))
            x, y = cameras[name].pixels_to_floor([region.centroid])[0]
            away, sideways = away_and_sideways([x, y], place, cameras[name])
            rows.append(
                {
                    "pose": pose,
                    "camera": name,
                    "distance": np.linalg.norm(footprint.mean(axis=0) - cameras[name].centre_m[:2]),
                    "n x factor": coarse[name].actual_area(region),
                    "sum of factors": exact[name].factors[own].sum(),
                    "predicted": prism_shadow_m2(footprint, cameras[name], height_m),
                    "footprint": polygon_area(footprint),
                    "x": x,
                    "y": y,
                    "true x": true.x,
                    "true y": true.y,
                    "away": away,
                    "sideways": sideways,
                }
            )
    return pd.DataFrame(rows)


def upright_robot_figure(
    poses: pd.DataFrame, mask: Mask, camera: Camera, floor: Floor, true: TrueObject, height_m: float
) -> Figure:
    """Three estimates of the robot's area against the distance, and one mask on the floor with the prism's prediction."""
    fig, (ax, bx) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    for column, (mark, colour) in _ESTIMATES.items():
        style = {"fillstyle": "none", "markersize": 10, "markeredgewidth": 1.8, "zorder": 2 + (mark == "_")}
        ax.plot(poses["distance"], poses[column], mark, color=colour, label=column, **style)
    ax.axhline(poses["footprint"].mean(), color=TRUTH_COLOUR, linestyle="--", label="true footprint")
    ax.set(xlabel="distance from the camera (m)", ylabel="area on the floor (m²)", ylim=(0, None))
    ax.legend(loc="lower right")
    foot = np.array(true.footprint)
    top = displaced(foot, camera, height_m)
    show_floor(bx, FloorWarp(camera, floor).warp(mask), floor, cmap="Greys", alpha=0.5)
    show_footprints(bx, [true])
    bx.plot(*np.vstack([top, top[:1]]).T, color=CAMERA_COLOURS[0], linewidth=1.5, label="moved by d h / (H - h)")
    x, y = foot.mean(axis=0)
    bx.set(xlim=(x - 0.45, x + 0.75), ylim=(y - 0.5, y + 0.6))
    bx.set_title(f"one mask of camera {camera.name} on the floor", fontsize=11)
    bx.legend(loc="upper right", fontsize=10)
    return fig


def centroid_figure(
    poses: pd.DataFrame, truth: Mapping[int, Sequence[TrueObject]], rule: FloatArray, *, enlarged: float = 3.0
) -> Figure:
    """The centroid's error as an enlarged arrow on the floor, and its part away from the camera against the distance.

    ``rule``: columns distance and predicted error in m, drawn as a line.
    """
    fig, (ax, bx) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", width_ratios=[1.3, 1])
    show_footprints(ax, [true for objects in truth.values() for true in objects])
    for name, colour in camera_colours(["left", "right"]).items():
        own = poses[poses["camera"] == name]
        start = own[["true x", "true y"]].to_numpy()
        arrows = {"angles": "xy", "scale_units": "xy", "scale": 1 / enlarged, "width": 0.007}
        ax.quiver(
            *start.T,
            *(own[["x", "y"]].to_numpy() - start).T,
            color=colour,
            label=f"{enlarged:g} x error, {name}",
            **arrows,
        )
        bx.plot(own["distance"], own["away"], "o" if name == "left" else "s", color=colour, label=name)
    ax.set(xlim=(-2, 2), ylim=(-1.5, 1.5), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    bx.plot(*np.asarray(rule).T, "k--", label="d h / (H - h), half the height")
    bx.set(xlabel="distance from the camera (m)", ylabel="error away (m)", ylim=(0, 0.24))
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=10)
    bx.legend(loc="upper left", fontsize=10)
    return fig


def chain_sizes(steps: Mapping[str, int]) -> pd.DataFrame:
    """Size over true footprint of what the profile ``paper`` identifies, the median over the frames, by height.

    Parameters
    ----------
    steps
        For each of the lab's recordings, that every how manieth frame is taken.
    """
    rows = []
    for name, step in steps.items():
        recording = open_recording(name, ["left", "right"])
        truth = load_truth(recording.path / "truth.json")
        chain = Pipeline(recording.rig, backgrounds_of(recording), settings_for("paper"))
        found = {
            frame: chain.process(images, recording.time(frame)).objects
            for frame, images in recording.images(recording.frames[::step])
        }
        heights = {true.id: true.height for true in truth.frames[recording.frames[0]]}
        ratios = evaluate_identity(found, truth.select(found), radius=0.3).size_ratio
        rows += [(name, key, heights[key], ratio) for key, ratio in ratios.items()]
    columns = ["recording", "object", "height (m)", "size / footprint"]
    return pd.DataFrame(rows, columns=columns).sort_values("height (m)", ignore_index=True)


def listed_objects(recording: Recording, frame: int, *, cell_px: int) -> pd.DataFrame:
    """Every region of every view with the position and the size that section 4 of the paper reports, and the truth.

    The true objects come first, with the area of their footprint and without pixels.
    """
    backgrounds = backgrounds_of(recording)
    ((_, images),) = recording.images([frame])
    rows: list[tuple[str, float, float, float, float]] = [
        (f"truth: {true.id}", np.nan, true.x, true.y, polygon_area(true.footprint or []))
        for true in load_truth(recording.path / "truth.json").frames[frame]
    ]
    for name, image in images.items():
        camera, mask = recording.rig[name], foreground_mask(image, backgrounds[name])
        table = scale_table(camera, cell_px=cell_px)
        for region in find_regions(mask, min_area=SMALLEST_PX)[1]:
            x, y = camera.pixels_to_floor([region.centroid])[0]
            rows.append((name, region.area, x, y, table.actual_area(region)))
    return pd.DataFrame(rows, columns=["source", "n (px)", "x (m)", "y (m)", "size (m2)"])
