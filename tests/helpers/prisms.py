"""Upright prisms as the polar views of some cameras show them, worked out ray by ray and sample by sample."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import assume
from hypothesis import strategies as st

from occlib.explaining.evidence import PolarEvidence, PolarView, PolarWarp
from occlib.explaining.objective import Gain, gain, workspace
from occlib.explaining.prisms import BOX, OUTLINES, Prism, plausible
from occlib.explaining.silhouettes import LEGS, silhouette
from occlib.lab.scenes import load_scene

Array = np.ndarray[Any, Any]
Point = tuple[float, float]
LEFT_RIGHT, THREE, FOUR = ("left", "right"), ("left", "right", "front"), ("left", "right", "front", "back")
BACKGROUND = 0.6  # weight of the background, as the pipeline has it
BIG, SMALL = Prism(-0.3, 0.05, 0.27, 0.9), Prism(0.45, 0.06, 0.11, 0.16)
LOW = Prism(0.2, 0.06, 0.11, 0.16)  # so near that from the right it stands before BIG


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

    def around(self, columns: int, rows: int) -> Watch:
        """The same with so many columns and rows more on all sides, which no camera sees."""
        views = [v._replace(left=v.left - columns * v.step, top=v.top - rows * v.step) for v in self.views]
        seen = np.pad(self.seen, [(0, 0), (rows, rows), (columns, columns)])
        return Watch(views, self.sizes + 2 * np.array([columns, rows]), seen, rays_of(views, seen.shape))


def rays_of(views: Sequence[PolarView], shape: tuple[int, ...]) -> Array:
    rays = np.zeros((*shape, 3))
    for k, view in enumerate(views):
        azimuth = view.middle + view.left + view.step * np.arange(shape[2])[None, :]
        depression = view.top + view.step * np.arange(shape[1])[:, None]
        rays[k, ..., 0] = np.cos(azimuth) * np.cos(depression)
        rays[k, ..., 1] = np.sin(azimuth) * np.cos(depression)
        rays[k, ..., 2] = -np.sin(depression)
    return rays


@cache
def watch(cameras: tuple[str, ...] = LEFT_RIGHT, scene: str = "four_robots", step_px: float = 2.0) -> Watch:
    rig = load_scene(scene).rig
    polar = [PolarWarp(rig[name], rig.floor, step_px) for name in cameras]
    views, sizes = [p.parameters for p in polar], np.array([p.shape[::-1] for p in polar], np.int64)
    columns, rows = sizes.max(axis=0)
    seen = np.zeros((len(polar), rows, columns), bool)
    for k, warp in enumerate(polar):
        seen[k, : warp.shape[0], : warp.shape[1]] = warp.visible
    return Watch(views, sizes, seen, rays_of(views, seen.shape))


def station(view: PolarView) -> Array:
    """Where its camera hangs, (x, y, z) in m."""
    return np.array([view.x, view.y, view.height])


# --- rays and solids -------------------------------------------------------------------------------------------
def between(here: Array, slope: Array) -> tuple[Array, Array]:
    """First and last t with ``here + t slope >= 0``; the first is infinite where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -here / slope
    near = np.where(slope > 0, crossing, np.where((slope == 0) & (here < 0), np.inf, -np.inf))
    return near, np.where(slope < 0, crossing, np.inf)


def hit_column(origin: Array, rays: Array, prism: Prism, scale: float, bottom: float, top: float) -> Array:
    """Which rays meet the prism's outline, ``scale`` times as large, drawn up from one height to another."""
    turn = np.array([[np.cos(prism.heading), np.sin(prism.heading)], [-np.sin(prism.heading), np.cos(prism.heading)]])
    o, d = turn @ (origin[:2] - [prism.x, prism.y]), rays[..., :2] @ turn.T  # along its length and its width
    spans = [between(origin[2] - bottom, rays[..., 2]), between(top - origin[2], -rays[..., 2])]
    corners = np.array(list(OUTLINES.values())[int(prism.outline)])
    if len(corners):
        corners = corners * scale * prism.radius * [1, prism.ratio]
        for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            inwards = np.array([ay - by, bx - ax])
            spans.append(between((o - [ax, ay]) @ inwards, d @ inwards))
    else:
        a, b, c = (d**2).sum(-1), d @ o, o @ o - (scale * prism.radius) ** 2
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - a * c)
            near, far = (-b - root) / a, (-b + root) / a
        spans.append((np.nan_to_num(near, nan=np.inf), np.nan_to_num(far, nan=-np.inf)))
    low, high = np.max([low for low, _ in spans], axis=0), np.min([high for _, high in spans], axis=0)
    return np.asarray((low <= high) & (high > 0))


