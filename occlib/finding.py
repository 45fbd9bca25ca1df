"""Objects as regions of the fused evidence (section 5), and what every way of finding objects takes and gives.

A finder turns one instant (:class:`Instant`) into the objects that stand on the floor (:class:`Found`). There are two of one shape: the
paper's, whose objects are connected regions of the fused views, here; and the one that asks which objects
explain all silhouettes, :mod:`occlib.explaining`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.foreground.background import Background
from occlib.foreground.evidence import Evidence
from occlib.geometry import Rig
from occlib.identification import Identified, Identifier, IdentifierSettings
from occlib.localization import Region, find_regions, split_regions
from occlib.occlusion import RULES, fuse, hidden_fractions
from occlib.registration import FloorWarp
from occlib.tracking import ObjectVector, Observation

Labels = npt.NDArray[np.int32]

HIDDEN = 0.9
"""An object is *hidden* in a view from this fraction on."""
GHOST = 0.5
"""A region of which every view has at least this fraction behind other objects is a ghost: those explain it."""
LARGEST_JOIN_M = 10.0
"""Fragments this far apart are no longer one object; the reach in cells is also the size of a mask in memory."""
COLOUR_CELLS = 32
"""At most so many cells of a region are looked at for its colour."""


# --- what every finder takes and gives ---------------------------------------------------------------
class FloorViews:
    """The cameras' views on one floor: how each is warped to it, and which cells it sees.

    Parameters
    ----------
    rig
        Floor and cameras.

    Attributes
    ----------
    needed
        So many cameras must see a cell before it is called occupied: one view alone cannot tell an object from its shadow.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig, self.floor = rig, rig.floor
        self.warps = {name: FloorWarp(camera, rig.floor) for name, camera in rig.cameras.items()}
        self.visible = {name: warp.visible for name, warp in self.warps.items()}
        self.stations = {n: rig.floor.cells(c.centre_m[None, :2])[0] for n, c in rig.cameras.items()}
        self.needed = min(2, len(rig.cameras))

    def fuse(self, views: Mapping[str, Image], rule: str) -> Mask:
        """The cells that the rule calls occupied, bool (ny, nx), from the views' masks on the floor, or from probabilities."""
        if not views:
            return np.zeros(self.floor.shape, bool)
        visible = [self.visible[name] for name in views]
        everywhere = all(seen.all() for seen in visible)
        fused = fuse(list(views.values()), rule, visible=None if everywhere else visible) > 0.5
        return fused if RULES[rule].one_view_enough else fused & (np.sum(visible, axis=0) >= self.needed)


@dataclass(frozen=True)
class Instant:
    """What the cameras that can be trusted show at one instant.

    Parameters
    ----------
    images
        ``{camera: uint8 RGB (H, W, 3)}``.
    evidence
        Each view's evidence.
    on_floor
        Its values warped to the floor, uint8 (ny, nx).
    """

    images: Mapping[str, Image]
    evidence: Mapping[str, Evidence]
    on_floor: Mapping[str, Image]

    @cached_property
    def views(self) -> dict[str, Mask]:
        """Each view's foreground on the floor, bool (ny, nx)."""
        return self.above({name: evidence.level for name, evidence in self.evidence.items()})

    def above(self, levels: Mapping[str, int]) -> dict[str, Mask]:
        """The cells where each view's evidence exceeds a level, bool (ny, nx)."""
        return {name: values > levels[name] for name, values in self.on_floor.items()}


class Found(NamedTuple):
    """The objects of one instant.

    Parameters
    ----------
    occupied
        The fused foreground, before noise and ghosts are dropped, bool (ny, nx).
    labels
        int32 (ny, nx): 0, or the index of the cell's object plus 1.
    observations
        One for each object.
    hidden
        How much of each object nearer objects hide from each camera of the instant, (N, K), 0 to 1; NaN where it is out of view.
    hidden_by
        Index of the object that hides most of it, (N, K); -1 if none does, or none is known.
    identify
        The label of object ``index``, where it is recognised only when asked for.
    """

    occupied: Mask
    labels: Labels
    observations: list[Observation]
    hidden: FloatArray
    hidden_by: npt.NDArray[np.int64]
    identify: Callable[[int], str | None] | None = None


class Finder(Protocol):
    """Anything that finds the objects of an instant; it may remember the last ones."""

    def find(self, instant: Instant) -> Found:
        """The objects of the next instant."""


