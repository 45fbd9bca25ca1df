"""Frames in, a map and its objects out: the paper's chain (Fig 3), readable from top to bottom in :meth:`Pipeline.process`.

Each view is checked and its evidence taken; the evidence is warped to the floor; a finder makes objects of it; a tracker
gives them identity and velocity; the map says what is occupied, free and unknown, and remembers for a moment what is not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from occlib.base.arrays import Image, Mask
from occlib.finding import Finder, FloorViews, Found, Instant, confirmed_only
from occlib.foreground.background import Background, as_background, average_background
from occlib.foreground.health import CameraMonitor
from occlib.foreground.learning import learn_background
from occlib.geometry import Rig
from occlib.mapping import OccupancyMap, instant_map
from occlib.memory import FootprintMemory
from occlib.recordings import Recording, check_size
from occlib.settings import PROFILES, Settings, settings_for
from occlib.tracking import ObjectVector, Tracker

__all__ = ["PROFILES", "FrameResult", "Pipeline", "Settings", "backgrounds_of", "settings_for"]

HALF_HIDDEN = 0.5
"""``FrameResult.hidden_by`` names the cameras from which more than this fraction of an object is hidden."""


@dataclass(frozen=True)
class FrameResult:
    """What one instant shows.

    Parameters
    ----------
    time
        Seconds.
    views
        Each view's foreground on the floor, bool (ny, nx).
    occupied
        The fused foreground, before noise and ghosts are dropped, bool (ny, nx).
    labels
        int32 (ny, nx): 0, or the index of the cell's object in ``objects`` plus 1.
    map
        -1 unknown, 0 free, 100 occupied.
    reason
        uint8 (ny, nx), why a cell is unknown: :data:`occlib.mapping.REASONS`; 0 where it is known.
    objects
        The object vectors M{p, V, C} of what is confirmed.
    coasting
        Those of what was confirmed and is not seen now, where it is expected, while it is on the floor. Its cells are on the map, not
        in ``labels``: see :mod:`occlib.memory`.
    excluded
        The cameras that are not to be trusted now, and why: missing, black, covered, frozen, or in light that nothing explains.
    hidden_by
        For each object the cameras in which more than half of it is hidden: ``{camera: (fraction, id that hides most of it)}``.
    """

    time: float
    views: dict[str, Mask]
    occupied: Mask
    labels: npt.NDArray[np.int32]
    map: OccupancyMap
    reason: npt.NDArray[np.uint8]
    objects: list[ObjectVector]
    coasting: list[ObjectVector]
    excluded: dict[str, str]
    hidden_by: list[dict[str, tuple[float, int]]]


class Pipeline:
    """The chain from synchronised frames to a floor map without occlusion.

    Parameters
    ----------
    rig
        Floor and one or more cameras.
    backgrounds
        For each camera a ``Background``, or a uint8 RGB picture of the empty floor.
    settings
        Of the stages; the recommended ones by default.
    templates
        ``{label: picture}`` of known objects, uint8 RGB, or RGBA where alpha says which pixels count; each shows its object from
        head to foot, in any of the cameras. An object that resembles one gets its label, and if it was away, its id again.

    Examples
    --------
    >>> from occlib.recordings import open_recording
    >>> recording = open_recording("ball_and_oval", ["left", "right"])
    >>> pipeline = Pipeline(recording.rig, backgrounds_of(recording))
    >>> frame, images = next(recording.images())
    >>> len(pipeline.process(images, recording.time(frame)).objects)
    2
    """

    def __init__(
        self,
        rig: Rig,
        backgrounds: Mapping[str, Background | npt.ArrayLike],
        settings: Settings = PROFILES["recommended"],
        templates: Mapping[str, Image] | None = None,
    ) -> None:
        missing = [name for name in rig.cameras if name not in backgrounds]
        if missing:
            raise ValueError(f"backgrounds: expected one for every camera, missing {', '.join(missing)}")
        self.rig, self.settings = rig, settings
        self.backgrounds = {name: as_background(backgrounds[name]) for name in rig.cameras}
        for name, background in self.backgrounds.items():
            check_size(background.image, rig[name].size, f"background of {name}")
        self.monitor = CameraMonitor(self.backgrounds)
        self.floor_views = FloorViews(rig)
        self.finder: Finder = settings.finder.build(self.floor_views, self.backgrounds, templates or {})
        self.tracker = Tracker(settings.tracker)
        self.memory = FootprintMemory(rig.floor)

    def process(self, images: Mapping[str, Image | None], time: float) -> FrameResult:
        """Run one instant through the chain.

        Parameters
        ----------
        images
            ``{camera: uint8 RGB (H, W, 3)}``, one for every camera of the rig; ``None`` for one that has dropped out.
        time
            Seconds, later than in the last call.

        Raises
        ------
        ValueError
            A camera's frame is not given, or has the wrong size or dtype.
        """
        self._check(images, time)
        excluded = self.monitor.check(images)  # health: missing, black, covered, frozen, or in odd light
        instant = self._look({name: images[name] for name in self.rig.cameras if name not in excluded})
        found = self.finder.find(instant)
        objects = self.tracker.update(found.observations, time, found.identify)
        labels, unconfirmed = confirmed_only(found.labels, objects)
        confirmed = [i for i, vector in enumerate(objects) if vector.id]
        coasting = [vector for vector in self.tracker.coasting() if self.rig.floor.contains(vector.position_m)]
        remembered = self.memory.update(labels, [objects[i] for i in confirmed], coasting)
        grid, reason = instant_map(
            labels,
            unconfirmed,
            found.occupied,
            instant.views,
            self.floor_views.visible,
            self.floor_views.needed,
            self.rig.floor,
            remembered,
        )
        hidden_by = _hidden_by(found, objects, list(instant.images))
        return FrameResult(
            time=time,
            views=instant.views,
            occupied=found.occupied,
            labels=labels,
            map=grid,
            reason=reason,
            objects=[objects[i] for i in confirmed],
            coasting=coasting,
            excluded=excluded,
            hidden_by=[hidden_by[i] for i in confirmed],
        )

    def _check(self, images: Mapping[str, Image | None], time: float) -> None:
        """Refuse what cannot be processed before anything changes."""
        missing = [name for name in self.rig.cameras if name not in images]
        if missing:
            raise ValueError(f"images: expected one for every camera, missing {', '.join(missing)}")
        for name in self.rig.cameras:
            if (image := images[name]) is not None:
                check_size(image, self.rig[name].size, f"image of {name}")
        self.tracker.check_time(time)

    def _look(self, images: Mapping[str, Any]) -> Instant:
        """Each view's evidence, as it is and on the floor."""
        foreground = self.settings.foreground
        evidence = {name: foreground.evidence(image, self.backgrounds[name]) for name, image in images.items()}
        on_floor = {name: self.floor_views.warps[name].warp(one.values) for name, one in evidence.items()}
        return Instant(images, evidence, on_floor)


