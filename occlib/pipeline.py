"""Frames in, a map and its objects out: the stages in the paper's order (Fig 3)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from occlib.explaining import DEFAULT, Cylinder, Explanation, PolarEvidence, explain, occlusion_state, standing_points
from occlib.foreground import (
    SURE,
    Background,
    adjust_intensity,
    as_background,
    average_background,
    foreground_evidence,
    learn_background,
    smooth,
    subtract_background,
    threshold_level,
)
from occlib.geometry import FloatArray, Floor, Image, Mask, Rig
from occlib.health import CameraMonitor
from occlib.localization import Region, find_regions, split_regions
from occlib.mapping import BLIND, DISAGREE, ONE_VIEW, UNCONFIRMED, OccupancyMap, occupancy_map
from occlib.matching import similarity
from occlib.occlusion import RULES, axis_colours, fuse, hidden_fractions, standing_places
from occlib.recordings import Recording, check_size
from occlib.registration import FloorWarp, PolarWarp
from occlib.tracking import ObjectVector, Observation, Tracker

HIDDEN = 0.9
"""An object is *hidden* in a view from this fraction on."""
HIDDEN_ESTIMATE = 0.96
"""The same for the estimate from cylinders, which lose a little of what still sticks out."""
NEAR_M = 0.02
"""What a sharp silhouette may lack of an object's rim on the floor, in m."""
PLANES_M = (0.0, 0.1, 0.3, 0.6, 1.0, 1.4)
"""Heights at which something that stands is looked for: where feet are hidden, the body still places it."""
LIKENESS, DISTINCT = 38.0, 1.1
"""Mean absolute difference, in grey levels, up to which an object resembles a template, and by how much another must be worse."""


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
        ``"evidence"``: shadows and reflections left out, :func:`occlib.foreground.foreground_evidence`. Else the difference is
        thresholded: ``"otsu"``, ``"half-otsu"``, ``"triangle"``, ``"noise"`` or grey levels; see
        :func:`occlib.foreground.threshold_level`.
    min_level
        Grey levels that a threshold found by a rule is never below.
    core
        Evidence above this many times the threshold (before ``min_level``) is an object's core; a region with several
        cores is split. 0: never.
    rule
        ``"explain"``: the fewest objects that explain all silhouettes, :func:`occlib.explaining.explain`. Else a fusion rule
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
        standing = [replace(thing, x=x, y=y) for thing, (x, y) in zip(things, points, strict=True)]
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


class _Explainer:
    """Turns the views' evidence into polar views, and keeps the last instant's objects."""

    def __init__(self, rig: Rig, backgrounds: Mapping[str, Background], how: Explanation = DEFAULT) -> None:
        self.how, self.before = how, list[Cylinder]()
        # a picture of fewer px is sampled finer: the objects are as large
        self.polar = {n: PolarWarp(c, rig.floor, 3.0 * min(1.0, c.size[0] / 640)) for n, c in rig.cameras.items()}
        # a dark background says little against a dark object
        light = {
            n: w.warp(cv2.GaussianBlur(backgrounds[n].image, (9, 9), 0)).mean(axis=2) for n, w in self.polar.items()
        }
        self.certain = {
            n: (np.clip((l - 40) / 60, 0.05, 1) * how.background).astype(np.float32) for n, l in light.items()
        }
        self.coarse = Floor(rig.floor.x, rig.floor.y, max(how.grid_m, rig.floor.resolution))
        self.planes = {n: [FloorWarp(c, self.coarse, h) for h in PLANES_M] for n, c in rig.cameras.items()}
        self.visible = {n: np.stack([plane.visible for plane in planes]) for n, planes in self.planes.items()}

    def explain(self, evidence: Mapping[str, tuple[Image, int]]) -> list[Cylinder]:
        """The objects of this instant from each camera's evidence and the level above which it is foreground."""
        views = []
        for name, warp in self.polar.items():
            if name in evidence:
                picture, level = evidence[name]
                soft = _weights(level)[warp.warp(picture)]
                soft = np.where(soft > 0, soft, soft * self.certain[name]) * warp.visible
                views.append((warp.parameters, soft.astype(np.int32), warp.visible))
            else:
                views.append((warp.parameters, np.zeros(warp.shape, np.int32), np.zeros(warp.shape, bool)))
        self.evidence = PolarEvidence.of(views)
        if evidence:
            votes = [
                np.stack([plane.warp(e) > at for plane in self.planes[name]]) for name, (e, at) in evidence.items()
            ]
            visible = [self.visible[name] for name in evidence]
            places = standing_places(votes, visible, self.coarse, level=0, views=min(2, len(self.polar)))
            self.before = explain(self.evidence, places, before=self.before, how=self.how)
        else:
            self.before = []
        return self.before

    def state(self, cameras: Iterable[str]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Hidden fractions of the objects, (n, cameras), and what hides them."""
        fractions, by = occlusion_state(self.evidence, self.before)
        chosen = [list(self.polar).index(name) for name in cameras]
        return fractions[:, chosen], by[:, chosen]


def _weights(level: int) -> npt.NDArray[np.float32]:
    """Evidence 0 to 255 to weights -255 to 255, 0 at the level: straight for soft evidence, steep for a difference."""
    steep = 255 / 127.5 if level == SURE - 1 else 2.5 * 255 / max(level, 1)
    return np.clip((np.arange(256) - (level + 0.5)) * steep, -255, 255).astype(np.float32)


def footprints(things: Sequence[Cylinder], occupied: Mask, floor: Floor) -> npt.NDArray[np.int32]:
    """The cells of each object: those under the cylinder, and evidence within a quarter radius + 5 cm of it.

    Returns
    -------
    int32 (ny, nx): 0, or the object's index plus 1; a cell between two belongs to the nearer rim.
    """
    labels, nearest = np.zeros(floor.shape, np.int32), np.full(floor.shape, np.inf, np.float32)
    for number, thing in enumerate(things, start=1):
        spare = 0.05 + 0.25 * thing.radius
        reach = thing.radius + spare
        low, high = floor.cells([[thing.x - reach, thing.y - reach], [thing.x + reach, thing.y + reach]])
        (x0, y0), (x1, y1) = (np.clip(corner, 0, floor.shape[::-1]).astype(int) for corner in (low, high + 2))
        iy, ix = np.mgrid[y0:y1, x0:x1]
        x = floor.x[0] + (ix + 0.5) * floor.resolution
        y = floor.y[0] + (iy + 0.5) * floor.resolution
        rim = (np.hypot(x - thing.x, y - thing.y) - thing.radius).astype(np.float32)
        mine = (rim < nearest[iy, ix]) & ((rim <= 0) | ((rim <= spare) & occupied[iy, ix]))
        nearest[iy[mine], ix[mine]] = rim[mine]
        labels[iy[mine], ix[mine]] = number
    return labels


def _confirmed_first(
    labels: npt.NDArray[np.int32], objects: Sequence[ObjectVector]
) -> tuple[npt.NDArray[np.int32], Mask]:
    """Labels of the confirmed objects alone, renumbered, and the cells of the others."""
    real = np.array([thing.id > 0 for thing in objects], bool)
    if real.all():
        return labels, np.zeros(labels.shape, bool)
    confirmed = _new_labels(real)[labels]
    return confirmed, (labels > 0) & (confirmed == 0)


def _new_labels(kept: Mask) -> npt.NDArray[np.int32]:
    """The new label of each old one, 0 to n: 1, 2, ... for what is kept, 0 for the rest."""
    return np.concatenate([[0], np.where(kept, np.cumsum(kept), 0)]).astype(np.int32)


def _template(label: str, picture: Any) -> tuple[Image, Mask | None]:
    """A template's colours and the pixels that count."""
    picture = np.asarray(picture)
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] not in (3, 4) or min(picture.shape[:2]) < 4:
        raise ValueError(
            f"templates[{label!r}]: expected uint8 RGB or RGBA of 4 x 4 px or more, got {picture.dtype} {picture.shape}"
        )
    if picture.shape[2] == 3:
        return picture, None
    if not (picture[..., 3] > 127).any():
        raise ValueError(f"templates[{label!r}]: expected pixels that are more opaque than not, got none")
    return np.ascontiguousarray(picture[..., :3]), picture[..., 3] > 127


