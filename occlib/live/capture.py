"""Live capture: cameras that run freely in, instants out; and recordings played as if they were live (section 2).

"The camera system (left and right) captured images of the scene synchronously": cameras without a common trigger do not,
so each is read in a thread of its own, and the pictures that were taken at nearly the same time are put together.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from threading import TIMEOUT_MAX, Condition, Event, Thread
from typing import Any, Protocol, Self

import cv2
import numpy as np

from occlib.base import checks
from occlib.base.arrays import Image
from occlib.recordings import DEFAULT_FPS, Recording

_QUEUE = 8  # pictures of a camera that wait for those of the others


class Source(Protocol):
    """Anything that is read as a ``cv2.VideoCapture`` is."""

    def read(self) -> tuple[bool, Any]:
        """``(True, uint8 BGR (H, W, 3))``, or ``(False, None)`` without a picture; ``EOFError`` when there are no more."""


@dataclass(frozen=True)
class Paired:
    """What the cameras saw at one instant.

    Parameters
    ----------
    time
        In s, for :meth:`occlib.pipeline.Pipeline.process`: that of a recording; of live cameras the same as ``taken``.
    images
        ``{camera: uint8 RGB (H, W, 3)}``; ``None`` for a camera that is silent.
    skew_s
        From the earliest of the pictures to the latest, 0 in a recording.
    taken
        When the earliest of the pictures was read, or due, in s by ``time.perf_counter()``.
    """

    time: float
    images: dict[str, Image | None]
    skew_s: float
    taken: float

    def epoch(self) -> float:
        """``taken`` in s since 1970-01-01 UTC, by the clock as it is set now."""
        return time.time() - (time.perf_counter() - self.taken)


class Device:
    """A camera by its number, or a video file that plays at its own rate; give it to :class:`Capture`.

    Parameters
    ----------
    device
        0, 1, ..., or the path of a video.
    size
        ``(width, height)`` in px to ask of a camera. It may not comply.

    Raises
    ------
    ValueError
        It cannot be opened.
    """

    def __init__(self, device: int | str | Path, *, size: tuple[int, int] | None = None) -> None:
        text, logs = str(device), cv2.utils.logging
        camera = text.isascii() and text.isdigit()
        level = logs.setLogLevel(logs.LOG_LEVEL_SILENT)  # a device that is not there is reported here, in one line
        try:
            self._video = cv2.VideoCapture(int(text)) if camera else cv2.VideoCapture(text)
        except cv2.error:
            self._video = cv2.VideoCapture()
        finally:
            logs.setLogLevel(level)
        if not self._video.isOpened():
            self._video.release()
            raise ValueError(f"device {device}: cannot be opened (expected the number of a camera, or a video file)")
        self._fps = 0.0 if camera else self._video.get(cv2.CAP_PROP_FPS) or DEFAULT_FPS
        self._start, self._frame = 0.0, 0
        if camera:
            self._video.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # no old pictures
            for name, value in zip((cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT), size or (), strict=False):
                self._video.set(name, value)

    def read(self) -> tuple[bool, Any]:
        """The next picture, BGR; of a file when it is due, without those that are overdue."""
        if not self._fps:
            return self._video.read()
        self._start = self._start or time.perf_counter()
        ahead = self._start + self._frame / self._fps - time.perf_counter()
        time.sleep(max(ahead, 0.0))
        for _ in range(int(-ahead * self._fps)):
            self._frame += self._video.grab()
        self._frame += 1
        read, picture = self._video.read()
        if not read:
            raise EOFError
        return read, picture

    def release(self) -> None:
        """Close it; may be called twice."""
        self._video.release()


class Capture:
    """Reads cameras side by side and pairs their pictures by time; a loop over it gives :class:`Paired`.

    A picture is paired with the nearest of every other camera, if that was taken within the tolerance. A camera that stays
    silent for longer does not hold up the others: they go on without it. Whoever is too slow gets the newest instant.

    Parameters
    ----------
    sources
        For each camera what is read: a :class:`Device`, or anything else with ``read()``. Each is read in one thread only,
        and closed by its ``release()``, if it has one, unless it hangs.
    tolerance_s
        Longest time between two pictures of an instant, s. Half the time between two frames is always enough.
    give_up_s
        A camera without a picture for so long, though it is asked, has ended.

    Attributes
    ----------
    dropped : dict of str to int
        For each camera the pictures that were read but are in no instant.
    ended : dict of str to str
        The cameras that give no pictures any more, and why.

    Raises
    ------
    ValueError
        No source, or a time that is not positive.
    """

    def __init__(self, sources: Mapping[str, Source], *, tolerance_s: float = 0.05, give_up_s: float = 1.0) -> None:
        if not sources:
            raise ValueError("sources: expected one or more cameras, got none")
        for name, value in (("tolerance_s", tolerance_s), ("give_up_s", give_up_s)):
            checks.number(name, value, above=0, unit="seconds")
        self.tolerance_s, self.give_up_s = tolerance_s, give_up_s
        self.dropped, self.ended = dict.fromkeys(sources, 0), dict[str, str]()
        self._sources = dict(sources)
        self._queues = {name: deque[tuple[float, Image]]() for name in sources}
        self._news, self._stop, self._time = Condition(), Event(), -np.inf
        self._threads = {name: Thread(target=self._read, args=(name,), daemon=True) for name in sources}
        for thread in self._threads.values():
            thread.start()

    def close(self) -> None:
        """Stop reading and release the sources; may be called twice."""
        self._stop.set()
        for name, thread in self._threads.items():
            thread.join(1.0)
            release = getattr(self._sources[name], "release", None)
            if release and not thread.is_alive():  # to release what is being read may crash
                release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Paired]:
        while (pair := self._next()) is not None:
            yield pair

    def _next(self) -> Paired | None:
        """The newest instant, as soon as there is one; ``None`` when every camera has ended."""
        with self._news:
            while not self._stop.is_set():
                newest = None
                while group := self._group(time.perf_counter()):
                    self._drop(newest or {})
                    newest = group
                if newest:
                    times = [taken for taken, _ in newest.values()]
                    images = {name: newest[name][1] if name in newest else None for name in self._sources}
                    return Paired(min(times), images, max(times) - min(times), min(times))
                if len(self.ended) == len(self._sources):
                    return None
                waiting = [queue[0][0] for queue in self._queues.values() if queue]
                left = min(waiting) + self.tolerance_s - time.perf_counter() if waiting else 0.1
                self._news.wait(min(max(left, 0.001), 0.1))
        return None

    def _group(self, now: float) -> dict[str, tuple[float, Image]]:
        """Take the pictures of the first instant about which there is nothing more to learn; empty if there is none."""
        for name, queue in self._queues.items():
            while queue and queue[0][0] <= self._time:  # it came too late
                self._drop([name])
                queue.popleft()
        while heads := {name: queue[0] for name, queue in self._queues.items() if queue}:
            anchor = min(heads, key=lambda name: heads[name][0])
            first = heads[anchor][0]
            group = {name: head for name, head in heads.items() if head[0] <= first + self.tolerance_s}
            silent = self._queues.keys() - heads.keys() - self.ended.keys()
            if silent and now < first + self.tolerance_s:
                break
            last, queue = max(taken for taken, _ in group.values()), self._queues[anchor]
            alone = len(group) == 1 and len(heads) > 1
            if alone or (len(queue) > 1 and abs(queue[1][0] - last) < last - first):  # its next is nearer to the others
                self._drop([anchor])
                queue.popleft()
                continue
            self._time = first
            return {name: self._queues[name].popleft() for name in group}
        return {}

    def _drop(self, names: Any) -> None:
        for name in names:
            self.dropped[name] += 1

    def _read(self, name: str) -> None:
        """In a thread: queue a camera's pictures until it ends."""
        reason, silent_since = "stopped", None
        while not self._stop.is_set():
            try:
                read, picture = self._sources[name].read()
                taken = time.perf_counter()
                image = _rgb(picture) if read and picture is not None else None
            except EOFError:
                reason = "no more pictures"
                break
            except Exception as error:  # a driver's own; the other cameras go on
                reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
                break
            if image is None:
                silent_since = silent_since or taken
                if taken - silent_since >= self.give_up_s:
                    reason = f"no picture for {self.give_up_s:g} s"
                    break
                self._stop.wait(0.01)
                continue
            silent_since = None
            with self._news:
                if len(queue := self._queues[name]) == _QUEUE:
                    queue.popleft()
                    self._drop([name])
                queue.append((taken, image))
                self._news.notify_all()
        with self._news:
            self.ended[name] = reason
            self._news.notify_all()


