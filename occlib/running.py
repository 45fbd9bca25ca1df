"""A recording run through the chain: its objects, maps and overview on disk."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tqdm import tqdm

from occlib.base.arrays import Image
from occlib.base.files import read_yaml, staged_folder, write_file, writing
from occlib.formats import load_truth
from occlib.live import save_bag
from occlib.mapping import MODES, OccupancyMap, save_map
from occlib.pipeline import PROFILES, FrameResult, Pipeline, Settings, backgrounds_of
from occlib.plotting import figure_png, overview
from occlib.recordings import Recording

MOST_RANGES = 6
"""Ranges of frames that :func:`frame_ranges` writes out before it sums up the rest: what fits on a line."""


@dataclass(frozen=True)
class RunSummary:
    """What a run has written.

    Parameters
    ----------
    out
        The folder.
    files
        Names of the files in it that hold the last frame's map: picture, description and, if asked for, the bag of all maps.
    frames
        The frames that were run, in order.
    excluded
        ``{(camera, reason): frames}``: where a camera was not to be trusted; see ``FrameResult.excluded``.
    """

    out: Path
    files: list[str]
    frames: list[int]
    excluded: dict[tuple[str, str], list[int]]

    def warnings(self) -> list[str]:
        """A line for each camera and reason for which it was left out, in the order of their first frames."""
        by_first_frame = sorted(self.excluded.items(), key=lambda item: item[1][0])
        return [f"{name}: {reason} in {frame_ranges(left_out, self.frames)}, left out"
                for (name, reason), left_out in by_first_frame]  # fmt: skip

    def __str__(self) -> str:
        return f"{self.out}: objects.jsonl ({len(self.frames)} frames), {', '.join(self.files)}, overview.png"


def run_recording(
    recording: Recording,
    out: str | Path,
    *,
    settings: Settings = PROFILES["recommended"],
    frames: Sequence[int] | None = None,
    templates: Mapping[str, Image] | None = None,
    maps: bool = False,
    map_mode: str = "trinary",
    bag: str | None = None,
    note: str = "",
    progress: bool = False,
) -> RunSummary:
    """Run a recording through the chain and write what it shows to a folder.

    ``objects.jsonl`` has a line for each frame, ``map.pgm`` (or ``.png``) and ``map.yaml`` are the map of the last frame,
    ``overview.png`` shows that frame. All of it is published at the end, or nothing; no more than one frame is in memory.

    Parameters
    ----------
    recording
        What to run, with the cameras to use; its ``truth.json``, if there is one, is drawn in the overview.
    out
        The folder; made if need be. What a previous run left there is replaced.
    settings
        Of the stages.
    frames
        Numbers of the frames to run, in any order; all by default.
    templates
        ``{label: picture}`` of known objects, see :class:`occlib.pipeline.Pipeline`.
    maps
        Write the map of every frame as well: ``maps/000040.pgm`` and ``.yaml``.
    map_mode
        One of :data:`occlib.mapping.MODES`.
    bag
        Write all maps to a bag for ROS, ``map.mcap``, ``map`` or ``map.bag``: one of :data:`occlib.live.BAG_FORMATS`.
    note
        What the title of the overview ends with.
    progress
        Show the progress on stderr if that is a terminal.

    Raises
    ------
    ValueError
        In one line: an unknown mode or format, no such frame, a picture or a truth that cannot be read, a folder that cannot be
        written. The folder is then left as it was.

    Examples
    --------
    >>> import tempfile
    >>> from occlib.recordings import open_recording
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     summary = run_recording(open_recording("ball_and_oval", ["left", "right"]), folder, frames=[0, 1])
    ...     sorted(path.name for path in summary.out.iterdir())
    ['map.pgm', 'map.yaml', 'objects.jsonl', 'overview.png']
    """
    if map_mode not in MODES:
        raise ValueError(f"map_mode: expected one of {', '.join(MODES)}, got {map_mode!r}")
    chosen = recording.frames if frames is None else sorted(set(frames))
    if not chosen:
        raise ValueError("frames: expected one or more, got none")
    truth_path = recording.path / "truth.json"
    truth = load_truth(truth_path).frames if truth_path.exists() else {}
    with staged_folder(out) as stage:
        pipeline = Pipeline(recording.rig, backgrounds_of(recording, progress=progress), settings, templates)
        run = _Run(recording, pipeline, stage, map_mode if maps else None)
        with closing(run.maps(chosen, progress)) as results:
            bags = [] if bag is None else [save_bag(stage / "map", results, format=bag).name]
            deque(results, maxlen=0)  # without a bag nobody has asked for the maps yet
        assert run.result is not None
        last = run.frames[-1]
        title = f"{recording.path.name}, frame {last}, rule {settings.finder.rule}" + (f", {note}" if note else "")
        drawn = overview(recording.rig, run.images, run.result, title=title, truth=truth.get(last, []))
        write_file(stage / "overview.png", figure_png(drawn))
        picture = read_yaml(save_map(stage / "map", run.result.map, mode=map_mode))["image"]
    return RunSummary(Path(out), [picture, "map.yaml", *bags], run.frames, run.excluded)


@dataclass
class _Run:
    """The frames of a recording as they go through the pipeline: each is written at once, the last one is remembered."""

    recording: Recording
    pipeline: Pipeline
    stage: Path
    map_mode: str | None
    images: dict[str, Image | None] = field(default_factory=dict)
    result: FrameResult | None = None
    frames: list[int] = field(default_factory=list)
    excluded: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def maps(self, frames: Sequence[int], progress: bool) -> Generator[tuple[float, OccupancyMap], None, None]:
        """Time and map of each frame."""
        bar = tqdm(
            self.recording.images(frames),
            total=len(frames),
            unit="frame",
            desc=self.recording.path.name,
            disable=None if progress else True,
        )
        with writing(self.stage / "objects.jsonl") as write:
            for frame, images in bar:
                shown = {name: images.get(name) for name in self.recording.rig.cameras}  # None where one dropped out
                result = self.pipeline.process(shown, self.recording.time(frame))
                write(objects_line(frame, result) + "\n")
                if self.map_mode:
                    save_map(self.stage / "maps" / f"{frame:06d}", result.map, mode=self.map_mode)
                for camera_and_reason in result.excluded.items():
                    self.excluded.setdefault(camera_and_reason, []).append(frame)
                self.frames.append(frame)
                self.images, self.result = shown, result
                yield result.time, result.map


def objects_line(frame: int, result: FrameResult) -> str:
    """A frame's line of ``objects.jsonl``, without the line break.

    ``coasting`` is there if an object is not seen now, ``excluded`` if a camera was left out.
    """
    objects, coasting = ([each.to_dict() for each in some] for some in (result.objects, result.coasting))
    line: dict[str, Any] = {"frame": frame, "time": round(result.time, 6), "objects": objects}
    more = {"coasting": coasting, "excluded": result.excluded}
    return json.dumps({**line, **{name: value for name, value in more.items() if value}})


def frame_ranges(some: Sequence[int], frames: Sequence[int], *, most: int = MOST_RANGES) -> str:
    """Frames as ranges of those that were run, on one line however many there are.

    Parameters
    ----------
    some
        Some of the frames, in order, at least one.
    frames
        All that were run, in order.
    most
        Ranges to write out before the rest is summed up.

    Examples
    --------
    >>> frame_ranges([4, 8, 12, 24], range(0, 40, 4))
    'frames 4 to 12 and 24'
    >>> frame_ranges([0, 1], range(2))
    'all frames'
    """
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


def output_folders(recordings: Sequence[Recording], out: str | Path) -> list[Path]:
    """Where the results of each recording go: ``out`` for a single one, else ``out/NAME`` for each.

    Raises ``ValueError`` if two recordings have the same name.
    """
    if len(recordings) == 1:
        return [Path(out)]
    paths: dict[str, Path] = {}
    for recording in recordings:
        path = recording.path.resolve()
        if path.name in paths:
            raise ValueError(f"recordings: expected different names, got {paths[path.name]} and {path}")
        paths[path.name] = path
    return [Path(out) / name for name in paths]
