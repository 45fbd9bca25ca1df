"""From the views of one instant to the objects that explain them: the finder beyond AND.

Each view's evidence becomes a polar view (:class:`occlib.explaining.evidence.PolarWarp`); places where something may
stand are looked for on planes above the floor; then the fewest prisms that explain all views are searched,
:func:`occlib.explaining.search.explain`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.explaining.appearance import _box, _likeness, axis_colours
from occlib.explaining.evidence import PolarEvidence, PolarWarp
from occlib.explaining.feet import standing_points
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.mirror import mirrored_shares
from occlib.explaining.prisms import Prism, beyond_outline_m, outline_points
from occlib.explaining.refining import DEFAULT, ExplainSettings
from occlib.explaining.search import Explanation, explain
from occlib.finding import FloorViews, Found, Instant, hidden_in, visible_shares
from occlib.foreground.background import Background
from occlib.foreground.evidence import Evidence
from occlib.foreground.intensity import adjust_intensity
from occlib.geometry import Floor, Rig
from occlib.identification import opaque_part
from occlib.registration import FloorWarp
from occlib.tracking import Observation

REFERENCE_WIDTH_PX = 640
"""A picture of fewer px a row is sampled finer in proportion: the objects in it are as large."""
CLOSE_M, CLOSE_SHARE = 0.05, 0.25
"""Evidence this far beyond a prism's rim, in m and as a share of its radius, still belongs to the object's footprint."""

AROUND_M = 0.5
"""Objects are looked for so far beyond the floor, in m: what stands there explains silhouettes, too, but is not listed."""

FORGET = 0.8
"""Share that the floor's gloss keeps of its former estimate from one instant to the next."""


@dataclass(frozen=True)
class Explaining:
    """Settings of :class:`ExplainingFinder`: objects are upright prisms that explain all silhouettes.

    Parameters
    ----------
    search
        Cost and limits of the search.
    step_px
        Angle between two samples of a polar view, in px of a picture at least 640 px wide, at its middle.
    planes_m
        Heights in m at which something that stands is looked for: where feet are hidden, the body still places it.
    dark_level, light_level
        Grey levels: what is no darker than the floor there speaks against an object, fully where the floor is brighter than
        ``light_level`` and hardly where it is darker than ``dark_level``: a dark floor looks like a dark object.
    least_certainty
        Share of its weight that background keeps on the darkest floor.
    hidden
        An object is *hidden* in a view from this estimated fraction on; prisms lose a little of what still sticks out.
    rim_m
        What a sharp silhouette may lack of an object's rim on the floor, in m.
    likeness
        Mean absolute difference in grey levels up to which an object resembles a template.
    distinct
        By how much, as a factor, every other template must be less alike.
    plain
        An object is compared with the templates in a view that hides less than this fraction of it.
    """

    search: ExplainSettings = DEFAULT
    step_px: float = 3.0
    planes_m: tuple[float, ...] = (0.0, 0.1, 0.3, 0.6, 1.0, 1.4)
    dark_level: float = 40.0
    light_level: float = 100.0
    least_certainty: float = 0.05
    hidden: float = 0.96
    rim_m: float = 0.02
    likeness: float = 38.0
    distinct: float = 1.1
    plain: float = 0.2

    rule = "explain"

    def __post_init__(self) -> None:
        checks.number("step_px", self.step_px, least=0.1, most=100, unit="px")
        if not self.planes_m:
            raise ValueError("planes_m: expected one or more heights in metres, got none")
        checks.number("spare", self.search.spare, least=0, most=1, unit="a share")
        for height in self.planes_m:
            checks.number("planes_m", height, least=0, most=10, unit="metres")
        checks.number(
            "dark_level", self.dark_level, least=0, most=self.light_level - 1, unit="grey levels, below light_level"
        )
        checks.number("rim_m", self.rim_m, least=0, most=1, unit="metres")

    def build(
        self, floor_views: FloorViews, backgrounds: Mapping[str, Background], templates: Mapping[str, Image]
    ) -> ExplainingFinder:
        """The finder with these settings."""
        return ExplainingFinder(floor_views, self, backgrounds, templates)


