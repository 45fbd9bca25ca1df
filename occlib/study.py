"""A comparative study of template matching measures: which one survives what, and by how much.

One factor at a time. A *trial* cuts a square template from a clean picture, centred at a target whose place is
known exactly, degrades the picture by one *condition* at one *level* (:data:`CONDITIONS`), and looks for the
template in a search image of 320 x 240 px that holds the target at a random place, displaced by a fraction of a pixel
and with the noise of a sensor. All measures see the same
pictures, and one seed has the same targets under every condition and level: the comparison is paired.

``cost`` is the score of a distance and ``1 - score`` of a correlation: 0 is perfect for both. *Optima* are
places with the least cost within half a template (:func:`occlib.matching.optima`, ``"nms"``). The best place is
*found* when it is within ``tau_px`` of the truth. Results hold for these pictures; seeds only redraw the targets.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import integrate, stats

from occlib import trials
from occlib.conditions import CONDITIONS
from occlib.geometry import FloatArray
from occlib.trials import (
    SHIPPED,
    SIDES_PX,
    SOURCES,
    TIMED,
    WRONG,
    Methods,
    known_names,
    make_trial,
    measured_trial,
    registered,
    whole_numbers,
)
from occlib.trials import runtime as runtime
from occlib.trials import sources as sources

RULES = ("fixed", "default", "otsu", "mad")
LIGHT = ("gain", "offset", "gradient")
LENGTHS = ("rmse_px", "rmse_cm")
STEP = 0.05  # of an area, the least that a lost target costs

# --- work --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Batch:
    """All trials of one source, seed and template side: one unit of work."""

    source: str
    seed: int
    side: int
    levels: tuple[tuple[str, tuple[float, ...]], ...]  # condition, its levels
    tau_px: float = 5.0

    @property
    def key(self) -> str:
        """For file names: the same for the same work, on every machine."""
        return f"{self.source}-{self.side}px-seed{self.seed}-{zlib.crc32(repr(self).encode()):08x}"


@dataclass(frozen=True)
class Preset:
    """How much to do: seeds, template sides in px, sources, few or all levels."""

    seeds: tuple[int, ...]
    sides: tuple[int, ...] = (48,)
    sources: tuple[str, ...] = SHIPPED
    few_levels: bool = False


PRESETS = {
    "fast": Preset((0, 1), sources=("camera", "coins", "four_robots"), few_levels=True),
    "default": Preset(tuple(range(6))),
    "full": Preset(tuple(range(12)), (24, 48, 96)),
}


def batches(
    preset: str = "default",
    *,
    seeds: Iterable[int] | None = None,
    conditions: Iterable[str] | None = None,
    sources: Iterable[str] | None = None,
    sides: Iterable[int] | None = None,
    tau_px: float = 5.0,
) -> list[Batch]:
    """The work of a study, in a fixed order; whatever is given replaces the preset's choice.

    ``preset`` is ``"fast"`` (seconds), ``"default"`` (a minute or two on one core) or ``"full"`` (three sides,
    12 seeds); ``tau_px`` is the error up to which a target counts as found. ``"time"`` runs only on sources
    where things move, ``"side"`` only beside its own clean side. Raises ``ValueError`` for unknown names, for
    nothing to do, and for sides outside 16 to 128 px.
    """  # fmt: skip
    choice = PRESETS[known_names([preset], PRESETS, "preset")[0]]
    numbers = whole_numbers(choice.seeds if seeds is None else seeds, "seeds", 0, 2**32)
    places = known_names(choice.sources if sources is None else sources, SOURCES, "source")
    trials.check_at_hand(places)
    names = known_names(CONDITIONS if conditions is None else conditions, CONDITIONS, "condition")
    lengths = whole_numbers(choice.sides if sides is None else sides, "sides", *SIDES_PX)
    if not (np.isfinite(tau_px) and tau_px > 0):
        raise ValueError(f"tau_px: expected px > 0, got {tau_px}")
    found = []
    for side, seed, source in ((side, seed, source) for side in lengths for seed in numbers for source in places):
        levels = tuple(
            (name, CONDITIONS[name].few_levels if choice.few_levels else CONDITIONS[name].levels) for name in names
            if (name != "time" or source in TIMED) and (name != "side" or side == CONDITIONS["side"].clean)
        )  # fmt: skip
        found += [Batch(source, seed, side, levels, float(tau_px))] if levels else []
    if not found:
        raise ValueError(f"conditions: {', '.join(names)} cannot be tried on {', '.join(places)}")
    return found


def run_batch(batch: Batch, methods: Methods = None) -> pd.DataFrame:
    """The trials of a batch, one row for each condition, level and method: the same on every run.

    Parameters
    ----------
    batch
        From :func:`batches`.
    methods
        Names, or methods themselves (as needed in another process for a matcher of your own); by default all of
        :data:`occlib.matching.METHODS`.

    Returns
    -------
    DataFrame
        ``source, seed, side, tau_px, condition, level, method, higher_is_better, present``; the best place:
        ``score``, ``dx, dy, error_px`` (px, found minus true) and ``error_cm`` (on the floor; NaN for
        photographs), ``found`` (error at most ``tau_px``); ``score_target`` (best within ``tau_px`` of the
        truth), ``optimum`` (that is the score of an optimum); ``wrong_1`` to ``wrong_5``, the best optima
        farther than ``tau_px``; ``peak_ratio``, the cost of the second optimum over that of the first, 1 to 100 (more
        is safer; not comparable between squared and absolute differences); the limits that ``default``, ``otsu``
        and ``mad`` give. What does not exist is NaN: truth of an absent target, a limit of a constant image.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # cores are shared out between batches
    clean: list[dict[str, Any]] = []  # is the same picture for every condition, so it is measured once
    rows = []
    try:
        with registered(methods) as chosen:
            for condition, levels in batch.levels:
                for level in levels:
                    same = level == CONDITIONS[condition].clean and not CONDITIONS[condition].under
                    if same and clean:
                        measured = clean
                    else:
                        trial = make_trial(batch.source, batch.seed, condition, level, batch.side)
                        measured = [measured_trial(trial, method, batch.tau_px) for method in chosen]
                        clean = measured if same else clean
                    about = {"source": batch.source, "seed": batch.seed, "side": batch.side, "tau_px": batch.tau_px}
                    rows += [{**about, "condition": condition, "level": float(level), **row} for row in measured]
    finally:
        cv2.setNumThreads(threads)
    return pd.DataFrame(rows)


