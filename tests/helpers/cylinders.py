"""Upright cylinders as the polar views of some cameras show them, worked out ray by ray and sample by sample."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import assume
from hypothesis import strategies as st

from occlib.explaining.cylinders import Cylinder, plausible, silhouette
from occlib.explaining.evidence import PolarEvidence, PolarView, PolarWarp
from occlib.explaining.objective import Gain, gain, workspace
from occlib.lab.scenes import load_scene

Array = np.ndarray[Any, Any]
Point = tuple[float, float]
LEFT_RIGHT, THREE, FOUR = ("left", "right"), ("left", "right", "front"), ("left", "right", "front", "back")
BACKGROUND = 0.6  # weight of the background, as the pipeline has it
BIG, SMALL = Cylinder(-0.3, 0.05, 0.27, 0.9), Cylinder(0.45, 0.06, 0.11, 0.16)
LOW = Cylinder(0.2, 0.06, 0.11, 0.16)  # so near that from the right it stands before BIG


@dataclasses.dataclass(frozen=True)
class Watch:
    """The polar views of some cameras, and the ray of every sample in the world."""

    views: list[PolarView]
    sizes: Array
    seen: Array
    rays: Array

    def evidence(self, weights: Array | None = None) -> PolarEvidence:
        """Of these weights (K, rows, columns), where something is seen; without, no view says anything."""
        weights = np.zeros(self.seen.shape) if weights is None else weights * self.seen
        return PolarEvidence(np.array(self.views), self.sizes, weights.astype(np.int32), self.seen)


@cache
def watch(cameras: tuple[str, ...] = LEFT_RIGHT, scene: str = "four_robots", step_px: float = 2.0) -> Watch:
    rig = load_scene(scene).rig
    polar = [PolarWarp(rig[name], rig.floor, step_px) for name in cameras]
    views, sizes = [p.parameters for p in polar], np.array([p.shape[::-1] for p in polar], np.int64)
    columns, rows = sizes.max(axis=0)
    seen = np.zeros((len(polar), rows, columns), bool)
    rays = np.zeros((*seen.shape, 3))
    for k, (warp, view) in enumerate(zip(polar, views, strict=True)):
        seen[k, : warp.shape[0], : warp.shape[1]] = warp.visible
        azimuth = view.middle + view.left + view.step * np.arange(columns)[None, :]
        depression = view.top + view.step * np.arange(rows)[:, None]
        rays[k, ..., 0] = np.cos(azimuth) * np.cos(depression)
        rays[k, ..., 1] = np.sin(azimuth) * np.cos(depression)
        rays[k, ..., 2] = -np.sin(depression)
    return Watch(views, sizes, seen, rays)


def station(view: PolarView) -> Array:
    """Where its camera hangs, (x, y, z) in m."""
    return np.array([view.x, view.y, view.height])


def hit(origin: Array, rays: Array, cylinder: Cylinder) -> Array:
    """Which rays meet an upright solid cylinder: some t lies within its round wall and between floor and top."""
    o = origin - [cylinder.x, cylinder.y, 0]
    a, b = (rays[..., :2] ** 2).sum(-1), rays[..., :2] @ o[:2]
    inside = b * b - a * (o[:2] @ o[:2] - cylinder.radius**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        near, far = (-b - np.sqrt(inside)) / a, (-b + np.sqrt(inside)) / a
        floor, top = -o[2] / rays[..., 2], (cylinder.height - o[2]) / rays[..., 2]
    low, high = np.maximum(near, np.minimum(floor, top)), np.minimum(far, np.maximum(floor, top))
    return np.asarray((inside >= 0) & (low <= high) & (high > 0))


def sample_masks(at: Watch, cylinder: Cylinder) -> Array:
    """The cylinder's samples in every view, bool (K, rows, columns), whether the camera sees them or not."""
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        masks[k, :rows, :columns] = hit(station(at.views[k]), at.rays[k, :rows, :columns], cylinder)
    return masks