def region_rules() -> list[str]:
    """The fusion rules whose regions can be objects, by name: all that need no planes above the floor."""
    return [name for name, rule in RULES.items() if not rule.planes]


# --- objects as regions ------------------------------------------------------------------------------
@dataclass(frozen=True)
class Regions:
    """Settings of :class:`RegionFinder`: objects are connected regions of the fused evidence.

    Parameters
    ----------
    rule
        Fusion rule, one of :data:`occlib.occlusion.RULES` but ``"planes"``; ``"and"`` is the paper's.
    core
        Evidence above this many times the threshold is an object's core; a region with several cores is split. 0: never.
    join_m
        Fragments of evidence no further apart, in m, are one object, if every view connects them.
    min_area_m2
        Less evidence, in m2, is noise.
    position
        ``"centroid"`` (Eq 3, 4) or ``"middle"`` of the extent, which a half-hidden footprint disturbs less.
    remove_ghosts
        Drop regions that every view sees only behind other objects: those explain them.
    identify
        Look for known objects in each view by template matching and measure them with the look-up table (sections 3 and 4).
    """

    rule: str = "and"
    core: float = 1.5
    join_m: float = 0.2
    min_area_m2: float = 0.015
    position: str = "middle"
    remove_ghosts: bool = True
    identify: IdentifierSettings | None = None

    def __post_init__(self) -> None:
        checks.choice("rule", self.rule, region_rules())
        checks.choice("position", self.position, ("centroid", "middle"))
        checks.number("join_m", self.join_m, least=0, most=LARGEST_JOIN_M, unit="metres")
        checks.number("min_area_m2", self.min_area_m2, least=0, unit="m2")
        checks.number("core", self.core, least=0)

    def build(
        self, floor_views: FloorViews, backgrounds: Mapping[str, Background], templates: Mapping[str, Image]
    ) -> RegionFinder:
        """The finder with these settings."""
        if templates and self.identify is None:
            raise ValueError(f"templates: expected rule explain or profile paper, which know objects, got {self.rule}")
        return RegionFinder(floor_views, self, backgrounds, templates)


