"""Tables and figures of chapter 02, "Subtract the background"."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from scipy import ndimage

from occlib import foreground, lab, metrics, plotting
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.extras import pandas as pd
from occlib.course.drawings import show_mask_errors
from occlib.foreground import Background
from occlib.localization import find_regions
from occlib.recordings import Recording, open_recording

STYLES: dict[str, dict[str, Any]] = {
    "otsu": {"linestyle": "-", "color": "#D55E00"},
    "half-otsu": {"linestyle": (0, (5, 1, 1, 1)), "color": "#D55E00"},
    "triangle": {"linestyle": "--", "color": "#009E73"},
    "noise": {"linestyle": ":", "color": "black"},
    "fixed": {"linestyle": "-.", "color": "#AA4499"},
}
"""How the line of each threshold is drawn, the same in every figure."""


class LabelledView(NamedTuple):
    """One camera's picture of one instant, with the exact silhouette of all that stands in it."""

    instant: int
    camera: str
    image: Image
    silhouette: Mask


def labelled_views(recording: Recording, scene: str, frames: Sequence[int] | None = None) -> list[LabelledView]:
    """Every camera's picture of the frames of a rendered scene, with the silhouettes that the renderer knows."""
    rendered = lab.load_scene(scene)
    views = []
    for frame, images in recording.images(frames):
        shapes = lab.silhouettes(rendered, frame)
        for name, image in images.items():
            silhouette = np.any([mask for _, mask in shapes[name].values()], axis=0)
            views.append(LabelledView(frame, name, image, silhouette))
    return views


def show_pair(images: Mapping[str, Image], titles: str) -> Figure:
    """The two views side by side, each title in its camera's colour."""
    fig, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for ax, (name, colour) in zip(axes, plotting.camera_colours(list(images)).items(), strict=True):
        plotting.show_image(ax, images[name], f"{name} camera, {titles}", colour=colour)
    return fig


# --- adjust the intensity


def gain_table(views: Iterable[LabelledView], backgrounds: Mapping[str, Background]) -> pd.DataFrame:
    """Gain and offset of each view: a row for each instant, columns (gain or offset, camera)."""
    rows = [
        (
            view.instant,
            view.camera,
            *foreground.intensity_gain_offset(foreground.to_grey(view.image), backgrounds[view.camera].grey),
        )
        for view in views
    ]
    table = pd.DataFrame(rows, columns=["instant", "camera", "gain", "offset"])
    return table.pivot(index="instant", columns="camera", values=["gain", "offset"]).round(3)


def noisy_copy(image: Image, rng: np.random.Generator) -> Image:
    """The picture under fresh sensor noise: 1 grey level of read noise, and shot noise of ``0.09 * sqrt(level)``."""
    sigma = np.hypot(1.0, 0.09 * np.sqrt(image))
    return np.clip(np.rint(rng.normal(image, sigma)), 0, 255).astype(np.uint8)


def exposure_table(empty: Image, background: Background, exposures: Iterable[float], *, size: int) -> pd.DataFrame:
    """What is left of an empty picture that is multiplied by each exposure, without and with intensity adjustment.

    Returns
    -------
    A row for each exposure; for "not adjusted" and "adjusted" the median difference in grey levels, and the share of the
    picture above the noise floor in percent.
    """
    rows: dict[float, dict[tuple[str, str], float]] = {}
    for exposure in sorted(set(exposures)):
        changed = np.clip(np.rint(exposure * empty), 0, 255).astype(np.uint8)
        rows[exposure] = {}
        for word, adjust in (("not adjusted", False), ("adjusted", True)):
            difference = foreground.subtract_background(changed, background, adjust=adjust, colour=False)
            difference = foreground.smooth(difference, size=size)
            rows[exposure]["median difference", word] = float(np.median(difference))
            rows[exposure]["foreground (%)", word] = 100 * float((difference > background.noise_floor).mean())
    columns = pd.MultiIndex.from_product([["median difference", "foreground (%)"], ["not adjusted", "adjusted"]])
    return pd.DataFrame.from_dict(rows, orient="index")[columns].rename_axis("exposure")


