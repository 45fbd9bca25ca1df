"""``python -m occlib.study.rooms``: every profile on every room and every real recording at hand, and what has changed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from occlib.base.extras import pandas as pd
from occlib.base.files import write_file
from occlib.lab import REPORTED
from occlib.pipeline import PROFILES
from occlib.plotting import figure_png, overview
from occlib.recordings import LAB
from occlib.study.rooms.cases import WORDS, Case, cases_at_hand, light_cases
from occlib.study.rooms.page import write_page
from occlib.study.rooms.scoring import Method, methods_of, run_case, worst_instant
from occlib.study.rooms.tables import difference, falls, joined, load_table, save_table, summary_text
from occlib.study.sweeps import run_batches

WORST = 5
"""So many cases are drawn."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases, say what has changed against the committed table, and write that and its page anew, or check."""
    options = _parser().parse_args(arguments)
    whole = not (options.what or options.profile or options.rule or options.no_light)
    try:
        cases = cases_at_hand(options.what or WORDS[:1])
        cases += [] if options.what or options.no_light else light_cases()
        methods = methods_of(options.profile or reversed(PROFILES), options.rule)
        new = run_batches(
            cases,
            partial(run_case, methods=methods),
            options.out,
            jobs=options.jobs,
            inputs={"methods": [repr(method) for method in methods]},
        )
        old = load_table(options.docs / "rooms.csv")
        new = joined(old.head(0), new)
        print(summary_text(new))
        print("\n".join(["", *(difference(old, new) or ["as in the table that is committed"])]))
        for path in draw_worst(new, cases, methods, options.out):
            print(path)
        if whole and not options.check:
            save_table(options.docs / "rooms.csv", joined(old, new))
            print(write_page(options.docs))
    except ValueError as error:
        sys.exit(f"rooms: {error}")
    except KeyboardInterrupt as stop:
        sys.exit(f"rooms: {stop}")
    if options.check and (worse := falls(old, new)):
        sys.exit("\n".join(["rooms: worse than it may be:", *worse]))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m occlib.study.rooms", description=main.__doc__)
    what = f"{', '.join(WORDS)}, names or folders; reported, and other light, by default"
    parser.add_argument("what", nargs="*", help=what)
    parser.add_argument("--profile", nargs="+", choices=list(PROFILES), help="all by default")
    parser.add_argument(
        "--rule", nargs="+", default=[], metavar="NAME", help="fusion rules to run as well, with what helps AND"
    )
    parser.add_argument("--no-light", action="store_true", help="without four_robots in other light")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (1)")
    parser.add_argument(
        "--check", action="store_true", help="write nothing to docs; fail where MODA has fallen too far"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("runs/rooms"), metavar="DIR", help="finished cases and the worst as pictures"
    )
    docs = LAB.parents[1] / "docs"
    parser.add_argument(
        "--docs", type=Path, default=docs, metavar="DIR", help="where rooms.csv and rooms.md are; written if all is run"
    )
    return parser


def draw_worst(table: pd.DataFrame, cases: Sequence[Case], methods: Sequence[Method], out: Path) -> list[Path]:
    """Views, map and truth of the worst cases of the last method, each in its worst frame, as one picture each.

    They may show people and stay in ``runs/``. Reported rooms are left out: who has seen them would tune on them.
    """
    method, reported = methods[-1], {f"room_{seed}" for seed in REPORTED}
    rows = table[(table["method"] == method.name) & (table["light"] == "") & ~table["recording"].isin(reported)]
    rows = rows.sort_values("moda", kind="stable").drop_duplicates(["recording", "cameras"])
    paths = []
    for number, (_, row) in enumerate(rows.head(WORST).iterrows(), 1):
        (case,) = (c for c in cases if (c.name, "+".join(c.cameras), c.light) == (row["recording"], row["cameras"], ""))
        recording, images, result, truth = worst_instant(case, method, int(row["worst_frame"]))
        title = f"{case.key}, frame {row['worst_frame']}, {method.name}: MODA {row['moda']:.2f}"
        drawn = overview(recording.rig, images, result, title=title, truth=truth)
        paths.append(write_file(out / f"worst_{number}.png", figure_png(drawn, dpi=80)))
    return paths


if __name__ == "__main__":
    main()
