"""The table of all cases: on disk, in short on a terminal, and what is worse than in an earlier one."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from occlib.base.extras import pandas as pd
from occlib.base.files import read_text, write_file

KEY = ("recording", "cameras", "region", "light", "method")
"""What a row is about; each comes once."""

COLUMNS = (
    *("recording", "kind", "cameras", "views", "region", "light", "method"),
    *("moda", "precision", "recall", "ghosts", "error_cm", "switches", "mislabelled", "free_under", "iou"),
    *("outside", "excluded", "ms", "peak", "frames", "truth", "by_kind", "worst_frame"),
    *("objects", "floor", "gloss", "date", "machine"),
)
"""The columns of the table, in their order; :func:`occlib.study.rooms.run_case` says what they mean."""

TEXT = ("recording", "kind", "cameras", "region", "light", "method", "by_kind", "floor", "gloss", "date", "machine")
"""Those of the columns that hold text; the others hold numbers."""

MEAN_FALL = 0.005
"""The mean MODA of a method may fall by so much."""

CASE_FALL = 0.05
"""The MODA of one case may fall by so much: one missed object in twenty, more than another version of OpenCV changes."""

STEPS = {"moda": 5e-4, "precision": 5e-4, "recall": 5e-4, "ghosts": 5e-3, "error_cm": 0.05, "free_under": 1.0}
"""What is told of a row that changed, where it changed by at least so much."""


def load_table(path: str | Path) -> pd.DataFrame:
    """Read ``rooms.csv``; without such a file, a table without rows.

    Raises ``ValueError`` with the file and what is wrong: columns that are missing, a row that comes twice.
    """
    if not Path(path).exists():
        return pd.DataFrame(columns=list(COLUMNS))
    try:
        table = pd.read_csv(io.StringIO(read_text(path)), keep_default_na=False, na_values=[""])
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise ValueError(f"{path}: not a table ({error})") from None
    if missing := [name for name in COLUMNS if name not in table]:
        raise ValueError(f"{path}: expected the columns {', '.join(COLUMNS)}; missing {', '.join(missing)}")
    table = _without_missing_text(table[list(COLUMNS)])
    if twice := table[table.duplicated(list(KEY))].head(1)[list(KEY)].to_numpy().tolist():
        raise ValueError(f"{path}: this row comes twice: {', '.join(map(str, twice[0]))}")
    return table


def save_table(path: str | Path, table: pd.DataFrame) -> Path:
    """Write ``rooms.csv``; whole numbers are written as such."""
    whole = [name for name in table if name not in TEXT and (table[name].dropna() % 1 == 0).all()]
    written = table[list(COLUMNS)].astype(dict.fromkeys(whole, "Int64"))
    return write_file(path, str(written.to_csv(index=False, lineterminator="\n")))


def joined(old: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """The old table with the new rows in place of those of the same key, in the order of kind, recording, light and cameras.

    Rows of recordings that are not at hand now stay, with the date of their run.
    """
    both = pd.concat([table for table in (old, new) if len(table)] or [old], ignore_index=True)
    both = _without_missing_text(both).drop_duplicates(list(KEY), keep="last")
    kinds = {kind: i for i, kind in enumerate(("real", "lab", "room"))}
    order = both.assign(kind=both["kind"].map(kinds), place=both["light"] != "", number=range(len(both)))
    index = order.sort_values(["place", "kind", "recording", "number"], kind="stable").index
    return both.loc[index].reset_index(drop=True)


def difference(old: pd.DataFrame, new: pd.DataFrame) -> list[str]:
    """What changed from one table to another, a line for each row that did, the worst first, and the means; empty if nothing did."""
    lines = []
    pairs = _pairs(old, new)
    for _, row in pairs.assign(by=pairs["moda_new"] - pairs["moda_old"]).sort_values("by", kind="stable").iterrows():
        parts = [
            f"{name} {_shown(row[f'{name}_old'])} -> {_shown(row[f'{name}_new'])}"
            for name, step in STEPS.items()
            if _differs(row[f"{name}_old"], row[f"{name}_new"], step)
        ]
        lines += [f"{_title(row)}: {', '.join(parts)}"] if parts else []
    if lines:
        lines += [
            f"mean of {len(group)}{' in other light' if light else ''}, {method}: moda {group['moda_old'].mean():.4f} -> "
            f"{group['moda_new'].mean():.4f}, ghosts {group['ghosts_old'].mean():.3f} -> {group['ghosts_new'].mean():.3f}"
            for (light, method), group in pairs.groupby([pairs["light"] != "", "method"], sort=False)
        ]
    return lines


def falls(old: pd.DataFrame, new: pd.DataFrame) -> list[str]:
    """What is worse than it may be, a line each: a mean MODA by more than :data:`MEAN_FALL`, a case's by more than :data:`CASE_FALL`.

    Rows that only one of the tables has do not count, nor does other light, in which a little more or less is chance.
    """
    pairs = _pairs(old, new)
    pairs = pairs[pairs["light"] == ""]
    found = []
    for method, group in pairs.groupby("method", sort=False):
        before, after = group["moda_old"].mean(), group["moda_new"].mean()
        if before - after > MEAN_FALL:
            found.append(f"mean of {len(group)}, {method}: moda {before:.4f} -> {after:.4f}")
    for _, row in pairs.iterrows():
        if row["moda_old"] - row["moda_new"] > CASE_FALL + 1e-9:
            found.append(f"{_title(row)}: moda {row['moda_old']:.3f} -> {row['moda_new']:.3f}")
    return found


def summary_text(table: pd.DataFrame) -> str:
    """The rows for a terminal, and mean and worst of each method."""
    shown = ["moda", "precision", "recall", "ghosts", "error_cm", "free_under", "outside", "excluded", "ms", "peak"]
    lines = [["", *shown]]
    lines += [[_title(row), *(_shown(row[name]) for name in shown)] for _, row in table.iterrows()]
    for (light, method), group in table.groupby([table["light"] != "", "method"], sort=False):
        where = f"{method}{', other light' if light else ''} ({len(group)})"
        lines.append([f"mean, {where}", *(_shown(group[name].mean()) for name in shown)])
        least = ("moda", "precision", "recall")
        worst = [group[name].min() if name in least else group[name].max() for name in shown]
        lines.append([f"worst, {where}", *map(_shown, worst)])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) for line in lines)


def _without_missing_text(table: pd.DataFrame) -> pd.DataFrame:
    """Nothing is an empty text in a column of texts."""
    return table.assign(**{n: table[n].astype(object).where(table[n].notna(), "") for n in TEXT})


def _pairs(old: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """The rows that both tables have, side by side."""
    kept = [*KEY, *STEPS]
    return old[kept].merge(new[kept], on=list(KEY), suffixes=("_old", "_new"))


def _title(row: Any) -> str:
    region = f" [{row['region']}]" if row["region"] not in ("", row["cameras"]) else ""
    light = f" {row['light']}" if row["light"] else ""
    return f"{row['recording']} {row['cameras']}{region}{light}, {row['method']}"


def _differs(before: Any, after: Any, step: float) -> bool:
    if pd.isna(before) or pd.isna(after):
        return bool(pd.isna(before) != pd.isna(after))
    return bool(abs(after - before) >= step - 1e-12)


def _shown(value: float) -> str:
    return "-" if pd.isna(value) else f"{value:.4g}"


def kinds_of(rows: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Found and true objects by label, summed over cells of ``by_kind``.

    >>> kinds_of(["carton 8/10; cone 2/2", "carton 1/2", ""])
    {'carton': (9, 12), 'cone': (2, 2)}
    """
    sums: dict[str, tuple[int, int]] = {}
    for part in (part for row in rows for part in row.split("; ") if part):
        label, _, counts = part.rpartition(" ")
        found, true = map(int, counts.split("/"))
        before = sums.get(label, (0, 0))
        sums[label] = before[0] + found, before[1] + true
    return dict(sorted(sums.items()))