class RegionFinder:
    """Objects as connected regions of the fused views (section 5; Figs 8, 11).

    Parameters
    ----------
    floor_views
        The cameras on the floor.
    settings
        How regions become objects.
    backgrounds, templates
        For identification only: each camera's empty floor, and pictures of known objects by label.
    """

    def __init__(
        self,
        floor_views: FloorViews,
        settings: Regions,
        backgrounds: Mapping[str, Background],
        templates: Mapping[str, Image],
    ) -> None:
        self.floor_views, self.settings = floor_views, settings
        self.identifier = settings.identify and Identifier(
            {name: warp.pixels for name, warp in floor_views.warps.items()},
            floor_views.rig,
            backgrounds,
            settings.identify,
            templates,
        )

    def find(self, instant: Instant) -> Found:
        """Fuse, group, part what touches, drop ghosts, measure."""
        occupied = self._fused(instant)
        labels, regions = self._grouped(occupied, instant)
        labels, regions, hidden = self._real(labels, regions, instant.views)
        known = self.identifier.identify(instant.images, instant.evidence, labels) if self.identifier else {}
        observations = [
            self._observe(r, labels, hidden[i], instant.images, known.get(i)) for i, r in enumerate(regions)
        ]
        return Found(occupied, labels, observations, hidden, np.full(hidden.shape, -1))

    def _fused(self, instant: Instant) -> Mask:
        rule = self.settings.rule
        if not RULES[rule].soft:
            return self.floor_views.fuse(instant.views, rule)
        odds = {n: instant.evidence[n].weights()[values] / 510 + 0.5 for n, values in instant.on_floor.items()}
        return self.floor_views.fuse(odds, rule)

    def _grouped(self, occupied: Mask, instant: Instant) -> tuple[Labels, list[Region]]:
        """Regions of the fused evidence, fragments joined, neighbours parted."""
        floor, settings = self.floor_views.floor, self.settings
        smallest = settings.min_area_m2 / floor.cell_area
        labels, regions = find_regions(
            occupied,
            min_area=smallest,
            join=round(settings.join_m / floor.resolution),
            within=list(instant.views.values()) if RULES[settings.rule].unanimous else (),
        )
        if not (settings.core and regions):
            return labels, regions
        cores = instant.above({name: e.core_level(settings.core) for name, e in instant.evidence.items()})
        core = self.floor_views.fuse(cores, settings.rule)
        return split_regions(labels, regions, core, min_area=smallest, within=list(cores.values()))

    def _real(
        self, labels: Labels, regions: list[Region], views: Mapping[str, Mask]
    ) -> tuple[Labels, list[Region], FloatArray]:
        """What is no ghost, with its hidden fractions (n, cameras): NaN where a view sees no cell of the object."""
        hidden = (
            hidden_fractions(labels, list(views.values()), [self.floor_views.stations[name] for name in views])
            if len(regions) > 1
            else np.zeros((len(regions), len(views)))
        )
        visible = [self.floor_views.visible[name] for name in views]
        if regions and not all(seen.all() for seen in visible):
            cells = [np.bincount(labels[seen], minlength=len(regions) + 1)[1:] for seen in visible]
            hidden[np.column_stack(cells) == 0] = np.nan
        if self.settings.remove_ghosts and len(views) > 1 and regions:
            real = np.nanmin(hidden, axis=1) < GHOST
            if not real.all():
                renumber = new_labels(real)
                labels, hidden = renumber[labels], hidden[real]
                regions = [replace(r, label=int(renumber[r.label])) for r in regions if renumber[r.label]]
        return labels, regions, hidden

    def _observe(
        self, region: Region, labels: Labels, hidden: FloatArray, images: Mapping[str, Image], known: Identified | None
    ) -> Observation:
        floor = self.floor_views.floor
        cell = region.centroid if self.settings.position == "centroid" else region.middle
        x, y = floor.points(cell).tolist()
        best = list(images)[int(np.nanargmin(hidden))]
        return Observation(
            position_m=(x, y),
            area_m2=region.area * floor.cell_area,
            colour=self._colour(region, labels, best, images[best]),
            label=known and known.label,
            size_m2=known and known.size_m2,
            hidden_in=hidden_in(hidden, images, HIDDEN),
            visible=visible_shares(hidden, images),
        )

    def _colour(self, region: Region, labels: Labels, name: str, image: Image) -> tuple[int, int, int]:
        """Mean colour that this view shows in the object's cells."""
        left, top, width, height = region.box
        iy, ix = np.nonzero(labels[top : top + height, left : left + width] == region.label)
        chosen = np.arange(min(COLOUR_CELLS, len(iy))) * len(iy) // min(COLOUR_CELLS, len(iy))
        pixels = self.floor_views.warps[name].pixels[iy[chosen] + top, ix[chosen] + left]
        pixels = np.rint(pixels[np.isfinite(pixels[:, 0])]).astype(int)
        if not len(pixels):
            return (0, 0, 0)
        r, g, b = image[pixels[:, 1], pixels[:, 0]].mean(axis=0)
        return (round(float(r)), round(float(g)), round(float(b)))


# --- what both finders say of an object -----------------------------------------------------------------
def visible_shares(hidden: FloatArray, cameras: Iterable[str]) -> dict[str, float]:
    """The share of an object that each camera sees, from its hidden fractions; cameras that do not view it are left out."""
    pairs = zip(cameras, hidden, strict=True)
    return {name: round(float(1 - fraction), 4) for name, fraction in pairs if np.isfinite(fraction)}


def hidden_in(hidden: FloatArray, cameras: Iterable[str], limit: float) -> tuple[str, ...]:
    """The cameras from which at least the fraction ``limit`` of an object is hidden."""
    return tuple(name for name, fraction in zip(cameras, hidden, strict=True) if fraction >= limit)


# --- confirmed or not -------------------------------------------------------------------------------------
def confirmed_only(labels: Labels, objects: Sequence[ObjectVector]) -> tuple[Labels, Mask]:
    """Labels of the confirmed objects alone, renumbered, and the cells of the others."""
    real = np.array([one.id > 0 for one in objects], bool)
    if real.all():
        return labels, np.zeros(labels.shape, bool)
    confirmed = new_labels(real)[labels]
    return confirmed, (labels > 0) & (confirmed == 0)


def new_labels(kept: Mask) -> Labels:
    """The new label of each old one, 0 to n: 1, 2, ... for what is kept, 0 for the rest."""
    return np.concatenate([[0], np.where(kept, np.cumsum(kept), 0)]).astype(np.int32)
