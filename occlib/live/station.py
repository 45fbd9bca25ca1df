"""The station of section 2: what the cameras see goes through the chain, and every map is broadcast as it is made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self

from tqdm import tqdm

from occlib.base.arrays import Image
from occlib.geometry import Rig
from occlib.live import capture
from occlib.recordings import Recording

if TYPE_CHECKING:
    from occlib.foreground import Background
    from occlib.live.broadcast import Publisher
    from occlib.live.topic import MapTopic
    from occlib.pipeline import Settings

# The pipeline and its compiled loops are imported where they are used: who only listens does not wait for them.


@dataclass(frozen=True)
class Feed:
    """What a station makes its maps from; closed at the end of a ``with`` block.

    Parameters
    ----------
    rig
        Floor and cameras.
    backgrounds
        For each camera the empty floor.
    instants
        What the cameras see, one instant after the other.
    count
        How many instants there will be; ``None`` if nobody knows.
    """

    rig: Rig
    backgrounds: Mapping[str, Background]
    instants: capture.Capture | capture.Player
    count: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.instants.close()


def recorded_feed(
    recording: Recording, *, rate: float | None = None, loop: bool = False, progress: bool = False
) -> Feed:
    """A recording played as if it were live.

    Parameters
    ----------
    recording
        With the cameras to use.
    rate, loop
        As in :class:`occlib.live.Player`.
    progress
        Show on stderr, if that is a terminal, how backgrounds are learned.
    """
    from occlib.pipeline import backgrounds_of

    player = capture.Player(recording, rate=rate, loop=loop)
    return Feed(
        recording.rig, backgrounds_of(recording, progress=progress), player, None if loop else len(recording.frames)
    )


def live_feed(
    rig: Rig,
    devices: Mapping[str, int | str | Path],
    pictures: Mapping[str, Sequence[Image]],
    *,
    tolerance_s: float = 0.05,
) -> Feed:
    """Live cameras, opened.

    Parameters
    ----------
    rig
        Floor and cameras.
    devices
        For each camera its number or a video, see :class:`occlib.live.Device`.
    pictures
        For each camera one or more pictures of the empty floor, uint8 RGB (H, W, 3).
    tolerance_s
        As in :class:`occlib.live.Capture`.

    Raises
    ------
    ValueError
        In one line: a camera without a device or without pictures, or a device that cannot be opened. None stays open then.
    """
    from occlib.foreground import average_background

    for name, given in (("devices", devices), ("pictures", pictures)):
        if missing := [camera for camera in rig.cameras if camera not in given]:
            raise ValueError(f"{name}: expected one for every camera, missing {', '.join(missing)}")
    backgrounds = {camera: average_background(pictures[camera]) for camera in rig.cameras}
    sources = {}
    with ExitStack() as opening:
        for name, camera in rig.cameras.items():
            sources[name] = capture.Device(devices[name], size=camera.size)
            opening.callback(sources[name].release)
        instants = capture.Capture(sources, tolerance_s=tolerance_s)
        opening.pop_all()  # from here on it is the capture that closes them, unless one hangs
    return Feed(rig, backgrounds, instants)


@dataclass
class Published:
    """What a station has published.

    Parameters
    ----------
    maps
        How many.
    skew_s
        The longest time between two pictures of an instant, s; 0 in a recording.
    excluded
        ``{(camera, reason): number of maps without it}``, see ``FrameResult.excluded``.
    dropped
        For each camera the pictures that are in no map.
    ended
        The cameras that gave no pictures any more, and why.
    """

    maps: int = 0
    skew_s: float = 0.0
    excluded: Counter[tuple[str, str]] = field(default_factory=Counter)
    dropped: dict[str, int] = field(default_factory=dict)
    ended: dict[str, str] = field(default_factory=dict)


def publish_maps(
    feed: Feed,
    settings: Settings,
    publisher: Publisher,
    topic: MapTopic | None = None,
    *,
    progress: bool = False,
) -> Published:
    """Publish the map of every instant until there are no more, or until Ctrl-C: live cameras have no last frame.

    Parameters
    ----------
    feed
        What the cameras see. Of live cameras the first instant is not published: it is there to warm up.
    settings
        Of the stages.
    publisher
        Sends each map and its objects.
    topic
        Sends each map to ROS 2 as well.
    progress
        Show the progress on stderr if that is a terminal.
    """
    from occlib.pipeline import Pipeline

    published = Published()
    try:
        pipeline = Pipeline(feed.rig, feed.backgrounds, settings)
        for instant in feed.instants:  # what is compiled, or loaded, at first use is not to delay the first maps
            Pipeline(feed.rig, feed.backgrounds, settings).process(instant.images, instant.time)
            break
        bar = tqdm(feed.instants, total=feed.count, unit="frame", disable=None if progress else True)
        for instant in bar:
            result = pipeline.process(instant.images, instant.time)
            objects, coasting = ([each.to_dict() for each in some] for some in (result.objects, result.coasting))
            publisher.send(result.map.data, feed.rig.floor, objects, instant.epoch(), coasting)
            if topic is not None:
                topic.send(result.map, instant.epoch())
            published.maps += 1
            published.skew_s = max(published.skew_s, instant.skew_s)
            published.excluded.update(result.excluded.items())
    except KeyboardInterrupt:
        pass
    published.dropped, published.ended = dict(feed.instants.dropped), dict(feed.instants.ended)
    return published
