"""Figures: each function draws on an ``Axes`` it is given, or returns a new ``Figure``.

One fixed colour a camera (Okabe and Ito, distinguishable by the colour-blind); floor axes in metres, north up.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke

from occlib.geometry import Camera, FloatArray, Floor, Image, Mask, Rig

if TYPE_CHECKING:
    import pandas as pd

    from occlib.explaining import Cylinder
    from occlib.mapping import OccupancyMap
    from occlib.matching import Match
    from occlib.pipeline import FrameResult
    from occlib.registration import PolarWarp
    from occlib.tracking import ObjectVector

CAMERA_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
TRUTH_COLOUR = "#D55E00"
REASON_COLOURS = {1: "#BFBFBF", 2: "#FBE3B5", 3: "#D9C9E8", 4: "#CDE8D5"}
"""Why a cell is unknown, :data:`occlib.mapping.REASONS`: grey, pale orange, pale violet, pale green; in grey print from dark to light."""


def camera_colours(names: Sequence[str]) -> dict[str, str]:
    """The colour of each camera, in the order of the rig: left blue, right orange."""
    return {name: CAMERA_COLOURS[i % len(CAMERA_COLOURS)] for i, name in enumerate(names)}


def new_figure(columns: int = 1, rows: int = 1, *, width: float = 10.0, height: float = 4.0) -> tuple[Figure, Any]:
    """A figure of its own (not pyplot's) and its axes, squeezed as ``plt.subplots`` does. Sizes in inches."""
    fig = Figure(figsize=(width, height), layout="constrained")
    return fig, fig.subplots(rows, columns)


def show_image(ax: Axes, image: Image, title: str = "", *, colour: str | None = None, **options: Any) -> AxesImage:
    """An image in px, without ticks; grey levels in grey from 0 to 255 unless told otherwise."""
    if image.ndim == 2:
        options = {"cmap": "gray", "vmin": 0, "vmax": 1 if image.dtype == np.bool_ else 255, **options}
    picture = ax.imshow(image, **options)
    ax.set(xticks=[], yticks=[])
    ax.set_title(title, color=colour or "black", fontsize=10)
    return picture


def show_view(
    ax: Axes, camera: Camera, image: Image | None, title: str = "", *, colour: str | None = None, reason: str = ""
) -> None:
    """A camera's picture or, where it has none, an empty panel of its size; across it why the camera was left out, if it was.

    Parameters
    ----------
    image
        uint8 RGB (H, W, 3), ``None`` if the camera has dropped out.
    reason
        As in ``FrameResult.excluded``; empty if the camera was used.
    """
    width, height = camera.size
    show_image(ax, np.full((height, width, 3), 235, np.uint8) if image is None else image, title, colour=colour)
    if image is None or reason:
        text = "no picture" if image is None else f"{reason}, not used"
        ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color="0.1", fontsize=12,
                bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "0.6"})  # fmt: skip


def show_floor(ax: Axes, values: npt.NDArray[Any], floor: Floor, title: str = "", **options: Any) -> AxesImage:
    """A floor array (ny, nx) or (ny, nx, 3) with axes in metres."""
    if values.ndim == 2:
        options = {"cmap": "gray_r", "vmin": 0, "vmax": 1 if values.dtype == np.bool_ else None, **options}
    picture = ax.imshow(values, origin="lower", extent=floor.extent, interpolation="nearest", **options)
    ax.set(xlabel="x (m)", ylabel="y (m)")
    ax.set_title(title, fontsize=10)
    return picture


