"""Tables and figures of chapter 01, "Calibrate the cameras"."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from occlib import calibration, floor_marks, plotting
from occlib.base.arrays import FloatArray, Image
from occlib.base.extras import pandas as pd
from occlib.calibration import Calibration
from occlib.course.drawings import rig_in_3d, rig_section
from occlib.geometry import Camera, Floor, Rig
from occlib.lens import Pose

Corners = Sequence[FloatArray]
"""The corners of each picture of a camera, (N, 2) in px."""


def show_system(rig: Rig, room: npt.ArrayLike, robots: Mapping[str, npt.ArrayLike]) -> Figure:
    """The vision system in 3-D, from the side and from above."""
    fig = plt.figure(figsize=(10, 4.8), layout="constrained")
    grid = fig.add_gridspec(2, 2, width_ratios=[1.7, 1])
    whole: Any = fig.add_subplot(grid[:, 0], projection="3d", computed_zorder=False)
    rig_in_3d(whole, rig, room, robots)
    whole.view_init(24, -68)
    for row, axes, title in ((0, "xz", "from the side"), (1, "xy", "from above")):
        ax = fig.add_subplot(grid[row, 1])
        rig_section(ax, rig, room, axes=axes)
        ax.set_title(title, fontsize=10)
    ax.text(0, 0, "mapped floor", ha="center", va="center")
    return fig


# --- the checkerboard


def show_board(image: Image, corners: FloatArray, marked: FloatArray, refined: FloatArray) -> Figure:
    """A view, its corners in the order found, and in close-up the corner that the hand missed by most."""
    worst = int(np.linalg.norm(marked - refined, axis=1).argmax())
    fig, axes = plt.subplots(1, 3, figsize=(10, 2.9), layout="constrained", width_ratios=[1.3, 1.3, 1])
    plotting.show_image(axes[0], image, "left view")
    plotting.show_image(axes[1], image, f"{len(corners)} corners, in the order found")
    axes[1].plot(*corners.T, "-", color="#0072B2", linewidth=1)
    axes[1].scatter(*corners.T, c=np.arange(len(corners)), cmap="viridis", s=12)
    plotting.show_image(axes[2], image, "one corner: hand x, refined +", interpolation="nearest")
    axes[2].plot(*marked[worst], "x", color="white", markersize=12, markeredgewidth=5)
    axes[2].plot(*marked[worst], "x", color="#D55E00", markersize=12, markeredgewidth=2)
    axes[2].plot(*refined[worst], "+", color="#0072B2", markersize=16, markeredgewidth=3)
    (u, v), reach = refined[worst], 8
    axes[2].set(xlim=(u - reach, u + reach), ylim=(v + reach, v - reach))
    return fig


# --- calibrate


def focal_error(lens: Calibration, exact: Camera) -> float:
    """The larger of the relative errors of the two focal lengths, in percent."""
    focal, true = (matrix[[0, 1], [0, 1]] for matrix in (lens.matrix, exact.matrix))
    return float(100 * np.abs(focal / true - 1).max())


def lens_table(lenses: Mapping[str, Calibration], rig: Rig) -> pd.DataFrame:
    """What each calibration found, beside the exact values of the rendered cameras."""
    rows = {
        name: {
            "fx": lens.matrix[0, 0],
            "exact fx": rig[name].matrix[0, 0],
            "fy": lens.matrix[1, 1],
            "exact fy": rig[name].matrix[1, 1],
            "focal error (%)": focal_error(lens, rig[name]),
            "k1": lens.distortion[0],
            "exact k1": rig[name].distortion[0],
            "rms (px)": lens.rms_px,
        }
        for name, lens in lenses.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("camera")


def show_coverage(corners: Mapping[str, Corners], lenses: Mapping[str, Calibration]) -> Figure:
    """Where on each sensor the corners of all views lie, and the reprojection error of each view."""
    colours = plotting.camera_colours(list(lenses))
    fig, axes = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
    for i, (ax, (name, lens)) in enumerate(zip(axes, lenses.items(), strict=False)):
        ax.plot(*np.vstack(corners[name]).T, ".", color=colours[name], markersize=2)
        ax.set(xlim=(0, 640), ylim=(480, 0), aspect="equal", xlabel="u (px)", ylabel="v (px)")
        ax.set_title(f"{name}: corners of all views", fontsize=10)
        at = np.arange(lens.views_used) + 0.4 * i
        axes[2].bar(at, lens.view_rms_px, width=0.4, color=colours[name], label=name)
    highest = max(float(lens.view_rms_px.max()) for lens in lenses.values())
    axes[2].set(xlabel="view", ylabel="rms error (px)", xticks=range(0, 15, 2), ylim=(0, 1.35 * highest))
    axes[2].legend(ncols=2)
    return fig


# --- how the corners are found, and how many pictures


def hand_marks(corners: Corners, noise_px: float, rng: np.random.Generator) -> list[FloatArray]:
    """The corners of all pictures as a hand marks them that misses by ``noise_px`` on each axis."""
    return [found + rng.normal(0, noise_px, found.shape) for found in corners]


def refined_marks(images: Sequence[Image], marks: Corners, window_px: int) -> list[FloatArray]:
    """The marks of all pictures after refinement within a window."""
    return [
        calibration.refine_corners(image, marked, window_px=window_px)
        for image, marked in zip(images, marks, strict=True)
    ]


def corner_table(sets: Mapping[str, Sequence[Corners]], board: FloatArray, exact: Camera) -> pd.DataFrame:
    """Calibrate with each of several sets of corners a label: rms and focal length error."""
    rows = {}
    for label, found in sets.items():
        fits = [calibration.calibrate(marks, board, exact.size) for marks in found]
        errors = [focal_error(fit, exact) for fit in fits]
        rows[label] = {
            "sets": len(fits),
            "median rms (px)": float(np.median([fit.rms_px for fit in fits])),
            "median focal error (%)": float(np.median(errors)),
            "worst focal error (%)": max(errors),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("corners").astype({"sets": int})


def picture_table(
    corners: Corners, board: FloatArray, exact: Camera, counts: Iterable[int], repeats: int, rng: np.random.Generator
) -> pd.DataFrame:
    """:func:`corner_table` for so many pictures, chosen at random so many times."""
    sets = {}
    for count in counts:
        chosen = [rng.choice(len(corners), count, replace=False) for _ in range(repeats)]
        sets[count] = [[corners[i] for i in pick] for pick in chosen]
    return corner_table(sets, board, exact).rename_axis("pictures")  # type: ignore[arg-type]


def show_pictures(table: pd.DataFrame) -> Figure:
    """Focal length error and reprojection error of :func:`picture_table`."""
    fig, axes = plt.subplots(1, 2, figsize=(10, 3.1), layout="constrained")
    axes[0].plot(table["worst focal error (%)"], "s--", color="#D55E00", label="worst")
    axes[0].plot(table["median focal error (%)"], "o-", color="#0072B2", label="median")
    axes[0].set(xlabel="pictures", ylabel="focal length error (%)", ylim=(0, None))
    axes[0].legend()
    axes[1].plot(table["median rms (px)"], "ko-")
    axes[1].set(xlabel="pictures", ylabel="median rms error (px)", ylim=(0, 0.2))
    return fig


# --- the floor


def both_orders(found: FloatArray, columns: int) -> dict[str, FloatArray]:
    """A board's corners in the two orders that a floor board seen from above may have."""
    grid = found.reshape(-1, columns, 2)
    orders = {"rows reversed": grid[::-1], "columns reversed": grid[:, ::-1]}
    return {name: turned.reshape(-1, 2) for name, turned in orders.items()}


