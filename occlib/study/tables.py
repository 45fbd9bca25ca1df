"""A comparative study of template matching measures: which one survives what, and by how much.

One factor at a time. A *trial* cuts a square template from a clean picture, centred at a target whose place is
known exactly, degrades the picture by one *condition* at one *level* (:data:`CONDITIONS`), and looks for the
template in a search image of 320 x 240 px that holds the target at a random place, displaced by a fraction of a pixel
and with the noise of a sensor. All measures see the same
pictures, and one seed has the same targets under every condition and level: the comparison is paired.

``cost`` is the score of a distance and ``1 - score`` of a correlation: 0 is perfect for both. *Optima* are
places with the least cost within half a template (:func:`occlib.matching.optima.optima`, ``"nms"``). The best place is
*found* when it is within ``tau_px`` of the truth. Results hold for these pictures; seeds only redraw the targets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import integrate

from occlib.base.arrays import FloatArray
from occlib.base.extras import pandas as pd
from occlib.base.intervals import log_interval, stratified_interval, t_interval, wilson_interval
from occlib.study.conditions import CHANGING_LIGHT, CONDITIONS, CONSTANT_LIGHT
from occlib.study.trials import WRONG, known_names

RULES = ("fixed", "default", "otsu", "mad")

LENGTHS = ("rmse_px", "rmse_cm")

BY = ("condition", "level", "method")


def summarise(table: pd.DataFrame, by: Sequence[str] = BY) -> pd.DataFrame:
    """Accuracy for each group of trials, present targets only, with 95 % intervals.

    Columns: ``trials``; ``recall`` (share found at rank 1) with Wilson's interval over the pooled trials, somewhat
    narrow as trials on one picture are not independent; ``rmse_px`` and ``rmse_cm`` over those found: the geometric
    mean of one value a seed, and the t-interval of its logarithm; the median ``peak_ratio``: the mean of one value a
    seed and its t-interval. ``_low`` and ``_high`` are the ends.
    """
    by = list(_columns(table, by))
    here = table[table["present"]]
    squares = here[["error_px", "error_cm"]].where(here["found"]) ** 2
    here = here.assign(rmse_px=squares["error_px"], rmse_cm=squares["error_cm"])
    counts = here.groupby(by, sort=False)["found"].agg(["size", "sum"])
    low, high = wilson_interval(counts["sum"], counts["size"])
    result = pd.DataFrame({"trials": counts["size"], "recall": counts["sum"] / counts["size"]}, index=counts.index)
    result = result.assign(recall_low=low, recall_high=high)
    seeds = here.groupby([*by, "seed"], sort=False)
    per_seed = pd.concat([seeds[["rmse_px", "rmse_cm"]].mean(), seeds["peak_ratio"].median()], axis=1)
    per_seed[["rmse_px", "rmse_cm"]] **= 0.5
    groups = per_seed.groupby(level=by, sort=False)
    for name in per_seed:
        ends = np.array(
            [log_interval(group[name]) if name in LENGTHS else t_interval(group[name]) for _, group in groups]
        )
        result = result.assign(**{str(name): ends[:, 0], f"{name}_low": ends[:, 1], f"{name}_high": ends[:, 2]})
    return result.reset_index()


def _columns(table: pd.DataFrame, names: Sequence[str]) -> tuple[str, ...]:
    if table.empty:
        raise ValueError("table: expected the trials of a study, got no row")
    return known_names([names] if isinstance(names, str) else names, table.columns, "by")


def _costs(table: pd.DataFrame, columns: Sequence[str]) -> FloatArray:
    """Values (trials, columns) turned so that less is better."""
    return table[list(columns)].to_numpy(float) * np.where(table["higher_is_better"], -1.0, 1.0)[:, None]


def _candidates(table: pd.DataFrame) -> tuple[FloatArray, FloatArray]:
    """Costs of what can be accepted: right (the target's own optimum, NaN without), and wrong (trials, 5)."""
    right = _costs(table, ["score_target"])[:, 0]
    return np.where(table["optimum"], right, np.nan), _costs(table, [f"wrong_{i + 1}" for i in range(WRONG)])


def _curve(table: pd.DataFrame) -> pd.DataFrame:
    """One method: ``cost, recall, precision, f1`` for every limit that changes what is accepted, strictest first."""
    right, wrong = (costs[np.isfinite(costs)] for costs in _candidates(table))
    costs = np.concatenate([right, wrong])
    order = np.argsort(costs, kind="stable")
    correct = (order < len(right)).cumsum()
    last = np.append(np.diff(costs[order]) > 0, True)[: len(order)]  # equal costs are accepted together
    accepted, correct, cost = (np.arange(len(order)) + 1)[last], correct[last], costs[order][last]
    positives = int(table["present"].sum())
    return pd.DataFrame({"cost": cost, "recall": correct / max(positives, 1), "precision": correct / accepted,
                         "f1": 2 * correct / (accepted + positives)})  # fmt: skip


def fixed_thresholds(table: pd.DataFrame) -> dict[str, float]:
    """For each method the one number that has the best F1 on the clean trials of all pictures together.

    Clean is what no condition disturbs, not even the noise that some are tried under.

    Halfway between the last score that it accepts and the next one: the most room for a disturbance on either
    side. Without a next one, the last accepted score itself; NaN without clean trials.
    """
    undisturbed = {name: c.clean for name, c in CONDITIONS.items() if c.is_undisturbed(c.clean)}
    clean = table[table["condition"].map(undisturbed) == table["level"]]
    clean = clean.drop_duplicates(["source", "seed", "side", "method"])
    limits = dict.fromkeys(table["method"].unique(), np.nan)
    for method, group in clean.groupby("method", sort=False):
        curve = _curve(group)
        if len(curve):
            best = int(curve["f1"].to_numpy().argmax())
            limit = float(curve["cost"].iloc[best : best + 2].mean())
            limits[str(method)] = -limit if group["higher_is_better"].iloc[0] else limit
    return limits


def thresholds(table: pd.DataFrame, by: Sequence[str] = BY) -> pd.DataFrame:
    """How the rules of :data:`RULES` decide, for each group: ``recall, precision, f1, false_alarms, limit``.

    ``fixed`` is :func:`fixed_thresholds`, held under every condition. A target is detected when its optimum is
    accepted; ``false_alarms`` are accepted wrong optima a trial, counted up to 5 (so precision is a little kind
    to a rule that accepts more). ``limit`` is the median threshold. Recall and F1 are NaN for absent targets.
    """
    by = list(_columns(table, by))
    right, wrong = _candidates(table)
    parts = []
    for rule in RULES:
        limits = table["method"].map(fixed_thresholds(table)) if rule == "fixed" else table[rule]
        cost = _costs(table.assign(limit=limits), ["limit"])
        counted = table[by].assign(limit=limits, trials=1, positives=table["present"].astype(int),
                                   correct=(right <= cost[:, 0]).astype(int),
                                   false=(wrong <= cost).sum(axis=1))  # fmt: skip
        groups = counted.groupby(by, sort=False)
        part = groups[["trials", "positives", "correct", "false"]].sum()
        part.insert(0, "rule", rule)
        parts.append(part.assign(limit=groups["limit"].median()).reset_index())
    result = pd.concat(parts, ignore_index=True)
    correct, false, positives = result["correct"], result["false"], result["positives"].where(result["positives"] > 0)
    result = result.assign(recall=correct / positives,
                           precision=correct / (correct + false).where(correct + false > 0),
                           f1=2 * correct / (correct + false + positives),
                           false_alarms=false / result["trials"])  # fmt: skip
    return result[["rule", *by, "trials", "limit", "recall", "precision", "f1", "false_alarms"]]


def precision_recall(table: pd.DataFrame, by: Sequence[str] = ("condition", "method")) -> pd.DataFrame:
    """Precision and recall as one threshold moves over all trials of a group: ``threshold, recall, precision, f1``.

    By default pooled over the levels of a condition. At most 5 wrong optima a trial count. Strictest first.
    """
    by = list(_columns(table, by))
    parts = []
    key: Any
    for key, group in table.groupby([*by, "higher_is_better"], sort=False):
        curve = _curve(group)
        for position, (name, value) in enumerate(zip(by, key, strict=False)):
            curve.insert(position, name, value)
        parts.append(curve.assign(threshold=-curve["cost"] if key[-1] else curve["cost"]).drop(columns="cost"))
    return pd.concat(parts, ignore_index=True)[[*by, "threshold", "recall", "precision", "f1"]]


def areas(table: pd.DataFrame) -> pd.DataFrame:
    """One figure of merit, 0 to 1, higher is better: ``area`` for each condition, method, source and seed.

    The area under recall against level, over the range of levels (trapezoids), averaged over sides. For conditions that
    remove the target the share of trials in which the default threshold accepts nothing (specificity).
    """
    unit = ["condition", "method", "source", "seed"]
    removing = [name for name, condition in CONDITIONS.items() if condition.removes_target]
    here = table[table["present"] & ~table["condition"].isin(removing)]
    recall = here.groupby([*unit, "level"], sort=False)["found"].mean().reset_index()
    rows = []
    group: pd.DataFrame
    key: Any
    for key, group in recall.groupby(unit, sort=False):
        level, value = group.sort_values("level")[["level", "found"]].to_numpy(float).T
        span = np.ptp(level)
        rows.append((*key, integrate.trapezoid(value, level) / span if span > 0 else value.mean()))
    gone = table[~table["present"]]
    silent = ~(_candidates(gone)[1] <= _costs(gone, ["default"])).any(axis=1)
    quiet = gone[unit].assign(area=silent.astype(float)).groupby(unit, sort=False)["area"].mean().reset_index()
    return pd.concat([pd.DataFrame(rows, columns=[*unit, "area"]), quiet], ignore_index=True)


def verdicts(table: pd.DataFrame) -> pd.DataFrame:
    """Which measure is best under each condition, and which cannot be told from it: the table of the study.

    One row a condition, then *constant light* and *changing light* (the means over the conditions of these groups),
    then the paper's claim about SSD. Columns:
    ``criterion``; ``best``; ``tied``, the measures whose 95 % interval of the difference to the best, paired by
    target, contains 0 (all of them with one seed); ``area, low, high`` of the best (:func:`stratified_interval`); one
    column a measure; ``statement``.

    The claim's row gives SSD's area at constant light minus that under changing light.
    """
    wide = areas(table).pivot(index=["condition", "source", "seed"], columns="method", values="area")
    wide = wide[list(dict.fromkeys(table["method"]))]
    names = list(dict.fromkeys(table["condition"]))
    groups = {name: wide.loc[name] for name in names}
    for title in (CONSTANT_LIGHT, CHANGING_LIGHT):
        if members := [name for name in names if name in CONDITIONS and CONDITIONS[name].group == title]:
            groups[title] = wide.loc[members].groupby(level=["source", "seed"]).mean()
    rows = [_verdict(name, values) for name, values in groups.items()]
    if "ssd" in wide and {CONSTANT_LIGHT, CHANGING_LIGHT} <= set(groups):
        constant, changing = groups[CONSTANT_LIGHT]["ssd"], groups[CHANGING_LIGHT]["ssd"]
        drop, low, high = stratified_interval(constant - changing)
        told = "no difference shown"
        if low > 0 or high < 0:
            told = f"{'less' if low > 0 else 'more'} reliable when the light changes"
        means = [stratified_interval(values)[0] for values in (constant, changing)]
        text = f"ssd {means[0]:.2f} at constant light, {means[1]:.2f} when it changes: {told}"
        rows.append({"condition": "claim: ssd is reliable at constant light", "criterion": "difference of areas",
                     "best": "ssd", "tied": "", "area": drop, "low": low, "high": high, "statement": text})  # fmt: skip
    return pd.DataFrame(rows)[["condition", "criterion", "best", "tied", "area", "low", "high", *wide, "statement"]]


def verdicts_of(table: pd.DataFrame, situations: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    """As :func:`verdicts`, for situations: the mean over the conditions of each, one row a situation."""
    wide = areas(table).pivot(index=["condition", "source", "seed"], columns="method", values="area")
    wide = wide[list(dict.fromkeys(table["method"]))]
    rows = [
        {**_verdict(name, wide.loc[list(members)].groupby(level=["source", "seed"]).mean()), "situation": name}
        for name, members in situations.items()
    ]
    return pd.DataFrame(rows)[["situation", "best", "tied", "area", "low", "high", *wide, "statement"]]


def _verdict(name: str, values: pd.DataFrame) -> dict[str, Any]:
    """The row of a condition from its areas, indexed by source and seed, a column a method."""
    means = values.groupby(level="source").mean().mean()
    best = str(means.idxmax())
    tied = []
    for other in values.columns.drop(best):
        difference, low, _ = stratified_interval(values[best] - values[other])
        if not low > 0 or difference == 0:
            tied.append(str(other))
    area, low, high = np.clip(stratified_interval(values[best]), 0, 1)
    rest = [str(m) for m in values.columns if m != best and m not in tied]
    text = f"{best} best" + (f"; {_listed(tied)} cannot be told from it" if tied else "") + (
        f"; {_listed(rest)} worse" if rest else "")  # fmt: skip
    gone = name in CONDITIONS and CONDITIONS[name].removes_target
    criterion = "specificity" if gone else "area under recall"
    return {"condition": name, "criterion": criterion, "best": best, "tied": ", ".join(tied), "area": area, "low": low,
            "high": high, **dict(zip(map(str, means.index), means, strict=True)), "statement": text}  # fmt: skip


def _listed(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))