def _rgb(picture: Any) -> Image:
    if not isinstance(picture, np.ndarray) or picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        came = f"{picture.dtype} {picture.shape}" if isinstance(picture, np.ndarray) else type(picture).__name__
        raise ValueError(f"picture: expected uint8 BGR (H, W, 3), got {came}")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


AGAIN_S = 10.0
"""s by which time leaps when a recording begins again: long enough for every object to be forgotten."""


class Player:
    """Plays a recording as if it were live; a loop over it gives :class:`Paired`, and starts anew.

    An instant that is due before the one before it is done with, by more than a period, is skipped, as a camera would. Its
    ``time`` is that of playing, so that velocities are those that a listener sees, whatever the rate.

    Parameters
    ----------
    recording
        What to play.
    rate
        Instants a second; that of the recording for ``None``, 0: as fast as they are asked for, none is skipped.
    loop
        Start again at the end: with ``time`` :data:`AGAIN_S` later than it would be, as all objects jump.

    Attributes
    ----------
    dropped : dict of str to int
        For each camera the pictures that were skipped.
    ended : dict of str to str
        As in :class:`Capture`; always empty.

    Raises
    ------
    ValueError
        A rate that is not finite, or negative.
    """

    def __init__(self, recording: Recording, *, rate: float | None = None, loop: bool = False) -> None:
        self.rate = recording.fps if rate is None else rate
        checks.number("rate", self.rate, least=0, unit="instants a second")
        self.recording, self.loop = recording, loop
        self.dropped, self.ended = dict.fromkeys(recording.rig.cameras, 0), dict[str, str]()

    def close(self) -> None:
        """Nothing to do; for who has either a player or a :class:`Capture`."""

    def __iter__(self) -> Iterator[Paired]:
        begun = due = back = None
        for again, images in self._instants():
            now = time.perf_counter()
            due = now if due is None or not self.rate else due + 1 / self.rate
            begun = due if begun is None else begun
            if self.rate and back is not None and back > due + 1 / self.rate:
                for name, image in images.items():
                    self.dropped[name] += image is not None
                continue
            due = max(due, now - 1 / self.rate) if self.rate else due  # what is read too slowly is late, not skipped
            time.sleep(min(max(due - now, 0.0), TIMEOUT_MAX))
            yield Paired(due - begun + again * AGAIN_S, images, 0.0, due)
            back = time.perf_counter()

    def _instants(self) -> Iterator[tuple[int, dict[str, Image | None]]]:
        """How often the recording has begun again, and the pictures."""
        for again in count() if self.loop else range(1):
            for _, images in self.recording.images():
                yield again, {name: images.get(name) for name in self.recording.rig.cameras}