def end_grey(image: Image, corners: FloatArray, columns: int) -> float:
    """Mean grey level in the middles of the two corner squares beside the first column of corners."""
    grid = corners.reshape(-1, columns, 2)
    squares = 1.5 * grid[[0, -1], 0] - 0.5 * grid[[1, -2], 1]  # half a square beyond the corners
    return float(np.mean([image[round(v), round(u)] for u, v in squares]))


def pose_table(
    poses: Mapping[tuple[str, str], Pose],
    corners: Mapping[tuple[str, str], FloatArray],
    lenses: Mapping[str, Calibration],
    images: Mapping[str, Image],
    known_m: FloatArray,
    columns: int,
) -> pd.DataFrame:
    """Reprojection error, grey level at the first end of the board, and the camera's place, by camera and order."""
    rows = {}
    for (name, order), (rotation, translation) in poses.items():
        seen, place = corners[name, order], -rotation.T @ translation
        error = calibration.reprojection_error(lenses[name], rotation, translation, known_m, seen)
        grey = end_grey(images[name], seen, columns)
        rows[name, order] = [error.mean(), grey, *place]
    table = pd.DataFrame.from_dict(
        rows, orient="index", columns=["mean error (px)", "grey level", "x (m)", "y (m)", "z (m)"]
    )
    return table.set_axis(pd.MultiIndex.from_tuples(rows, names=["camera", "order"]))


