"""Tables and figures of chapter 03, "Match templates"."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from skimage import transform

from occlib import foreground, formats, lab, localization, matching, metrics, pipeline, plotting, recordings
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.extras import pandas as pd
from occlib.foreground import Background
from occlib.localization import Region

GREY = ("ssd", "sad", "ncc", "zncc")
"""The measures that compare grey values."""

MEASURES = (*GREY, "sed")
"""The built-in measures: a chapter run after this one in the same session may have added others."""

Window = tuple[slice, slice]
"""Rows and columns of a picture."""

ACCEPTED = "#D55E00"
"""Colour of thresholds and matches."""


def true_robots(scene: str, frames: Iterable[int], camera: str) -> dict[int, Region]:
    """The one robot of a rendered scene in each frame, as the region of its exact silhouette."""
    loaded = lab.load_scene(scene)
    masks = {frame: lab.silhouettes(loaded, frame)[camera]["rover"][1] for frame in frames}
    return {frame: localization.find_regions(mask)[1][0] for frame, mask in masks.items()}


def window_around(region: Region, margin_px: int) -> Window:
    """The rows and columns of a region's bounding box and so many px of floor around it."""
    x, y, w, h = region.box
    return np.s_[y - margin_px : y + h + margin_px, x - margin_px : x + w + margin_px]


def difference_of(image: Image, background: Background) -> Image:
    """The subtracted picture that a template is matched in: grey difference, smoothed."""
    return foreground.smooth(foreground.subtract_background(image, background, colour=False))


def _best_match(picture: Image, template: Image, method: str, mask: Mask | None = None) -> matching.Match:
    """The best place in a picture, whatever its score."""
    scores = matching.similarity(picture, template, method, mask)
    y, x = matching.best(scores, method)
    return matching.Match(x, y, float(scores[y, x]), template.shape[1], template.shape[0])


def _error_px(match: matching.Match, robot: Region) -> float:
    return float(np.hypot(*np.subtract(match.centre_px, robot.middle)))


def search_each(
    pictures: Mapping[int, Image],
    template: Image,
    robots: Mapping[int, Region],
    near_px: float,
    method: str = "ssd",
    *,
    mask: Mask | None = None,
) -> pd.DataFrame:
    """The best place in each picture: its score, its distance from the robot, and whether that is below ``near_px``."""
    matches = {frame: _best_match(picture, template, method, mask) for frame, picture in pictures.items()}
    errors = pd.Series({frame: _error_px(match, robots[frame]) for frame, match in matches.items()})
    scores = pd.Series({frame: match.score for frame, match in matches.items()})
    table = pd.DataFrame({f"best {method}": scores, "error (px)": errors, "right": errors < near_px})
    return table.rename_axis("instant")


def right_by_measure(
    pictures: Mapping[int, Image], template: Image, robots: Mapping[int, Region], near_px: float
) -> pd.Series[int]:
    """For each measure, in how many pictures the best place is right."""
    counts = {name: search_each(pictures, template, robots, near_px, name)["right"].sum() for name in MEASURES}
    return pd.Series(counts, name="right").astype(int)


def search_figure(template: Image, picture: Image, scores: FloatArray, titles: Sequence[str]) -> Figure:
    """Template, input, score and decision side by side; ``titles`` are those of the first two."""
    y, x = matching.best(scores, "ssd")
    match = matching.Match(x, y, float(scores[y, x]), template.shape[1], template.shape[0])
    fig, axes = plt.subplots(1, 4, figsize=(10, 2.6), layout="constrained", width_ratios=[0.5, 1.4, 1.5, 1.4])
    plotting.show_image(axes[0], template, titles[0])
    plotting.show_image(axes[1], picture, titles[1])
    shown = plotting.show_similarity(axes[2], scores, picture.shape, "score: ssd (0 is best)", cmap="viridis_r")
    fig.colorbar(shown, ax=axes[2], label="squared grey levels", shrink=0.8)
    plotting.show_image(axes[3], picture, "decision: the best place")
    plotting.show_matches(axes[3], [match])
    return fig


