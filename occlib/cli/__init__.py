"""The command line: one small module a command, which parses, calls the library and prints."""
# fmt: off

from occlib.cli.commands import build_parser, main

__all__ = ["build_parser", "main"]
