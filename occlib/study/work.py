"""The work of the study: batches of trials by preset, their run in this process, and the sweep that writes files."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from occlib.base.extras import pandas as pd
from occlib.matching.sums import shared
from occlib.study import trials
from occlib.study.conditions import CONDITIONS
from occlib.study.trials import (
    SHIPPED,
    SIDES_PX,
    SOURCES,
    TIMED,
    Methods,
    known_names,
    make_trial,
    measured_trial,
    registered,
    whole_numbers,
)


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
    levels: Mapping[str, Iterable[float]] | None = None,
    tau_px: float = 5.0,
) -> list[Batch]:
    """The work of a study, in a fixed order; whatever is given replaces the preset's choice, ``levels`` by condition.

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
    own = {known_names([name], CONDITIONS, "levels")[0]: tuple(given) for name, given in (levels or {}).items()}
    found = []
    for side, seed, source in ((side, seed, source) for side in lengths for seed in numbers for source in places):
        suited = [name for name in names if CONDITIONS[name].suits(side, filmed=source in TIMED)]
        tried = tuple((name, own.get(name) or _usual_levels(name, choice)) for name in suited)
        found += [Batch(source, seed, side, tried, float(tau_px))] if tried else []
    if not found:
        raise ValueError(f"conditions: {', '.join(names)} cannot be tried on {', '.join(places)}")
    return found


def _usual_levels(condition: str, preset: Preset) -> tuple[float, ...]:
    return CONDITIONS[condition].few_levels if preset.few_levels else CONDITIONS[condition].levels


def run_batch(batch: Batch, methods: Methods = None) -> pd.DataFrame:
    """The trials of a batch, one row for each condition, level and method: the same on every run.

    Parameters
    ----------
    batch
        From :func:`batches`.
    methods
        Names, or methods themselves (as needed in another process for a matcher of your own); by default all of
        :data:`occlib.matching.search.METHODS`.

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
        with registered(methods) as chosen, shared():
            for condition, levels in batch.levels:
                for level in levels:
                    undisturbed = CONDITIONS[condition].is_undisturbed(level)
                    if undisturbed and clean:
                        measured = clean
                    else:
                        trial = make_trial(batch.source, batch.seed, condition, level, batch.side)
                        with shared():
                            measured = [measured_trial(trial, method, batch.tau_px) for method in chosen]
                        clean = measured if undisturbed else clean
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
