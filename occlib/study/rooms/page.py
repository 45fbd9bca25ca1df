"""The page of the book about the rooms: ``docs/rooms.md``, whose block is written from ``docs/rooms.csv``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from occlib.base.extras import pandas as pd
from occlib.base.files import read_text, write_file
from occlib.base.markdown import END, table_text, with_block
from occlib.lab import REPORTED
from occlib.study.rooms.lighting import LIGHTS
from occlib.study.rooms.tables import kinds_of, load_table

FIRST = "<!-- rooms: all -->\n"

ENOUGH = 0.95
"""A rule is called enough for a case with at least this MODA."""

_OBJECTS = {"1 or 2": (1, 2), "3 to 5": (3, 5), "6 and more": (6, 10**6)}

_KINDS = {"real": "real recordings", "lab": "the lab", "room": "random rooms"}


def page_text(text: str, table: pd.DataFrame) -> str:
    """A page with its block written anew from the table.

    Raises ``ValueError`` unless the text has one block from ``<!-- rooms: all -->`` to ``<!-- end -->``.
    """
    written = with_block(text, FIRST, _block(table))
    if written is None or text.count(FIRST) > 1:
        raise ValueError(f"rooms.md: expected one block from {FIRST.strip()} to {END}")
    return written


def stale_page(docs: str | Path) -> bool:
    """Whether ``rooms.md`` in a folder is not what ``rooms.csv`` beside it says."""
    text = read_text(Path(docs) / "rooms.md")
    return page_text(text, load_table(Path(docs) / "rooms.csv")) != text


def write_page(docs: str | Path) -> Path:
    """Write the block of ``rooms.md`` in a folder anew, from ``rooms.csv`` beside it."""
    path = Path(docs) / "rooms.md"
    return write_file(path, page_text(read_text(path), load_table(Path(docs) / "rooms.csv")))


def _block(table: pd.DataFrame) -> str:
    rooms, light = table[table["light"] == ""], table[table["light"] != ""]
    parts = [_when_and_where(table)]
    if len(rooms):
        parts += ["## When is the paper's rule enough?", _answer(rooms), _by_condition(rooms)]
        if kinds := _by_kind(rooms):
            parts += ["Share of the objects of a kind that are found, in the random rooms, from two cameras:", kinds]
        parts += ["## Every case", _cases(rooms)]
    if len(light):
        parts += ["## The light changes", _about_light(light), _in_light(light)]
    return "\n\n".join(parts)


def _when_and_where(table: pd.DataFrame) -> str:
    dates = sorted(set(table["date"]))
    span = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}" if dates else "never"
    return f"Run {span} on {'; '.join(dict.fromkeys(table['machine'])) or 'nothing'}."


def _answer(rooms: pd.DataFrame) -> str:
    """A few sentences for each number of cameras; what they say follows from the table."""
    sentences = []
    for word, group in _by_cameras(rooms):
        moda = _wide(group, "moda")
        if not {"and", "recommended"} <= set(moda):
            continue
        good = (moda >= ENOUGH).sum()
        better = (moda["recommended"] > moda["and"] + 0.02).sum()
        worse = (moda["and"] > moda["recommended"] + 0.02).sum()
        paper = f"by the paper's chain to the letter in {good['paper']}, " if "paper" in moda else ""
        mean = moda.mean()
        sentences.append(
            f"With {word}, a MODA of at least {ENOUGH} is reached {paper}by AND in its best settings in {good['and']} and by the recommended profile "
            f"in {good['recommended']} of {len(moda)} cases. The mean MODA of AND is {mean['and']:.2f}, of the recommended profile "
            f"{mean['recommended']:.2f}; better by more than 0.02 is the recommended profile in {better} of them, AND in {worse}."
        )
    return "\n\n".join(sentences)


def _by_condition(rooms: pd.DataFrame) -> str:
    """Mean MODA of each method, and how often it is enough, by what is known of a case."""
    methods = _methods(rooms)
    header = ["cameras", "condition", "cases", *(f"MODA, {m}" for m in methods), *(f"enough, {m}" for m in methods)]
    lines = []
    for word, group in _by_cameras(rooms):
        for condition, own in _conditions(group):
            moda = _wide(own, "moda")
            means, good = moda.mean(), (moda >= ENOUGH).sum()
            lines.append(
                [
                    word,
                    condition,
                    f"{len(moda)}",
                    *(f"{means[m]:.2f}" for m in methods),
                    *(f"{good[m]}" for m in methods),
                ]
            )
    return table_text(header, lines)


def _conditions(group: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """The cases of a number of cameras by kind, number of objects, and gloss of the floor; without empty ones."""
    found = [("all", group)]
    found += [(title, group[group["kind"] == kind]) for kind, title in _KINDS.items()]
    reported = group["recording"].isin({f"room_{seed}" for seed in REPORTED})
    found.append(("random rooms that nothing was chosen on", group[reported]))
    rendered = group[group["kind"] != "real"]
    found += [
        (f"rendered, {title} objects", rendered[rendered["objects"].between(least, most)])
        for title, (least, most) in _OBJECTS.items()
    ]
    found += [
        (f"rendered, floor {gloss}", rendered[rendered["gloss"] == gloss]) for gloss in ("glossy", "satin", "dull")
    ]
    return [(title, own) for title, own in found if len(own)]


def _by_kind(rooms: pd.DataFrame) -> str:
    """Recall of each kind of object in the random rooms, two cameras; empty without such rooms."""
    methods = _methods(rooms)
    own = rooms[(rooms["kind"] == "room") & (rooms["views"] == 2)]
    kinds = {method: kinds_of(own[own["method"] == method]["by_kind"].tolist()) for method in methods}
    if not any(kinds.values()):
        return ""
    lines = [
        [label, f"{count}", *(f"{kinds[method][label][0] / count:.2f}" for method in methods)]
        for label, (_, count) in kinds[methods[-1]].items()
    ]
    return table_text(["kind", "objects", *methods], lines)


def _cases(rooms: pd.DataFrame) -> str:
    """A line for each case, then mean and worst: MODA of each method, and the rest of the last one, the recommended."""
    methods = _methods(rooms)
    best = methods[-1]
    rest = {
        "precision": ("precision", "{:.2f}"),
        "recall": ("recall", "{:.2f}"),
        "ghosts": ("ghosts a frame", "{:.2f}"),
        "error_cm": ("error, cm", "{:.1f}"),
        "ms": ("ms a frame", "{:.0f}"),
    }
    header = [
        "recording",
        "cameras",
        "objects",
        *(f"MODA, {m}" for m in methods),
        *(title for title, _ in rest.values()),
    ]
    lines: list[list[str]] = []
    keys = ["recording", "cameras", "region"]
    for (recording, cameras, region), group in rooms.groupby(keys, sort=False):
        own = group.set_index("method")
        where = f"{cameras}" if region in ("", cameras) else f"{cameras} in {region}"
        last = own.loc[best] if best in own.index else None
        lines.append(
            [
                f"{recording}",
                where,
                f"{group['objects'].iloc[0]:.0f}",
                *(_cell(own["moda"].get(method), "{:.2f}") for method in methods),
                *(_cell(None if last is None else last[name], form) for name, (_, form) in rest.items()),
            ]
        )
    chosen = rooms[rooms["method"] == best]
    for title, moda, other in (("mean", "mean", "mean"), ("worst", "min", "max")):
        of_method = [rooms[rooms["method"] == method]["moda"].agg(moda) for method in methods]
        of_best = [chosen[n].agg(moda if n in ("precision", "recall") else other) for n in rest]
        cells = [_cell(value, form) for value, (_, form) in zip(of_best, rest.values(), strict=True)]
        lines.append([f"**{title}**", "", "", *(f"{value:.2f}" for value in of_method), *cells])
    return table_text(header, lines)


def _about_light(light: pd.DataFrame) -> str:
    """What the table of other light shows, in two sentences."""
    own = light[light["light"] != "as it is"]
    moda = _wide(own, "moda")
    good = (moda >= ENOUGH).sum()
    counts = ", ".join(f"{method} in {good[method]}" for method in _methods(light))
    left_out = int((own[own["method"] == _methods(light)[-1]]["excluded"] > 0).sum())
    return (
        f"`four_robots` again, {int(light['frames'].max())} frames, with the frames or the background changed. Of {len(moda)} cases a MODA of at least "
        f"{ENOUGH} is reached by {counts}. A camera is left out in some frame in {left_out} of them."
    )


def _in_light(light: pd.DataFrame) -> str:
    methods = _methods(light)
    header = ["light", "cameras", *(f"MODA, {m}" for m in methods), "camera frames left out"]
    lines = []
    for name in ("as it is", *LIGHTS):
        for (views,), group in light[light["light"] == name].groupby(["views"], sort=True):
            own = group.set_index("method")
            about = f"{name}: {LIGHTS[name].about}" if name in LIGHTS else name
            cells = [_cell(own["moda"].get(method), "{:.2f}") for method in methods]
            lines.append([about, f"{views}", *cells, f"{own['excluded'].max():.0f}"])
    return table_text(header, lines)


def _by_cameras(rooms: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    two = rooms["views"] == 2
    groups = [("two cameras", rooms[two]), ("three and more", rooms[~two])]
    return [(word, group) for word, group in groups if len(group)]


def _methods(table: pd.DataFrame) -> list[str]:
    """The methods of a table, the recommended one last."""
    names = list(dict.fromkeys(table["method"]))
    return sorted(names, key=lambda name: (name == "recommended", names.index(name)))


def _wide(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """A row for each case, a column for each method."""
    return table.pivot(index=["recording", "cameras", "region", "light"], columns="method", values=column)


def _cell(value: Any, form: str) -> str:
    return "" if value is None or pd.isna(value) else form.format(value)
