"""What a fusion rule makes of perfect silhouettes: crowds of upright objects under one to eight wall cameras.

There is no picture and no noise: rays are cast against exact shapes, so whatever goes wrong on the floor is due to the
geometry or to the rule. Views may be made to *miss* objects on purpose.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # whose `stats` loads when used, and slowly

from occlib.base import checks
from occlib.base.arrays import FloatArray, Mask, as_points
from occlib.base.intervals import t_interval
from occlib.explaining import Explainer, Explaining
from occlib.foreground import Evidence
from occlib.geometry import Floor, Rig
from occlib.lab.crowds import base_m, places_m, solid_m, truth_of
from occlib.lab.ghosts import LEAST_AREA_M2, crossings, expected_crossings, ghost_regions
from occlib.lab.scenes import Scene, SceneObject
from occlib.lab.truth import depth_image
from occlib.localization import find_regions
from occlib.metrics import claimed_area_ratio, evaluate, footprint_coverage
from occlib.occlusion import RULES, fuse
from occlib.registration import FloorWarp

PLANES_M = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
"""Planes of the rule ``"planes"``: what reaches through half of them, so something at least 0.15 m high, is kept."""


SILHOUETTE_STEP_PX = 2.13
"""Sampling of polar views in px: exact silhouettes bear finer samples than those of pictures."""
EXPLAIN = ("explain", "explain, one spare")
"""Rules that search for objects instead of voting on cells; in the second, one view may miss an object."""


@dataclass(frozen=True)
class Simulation:
    """Perfect silhouettes of crowds as a rig's cameras see them, and what a rule makes of them.

    Parameters
    ----------
    rig
        One or more cameras.
    trust
        What a view's "yes" and "no" are worth as probabilities, for the rules that weigh evidence. A "yes" may be
        another object's shadow, so it is worth less than a "no".
    settings
        For the rules ``"explain"`` and ``"explain, one spare"``: the latter looks also where one view sees nothing.

    Examples
    --------
    >>> from occlib.lab import random_crowd, wall_rig
    >>> simulation = Simulation(wall_rig(2))
    >>> crowd = random_crowd(2, np.random.default_rng(1))
    >>> found = simulation.places(simulation.masks(crowd), "and")
    >>> bool(np.linalg.norm(found[:, None] - places_m(crowd), axis=2).min(axis=0).max() < 0.1)
    True
    """

    rig: Rig
    trust: tuple[float, float] = (0.8, 0.1)
    settings: Explaining = field(default_factory=lambda: Explaining(step_px=SILHOUETTE_STEP_PX))

    @cached_property
    def _scene(self) -> Scene:
        """Holds the pixels' rays; the objects come later."""
        return Scene("crowd", Path(), None, self.rig, frames=1, background=0, seed=0, fps=10.0, objects=())

    @cached_property
    def _warps(self) -> dict[str, FloorWarp]:
        return {name: FloorWarp(camera, self.rig.floor) for name, camera in self.rig.cameras.items()}

    @cached_property
    def _planes(self) -> dict[str, list[FloorWarp]]:
        return {n: [FloorWarp(c, self.rig.floor, z) for z in PLANES_M] for n, c in self.rig.cameras.items()}

    @cached_property
    def _explainers(self) -> dict[str, Explainer]:
        search = self.settings.search
        spares = enumerate(EXPLAIN)
        return {n: Explainer(self.rig, replace(self.settings, search=search._replace(spare=k / 3))) for k, n in spares}

    def silhouettes(self, crowd: Sequence[SceneObject]) -> dict[str, Mask]:
        """Each object's silhouette as if it were alone, ``{camera: bool (n, H, W)}``."""
        seen = {}
        for name, camera in self.rig.cameras.items():
            seen[name] = np.zeros((len(crowd), *camera.size[::-1]), bool)
            for mask, each in zip(seen[name], crowd, strict=True):
                depth, window = depth_image(self._scene, camera, each, 0)
                mask[window] = np.isfinite(depth)
        return seen

    def masks(self, crowd: Sequence[SceneObject], kept: Mapping[str, Mask] | None = None) -> dict[str, Mask]:
        """Each camera's foreground, ``{camera: bool (H, W)}``.

        ``kept``: for each camera bool (n,), False for an object that this view misses; all for None.
        """
        seen = {}
        for name, camera in self.rig.cameras.items():
            seen[name] = np.zeros(camera.size[::-1], bool)
            for i, each in enumerate(crowd):
                if kept is None or kept[name][i]:
                    depth, window = depth_image(self._scene, camera, each, 0)
                    seen[name][window] |= np.isfinite(depth)
        return seen

    def on_floor(self, masks: Mapping[str, Mask]) -> dict[str, Mask]:
        """The masks as shadows on the floor, ``{camera: bool (ny, nx)}``."""
        return {name: self._warps[name].warp(mask) for name, mask in masks.items()}

    def shadows(self, crowd: Sequence[SceneObject]) -> dict[str, Mask]:
        """Each object's shadow on the floor as if it were alone, ``{camera: bool (n, ny, nx)}``.

        Their :func:`union` is :meth:`on_floor` of :meth:`masks`: cast once, they serve every rule that votes on the
        floor, every choice among the cameras and every pattern of misses.
        """
        return {
            name: np.reshape([self._warps[name].warp(mask) for mask in masks], (len(crowd), *self.rig.floor.shape))
            for name, masks in self.silhouettes(crowd).items()
        }

    def occupied(self, masks: Mapping[str, Mask], rule: str = "and") -> Mask:
        """The map of a rule of :func:`occlib.occlusion.fuse`, bool (ny, nx).

        Where the rig has two cameras or more, at least two must see a cell.
        """
        if not RULES[checks.choice("rule", rule, RULES)].planes:
            return self.fused(self.on_floor(masks), rule)
        visible: list[Mask] = [self._warps[name].visible for name in masks]
        views = [np.stack([plane.warp(mask) for plane in self._planes[name]]) for name, mask in masks.items()]
        fused = fuse(views, rule, visible=[np.stack([p.visible for p in self._planes[name]]) for name in masks])
        return np.asarray(fused & (np.sum(visible, axis=0) >= min(2, len(masks))), dtype=bool)

    def fused(self, views: Mapping[str, Mask], rule: str = "and") -> Mask:
        """The map of a rule that votes on the floor, bool (ny, nx); ``views``: ``{camera: bool (ny, nx)}``."""
        if RULES[checks.choice("rule", rule, RULES)].planes:
            raise ValueError(f"rule: expected one that needs the floor alone, got {rule!r}")
        visible: list[Mask] = [self._warps[name].visible for name in views]
        if RULES[rule].soft:
            yes, no = self.trust
            fused = fuse([np.where(view, yes, no) for view in views.values()], rule, visible=visible) > 0.5
        else:
            fused = fuse(list(views.values()), rule, visible=visible)
        return np.asarray(fused & (np.sum(visible, axis=0) >= min(2, len(views))), dtype=bool)

    def places(self, masks: Mapping[str, Mask], rule: str = "and") -> FloatArray:
        """Where a rule puts objects, (N, 2) in m: centroids of its regions, or axes of the explaining cylinders."""
        if rule in EXPLAIN:
            return as_points([(c.x, c.y) for c in self._explainers[rule].explain(evidence_of(masks)).prisms])
        return region_places(self.occupied(masks, rule), self.rig.floor)

    def cost_ms(self, masks: Sequence[Mapping[str, Mask]], rule: str, *, repeats: int = 3) -> float:
        """Median time from the masks of an instant to the objects' places, in ms, after one run to warm up."""
        self.places(masks[0], rule)
        times = []
        for _ in range(repeats):
            for views in masks:
                start = time.perf_counter()
                self.places(views, rule)
                times.append(1000 * (time.perf_counter() - start))
        return float(np.median(times))


