"""Drawings that only notebooks need: lamps and shadows, the room and its cameras, strips of frames, mask errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.geometry import Camera, Rig
from occlib.plotting import (
    TRUTH_COLOUR,
    camera_colours,
    new_figure,
    outline_on_image,
    show_floor,
    show_image,
    show_map,
    show_view,
)

if TYPE_CHECKING:
    import pandas as pd

    from occlib.explaining import PolarWarp, Prism
    from occlib.formats import TrueObject, Truth
    from occlib.pipeline import FrameResult


def cover_heads(image: Image, camera: Camera, people: Sequence[TrueObject], *, radius_m: float = 0.2) -> Image:
    """A copy of a picture with a grey disc and the id over the head of everyone in ``people``: no face is needed.

    ``people`` are objects of the truth; the head is taken to be 1.62 m above the feet.
    """
    covered = image.copy()
    for person in people:
        (x, y), above = camera.project([[person.x, person.y, height] for height in (1.62, 1.62 + radius_m)])
        radius = float(np.hypot(x - above[0], y - above[1]))
        if np.isfinite(radius):
            cv2.circle(covered, (round(x), round(y)), round(radius), (150, 150, 150), -1)
            corner = (round(x - 0.4 * radius), round(y + 0.4 * radius))
            cv2.putText(
                covered,
                str(person.id),
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


def outline_cylinders(ax: Axes, warp: PolarWarp, cylinders: Sequence[Prism], **options: Any) -> None:
    """Outline of each upright cylinder, with its number, in a camera's polar view."""
    from occlib.explaining import silhouette

    rows, columns = warp.shape
    for number, cylinder in enumerate(cylinders, start=1):
        first, top, bottom = silhouette(warp.parameters, columns, rows, cylinder)
        if len(top):
            x = np.arange(first, first + len(top))
            outline = np.column_stack([np.concatenate([x, x[::-1], x[:1]]), [*top, *bottom[::-1], top[0]]])
            ax.plot(*outline.T, **{"color": "white", "linewidth": 1.5, **options})
            ax.annotate(str(number), (x.mean(), top.min()), xytext=(0, 4), textcoords="offset points", ha="center",
                        color=options.get("color", "white"))  # fmt: skip


def lamps_and_shadows(
    ax: Axes,
    lamps: Mapping[str, tuple[float, float]],
    objects: Mapping[str, tuple[float, float, float]],
    reach: tuple[float, float],
) -> None:
    """Cameras as lamps, in section: upright objects, the shadow each lamp casts behind them, and the umbra of all.

    Parameters
    ----------
    ax
        Where to draw; x along the floor and height, both in m.
    lamps
        Position ``(x, z)`` of each camera in m.
    objects
        For each object ``(x_min, x_max, height)`` in m; the first one is drawn with its rays.
    reach
        Floor ``(x_min, x_max)`` in m.
    """
    colours = camera_colours(list(lamps))
    cells = np.linspace(*reach, 2001)
    umbra = np.ones(cells.shape, bool)
    ax.plot(reach, (0, 0), color="0.3", linewidth=1)
    for row, (name, (x, z)) in enumerate(lamps.items()):
        shadow = np.zeros(cells.shape, bool)
        for i, (low, high, height) in enumerate(objects.values()):
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
    for name, (low, high, height) in objects.items():
        ax.fill([low, high, high, low], [0, 0, height, height], color="0.35")
        if height > 0.3:  # inside: above it are the rays
            ax.text((low + high) / 2, height / 2, name, color="white", ha="center", va="center")
        else:
            ax.annotate(name, ((low + high) / 2, height), xytext=(0, 4), textcoords="offset points", ha="center")
    ax.set(xlabel="x (m)", ylabel="height (m)", aspect="equal", yticks=[0, 1, 2])
    ax.spines[["top", "right"]].set_visible(False)


def _strip(ax: Axes, x: npt.NDArray[Any], on: Mask, row: int, label: str, colour: str) -> None:
    top = -0.18 - 0.24 * row
    ax.fill_between(x, top - 0.15, top, where=on, color=colour, linewidth=0)
    ax.plot(x[[0, -1]], [top - 0.15, top - 0.15], color="0.8", linewidth=0.8)
    ax.annotate(label, (x[-1], top - 0.15), xytext=(6, 1), textcoords="offset points", color=colour, fontsize=11)


