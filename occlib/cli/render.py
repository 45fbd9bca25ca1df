"""``occlib render``: a scene rendered to a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from occlib.cli.options import Commands, add_command


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "render", "Render a scene to a recording with exact ground truth.", render)
    p.add_argument("scene", metavar="SCENE", nargs="?", help="a scene.yaml, or a name in data/lab")
    p.add_argument(
        "--random", type=int, metavar="SEED", help="in place of SCENE: a random room, always the same for a seed"
    )
    p.add_argument("--cameras", type=int, metavar="N", help="of the random room: 2 to 6 (default: at random)")
    p.add_argument("--objects", type=int, metavar="N", help="of the random room: 1 to 8 (default: 3 to 5 at random)")
    p.add_argument("--out", metavar="DIR", help="where the recording goes (default: runs/render/NAME)")
    p.add_argument("--frames", metavar="START:STOP:STEP", help="only these frames")
    p.add_argument("--spp", type=int, default=6, metavar="N", help="samples per pixel (6)")


def render(args: argparse.Namespace) -> int:
    """Render the scene and say where it is."""
    from occlib.lab import load_scene, random_scene
    from occlib.lab import render as render_scene
    from occlib.recordings import parse_frames

    if (args.scene is None) == (args.random is None):
        raise ValueError("render: expected either SCENE or --random SEED")
    if args.random is None and (args.cameras, args.objects) != (None, None):
        raise ValueError("--cameras, --objects: expected only with --random SEED")
    if args.random is None:
        scene = load_scene(args.scene)
    else:
        scene = random_scene(args.random, cameras=args.cameras, objects=args.objects)
    frames = None if args.frames is None else parse_frames(args.frames, range(scene.frames))
    out = Path(args.out or Path("runs") / "render" / scene.name)
    print(render_scene(scene, out, frames=frames, spp=args.spp))
    return 0