def measured_smear_m(simulation: Simulation, scene_object: SceneObject) -> float:
    """How far in m a cylinder's shadow reaches beyond it, read off the floor map of the rig's only camera."""
    ((name, camera),) = simulation.rig.cameras.items()
    floor, shadow = simulation.rig.floor, simulation.on_floor(simulation.masks([scene_object]))[name]
    axis = places_m([scene_object])[0] - camera.centre_m[:2]
    distance = float(np.linalg.norm(axis))
    offset = floor.cell_centres_m()[shadow.ravel()] - camera.centre_m[:2]
    along, across = offset @ axis / distance, (offset[:, 0] * axis[1] - offset[:, 1] * axis[0]) / distance
    reach = along[np.abs(across) <= floor.resolution].max() + floor.resolution / 2
    return float(reach - distance - scene_object.parts[0].size[0] / 2)


def score(
    simulation: Simulation,
    masks: Sequence[Mapping[str, Mask]],
    crowds: Sequence[Sequence[SceneObject]],
    rule: str = "and",
    *,
    radius: float = 0.3,
) -> dict[str, float]:
    """What :func:`occlib.metrics.evaluate` says of a rule on these crowds; NaN where it says nothing.

    Parameters
    ----------
    simulation
        Whose cameras took the masks.
    masks
        For each crowd ``{camera: bool (H, W)}``.
    crowds
        Who stands there.
    rule
        One of :data:`occlib.occlusion.RULES` or :data:`EXPLAIN`.
    radius
        Within which a detection is right, in m.
    """
    return score_places([simulation.places(views, rule) for views in masks], crowds, radius=radius)


def region_places(occupied: Mask, floor: Floor) -> FloatArray:
    """Centroids of a map's regions, (N, 2) in m; those smaller than :data:`LEAST_AREA_M2` are left out."""
    regions = find_regions(occupied, min_area=LEAST_AREA_M2 / floor.cell_area)[1]
    return floor.points([region.centroid for region in regions])