def show_views_on_floor(
    ax: Axes, views: Mapping[str, Mask], floor: Floor, title: str = "", *, cameras: Sequence[str] = ()
) -> None:
    """Each view's foreground in its camera's colour; dark where all of them agree.

    ``cameras``: all those of the rig, where some have no view now: each keeps its colour.
    """
    colours = camera_colours(list(cameras or views))
    canvas = np.ones((*floor.shape, 3))
    for name, mask in views.items():
        canvas[mask] *= 0.35 + 0.65 * np.array(to_rgb(colours[name]))
    if len(views) > 1:
        canvas[np.all(list(views.values()), axis=0)] = 0.1
    show_floor(ax, canvas, floor, title)
    for name in views:
        ax.plot([], [], "s", color=colours[name], label=f"{name} only")
    if len(views) > 1:
        ax.plot([], [], "s", color="0.1", label="both" if len(views) == 2 else "all")
    if views:
        ax.legend(loc="upper right", fontsize=7, framealpha=0.9)


def show_map(
    ax: Axes,
    grid: OccupancyMap,
    objects: Sequence[ObjectVector] = (),
    *,
    truth: Sequence[Mapping[str, Any]] = (),
    title: str = "",
    reason: npt.NDArray[np.uint8] | None = None,
) -> None:
    """The occupancy map (white free, black occupied, grey unknown), its objects and, dashed, the true footprints.

    With ``reason``, uint8 (ny, nx) as in ``FrameResult``, what is unknown is tinted by its reason, and a legend names those
    that occur.
    """
    shade = np.select([grid.data == 100, grid.data == 0], [0.1, 1.0], 0.75)
    if reason is None:
        show_floor(ax, shade, grid.floor, title, cmap="gray", vmax=1)
    else:
        _show_reasons(ax, shade, reason, grid.floor, title)
    for thing in objects:
        (x, y), (vx, vy) = thing.position_m, thing.velocity_mps
        ax.plot(x, y, "o", color=np.array(thing.colour) / 255, markeredgecolor="white", markersize=7)
        number = ax.annotate(
            str(thing.id), (x, y), xytext=(6, 6), textcoords="offset points", fontsize=9, color="white"
        )
        number.set_path_effects([withStroke(linewidth=2.5, foreground="#0072B2")])  # on black and on white alike
        if np.hypot(vx, vy) > 0.05:
            ax.annotate("", (x + vx, y + vy), (x, y), arrowprops={"arrowstyle": "->", "color": "#0072B2"})
    show_footprints(ax, truth)


def _show_reasons(ax: Axes, shade: FloatArray, reason: npt.NDArray[np.uint8], floor: Floor, title: str) -> None:
    from occlib.mapping import REASONS

    canvas = np.repeat(shade[..., None], 3, axis=2)
    for kind in [kind for kind in REASONS if (reason == kind).any()]:
        canvas[reason == kind] = to_rgb(REASON_COLOURS[kind])
        ax.plot([], [], "s", color=REASON_COLOURS[kind], markeredgecolor="0.5", label=f"unknown: {REASONS[kind]}")
    show_floor(ax, canvas, floor, title)
    if reason.any():
        ax.legend(loc="upper right", fontsize=7, framealpha=0.9)


def show_footprints(ax: Axes, truth: Sequence[Mapping[str, Any]]) -> None:
    """True footprints dashed, or a cross where truth has a point only."""
    for thing in truth:
        outline = np.asarray(thing.get("footprint") or [[thing["x"], thing["y"]]], dtype=float)
        if len(outline) > 1:
            ax.plot(*np.vstack([outline, outline[:1]]).T, "--", color=TRUTH_COLOUR, linewidth=1)
        else:
            ax.plot(*outline.T, "+", color=TRUTH_COLOUR, markersize=8)
    if truth:
        ax.plot([], [], "--", color=TRUTH_COLOUR, label="truth")
        ax.legend(loc="upper right", fontsize=7)