def hit(origin: Array, rays: Array, prism: Prism) -> Array:
    """Which rays meet an upright solid prism that stands on the floor: below its waist or above it."""
    waist = prism.waist * prism.height
    met = hit_column(origin, rays, prism, 1.0, 0.0, waist)
    if prism.waist >= 1:
        return met
    spare = (1 - prism.upper) * prism.radius  # so far may the upper part be moved before it is flush
    x, y = prism.x + prism.lean * spare * np.cos(prism.heading), prism.y + prism.lean * spare * np.sin(prism.heading)
    return met | hit_column(origin, rays, prism._replace(x=x, y=y), prism.upper, waist, prism.height)


def sample_masks(at: Watch, prism: Prism) -> Array:
    """The prism's samples in every view, bool (K, rows, columns), whether the camera sees them or not."""
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        masks[k, :rows, :columns] = hit(station(at.views[k]), at.rays[k, :rows, :columns], prism)
    return masks


def mirror_masks(at: Watch, prism: Prism) -> Array:
    """The samples of its image in a level mirror on the floor: a ray that meets the floor goes up again from there."""
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        below = station(at.views[k]) * [1, 1, -1]  # from where the ray seems to come
        masks[k, :rows, :columns] = hit(below, at.rays[k, :rows, :columns] * [1, 1, -1], prism)
    return masks


def run_masks(at: Watch, prism: Prism) -> Array:
    """As :func:`sample_masks`, from :func:`silhouette`."""
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes.tolist()):
        first, low, high = silhouette(at.views[k], columns, rows, prism)
        assert 0 <= first <= first + len(low) <= columns
        for i in range(len(low)):
            assert 0 <= low[i] <= high[i] <= rows
            masks[k, low[i] : high[i], first + i] = True
    return masks


def leg_masks(at: Watch, prism: Prism) -> Array:
    """Of a person or a table, the samples of the silhouette whose rays pass below the hip or the top."""
    from_m = (prism.waist if prism.waist < 1 else LEGS) * prism.height
    upper = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        origin, rays = station(at.views[k]), at.rays[k, :rows, :columns]
        upper[k, :rows, :columns] = hit_column(origin, rays, prism, 1.0, from_m, prism.height)
    return lower_rows(sample_masks(at, prism), upper)


def lower_rows(masks: Array, above: Array) -> Array:
    """The samples of ``masks`` that lie below all of ``above`` in the same column."""
    rows = np.arange(masks.shape[1])[None, :, None]
    return np.asarray(masks & (rows > np.where(above, rows, -1).max(axis=1, keepdims=True)))


# --- evidence --------------------------------------------------------------------------------------------------
def seen_from(cameras: tuple[str, ...], prisms: Sequence[Prism]) -> PolarEvidence:
    """Ideal evidence: surely foreground where a ray meets one of the prisms, else background."""
    at = watch(cameras)
    return shown(at, np.any([sample_masks(at, p) for p in prisms] or [np.zeros(at.seen.shape, bool)], axis=0))


def shown(at: Watch, foreground: Array) -> PolarEvidence:
    """Surely foreground there, else background."""
    return at.evidence(np.where(foreground, 255, -round(255 * BACKGROUND)))


def person(at: Watch, feet: tuple[Point, Point], lean: Point = (0.0, 0.0)) -> Array:
    """Samples of two legs and of a trunk and head above them, moved by ``lean``, bool (K, rows, columns)."""
    x, y = np.mean(feet, axis=0) + lean
    masks = np.zeros(at.seen.shape, bool)
    for k, (columns, rows) in enumerate(at.sizes):
        origin, rays = station(at.views[k]), at.rays[k, :rows, :columns]
        parts = [(0.0, Prism(*foot, 0.07, 0.8)) for foot in feet]
        parts += [(0.75, Prism(x, y, 0.2, 0.7)), (1.4, Prism(x, y, 0.1, 0.28))]
        for z, part in parts:
            masks[k, :rows, :columns] |= hit(origin - [0, 0, z], rays, part)
    return masks


