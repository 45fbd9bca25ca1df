"""Figures: each function draws on an ``Axes`` it is given, or returns a new ``Figure``.

One fixed colour a camera (Okabe and Ito, distinguishable by the colour-blind); floor axes in metres, north up.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from occlib.geometry import Camera, Floor, Image, Mask, Rig

if TYPE_CHECKING:
    from occlib.mapping import OccupancyMap
    from occlib.pipeline import FrameResult
    from occlib.tracking import ObjectVector

CAMERA_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
TRUTH_COLOUR = "#D55E00"


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


def show_floor(ax: Axes, values: npt.NDArray[Any], floor: Floor, title: str = "", **options: Any) -> AxesImage:
    """A floor array (ny, nx) or (ny, nx, 3) with axes in metres."""
    if values.ndim == 2:
        options = {"cmap": "gray_r", "vmin": 0, "vmax": 1 if values.dtype == np.bool_ else None, **options}
    picture = ax.imshow(values, origin="lower", extent=floor.extent, interpolation="nearest", **options)
    ax.set(xlabel="x (m)", ylabel="y (m)")
    ax.set_title(title, fontsize=10)
    return picture


def show_views_on_floor(ax: Axes, views: Mapping[str, Mask], floor: Floor, title: str = "") -> None:
    """Each view's foreground in its camera's colour; dark where all of them agree."""
    colours = camera_colours(list(views))
    canvas = np.ones((*floor.shape, 3))
    for name, mask in views.items():
        canvas[mask] *= 0.35 + 0.65 * np.array(to_rgb(colours[name]))
    canvas[np.all(list(views.values()), axis=0)] = 0.1
    show_floor(ax, canvas, floor, title)
    for name, colour in colours.items():
        ax.plot([], [], "s", color=colour, label=f"{name} only")
    if len(views) > 1:
        ax.plot([], [], "s", color="0.1", label="both" if len(views) == 2 else "all")
    ax.legend(loc="upper right", fontsize=7, framealpha=0.9)


def show_map(
    ax: Axes,
    grid: OccupancyMap,
    objects: Sequence[ObjectVector] = (),
    *,
    truth: Sequence[Mapping[str, Any]] = (),
    title: str = "",
) -> None:
    """The occupancy map (white free, black occupied, grey unknown), its objects and, dashed, the true footprints."""
    shade = np.select([grid.data == 100, grid.data == 0], [0.1, 1.0], 0.75)
    show_floor(ax, shade, grid.floor, title, cmap="gray", vmax=1)
    for thing in objects:
        (x, y), (vx, vy) = thing.position_m, thing.velocity_mps
        ax.plot(x, y, "o", color=np.array(thing.colour) / 255, markeredgecolor="white", markersize=7)
        ax.annotate(str(thing.id), (x, y), xytext=(6, 6), textcoords="offset points", fontsize=8, color="#0072B2")
        if np.hypot(vx, vy) > 0.05:
            ax.annotate("", (x + vx, y + vy), (x, y), arrowprops={"arrowstyle": "->", "color": "#0072B2"})
    show_footprints(ax, truth)


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


def outline_on_image(ax: Axes, camera: Camera, outline_m: npt.ArrayLike, **options: Any) -> None:
    """A closed floor polygon (M, 2) in m, drawn where the camera sees it."""
    corners = np.asarray(outline_m, dtype=float)
    corners = np.vstack([corners, corners[:1]])
    steps = np.linspace(0, 1, 9)[:-1, None]  # straight on the floor is bent by the lens
    path = np.vstack([a + steps * (b - a) for a, b in pairwise(corners)] + [corners[-1:]])
    pixels = camera.floor_to_pixels(path)
    pixels[~camera.inside(pixels)] = np.nan
    ax.plot(*pixels.T, **{"linewidth": 1.2, **options})


def overview(rig: Rig, images: Mapping[str, Image], result: FrameResult, *, title: str = "", truth: Any = ()) -> Figure:
    """The views of an instant, their foreground on the floor, and the map: what ``occlib run`` saves."""
    names = list(rig.cameras)
    colours = camera_colours(names)
    columns = max(2, len(names))
    fig = Figure(figsize=(4.2 * columns, 6.8), layout="constrained")
    grid = fig.add_gridspec(2, 2 * columns)
    floor = rig.floor
    rim = [[floor.x[i], floor.y[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    for i, name in enumerate(names):
        ax = fig.add_subplot(grid[0, 2 * i : 2 * i + 2] if len(names) > 1 else grid[0, :])
        show_image(ax, images[name], name, colour=colours[name])
        limits = ax.get_xlim(), ax.get_ylim()
        outline_on_image(ax, rig[name], rim, color=colours[name], linestyle=":")
        for thing in result.objects:
            pixel = rig[name].floor_to_pixels([thing.position_m])
            if rig[name].inside(pixel)[0]:
                hidden = name in thing.hidden_in
                ax.plot(*pixel.T, "o", markersize=14, markerfacecolor="none", markeredgewidth=1.8,
                        color="white", linestyle="none", alpha=0.5 if hidden else 1.0)  # fmt: skip
                ax.annotate(f"{thing.id}{' hidden' if hidden else ''}", pixel[0], xytext=(9, -12), color="white",
                            textcoords="offset points", fontsize=9, fontweight="bold")  # fmt: skip
        ax.set(xlim=limits[0], ylim=limits[1])
    show_views_on_floor(fig.add_subplot(grid[1, :columns]), result.views, floor, "foreground on the floor")
    count = f"{len(result.objects)} object{'' if len(result.objects) == 1 else 's'}"
    show_map(fig.add_subplot(grid[1, columns:]), result.map, result.objects, truth=truth, title=f"map: {count}")
    if title:
        fig.suptitle(title, fontsize=11)
    return fig


def figure_png(fig: Figure, *, dpi: float = 110) -> bytes:
    """The figure as the bytes of a PNG, without a date in it."""
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