def cover_heads(image: Image, camera: Camera, people: Sequence[Mapping[str, Any]], *, radius_m: float = 0.2) -> Image:
    """A copy of a picture with a grey disc and the id over the head of everyone in ``people``: no face is needed.

    ``people`` are entries of the truth, with ``id``, ``x`` and ``y``; the head is taken to be 1.62 m above the feet.
    """
    covered = image.copy()
    for person in people:
        (x, y), above = camera.project([[person["x"], person["y"], height] for height in (1.62, 1.62 + radius_m)])
        radius = float(np.hypot(x - above[0], y - above[1]))
        if np.isfinite(radius):
            cv2.circle(covered, (round(x), round(y)), round(radius), (150, 150, 150), -1)
            corner = (round(x - 0.4 * radius), round(y + 0.4 * radius))
            cv2.putText(
                covered,
                str(person["id"]),
                corner,
                cv2.FONT_HERSHEY_SIMPLEX,
                radius / 24,
                (0, 0, 0),
                max(1, round(radius / 15)),
            )
    return covered


def fill_hull(ax: Axes, points: npt.ArrayLike, **options: Any) -> FloatArray:
    """Fill the convex hull of points (N, 2) and return its corners (M, 2): a convex solid's outline or shadow."""
    from scipy.spatial import ConvexHull

    corners = np.asarray(points, dtype=float)
    corners = corners[ConvexHull(corners).vertices]
    ax.fill(*corners.T, **{"edgecolor": "black", "linewidth": 0.8, **options})
    return corners


def outline_on_image(ax: Axes, camera: Camera, outline_m: npt.ArrayLike, **options: Any) -> None:
    """A closed floor polygon (M, 2) in m, drawn where the camera sees it."""
    corners = np.asarray(outline_m, dtype=float)
    corners = np.vstack([corners, corners[:1]])
    steps = np.linspace(0, 1, 9)[:-1, None]  # straight on the floor is bent by the lens
    path = np.vstack([a + steps * (b - a) for a, b in pairwise(corners)] + [corners[-1:]])
    pixels = camera.floor_to_pixels(path)
    pixels[~camera.inside(pixels)] = np.nan
    ax.plot(*pixels.T, **{"linewidth": 1.2, **options})


def outline_cylinders(ax: Axes, warp: PolarWarp, things: Sequence[Cylinder], **options: Any) -> None:
    """Outline of each upright cylinder, with its number, in a camera's polar view."""
    from occlib.explaining import room_for_runs, silhouette

    rows, columns = warp.shape
    runs = room_for_runs(columns)
    for number, thing in enumerate(things, start=1):
        first, last = silhouette(warp.parameters, columns, rows, thing.x, thing.y, thing.radius, thing.height, runs)
        if last > first:
            x, (top, bottom) = np.arange(first, last), runs[: last - first, :2].T
            outline = np.column_stack([np.concatenate([x, x[::-1], x[:1]]), [*top, *bottom[::-1], top[0]]])
            ax.plot(*outline.T, **{"color": "white", "linewidth": 1.5, **options})
            ax.annotate(str(number), (x.mean(), top.min()), xytext=(0, 4), textcoords="offset points", ha="center",
                        color=options.get("color", "white"))  # fmt: skip


def lamps_and_shadows(
    ax: Axes,
    lamps: Mapping[str, tuple[float, float]],
    things: Mapping[str, tuple[float, float, float]],
    reach: tuple[float, float],
) -> None:
    """Cameras as lamps, in section: upright things, the shadow each lamp casts behind them, and the umbra of all.

    Parameters
    ----------
    ax
        Where to draw; x along the floor and height, both in m.
    lamps
        Position ``(x, z)`` of each camera in m.
    things
        For each thing ``(x_min, x_max, height)`` in m; the first one is drawn with its rays.
    reach
        Floor ``(x_min, x_max)`` in m.
    """
    colours = camera_colours(list(lamps))
    cells = np.linspace(*reach, 2001)
    umbra = np.ones(cells.shape, bool)
    ax.plot(reach, (0, 0), color="0.3", linewidth=1)
    for row, (name, (x, z)) in enumerate(lamps.items()):
        shadow = np.zeros(cells.shape, bool)
        for i, (low, high, height) in enumerate(things.values()):
            ends = [x + (corner - x) * scale for corner in (low, high) for scale in (1.0, z / (z - height))]
            shadow |= (cells >= min(ends)) & (cells <= max(ends))
            if i == 0:
                far = max(ends, key=lambda end: abs(end - x))
                ax.fill([x, far, high if far > x else low], [z, 0, 0], color=colours[name], alpha=0.13, linewidth=0)
                ax.plot([x, far], [z, 0], color=colours[name], linewidth=1)
        ax.plot(x, z, "o", color=colours[name], markersize=11)
        ax.annotate(f"{name} camera", (x, z), xytext=(0, 11), textcoords="offset points", ha="center",
                    color=colours[name])  # fmt: skip
        _strip(ax, cells, shadow, row, f"{name} says occupied", colours[name])
        umbra &= shadow
    _strip(ax, cells, umbra, len(lamps), "both say occupied", "0.1")
    for name, (low, high, height) in things.items():
        ax.fill([low, high, high, low], [0, 0, height, height], color="0.35")
        ax.annotate(name, ((low + high) / 2, height), xytext=(0, 4), textcoords="offset points", ha="center")
    ax.set(xlabel="x (m)", ylabel="height (m)", aspect="equal", yticks=[0, 1, 2])
    ax.spines[["top", "right"]].set_visible(False)


