"""Frames in, a map and its objects out: the stages in the paper's order (Fig 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from occlib.foreground import (
    Background,
    as_background,
    average_background,
    learn_background,
    smooth,
    subtract_background,
    threshold_level,
)
from occlib.geometry import Image, Mask, Rig
from occlib.localization import Region, find_regions, split_regions
from occlib.mapping import OccupancyMap, occupancy_map
from occlib.occlusion import RULES, fuse, hidden_fractions
from occlib.recordings import Recording, check_size
from occlib.registration import FloorWarp
from occlib.tracking import ObjectVector, Observation, Tracker

HIDDEN = 0.9
"""An object is *hidden* in a view from this fraction on."""


@dataclass(frozen=True)
class Settings:
    """How the stages are run; one set for every recording.

    Parameters
    ----------
    colour
        Subtract the three channels rather than the grey levels.
    smoothing_px
        Side of the Gaussian in px, odd.
    threshold
        ``"otsu"``, ``"half-otsu"``, ``"triangle"``, ``"noise"`` or grey levels; see
        :func:`occlib.foreground.threshold_level`.
    min_level
        Grey levels that a threshold found by a rule is never below.
    core
        Evidence above this many times the threshold (before ``min_level``) is an object's core; a region with several
        cores is split. 0: never.
    rule
        Fusion rule; see :func:`occlib.occlusion.fuse`.
    join_m
        Fragments of evidence no further apart are one object, if every view connects them.
    min_area_m2
        Less evidence is noise.
    position
        ``"centroid"`` (Eq 3, 4) or ``"middle"`` of the extent, which a half-hidden footprint disturbs less.
    remove_ghosts
        Drop evidence that every view sees only behind other objects: those explain it.
    """

    colour: bool = True
    smoothing_px: int = 5
    threshold: str | float = "half-otsu"
    min_level: float = 30.0
    core: float = 1.5
    rule: str = "and"
    join_m: float = 0.2
    min_area_m2: float = 0.015
    position: str = "middle"
    remove_ghosts: bool = True

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ValueError(f"rule: expected one of {', '.join(RULES)}, got {self.rule!r}")
        if self.position not in ("centroid", "middle"):
            raise ValueError(f"position: expected centroid or middle, got {self.position!r}")
        threshold_level(np.zeros((1, 1), np.uint8), self.threshold)  # an unknown one is found out now


PROFILES = {
    "recommended": Settings(),
    "paper": Settings(
        colour=False,
        threshold="otsu",
        min_level=0.0,
        core=0.0,
        join_m=0.0,
        min_area_m2=0.002,
        position="centroid",
        remove_ghosts=False,
    ),
}
"""``paper``: grey difference, Otsu, AND, centroid, as far as the paper says; noise floor and tracker are ours.
``recommended``: the best that is known, chosen on the recordings of ``data/lab`` and on ufes-lab."""


def settings_for(profile: str = "recommended", **changes: Any) -> Settings:
    """A profile's settings, with the changes that are not ``None``."""
    if profile not in PROFILES:
        raise ValueError(f"profile: expected one of {', '.join(PROFILES)}, got {profile!r}")
    return replace(PROFILES[profile], **{name: value for name, value in changes.items() if value is not None})


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
    objects
        The object vectors M{p, V, C}.
    """

    time: float
    views: dict[str, Mask]
    occupied: Mask
    labels: npt.NDArray[np.int32]
    map: OccupancyMap
    objects: list[ObjectVector]


class Pipeline:
    """The chain from synchronised frames to a floor map without occlusion.

    Parameters
    ----------
    rig
        Floor and one or more cameras.
    backgrounds
        For each camera a ``Background``, or a uint8 RGB picture of the empty floor.
    settings
        How to run the stages; the recommended ones by default.

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
    ) -> None:
        missing = [name for name in rig.cameras if name not in backgrounds]
        if missing:
            raise ValueError(f"backgrounds: expected one for every camera, missing {', '.join(missing)}")
        self.rig, self.settings, self.tracker = rig, settings, Tracker()
        self.backgrounds = {name: as_background(backgrounds[name]) for name in rig.cameras}
        for name, background in self.backgrounds.items():
            check_size(background.image, rig[name].size, f"background of {name}")
        self.warps = {name: FloorWarp(camera, rig.floor) for name, camera in rig.cameras.items()}
        self._visible = [warp.visible for warp in self.warps.values()]
        self._seen = np.any(self._visible, axis=0)
        self._everywhere = bool(np.all(self._visible))
        # one view alone cannot tell an object from its shadow, so two must see a cell before it is called occupied
        self._confirmed = np.sum(self._visible, axis=0) >= min(2, len(self._visible))
        self._stations = [rig.floor.cells(camera.centre_m[None, :2])[0] for camera in rig.cameras.values()]

    def process(self, images: Mapping[str, Image], time: float) -> FrameResult:
        """Run one instant through the chain.

        Parameters
        ----------
        images
            ``{camera: uint8 RGB (H, W, 3)}``, one for every camera of the rig.
        time
            Seconds, later than in the last call.

        Raises
        ------
        ValueError
            A camera's frame is missing or has the wrong size or dtype.
        """
        missing = [name for name in self.rig.cameras if name not in images]
        if missing:
            raise ValueError(f"images: expected one for every camera, missing {', '.join(missing)}")
        evidence = [self.evidence(name, images[name]) for name in self.rig.cameras]
        views = {name: warped > level for name, (warped, level, _) in zip(self.rig.cameras, evidence, strict=True)}
        occupied = self._fused(list(views.values()))
        labels, regions = self._regions(occupied, list(views.values()))
        if self.settings.core and regions:
            cores = [warped > level for warped, _, level in evidence]
            smallest = self.settings.min_area_m2 / self.rig.floor.cell_area
            labels, regions = split_regions(labels, regions, self._fused(cores), min_area=smallest, within=cores)
        labels, regions, hidden = self._real(labels, regions, list(views.values()))
        seen = [self._observe(region, labels, hidden[i], images) for i, region in enumerate(regions)]
        objects = self.tracker.update(seen, time)
        return FrameResult(time, views, occupied, labels, self._map(labels, views, occupied), objects)

    def evidence(self, name: str, image: Image) -> tuple[Image, int, int]:
        """One camera's evidence on the floor, uint8 (ny, nx), the level above which it is foreground, and that of its core.

        The chain of one view: adjust, subtract, smooth, find the threshold, warp. The threshold is applied on the floor, to the
        transformed view as section 5 has it: thresholding first would stretch hard tiles over the floor.
        """
        check_size(image, self.rig[name].size, f"image of {name}")
        how, background = self.settings, self.backgrounds[name]
        difference = smooth(subtract_background(image, background, colour=how.colour), size=how.smoothing_px)
        found = threshold_level(difference, how.threshold)
        floor = 0.0 if not isinstance(how.threshold, str) else max(how.min_level, background.noise_floor)
        level = max(found, floor)
        # whole levels: the same decision on whole grey levels, without a detour through floats
        return self.warps[name].warp(difference), int(level), int(max(level, how.core * found))

    def _fused(self, views: Sequence[Mask]) -> Mask:
        if self._everywhere:
            return np.asarray(fuse(views, self.settings.rule), dtype=bool)
        fused = np.asarray(fuse(views, self.settings.rule, visible=self._visible), dtype=bool)
        return fused & self._confirmed if self.settings.rule == "and" else fused

    def _regions(self, occupied: Mask, views: Sequence[Mask]) -> tuple[npt.NDArray[np.int32], list[Region]]:
        floor, how = self.rig.floor, self.settings
        return find_regions(
            occupied,
            min_area=how.min_area_m2 / floor.cell_area,
            join=round(how.join_m / floor.resolution),
            within=views if how.rule == "and" else (),
        )

    def _real(
        self, labels: npt.NDArray[np.int32], regions: list[Region], views: Sequence[Mask]
    ) -> tuple[npt.NDArray[np.int32], list[Region], Any]:
        """What is no ghost, with its hidden fractions (n, cameras): NaN where a view sees no cell of the object."""
        hidden = (
            hidden_fractions(labels, views, self._stations)
            if len(regions) > 1
            else np.zeros((len(regions), len(views)))
        )
        if regions and not self._everywhere:
            cells = [np.bincount(labels[seen], minlength=len(regions) + 1)[1:] for seen in self._visible]
            hidden[np.column_stack(cells) == 0] = np.nan
        if self.settings.remove_ghosts and len(views) > 1 and regions:
            real = np.nanmin(hidden, axis=1) < 0.5
            if not real.all():
                renumber = np.concatenate([[0], np.where(real, np.cumsum(real), 0)]).astype(np.int32)
                labels, hidden = renumber[labels], hidden[real]
                regions = [replace(r, label=int(renumber[r.label])) for r in regions if renumber[r.label]]
        return labels, regions, hidden

    def _observe(self, region: Region, labels: Image, hidden: Any, images: Mapping[str, Image]) -> Observation:
        floor = self.rig.floor
        cell = region.centroid if self.settings.position == "centroid" else region.middle
        x, y = (
            float(low + (c + 0.5) * floor.resolution) for low, c in zip((floor.x[0], floor.y[0]), cell, strict=True)
        )
        names = list(self.rig.cameras)
        best = names[int(np.nanargmin(hidden))]
        return Observation(
            position_m=(x, y),
            area_m2=region.area * floor.cell_area,
            colour=self._colour(region, labels, best, images[best]),
            hidden_in=tuple(name for name, fraction in zip(names, hidden, strict=True) if fraction >= HIDDEN),
        )

    def _colour(self, region: Region, labels: Image, name: str, image: Image) -> tuple[int, int, int]:
        """Mean colour that this view shows in the object's cells."""
        left, top, width, height = region.box
        iy, ix = np.nonzero(labels[top : top + height, left : left + width] == region.label)
        chosen = np.arange(min(32, len(iy))) * len(iy) // min(32, len(iy))
        pixels = self.warps[name].pixels[iy[chosen] + top, ix[chosen] + left]
        pixels = np.rint(pixels[np.isfinite(pixels[:, 0])]).astype(int)
        if not len(pixels):
            return (0, 0, 0)
        r, g, b = image[pixels[:, 1], pixels[:, 0]].mean(axis=0)
        return (round(float(r)), round(float(g)), round(float(b)))

    def _map(self, labels: Image, views: Mapping[str, Mask], occupied: Mask) -> OccupancyMap:
        """Occupied where an object is; free where a view looks at bare floor; else, as under a ghost, unknown."""
        known = self._seen
        if not self._everywhere:
            shaded = np.logical_and.reduce(
                [view | ~seen for view, seen in zip(views.values(), self._visible, strict=True)]
            )
            known = known & ~(shaded & ~self._confirmed)
        return occupancy_map(labels > 0, known & ~occupied, self.rig.floor)


def backgrounds_of(recording: Recording, *, samples: int = 60, progress: bool = False) -> dict[str, Background]:
    """Each camera's background: the mean of its empty pictures, or else learned from ``samples`` of its frames."""
    backgrounds = {name: average_background(images) for name, images in recording.background_images().items()}
    if unknown := recording.without_background:
        pictures = recording.sample(samples)
        for name in tqdm(unknown, desc="learning the background", unit="camera", disable=None if progress else True):
            backgrounds[name] = learn_background(pictures[name])
    return {name: backgrounds[name] for name in recording.sources}
