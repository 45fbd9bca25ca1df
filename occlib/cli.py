"""The roof: ``occlib reproduce | run | broadcast | listen | evaluate | compare | sweep | calibrate | render | data``."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from occlib import __version__

ADDRESS = "tcp://127.0.0.1:5599"


def build_parser() -> argparse.ArgumentParser:
    """The command line with all its sub-commands."""
    parser = argparse.ArgumentParser(prog="occlib", description="Two views in, an occlusion-free floor map out.")
    parser.add_argument("--version", action="version", version=f"occlib {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, help_text: str, function: Any) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=help_text, description=help_text)
        command.set_defaults(function=function)
        return command

    p = add("reproduce", "Run the notebooks; write every figure and metric to figures/.", reproduce)
    p.add_argument("notebooks", nargs="*", metavar="NOTEBOOK", help="number, name or path; all by default")
    p.add_argument("-p", "--parameter", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"),
                   help="override a parameter of the notebooks (results stay in runs/)")  # fmt: skip
    p.add_argument("--fast", action="store_true", help="smaller experiments (results stay in runs/)")
    p.add_argument("--jobs", type=int, default=1, metavar="N", help="notebooks at the same time")
    p.add_argument("--force", action="store_true", help="run also what did not change since the last run")
    p.add_argument("--check", action="store_true", help="compare with the committed metrics, publish nothing")

    p = add("run", "Turn a recording into objects.jsonl, a floor map and an overview.", run)
    p.add_argument("recording", metavar="RECORDING", help="a folder with rig.yaml and frames/, or a name in data/lab")
    p.add_argument("--out", required=True, metavar="DIR", help="where the results go")
    p.add_argument("--cameras", nargs="+", metavar="NAME", help="views to use; all of the rig by default")
    p.add_argument("--profile", default="recommended", metavar="NAME", help="recommended (default), and, or paper")
    p.add_argument("--rule", metavar="NAME", help="how views are joined: and, or, most, product, log-odds, explain")
    p.add_argument("--threshold", metavar="T", help="evidence, otsu, half-otsu, triangle, noise or grey levels")
    p.add_argument("--frames", metavar="START:STOP:STEP", help="only these frames, as in 40:149:4")
    p.add_argument("--maps", action="store_true", help="a map of every frame, in DIR/maps")
    p.add_argument(
        "--templates", metavar="FOLDER", help="pictures LABEL.png of known objects, which then get that label"
    )
    p.add_argument(
        "--map-mode", default="trinary", metavar="MODE", help="of map_server: trinary (default), scale or raw"
    )
    p.add_argument("--bag", metavar="FORMAT", help="every frame's map as a bag, DIR/map: mcap, ros2 or ros1")

    p = add("broadcast", "Publish the map of a recording, or of live cameras, as it is made.", broadcast)
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
    p.add_argument("--profile", default="recommended", metavar="NAME", help="recommended (default), and, or paper")
    p.add_argument("--rule", metavar="NAME", help="as in occlib run")
    p.add_argument("--threshold", metavar="T", help="as in occlib run")
    p.add_argument("--rate", type=float, metavar="HZ", help="instead of the recording's rate; 0: as fast as possible")
    p.add_argument("--loop", action="store_true", help="play the recording again and again")
    p.add_argument("--address", default=ADDRESS, metavar="tcp://HOST:PORT", help=f"where ({ADDRESS}); port *: any")
    p.add_argument("--keys", metavar="FILE", help="the publisher's NAME.key_secret")
    p.add_argument("--allow", metavar="DIR", help="the listeners' public keys, DIR/*.key, read at the start")
    p.add_argument("--ros2", nargs="?", const=0, type=int, metavar="DOMAIN",
                   help="also as the ROS 2 topic /map, open to all in that domain (0)")  # fmt: skip

    p = add("listen", "Receive the maps of occlib broadcast.", listen)
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

    p = add("evaluate", "Score objects.jsonl against truth.json.", evaluate)
    p.add_argument("objects", metavar="OBJECTS.jsonl")
    p.add_argument("truth", metavar="TRUTH.json")
    p.add_argument("--roi", metavar="NAME", help="count only inside this region of the truth file")
    p.add_argument("--radius", type=float, default=0.5, metavar="M", help="matches are closer than this (0.5 m)")
    p.add_argument("--json", action="store_true", help="print one JSON object")

    p = add("calibrate", "Calibrate a camera from pictures of a checkerboard.", calibrate)
    p.add_argument("images", nargs="+", metavar="IMAGE")
    p.add_argument("--pattern", required=True, metavar="9x6", help="inner corners, columns x rows")
    p.add_argument("--square", required=True, type=float, metavar="M", help="side of a square in m")
    p.add_argument("--out", metavar="camera.yaml", help="write the calibration here")

    p = add("compare", "Look for a template in an image with each measure: a table, and a picture.", compare)
    p.epilog = "x, y: the template's top-left px at the best place. 0 is best for ssd, sad, sed; 1 for ncc, zncc."
    p.add_argument("image", metavar="IMAGE", help="read as 8 bit")
    p.add_argument("template", metavar="TEMPLATE", help="a picture no larger than the image")
    p.add_argument("--methods", nargs="+", metavar="NAME", help="ssd, sad, ncc, zncc, sed; all by default")
    p.add_argument("--matchers", metavar="FILE.py", help="a file that registers matchers of your own")
    p.add_argument("--threshold", metavar="T", help="otsu, mad or a score; by default what suits the template")
    p.add_argument("--mask", metavar="IMAGE", help="weights of the template's pixels, black: not counted")
    p.add_argument("--rule", default="components", metavar="NAME", help="components (default) or nms")
    p.add_argument("--colour", action="store_true", help="compare in colour; grey by default")
    p.add_argument("--out", default="compare.png", metavar="FILE.png", help="the picture (compare.png)")
    p.add_argument("--json", action="store_true", help="print one JSON object instead of the table")

    p = add(
        "sweep",
        "Compare the template matching measures under every condition; goes on where it was stopped. In full it takes "
        "about seven minutes on two cores.",
        sweep,
    )
    p.add_argument(
        "--out",
        default="runs/sweep",
        metavar="DIR",
        help="where the results go, finished batches are kept (runs/sweep)",
    )
    p.add_argument(
        "--seeds", metavar="START:STOP", help="draws of the targets, as in 0:8 or 5; by default 0:12, with --fast 0:2"
    )
    p.add_argument("--sides", nargs="+", type=int, metavar="PX", help="template sides, 16 to 128; by default 24 48 96")
    p.add_argument("--conditions", nargs="+", metavar="NAME", help="gain, noise, rotation, ...; all by default")
    p.add_argument("--sources", nargs="+", metavar="NAME", help="pictures and recordings; by default those that ship")
    p.add_argument("--methods", nargs="+", metavar="NAME", help="ssd, sad, ncc, ...; all by default")
    p.add_argument(
        "--matchers",
        metavar="FILE.py",
        help="a file that registers matchers of your own with @matching.matcher; what it imports is not watched for changes",
    )
    p.add_argument("--jobs", type=int, default=1, metavar="N", help="processes; the results do not depend on it")
    p.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="use the workers of this Dask scheduler instead")
    p.add_argument("--fast", action="store_true", help="one template size, three sources, two seeds, few levels")

    p = add("render", "Render a scene to a recording with exact ground truth.", render)
    p.add_argument("scene", metavar="SCENE", help="a scene.yaml, or a name in data/lab")
    p.add_argument("--out", metavar="DIR", help="where the recording goes (default: runs/render/NAME)")
    p.add_argument("--frames", metavar="START:STOP:STEP", help="only these frames")
    p.add_argument("--spp", type=int, default=6, metavar="N", help="samples per pixel (6)")

    p = add("data", "Fetch public recordings, with checksums.", data)
    p.add_argument("action", choices=["fetch", "list", "verify"], help="verify: the checksums of data/lab")
    p.add_argument("names", nargs="*", metavar="NAME", help="ufes-lab, opencv-checkerboard")
    return parser


def reproduce(args: argparse.Namespace) -> int:
    from occlib.reproduce import publish

    report = publish.reproduce(
        args.notebooks or None,
        parameters=dict(args.parameter),
        fast=args.fast,
        jobs=args.jobs,
        force=args.force,
        check=args.check,
    )
    print(report)
    return 1 if report.problems else 0


def run(args: argparse.Namespace) -> int:
    from tqdm import tqdm

    from occlib.base.files import read_yaml, staged_folder, write_file
    from occlib.explaining.appearance import read_templates
    from occlib.formats import load_truth
    from occlib.live import bags
    from occlib.mapping import MODES, save_map
    from occlib.pipeline import Pipeline, backgrounds_of, settings_for
    from occlib.plotting import figure_png, overview
    from occlib.recordings import open_recording, parse_frames

    if args.map_mode not in MODES:
        raise ValueError(f"--map-mode: expected one of {', '.join(MODES)}, got {args.map_mode!r}")
    if args.bag is not None:
        bags.check_format(args.bag, name="--bag")
    recording = open_recording(args.recording, args.cameras)
    frames = list(recording.frames) if args.frames is None else parse_frames(args.frames, recording.frames)
    settings = settings_for(args.profile, rule=args.rule, threshold=_threshold(args.threshold))
    truth = recording.path / "truth.json"
    known = {int(k): things for k, things in load_truth(truth)["frames"].items()} if truth.exists() else {}
    if recording.without_background:
        print(
            f"no background/ for {', '.join(recording.without_background)}: learned from the frames; what never moves is not found"
        )
    lines, maps, out, excluded = [], [], Path(args.out), dict[tuple[str, str], list[int]]()
    with staged_folder(out) as stage:
        templates = None if args.templates is None else read_templates(args.templates)
        pipeline = Pipeline(recording.rig, backgrounds_of(recording, progress=True), settings, templates)
        for frame, images in tqdm(
            recording.images(frames), total=len(frames), unit="frame", desc=recording.path.name, disable=None
        ):
            shown = {name: images.get(name) for name in recording.rig.cameras}  # None where a camera dropped out
            result = pipeline.process(shown, recording.time(frame))
            for camera_and_reason in result.excluded.items():
                excluded.setdefault(camera_and_reason, []).append(frame)
            objects = [thing.to_dict() for thing in result.objects]
            line: dict[str, Any] = {"frame": frame, "time": round(result.time, 6), "objects": objects}
            lines.append(json.dumps({**line, "excluded": result.excluded} if result.excluded else line))
            if args.maps:
                save_map(stage / "maps" / f"{frame:06d}", result.map, mode=args.map_mode)
            if args.bag:
                maps.append((result.time, result.map))
        title = f"{recording.path.name}, frame {frames[-1]}, rule {settings.rule}, profile {args.profile}"
        picture = figure_png(overview(recording.rig, shown, result, title=title, truth=known.get(frames[-1], [])))
        written = [read_yaml(save_map(stage / "map", result.map, mode=args.map_mode))["image"], "map.yaml"]
        if args.bag:
            written.append(bags.save_bag(stage / "map", maps, format=args.bag).name)
        write_file(stage / "overview.png", picture)
        write_file(stage / "objects.jsonl", "\n".join(lines) + "\n")
    print(f"{out}: objects.jsonl ({len(lines)} frames), {', '.join(written)}, overview.png")
    for (name, reason), left_out in sorted(excluded.items(), key=lambda item: item[1][0]):
        print(f"occlib run: warning: {name}: {reason} in {_spans(left_out, frames)}, left out", file=sys.stderr)
    return 0


def _spans(some: Sequence[int], frames: Sequence[int], *, most: int = 6) -> str:
    """Frames as ranges, of those that were run: "frames 4, 8 to 20 and 32"; one line, however many there are."""
    if len(some) == len(frames):
        return "all frames"
    place = {frame: i for i, frame in enumerate(frames)}
    runs: list[list[int]] = []
    for frame in some:
        if runs and place[frame] == place[runs[-1][-1]] + 1:
            runs[-1].append(frame)
        else:
            runs.append([frame])
    parts = [f"{r[0]} to {r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs[:most]]
    if len(runs) > most:
        parts[-1:] = [f"{sum(map(len, runs[most - 1 :]))} more up to {some[-1]}"]
    text = " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
    return f"frame{'s' if len(some) > 1 else ''} {text}"


def _threshold(text: str | None) -> str | float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def broadcast(args: argparse.Namespace) -> int:
    from collections import Counter
    from contextlib import ExitStack

    from tqdm import tqdm

    from occlib.live.broadcast import Publisher, keygen
    from occlib.live.topic import MapTopic
    from occlib.pipeline import Pipeline, settings_for

    if args.recording == "keygen":
        if args.name is None:
            raise ValueError("keygen: expected a name, as in: occlib broadcast keygen robot1")
        print("{}: to be given away\n{}: secret".format(*keygen(args.out or ".", args.name)))
        return 0
    if args.name is not None or args.out is not None or (args.recording is None) == (args.device is None):
        raise ValueError("expected either a recording, or --device with --rig and --background, or keygen NAME")
    settings = settings_for(args.profile, rule=args.rule, threshold=_threshold(args.threshold))
    published, worst, excluded = 0, 0.0, Counter[tuple[str, str]]()
    with ExitStack() as stack:
        rig, backgrounds, instants, total = (_live if args.device else _played)(args, stack)
        pipeline = Pipeline(rig, backgrounds, settings)
        publisher = stack.enter_context(Publisher(args.address, keys=args.keys, allowed=args.allow))
        topic = None if args.ros2 is None else stack.enter_context(MapTopic(args.ros2))
        try:
            print(f"publishing at {publisher.address}", file=sys.stderr, flush=True)
            for pair in instants:  # what is compiled, or loaded, at first use is not to delay the first maps
                Pipeline(rig, backgrounds, settings).process(pair.images, pair.time)
                break
            for pair in tqdm(instants, total=total, unit="frame", disable=None):
                result = pipeline.process(pair.images, pair.time)
                objects = [thing.to_dict() for thing in result.objects]
                publisher.send(result.map.data, rig.floor, objects, pair.epoch())
                if topic is not None:
                    topic.send(result.map, pair.epoch())
                excluded.update(result.excluded.items())
                published += 1
                worst = max(worst, pair.skew_s)
        except KeyboardInterrupt:
            pass  # how it ends: live cameras have no last frame
        dropped = instants.dropped
        for name, reason in getattr(instants, "ended", {}).items():
            print(f"occlib broadcast: warning: {name}: {reason}", file=sys.stderr)
    for (name, reason), count in excluded.items():
        print(f"occlib broadcast: warning: {name}: {reason} in {count} maps, left out", file=sys.stderr)
    lost = ", ".join(f"{count} of {name}" for name, count in dropped.items())
    skew = f", skew at most {1e3 * worst:.1f} ms" if args.device else ""
    print(f"{published} maps published; frames dropped: {lost}{skew}")
    return 0


def _played(args: argparse.Namespace, stack: Any) -> tuple[Any, ...]:
    """Rig, backgrounds, instants and their number, of a recording."""
    from occlib.live.capture import Player
    from occlib.pipeline import backgrounds_of
    from occlib.recordings import open_recording

    recording = open_recording(args.recording, args.cameras)
    player = Player(recording, rate=args.rate, loop=args.loop)
    return recording.rig, backgrounds_of(recording, progress=True), player, None if args.loop else len(recording.frames)


def _live(args: argparse.Namespace, stack: Any) -> tuple[Any, ...]:
    """The same of live cameras, which are closed by the stack."""
    from contextlib import ExitStack

    from occlib.foreground.background import average_background
    from occlib.geometry import Rig
    from occlib.live.capture import Capture, Device
    from occlib.recordings import empty_floor_images

    if args.rig is None or args.background is None or args.rate is not None or args.loop:
        raise ValueError("--device: expected --rig and --background with it, and neither --rate nor --loop")
    rig = Rig.load(args.rig).select(args.cameras)
    if len(args.device) != len(rig.cameras):
        raise ValueError(f"--device: expected one for each of {', '.join(rig.cameras)}, got {len(args.device)}")
    pictures = empty_floor_images(args.background, rig)
    if missing := [name for name in rig.cameras if name not in pictures]:
        raise ValueError(f"--background: {args.background} has no pictures of {', '.join(missing)}")
    devices = {}
    with ExitStack() as opening:
        for (name, camera), device in zip(rig.cameras.items(), args.device, strict=True):
            devices[name] = Device(device, size=camera.size)
            opening.callback(devices[name].release)
        capture = stack.enter_context(Capture(devices, tolerance_s=args.tolerance))
        opening.pop_all()  # from here on it is the capture that closes them, unless one hangs
    return rig, {name: average_background(images) for name, images in pictures.items()}, capture, None


def listen(args: argparse.Namespace) -> int:
    import threading
    import time
    from concurrent.futures import ThreadPoolExecutor

    from occlib.live.broadcast import Listener

    if args.plot is not None and Path(args.plot).suffix.lower() != ".png":
        raise ValueError(f"--plot: expected a file name that ends in .png, got {args.plot}")
    if args.count is not None and args.count < 1:
        raise ValueError(f"--count: expected a number > 0, got {args.count}")
    if args.timeout is not None and not args.timeout > 0:
        raise ValueError(f"--timeout: expected seconds > 0, got {args.timeout}")
    if args.plot:
        import occlib.plotting  # noqa: F401  slow, and maps must not wait for it
    drawn, message, drawing = -1.0, None, None
    options = {"keys": args.keys, "server_key": args.server_key, "timeout_s": args.timeout}
    hint = threading.Timer(5.0, print, ["nothing yet: does the station run, are the keys right?"], {"file": sys.stderr})
    hint.daemon = True
    with Listener(args.address, **options) as listener, ThreadPoolExecutor(1) as beside:
        try:
            print(f"listening to {args.address}", file=sys.stderr, flush=True)
            hint.start()
            for message in listener:
                hint.cancel()
                latency = 1e3 * (time.time() - message.t_capture)
                print(_as_json(message, latency, args.maps) if args.json else _as_text(message, latency), flush=True)
                if args.plot and time.monotonic() >= drawn + 1 and (drawing is None or drawing.done()):
                    if drawing is not None:
                        drawing.result()  # the file may have failed
                    drawing, drawn = beside.submit(_draw, message, args.plot), time.monotonic()
                if listener.received == args.count:
                    break
        except KeyboardInterrupt:
            args.count = None  # how it ends
        finally:
            hint.cancel()
    if args.plot and message:
        _draw(message, args.plot)
    print(f"{listener.received} maps received, {listener.missed} missed, {listener.rejected} rejected", file=sys.stderr)
    return 0 if args.count is None or listener.received == args.count else 1


def _as_text(message: Any, latency_ms: float) -> str:
    things = "".join(f"  {t['id']} ({t['x']:.2f}, {t['y']:.2f})" for t in message.objects)
    return f"{message.sequence:>6}  {latency_ms:7.1f} ms  {len(message.objects)} objects{things}"


def _as_json(message: Any, latency_ms: float, cells: bool) -> str:
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
        }
    )


def _draw(message: Any, path: str) -> None:
    from occlib.base.files import write_file
    from occlib.mapping import OccupancyMap
    from occlib.plotting import figure_png, new_figure, show_map
    from occlib.tracking import ObjectVector

    things = [
        ObjectVector(t["id"], (t["x"], t["y"]), (t["vx"], t["vy"]), t["area"], tuple(t["colour"]))
        for t in message.objects
    ]
    fig, ax = new_figure(width=6.0, height=5.0)
    show_map(ax, OccupancyMap(message.data, message.floor), things, title=f"map {message.sequence}")
    write_file(path, figure_png(fig))


def evaluate(args: argparse.Namespace) -> int:
    from occlib.formats import load_objects, load_truth
    from occlib.metrics import evaluate as score_objects
    from occlib.metrics import evaluate_hidden

    objects, truth = load_objects(args.objects), load_truth(args.truth)
    hidden = evaluate_hidden(objects, truth, roi=args.roi, radius=args.radius)
    scores = {
        **score_objects(objects, truth, roi=args.roi, radius=args.radius).to_dict(),
        "hidden_precision": hidden.precision,
        "hidden_recall": hidden.recall,
    }
    if args.json:
        print(json.dumps(scores))
    else:
        for name, value in scores.items():
            print(f"{name:>16}  {'-' if value is None else f'{value:.4g}' if isinstance(value, float) else value}")
    return 0


def calibrate(args: argparse.Namespace) -> int:
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


def compare(args: argparse.Namespace) -> int:
    from occlib.base.files import read_image, write_file
    from occlib.foreground.intensity import to_grey
    from occlib.matching.search import compare as compare_measures
    from occlib.plotting import figure_png
    from occlib.study import charts, sweeps

    if Path(args.out).suffix.lower() != ".png":
        raise ValueError(f"--out: expected a file name that ends in .png, got {args.out}")
    if args.matchers:
        sweeps.load_matchers(args.matchers)
    image, template = (
        read_image(path) if args.colour else to_grey(read_image(path)) for path in (args.image, args.template)
    )
    mask = to_grey(read_image(args.mask)) if args.mask else None
    results = compare_measures(
        image, template, args.methods, threshold=_threshold(args.threshold), mask=mask, rule=args.rule
    )
    write_file(args.out, figure_png(charts.comparison_figure(image, template, results)))
    rows = charts.comparison_rows(results)
    if args.json:
        finite = {name: {key: _finite(value) for key, value in row.items()} for name, row in rows.items()}
        found = {
            name: [{"centre_px": match.centre_px, "score": match.score} for match in result.matches]
            for name, result in results.items()
        }
        print(json.dumps({name: {**row, "found": found[name]} for name, row in finite.items()}))
    else:
        print(_table(rows))
        if blank := [name for name, row in rows.items() if row["best"] is None]:
            print(
                f"{', '.join(blank)}: the same score everywhere; the template or the image has no contrast, or no edges"
            )
        print(f"{args.out}: similarity images, thresholds and matches")
    return 0


def _finite(value: float | None) -> float | None:
    return value if value is not None and abs(value) < float("inf") else None


def _table(rows: dict[str, dict[str, float | None]]) -> str:
    """Named rows in columns, numbers to four digits and ``-`` for none."""
    lines = [["", *next(iter(rows.values()))]]
    lines.append(["method"] + [""] * (len(lines[0]) - 1))
    for name, row in rows.items():
        lines.append(
            [
                name,
                *("-" if v is None or v != v else f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()),
            ]
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) for line in lines]
    return "\n".join(text.rstrip() for text in texts)


def sweep(args: argparse.Namespace) -> int:
    from contextlib import suppress
    from functools import partial

    from occlib.base.files import file_hash, folder_hash, write_file
    from occlib.matching.measures import METHODS
    from occlib.plotting import figure_png
    from occlib.recordings import open_recording
    from occlib.study import charts, sweeps, tables, trials
    from occlib.study import work as work_module

    own = sweeps.load_matchers(args.matchers) if args.matchers else {}
    names = trials.known_names(args.methods or METHODS, METHODS, "methods")
    chosen = {"seeds": _seeds(args.seeds), "sides": args.sides, "conditions": args.conditions, "sources": args.sources}
    work = work_module.batches("fast" if args.fast else "full", **chosen)
    recorded = sorted({batch.source for batch in work} - set(trials.PHOTOGRAPHS))
    inputs: dict[str, Any] = {"methods": names, "matchers": file_hash(Path(args.matchers)) if own else ""}
    inputs["recordings"] = {name: folder_hash(open_recording(name).path) for name in recorded}
    made: dict[str, Any] = {}

    def made_of(table: Any) -> dict[str, Any]:
        made.update({"summary.csv": tables.summarise(table), "thresholds.csv": tables.thresholds(table)})
        made["verdicts.csv"] = tables.verdicts(table)
        return made

    function = partial(work_module.run_batch, methods=tuple(own.get(name, name) for name in names))
    options = {"jobs": args.jobs, "scheduler": args.scheduler, "inputs": inputs, "tables": made_of}
    count = len(sweeps.run_batches(work, function, args.out, **options))
    pictures = {"verdicts.png": charts.verdict_figure(made["verdicts.csv"])}
    (Path(args.out) / "recall.png").unlink(missing_ok=True)
    with suppress(ValueError):  # one level a condition draws no curve
        pictures["recall.png"] = charts.level_curves(made["summary.csv"])
    for name, picture in pictures.items():
        write_file(Path(args.out) / name, figure_png(picture))
    for condition, statement in made["verdicts.csv"][["condition", "statement"]].itertuples(index=False):
        print(f"{condition:>18}  {statement}")
    print(f"{args.out}: trials.csv ({count} rows), {', '.join([*made, *pictures])}")
    return 0


def _seeds(text: str | None) -> range | None:
    if text is None:
        return None
    start, _, stop = text.partition(":")
    digits = all(part.isascii() and part.isdigit() and len(part) < 10 for part in (start, stop or "0"))
    seeds = range(int(start), int(stop) if ":" in text and stop else int(start) + 1) if digits else range(0)
    if not 0 < len(seeds) <= 10_000 or text.endswith(":"):
        raise ValueError(f"--seeds: expected START:STOP, as in 0:8, or one number, got {text[:40]!r}")
    return seeds


def render(args: argparse.Namespace) -> int:
    from occlib.lab.rendering import render as render_scene
    from occlib.lab.scenes import load_scene
    from occlib.recordings import parse_frames

    scene = load_scene(args.scene)
    frames = None if args.frames is None else parse_frames(args.frames, range(scene.frames))
    out = Path(args.out or Path("runs") / "render" / scene.name)
    print(render_scene(scene, out, frames=frames, spp=args.spp))
    return 0


def data(args: argparse.Namespace) -> int:
    from occlib import recordings

    if args.action == "verify":
        from occlib.lab.manifest import verify_manifest

        problems = verify_manifest()
        print("\n".join(problems) or "data/lab agrees with its manifest")
        return 1 if problems else 0
    if args.action == "list":
        print("\n".join(f"{name}: {source['about']}" for name, source in recordings.public_recordings().items()))
        return 0
    if not args.names:
        raise ValueError(f"data fetch: expected a name, one of {', '.join(recordings.public_recordings())}")
    for name in args.names:
        print(recordings.fetch(name, progress=True))
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0 on success, else a one-line error on stderr and another number."""
    args = build_parser().parse_args(arguments)
    from occlib.base.interrupts import stoppable

    try:
        with stoppable():
            status = int(args.function(args))
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader of a pipe left, as in `occlib ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (ValueError, OSError) as error:
        message = " ".join(str(error).split())
        print(f"occlib {args.command}: {message}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print(f"occlib {args.command}: {str(stop) or 'interrupted'}", file=sys.stderr)
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
