"""``occlib render``: a scene rendered to a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from occlib.cli.options import Commands, add_command


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "render", "Render a scene to a recording with exact ground truth.", render)
    p.add_argument("scene", metavar="SCENE", help="a scene.yaml, or a name in data/lab")
    p.add_argument("--out", metavar="DIR", help="where the recording goes (default: runs/render/NAME)")
    p.add_argument("--frames", metavar="START:STOP:STEP", help="only these frames")
    p.add_argument("--spp", type=int, default=6, metavar="N", help="samples per pixel (6)")


def render(args: argparse.Namespace) -> int:
    """Render the scene and say where it is."""
    from occlib.lab import load_scene
    from occlib.lab import render as render_scene
    from occlib.recordings import parse_frames

    scene = load_scene(args.scene)
    frames = None if args.frames is None else parse_frames(args.frames, range(scene.frames))
    out = Path(args.out or Path("runs") / "render" / scene.name)
    print(render_scene(scene, out, frames=frames, spp=args.spp))
    return 0
