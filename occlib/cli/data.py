"""``occlib data``: public recordings fetched, and those that ship verified."""

from __future__ import annotations

import argparse

from occlib.cli.options import Commands, add_command, one_of


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "data", "Fetch public recordings, with checksums.", data)
    p.add_argument(
        "action", choices=["fetch", "list", "verify"], help="verify: the checksums of data/lab and data/rooms"
    )
    names = p.add_argument("names", nargs="*", metavar="NAME", help="a public recording")

    def complete() -> None:
        from occlib.recordings import public_recordings

        names.help = one_of(public_recordings())

    p.complete_help(complete)


def data(args: argparse.Namespace) -> int:
    """Print what there is, where it was fetched to, or what does not agree."""
    from occlib import recordings

    if args.action == "verify":
        from occlib.lab import verify_manifest

        folders = recordings.LAB, recordings.ROOMS
        problems = [f"data/{folder.name}/{problem}" for folder in folders for problem in verify_manifest(folder)]
        print("\n".join(problems) or "data/lab and data/rooms agree with their manifests")
        return 1 if problems else 0
    if args.action == "list":
        print("\n".join(f"{name}: {source['about']}" for name, source in recordings.public_recordings().items()))
        return 0
    if not args.names:
        raise ValueError(f"data fetch: expected a name, one of {', '.join(recordings.public_recordings())}")
    for name in args.names:
        print(recordings.fetch(name, progress=True))
    return 0
