"""DOC"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.explaining.cylinders import Cylinder
from occlib.explaining.evidence import PolarEvidence, PolarWarp
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.search import DEFAULT, ExplainSettings, explain
from occlib.foreground.background import Background
from occlib.foreground.shadows import SURE
from occlib.geometry import Floor, Rig
from occlib.registration import FloorWarp


class MaskExplainer:
    """Explains away with masks alone: ``{camera: mask}`` to cylinders, :func:`occlib.explaining.search.explain`.

    Parameters
    ----------
    rig
        The cameras.
    how
        Thresholds of the explanation.
    step_rad
        Angle between two samples of the polar views.
    planes_m
        Heights at which something that stands is looked for, in m.
    spare
        So many views may miss an object: it is looked for where all but ``spare`` of them have foreground, but in two at
        least. 0 is what :func:`occlib.explaining.explainer.standing_places` does.
    """

    def __init__(
        self,
        rig: Rig,
        how: ExplainSettings = DEFAULT,
        *,
        step_rad: float = 0.0045,
        planes_m: Sequence[float] = (0.0, 0.1, 0.3),
        spare: int = 0,
    ) -> None:
        self.how, self.spare = how, spare
        self._polar = {n: PolarWarp(c, rig.floor, step_rad * float(c.matrix[0, 0])) for n, c in rig.cameras.items()}
        self._coarse = Floor(rig.floor.x, rig.floor.y, max(how.grid_m, rig.floor.resolution))
        self._planes = {n: [FloorWarp(c, self._coarse, z) for z in planes_m] for n, c in rig.cameras.items()}
        self._visible = {n: np.stack([plane.visible for plane in planes]) for n, planes in self._planes.items()}

    def explain(self, masks: Mapping[str, Mask], before: Sequence[Cylinder] = ()) -> list[Cylinder]:
        """The cylinders that explain the masks of one instant, ``{camera: bool (H, W)}``; ``before``: those of the last."""
        views = []
        for name, mask in masks.items():
            warp = self._polar[name]
            share = warp.warp(np.where(mask, np.uint8(255), np.uint8(0))).astype(np.float64) / 255
            signed = np.where(share > 0.5, 255 * (2 * share - 1), 255 * self.how.background * (2 * share - 1))
            views.append((warp.parameters, np.rint(signed * warp.visible).astype(np.int32), warp.visible))
        votes = {name: np.stack([plane.warp(mask) for plane in self._planes[name]]) for name, mask in masks.items()}
        standing = np.unique(
            np.vstack(
                [
                    standing_places(
                        [votes[n] for n in team], [self._visible[n] for n in team], self._coarse, level=0, views=fewest
                    )
                    for fewest in [min(2, len(masks))]
                    for team in combinations(masks, max(fewest, len(masks) - self.spare))
                ]
            ),
            axis=0,
        )
        return explain(PolarEvidence.of(views), standing, previous=before, settings=self.how)


def standing_places(
    evidence: Sequence[Image], visible: Sequence[Mask], floor: Floor, *, level: float = 127, views: int = 2
) -> FloatArray:
    """Where something may stand: cells over which, on some plane, every view that sees it says foreground.

    Parameters
    ----------
    evidence, visible
        For each view soft evidence on parallel planes and what it sees of them, (planes, ny, nx).
    floor
        Of these cells; coarse cells do.
    level
        Evidence above this is foreground.
    views
        At least so many views must see a cell on the plane.

    Returns
    -------
    Floor points (N, 2) in m.
    """
    votes = np.logical_and.reduce([~seen | (e > level) for e, seen in zip(evidence, visible, strict=True)])
    votes &= np.sum(visible, axis=0) >= views
    iy, ix = np.nonzero(votes.any(axis=0))
    return np.column_stack([floor.x[0] + (ix + 0.5) * floor.resolution, floor.y[0] + (iy + 0.5) * floor.resolution])


HIDDEN_ESTIMATE = 0.96
"""The same for the estimate from cylinders, which lose a little of what still sticks out."""


PLANES_M = (0.0, 0.1, 0.3, 0.6, 1.0, 1.4)
"""Heights at which something that stands is looked for: where feet are hidden, the body still places it."""


class _Explainer:
    """Turns the views' evidence into polar views, and keeps the last instant's objects."""

    def __init__(self, rig: Rig, backgrounds: Mapping[str, Background], how: ExplainSettings = DEFAULT) -> None:
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
            self.before = explain(self.evidence, places, previous=self.before, settings=self.how)
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
