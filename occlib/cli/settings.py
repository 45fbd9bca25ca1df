"""From ``--profile``, ``--rule`` and ``--threshold`` to settings of the chain, for every command that runs it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from occlib.cli.options import CommandParser, one_of, threshold

if TYPE_CHECKING:
    from occlib.pipeline import Settings


def add_settings(command: CommandParser) -> None:
    """Add the options that :func:`settings_of` reads."""
    profile = command.add_argument("--profile", default="recommended", metavar="NAME", help="settings by their name")
    rule = command.add_argument("--rule", metavar="NAME", help="how views are joined")
    level = command.add_argument("--threshold", type=threshold, metavar="T", help="by name, or grey levels")

    def complete() -> None:
        from occlib.foreground import THRESHOLDS
        from occlib.occlusion import RULES
        from occlib.pipeline import PROFILES

        profile.help = one_of(PROFILES, default="recommended")
        rule.help = f"how views are joined: {one_of([*(name for name in RULES if name != 'planes'), 'explain'])}"
        level.help = f"{one_of(['evidence', *THRESHOLDS, 'noise'])} or grey levels"

    command.complete_help(complete)


def settings_of(args: argparse.Namespace) -> Settings:
    """The profile's settings, with what was given beside it."""
    from occlib.pipeline import settings_for

    return settings_for(args.profile, rule=args.rule, threshold=args.threshold)