def run_masks(at: Watch, cylinder: Cylinder) -> Array:
    """The same from :func:`silhouette`."""
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes.tolist()):
        first, low, high = silhouette(at.views[k], columns, rows, cylinder)
        assert 0 <= first <= first + len(low) <= columns
        for i in range(len(low)):
            assert 0 <= low[i] <= high[i] <= rows
            masks[k, low[i] : high[i], first + i] = True
    return masks


def seen_from(cameras: tuple[str, ...], cylinders: Sequence[Cylinder]) -> PolarEvidence:
    """Ideal evidence: surely foreground where a ray meets one of the cylinders, else background."""
    at = watch(cameras)
    foreground = np.any([sample_masks(at, c) for c in cylinders] or [np.zeros(at.seen.shape, bool)], axis=0)
    return at.evidence(np.where(foreground, 255, -round(255 * BACKGROUND)))


def random_weights(at: Watch, seed: int) -> Array:
    weights = np.random.default_rng(seed).integers(-255, 256, at.seen.shape)
    return np.asarray(weights * at.seen, np.int32)


def gain_of(at: Watch, weights: Array, cylinder: Cylinder, cost: float) -> Gain:
    work = workspace(at.evidence(weights))
    found: Gain = gain(work, work.sums, cylinder, cost)
    return found


def floor_places(evidence: PolarEvidence, step: float = 0.08) -> Array:
    """Where something may stand: floor points that no view calls bare at the floor and at all of three heights."""
    x, y = np.meshgrid(np.arange(-1.96, 2, step), np.arange(-1.46, 1.5, step))
    possible = np.zeros(x.shape, bool)
    for height in (0.0, 0.1, 0.3):
        here = np.ones(x.shape, bool)
        for row, weights, seen in zip(evidence.views, evidence.weights, evidence.seen, strict=True):
            view = PolarView(*row)
            azimuth = (np.arctan2(y - view.y, x - view.x) - view.middle + np.pi) % (2 * np.pi) - np.pi
            depression = np.arctan2(view.height - height, np.hypot(x - view.x, y - view.y))
            i = np.clip(np.rint((azimuth - view.left) / view.step), 0, weights.shape[1] - 1).astype(int)
            j = np.clip(np.rint((depression - view.top) / view.step), 0, weights.shape[0] - 1).astype(int)
            here &= (weights[j, i] >= 0) | ~seen[j, i]
        possible |= here
    return np.column_stack([x[possible], y[possible]])


def plausible_cylinder(x: float, y: float, radius: float, height: float) -> Cylinder:
    assume(plausible(radius, height))
    return Cylinder(x, y, radius, height)


plausible_cylinders = st.builds(
    plausible_cylinder,
    x=st.floats(-1.7, 1.7),
    y=st.floats(-1.2, 1.2),
    radius=st.floats(0.06, 0.4),
    height=st.floats(0.05, 1.9),
)


def crowd(count: int, seed: int) -> list[Cylinder]:
    """Cylinders of many sizes, 15 cm apart or more."""
    rng = np.random.default_rng(seed)
    cylinders: list[Cylinder] = []
    while len(cylinders) < count:
        x, y, radius, height = rng.uniform([-1.6, -1.1, 0.08, 0.1], [1.6, 1.1, 0.25, 0.5]).tolist()
        apart = all(np.hypot(x - c.x, y - c.y) > radius + c.radius + 0.15 for c in cylinders)
        if apart and plausible(radius, height):
            cylinders.append(Cylinder(x, y, radius, height))
    return cylinders


def assert_found(
    found: Sequence[Cylinder], planted: Sequence[Cylinder], *, metres: float = 0.02, size: float = 0.15
) -> None:
    """Each planted cylinder is found, once, and nothing else is."""
    assert len(found) == len(planted), f"{len(found)} for {len(planted)}: {found}"
    left = list(found)
    for cylinder in planted:
        nearest = min(left, key=lambda c: float(np.hypot(c.x - cylinder.x, c.y - cylinder.y)))
        left.remove(nearest)
        assert np.hypot(nearest.x - cylinder.x, nearest.y - cylinder.y) < metres, (cylinder, nearest)
        assert nearest.radius == pytest.approx(cylinder.radius, rel=size), (cylinder, nearest)
        assert nearest.height == pytest.approx(cylinder.height, rel=size), (cylinder, nearest)