def _strip(ax: Axes, x: npt.NDArray[Any], on: Mask, row: int, label: str, colour: str) -> None:
    top = -0.18 - 0.24 * row
    ax.fill_between(x, top - 0.15, top, where=on, color=colour, linewidth=0)
    ax.plot(x[[0, -1]], [top - 0.15, top - 0.15], color="0.8", linewidth=0.8)
    ax.annotate(label, (x[-1], top - 0.15), xytext=(6, 1), textcoords="offset points", color=colour, fontsize=9)


def views_and_map(
    rig: Rig,
    images: Mapping[str, Image | None],
    result: FrameResult,
    truth: Sequence[Mapping[str, Any]],
    *,
    crops: Mapping[str, tuple[int, int, int, int]],
    window_m: tuple[float, float, float, float],
) -> Figure:
    """The views of an instant side by side, hidden objects outlined, and the one map made from them.

    Parameters
    ----------
    rig, images, result
        What the pipeline was given, and its answer.
    truth
        The true objects of this frame (``truth.json``), with footprints and hidden fractions.
    crops
        For each camera ``(left, right, top, bottom)`` in px: the part of the view that is shown.
    window_m
        ``(x_min, x_max, y_min, y_max)`` of the floor that is shown.
    """
    names = list(rig.cameras)
    colours = camera_colours(names)
    fig, axes = new_figure(columns=len(names) + 1, width=4.0 * (len(names) + 1), height=4.3)
    for ax, name in zip(axes, names, strict=False):
        show_view(ax, rig[name], images.get(name), reason=result.excluded.get(name, ""))
        shown = () if name in result.excluded else truth
        hidden = [thing for thing in truth if thing["hidden_fraction"].get(name, 0) > 0.9]
        for thing in shown:
            gone = thing in hidden
            if gone:
                outline_on_image(ax, rig[name], thing["footprint"], color="white", linestyle="--", linewidth=2)
            pixel = rig[name].floor_to_pixels([[thing["x"], thing["y"]]])[0]
            text, offset = (f"{thing['label']}: hidden here", (0, 62)) if gone else (thing["label"], (70, -22))
            ax.annotate(text, pixel, xytext=offset, textcoords="offset points", color="0.1", fontsize=15,
                        va="center", ha="center", bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "0.6"},
                        arrowprops={"arrowstyle": "-", "color": "white" if gone else "0.2", "linewidth": 1.5})  # fmt: skip
        left, right, top, bottom = crops[name]
        ax.set(xlim=(left, right), ylim=(bottom, top))
        count = result.excluded.get(name) or f"{len(truth) - len(hidden)} of {len(truth)} objects"
        ax.set_title(f"{name} view: {count}", color=colours[name], fontsize=17)
        for spine in ax.spines.values():
            spine.set(color=colours[name], linewidth=3)
    _umbra_map(axes[-1], rig, result, truth, window_m)
    return fig