class Explainer:
    """Turns the views' evidence into the prisms that explain it.

    Parameters
    ----------
    rig
        The cameras.
    settings
        Of the polar views and the search.
    backgrounds
        Each camera's empty floor, which tells how much its background is worth; all the same without.

    Examples
    --------
    >>> from occlib.recordings import LAB
    >>> rig = Rig.load(LAB / "robot" / "rig.yaml")
    >>> nothing = {name: Evidence.of_mask(np.zeros((480, 640), bool)) for name in rig.cameras}
    >>> Explainer(rig).explain(nothing).prisms
    []
    """

    def __init__(
        self, rig: Rig, settings: Explaining = Explaining(), backgrounds: Mapping[str, Background] | None = None
    ) -> None:
        self.rig, self.settings = rig, settings
        self.warps = {
            name: PolarWarp(camera, rig.floor, settings.step_px * min(1.0, camera.size[0] / REFERENCE_WIDTH_PX))
            for name, camera in rig.cameras.items()
        }
        self._certainty = {
            name: self._certain(name, None if backgrounds is None else backgrounds[name]) for name in rig.cameras
        }
        (x0, x1), (y0, y1) = rig.floor.x, rig.floor.y
        grid = max(settings.search.grid_m, rig.floor.resolution)
        self._coarse = Floor((x0 - AROUND_M, x1 + AROUND_M), (y0 - AROUND_M, y1 + AROUND_M), grid)
        self._planes = {
            name: [FloorWarp(camera, self._coarse, height) for height in settings.planes_m]
            for name, camera in rig.cameras.items()
        }
        self._visible = {name: np.stack([plane.visible for plane in planes]) for name, planes in self._planes.items()}

    def _certain(self, name: str, background: Background | None) -> npt.NDArray[np.float32] | np.float32:
        """How much each sample weighs where it says background."""
        whole = self.settings.search.background
        if background is None:
            return np.float32(whole)
        levels = self.warps[name].warp(cv2.GaussianBlur(background.image, (9, 9), 0)).mean(axis=2)
        dark, light = self.settings.dark_level, self.settings.light_level
        share = np.clip((levels - dark) / (light - dark), self.settings.least_certainty, 1)
        return (share * whole).astype(np.float32)

    def polar(self, evidence: Mapping[str, Evidence]) -> PolarEvidence:
        """The polar views of an instant; a camera without evidence says nothing."""
        views = []
        for name, warp in self.warps.items():
            if name in evidence:
                weights = evidence[name].weights()[warp.warp(self._blurred(name, evidence[name].values))]
                weights = np.where(weights > 0, weights, weights * self._certainty[name]) * warp.visible
                views.append((warp.parameters, weights.astype(np.int32), warp.visible))
            else:
                views.append((warp.parameters, np.zeros(warp.shape, np.int32), np.zeros(warp.shape, bool)))
        return PolarEvidence.of(views)

    def _blurred(self, name: str, values: Image) -> Image:
        """Evidence averaged over the px of a sample, where a sample is far larger than a pixel."""
        side = int(self.warps[name].spacing_px / 2)
        return values if side < 2 else np.asarray(cv2.blur(values, (side, side)))

    def places(self, evidence: Mapping[str, Evidence]) -> FloatArray:
        """Floor points (N, 2) in m where something may stand."""
        fewest = min(2, len(self.warps))
        votes = {
            name: np.stack([plane.warp(values) > level for plane in self._planes[name]])
            for name, (values, _, level, _) in evidence.items()
        }
        found = [
            standing_places(
                [votes[n] for n in team], [self._visible[n] for n in team], self._coarse, level=0, views=fewest
            )
            for team in combinations(
                evidence,
                max(min(fewest, len(evidence)), len(evidence) - int(self.settings.search.spare * len(evidence))),
            )
        ]
        return found[0] if len(found) == 1 else np.unique(np.vstack(found), axis=0)

    def explain(
        self,
        evidence: Mapping[str, Evidence],
        previous: Explanation | None = None,
        *,
        polar: PolarEvidence | None = None,
        gloss: Sequence[float] | None = None,
    ) -> Explanation:
        """The prisms that explain one instant.

        Parameters
        ----------
        evidence
            Of each camera that can be trusted.
        previous
            What explained the last instant, a second start of the search.
        polar
            What :meth:`polar` makes of the evidence, where that is known already.
        gloss
            For each camera how much of an object the floor mirrors to it, 0 to 1.
        """
        if not evidence:
            return Explanation([])
        polar = self.polar(evidence) if polar is None else polar
        return explain(polar, self.places(evidence), previous=previous, gloss=gloss, settings=self.settings.search)