def random_weights(at: Watch, seed: int) -> Array:
    weights = np.random.default_rng(seed).integers(-255, 256, at.seen.shape)
    return np.asarray(weights * at.seen, np.int32)


def gain_of(at: Watch, weights: Array, prism: Prism, cost: float, gloss: Sequence[float] | None = None) -> Gain:
    work = workspace(at.evidence(weights), gloss)
    found: Gain = gain(work, work.sums, prism, cost)
    return found


def floor_places(evidence: PolarEvidence, step: float = 0.08, heights: Sequence[float] = (0.0, 0.1, 0.3)) -> Array:
    """Where something may stand: floor points that at some height no view calls bare."""
    x, y = np.meshgrid(np.arange(-1.96, 2, step), np.arange(-1.46, 1.5, step))
    possible = np.zeros(x.shape, bool)
    for height in heights:
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


# --- random prisms ---------------------------------------------------------------------------------------------
def some_prism(**fields: float) -> Prism:
    return Prism(**fields)


def plausible_prism(**fields: float) -> Prism:
    prism = Prism(**fields)
    assume(plausible(prism))
    return prism


SOMEWHERE: dict[str, Any] = {"x": st.floats(-1.7, 1.7), "y": st.floats(-1.2, 1.2)}
HEADED: dict[str, Any] = {"outline": st.just(BOX), "heading": st.floats(-4, 4), "ratio": st.floats(0.2, 1)}
WAIST: dict[str, Any] = {
    "radius": st.floats(0.08, 0.5),
    "height": st.floats(0.2, 1.9),
    "waist": st.floats(0.1, 0.9),
    "upper": st.floats(0.1, 0.9),
    "lean": st.sampled_from([0.0, 0.0, 1.0, -1.0, 0.4]),
}

plausible_cylinders = st.builds(plausible_prism, **SOMEWHERE, radius=st.floats(0.06, 0.4), height=st.floats(0.05, 1.9))
plausible_boxes = st.builds(
    plausible_prism, **SOMEWHERE, **HEADED, radius=st.floats(0.08, 0.8), height=st.floats(0.03, 1.2)
)
with_waists = st.one_of(
    st.builds(some_prism, **SOMEWHERE, **WAIST, heading=st.floats(-4, 4)),
    st.builds(some_prism, **SOMEWHERE, **HEADED, **WAIST),
)
tables = st.builds(
    some_prism,
    **SOMEWHERE,
    **HEADED,
    radius=st.floats(0.25, 0.8),
    height=st.floats(0.3, 1.0),
    waist=st.floats(0.75, 0.97),
)
any_prisms = st.one_of(plausible_cylinders, plausible_boxes, with_waists, tables)
"""Round ones, boxes, either with a waist, of whatever size, and tables."""


def crowd(count: int, seed: int) -> list[Prism]:
    """Cylinders of many sizes, 15 cm apart or more."""
    rng = np.random.default_rng(seed)
    cylinders: list[Prism] = []
    while len(cylinders) < count:
        x, y, radius, height = rng.uniform([-1.6, -1.1, 0.08, 0.1], [1.6, 1.1, 0.25, 0.5]).tolist()
        apart = all(np.hypot(x - c.x, y - c.y) > radius + c.radius + 0.15 for c in cylinders)
        if apart and plausible(Prism(x, y, radius, height)):
            cylinders.append(Prism(x, y, radius, height))
    return cylinders


def assert_found(found: Sequence[Prism], planted: Sequence[Prism], *, metres: float = 0.02, size: float = 0.15) -> None:
    """Each planted cylinder is found, once, and nothing else is."""
    assert len(found) == len(planted), f"{len(found)} for {len(planted)}: {found}"
    left = list(found)
    for prism in planted:
        nearest = min(left, key=lambda c: float(np.hypot(c.x - prism.x, c.y - prism.y)))
        left.remove(nearest)
        assert np.hypot(nearest.x - prism.x, nearest.y - prism.y) < metres, (prism, nearest)
        assert nearest.radius == pytest.approx(prism.radius, rel=size), (prism, nearest)
        assert nearest.height == pytest.approx(prism.height, rel=size), (prism, nearest)
