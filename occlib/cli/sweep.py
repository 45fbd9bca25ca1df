"""``occlib sweep``: the measures compared under every condition."""

from __future__ import annotations

import argparse

from occlib.cli.options import Commands, add_command, one_of


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(
        commands,
        "sweep",
        "Compare the template matching measures under every condition; goes on where it was stopped. In full it takes "
        "about seven minutes on two cores.",
        sweep,
    )
    p.add_argument(
        "--out",
        default="runs/sweep",
        metavar="DIR",
        help="where the results go, finished batches are kept (runs/sweep)",
    )
    p.add_argument(
        "--seeds", metavar="START:STOP", help="draws of the targets, as in 0:8 or 5; by default 0:12, with --fast 0:2"
    )
    p.add_argument("--sides", nargs="+", type=int, metavar="PX", help="template sides, 16 to 128; by default 24 48 96")
    conditions = p.add_argument("--conditions", nargs="+", metavar="NAME", help="all by default")
    p.add_argument("--sources", nargs="+", metavar="NAME", help="pictures and recordings; by default those that ship")
    methods = p.add_argument("--methods", nargs="+", metavar="NAME", help="all by default")
    p.add_argument(
        "--matchers",
        metavar="FILE.py",
        help="a file that registers matchers of your own with @matching.matcher; what it imports is not watched for changes",
    )
    p.add_argument("--jobs", type=int, default=1, metavar="N", help="processes; the results do not depend on it")
    p.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="use the workers of this Dask scheduler instead")
    p.add_argument("--fast", action="store_true", help="one template size, three sources, two seeds, few levels")

    def complete() -> None:
        from occlib.matching import METHODS
        from occlib.study import CONDITIONS

        conditions.help = f"{one_of(CONDITIONS)}; all by default"
        methods.help = f"{one_of(METHODS)}; all by default"

    p.complete_help(complete)


def sweep(args: argparse.Namespace) -> int:
    """Run what is missing of the study, write its tables and charts, print the verdicts."""
    from occlib import study

    done = study.sweep(
        args.out,
        "fast" if args.fast else "full",
        seeds=_seeds(args.seeds),
        sides=args.sides,
        conditions=args.conditions,
        sources=args.sources,
        methods=args.methods,
        matchers=args.matchers or None,
        jobs=args.jobs,
        scheduler=args.scheduler,
    )
    for condition, statement in done.verdicts[["condition", "statement"]].itertuples(index=False):
        print(f"{condition:>18}  {statement}")
    trials, *others = done.files
    print(f"{args.out}: {trials} ({len(done.trials)} rows), {', '.join(others)}")
    return 0


def _seeds(text: str | None) -> range | None:
    if text is None:
        return None
    start, _, stop = text.partition(":")
    digits = all(part.isascii() and part.isdigit() and len(part) < 10 for part in (start, stop or "0"))
    seeds = range(int(start), int(stop) if ":" in text and stop else int(start) + 1) if digits else range(0)
    if not 0 < len(seeds) <= 10_000 or text.endswith(":"):
        raise ValueError(f"--seeds: expected START:STOP, as in 0:8, or one number, got {text[:40]!r}")
    return seeds