def frame_strip(
    rig: Rig,
    images: Mapping[int, Mapping[str, Image | None]],
    results: Mapping[int, FrameResult],
    truth: Mapping[str, Sequence[Mapping[str, Any]]],
    *,
    crops: Mapping[str, tuple[int, int, int, int]],
    window_m: tuple[float, float, float, float],
) -> Figure:
    """A column for each of a few frames: the views, what is hidden outlined in white, and the map with its object ids.

    Parameters
    ----------
    rig
        Floor and cameras.
    images, results, truth
        By frame number (in ``truth`` as text), at least for the frames of ``images``.
    crops, window_m
        As for :func:`views_and_map`.
    """
    names, colours = list(rig.cameras), camera_colours(list(rig.cameras))
    fig, axes = new_figure(len(images), len(names) + 1, width=2.4 * len(images), height=2.4 * (len(names) + 1))
    axes = axes.reshape(len(names) + 1, len(images))  # one frame, too
    for column, frame in zip(axes.T, images, strict=True):
        things = truth[str(frame)]
        for ax, name in zip(column, names, strict=False):
            reason = results[frame].excluded.get(name, "")
            show_view(ax, rig[name], images[frame].get(name), reason=reason)
            for thing in things:
                if thing["hidden_fraction"].get(name, 0) > 0.9 and not reason:
                    outline_on_image(ax, rig[name], thing["footprint"], color="white", linestyle="--", linewidth=1.6)
            left, right, top, bottom = crops[name]
            ax.set(xlim=(left, right), ylim=(bottom, top))
            ax.set_ylabel(f"{name} view" if frame == next(iter(images)) else "", color=colours[name], fontsize=12)
        column[0].set_title(f"t = {results[frame].time:.1f} s", fontsize=12)
        show_map(column[-1], results[frame].map)
        for found in results[frame].objects:
            column[-1].text(*found.position_m, str(found.id), color="white", ha="center", va="center", fontsize=12)
        for thing in things:
            outline = np.vstack([thing["footprint"], thing["footprint"][:1]])
            column[-1].plot(*outline.T, color=TRUTH_COLOUR, linewidth=1.2)
        column[-1].set(xlim=window_m[:2], ylim=window_m[2:])
    for ax in axes[-1, 1:]:
        ax.set_ylabel("")
    axes[-1, 0].plot([], [], color=TRUTH_COLOUR, linewidth=1.2, label="true footprint")
    axes[-1, 0].legend(loc="upper right", fontsize=8)
    return fig


def _umbra_map(ax: Axes, rig: Rig, result: FrameResult, truth: Any, window_m: tuple[float, ...]) -> None:
    """The map over the pale shadows of the single views, with an arrow from each camera's side."""
    colours = camera_colours(list(rig.cameras))
    canvas = np.ones((*rig.floor.shape, 3))
    for name, view in result.views.items():
        canvas[view] *= 0.6 + 0.4 * np.array(to_rgb(colours[name]))
    canvas[result.map.data == 100] = 0.15
    show_floor(ax, canvas, rig.floor)
    left_out = len(rig.cameras) - len(result.views)
    views = (", ".join(result.views) or "no view") if left_out else "both" if len(result.views) == 2 else "all"
    ax.set_title(f"map from {views}: {len(result.objects)} objects", fontsize=17)
    for thing in truth:
        ax.plot(*np.vstack([thing["footprint"], thing["footprint"][:1]]).T, color="#F0E442", linewidth=2)
        top = max(y for _, y in thing["footprint"])
        ax.annotate(thing["label"], (thing["x"], top), xytext=(0, 8), textcoords="offset points", ha="center",
                    fontsize=14)  # fmt: skip
    ax.plot([], [], color="#F0E442", linewidth=2, label="true footprint")
    low, high = window_m[:2]
    for name, camera in rig.cameras.items():
        west = camera.centre_m[0] < (low + high) / 2
        text = f" \u25b6 {name} camera" if west else f"{name} camera \u25c0 "
        ax.text(low if west else high, window_m[2] + 0.06, text, color=colours[name], fontsize=13,
                ha="left" if west else "right")  # fmt: skip
    ax.legend(loc="upper right", fontsize=11, facecolor="0.75", framealpha=0.9)
    ax.set(xlim=window_m[:2], ylim=window_m[2:])
    ax.tick_params(labelsize=11)


