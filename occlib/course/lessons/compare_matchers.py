"""Tables and figures of chapter 04, "Compare matchers"."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from occlib import matching, plotting, study
from occlib.base.arrays import FloatArray
from occlib.base.extras import pandas as pd
from occlib.base.intervals import stratified_interval

SITUATIONS = {
    "the light changes": ("gain", "offset", "gradient"),
    "noise, blur, compression": ("noise", "blur", "jpeg"),
    "look-alikes, small templates": ("clutter", "side"),
    "the target turns or changes size": ("rotation", "scale"),
    "the target is partly covered": ("occlusion",),
    "the target may be absent": ("absent",),
}
"""What a reader wants to decide for, and the conditions of the study that answer."""

GROUPS = {
    "light": ("gain", "offset", "gradient"),
    "picture quality": ("noise", "blur", "jpeg"),
    "geometry": ("rotation", "scale"),
    "scene": ("occlusion", "clutter", "absent"),
}
"""Conditions that share one threshold in the curves of precision and recall."""

STRONG = {"gain": 0.4, "occlusion": 0.6, "jpeg": 2, "rotation": 30, "clutter": 8}
"""Levels to show, where the last one would show too much."""

IN_SHORT = {
    "gradient": "gain from 1 - level (left) to 1 + level (right)",
    "occlusion": "covered by another piece of the picture",
    "clutter": "turned copies of the target; noise of 40",
    "jpeg": "JPEG quality; 100 is not compressed",
    "side": "side of the template; noise of 40",
    "time": "frames of 0.1 s from template to image",
    "absent": "target covered: any match is a false alarm",
}
"""What happens, where the study's own words are too long for a table (pandas cuts at 50 characters)."""

RULE_COLOURS = {"fixed": "#444444", "default": "#D55E00", "otsu": "#0072B2", "mad": "#CC79A7"}


def decision_table(trials: pd.DataFrame) -> pd.DataFrame:
    """For each situation: the best measure, what is not told from it, and the area under recall of each measure."""
    table = study.verdicts_of(trials, SITUATIONS).set_index("situation")
    areas = table[list(dict.fromkeys(trials["method"]))].astype(float)
    named = table[["best", "tied"]].replace("", "none").rename(columns={"best": "use", "tied": "or"})
    return named.join(areas.round(2))


def condition_table() -> pd.DataFrame:
    """Every condition of the study: unit, clean level, levels, and what happens."""
    rows = [
        (c.name, c.unit, c.clean, ", ".join(f"{x:g}" for x in c.levels), IN_SHORT.get(c.name, c.about))
        for c in study.CONDITIONS.values()
    ]
    names = ["condition", "unit", "clean at", "levels", "what happens"]
    return pd.DataFrame(rows, columns=names).set_index("condition")


def condition_sheet(source: str, draw: int) -> Figure:
    """One target at a strong level of every condition that changes the picture, the true place framed."""
    sheet = {"clean": study.make_trial(source, draw)}
    for c in study.CONDITIONS.values():
        if c.level_is != "side":
            level = STRONG.get(c.name, c.levels[-1])
            unit = c.unit if c.unit in ("grey levels", "px", "degrees", "frames") else ""
            sheet[f"{c.name}: {level:g} {unit}"] = study.make_trial(source, draw, c.name, level)
    return study.contact_sheet(sheet, columns=4)


def _corner(trial: study.Trial) -> FloatArray:
    if trial.corner is None:
        raise ValueError("trial: expected one with its target, got one without")
    return trial.corner


def best_places(trial: study.Trial, tau_px: float) -> pd.DataFrame:
    """For each measure the best place, its distance from the truth, whether that is a hit, and the peak ratio."""
    rows = {}
    for name, method in matching.METHODS.items():
        told = study.measured_trial(trial, method, tau_px)
        corner = np.add(_corner(trial), (told["dx"], told["dy"]))
        rows[name] = {"x": corner[0], "y": corner[1], **{k: told[k] for k in ("error_px", "found", "peak_ratio")}}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("method")


def gain_figure(source: str, draw: int, gains: Iterable[float], tau_px: float) -> Figure:
    """The picture under each gain, and the peak ratio of each measure: hatched where its best place is wrong."""
    chosen = list(gains)
    fig, axes = plt.subplots(
        2, len(chosen), figsize=(3.4 * len(chosen), 5.2), layout="constrained", height_ratios=[1.2, 1], squeeze=False
    )
    for column, gain in zip(axes.T, chosen, strict=True):
        trial = study.make_trial(source, draw, "gain", gain)
        _draw_gain(column[0], column[1], trial, gain, tau_px)
    axes[1, 0].set_ylabel("peak ratio")
    return fig


