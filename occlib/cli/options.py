"""What several commands share: how a command is added, and options that look alike in each."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

ADDRESS = "tcp://127.0.0.1:5599"
"""Where ``broadcast`` publishes and ``listen`` listens unless told otherwise."""


class CommandParser(argparse.ArgumentParser):
    """The options of one command."""

    _late_help: tuple[Callable[[], object], ...] = ()

    def complete_help(self, complete: Callable[[], object]) -> None:
        """Call ``complete`` before help is printed, to write into the options' help what is slow to import.

        The names of all rules, for instance. Where it needs an extra that is not installed, help does without.
        """
        self._late_help = (*self._late_help, complete)

    def format_help(self) -> str:
        """The text of ``--help``."""
        for complete in self._late_help:
            with suppress(ImportError):
                complete()
        return super().format_help()


Commands: TypeAlias = "argparse._SubParsersAction[CommandParser]"


def add_command(
    commands: Commands, name: str, help_text: str, function: Callable[[argparse.Namespace], int]
) -> CommandParser:
    """A new command: ``function`` gets its arguments and returns the exit code."""
    command = commands.add_parser(name, help=help_text, description=help_text)
    command.set_defaults(function=function)
    return command


def one_of(names: Iterable[str], default: str | None = None) -> str:
    """Names as help texts list them.

    >>> one_of(["recommended", "and", "paper"], default="and")
    'recommended, and (default), paper'
    """
    return ", ".join(f"{name} (default)" if name == default else name for name in names)


def threshold(text: str) -> str | float:
    """A threshold by its name, or a number.

    >>> threshold("otsu"), threshold("1e2")
    ('otsu', 100.0)
    """
    try:
        return float(text)
    except ValueError:
        return text


def check_png(path: str, option: str) -> None:
    """``ValueError`` unless the file's name ends in ``.png``."""
    if Path(path).suffix.lower() != ".png":
        raise ValueError(f"{option}: expected a file name that ends in .png, got {path}")
