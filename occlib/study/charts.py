"""Charts of template matching: the measures side by side on one image, and the study of them.

One fixed colour and marker a measure (Okabe and Ito, distinguishable by the colour-blind).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from occlib.base.arrays import Image
from occlib.base.extras import pandas as pd
from occlib.matching.optima import best
from occlib.matching.thresholds import ROUNDING
from occlib.plotting import show_image, show_matches, show_similarity
from occlib.study.conditions import CONDITIONS, CONSTANT_LIGHT

if TYPE_CHECKING:
    from occlib.matching.search import Comparison
    from occlib.study.trials import Trial


ACCEPTED = "#D55E00"
"""Colour of thresholds, matches and frames."""

MOST_DRAWN = 100
"""Matches drawn into a picture: more hide it."""

STYLES = {
    "ssd": ("#000000", "o"),
    "sad": ("#56B4E9", "s"),
    "ncc": ("#E69F00", "^"),
    "zncc": ("#0072B2", "D"),
    "sed": ("#009E73", "v"),
}
"""Colour and marker of the built-in measures."""

OTHER_STYLES = (("#CC79A7", "P"), ("#8B6914", "X"), ("#7F7F7F", "<"), ("#A020F0", ">"))
"""Of all others, in turn."""

LABELS = {
    "recall": "recall at rank 1",
    "precision": "precision",
    "f1": "F1",
    "false_alarms": "false alarms a picture",
    "rmse_px": "RMSE (px)",
    "rmse_cm": "RMSE on the floor (cm)",
    "peak_ratio": "peak ratio",
}


def comparison_rows(results: Mapping[str, Comparison]) -> dict[str, dict[str, float | None]]:
    """For each measure: best score and where (``x``, ``y``, top-left px), threshold, number of matches, time in ms.

    No best place (``None``) where all scores are equal, as those of a template without contrast or edges; no
    threshold (``NaN``) where there is none for the measure.
    """
    rows: dict[str, dict[str, float | None]] = {}
    for name, result in results.items():
        y, x = best(result.score, name)
        told = not is_constant(result.score) or result.score.size == 1
        rows[name] = {
            "best": float(result.score[y, x]) if told else None,
            "x": x if told else None,
            "y": y if told else None,
            "threshold": result.threshold,
            "matches": len(result.matches),
            "ms": 1e3 * result.seconds,
        }
    return rows


def comparison_table(results: Mapping[str, Comparison]) -> pd.DataFrame:
    """:func:`comparison_rows` as a table, one row a measure."""
    table = pd.DataFrame.from_dict(comparison_rows(results), orient="index").rename_axis("method")
    return table.astype({"best": float, "x": "Int64", "y": "Int64"})


def is_constant(score: npt.NDArray[np.float64]) -> bool:
    """Whether scores differ by no more than rounding."""
    return bool(np.ptp(score) <= ROUNDING * np.abs(score).max())


def comparison_figure(image: Image, template: Image, results: Mapping[str, Comparison]) -> Figure:
    """A column a measure: its similarity image, the scores with the threshold, and the matches; first the input."""
    fig = Figure(figsize=(2.0 + 2.6 * len(results), 6.6), layout="constrained")
    axes = fig.subplots(3, 1 + len(results), squeeze=False, width_ratios=[0.7] + [1] * len(results))
    show_image(axes[0, 0], template, f"template\n{template.shape[1]} x {template.shape[0]} px")
    show_image(axes[1, 0], image, f"image\n{image.shape[1]} x {image.shape[0]} px")
    axes[2, 0].axis("off")
    for line, (name, result) in zip(axes[:, 1:].T, results.items(), strict=True):
        direction = "high is alike" if result.method.higher_is_better else "low is alike"
        cmap = "viridis" if result.method.higher_is_better else "viridis_r"
        shown = show_similarity(line[0], result.score, image.shape, f"{name}\n{result.method.description}", cmap=cmap)
        line[0].title.set(fontsize=8)
        fig.colorbar(shown, ax=line[0], shrink=0.6).ax.tick_params(labelsize=7)
        score_histogram(line[1], result.score, result.threshold, higher_is_better=result.method.higher_is_better)
        line[1].set_xlabel(f"score, {direction}", fontsize=8)
        count = len(result.matches)
        drawn = f", best {MOST_DRAWN} drawn" if count > MOST_DRAWN else "" if count else ", best place dashed"
        show_image(line[2], image, f"{count} match{'' if count == 1 else 'es'}{drawn}")
        show_matches(line[2], result.matches[:MOST_DRAWN], colour=ACCEPTED)
        if not count:
            frame_place(line[2], best(result.score, name)[::-1], template.shape, linestyle="--")
    axes[1, 1].set_ylabel("places", fontsize=8)
    return fig


def score_histogram(
    ax: Axes, score: npt.NDArray[np.float64], threshold: float, *, higher_is_better: bool, bins: int = 80
) -> None:
    """How many places have which score, on a logarithmic axis; the accepted side of the threshold is shaded."""
    values = score[np.isfinite(score)]
    if is_constant(values):  # but for rounding, which has no room for bins
        values = np.full_like(values, values[0])
    counts, edges = np.histogram(values, bins)
    ax.stairs(counts, edges, fill=True, color="0.35")
    low, high = min(edges[0], threshold), max(edges[-1], threshold)  # NaN, no threshold, changes neither
    ax.set(yscale="log", ylim=(0.7, None), xlim=(low - 0.02 * (high - low), high + 0.02 * (high - low)))
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.tick_params(labelsize=7)
    ax.xaxis.set_major_locator(MaxNLocator(4))
    if np.isfinite(threshold):
        ax.axvspan(threshold, ax.get_xlim()[1 if higher_is_better else 0], color=ACCEPTED, alpha=0.25, linewidth=0)
        ax.axvline(threshold, color=ACCEPTED, linewidth=1.2)
        ax.set_title(f"accepted {'above' if higher_is_better else 'below'} {threshold:.4g}", fontsize=8, color=ACCEPTED)
    else:
        ax.set_title("nothing to split: no threshold", fontsize=8, color=ACCEPTED)


def measure_styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker of each measure: the same in every chart, and cycling for measures of your own.

    >>> measure_styles(["zncc", "mine"])["zncc"]
    {'color': '#0072B2', 'marker': 'D'}
    """
    unique = list(dict.fromkeys(map(str, names)))
    own = [name for name in unique if name not in STYLES]
    styles = {**STYLES, **{name: OTHER_STYLES[i % len(OTHER_STYLES)] for i, name in enumerate(own)}}
    return {name: {"color": styles[name][0], "marker": styles[name][1]} for name in unique}