def show_gain(gain: float, *, source: str, draw: int, tau_px: float) -> None:
    """One column of :func:`gain_figure`, side by side."""
    _, axes = plt.subplots(1, 2, figsize=(8.5, 3.2), width_ratios=[1.2, 1])
    _draw_gain(axes[0], axes[1], study.make_trial(source, draw, "gain", gain), gain, tau_px)
    axes[1].set_ylabel("peak ratio")
    plt.show()


def _draw_gain(left: Axes, right: Axes, trial: study.Trial, gain: float, tau_px: float) -> None:
    places, looks = best_places(trial, tau_px), study.measure_styles(matching.METHODS)
    plotting.show_image(left, trial.image, f"gain {gain:g}")
    study.frame_place(left, _corner(trial), trial.template.shape, color="white", linewidth=2.5)
    for name, row in places[~places["found"].astype(bool)].iterrows():
        study.frame_place(
            left, (row["x"], row["y"]), trial.template.shape, color=looks[str(name)]["color"], linestyle="--"
        )
    colours = [looks[str(name)]["color"] for name in places.index]
    hatches = ["" if hit else "xx" for hit in places["found"]]
    right.bar(range(len(places)), places["peak_ratio"] - 1, bottom=1, color=colours, hatch=hatches, edgecolor="0.8")
    right.set_xticks(range(len(places)), list(places.index), rotation=40)
    right.set(yscale="log", ylim=(0.95, 110), title=f"{int(places['found'].sum())} of {len(places)} right")
    right.set_yticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
    right.minorticks_off()


def trial_figure(trial: study.Trial, scores: FloatArray, best: FloatArray, second: FloatArray) -> Figure:
    """Template, image with the true and the second best place, and the score around the best, ``(x, y)`` in px."""
    fig, axes = plt.subplots(1, 3, figsize=(10.5, 3.1), layout="constrained", width_ratios=[0.5, 1.3, 1])
    plotting.show_image(axes[0], trial.template, "template")
    plotting.show_image(axes[1], trial.image, "true place framed, second best dashed")
    study.frame_place(axes[1], _corner(trial), trial.template.shape)
    study.frame_place(axes[1], second, trial.template.shape, color="#56B4E9", linestyle="--", linewidth=2)
    shown = axes[2].imshow(scores, cmap="viridis_r", vmax=scores.min() + 0.2 * np.ptp(scores))
    axes[2].plot(*_corner(trial), "+", color="#D55E00", markersize=16, markeredgewidth=2, label="true")
    axes[2].plot(*best, "x", color="black", markersize=8, markeredgewidth=2, label="best")
    window = {"xlim": best[0] + np.array([-12, 12]), "ylim": best[1] + np.array([12, -12])}
    axes[2].set(**window, xlabel="x (px)", ylabel="y (px)", title="ssd around it")
    axes[2].legend(loc="upper right", labelcolor="black", facecolor="0.7")
    fig.colorbar(shown, ax=axes[2], label="squared grey levels")
    return fig


def accuracy(trials: pd.DataFrame) -> pd.DataFrame:
    """RMSE of the targets found in clean pictures: px over all sources, and px and cm on the robots."""

    def clean(part: pd.DataFrame) -> pd.DataFrame:
        summary = study.summarise(part[(part["condition"] == "noise") & (part["level"] == 0)])
        return summary.set_index("method")

    every, robots = clean(trials), clean(trials[trials["source"].str.contains("robot")])
    columns = {"all (px)": every["rmse_px"], "robots (px)": robots["rmse_px"], "robots (cm)": robots["rmse_cm"]}
    return pd.DataFrame(columns)


def grouped_curves(trials: pd.DataFrame) -> pd.DataFrame:
    """Precision and recall as one threshold moves over all pictures of each of :data:`GROUPS`."""
    groups = {condition: name for name, members in GROUPS.items() for condition in members}
    grouped = trials.assign(group=trials["condition"].map(groups)).dropna(subset="group")
    return study.precision_recall(grouped, ["group", "method"])


def best_f1(curves: pd.DataFrame) -> pd.DataFrame:
    """The best F1 of each curve: a row a group, a column a measure."""
    table = curves.groupby(["group", "method"], sort=False)["f1"].max().unstack(sort=False)
    return table[list(dict.fromkeys(curves["method"]))]