def run(work: Sequence[Batch], methods: Methods = None, *, progress: bool = True) -> pd.DataFrame:
    """The trials of several batches, one after the other, with a progress bar; columns as in :func:`run_batch`."""
    from tqdm import tqdm

    if not work:
        raise ValueError("work: expected at least one batch, got none")
    chosen = None if methods is None else tuple(methods)
    bar = tqdm(work, desc="study", unit="batch", disable=not progress)
    return pd.concat([run_batch(batch, chosen) for batch in bar], ignore_index=True)


# --- intervals ---------------------------------------------------------------------------------------


def wilson_interval(hits: npt.ArrayLike, count: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """95 % interval of a proportion (Wilson 1927); NaN for a count of 0.

    >>> [round(float(end), 3) for end in wilson_interval(8, 10)]
    [0.49, 0.943]
    """
    k, n, z = np.asarray(hits, float), np.asarray(count, float), float(stats.norm.ppf(0.975))
    n = np.where(n > 0, n, np.nan)
    middle = (k + z * z / 2) / (n + z * z)
    half = z / (n + z * z) * np.sqrt(k * (n - k) / n + z * z / 4)
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)


def t_interval(values: npt.ArrayLike) -> tuple[float, float, float]:
    """Mean and 95 % t-interval of independent values (one a seed); NaN are left out, and fewer than two have no ends.

    >>> [round(end, 3) for end in t_interval([1, 2, 3])]
    [2.0, -0.484, 4.484]
    """
    kept = np.asarray(values, float)
    kept = kept[np.isfinite(kept)]
    if len(kept) < 2:
        return (float(kept[0]) if len(kept) else np.nan), np.nan, np.nan
    half = float(stats.t.ppf(0.975, len(kept) - 1) * kept.std(ddof=1) / np.sqrt(len(kept)))
    return float(kept.mean()), float(kept.mean()) - half, float(kept.mean()) + half