def show_exposure(table: pd.DataFrame, exposure: float) -> Figure:
    """:func:`exposure_table` as two curves; ``exposure`` is marked."""
    fig, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    labels = {"median difference": "median difference (grey levels)", "foreground (%)": "foreground (% of the picture)"}
    for ax, (quantity, label) in zip(axes, labels.items(), strict=True):
        ax.plot(table[quantity, "not adjusted"], "o--", color="#D55E00", label="not adjusted")
        ax.plot(table[quantity, "adjusted"], "s-", color="black", label="adjusted")
        ax.set(xlabel="exposure relative to the background", ylabel=label, ylim=(0, None))
        ax.axvline(exposure, color="0.6", linestyle=":")
    axes[0].legend()
    return fig


# --- subtract and smooth


def show_difference(difference: Image, smoothed: Image, silhouette: Mask, *, size: int, white: float = 40) -> Figure:
    """The difference before and after smoothing, whole and in close-up with the outline of the true silhouette."""
    fig, axes = plt.subplots(2, 2, figsize=(10, 7.4), layout="constrained")
    titled = ((difference, "difference"), (smoothed, f"smoothed over {size} px"))
    for column, (values, title) in zip(axes.T, titled, strict=True):
        for ax, where in zip(column, ("whole picture", "close-up"), strict=True):
            shown = plotting.show_image(ax, values, f"{title}, {where}", vmax=white)
        column[1].set(**_window(silhouette, above=35, below=40))
        column[1].contour(silhouette, [0.5], colors="#56B4E9", linewidths=1.2)
    fig.colorbar(shown, ax=axes, label=f"difference (grey levels, {white:.0f} and more is white)", shrink=0.7)
    return fig


def belt_and_far(silhouette: Mask) -> tuple[Mask, Mask]:
    """The belt of 6 to 16 px around a silhouette, and what is 60 px or more away from it."""
    near, belt, away = (ndimage.binary_dilation(silhouette, iterations=n) for n in (6, 16, 60))
    return belt & ~near, ~away


