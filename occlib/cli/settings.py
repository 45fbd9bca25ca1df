"""From ``--profile``, ``--rule``, ``--threshold`` and ``--set`` to settings of the chain, for every command that runs it."""

from __future__ import annotations

import argparse
import textwrap
from typing import TYPE_CHECKING, Any

from occlib.cli.options import CommandParser, one_of, threshold

if TYPE_CHECKING:
    from occlib.pipeline import Settings


def add_settings(command: CommandParser) -> None:
    """Add the options that :func:`settings_of` reads."""
    profile = command.add_argument("--profile", default="recommended", metavar="NAME", help="settings by their name")
    rule = command.add_argument("--rule", metavar="NAME", help="how views are joined")
    level = command.add_argument("--threshold", type=threshold, metavar="T", help="by name, or grey levels")

    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="one setting of a stage, such as finder.cost=0.2",
    )
    command.add_argument(
        "--help-settings",
        action=_ListSettings,
        nargs=0,
        help="list all that --set can change, after --profile and --rule",
    )

    def complete() -> None:
        from occlib.finding import region_rules
        from occlib.foreground import THRESHOLDS
        from occlib.pipeline import PROFILES

        profile.help = one_of(PROFILES, default="recommended")
        rule.help = f"how views are joined: {one_of([*region_rules(), 'explain'])}"
        level.help = f"{one_of(['evidence', *THRESHOLDS, 'noise'])} or grey levels"

    command.complete_help(complete)


def settings_of(args: argparse.Namespace) -> Settings:
    """The profile's settings, with what was given beside it."""
    from occlib.pipeline import settings_for

    changes = dict(_name_and_value(text) for text in args.set)
    return settings_for(args.profile, rule=args.rule, threshold=args.threshold, **changes)


def _name_and_value(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value) or name in ("profile", "rule", "threshold"):
        raise ValueError(f"--set: expected NAME=VALUE, as in finder.cost=0.2, got {text!r}")
    return name, value


class _ListSettings(argparse.Action):
    """Print every setting of the profile, its value and what it means, and leave."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, *_: object) -> None:
        from occlib.settings import list_settings, setting_meanings

        try:
            settings = settings_of(namespace)
        except ValueError as error:
            parser.error(str(error))
        meanings = setting_meanings(settings)
        print(f"profile {namespace.profile}; change with --set NAME=VALUE")
        for name, value in list_settings(settings).items():
            shown = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
            print(f"\n{name}={shown}")
            print(textwrap.fill(meanings[name], 88, initial_indent="    ", subsequent_indent="    "))
        parser.exit()