class ExplainingFinder:
    """Objects as the prisms that explain the silhouettes of all views, from one instant to the next.

    Parameters
    ----------
    floor_views
        The cameras on the floor.
    settings
        Of the search and of what is said about objects.
    backgrounds
        Each camera's empty floor.
    templates
        Pictures of known objects by label.

    Attributes
    ----------
    explanation
        Of the last instant, with prisms also beyond the floor's edge.
    gloss
        How much of an object the floor mirrors to each camera, 0 to 1, as far as is known.
    """

    def __init__(
        self,
        floor_views: FloorViews,
        settings: Explaining,
        backgrounds: Mapping[str, Background],
        templates: Mapping[str, Image],
    ) -> None:
        self.floor_views, self.settings, self.backgrounds = floor_views, settings, backgrounds
        self.explainer = Explainer(floor_views.rig, settings, backgrounds)
        self.templates = {label: opaque_part(label, picture) for label, picture in templates.items()}
        self.explanation: Explanation | None = None
        self.gloss = [0.0] * len(floor_views.rig.cameras)
        side = 2 * round(settings.rim_m / floor_views.floor.resolution) + 1
        self._rim = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))

    def find(self, instant: Instant) -> Found:
        """Explain, place, measure."""
        floor, images = self.floor_views.floor, instant.images
        polar = self.explainer.polar(instant.evidence)
        explained = self.explainer.explain(instant.evidence, self.explanation, polar=polar, gloss=self.gloss)
        everything = explained.prisms
        self._learn_gloss(polar, everything)
        hidden, by = self._hidden(polar, everything, instant)
        points = standing_points(polar, everything).tolist()
        standing = [prism._replace(x=x, y=y) for prism, (x, y) in zip(everything, points, strict=True)]
        (x0, x1), (y0, y1) = floor.x, floor.y
        on_floor = np.array([x0 <= p.x <= x1 and y0 <= p.y <= y1 for p in standing], bool)
        self.explanation = explained
        standing, prisms = ([p for p, kept in zip(ps, on_floor, strict=True) if kept] for ps in (standing, everything))
        hidden, by = hidden[on_floor], renumbered(by[on_floor], on_floor)
        occupied = self.floor_views.fuse(instant.views, "and")
        labels = footprints(standing, self._near(occupied), floor)
        areas = np.bincount(labels.ravel(), minlength=len(standing) + 1)[1:] * floor.cell_area
        observations = [
            Observation(
                (prism.x, prism.y),
                float(areas[i]),
                self._colour(prisms[i], hidden[i], images),
                hidden_in=hidden_in(hidden[i], images, self.settings.hidden),
                visible=visible_shares(hidden[i], images),
            )
            for i, prism in enumerate(standing)
        ]
        identify = (lambda i: self._identify(prisms[i], hidden[i], images)) if self.templates else None
        return Found(occupied, labels, observations, hidden, by, identify)

    def _learn_gloss(self, polar: PolarEvidence, prisms: Sequence[Prism]) -> None:
        """The median of what each view shows of the objects' mirror images, averaged over the last instants."""
        shares = mirrored_shares(polar, prisms)
        for k in range(len(self.gloss)):
            clear = shares[:, k][np.isfinite(shares[:, k])]
            if len(clear):
                self.gloss[k] = FORGET * self.gloss[k] + (1 - FORGET) * float(np.median(clear))

    def _near(self, occupied: Mask) -> Mask:
        """Cells that count as an object's where they are near it: the fused foreground, and a sharp silhouette's rim."""
        return cv2.dilate(occupied.view(np.uint8), self._rim).view(np.bool_)

    def _hidden(
        self, polar: PolarEvidence, prisms: Sequence[Prism], instant: Instant
    ) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Hidden fractions of the objects, (n, cameras), and what hides them."""
        fractions, by = occlusion_state(polar, prisms)
        chosen = [list(self.explainer.warps).index(name) for name in instant.images]
        return fractions[:, chosen], by[:, chosen]

    def _colour(self, prism: Prism, hidden: FloatArray, images: Mapping[str, Image]) -> tuple[int, int, int]:
        """Mean colour along an object's axis, in the view that sees most of it."""
        best = list(images)[_least_hidden(hidden)]
        seen = axis_colours([(prism.x, prism.y)], prism.height, {best: images[best]}, self.floor_views.rig)
        r, g, b = np.nan_to_num(seen[0, 0])
        return round(float(r)), round(float(g)), round(float(b))

    def _identify(self, prism: Prism, hidden: FloatArray, images: Mapping[str, Image]) -> str | None:
        """The template that an object clearly resembles most in the view that sees it best."""
        least = _least_hidden(hidden)
        if not hidden[least] < self.settings.plain:
            return None
        name = list(images)[least]
        left, top, right, bottom = _box(prism, self.floor_views.rig, name)
        width, height = right - left, bottom - top
        rows, columns = (
            slice(max(low - s // 4, 0), max(low + s + s // 4, 0)) for low, s in ((top, height), (left, width))
        )
        window = adjust_intensity(images[name], self.backgrounds[name].image)[rows, columns]
        scores = {label: _likeness(window, *template, height) for label, template in self.templates.items()}
        best = min(scores, key=lambda label: scores[label])
        others = [score for label, score in scores.items() if label != best]
        alike = scores[best] <= self.settings.likeness
        return best if alike and all(score >= self.settings.distinct * scores[best] for score in others) else None


def renumbered(indices: npt.NDArray[np.int64], kept: Mask) -> npt.NDArray[np.int64]:
    """Indices into a list as indices into what is kept of it; -1 stays, and stands for what is not kept."""
    new = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    return np.asarray(new[indices])


def _least_hidden(hidden: FloatArray) -> int:
    """The view that sees most of an object; one that does not view it at all comes last."""
    return int(np.argmin(np.nan_to_num(hidden, nan=2.0)))


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
    return floor.points(np.column_stack([ix, iy]))


def footprints(prisms: Sequence[Prism], occupied: Mask, floor: Floor) -> npt.NDArray[np.int32]:
    """The cells of each object: those under the prism, and evidence within a quarter of its radius + 5 cm of it.

    Returns
    -------
    int32 (ny, nx): 0, or the object's index plus 1; a cell between two belongs to the nearer rim.
    """
    labels, nearest = np.zeros(floor.shape, np.int32), np.full(floor.shape, np.inf, np.float32)
    for number, prism in enumerate(prisms, start=1):
        spare = CLOSE_M + CLOSE_SHARE * prism.radius
        outline = outline_points(prism)
        low, high = floor.cells([outline.min(axis=0) - spare, outline.max(axis=0) + spare])
        (x0, y0), (x1, y1) = (np.clip(corner, 0, floor.shape[::-1]).astype(int) for corner in (low, high + 2))
        iy, ix = np.mgrid[y0:y1, x0:x1]
        x, y = np.moveaxis(floor.points(np.stack([ix, iy], axis=-1)), -1, 0)
        rim = beyond_outline_m(prism, x, y).astype(np.float32)
        mine = (rim < nearest[iy, ix]) & ((rim <= 0) | ((rim <= spare) & occupied[iy, ix]))
        nearest[iy[mine], ix[mine]] = rim[mine]
        labels[iy[mine], ix[mine]] = number
    return labels
