"""``occlib reproduce``: the notebooks run, their figures and metrics published or checked."""

from __future__ import annotations

import argparse

from occlib.cli.options import Commands, add_command


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "reproduce", "Run the notebooks; write every figure and metric to figures/.", reproduce)
    p.add_argument("notebooks", nargs="*", metavar="NOTEBOOK", help="number, name or path; all by default")
    p.add_argument("-p", "--parameter", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"),
                   help="override a parameter of the notebooks (results stay in runs/)")  # fmt: skip
    p.add_argument("--fast", action="store_true", help="smaller experiments (results stay in runs/)")
    p.add_argument("--jobs", type=int, default=1, metavar="N", help="notebooks at the same time")
    p.add_argument("--force", action="store_true", help="run also what did not change since the last run")
    p.add_argument("--check", action="store_true", help="compare with the committed metrics, publish nothing")


def reproduce(args: argparse.Namespace) -> int:
    """Run the notebooks; 1 if one of them failed or disagrees."""
    from occlib.reproduce import reproduce as run_notebooks

    report = run_notebooks(
        args.notebooks or None,
        parameters=dict(args.parameter),
        fast=args.fast,
        jobs=args.jobs,
        force=args.force,
        check=args.check,
    )
    print(report)
    return 1 if report.problems else 0