def score_places(
    found: Sequence[FloatArray], crowds: Sequence[Sequence[SceneObject]], *, radius: float = 0.3
) -> dict[str, float]:
    """As :func:`score`, of the places (N, 2) in m that were found for each crowd."""
    result = evaluate(dict(enumerate(found)), truth_of(crowds), radius=radius)
    values = {
        "MODA": result.moda,
        "ghosts a frame": result.ghosts_per_frame,
        "precision": result.precision,
        "recall": result.recall,
        "median error (cm)": None if result.error_median_m is None else 100 * result.error_median_m,
    }
    return {name: np.nan if value is None else float(value) for name, value in values.items()}


def two_view_study(rig: Rig, crowds: Sequence[Sequence[SceneObject]]) -> dict[str, float]:
    """Ghosts a frame of the AND of two cameras: by the law, predicted, measured; and its scores. Means over crowds.

    ``measured, low`` and ``measured, high`` are the ends of the 95 % interval over the crowds.
    """
    simulation, floor = Simulation(rig), rig.floor
    maps = [simulation.occupied(simulation.masks(crowd)) for crowd in crowds]
    pairs = list(zip(maps, crowds, strict=True))
    tall = float(np.mean([solid_m(each)[:, 2].max() for crowd in crowds for each in crowd]))
    ratios = [claimed_area_ratio(one, floor, [base_m(each) for each in crowd]) for one, crowd in pairs]
    measured, low, high = t_interval([ghost_regions(one, crowd, floor) for one, crowd in pairs])
    return {
        "law": expected_crossings(rig, len(crowds[0]), tall),
        "predicted": float(np.mean([len(crossings(rig, crowd)) for crowd in crowds])),
        "measured": measured,
        "measured, low": low,
        "measured, high": high,
        "claimed / true": float(np.mean([ratio for ratio in ratios if ratio is not None])),
        **score_places([region_places(one, floor) for one in maps], crowds),
    }


def recall_study(
    rig: Rig,
    crowds: Sequence[Sequence[SceneObject]],
    *,
    cameras: Sequence[int],
    recalls: Sequence[float],
    rules: Sequence[str],
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Share of the objects that each rule keeps when every view misses objects at random.

    Parameters
    ----------
    rig
        Its first ``cameras`` are used, so that shadows are cast once.
    crowds
        Of equally many objects.
    cameras, recalls, rules
        How many cameras, the share of the objects that a single view segments, and rules that vote on the floor.
    rng
        For the misses.

    Returns
    -------
    Rows ``{"cameras", "r", "rule", "expected", "found"}``: the share by the binomial law, and the share of the objects
    of which the map covers at least half the base.
    """
    simulation, rows = Simulation(rig), []
    shadows, count = [simulation.shadows(crowd) for crowd in crowds], len(crowds[0])
    for k, recall in product(cameras, recalls):
        names = list(rig.cameras)[:k]
        kept = [misses(names, count, recall, rng) for _ in crowds]
        views = [union({n: one[n] for n in names}, seen) for one, seen in zip(shadows, kept, strict=True)]
        for rule in rules:
            found = [
                footprint_coverage(simulation.fused(one, rule), rig.floor, [base_m(each) for each in crowd]) >= 0.5
                for one, crowd in zip(views, crowds, strict=True)
            ]
            expected = scipy.stats.binom.sf(votes_needed(rule, k, simulation.trust) - 1, k, recall)
            row = {"cameras": k, "r": recall, "rule": rule, "expected": float(expected)}
            rows.append({**row, "found": float(np.mean(np.concatenate(found)))})
    return rows


def evidence_of(masks: Mapping[str, Mask]) -> dict[str, Evidence]:
    """Masks ``{camera: bool (H, W)}`` as evidence that is sure of every pixel."""
    return {name: Evidence.of_mask(mask) for name, mask in masks.items()}


def union(silhouettes: Mapping[str, Mask], kept: Mapping[str, Mask] | None = None) -> dict[str, Mask]:
    """One mask a camera of silhouettes ``{camera: bool (n, H, W)}``; of those ``kept`` alone, ``{camera: bool (n,)}``."""
    return {n: np.any(one if kept is None else one[kept[n]], axis=0) for n, one in silhouettes.items()}


def misses(cameras: Iterable[str], count: int, recall: float, rng: np.random.Generator) -> dict[str, Mask]:
    """Which of ``count`` objects each camera segments, each with probability ``recall``, ``{camera: bool (n,)}``.

    >>> {name: kept.all() for name, kept in misses(["left"], 3, 1.0, np.random.default_rng(0)).items()}
    {'left': np.True_}
    """
    checks.number("recall", recall, least=0, most=1, unit="a probability")
    return {name: np.asarray(rng.random(count) < recall) for name in cameras}


def votes_needed(rule: str, cameras: int, trust: tuple[float, float] = (0.8, 0.1)) -> int:
    """How many of the cameras must say "yes" before a cell is occupied: with hard masks every rule is a vote.

    >>> [votes_needed(rule, 4) for rule in ("and", "most", "product", "log-odds", "or")]
    [4, 3, 4, 3, 1]
    """
    yes, no = trust if RULES[rule].soft else (1.0, 0.0)
    for count in range(1, cameras + 1):
        if fuse([np.array([[yes if i < count else no]]) for i in range(cameras)], rule)[0, 0] > 0.5:
            return count
    return cameras + 1
