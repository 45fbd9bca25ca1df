"""``occlib run``: recordings turned into objects, maps and overviews."""

from __future__ import annotations

import argparse
import sys

from occlib.cli.options import Commands, add_command, one_of
from occlib.cli.settings import add_settings, settings_of


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "run", "Turn a recording into objects.jsonl, a floor map and an overview.", run)
    p.add_argument(
        "recordings", nargs="+", metavar="RECORDING",
        help="a folder with rig.yaml and frames/, or a name in data/lab; of several, each gets a folder in DIR",
    )  # fmt: skip
    p.add_argument("--out", required=True, metavar="DIR", help="where the results go")
    p.add_argument("--cameras", nargs="+", metavar="NAME", help="views to use; all of the rig by default")
    add_settings(p)
    p.add_argument("--frames", metavar="START:STOP:STEP", help="only these frames, as in 40:149:4")
    p.add_argument("--maps", action="store_true", help="a map of every frame, in DIR/maps")
    p.add_argument(
        "--templates", metavar="FOLDER", help="pictures LABEL.png of known objects, which then get that label"
    )
    mode = p.add_argument("--map-mode", default="trinary", metavar="MODE", help="of map_server")
    bag = p.add_argument("--bag", metavar="FORMAT", help="every frame's map as a bag, DIR/map")

    def complete() -> None:
        from occlib.live import BAG_FORMATS
        from occlib.mapping import MODES

        mode.help = f"of map_server: {one_of(MODES, default='trinary')}"
        bag.help = f"every frame's map as a bag, DIR/map: {one_of(BAG_FORMATS)}"

    p.complete_help(complete)


def run(args: argparse.Namespace) -> int:
    """Run each recording; what is wrong with any of the arguments is found out before the work."""
    from occlib.identification import read_templates
    from occlib.live import check_bag_format
    from occlib.mapping import MODES
    from occlib.recordings import open_recording, parse_frames
    from occlib.running import output_folders, run_recording

    if args.map_mode not in MODES:
        raise ValueError(f"--map-mode: expected one of {', '.join(MODES)}, got {args.map_mode!r}")
    if args.bag is not None:
        check_bag_format(args.bag, name="--bag")
    recordings = [open_recording(recording, args.cameras) for recording in args.recordings]
    folders = output_folders(recordings, args.out)
    frames = [None if args.frames is None else parse_frames(args.frames, each.frames) for each in recordings]
    settings = settings_of(args)
    templates = None if args.templates is None else read_templates(args.templates)
    for recording, folder, chosen in zip(recordings, folders, frames, strict=True):
        if recording.without_background:
            print(
                f"no background/ for {', '.join(recording.without_background)}: learned from the frames; what never moves is not found"
            )
        summary = run_recording(
            recording,
            folder,
            settings=settings,
            frames=chosen,
            templates=templates,
            maps=args.maps,
            map_mode=args.map_mode,
            bag=args.bag,
            note=f"profile {args.profile}",
            progress=True,
        )
        print(summary, flush=True)
        whose = "" if len(recordings) == 1 else f"{folder.name}: "
        for warning in summary.warnings():
            print(f"occlib run: warning: {whose}{warning}", file=sys.stderr)
    return 0