def views_and_map(
    rig: Rig,
    images: Mapping[str, Image | None],
    result: FrameResult,
    truth: Sequence[TrueObject],
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
        hidden = [true for true in truth if true.hidden_fraction.get(name, 0) > 0.9]
        for true in shown:
            gone = true in hidden
            if gone:
                outline_on_image(ax, rig[name], true.footprint or (), color="white", linestyle="--", linewidth=2)
            pixel = rig[name].floor_to_pixels([[true.x, true.y]])[0]
            text, offset = (f"{true.label}: hidden here", (0, 62)) if gone else (true.label or "", (70, -22))
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
    truth: Truth,
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
        By frame number, at least for the frames of ``images``.
    crops, window_m
        As for :func:`views_and_map`.
    """
    names, colours = list(rig.cameras), camera_colours(list(rig.cameras))
    fig, axes = new_figure(len(images), len(names) + 1, width=2.0 * len(images), height=2.1 * (len(names) + 1))
    axes = axes.reshape(len(names) + 1, len(images))  # one frame, too
    for column, frame in zip(axes.T, images, strict=True):
        marked = truth.frames[frame]
        for ax, name in zip(column, names, strict=False):
            reason = results[frame].excluded.get(name, "")
            show_view(ax, rig[name], images[frame].get(name), reason=reason)
            for true in marked:
                if true.hidden_fraction.get(name, 0) > 0.9 and not reason:
                    outline_on_image(ax, rig[name], true.footprint or (), color="white", linestyle="--", linewidth=1.6)
            left, right, top, bottom = crops[name]
            ax.set(xlim=(left, right), ylim=(bottom, top))
            ax.set_ylabel(f"{name} view" if frame == next(iter(images)) else "", color=colours[name], fontsize=12)
        column[0].set_title(f"t = {results[frame].time:.1f} s", fontsize=12)
        show_map(column[-1], results[frame].map)
        for found in results[frame].objects:
            column[-1].text(*found.position_m, str(found.id), color="white", ha="center", va="center", fontsize=12)
        for footprint in (true.footprint for true in marked if true.footprint):
            outline = np.vstack([footprint, footprint[:1]])
            column[-1].plot(*outline.T, color=TRUTH_COLOUR, linewidth=1.2)
        column[-1].set(xlim=window_m[:2], ylim=window_m[2:])
    for ax in axes[-1, 1:]:
        ax.set(ylabel="", yticklabels=[])
    axes[-1, 0].plot([], [], color=TRUTH_COLOUR, linewidth=1.2, label="true footprint")
    fig.legend(*axes[-1, 0].get_legend_handles_labels(), loc="outside lower center", fontsize=11)
    return fig


def film_frame(
    rig: Rig,
    images: Mapping[str, Image | None],
    result: FrameResult,
    truth: Sequence[TrueObject],
    *,
    crops: Mapping[str, tuple[int, int, int, int]],
    window_m: tuple[float, float, float, float],
    width_px: int = 960,
) -> Image:
    """One picture of a film, RGB uint8: the views of an instant, hidden objects outlined, and the map made from them.

    Parameters as for :func:`views_and_map`; the film's size is the same for every instant.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    names, colours = list(rig.cameras), camera_colours(list(rig.cameras))
    panels = len(names) + 1
    fig = Figure(figsize=(4.0 * panels, 3.6), dpi=width_px / (4.0 * panels))
    axes = [fig.add_axes((i / panels + 0.003, 0.01, 1 / panels - 0.006, 0.86)) for i in range(panels)]
    for ax, name in zip(axes, names, strict=False):
        show_view(ax, rig[name], images.get(name), reason=result.excluded.get(name, ""))
        hidden = [true for true in truth if true.hidden_fraction.get(name, 0) > 0.9 and name not in result.excluded]
        for true in hidden:
            outline_on_image(ax, rig[name], true.footprint or (), color="white", linestyle="--", linewidth=2)
        left, right, top, bottom = crops[name]
        ax.set(xlim=(left, right), ylim=(bottom, top))
        ax.set_title(f"{name} camera: {len(truth) - len(hidden)} of {len(truth)}", color=colours[name], fontsize=17)
        ax.spines[:].set(color=colours[name], linewidth=3)
    _umbra_map(axes[-1], rig, result, truth, window_m)
    axes[-1].set(xticks=[], yticks=[], xlabel="", ylabel="")
    axes[-1].set_title(f"map: {len(result.objects)} of {len(truth)}", fontsize=17)
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _umbra_map(
    ax: Axes, rig: Rig, result: FrameResult, truth: Sequence[TrueObject], window_m: tuple[float, ...]
) -> None:
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
    for true in truth:
        footprint = true.footprint or ((true.x, true.y),)
        ax.plot(*np.vstack([footprint, footprint[:1]]).T, color="#F0E442", linewidth=2)
        top = max(y for _, y in footprint)
        ax.annotate(true.label or "", (true.x, top), xytext=(0, 8), textcoords="offset points", ha="center",
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
    rays = camera.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    rays = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    low, high = np.asarray(room, dtype=float).T
    distance = (np.where(rays > 0, high, low) - camera.centre_m) / rays  # to the wall ahead, axis by axis
    return np.asarray(camera.centre_m + rays * distance.min(axis=1, keepdims=True))


def rig_section(ax: Axes, rig: Rig, room: npt.ArrayLike, *, axes: str = "xy") -> None:
    """The rig to scale, from above (``"xy"``) or the side (``"xz"``): room, mapped floor, what each camera sees."""
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


def rig_in_3d(ax: Any, rig: Rig, room: npt.ArrayLike, objects: Mapping[str, npt.ArrayLike]) -> None:
    """The vision system as a drawing: room, mapped floor, cameras, a computer on a wall, and what it talks to.

    Parameters
    ----------
    ax
        A 3-D axes made with ``projection="3d", computed_zorder=False``, in m.
    rig, room
        As for :func:`rig_section`.
    objects
        For each object ``(x, y, width, depth, height)`` in m: a box that hears the computer's broadcast.
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
    ax.text(*computer, "CPU", color="white", ha="center", va="center")
    for name, size in objects.items():
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
        A row for each frame and way of looking: ``time`` in s, ``way``, ``state`` (``"seen"`` or ``"coasting"``), ``sd
        (cm)``, and for each camera the share of the object that it sees. The first way's shares are shown.
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
    bottom.set_yticks([3, 5, 10, 20, 50], ["3", "5", "10", "20", "50"])
    bottom.minorticks_off()
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