def chain_figure(
    views: Mapping[str, Image],
    differences: Mapping[str, Image],
    similarities: Mapping[str, FloatArray],
    levels: Mapping[str, float],
    found: Mapping[str, Sequence[matching.Match]],
) -> Figure:
    """Figure 3 of the paper with the picture of every stage: one row a camera, the template boxed in the second picture."""
    fig, axes = plt.subplots(len(views), 5, figsize=(12.5, 4.3), layout="constrained", squeeze=False)
    stages = ("1. input", "2. background subtracted", "3. ssd (yellow: alike)", "4. thresholded", "5. one optimum each")
    for line, (name, colour) in zip(axes, plotting.camera_colours(list(views)).items(), strict=True):
        shape = differences[name].shape
        plotting.show_image(line[0], views[name])
        plotting.show_image(line[1], differences[name])
        plotting.show_matches(line[1], found[name][:1])
        plotting.show_similarity(line[2], similarities[name], shape, cmap="viridis_r")
        plotting.show_similarity(line[3], similarities[name] <= levels[name], shape, cmap="gray")
        plotting.show_image(line[4], views[name])
        plotting.show_matches(line[4], found[name])
        line[0].set_ylabel(f"{name} camera", color=colour, fontsize=13)
    for ax, stage in zip(axes[0], stages, strict=True):
        ax.set_title(stage, fontsize=13)
    return fig


def _counted(matches: Sequence[matching.Match], robots: Iterable[Region], near_px: float) -> dict[str, float]:
    """How many matches there are, how many robots they find, how many are left over, and the mean error of the right ones."""
    places = [match.centre_px for match in matches]
    pairs = metrics.match_points(places, [robot.middle for robot in robots], near_px) if places else []
    error = float(np.mean([distance for _, _, distance in pairs])) if pairs else np.nan
    return {
        "matches": len(matches),
        "right": len(pairs),
        "false": len(matches) - len(pairs),
        "mean error (px)": error,
    }


def count_right(matches: Sequence[matching.Match], robots: Mapping[int, Region], near_px: float) -> int:
    """How many robots the matches find."""
    return int(_counted(matches, robots.values(), near_px)["right"])


def by_threshold(
    image: Image, template: Image, robots: Mapping[int, Region], thresholds: Iterable[float], near_px: float
) -> pd.DataFrame:
    """What each threshold of SSD finds: ``matches, right, false, mean error (px)``, indexed by the threshold."""
    scores = matching.similarity(image, template)
    rows = {}
    for threshold in thresholds:
        places = matching.optima(scores, "ssd", threshold)
        size = template.shape[1], template.shape[0]
        found = [matching.Match(int(x), int(y), float(scores[y, x]), *size) for y, x in places]
        rows[threshold] = _counted(found, robots.values(), near_px)
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("threshold")
    return table.astype({"matches": int, "right": int, "false": int})


def threshold_figure(counts: pd.DataFrame, limits: Mapping[str, float]) -> Figure:
    """Matches and right ones against the threshold, and where the thresholds of ``limits`` lie."""
    fig, ax = plt.subplots(figsize=(9, 3.4), layout="constrained")
    ax.step(counts.index, counts["matches"], where="post", color="0.6", linewidth=4, label="matches")
    ax.step(counts.index, counts["right"], where="post", color="black", label="right ones")
    for (name, value), style, colour in zip(limits.items(), ("--", "-."), (ACCEPTED, "#CC79A7"), strict=True):
        ax.axvline(value, linestyle=style, color=colour, label=name)
    ax.set(xlabel="threshold on ssd (squared grey levels)", ylabel="number", ylim=(0, 7.5))
    ax.legend(ncols=4, loc="upper center")
    return fig


def show_threshold(threshold: float, *, scores: FloatArray, template: Image, picture: Image) -> None:
    """Draw the thresholded similarity image of SSD and the optimum of each component, on a smaller picture to be quick."""
    size = template.shape[1], template.shape[0]
    places = matching.optima(scores, "ssd", threshold)
    matches = [matching.Match(int(x), int(y), float(scores[y, x]), *size) for y, x in places]
    _, axes = plt.subplots(1, 2, figsize=(9, 3.4))
    plotting.show_similarity(
        axes[0], scores <= threshold, picture.shape[:2], f"ssd at most {threshold:.0f}", cmap="gray"
    )
    plotting.show_image(axes[1], picture, f"{len(matches)} match{'' if len(matches) == 1 else 'es'}")
    plotting.show_matches(axes[1], matches)
    plt.show()


