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
from matplotlib.patheffects import withStroke

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.formats import TrueObject
from occlib.geometry import Camera, Floor, Rig

if TYPE_CHECKING:
    from occlib.mapping import OccupancyMap
    from occlib.matching.search import Match
    from occlib.pipeline import FrameResult
    from occlib.tracking import ObjectVector


CAMERA_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
"""Of the cameras in the order of the rig, from the palette of Okabe and Ito (2008), which the colour-blind tell apart."""


TRUTH_COLOUR = "#D55E00"
"""Of the true footprints: vermilion."""


REASON_COLOURS = {1: "#BFBFBF", 2: "#FBE3B5", 3: "#D9C9E8", 4: "#CDE8D5", 5: "#9CC3E6", 6: "#F2C6C6"}
"""Why a cell is unknown (:data:`occlib.mapping.REASONS`): grey, pale orange, violet, green, blue, pink."""


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
    """A camera's picture, or an empty panel of its size; across it why the camera was left out, if it was.

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
    coasting: Sequence[ObjectVector] = (),
    truth: Sequence[TrueObject] = (),
    title: str = "",
    reason: npt.NDArray[np.uint8] | None = None,
) -> None:
    """The occupancy map (white free, black occupied, grey unknown), its objects and, dashed, the true footprints.

    Objects that coast, not seen now, are dashed rings where they are expected.
    With ``reason``, uint8 (ny, nx) as in ``FrameResult``, what is unknown is tinted by its reason, and a legend names
    those that occur.
    """
    shade = np.select([grid.data == 100, grid.data == 0], [0.1, 1.0], 0.75)
    if reason is None:
        show_floor(ax, shade, grid.floor, title, cmap="gray", vmax=1)
    else:
        _show_reasons(ax, shade, reason, grid.floor, title)
    for vector in objects:
        (x, y), (vx, vy) = vector.position_m, vector.velocity_mps
        ax.plot(x, y, "o", color=np.array(vector.colour) / 255, markeredgecolor="white", markersize=7)
        _number(ax, vector)
        if np.hypot(vx, vy) > 0.05:
            ax.annotate("", (x + vx, y + vy), (x, y), arrowprops={"arrowstyle": "->", "color": "#0072B2"})
    for vector in coasting:
        _ring(ax, vector.position_m, 8, np.array(vector.colour) / 255)
        _number(ax, vector)
    show_footprints(ax, truth)


def _number(ax: Axes, vector: ObjectVector) -> None:
    """An object's id beside its place on the map."""
    number = ax.annotate(
        str(vector.id), vector.position_m, xytext=(6, 6), textcoords="offset points", fontsize=9, color="white"
    )
    number.set_path_effects([withStroke(linewidth=2.5, foreground="#0072B2")])  # on black and on white alike


def _ring(ax: Axes, at: npt.ArrayLike, size: float, colour: Any) -> None:
    """A dashed ring, of a size in points, around what is not seen now."""
    x, y = np.ravel(at)
    ax.scatter([x], [y], s=size**2, facecolors="none", edgecolors=[colour], linestyles="--", linewidths=1.4, zorder=3)


def _show_reasons(ax: Axes, shade: FloatArray, reason: npt.NDArray[np.uint8], floor: Floor, title: str) -> None:
    from occlib.mapping import REASONS

    canvas = np.repeat(shade[..., None], 3, axis=2)
    for kind in [kind for kind in REASONS if (reason == kind).any()]:
        canvas[reason == kind] = to_rgb(REASON_COLOURS[kind])
        ax.plot([], [], "s", color=REASON_COLOURS[kind], markeredgecolor="0.5", label=f"unknown: {REASONS[kind]}")
    show_floor(ax, canvas, floor, title)
    if reason.any():
        ax.legend(loc="upper right", fontsize=7, framealpha=0.9)


def show_footprints(ax: Axes, truth: Sequence[TrueObject | npt.ArrayLike]) -> None:
    """True footprints dashed, or a cross where truth has a point only; outlines (M, 2) in m are drawn alike."""
    for true in truth:
        footprint = (true.footprint or [[true.x, true.y]]) if isinstance(true, TrueObject) else true
        outline = np.asarray(footprint, dtype=float)
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
    rig: Rig,
    images: Mapping[str, Image | None],
    result: FrameResult,
    *,
    title: str = "",
    truth: Sequence[TrueObject] = (),
) -> Figure:
    """The views of an instant, their foreground on the floor, and the map: what ``occlib run`` saves.

    A camera without a picture has an empty panel, and one that was left out says why. What is unknown on the map is
    tinted by its reason. An object that is not seen now is a dashed ring where it is expected.
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
        for vector in () if name in result.excluded else [*result.objects, *result.coasting]:
            pixel = rig[name].floor_to_pixels([vector.position_m])
            if rig[name].inside(pixel)[0]:
                unseen, hidden = vector in result.coasting, name in vector.hidden_in
                if unseen:
                    _ring(ax, pixel, 14, "white")
                else:
                    ax.plot(*pixel.T, "o", markersize=14, markerfacecolor="none", markeredgewidth=1.8,
                            color="white", linestyle="none", alpha=0.5 if hidden else 1.0)  # fmt: skip
                state = " not seen" if unseen else " hidden" if hidden else ""
                ax.annotate(f"{vector.id}{state}", pixel[0], xytext=(9, -12), color="white",
                            textcoords="offset points", fontsize=9, fontweight="bold")  # fmt: skip
        ax.set(xlim=limits[0], ylim=limits[1])
    show_views_on_floor(
        fig.add_subplot(grid[1, :columns]), result.views, floor, "foreground on the floor", cameras=names
    )
    count = f"{len(result.objects)} object{'' if len(result.objects) == 1 else 's'}"
    if result.coasting:
        count += f", {len(result.coasting)} not seen now"
    ax = fig.add_subplot(grid[1, columns:])
    show_map(ax, result.map, result.objects, coasting=result.coasting, truth=truth, title=f"map: {count}",
             reason=result.reason)  # fmt: skip
    if title:
        fig.suptitle(title, fontsize=11, parse_math=False)
    return fig


def figure_png(fig: Figure, *, dpi: float = 110) -> bytes:
    """The figure as the bytes of a PNG, without a date in it."""
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