def view_points_m(camera: Camera, room: npt.ArrayLike, *, steps: int = 24) -> npt.NDArray[np.float64]:
    """Where a camera's picture meets the floor, walls or ceiling of a room: ``steps`` x ``steps`` pixels, (N, 3) in m.

    Parameters
    ----------
    camera
        It must hang inside the room.
    room
        ``[[x_min, x_max], [y_min, y_max], [z_min, z_max]]`` in m.
    steps
        Pixels along each side of the picture, border included.
    """
    u, v = (np.linspace(0, n - 1, steps) for n in camera.size)
    ideal = camera.undistort_points(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ np.linalg.inv(camera.matrix).T @ camera.pose[0]
    rays = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    low, high = np.asarray(room, dtype=float).T
    distance = (np.where(rays > 0, high, low) - camera.centre_m) / rays  # to the wall ahead, axis by axis
    return np.asarray(camera.centre_m + rays * distance.min(axis=1, keepdims=True))


def rig_section(ax: Axes, rig: Rig, room: npt.ArrayLike, *, axes: str = "xy") -> None:
    """The rig to scale, from above (``"xy"``) or from the side (``"xz"``): room, mapped floor and what each camera sees."""
    from scipy.spatial import ConvexHull

    i, j = ("xyz".index(letter) for letter in axes)
    box, colours = np.asarray(room, dtype=float), camera_colours(list(rig.cameras))
    bounds = {"x": rig.floor.x, "y": rig.floor.y, "z": (-0.06, 0.0)}
    for limits, style in (((box[i], box[j]), {"facecolor": "none", "edgecolor": "0.5", "linewidth": 1.5}),
                          ((bounds[axes[0]], bounds[axes[1]]), {"facecolor": "0.8", "edgecolor": "0.3"})):  # fmt: skip
        (a, b), (c, d) = limits
        ax.fill([a, b, b, a], [c, c, d, d], **style)
    for name, camera in rig.cameras.items():
        ends = np.vstack([camera.centre_m, view_points_m(camera, room)])[:, [i, j]]
        hull = ends[ConvexHull(ends).vertices]
        ax.fill(*hull.T, facecolor=(*to_rgb(colours[name]), 0.14), edgecolor=colours[name], linewidth=1)
        x, y = camera.centre_m[[i, j]]
        ax.plot(x, y, "s", color=colours[name], markersize=9)
        inwards = 1 if x < box[i].mean() else -1
        ax.annotate(name, (x, y), xytext=(9 * inwards, 8), textcoords="offset points", color=colours[name],
                    ha="left" if inwards > 0 else "right")  # fmt: skip
    ax.set(xlabel=f"{axes[0]} (m)", ylabel=f"{axes[1]} (m)", aspect="equal")


def rig_in_3d(ax: Any, rig: Rig, room: npt.ArrayLike, things: Mapping[str, npt.ArrayLike]) -> None:
    """The vision system as a drawing: room, mapped floor, cameras, a computer on a wall, and what it talks to.

    Parameters
    ----------
    ax
        A 3-D axes made with ``projection="3d", computed_zorder=False``, in m.
    rig, room
        As for :func:`rig_section`.
    things
        For each thing ``(x, y, width, depth, height)`` in m: a box that hears the computer's broadcast.
    """
    box, colours = np.asarray(room, dtype=float), camera_colours(list(rig.cameras))
    (x0, x1), (y0, y1), (_, top) = box
    for (a, b), (c, d), shade in (((x0, x1), (y0, y1), "0.95"), (rig.floor.x, rig.floor.y, "0.84")):
        ax.plot_surface(*np.array([[[a, b], [a, b]], [[c, c], [d, d]], [[0, 0], [0, 0]]]), color=shade, shade=False)
    for x, y in ((x0, y1), (x1, y1)):
        ax.plot([x, x], [y, y], [0, top], color="0.7", linewidth=1)
    ax.plot([x0, x1], [y1, y1], [top, top], color="0.7", linewidth=1)
    computer = np.array([(x0 + x1) / 2, y1, 1.3])
    (fx0, fx1), (fy0, fy1) = rig.floor.x, rig.floor.y
    for name, camera in rig.cameras.items():
        centre, colour = camera.centre_m, colours[name]
        for x, y in ((fx0, fy0), (fx0, fy1), (fx1, fy0), (fx1, fy1)):
            ax.plot(*np.array([centre, [x, y, 0]]).T, color=colour, linewidth=1)
        cable = np.array([centre, [centre[0], y1, centre[2]], [computer[0], y1, centre[2]], computer])
        ax.plot(*cable.T, color="0.45", linewidth=1)
        ax.scatter(*centre, color=colour, marker="s", s=80, depthshade=False)
        ax.text(*centre[:2], centre[2] + 0.3, f"{name} camera", color=colour, ha="center")
    ax.bar3d(computer[0] - 0.35, y1 - 0.15, 1.05, 0.7, 0.15, 0.5, color="0.3", shade=False)
    ax.text(*computer, "CPU", color="white", ha="center", va="center", fontsize=8)
    for name, size in things.items():
        x, y, width, depth, height = np.asarray(size, dtype=float)
        ax.bar3d(x - width / 2, y - depth / 2, 0, width, depth, height, color=TRUTH_COLOUR, shade=True)
        ax.text(x, y - depth / 2, -0.35, name, ha="center")
        ax.plot(*np.array([[computer[0], y1 - 0.15, 1.05], [x, y, height]]).T, color="0.2", linestyle=":")
    ax.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", xlim=box[0], ylim=box[1], zlim=box[2], zticks=[0, 1, 2])
    ax.set_box_aspect(np.ptp(box, axis=1), zoom=1.1)
    ax.grid(visible=False)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.pane.set_visible(False)


def vector_life(axes: Sequence[Axes], life: pd.DataFrame, shares: Mapping[str, str]) -> None:
    """What each camera sees of an object; and how sure its vector is of its place, dots seen and crosses coasting.

    Parameters
    ----------
    axes
        Two.
    life
        A row for each frame and way of looking: ``time`` in s, ``way``, ``state`` (``"seen"`` or ``"coasting"``), ``sd (cm)``, and for each
        camera the share of the object that it sees. The first way's shares are shown.
    shares
        ``{camera: colour}``.
    """
    top, bottom = axes
    first = life[(life["way"] == life["way"].iloc[0]) & (life["state"] == "seen")]
    for name, colour in shares.items():
        top.plot(first["time"], first[name], color=colour, label=name)
    for (way, state), part in life.groupby(["way", "state"], sort=False):
        marker, colour = {"seen": ".", "coasting": "x"}[str(state)], "0.1" if way == first["way"].iloc[0] else "#D55E00"
        bottom.plot(part["time"], part["sd (cm)"], marker, color=colour, label=f"{way}, {state}")
    top.set(ylabel="share visible", title="what each camera sees of it")
    bottom.set(xlabel="time (s)", ylabel="sd (cm)", yscale="log", title="how sure its vector is of its place")
    for ax in (top, bottom):
        ax.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    bottom.set_xlim(top.get_xlim())


def show_mask_errors(ax: Axes, mask: Mask, truth: Mask, title: str = "") -> None:
    """A mask against the exact one: hits grey, misses red, false px yellow; ``ax.legend()`` names them."""
    kinds = (
        ("hit", "#BBBBBB", mask & truth),
        ("missed", "#D55E00", truth & ~mask),
        ("false", "#F0E442", mask & ~truth),
    )
    canvas = np.zeros((*mask.shape, 3))
    for name, colour, where in kinds:
        canvas[where] = to_rgb(colour)
        ax.plot([], [], "s", color=colour, label=name)
    show_image(ax, canvas, title)


def show_similarity(
    ax: Axes, scores: npt.NDArray[Any], image_shape: tuple[int, ...], title: str = "", **options: Any
) -> AxesImage:
    """A similarity image in the picture's px, each score at its template's centre; no score is hatched."""
    rows, columns = scores.shape
    x, y = (image_shape[1] - columns) / 2 - 0.5, (image_shape[0] - rows) / 2 - 0.5
    options = {"cmap": "viridis", "interpolation": "nearest", **options}
    picture = ax.imshow(scores, extent=(x, x + columns, y + rows, y), **options)
    ax.patch.set(facecolor="0.9", hatch="///", edgecolor="0.75")
    ax.set(xticks=[], yticks=[], xlim=(-0.5, image_shape[1] - 0.5), ylim=(image_shape[0] - 0.5, -0.5))
    ax.set_title(title, fontsize=10)
    return picture


def show_matches(ax: Axes, matches: Sequence[Match], *, colour: str = "#D55E00") -> None:
    """The frame, turned as the match is, and the centre of each match, on an image in px."""
    for match in matches:
        corners = match.corners_px
        ax.plot(*np.vstack([corners, corners[:1]]).T, color=colour, linewidth=1.4)
        ax.plot(*match.centre_px, "+", color=colour, markersize=8, markeredgewidth=1.6)


def overview(
    rig: Rig, images: Mapping[str, Image | None], result: FrameResult, *, title: str = "", truth: Any = ()
) -> Figure:
    """The views of an instant, their foreground on the floor, and the map: what ``occlib run`` saves.

    A camera without a picture has an empty panel, and one that was left out says why. What is unknown on the map is tinted by
    its reason.
    """
    names = list(rig.cameras)
    colours = camera_colours(names)
    columns = max(2, len(names))
    fig = Figure(figsize=(4.2 * columns, 6.8), layout="constrained")
    grid = fig.add_gridspec(2, 2 * columns)
    floor = rig.floor
    rim = [[floor.x[i], floor.y[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    for i, name in enumerate(names):
        ax = fig.add_subplot(grid[0, 2 * i : 2 * i + 2] if len(names) > 1 else grid[0, :])
        show_view(ax, rig[name], images.get(name), name, colour=colours[name], reason=result.excluded.get(name, ""))
        limits = ax.get_xlim(), ax.get_ylim()
        outline_on_image(ax, rig[name], rim, color=colours[name], linestyle=":")
        for thing in () if name in result.excluded else result.objects:
            pixel = rig[name].floor_to_pixels([thing.position_m])
            if rig[name].inside(pixel)[0]:
                hidden = name in thing.hidden_in
                ax.plot(*pixel.T, "o", markersize=14, markerfacecolor="none", markeredgewidth=1.8,
                        color="white", linestyle="none", alpha=0.5 if hidden else 1.0)  # fmt: skip
                ax.annotate(f"{thing.id}{' hidden' if hidden else ''}", pixel[0], xytext=(9, -12), color="white",
                            textcoords="offset points", fontsize=9, fontweight="bold")  # fmt: skip
        ax.set(xlim=limits[0], ylim=limits[1])
    show_views_on_floor(
        fig.add_subplot(grid[1, :columns]), result.views, floor, "foreground on the floor", cameras=names
    )
    count = f"{len(result.objects)} object{'' if len(result.objects) == 1 else 's'}"
    ax = fig.add_subplot(grid[1, columns:])
    show_map(ax, result.map, result.objects, truth=truth, title=f"map: {count}", reason=result.reason)
    if title:
        fig.suptitle(title, fontsize=11, parse_math=False)
    return fig


def figure_png(fig: Figure, *, dpi: float = 110) -> bytes:
    """The figure as the bytes of a PNG, without a date in it."""
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