def smoothing_table(
    difference: Image, silhouette: Mask, noise_floor: float, sizes: Iterable[int] = (1, 3, 5, 9, 15)
) -> pd.DataFrame:
    """Spread of the noise far away, mean of the reflection in the belt, and regions above the noise floor, by size."""
    belt, far = belt_and_far(silhouette)
    rows = {}
    for size in sizes:
        values = foreground.smooth(difference, size=size)
        rows[size] = {
            "noise (std)": values[far].std(),
            "reflection (mean)": values[belt].mean(),
            "regions": count_regions(values > noise_floor),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("size (px)").astype({"regions": int})


def count_regions(mask: Mask) -> int:
    """Separate regions of a mask; pixels that touch at a side or a corner are one."""
    return int(ndimage.label(mask, np.ones((3, 3)))[1])


# --- threshold


def between_class_variance(values: npt.ArrayLike, level: float) -> float:
    """Otsu's criterion: the variance between the values up to ``level`` and those above it; 0 where one side is empty."""
    array = np.asarray(values, dtype=float)
    low, high = array[array <= level], array[array > level]
    if not low.size or not high.size:
        return 0.0
    return float(low.size * high.size / array.size**2 * (low.mean() - high.mean()) ** 2)


def f_measure_curve(views: Iterable[LabelledView], backgrounds: Mapping[str, Background], size: int) -> FloatArray:
    """Mean F-measure of the grey difference, smoothed over ``size``, for the fixed levels 0 to 255."""
    curves = []
    for view in views:
        raw = foreground.subtract_background(view.image, backgrounds[view.camera], colour=False)
        values = foreground.smooth(raw, size=size)
        hit, false = (_above(values[part]) for part in (view.silhouette, ~view.silhouette))
        curves.append(2 * hit / (hit + false + view.silhouette.sum()))
    return np.asarray(np.mean(curves, axis=0), dtype=np.float64)


def show_levels(
    smoothed: Image, silhouette: Mask, levels: Mapping[str, float], curves: Mapping[str, FloatArray]
) -> Figure:
    """Histogram of floor and robot above, F-measure against a fixed level below, and the levels through both."""
    fig, (top, bottom) = plt.subplots(2, 1, figsize=(10, 7), layout="constrained", sharex=True)
    bins = np.arange(0, 202, 2)
    top.hist(smoothed[~silhouette], bins, color="0.75", label="floor (true)")
    top.hist(smoothed[silhouette], bins, color="#56B4E9", alpha=0.7, label="robot (true)")
    top.set(yscale="log", ylabel="pixels of this view")
    for (label, curve), style in zip(curves.items(), (":", "-", "--"), strict=False):
        bottom.plot(curve, style, color="black", label=label)
    bottom.set(xlabel="level (grey levels)", ylabel="F-measure, mean of all views", xlim=(0, 200), ylim=(0, 1))
    for name, level in levels.items():
        top.axvline(level, **STYLES[name], linewidth=2, label=f"{name}: {level:.0f}")
        bottom.axvline(level, **STYLES[name], linewidth=2)
    top.legend(ncols=2)
    bottom.legend(loc="lower center")
    return fig


def show_decisions(image: Image, smoothed: Image, silhouette: Mask, levels: Mapping[str, float]) -> Figure:
    """Input, score and the decision of each level, in close-up."""
    fig, axes = plt.subplots(2, 4, figsize=(10, 6.4), layout="constrained")
    plotting.show_image(axes[0, 0], image, "input")
    plotting.show_image(axes[0, 1], smoothed, "score (white: 40)", vmax=40)
    for ax, (name, level) in zip(axes.flat[2:7], levels.items(), strict=True):
        mask = smoothed > level
        score = metrics.foreground_scores(mask, silhouette, smoothed)["f_measure"]
        show_mask_errors(ax, mask, silhouette, f"{name} ({level:.0f}): F = {score:.2f}")
    for ax in axes.flat[:7]:
        ax.set(**_window(silhouette))
    axes[1, 3].axis("off")
    axes[1, 3].legend(*axes[0, 2].get_legend_handles_labels(), loc="center", fontsize=12)
    return fig


def threshold_table(
    views: Iterable[LabelledView],
    backgrounds: Mapping[str, Background],
    thresholds: Mapping[str, str | float],
    sizes: Iterable[int] = (1, 5, 9),
) -> pd.DataFrame:
    """Means over all views: F-measure, missed share of the silhouette in percent, and regions; by threshold and size."""
    rows, sizes = [], list(sizes)
    for view in views:
        background = backgrounds[view.camera]
        raw = foreground.subtract_background(view.image, background, colour=False)
        for size in sizes:
            values = foreground.smooth(raw, size=size)
            for name, threshold in thresholds.items():
                mask = values > foreground.threshold_level(values, threshold, noise_floor=background.noise_floor)
                hit, true = int((mask & view.silhouette).sum()), int(view.silhouette.sum())
                rows.append(
                    (name, size, 2 * hit / (mask.sum() + true), 100 * (1 - hit / true), float(count_regions(mask)))
                )
    table = pd.DataFrame(rows, columns=["threshold", "size (px)", "F", "missed (%)", "regions"])
    means = table.groupby(["threshold", "size (px)"], sort=False).mean()
    return means.reset_index().pivot(index="threshold", columns="size (px)").reindex(list(thresholds))


def empty_table(nothing: Image, thresholds: Mapping[str, str | float], noise_floor: float) -> pd.DataFrame:
    """Level and share called foreground in a difference that shows nothing, without and with the noise floor."""
    rows: dict[str, dict[tuple[str, str], float]] = {}
    for name, threshold in thresholds.items():
        rows[name] = {}
        for word, floor in (("alone", 0.0), ("with noise floor", noise_floor)):
            level = foreground.threshold_level(nothing, threshold, noise_floor=floor)
            rows[name]["level", word] = level
            rows[name]["foreground (%)", word] = 100 * float((nothing > level).mean())
    columns = pd.MultiIndex.from_product([["level", "foreground (%)"], ["alone", "with noise floor"]])
    return pd.DataFrame.from_dict(rows, orient="index")[columns].rename_axis("threshold")


# --- a background without an empty room


def parked_sequence(pictures: Sequence[Image], parked: int, length: int = 12) -> list[Image]:
    """The first picture ``parked`` times, then the others in turn, up to ``length`` pictures.

    >>> import numpy as np
    >>> [int(picture[0]) for picture in parked_sequence([np.array([i]) for i in range(3)], 2, 6)]
    [0, 0, 1, 2, 1, 2]
    """
    others = pictures[1:]
    return [pictures[0]] * parked + [others[i % len(others)] for i in range(length - parked)]


def parking_table(
    pictures: Sequence[Image], spot: Mask, background: Image, parked: Iterable[int], length: int = 12
) -> pd.DataFrame:
    """Mean error, in the place where the robot parks, of the plain median and of the learned background, in grey levels."""
    rows = {}
    for count in parked:
        sequence = parked_sequence(pictures, count, length)
        found = {"median": np.median(sequence, axis=0), "learned": foreground.learn_background(sequence).image}
        rows[f"{count} of {length}"] = {
            name: float(np.abs(image.astype(float) - background)[spot].mean()) for name, image in found.items()
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("frames parked")


def show_ghosts(backgrounds: Mapping[str, Image], image: Image, silhouette: Mask, *, size: int) -> Figure:
    """Each background, and what it makes of a picture."""
    fig, axes = plt.subplots(len(backgrounds), 2, figsize=(10, 7.4), layout="constrained", squeeze=False)
    for row, (name, background) in zip(axes, backgrounds.items(), strict=True):
        mask = foreground.foreground_mask(image, foreground.as_background(background), size=size)
        plotting.show_image(row[0], background, f"background: {name}")
        show_mask_errors(row[1], mask, silhouette, "foreground of a later instant")
    axes[0, 1].legend(loc="upper right")
    return fig


# --- shadows


def shadow_masks(image: Image, background: Background) -> dict[str, Mask]:
    """Foreground of the grey difference at half of Otsu's level, and of the evidence at two levels."""
    evidence = foreground.foreground_evidence(image, background)
    half = foreground.foreground_mask(image, background, threshold="half-otsu")
    return {"half-otsu": half, "evidence, 128": evidence >= 128, "evidence, 230": evidence >= 230}


def shadow_table(names: Iterable[str], instants: int) -> pd.DataFrame:
    """Means of :func:`occlib.metrics.foreground_scores` by mask and recording, over at most about ``instants`` frames each."""
    rows: list[dict[str, Any]] = []
    for name in names:
        recording = open_recording(name, ["left", "right"])
        frames = recording.frames[:: max(1, len(recording.frames) // instants)]
        empty = recording.background_images()
        backgrounds = {camera: foreground.average_background(pictures) for camera, pictures in empty.items()}
        for view in labelled_views(recording, name, frames):
            rows += [{"recording": name, **row} for row in _shadow_scores(view, backgrounds[view.camera])]
    return pd.DataFrame(rows).groupby(["mask", "recording"], sort=False).mean()


def show_shadows(view: LabelledView, background: Background) -> Figure:
    """One view in close-up, and its errors under the masks of :func:`shadow_masks`, the sure one left out."""
    fig, axes = plt.subplots(1, 3, figsize=(10, 3.9), layout="constrained")
    masks = shadow_masks(view.image, background)
    plotting.show_image(axes[0], view.image, f"{view.camera} camera, instant {view.instant}")
    for ax, name in zip(axes[1:], ("half-otsu", "evidence, 128"), strict=True):
        show_mask_errors(ax, masks[name], view.silhouette, name)
    for ax in axes:
        ax.set(**_window(view.silhouette))
    axes[2].legend(loc="lower right")
    return fig


def _shadow_scores(view: LabelledView, background: Background) -> Iterator[dict[str, Any]]:
    change = foreground.subtract_background(view.image, background)
    for name, mask in shadow_masks(view.image, background).items():
        yield {"mask": name, **metrics.foreground_scores(mask, view.silhouette, change)}


def _above(values: Image) -> npt.NDArray[np.int64]:
    """How many values lie above each level from 0 to 255."""
    at_least = np.bincount(values, minlength=256)[::-1].cumsum()[::-1]
    return np.append(at_least[1:], 0)


def _window(silhouette: Mask, margin: int = 45, *, above: int = 40, below: int = 45) -> dict[str, tuple[float, float]]:
    """Limits of axes that show the largest region of a silhouette with a margin in px."""
    regions = find_regions(silhouette)[1]
    left, top, width, height = max(regions, key=lambda region: region.area).box
    return {"xlim": (left - margin, left + width + margin), "ylim": (top + height + below, top - above)}
