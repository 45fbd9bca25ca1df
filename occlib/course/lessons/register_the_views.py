"""Loops and long plots of the chapter on registration: marks, smears, planes, and the order of threshold and warp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.spatial.distance import cdist

from occlib.base import read_image, read_yaml
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.extras import pandas as pd
from occlib.calibration import board_points, find_checkerboard
from occlib.floor_marks import floor_homography_from_marks, load_marks
from occlib.formats import TrueObject
from occlib.geometry import Camera, Floor, Rig, apply_homography
from occlib.plotting import TRUTH_COLOUR, camera_colours, show_floor, show_footprints, show_image, show_views_on_floor
from occlib.recordings import DATA, LAB
from occlib.registration import (
    FloorWarp,
    registration_error_m,
    rotation_about_centre,
    view_angle,
    warp_top_view,
)

_MARKS = LAB / "calibration" / "floor_marks.yaml"


def eight_equations(source: npt.ArrayLike, target: npt.ArrayLike) -> pd.DataFrame:
    """The eight linear equations for a homography that takes four points (4, 2) to four others, with ``h33 = 1``.

    A row an equation: the factors of ``h11`` to ``h32``, and what their sum ``equals``.
    """
    rows = []
    for (u, v), (x, y) in zip(np.asarray(source, dtype=float), np.asarray(target, dtype=float), strict=True):
        rows.append([u, v, 1, 0, 0, 0, -x * u, -x * v, x])
        rows.append([0, 0, 0, u, v, 1, -y * u, -y * v, y])
    names = ["h11", "h12", "h13", "h21", "h22", "h23", "h31", "h32", "equals"]
    return pd.DataFrame(rows, columns=names) + 0.0  # without a minus before zeros


def footprints_in_view(truth: Sequence[TrueObject], camera: Camera, canvas: Floor) -> list[FloatArray]:
    """True footprints in m of a canvas that is turned as this camera looks at it, as in ``view_homography``."""
    turn = canvas.cell_to_floor @ rotation_about_centre(-view_angle(camera, canvas), canvas)
    return [apply_homography(turn, canvas.cells(np.array(true.footprint))) for true in truth]


def top_views_figure(
    titles: Mapping[str, Image], floor: Floor, footprints: Sequence[FloatArray], camera: str
) -> Figure:
    """Pictures and top views of one camera side by side.

    The last one is turned as the right camera looks at it, as the footprints are that are drawn in it.
    """
    colour = camera_colours(["left", "right"])[camera]
    fig, axes = plt.subplots(1, len(titles), figsize=(10, 4.4), layout="constrained")
    for ax, (title, picture) in zip(axes, titles.items(), strict=True):
        if picture.shape[:2] == floor.shape:
            show_floor(ax, picture, floor)
            seen_from = "right" if ax is axes[-1] else camera
            ax.set(xlabel=f"to the right of camera {seen_from} (m)", ylabel=f"away from camera {seen_from} (m)")
        else:
            show_image(ax, picture)
        ax.set_title(title, fontsize=11, color=colour)
    show_footprints(axes[-1], footprints)
    axes[-1].legend(loc="upper right", fontsize=10)
    return fig


def turned_and_back(picture: Image, canvas: Floor, degrees: float) -> Image:
    """A top view turned about the canvas's centre and back again: the same, but interpolated twice."""
    turns = [rotation_about_centre(sign * np.radians(degrees), canvas) for sign in (1, -1)]
    return warp_top_view(warp_top_view(picture, turns[0], canvas), turns[1], canvas)


def board_corners_m() -> FloatArray:
    """The true places (54, 2) in m of the corners of the board that lies on the lab's floor."""
    board = read_yaml(_MARKS)["board"]
    angle = np.radians(board["angle_deg"])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(board_points(tuple(board["pattern"]), board["square"])[:, :2] @ turn + board["origin"])


def landed_corners_m(rig: Rig) -> dict[str, FloatArray]:
    """Where each view's detected corners land on the floor, (54, 2) in m, in the order of :func:`board_corners_m`."""
    true, pattern = board_corners_m(), tuple(read_yaml(_MARKS)["board"]["pattern"])
    landed = {}
    for name in ("left", "right"):
        picture = read_image(LAB / "calibration" / "floor" / f"{name}.jpg")
        corners = find_checkerboard(picture, pattern)
        if corners is None:
            raise ValueError(f"{name}: expected a board of {pattern} corners in the picture")
        found = rig[name].pixels_to_floor(corners)
        landed[name] = found[cdist(true, found).argmin(axis=1)]  # a detector numbers the corners in an order of its own
    return landed