def rules_figure(trials: pd.DataFrame) -> Figure:
    """F1 of the four rules for a threshold, over all levels of a condition together."""
    rules = study.thresholds(trials[trials["condition"] != "absent"], ["condition", "method"])
    fig, axes = plt.subplots(2, 2, figsize=(10, 8.2), layout="constrained", sharex=True, sharey=True)
    for ax, rule in zip(axes.flat, study.RULES, strict=True):
        f1 = rules[rules["rule"] == rule].pivot(index="condition", columns="method", values="f1")
        study.heatmap(ax, f1.loc[rules["condition"].unique(), rules["method"].unique()], f"F1, threshold: {rule}")
    return fig


def ssd_rules_figure(trials: pd.DataFrame) -> Figure:
    """Share of SSD's targets that each rule accepts, against the level of four conditions."""
    shown = ("gain", "offset", "noise", "occlusion")
    levels = study.thresholds(
        trials[trials["method"] == "ssd"]
    )  # all conditions: the fixed threshold needs the clean ones
    levels = levels[levels["condition"].isin(shown)]
    styles = {rule: {"color": colour, "marker": "o"} for rule, colour in RULE_COLOURS.items()}
    fig = study.level_curves(levels, "recall", by="rule", styles=styles)
    fig.axes[0].set_ylabel("share of targets accepted")
    return fig


def threshold_failures(trials: pd.DataFrame) -> pd.DataFrame:
    """Of each rule and measure: the share of targets accepted while the gain is changed, and false alarms where there is none."""
    lit = (trials["condition"] == "gain") & (trials["level"] != 1)
    marked = trials.assign(part=np.where(lit, "gain changed", np.where(trials["present"], "other", "absent")))
    pooled = study.thresholds(marked, ["part", "method"]).set_index(["part", "rule", "method"])
    accepted = pooled["recall"]["gain changed"].unstack("method")
    alarms = pooled["false_alarms"]["absent"].unstack("method")
    order = list(dict.fromkeys(trials["method"]))
    parts = {"accepted, gain changed": accepted, "false alarms, absent": alarms}
    return pd.concat({name: part.loc[list(study.RULES), order] for name, part in parts.items()})


def claim_table(trials: pd.DataFrame) -> pd.DataFrame:
    """SSD's area minus that of another measure on the same pictures, with 95 % intervals, for constant and changing light."""
    wide = study.areas(trials).pivot(index=["condition", "source", "seed"], columns="method", values="area")
    rows = {}
    for title in (study.CONSTANT_LIGHT, study.CHANGING_LIGHT):
        members = [name for name in wide.index.unique("condition") if study.CONDITIONS[name].group == title]
        means = wide.loc[members].groupby(level=["source", "seed"]).mean()
        for other in ("zncc", "sad", "direction"):
            rows[title, f"ssd - {other}"] = stratified_interval(means["ssd"] - means[other])
    rendered = means.index.get_level_values("source").str.contains("robot")
    for name, part in (("photographs", means[~rendered]), ("robots", means[rendered])):
        rows[study.CHANGING_LIGHT, f"ssd - zncc, {name}"] = stratified_interval(part["ssd"] - part["zncc"])
    return pd.DataFrame(rows, index=["difference", "low", "high"]).T


def claim_metrics(claim: pd.DataFrame) -> dict[str, float]:
    """The numbers of :func:`claim_table` by name, as ``ssd_minus_zncc_changing_robots_low``."""
    metrics: dict[str, float] = {}
    for title, pair in claim.index.to_list():
        measures, *part = pair.split(", ")
        name = "_".join(["ssd_minus", measures.split(" - ")[1], title.split()[0], *part])
        ends = claim.loc[(title, pair)]
        metrics |= {name: ends["difference"], f"{name}_low": ends["low"], f"{name}_high": ends["high"]}
    return metrics


def peak_ratios(summary: pd.DataFrame, methods: Iterable[str]) -> dict[str, float]:
    """The median peak ratio of each measure in clean pictures, in dark ones, and under the strongest noise."""
    ratio = summary.set_index(["condition", "level", "method"])["peak_ratio"]
    shown = {"clean": ("gain", 1), "gain_0.4": ("gain", 0.4), "noise_80": ("noise", 80)}
    return {f"{name}_{method}": float(ratio[(*key, method)]) for name, key in shown.items() for method in methods}