def contact_sheet(trials: Mapping[str, Trial], *, columns: int = 5) -> Figure:
    """The template of the first trial, then the search image of each under its name.

    The true place is framed; where the target is absent there is no frame.
    """
    pictures = list(trials.items())
    rows = -(-(len(pictures) + 1) // columns)
    fig = Figure(figsize=(2.5 * columns, 2.15 * rows), layout="constrained")
    axes = fig.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.axis("off")
    template = pictures[0][1].template
    show_image(axes[0], template, f"template, {template.shape[1]} x {template.shape[0]} px")
    shape = pictures[0][1].image.shape
    axes[0].set(xlim=(-(shape[1] - template.shape[1]) / 2, (shape[1] + template.shape[1]) / 2))  # to the same scale
    axes[0].set(ylim=((shape[0] + template.shape[0]) / 2, -(shape[0] - template.shape[0]) / 2))
    for ax, (name, trial) in zip(axes[1:], pictures, strict=False):
        show_image(ax, trial.image, name)
        if trial.corner is not None:
            frame_place(ax, trial.corner, trial.template.shape)
    return fig


def frame_place(ax: Axes, corner: npt.ArrayLike, shape: Sequence[int], **options: Any) -> None:
    """Frame the window ``shape`` (h, w) whose top-left pixel is at ``corner`` (x, y), px."""
    x, y = np.asarray(corner, float)
    across = np.array([0, shape[1], shape[1], 0, 0]) + x - 0.5
    down = np.array([0, 0, shape[0], shape[0], 0]) + y - 0.5
    ax.plot(across, down, **{"color": ACCEPTED, "linewidth": 1.2, **options})


def level_curves(
    summary: pd.DataFrame,
    value: str = "recall",
    *,
    by: str = "method",
    columns: int = 4,
    log: bool = False,
    styles: Mapping[str, Mapping[str, Any]] | None = None,
) -> Figure:
    """A panel a condition: ``value`` against the level of the disturbance, a line a measure, with 95 % intervals.

    The levels of a condition are equally spaced, and the measures of one level stand side by side, so that equal
    values do not hide each other.

    Parameters
    ----------
    summary
        Columns ``condition, level``, ``by`` and ``value``, as from :func:`occlib.study.tables.summarise`; intervals where
        there are ``<value>_low`` and ``<value>_high``. Conditions with one level are left out.
    value
        What is drawn.
    by
        The column that tells the lines apart; ``styles`` are theirs, by default :func:`measure_styles`.
    columns
        Panels in a row.
    log
        A logarithmic value axis, over the range of the values; intervals may be cut off.
    """
    names = _with_levels(summary)
    looks = measure_styles(summary[by]) if styles is None else styles
    fig, axes = _panels(len(names), columns, 2.2)
    for ax, name in zip(axes.ravel(), names, strict=False):
        panel = summary[summary["condition"] == name]
        falling = name in CONDITIONS and CONDITIONS[name].worst_first
        levels = sorted(panel["level"].unique(), reverse=falling)  # worse to the right
        for number, (line, look) in enumerate(looks.items()):
            shift = 0.09 * (number - (len(looks) - 1) / 2)
            values = panel[panel[by] == line].set_index("level").reindex(levels)
            _line(ax, values, value, shift, {**look, "label": line})
        ax.set_xticks(range(len(levels)), [f"{level:g}" for level in levels], fontsize=11)
        ax.set_xlabel(CONDITIONS[name].unit if name in CONDITIONS else "level", fontsize=11)
        ax.set_title(name, fontsize=12, fontweight="bold")
    if log:  # an interval may reach below zero or far up; the values decide what is shown
        _log_axis(axes[0, 0])
        axes[0, 0].set_ylim(summary[value].min() / 1.8, summary[value].max() * 1.8)
    else:
        axes[0, 0].set_ylim(*((-0.03, 1.03) if value in ("recall", "precision", "f1") else (0, None)))
    for ax in axes[:, 0]:
        ax.set_ylabel(LABELS.get(value, value), fontsize=11)
        ax.tick_params(axis="y", labelsize=11)
    handles = axes[0, 0].get_legend_handles_labels()
    fig.legend(*handles, loc="outside upper center", ncols=len(looks), frameon=False, fontsize=12)
    return fig


def _with_levels(summary: pd.DataFrame) -> list[str]:
    names = [str(name) for name, part in summary.groupby("condition", sort=False) if part["level"].nunique() > 1]
    if not names:
        raise ValueError("summary: expected a condition with two levels or more, got none")
    return names


def _panels(count: int, columns: int, height: float) -> tuple[Figure, Any]:
    """Axes (rows, columns) that share the value axis, gridded; those left over are blank."""
    columns = min(columns, count)
    rows = -(-count // columns)
    fig = Figure(figsize=(1.2 + 2.75 * columns, 0.7 + height * rows), layout="constrained")
    axes = fig.subplots(rows, columns, squeeze=False, sharey=True)
    for ax in axes.ravel()[:count]:
        ax.grid(color="0.92", linewidth=0.6)
        ax.set_axisbelow(True)
    for ax in axes.ravel()[count:]:
        ax.axis("off")
    return fig, axes


def _log_axis(ax: Axes) -> None:
    """A logarithmic value axis with plain numbers at 1, 2 and 5."""
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_locator(NullLocator())


def _line(ax: Axes, line: pd.DataFrame, value: str, shift: float, look: Mapping[str, Any]) -> None:
    x, y = np.arange(len(line)) + shift, line[value].to_numpy(float)
    ax.plot(x, y, **{"markersize": 4, "linewidth": 0.8, **look})
    if f"{value}_low" in line:
        low, high = (line[f"{value}_{end}"].to_numpy(float) for end in ("low", "high"))
        ax.vlines(x, low, high, color=look["color"], linewidth=1.2, alpha=0.55)


def precision_recall_curves(curves: pd.DataFrame, by: str = "condition", *, columns: int = 4) -> Figure:
    """A panel a group, a line a measure: precision against recall as the threshold moves.

    ``curves`` has the columns ``by, method, recall, precision, f1``, strictest threshold first, as from
    :func:`occlib.study.tables.precision_recall`. The marker is the best F1. Higher and farther right is better.
    """
    names, looks = list(dict.fromkeys(map(str, curves[by]))), measure_styles(curves["method"])
    fig, axes = _panels(len(names), columns, 2.5)
    for ax, name in zip(axes.ravel(), names, strict=False):
        for method, look in looks.items():
            line = curves[(curves[by] == name) & (curves["method"] == method)]
            ax.plot(line["recall"], line["precision"], color=look["color"], linewidth=1.4)
            if len(line):
                peak = line.iloc[[int(line["f1"].to_numpy().argmax())]]
                ax.plot(peak["recall"], peak["precision"], **{"markersize": 6, "linestyle": "", **look})
        ax.set(xlim=(0, 1.03), ylim=(0, 1.04))
        ax.set_title(name, fontsize=12, fontweight="bold")
    for ax in axes[:, 0]:
        ax.set_ylabel("precision")
    for ax in axes[-1]:
        ax.set_xlabel("recall")
    for method, look in looks.items():
        axes[0, 0].plot([], [], label=method, **look)
    handles = axes[0, 0].get_legend_handles_labels()
    fig.legend(*handles, loc="outside upper center", ncols=len(looks), frameon=False, fontsize=12)
    return fig


def runtime_curves(ax: Axes, times: pd.DataFrame, value: str = "median_ms", label: str = "run time (ms)") -> None:
    """``value`` against the side of the template, both logarithmic; columns as from :func:`occlib.study.trials.runtime`."""
    for method, look in measure_styles(times["method"]).items():
        line = times[times["method"] == method].sort_values("side")
        ax.plot(line["side"], line[value], label=method, **look)
    sides = sorted(times["side"].unique())
    _log_axis(ax)
    ax.set(xscale="log", xlabel="side of the template (px)", ylabel=label)
    ax.set_xticks(sides, [f"{side:g}" for side in sides])
    ax.set_xticks([], minor=True)
    ax.grid(color="0.9", linewidth=0.6)
    ax.legend(frameon=False, fontsize=10)


def heatmap(ax: Axes, values: pd.DataFrame, title: str = "", *, marked: pd.DataFrame | None = None) -> None:
    """Shares, 0 to 1, as coloured cells with two digits; NaN stays empty, ``marked`` ones are bold and framed."""
    numbers = values.to_numpy(float)
    shown = ax.imshow(numbers, vmin=0, vmax=1, aspect="auto")
    for (row, column), number in np.ndenumerate(numbers):
        if np.isfinite(number):
            bold = marked is not None and bool(marked.iloc[row, column])
            light = np.dot(np.asarray(shown.to_rgba(number))[:3], [0.3, 0.59, 0.11]) > 0.5
            text = ax.text(column, row, f"{number:.2f}", ha="center", va="center", fontsize=10,
                           color="black" if light else "white", fontweight="bold" if bold else "normal")  # fmt: skip
            text.set_in_layout(False)  # it is inside the axes, and measuring hundreds of texts takes seconds
            if bold:
                corner = np.array([column - 0.46, row - 0.44])
                ax.plot(corner[0] + np.array([0, 0.92, 0.92, 0, 0]), corner[1] + np.array([0, 0, 0.88, 0.88, 0]),
                        color=ACCEPTED, linewidth=1.6)  # fmt: skip
    ax.set_xticks(range(values.shape[1]), [str(name) for name in values.columns], fontsize=10)
    ax.set_yticks(range(values.shape[0]), [str(name) for name in values.index], fontsize=10)
    ax.tick_params(length=0)
    ax.set_title(title, fontsize=10)


def verdict_figure(verdicts: pd.DataFrame) -> Figure:
    """THE table as a picture: area under recall for each condition and measure, framed where best or not told from it.

    ``verdicts`` as from :func:`occlib.study.tables.verdicts`; to the right, the best measure's area with its 95 % interval.
    """
    rows = verdicts[~verdicts["condition"].str.startswith("claim")].set_index("condition")
    columns = list(rows.columns)
    methods = columns[columns.index("high") + 1 : columns.index("statement")]
    good = [[m == row["best"] or m in row["tied"].split(", ") for m in methods] for _, row in rows.iterrows()]
    fig = Figure(figsize=(3.6 + 0.95 * max(len(methods), 5), 1.3 + 0.36 * len(rows)), layout="constrained")
    left, right = fig.subplots(1, 2, sharey=True, width_ratios=[max(len(methods), 5), 3])
    heatmap(left, rows[methods], "area under recall (absent: share of pictures without false alarm)\nframed: best (in brackets), or not told from it",
            marked=pd.DataFrame(good))  # fmt: skip
    left.set_yticks(range(len(rows)), [f"{name} ({row['best']})" for name, row in rows.iterrows()])
    for place, name in enumerate(rows.index):
        if name == CONSTANT_LIGHT:  # from here on: means over conditions
            left.axhline(place - 0.5, color="black", linewidth=2)
            right.axhline(place - 0.5, color="black", linewidth=2)
    places = np.arange(len(rows))
    right.hlines(places, rows["low"], rows["high"], color="black", linewidth=1.4)
    right.plot(rows["area"], places, "o", color="black", markersize=4)
    right.set(xlim=(0, 1.02), xlabel="area", xticks=[0, 0.5, 1])
    right.set_title("the best one,\n95 % interval", fontsize=10)
    right.grid(axis="x", color="0.9", linewidth=0.6)
    right.tick_params(axis="y", length=0)
    return fig