def _likeness(window: Image, picture: Image, mask: Mask | None, height: int) -> float:
    """Least mean absolute difference of a template, resized to about ``height``, in a window; infinite if it does not fit."""
    best = np.inf
    for scale in height / len(picture) * np.array([0.8, 0.9, 1.0, 1.1, 1.25]):
        size = tuple(round(float(scale * side)) for side in picture.shape[1::-1])
        if 4 <= min(size) and size[0] <= window.shape[1] and size[1] <= window.shape[0]:
            resized = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
            used = None if mask is None else cv2.resize(mask.view(np.uint8), size).astype(bool)
            if used is None or used.any():
                best = min(best, float(similarity(window, resized, "sad", used).min()))
    return best


def _box(thing: Cylinder, rig: Rig, name: str) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of an object in a view, in whole px; it may reach beyond the picture."""
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.column_stack([thing.x + thing.radius * np.cos(turn), thing.y + thing.radius * np.sin(turn)])
    points = rig[name].project(np.vstack([np.column_stack([ring, np.full(24, z)]) for z in (0.0, thing.height)]))
    left, top = np.floor(points.min(axis=0)).astype(int).tolist()
    right, bottom = np.ceil(points.max(axis=0)).astype(int).tolist()
    return left, top, right, bottom


def _visible(hidden: FloatArray, cameras: Iterable[str]) -> dict[str, float]:
    pairs = zip(cameras, hidden, strict=True)
    return {name: round(float(1 - fraction), 4) for name, fraction in pairs if np.isfinite(fraction)}


def _hidden_in(hidden: FloatArray, cameras: Iterable[str], limit: float) -> tuple[str, ...]:
    return tuple(name for name, fraction in zip(cameras, hidden, strict=True) if fraction >= limit)


def _hidden_by(
    objects: Sequence[ObjectVector], hidden: FloatArray, by: npt.NDArray[np.int64], cameras: Sequence[str]
) -> list[dict[str, tuple[float, int]]]:
    return [
        {
            name: (float(hidden[i, k]), objects[by[i, k]].id if by[i, k] >= 0 else -1)
            for k, name in enumerate(cameras)
            if hidden[i, k] > 0.5
        }
        for i in range(len(objects))
    ]


def backgrounds_of(recording: Recording, *, samples: int = 60, progress: bool = False) -> dict[str, Background]:
    """Each camera's background: the mean of its empty pictures, or else learned from ``samples`` of its frames."""
    backgrounds = {name: average_background(images) for name, images in recording.background_images().items()}
    if unknown := recording.without_background:
        pictures = recording.sample(samples)
        for name in tqdm(unknown, desc="learning the background", unit="camera", disable=None if progress else True):
            backgrounds[name] = learn_background(pictures[name])
    return {name: backgrounds[name] for name in recording.sources}
