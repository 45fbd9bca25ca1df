"""All commands under one name: ``occlib COMMAND ...``."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import TextIO

from occlib import __version__
from occlib.cli.options import CommandParser

COMMANDS = (
    "reproduce",
    "run",
    "broadcast",
    "listen",
    "evaluate",
    "calibrate",
    "compare",
    "sweep",
    "render",
    "data",
)
"""The commands in the order of ``occlib --help``. Each is the module ``occlib.cli.NAME``, whose ``add(commands)`` adds its options."""


def build_parser() -> argparse.ArgumentParser:
    """The command line with all its sub-commands."""
    parser = argparse.ArgumentParser(prog="occlib", description="Two views in, an occlusion-free floor map out.")
    parser.add_argument("--version", action="version", version=f"occlib {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=CommandParser)
    for name in COMMANDS:
        import_module(f"occlib.cli.{name}").add(commands)
    return parser


@contextmanager
def _notices(command: str) -> Iterator[None]:
    """What is wrong with the input, though the work goes on, is said in a line on stderr, once."""
    from occlib.base.checks import Notice

    said: set[str] = set()

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int,
        file: TextIO | None = None, line: str | None = None,
    ) -> None:  # fmt: skip
        if not issubclass(category, Notice):
            others(message, category, filename, lineno, file, line)
        elif str(message) not in said:
            from tqdm import tqdm  # only now: it would make every command start later

            said.add(str(message))
            tqdm.write(f"occlib {command}: warning: {message}", file=sys.stderr)  # above the bars, if there are any

    with warnings.catch_warnings():
        others = warnings.showwarning
        warnings.showwarning = show
        warnings.simplefilter("always", Notice)
        yield


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0 on success, else a one-line error on stderr and another number."""
    args = argparse.Namespace(command="")
    try:
        args = build_parser().parse_args(arguments)
        from occlib.base.interrupts import stoppable  # after the parser, so that help is printed at once

        with stoppable(), _notices(args.command):
            status = int(args.function(args))
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader of a pipe left, as in `occlib ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (ValueError, OSError, ArithmeticError, MemoryError) as error:
        message = " ".join(str(error).split())
        print(f"occlib {args.command}: {message}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print(f"occlib {args.command}: {str(stop) or 'interrupted'}", file=sys.stderr)
        return 130