def mark_table(fit: floor_marks.FloorFit, floor_m: npt.ArrayLike) -> pd.DataFrame:
    """Each mark's place, and its error in mm in the fit and when it is left out."""
    left_out = np.full(len(fit.error_m), np.nan) if fit.leave_one_out_m is None else fit.leave_one_out_m
    x, y = np.asarray(floor_m, dtype=float).T
    columns = {"x (m)": x, "y (m)": y, "residual (mm)": 1000 * fit.error_m, "when left out (mm)": 1000 * left_out}
    return pd.DataFrame(columns).rename_axis("mark").round(1)


def floor_error_mm(camera: Camera, exact: Camera, grid: Floor) -> FloatArray:
    """How far off a camera puts the centre of each cell, seen by the exact camera, in mm, (ny, nx)."""
    points = grid.cell_centres_m()
    found = camera.pixels_to_floor(exact.floor_to_pixels(points))
    return np.asarray(1000 * np.linalg.norm(found - points, axis=1).reshape(grid.shape), dtype=np.float64)


def floor_error_table(maps: Mapping[tuple[str, str], FloatArray]) -> pd.DataFrame:
    """Mean and largest value of each map, by camera and way."""
    rows = {key: [error.mean(), error.max()] for key, error in maps.items()}
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["mean error (mm)", "largest error (mm)"])
    return table.set_axis(pd.MultiIndex.from_tuples(maps, names=["camera", "homography from"]))


def show_floor_error(
    maps: Mapping[tuple[str, str], FloatArray], grid: Floor, marks_m: npt.ArrayLike, board_m: FloatArray
) -> Figure:
    """The error across the floor, a row for each camera, with marks as crosses and the board's corners as dots."""
    names = list(dict.fromkeys(name for name, _ in maps))
    colours = plotting.camera_colours(names)
    fig, axes = plt.subplots(len(names), 2, figsize=(10, 6.6), layout="constrained", sharex=True, sharey=True)
    for ax, ((name, way), error) in zip(axes.flat, maps.items(), strict=True):
        shown = plotting.show_floor(ax, error, grid, f"{name} camera, homography from {way}", cmap="cividis", vmax=2)
        ax.plot(*np.asarray(marks_m, dtype=float).T, "+", color="white", markersize=9)
        if way == "pose":
            ax.plot(*board_m[:, :2].T, ".", color="white", markersize=3)
        ax.title.set_color(colours[name])
    fig.colorbar(shown, ax=axes, label="error (mm)", shrink=0.8)
    return fig


def middle_table(
    picks: Mapping[str, Sequence[int]],
    corners: Corners,
    board: FloatArray,
    exact: Camera,
    marks: tuple[FloatArray, FloatArray],
    grid: Floor,
) -> pd.DataFrame:
    """Calibrate with some of the pictures, tie to the marks, and measure the error across the floor."""
    rows = {}
    for label, pick in picks.items():
        lens = calibration.calibrate([corners[i] for i in pick], board, exact.size)
        fit = floor_marks.floor_homography_from_marks(lens, *marks)
        error = floor_error_mm(lens.camera(exact.name, fit.image_to_floor), exact, grid)
        rows[label] = {
            "rms (px)": lens.rms_px,
            "k3 (exact 0)": lens.distortion[4],
            "mean error (mm)": error.mean(),
            "largest error (mm)": error.max(),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("pictures")


def mismeasured(floor_m: npt.ArrayLike) -> FloatArray:
    """The marks' places as a tired colleague wrote them down: one of them is 5 cm off."""
    places = np.array(floor_m, dtype=float)
    places[1] += [0.05, 0.0]
    return places
