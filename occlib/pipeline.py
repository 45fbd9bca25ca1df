"""Frames in, a map and its objects out: the stages in the paper's order (Fig 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.explaining.appearance import DISTINCT, LIKENESS, _box, _likeness, _template, axis_colours
from occlib.explaining.cylinders import Cylinder
from occlib.explaining.explainer import HIDDEN_ESTIMATE, _Explainer, _weights, footprints
from occlib.explaining.feet import standing_points
from occlib.finding import HIDDEN, _confirmed_first, _hidden_by, _hidden_in, _new_labels, _visible
from occlib.foreground.background import Background, as_background, average_background
from occlib.foreground.difference import smooth, subtract_background
from occlib.foreground.health import CameraMonitor
from occlib.foreground.intensity import adjust_intensity
from occlib.foreground.learning import learn_background
from occlib.foreground.shadows import SURE, foreground_evidence
from occlib.foreground.threshold import threshold_level
from occlib.geometry import Rig
from occlib.localization import Region, find_regions, split_regions
from occlib.mapping import BLIND, DISAGREE, ONE_VIEW, UNCONFIRMED, OccupancyMap, occupancy_map
from occlib.occlusion import RULES, fuse, hidden_fractions
from occlib.recordings import Recording, check_size
from occlib.registration import FloorWarp
from occlib.tracking import ObjectVector, Observation, Tracker

NEAR_M = 0.02
"""What a sharp silhouette may lack of an object's rim on the floor, in m."""


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
        ``"evidence"``: shadows and reflections left out, :func:`occlib.foreground.shadows.foreground_evidence`. Else the difference is
        thresholded: ``"otsu"``, ``"half-otsu"``, ``"triangle"``, ``"noise"`` or grey levels; see
        :func:`occlib.foreground.threshold.threshold_level`.
    min_level
        Grey levels that a threshold found by a rule is never below.
    core
        Evidence above this many times the threshold (before ``min_level``) is an object's core; a region with several
        cores is split. 0: never.
    rule
        ``"explain"``: the fewest objects that explain all silhouettes, :func:`occlib.explaining.search.explain`. Else a fusion rule
        of :func:`occlib.occlusion.fuse`, whose regions are the objects; what follows below is for these.
    join_m
        Fragments of evidence no further apart are one object, if every view connects them.
    min_area_m2
        Less evidence is noise.
    position
        ``"centroid"`` (Eq 3, 4) or ``"middle"`` of the extent, which a half-hidden footprint disturbs less.
    remove_ghosts
        Drop evidence that every view sees only behind other objects: those explain it.
    confirm_s
        What is new must be seen for so long before it is an object; until then its cells are unknown. See
        :class:`occlib.tracking.Tracker`.
    """

    colour: bool = True
    smoothing_px: int = 5
    threshold: str | float = "evidence"
    min_level: float = 30.0
    core: float = 1.5
    rule: str = "explain"
    join_m: float = 0.2
    min_area_m2: float = 0.015
    position: str = "middle"
    remove_ghosts: bool = True
    confirm_s: float = 0.2

    def __post_init__(self) -> None:
        known = [rule for rule in RULES if rule != "planes"] + ["explain"]
        if self.rule not in known:
            raise ValueError(f"rule: expected one of {', '.join(known)}, got {self.rule!r}")
        if self.position not in ("centroid", "middle"):
            raise ValueError(f"position: expected centroid or middle, got {self.position!r}")
        if self.threshold != "evidence":
            threshold_level(np.zeros((1, 1), np.uint8), self.threshold)  # an unknown one is found out now


PROFILES = {
    "recommended": Settings(),
    "and": Settings(threshold="half-otsu", rule="and", confirm_s=0.0),
    "paper": Settings(
        colour=False,
        threshold="otsu",
        rule="and",
        min_level=0.0,
        core=0.0,
        join_m=0.0,
        min_area_m2=0.002,
        position="centroid",
        remove_ghosts=False,
        confirm_s=0.0,
    ),
}
"""``paper``: grey difference, Otsu, AND, centroid, as far as the paper says; noise floor and tracker are ours.
``and``: the AND rule with what helps it most: colour, half of Otsu, fragments joined, neighbours parted, ghosts dropped.
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
    reason
        uint8 (ny, nx), why a cell is unknown: :data:`occlib.mapping.REASONS`; 0 where it is known.
    objects
        The object vectors M{p, V, C} of what is confirmed.
    excluded
        The cameras that are not to be trusted now, and why: missing, black, covered or frozen.
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
        How to run the stages; the recommended ones by default.
    templates
        ``{label: picture}`` of known objects, uint8 RGB, or RGBA where alpha says which pixels count; each shows its object from
        head to foot, in any of the cameras. An object that resembles one (:data:`LIKENESS`) gets its label, and if it was away, its id again.

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
        self.rig, self.settings, self.tracker = rig, settings, Tracker(confirm_s=settings.confirm_s)
        self.templates = {label: _template(label, picture) for label, picture in (templates or {}).items()}
        if self.templates and settings.rule != "explain":
            raise ValueError(f"templates: expected rule explain, which knows the objects' sizes, got {settings.rule}")
        self.backgrounds = {name: as_background(backgrounds[name]) for name in rig.cameras}
        for name, background in self.backgrounds.items():
            check_size(background.image, rig[name].size, f"background of {name}")
        self.warps = {name: FloorWarp(camera, rig.floor) for name, camera in rig.cameras.items()}
        self.monitor = CameraMonitor(self.backgrounds)
        self._visible = {name: warp.visible for name, warp in self.warps.items()}
        # one view alone cannot tell an object from its shadow, so two must see a cell before it is called occupied
        self._needed = min(2, len(rig.cameras))
        self._stations = {n: rig.floor.cells(c.centre_m[None, :2])[0] for n, c in rig.cameras.items()}
        self._explainer = _Explainer(rig, self.backgrounds) if settings.rule == "explain" else None
        side = 2 * round(NEAR_M / rig.floor.resolution) + 1
        self._rim = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))

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
        missing = [name for name in self.rig.cameras if name not in images]
        if missing:
            raise ValueError(f"images: expected one for every camera, missing {', '.join(missing)}")
        for name in self.rig.cameras:
            if (image := images[name]) is not None:
                check_size(image, self.rig[name].size, f"image of {name}")
        self.tracker.check_time(time)
        excluded = self.monitor.check(images)
        frames = {n: image for n in self.rig.cameras if n not in excluded and (image := images[n]) is not None}
        evidence = {name: self.evidence(name, image) for name, image in frames.items()}
        floor = {name: self.warps[name].warp(picture) for name, (picture, _, _) in evidence.items()}
        views = {name: floor[name] > level for name, (_, level, _) in evidence.items()}
        if self.settings.rule in ("product", "log-odds"):
            soft = {n: _weights(level)[floor[n]] / 510 + 0.5 for n, (_, level, _) in evidence.items()}
            occupied = self._fused(soft, self.settings.rule)
        else:
            occupied = self._fused(views, "and" if self._explainer else self.settings.rule)
        if self._explainer:
            things = self._explainer.explain({name: (e[0], e[1]) for name, e in evidence.items()})
            near = occupied
            # beside an object any evidence is enough, and what is near it: a dark rim must not pass for shadow
            if self.settings.threshold == "evidence":
                near = self._fused({name: picture > 0 for name, picture in floor.items()}, "and")
                near = cv2.dilate(near.view(np.uint8), self._rim).view(np.bool_)
            labels, seen, hidden, by = self._explained(things, near, frames)
        else:
            cores = {name: floor[name] > core for name, (_, _, core) in evidence.items()}
            labels, seen, hidden = self._regions(occupied, views, cores, frames)
            by = np.full(hidden.shape, -1)
        identify = (lambda i: self._identify(i, hidden[i], frames)) if self.templates else None
        objects = self.tracker.update(seen, time, identify)
        labels, candidates = _confirmed_first(labels, objects)
        grid, reason = self._map(labels, candidates, views, occupied)
        hidden_by = _hidden_by(objects, hidden, by, list(frames))
        return FrameResult(
            time,
            views,
            occupied,
            labels,
            grid,
            reason,
            [thing for thing in objects if thing.id],
            excluded,
            [by for thing, by in zip(objects, hidden_by, strict=True) if thing.id],
        )

    def evidence(self, name: str, image: Image) -> tuple[Image, int, int]:
        """One camera's evidence, uint8 (H, W), the level above which it is foreground, and that of an object's core.

        The chain of one view but for the threshold, which is applied on the floor, to the transformed view as section 5 has
        it: thresholding first would stretch hard tiles over the floor.
        """
        how, background = self.settings, self.backgrounds[name]
        if how.threshold == "evidence":
            return foreground_evidence(image, background), SURE - 1, SURE + 63
        difference = smooth(subtract_background(image, background, colour=how.colour), size=how.smoothing_px)
        found = threshold_level(difference, how.threshold)
        floor = 0.0 if not isinstance(how.threshold, str) else max(how.min_level, background.noise_floor)
        level = max(found, floor)
        # whole levels: the same decision on whole grey levels, without a detour through floats
        return difference, int(level), int(max(level, how.core * found))

    def _fused(self, views: Mapping[str, Image], rule: str) -> Mask:
        """The cells that the rule calls occupied, from masks, or from probabilities."""
        if not views:
            return np.zeros(self.rig.floor.shape, bool)
        visible = [self._visible[name] for name in views]
        everywhere = all(seen.all() for seen in visible)
        fused = fuse(list(views.values()), rule, visible=None if everywhere else visible) > 0.5
        return fused if rule == "or" else fused & (np.sum(visible, axis=0) >= self._needed)

    # --- objects that explain the silhouettes ------------------------------------------------------
    def _explained(
        self, things: Sequence[Cylinder], occupied: Mask, frames: Mapping[str, Image]
    ) -> tuple[npt.NDArray[np.int32], list[Observation], FloatArray, npt.NDArray[np.int64]]:
        assert self._explainer is not None
        points = standing_points(self._explainer.evidence, things).tolist()
        standing = [thing._replace(x=x, y=y) for thing, (x, y) in zip(things, points, strict=True)]
        labels = footprints(standing, occupied, self.rig.floor)
        hidden, by = self._explainer.state(frames)
        areas = np.bincount(labels.ravel(), minlength=len(things) + 1)[1:] * self.rig.floor.cell_area
        colours = self._colours(things, hidden, frames)
        seen = [
            Observation(
                (thing.x, thing.y),
                float(areas[i]),
                colours[i],
                hidden_in=_hidden_in(hidden[i], frames, HIDDEN_ESTIMATE),
                visible=_visible(hidden[i], frames),
            )
            for i, thing in enumerate(standing)
        ]
        return labels, seen, hidden, by

    def _colours(
        self, things: Sequence[Cylinder], hidden: FloatArray, frames: Mapping[str, Image]
    ) -> list[tuple[int, int, int]]:
        """Mean colour along each object's axis, in the view that sees most of it."""
        colours = []
        for i, thing in enumerate(things):
            best = list(frames)[int(np.argmin(np.nan_to_num(hidden[i], nan=2.0)))]
            seen = axis_colours([(thing.x, thing.y)], thing.height, {best: frames[best]}, self.rig)
            r, g, b = np.nan_to_num(seen[0, 0])
            colours.append((round(float(r)), round(float(g)), round(float(b))))
        return colours

    def _identify(self, i: int, hidden: FloatArray, frames: Mapping[str, Image]) -> str | None:
        """The template that object ``i`` clearly resembles most in the view that sees it best."""
        assert self._explainer is not None
        least = int(np.argmin(np.nan_to_num(hidden, nan=2.0)))
        if not hidden[least] < 0.2:
            return None
        name = list(frames)[least]
        left, top, right, bottom = _box(self._explainer.before[i], self.rig, name)
        width, height = right - left, bottom - top
        rows, columns = (
            slice(max(low - s // 4, 0), max(low + s + s // 4, 0)) for low, s in ((top, height), (left, width))
        )
        window = adjust_intensity(frames[name], self.backgrounds[name].image)[rows, columns]
        scores = {label: _likeness(window, *template, height) for label, template in self.templates.items()}
        best = min(scores, key=lambda label: scores[label])
        others = [score for label, score in scores.items() if label != best]
        return best if scores[best] <= LIKENESS and all(score >= DISTINCT * scores[best] for score in others) else None

    # --- objects that are regions of the fused evidence ----------------------------------------------
    def _regions(
        self, occupied: Mask, views: Mapping[str, Mask], cores: Mapping[str, Mask], frames: Mapping[str, Image]
    ) -> tuple[npt.NDArray[np.int32], list[Observation], FloatArray]:
        floor, how = self.rig.floor, self.settings
        smallest = how.min_area_m2 / floor.cell_area
        masks = list(views.values())
        labels, regions = find_regions(
            occupied,
            min_area=smallest,
            join=round(how.join_m / floor.resolution),
            within=masks if how.rule == "and" else (),
        )
        if how.core and regions:
            core = self._fused(cores, how.rule)
            labels, regions = split_regions(labels, regions, core, min_area=smallest, within=list(cores.values()))
        labels, regions, hidden = self._real(labels, regions, views)
        return labels, [self._observe(r, labels, hidden[i], frames) for i, r in enumerate(regions)], hidden

    def _real(
        self, labels: npt.NDArray[np.int32], regions: list[Region], views: Mapping[str, Mask]
    ) -> tuple[npt.NDArray[np.int32], list[Region], Any]:
        """What is no ghost, with its hidden fractions (n, cameras): NaN where a view sees no cell of the object."""
        hidden = (
            hidden_fractions(labels, list(views.values()), [self._stations[name] for name in views])
            if len(regions) > 1
            else np.zeros((len(regions), len(views)))
        )
        visible = [self._visible[name] for name in views]
        if regions and not all(seen.all() for seen in visible):
            cells = [np.bincount(labels[seen], minlength=len(regions) + 1)[1:] for seen in visible]
            hidden[np.column_stack(cells) == 0] = np.nan
        if self.settings.remove_ghosts and len(views) > 1 and regions:
            real = np.nanmin(hidden, axis=1) < 0.5
            if not real.all():
                renumber = _new_labels(real)
                labels, hidden = renumber[labels], hidden[real]
                regions = [replace(r, label=int(renumber[r.label])) for r in regions if renumber[r.label]]
        return labels, regions, hidden

    def _observe(self, region: Region, labels: Image, hidden: Any, frames: Mapping[str, Image]) -> Observation:
        floor = self.rig.floor
        cell = region.centroid if self.settings.position == "centroid" else region.middle
        x, y = (
            float(low + (c + 0.5) * floor.resolution) for low, c in zip((floor.x[0], floor.y[0]), cell, strict=True)
        )
        best = list(frames)[int(np.nanargmin(hidden))]
        return Observation(
            position_m=(x, y),
            area_m2=region.area * floor.cell_area,
            colour=self._colour(region, labels, best, frames[best]),
            hidden_in=_hidden_in(hidden, frames, HIDDEN),
            visible=_visible(hidden, frames),
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

    # --- the map -------------------------------------------------------------------------------------
    def _map(
        self, labels: Image, candidates: Mask, views: Mapping[str, Mask], occupied: Mask
    ) -> tuple[OccupancyMap, npt.NDArray[np.uint8]]:
        """Occupied where an object is; free where a view looks at bare floor; else unknown, with the reason."""
        floor = self.rig.floor
        count = np.sum([self._visible[name] for name in views], axis=0) if views else np.zeros(floor.shape, int)
        bare = np.zeros(floor.shape, bool)
        for name, view in views.items():
            bare |= self._visible[name] & ~view
        lost = np.zeros(floor.shape, bool)  # a camera that is excluded leaves its cells to one view: not free
        for name in self.rig.cameras.keys() - views.keys():
            lost |= self._visible[name] & (count < self._needed)
        reason = np.zeros(floor.shape, np.uint8)
        reason[occupied | ~bare] = DISAGREE
        reason[~bare & (count < self._needed) | lost] = ONE_VIEW
        reason[candidates] = UNCONFIRMED
        reason[count == 0] = BLIND
        reason[labels > 0] = 0
        return occupancy_map(labels > 0, reason == 0, floor), reason


def backgrounds_of(recording: Recording, *, samples: int = 60, progress: bool = False) -> dict[str, Background]:
    """Each camera's background: the mean of its empty pictures, or else learned from ``samples`` of its frames."""
    backgrounds = {name: average_background(images) for name, images in recording.background_images().items()}
    if unknown := recording.without_background:
        pictures = recording.sample(samples)
        for name in tqdm(unknown, desc="learning the background", unit="camera", disable=None if progress else True):
            backgrounds[name] = learn_background(pictures[name])
    return {name: backgrounds[name] for name in recording.sources}