def empty_room(background: Background, seed: int) -> Image:
    """A picture of the empty room under fresh noise: 1 grey level of read noise, and shot noise of 0.09 times the root."""
    sigma = np.hypot(1.0, 0.09 * np.sqrt(background.image))
    noisy = np.random.default_rng(seed).normal(background.image, sigma)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def by_measure(image: Image, template: Image, robots: Mapping[int, Region], near_px: float) -> pd.DataFrame:
    """Right and false matches of each measure, with its default threshold and with Otsu's."""
    rows = {}
    for method in MEASURES:
        for name, threshold in (("default", None), ("Otsu", "otsu")):
            found = matching.find(image, template, method, threshold)
            rows[method, name] = _counted(found, robots.values(), near_px)
    table = pd.DataFrame.from_dict(rows, orient="index")[["right", "false"]].astype(int)
    return pd.DataFrame(table.rename_axis(["measure", "threshold"]).unstack(sort=False))


def lit(image: Image, gain: float, offset: float = 0.0) -> Image:
    """The picture under other light: grey levels times the gain plus the offset, clipped."""
    return np.clip(np.rint(gain * image.astype(float) + offset), 0, 255).astype(np.uint8)


def half_lit(image: Image, factor: float) -> Image:
    """The picture with the right half's grey levels times the factor."""
    middle = image.shape[1] // 2
    return np.concatenate([image[:, :middle], lit(image[:, middle:], factor)], axis=1)


def _judged(picture: Image, template: Image, method: str, robot: Region, near_px: float) -> str:
    match = _best_match(picture, template, method)
    if not _error_px(match, robot) < near_px:
        return "wrong"
    sign = -1 if matching.METHODS[method].higher_is_better else 1
    limit = matching.default_threshold(picture, template, method)
    return "found" if sign * match.score <= sign * limit else "rejected"


def under_light(
    image: Image,
    background: Background,
    templates: tuple[Image, Image],
    robot: Region,
    changes: Iterable[tuple[float, float]],
    near_px: float,
) -> pd.DataFrame:
    """``"found"``, ``"rejected"`` or ``"wrong"`` for each change of light (gain, offset) and each measure.

    ``templates`` are the grey one, for the five measures in the grey picture, and that of the difference, for the column
    ``chain + ssd``, where the picture is adjusted and subtracted first.
    """
    rows = {}
    for gain, offset in changes:
        changed = lit(image, gain, offset)
        grey = foreground.to_grey(changed)
        row = {name: _judged(grey, templates[0], name, robot, near_px) for name in MEASURES}
        chain = difference_of(changed, background)
        rows[gain, offset] = {**row, "chain + ssd": _judged(chain, templates[1], "ssd", robot, near_px)}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["gain", "offset"])