def stratified_interval(values: pd.Series[float]) -> tuple[float, float, float]:
    """Mean over sources and its 95 % interval over seeds; ``values`` has the index levels ``source`` and ``seed``.

    The sources are the same on every run and the seeds redraw the targets in them, so what differs between sources
    is no error: the variance is the mean one within sources, and a t-distribution has its degrees of freedom.
    Where (nearly) nothing varied among ``n`` values it is taken as ``3 / n`` times 0.05 squared: what happened to none
    of ``n`` may still happen to 3 of ``n`` (the rule of three), and then costs an area a step. NaN are left out, and
    there are no ends where a source has one seed.

    >>> index = pd.MultiIndex.from_product([["a", "b"], [0, 1, 2]], names=["source", "seed"])
    >>> [round(end, 3) for end in stratified_interval(pd.Series([1, 2, 3, 11, 12, 13.0], index))]
    [7.0, 5.867, 8.133]
    """
    groups = values.dropna().groupby(level="source")
    mean, freedom = float(groups.mean().mean()), int((groups.size() - 1).sum())
    variance = groups.apply(lambda group: ((group - group.mean()) ** 2).sum()).sum() / max(freedom, 1)
    if (groups.size() < 2).any():
        return mean, np.nan, np.nan
    variance = max(variance, 3 / groups.size().sum() * STEP**2)
    half = float(stats.t.ppf(0.975, freedom) * np.sqrt(variance * (1 / groups.size()).sum()) / len(groups))
    return mean, mean - half, mean + half


def _log_interval(values: pd.Series[float]) -> tuple[float, ...]:
    """As :func:`t_interval` for what is positive and skewed; a length of exactly 0 counts as a thousandth."""
    return tuple(float(np.exp(end)) for end in t_interval(np.log(values.clip(lower=1e-3))))


# --- tables ------------------------------------------------------------------------------------------

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
            [_log_interval(group[name]) if name in LENGTHS else t_interval(group[name]) for _, group in groups]
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
    undisturbed = {name: np.nan if condition.under else condition.clean for name, condition in CONDITIONS.items()}
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

    The area under recall against level, over the range of levels (trapezoids), averaged over sides. For ``absent`` the
    share of trials in which the default threshold accepts nothing (specificity).
    """
    unit = ["condition", "method", "source", "seed"]
    here = table[table["present"] & (table["condition"] != "absent")]
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

    One row a condition, then *constant light* and *changing light* (the mean over the conditions without and
    with gain, offset and gradient; ``time`` and ``absent`` left out), then the paper's claim about SSD. Columns:
    ``criterion``; ``best``; ``tied``, the measures whose 95 % interval of the difference to the best, paired by
    target, contains 0 (all of them with one seed); ``area, low, high`` of the best (:func:`stratified_interval`); one
    column a measure; ``statement``.

    The claim's row gives SSD's area at constant light minus that under changing light.
    """
    wide = areas(table).pivot(index=["condition", "source", "seed"], columns="method", values="area")
    wide = wide[list(dict.fromkeys(table["method"]))]
    names = list(dict.fromkeys(table["condition"]))
    groups = {name: wide.loc[name] for name in names}
    steady = [name for name in names if name not in (*LIGHT, "time", "absent")]
    for title, members in (("constant light", steady), ("changing light", [name for name in names if name in LIGHT])):
        if members:
            groups[title] = wide.loc[members].groupby(level=["source", "seed"]).mean()
    rows = [_verdict(name, values) for name, values in groups.items()]
    if "ssd" in wide and {"constant light", "changing light"} <= set(groups):
        constant, changing = groups["constant light"]["ssd"], groups["changing light"]["ssd"]
        drop, low, high = stratified_interval(constant - changing)
        told = "no difference shown"
        if low > 0 or high < 0:
            told = f"{'less' if low > 0 else 'more'} reliable when the light changes"
        means = [stratified_interval(values)[0] for values in (constant, changing)]
        text = f"ssd {means[0]:.2f} at constant light, {means[1]:.2f} when it changes: {told}"
        rows.append({"condition": "claim: ssd is reliable at constant light", "criterion": "difference of areas",
                     "best": "ssd", "tied": "", "area": drop, "low": low, "high": high, "statement": text})  # fmt: skip
    return pd.DataFrame(rows)[["condition", "criterion", "best", "tied", "area", "low", "high", *wide, "statement"]]


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
    text = f"{best} best" + (f", {', '.join(tied)} not told from it" if tied else "") + (
        f"; {', '.join(rest)} worse" if rest else "; no difference shown")  # fmt: skip
    criterion = "specificity" if name == "absent" else "area under recall"
    return {"condition": name, "criterion": criterion, "best": best, "tied": ", ".join(tied), "area": area, "low": low,
            "high": high, **dict(zip(map(str, means.index), means, strict=True)), "statement": text}  # fmt: skip
