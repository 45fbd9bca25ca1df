"""``occlib broadcast``: the maps of a recording or of live cameras published; and keys made."""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from typing import TYPE_CHECKING

from occlib.cli.options import ADDRESS, Commands, add_command
from occlib.cli.settings import add_settings, settings_of

if TYPE_CHECKING:
    from occlib.live import Feed


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(
        commands, "broadcast", "Publish the map of a recording, or of live cameras, as it is made.", broadcast
    )
    p.epilog = (
        "Beyond this machine keys are needed: `occlib broadcast keygen NAME` makes NAME.key, public, and NAME.key_secret, for the "
        "publisher and for each listener. A recording that is called keygen is ./keygen."
    )
    p.add_argument("recording", nargs="?", metavar="RECORDING", help="a folder, or a name in data/lab; or: keygen")
    p.add_argument("name", nargs="?", metavar="NAME", help="keygen: whose keys")
    p.add_argument("--out", metavar="DIR", help="keygen: where the keys go (here)")
    p.add_argument(
        "--device", nargs="+", metavar="N", help="live cameras, by number, or videos; in the order of the rig"
    )
    p.add_argument("--rig", metavar="rig.yaml", help="of the live cameras")
    p.add_argument(
        "--background", metavar="DIR", help="pictures of the empty floor, DIR/CAMERA/*.png, of the live cameras"
    )
    p.add_argument(
        "--tolerance", type=float, default=0.05, metavar="S", help="pictures of an instant are closer (0.05 s)"
    )
    p.add_argument("--cameras", nargs="+", metavar="NAME", help="views to use; all of the rig by default")
    add_settings(p)
    p.add_argument("--rate", type=float, metavar="HZ", help="instead of the recording's rate; 0: as fast as possible")
    p.add_argument("--loop", action="store_true", help="play the recording again and again")
    p.add_argument("--address", default=ADDRESS, metavar="tcp://HOST:PORT", help=f"where ({ADDRESS}); port *: any")
    p.add_argument("--keys", metavar="FILE", help="the publisher's NAME.key_secret")
    p.add_argument("--allow", metavar="DIR", help="the listeners' public keys, DIR/*.key, read at the start")
    p.add_argument("--ros2", nargs="?", const=0, type=int, metavar="DOMAIN",
                   help="also as the ROS 2 topic /map, open to all in that domain (0)")  # fmt: skip


def broadcast(args: argparse.Namespace) -> int:
    """Publish until there are no more frames, or Ctrl-C; then say what was published."""
    from occlib.live import MapTopic, Publisher, publish_maps

    if args.recording == "keygen":
        return _keygen(args)
    if args.name is not None or args.out is not None or (args.recording is None) == (args.device is None):
        raise ValueError("expected either a recording, or --device with --rig and --background, or keygen NAME")
    settings = settings_of(args)
    with (
        (_live if args.device else _recorded)(args) as feed,
        Publisher(args.address, keys=args.keys, allowed=args.allow) as publisher,
        nullcontext() if args.ros2 is None else MapTopic(args.ros2) as topic,
    ):
        print(f"publishing at {publisher.address}", file=sys.stderr, flush=True)
        published = publish_maps(feed, settings, publisher, topic, progress=True)
    for name, reason in published.ended.items():
        print(f"occlib broadcast: warning: {name}: {reason}", file=sys.stderr)
    for (name, reason), count in published.excluded.items():
        print(f"occlib broadcast: warning: {name}: {reason} in {count} maps, left out", file=sys.stderr)
    lost = ", ".join(f"{count} of {name}" for name, count in published.dropped.items())
    skew = f", skew at most {1e3 * published.skew_s:.1f} ms" if args.device else ""
    print(f"{published.maps} maps published; frames dropped: {lost}{skew}")
    return 0


def _keygen(args: argparse.Namespace) -> int:
    from occlib.live import keygen

    if args.name is None:
        raise ValueError("keygen: expected a name, as in: occlib broadcast keygen robot1")
    print("{}: to be given away\n{}: secret".format(*keygen(args.out or ".", args.name)))
    return 0


def _recorded(args: argparse.Namespace) -> Feed:
    from occlib.live import recorded_feed
    from occlib.recordings import open_recording

    return recorded_feed(open_recording(args.recording, args.cameras), rate=args.rate, loop=args.loop, progress=True)


def _live(args: argparse.Namespace) -> Feed:
    from occlib.geometry import Rig
    from occlib.live import live_feed
    from occlib.recordings import empty_floor_images

    if args.rig is None or args.background is None or args.rate is not None or args.loop:
        raise ValueError("--device: expected --rig and --background with it, and neither --rate nor --loop")
    rig = Rig.load(args.rig).select(args.cameras)
    if len(args.device) != len(rig.cameras):
        raise ValueError(f"--device: expected one for each of {', '.join(rig.cameras)}, got {len(args.device)}")
    pictures = empty_floor_images(args.background, rig)
    if missing := [name for name in rig.cameras if name not in pictures]:
        raise ValueError(f"--background: {args.background} has no pictures of {', '.join(missing)}")
    return live_feed(rig, dict(zip(rig.cameras, args.device, strict=True)), pictures, tolerance_s=args.tolerance)