def registration_errors(rig: Rig, landed: Mapping[str, FloatArray]) -> pd.DataFrame:
    """Registration errors in mm: tape marks and a detected board in the lab, and clicked marks in a real laboratory."""
    true = board_corners_m()
    errors: list[tuple[str, str, FloatArray]] = []
    for name, (pixels, metres) in load_marks(_MARKS).items():
        errors.append(("tape marks, exact", name, registration_error_m(rig[name], pixels, metres)))
        errors.append(("board, detected", name, np.linalg.norm(landed[name] - true, axis=1)))
    errors.append(("board, left to right", "both", np.linalg.norm(landed["left"] - landed["right"], axis=1)))
    real = Rig.load(DATA / "ufes-lab" / "rig.yaml")
    for name, (pixels, metres) in load_marks(DATA / "ufes-lab" / "floor_marks.yaml").items():
        errors.append(("real lab, clicked", name, registration_error_m(real[name], pixels, metres)))
    rows = [(points, name, len(e), 1000 * np.median(e), 1000 * e.max()) for points, name, e in errors]
    table = pd.DataFrame(rows, columns=["points", "camera", "count", "median (mm)", "max (mm)"])
    return table.sort_values(["points", "camera"], ignore_index=True)


def registration_error_figure(landed: Mapping[str, FloatArray], *, enlarged: float = 50.0) -> Figure:
    """Where the board's corners land from each view, as arrows from the true corners."""
    fig, ax = plt.subplots(figsize=(8, 5), layout="constrained")
    true = board_corners_m()
    for name, colour in camera_colours(["left", "right"]).items():
        arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1 / enlarged, "width": 0.004}
        ax.quiver(*true.T, *(landed[name] - true).T, color=colour, label=f"error, {name}", **arrows)
    ax.plot(*true.T, ".", color=TRUTH_COLOUR, markersize=7, label="true corners")
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", xlim=(-0.85, 0.85), ylim=(-0.55, 0.75))
    ax.set_title(f"registration errors, {enlarged:g} times enlarged", fontsize=11)
    ax.legend(loc="upper right", ncols=3)
    return fig


def pixel_on_floor_mm(camera: Camera, x_m: Sequence[float]) -> pd.DataFrame:
    """How much floor one pixel covers at places along the axis y = 0: across the line of sight, and along it, in mm."""
    rows = []
    for x in x_m:
        here = camera.floor_to_pixels([[x, 0.0]]) + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        lands = camera.pixels_to_floor(here)
        across, along = 1000 * np.linalg.norm(lands[1:] - lands[0], axis=1)
        rows.append((x, abs(x - camera.centre_m[0]), across, along))
    return pd.DataFrame(rows, columns=["x (m)", "distance (m)", "across (mm)", "along (mm)"])


def clicked_marks(camera: Camera, *, click_px: float, trials: int, seed: int) -> pd.DataFrame:
    """Error in mm at the board's corners when the homography comes from marks clicked with a normal error.

    A row for four marks and for eight, over all trials and corners.
    """
    pixels, metres = load_marks(_MARKS)[camera.name]
    true = board_corners_m()
    straight = camera.lens.undistort(camera.floor_to_pixels(true))
    clicks = np.random.default_rng(seed).normal(0, click_px, size=(trials, *pixels.shape))
    rows = {}
    for label, chosen in {"4 marks": [0, 2, 5, 7], "8 marks": list(range(8))}.items():
        fits = [floor_homography_from_marks(camera, (pixels + click)[chosen], metres[chosen]) for click in clicks]
        lands = np.stack([apply_homography(fit.image_to_floor, straight) for fit in fits])
        error = 1000 * np.linalg.norm(lands - true, axis=-1)
        rows[label] = {"mean (mm)": error.mean(), "max (mm)": error.max()}
    return pd.DataFrame(rows).T


def bumped(camera: Camera, tilt_deg: float) -> Camera:
    """The same camera after a nod of ``tilt_deg`` about its own horizontal axis; its centre stays where it is."""
    angle, (rotation, _) = np.radians(tilt_deg), camera.pose
    nod = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    turned = nod @ rotation
    return Camera.from_pose(camera.name, camera.size, camera.lens, turned, -turned @ camera.centre_m)


def tilt_errors(camera: Camera, tilt_deg: float, x_m: Sequence[float]) -> pd.DataFrame:
    """How far a bumped camera misplaces floor points along y = 0, through the full model and by the formula, in mm."""
    line = np.column_stack([x_m, np.zeros(len(x_m))])
    lands = camera.pixels_to_floor(bumped(camera, tilt_deg).floor_to_pixels(line))
    height, distance = camera.centre_m[2], np.abs(line[:, 0] - camera.centre_m[0])
    return pd.DataFrame(
        {
            "distance (m)": distance,
            "measured (mm)": 1000 * np.linalg.norm(lands - line, axis=1),
            "predicted (mm)": 1000 * (height**2 + distance**2) / height * np.radians(tilt_deg),
        }
    )


