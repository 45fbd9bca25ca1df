"""``occlib listen``: the maps of ``occlib broadcast`` received and printed."""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from contextlib import nullcontext
from typing import TYPE_CHECKING

from occlib.cli.options import ADDRESS, Commands, add_command, check_png

if TYPE_CHECKING:
    from occlib.live import Message

SILENT_S = 5.0
"""After so long without a map, s, a hint is given: a station starts in less."""


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "listen", "Receive the maps of occlib broadcast.", listen)
    p.add_argument("address", nargs="?", default=ADDRESS, metavar="tcp://HOST:PORT", help=f"where from ({ADDRESS})")
    p.add_argument("--json", action="store_true", help="print one JSON object a map")
    p.add_argument("--maps", action="store_true", help="with its cells, as in nav_msgs/OccupancyGrid")
    p.add_argument(
        "--plot", nargs="?", const="map.png", metavar="FILE.png", help="draw the newest map, at most once a second"
    )
    p.add_argument("--count", type=int, metavar="N", help="stop after so many maps")
    p.add_argument("--timeout", type=float, metavar="S", help="stop when no map comes for so long")
    p.add_argument("--keys", metavar="FILE", help="the listener's NAME.key_secret")
    p.add_argument("--server-key", metavar="FILE", help="the publisher's NAME.key")


def listen(args: argparse.Namespace) -> int:
    """Print maps as they come; 1 if fewer came than were asked for."""
    if args.plot is not None:
        check_png(args.plot, "--plot")
    if args.count is not None and args.count < 1:
        raise ValueError(f"--count: expected a number > 0, got {args.count}")
    if args.timeout is not None and not args.timeout > 0:
        raise ValueError(f"--timeout: expected seconds > 0, got {args.timeout}")
    from occlib.live import Listener, MapPicture

    hint = threading.Timer(
        SILENT_S, print, ["nothing yet: does the station run, are the keys right?"], {"file": sys.stderr}
    )
    hint.daemon = True
    listener = Listener(args.address, keys=args.keys, server_key=args.server_key, timeout_s=args.timeout)
    with listener, MapPicture(args.plot) if args.plot else nullcontext() as picture:
        try:
            print(f"listening to {args.address}", file=sys.stderr, flush=True)
            hint.start()
            for message in listener:
                hint.cancel()
                latency = 1e3 * (time.time() - message.t_capture)
                print(_as_json(message, latency, args.maps) if args.json else _as_text(message, latency), flush=True)
                if picture is not None:
                    picture.show(message)
                if listener.received == args.count:
                    break
        except KeyboardInterrupt:
            args.count = None  # how it ends
        finally:
            hint.cancel()
    print(f"{listener.received} maps received, {listener.missed} missed, {listener.rejected} rejected", file=sys.stderr)
    return 0 if args.count is None or listener.received == args.count else 1


def _as_text(message: Message, latency_ms: float) -> str:
    objects, coasting = (
        "".join(f"  {t['id']} ({t['x']:.2f}, {t['y']:.2f})" for t in some)
        for some in (message.objects, message.coasting)
    )
    unseen = f"; not seen now:{coasting}" if coasting else ""
    return f"{message.sequence:>6}  {latency_ms:7.1f} ms  {len(message.objects)} objects{objects}{unseen}"


def _as_json(message: Message, latency_ms: float, cells: bool) -> str:
    floor, (height, width) = message.floor, message.floor.shape
    counts = {
        name: int((message.data == value).sum()) for name, value in (("free", 0), ("occupied", 100), ("unknown", -1))
    }
    grid = {"width": width, "height": height, "resolution": floor.resolution, "origin": [floor.x[0], floor.y[0]]}
    return json.dumps(
        {
            **{name: getattr(message, name) for name in ("session", "sequence", "t_capture", "t_sent")},
            "latency_ms": round(latency_ms, 3),
            "map": {**grid, "counts": counts, **({"data": message.data.ravel().tolist()} if cells else {})},
            "objects": message.objects,
            **({"coasting": message.coasting} if message.coasting else {}),
        }
    )