def score_against_gain(grey: Image, template: Image, robot: Region, gains: Iterable[float]) -> pd.DataFrame:
    """Best SSD and ZNCC within 8 px of the robot, and the best SSD of the whole picture, for each gain of the light."""
    top, left = (round(m - (n - 1) / 2) for m, n in zip(robot.middle[::-1], template.shape, strict=True))
    near = np.s_[top - 8 : top + 9, left - 8 : left + 9]
    rows = {}
    for gain in gains:
        scores = {name: matching.similarity(lit(grey, gain), template, name) for name in ("ssd", "zncc")}
        rows[gain] = {
            "ssd": scores["ssd"][near].min(),
            "zncc": scores["zncc"][near].max(),
            "ssd anywhere": scores["ssd"].min(),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("gain")


def light_figure(curves: pd.DataFrame, limits: Mapping[str, float]) -> Figure:
    """SSD and ZNCC at the robot against the gain, with the thresholds ``limits``."""
    fig, axes = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
    axes[0].plot(curves["ssd anywhere"], ":", color="0.5", linewidth=3, label="best in the picture")
    for ax, name, side in zip(axes, ("ssd", "zncc"), ("below", "above"), strict=True):
        ax.plot(curves[name], "o-", color="black", label="at the robot")
        ax.axhline(limits[name], color=ACCEPTED, linestyle="--", label=f"accepted {side}")
    axes[0].set(xlabel="gain", ylabel="ssd (squared grey levels)", title="ssd: 0 is best", ylim=(0, None))
    axes[1].set(xlabel="gain", ylabel="zncc", title="zncc: 1 is best", ylim=(0, 1.02))
    axes[0].legend(loc="upper right")
    axes[1].legend(loc="lower right")
    return fig


def unexplained_shares(pictures: Mapping[int, Image], windows: Mapping[int, Window]) -> pd.DataFrame:
    """Best SSD over the template's variance, for each template (row) in each picture (column); 0 is perfect."""
    templates = {frame: pictures[frame][window] for frame, window in windows.items()}
    shares = {
        found: {cut: matching.similarity(picture, t).min() / t.var() for cut, t in templates.items()}
        for found, picture in pictures.items()
    }
    return pd.DataFrame(shares).rename_axis(index="template from", columns="found in")


def pairs_figure(shares: pd.DataFrame, templates: Sequence[Image]) -> Figure:
    """The table of :func:`unexplained_shares`, accepted pairs bold, and the six templates."""
    fig, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", width_ratios=[1.2, 1])
    shown = axes[0].imshow(shares, cmap="viridis_r", vmin=0, vmax=1)
    for (row, column), value in np.ndenumerate(shares.to_numpy()):
        look: dict[str, Any] = {"color": "black" if value <= 0.5 else "white"}
        weight = "bold" if value <= 0.5 else "normal"
        axes[0].text(column, row, f"{value:.2f}", ha="center", va="center", fontweight=weight, fontsize=11, **look)
    title = "unexplained share (bold: accepted)"
    axes[0].set(xlabel="found in instant", ylabel="template from instant", title=title)
    fig.colorbar(shown, ax=axes[0])
    canvas = np.zeros((2 * 95, 3 * 85), np.uint8)
    for number, patch in enumerate(templates):
        y, x = 95 * (number // 3), 85 * (number % 3)
        canvas[y : y + patch.shape[0], x : x + patch.shape[1]] = patch
    plotting.show_image(axes[1], canvas, "the six templates, instants 0 to 2 and 3 to 5")
    return fig


def turned_or_scaled(
    picture: Image, window: Window, middle: tuple[float, float], angles: Iterable[float], sizes: Iterable[float]
) -> pd.DataFrame:
    """Unexplained share of SSD and of ZNCC when the picture is turned (degrees) or scaled about the template's middle."""
    template = picture[window]
    pictures = {("rotation", a): transform.rotate(picture, a, center=middle, preserve_range=True) for a in angles}
    for size in sizes:
        pictures["size", size] = transform.rescale(picture, size, preserve_range=True, anti_aliasing=size < 1)
    shares = {}
    for key, changed in pictures.items():
        values = np.rint(changed).astype(np.uint8)
        ssd = matching.similarity(values, template, "ssd").min() / template.var()
        shares[key] = {"ssd": ssd, "zncc": 1 - matching.similarity(values, template, "zncc").max() ** 2}
    return pd.DataFrame.from_dict(shares, orient="index").rename_axis(["change", "by"])


def turned_figure(shares: pd.DataFrame) -> Figure:
    """The two halves of :func:`turned_or_scaled`."""
    fig, axes = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained", sharey=True)
    for ax, change in zip(axes, ("rotation", "size"), strict=True):
        part = shares.loc[change]
        ax.plot(part["ssd"], "o-", color="black", label="ssd")
        ax.plot(part["zncc"], "s--", color="0.5", label="zncc")
        ax.axhline(0.5, color=ACCEPTED, linestyle=":", label="accepted below")
    axes[0].set(xlabel="rotation in the image (degrees)", ylabel="unexplained share", ylim=(0, None))
    axes[1].set(xlabel="size of the robot relative to the template")
    axes[1].legend()
    return fig


def identified(steps: Mapping[str, int]) -> pd.DataFrame:
    """How many labels of the profile ``paper`` are right, wrong or missing, in every so many frames of each recording."""
    rows = {}
    for name, step in steps.items():
        recording = recordings.open_recording(name, ["left", "right"])
        chain = pipeline.Pipeline(recording.rig, pipeline.backgrounds_of(recording), pipeline.settings_for("paper"))
        found = {
            frame: chain.process(images, recording.time(frame)).objects
            for frame, images in recording.images(recording.frames[::step])
        }
        truth = formats.load_truth(recording.path / "truth.json").select(found)
        score = metrics.evaluate_identity(found, truth, radius=0.3)
        rows[name] = {kind: getattr(score, kind) for kind in ("right", "wrong", "unlabelled")}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("recording")