def box_reach_m(camera: Camera, edge_m: float, height_m: float) -> float:
    """How far a box's smear reaches, in m from the floor point below the camera.

    ``edge_m`` is the distance of its far upper edge from there, ``height_m`` its height: ``d + d h / (H - h)``.
    """
    high = camera.centre_m[2]
    return float(edge_m * high / (high - height_m))


def ball_reach_m(camera: Camera, distance_m: float, radius_m: float) -> float:
    """The same for a ball on the floor, which has no edge: the last ray is the tangent over its top."""
    high = camera.centre_m[2]
    down = np.arctan2(high - radius_m, distance_m) - np.arcsin(radius_m / np.hypot(distance_m, high - radius_m))
    return float(high / np.tan(down))


def reach_table(
    rig: Rig,
    floor: Floor,
    cabinet: Mapping[str, Mask],
    ball: Mapping[str, Mask],
    *,
    lid_m: tuple[float, float],
    ball_m: tuple[float, float],
) -> pd.DataFrame:
    """How far each camera's mask reaches on the floor, predicted and measured, in m from the point below the camera.

    Parameters
    ----------
    cabinet, ball
        Each camera's foreground on the floor, bool (ny, nx).
    lid_m
        Of the cabinet, whose middle is at x = 0: half the width of its upper edge, and its height.
    ball_m
        The x of the ball's place, and its radius.
    """
    x = floor.cell_centres_m().reshape(*floor.shape, 2)[..., 0]
    rows = []
    for name, camera in rig.cameras.items():
        towards = -np.sign(camera.centre_m[0])  # left looks along x, right against it
        station = towards * camera.centre_m[0]
        predicted = {
            "cabinet": box_reach_m(camera, lid_m[0] - station, lid_m[1]),
            "ball": ball_reach_m(camera, towards * ball_m[0] - station, ball_m[1]),
        }
        for key, masks in {"cabinet": cabinet, "ball": ball}.items():
            rows.append((key, name, predicted[key], (towards * x[masks[name]]).max() - station))
    table = pd.DataFrame(rows, columns=["object", "camera", "predicted (m)", "measured (m)"])
    return table.sort_values(["object", "camera"], ignore_index=True)


def smear_figure(
    rig: Rig,
    floor: Floor,
    masks: Mapping[str, Mapping[str, Mask]],
    truth: Mapping[str, Sequence[TrueObject | npt.ArrayLike]],
    reach: pd.DataFrame,
) -> Figure:
    """Each object's foreground from both cameras on the floor, with the predicted end of each smear, dotted."""
    fig, axes = plt.subplots(1, len(masks), figsize=(10, 3.3), layout="constrained")
    colours = camera_colours(list(rig.cameras))
    for ax, (key, views) in zip(axes, masks.items(), strict=True):
        show_views_on_floor(ax, views, floor)
        show_footprints(ax, truth[key])
        for row in reach[reach["object"] == key].to_dict("records"):
            x = rig[row["camera"]].centre_m[0]
            end = x - np.sign(x) * row["predicted (m)"]
            ax.axvline(end, color=colours[row["camera"]], linestyle=":", linewidth=2)
        ax.set_title(key, fontsize=11)
        ax.set(ylim=(-0.9, 0.9))
    _legend_below(fig)
    return fig


def _legend_below(fig: Figure) -> None:
    handles, labels = fig.axes[0].get_legend_handles_labels()
    for ax in fig.axes:
        ax.get_legend().remove()  # type: ignore[union-attr]
    fig.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=10)


def views_on_plane(rig: Rig, masks: Mapping[str, Mask], floor: Floor, height_m: float) -> dict[str, Mask]:
    """Each camera's foreground, bool (H, W), on the horizontal plane at this height, bool (ny, nx)."""
    return {name: FloorWarp(rig[name], floor, height_m).warp(mask) for name, mask in masks.items()}