def _hidden_by(
    found: Found, objects: Sequence[ObjectVector], cameras: Sequence[str]
) -> list[dict[str, tuple[float, int]]]:
    """For each object the cameras in which more than half of it is hidden, how much, and by which object (-1: not known)."""
    return [
        {
            name: (float(found.hidden[i, k]), objects[by].id if (by := found.hidden_by[i, k]) >= 0 else -1)
            for k, name in enumerate(cameras)
            if found.hidden[i, k] > HALF_HIDDEN
        }
        for i in range(len(objects))
    ]


def backgrounds_of(recording: Recording, *, samples: int = 60, progress: bool = False) -> dict[str, Background]:
    """Each camera's background: the mean of its empty pictures, or else learned from ``samples`` of its frames."""
    backgrounds = {name: average_background(images) for name, images in recording.background_images().items()}
    if unknown := recording.without_background:
        pictures = recording.sample(samples)
        if bare := [name for name in unknown if not pictures[name]]:
            raise ValueError(f"{recording.path / 'frames'}: no picture of {', '.join(bare)} can be read")
        for name in tqdm(unknown, desc="learning the background", unit="camera", disable=None if progress else True):
            backgrounds[name] = learn_background(pictures[name])
    return {name: backgrounds[name] for name in recording.sources}
