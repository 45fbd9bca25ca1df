"""``occlib calibrate``: a camera's lens from pictures of a checkerboard."""

from __future__ import annotations

import argparse

from occlib.cli.options import Commands, add_command


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "calibrate", "Calibrate a camera from pictures of a checkerboard.", calibrate)
    p.add_argument("images", nargs="+", metavar="IMAGE")
    p.add_argument("--pattern", required=True, metavar="9x6", help="inner corners, columns x rows")
    p.add_argument("--square", required=True, type=float, metavar="M", help="side of a square in m")
    p.add_argument("--out", metavar="camera.yaml", help="write the calibration here")


def calibrate(args: argparse.Namespace) -> int:
    """Print the calibration, and write it if asked to."""
    from occlib.calibration import calibrate_images, parse_pattern, save_calibration

    result = calibrate_images(args.images, parse_pattern(args.pattern), args.square, progress=True)
    (fx, _, cx), (_, fy, cy), _ = result.matrix
    print(f"{result.views_used} of {len(args.images)} pictures used, rms {result.rms_px:.3f} px")
    worst = int(result.view_rms_px.argmax())
    print(f"worst picture: {result.images_used[worst]}, rms {result.view_rms_px[worst]:.3f} px")
    print(f"fx {fx:.2f}  fy {fy:.2f}  cx {cx:.2f}  cy {cy:.2f} px")
    print("k1 {:.4f}  k2 {:.4f}  p1 {:.5f}  p2 {:.5f}  k3 {:.4f}".format(*result.distortion))
    if args.out:
        save_calibration(args.out, result)
        print(f"written to {args.out}")
    return 0