def planes_figure(
    rig: Rig, masks: Mapping[str, Mask], floor: Floor, heights_m: Sequence[float], footprint_m: npt.ArrayLike
) -> Figure:
    """Both views of an object on horizontal planes at several heights, beside each other, with its true outline."""
    wide = 10.0 if len(heights_m) > 1 else 5.0
    fig, axes = plt.subplots(1, len(heights_m), figsize=(wide, 2.6), layout="constrained", squeeze=False, sharey=True)
    for ax, height in zip(axes[0], heights_m, strict=True):
        views = views_on_plane(rig, masks, floor, height)
        show_views_on_floor(ax, views, floor)
        show_footprints(ax, [footprint_m])
        both = int(np.all(list(views.values()), axis=0).sum()) * floor.cell_area
        ax.set_title(f"plane at {height:.2f} m: both {both:.2f} m²", fontsize=11)
        ax.set(xlim=(-1.7, 1.7), ylim=(-0.7, 0.7), ylabel="y (m)" if ax is axes[0][0] else "")
    _legend_below(fig)
    return fig


def show_plane(rig: Rig, masks: Mapping[str, Mask], floor: Floor, height_m: float, footprint_m: npt.ArrayLike) -> None:
    """Show :func:`planes_figure` for one height: for a slider."""
    planes_figure(rig, masks, replace(floor, resolution=0.02), [height_m], footprint_m)
    plt.show()


def disc_picture(camera: Camera, centre_m: npt.ArrayLike, diameter_m: float) -> Image:
    """A camera's ideal picture of a white disc on a black floor, uint8 (H, W): grey where a pixel is partly covered."""
    rim = np.asarray(centre_m, dtype=float) + diameter_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    low = np.floor(camera.floor_to_pixels(rim).min(axis=0)).astype(int)
    high = np.ceil(camera.floor_to_pixels(rim).max(axis=0)).astype(int) + 1
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    cover = np.zeros(camera.size[::-1])
    samples = (-0.375, -0.125, 0.125, 0.375)  # 4 x 4 a pixel
    for dx in samples:
        for dy in samples:
            lands = camera.pixels_to_floor(np.column_stack([x.ravel() + dx, y.ravel() + dy]))
            inside = np.linalg.norm(lands - np.asarray(centre_m), axis=1) < diameter_m / 2
            cover[low[1] : high[1], low[0] : high[0]] += inside.reshape(x.shape)
    return np.round(cover / len(samples) ** 2 * 255).astype(np.uint8)


def grid_scores(
    camera: Camera, picture: Image, centre_m: npt.ArrayLike, diameter_m: float, repeats: Sequence[int]
) -> pd.DataFrame:
    """How well a disc is kept on the floor, by size of the cells: threshold at one half before the warp, and after.

    Parameters
    ----------
    picture
        From :func:`disc_picture`.
    repeats
        Sizes of the map's cells, in multiples of 2.5 mm; divisors of 256.

    Returns
    -------
    Intersection over union with the true disc, counted on cells of 2.5 mm: 1 is perfect.
    """
    fine, centre = 0.0025, np.asarray(centre_m, dtype=float)
    x, y = ((c - 128 * fine, c + 128 * fine) for c in centre)
    area = Floor(x, y, fine)
    true = (np.linalg.norm(area.cell_centres_m() - centre, axis=1) < diameter_m / 2).reshape(area.shape)
    rows = {}
    for repeat in repeats:
        warp = FloorWarp(camera, Floor(x, y, fine * repeat))
        masks = {"threshold first": warp.warp(picture > 127), "warp first": warp.warp(picture) > 127}
        spread = {order: np.kron(mask, np.ones((repeat, repeat), dtype=bool)) for order, mask in masks.items()}
        rows[fine * repeat] = {order: (mask & true).sum() / (mask | true).sum() for order, mask in spread.items()}
    return pd.DataFrame(rows).T.rename_axis("cell (m)")


def threshold_figure(camera: Camera, picture: Image, centre_m: npt.ArrayLike, diameter_m: float) -> Figure:
    """The soft picture of a disc, and its mask on cells of 5 mm: threshold first, and warp first."""
    centre = np.asarray(centre_m, dtype=float)
    fig, axes = plt.subplots(1, 3, figsize=(10, 3.4), layout="constrained")
    show_image(axes[0], picture)
    rows, columns = np.nonzero(picture)
    axes[0].set(xlim=(columns.min() - 4, columns.max() + 4), ylim=(rows.max() + 4, rows.min() - 4))
    turns = np.linspace(0, 2 * np.pi, 60)
    circle = centre + diameter_m / 2 * np.column_stack([np.cos(turns), np.sin(turns)])
    x, y = ((c - 0.2, c + 0.2) for c in centre)
    warp = FloorWarp(camera, Floor(x, y, 0.005))
    for ax, mask in ((axes[1], warp.warp(picture > 127)), (axes[2], warp.warp(picture) > 127)):
        show_floor(ax, mask, warp.floor, alpha=0.6)
        show_footprints(ax, [circle])
        ax.get_legend().remove()
    titles = ("the disc in the picture", "threshold, then warp", "warp, then threshold")
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, fontsize=11)
    return fig
