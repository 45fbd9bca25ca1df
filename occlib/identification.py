"""Known objects in each view, and how big they are (sections 3 and 4; Fig 3).

In the image that is left after background subtraction each known object's template is matched by SSD (Eq 2), wherever it can cover
something that is left; the similarity image is thresholded, and each of its connected components gives one optimum. The object at an optimum is the region of the view's
foreground there: its centroid (Eq 3, 4), its number of pixels *n*, and its actual size, *n* times the scale factor that the look-up
table holds for the centroid.

What the paper leaves open, and what is done here:

* *Where templates come from.* Pictures of the objects may be given. Else they are cut from the first instant that has an object on
  the map: of each object, in each view where its region is its own, the box around the region, :data:`MARGIN_PX` wider, out of the
  subtracted image. A view that shows none of them apart, or drops out just then, follows as soon as it shows apart what the
  other views know. An object that comes later has no template and no label.
* *Which grey values.* Templates that were cut are matched in the subtracted image, as they are. A given picture shows the object
  itself: it is matched in the grey levels of the view, adjusted to the background's intensity.
* *Which threshold.* Otsu's, the only one that the paper names ("gray thresh"). It always accepts something: where a known object is absent,
  its template may label an object that no other template claims.
* *Two templates for one object.* The smaller dissimilarity wins; a template shows one object, so it labels one.
* *Which object of the map is it.* The one that the identified region, warped to the floor, covers most of.
* *Which view's size.* The mean over the views that identify the object.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.files import read_image
from occlib.foreground.background import Background
from occlib.foreground.evidence import Evidence
from occlib.foreground.intensity import adjust_intensity, to_grey
from occlib.geometry import Rig
from occlib.localization import Region, ScaleTable, find_regions, measured_regions, scale_table
from occlib.matching.measures import METHODS
from occlib.matching.optima import RULES
from occlib.matching.search import Match, find
from occlib.matching.thresholds import THRESHOLDS

Labels = npt.NDArray[np.int32]

MARGIN_PX = 4
"""Background around a region that belongs to its template: the outline counts, too."""


@dataclass(frozen=True)
class IdentifierSettings:
    """Settings of :class:`Identifier`.

    Parameters
    ----------
    method
        Similarity measure, one of :data:`occlib.matching.METHODS`; ``"ssd"`` is the paper's.
    limit
        The worst score that is a match, ``"otsu"``, ``"mad"``, or ``"default"``: half of the template's own contrast.
    optima
        ``"components"``, one optimum in each connected component (the paper's), or ``"nms"``.
    min_area_px
        Smaller regions of a view's foreground are noise.
    cell_px
        Side of a cell of the look-up table in px.
    """

    method: str = "ssd"
    limit: float | str = "otsu"
    optima: str = "components"
    min_area_px: int = 40
    cell_px: int = 40

    def __post_init__(self) -> None:
        checks.choice("method", self.method, METHODS)
        if not isinstance(self.limit, str):
            checks.number("limit", self.limit, unit="a score")
        elif self.limit not in ("default", *THRESHOLDS):
            raise ValueError(f"limit: expected a score, default, {' or '.join(THRESHOLDS)}, got {self.limit!r}")
        checks.choice("optima", self.optima, RULES)
        checks.whole("min_area_px", self.min_area_px, least=1)
        checks.whole("cell_px", self.cell_px, least=1)


class Template(NamedTuple):
    """A known object's picture.

    Parameters
    ----------
    label
        Which object.
    picture
        Grey levels, uint8 (h, w): of the object itself, or of the subtracted image.
    mask
        Bool (h, w), the pixels that count; all for None.
    """

    label: str
    picture: Image
    mask: Mask | None = None


class Sighting(NamedTuple):
    """A known object in one view.

    Parameters
    ----------
    label
        Of its template.
    match
        Where the template was found, and its score.
    region
        Its region of the view's foreground; ``area`` is the paper's *n*.
    pixels
        Bool (H, W), the region's pixels.
    """

    label: str
    match: Match
    region: Region
    pixels: Mask


class Identified(NamedTuple):
    """What identification says of an object of the map: its label, and its actual size in m2 by the look-up table."""

    label: str
    size_m2: float | None


def identify(
    image: Image, foreground: Mask, templates: Sequence[Template], settings: IdentifierSettings = IdentifierSettings()
) -> list[Sighting]:
    """Known objects in a view, the most similar first: match, threshold, one optimum a component, its region.

    Parameters
    ----------
    image
        What the templates are matched in, uint8 (H, W).
    foreground
        Bool (H, W). An optimum whose centre lies in none of its regions is no object.
    templates
        Of this view. One larger than the image is left out.
    settings
        Measure, threshold and limits.

    Returns
    -------
    list of Sighting
        At most one for a template, and for a region unless it holds several optima: then each has what its template covers.
    """
    labels, regions = find_regions(foreground, min_area=settings.min_area_px)
    candidates = [
        (_dissimilarity(match, settings), number, match)
        for number, template in enumerate(templates)
        for match in _matches(image, regions, template, settings)
    ]
    chosen: list[tuple[Template, Match, int]] = []
    for _, number, match in sorted(candidates, key=lambda candidate: candidate[:2]):
        x, y = (round(c) for c in match.centre_px)
        label, template = int(labels[y, x]), templates[number]
        taken = any(other is template or _same_place(match, place) for other, place, _ in chosen)
        if label and not taken:
            chosen.append((template, match, label))
    return list(_sightings(labels, regions, chosen))


def _matches(image: Image, regions: Sequence[Region], template: Template, settings: IdentifierSettings) -> list[Match]:
    """Matches where the template may cover a region: elsewhere nothing is left after subtraction."""
    height, width = template.picture.shape
    if not regions:
        return []
    boxes = np.array([region.box for region in regions])
    reach = np.array([width, height])
    left, top = np.maximum(boxes[:, :2].min(axis=0) - reach, 0)
    right, bottom = (boxes[:, :2] + boxes[:, 2:]).max(axis=0) + reach
    window = image[top:bottom, left:right]
    if window.shape[0] < height or window.shape[1] < width:
        return []
    limit = None if settings.limit == "default" else settings.limit
    found = find(window, template.picture, settings.method, limit, template.mask, rule=settings.optima)
    return [replace(match, x=match.x + int(left), y=match.y + int(top)) for match in found]


def _dissimilarity(match: Match, settings: IdentifierSettings) -> float:
    """The match's score, turned so that less is more alike."""
    return -match.score if METHODS[settings.method].higher_is_better else match.score


def _same_place(a: Match, b: Match) -> bool:
    """Whether two matches are one object: the centre of one lies within half of the other."""
    (ax, ay), (bx, by) = a.centre_px, b.centre_px
    return abs(ax - bx) < max(a.width, b.width) / 2 and abs(ay - by) < max(a.height, b.height) / 2


def _sightings(
    labels: Labels, regions: Sequence[Region], chosen: Sequence[tuple[Template, Match, int]]
) -> Iterator[Sighting]:
    """Each match with its region; where several lie in one region, each has what its template covers of it."""
    matches_in = Counter(label for _, _, label in chosen)
    for template, match, label in chosen:
        pixels = labels == label
        region = regions[label - 1]
        if matches_in[label] > 1:
            x, y, width, height = (round(v) for v in (match.x, match.y, match.width, match.height))
            box = np.zeros_like(pixels)
            box[max(y, 0) : y + height, max(x, 0) : x + width] = True
            pixels = pixels & box
            _, (region,) = measured_regions(pixels.astype(np.int32))
        yield Sighting(template.label, match, region, pixels)


def cut_templates(
    difference: Image,
    foreground: Mask,
    cells_px: FloatArray,
    labels: Labels,
    names: Mapping[int, str],
    *,
    min_area_px: int,
) -> list[Template]:
    """Templates of the objects of a map that a view shows apart, cut from its subtracted image.

    Parameters
    ----------
    difference
        The subtracted image, uint8 (H, W).
    foreground
        Bool (H, W).
    cells_px
        Raw px that each cell of the map shows, (ny, nx, 2); NaN where the camera does not see it.
    labels
        int (ny, nx), the map's objects from 1.
    names
        What they are called, by their number in ``labels``; one without a name is left out.
    min_area_px
        Smaller regions are noise.
    """
    owners, regions = find_regions(foreground, min_area=min_area_px)
    counts = _overlaps(owners, len(regions), cells_px, labels)
    templates = []
    for number in range(1, counts.shape[1]):
        region = int(counts[1:, number].argmax()) + 1 if len(regions) else 0
        # the region is the object's own: it holds this object's cells and no other object's
        own = region and counts[region, number] and np.count_nonzero(counts[region, 1:]) == 1
        if own and number in names:
            left, top, width, height = regions[region - 1].box
            rows = slice(max(top - MARGIN_PX, 0), top + height + MARGIN_PX)
            columns = slice(max(left - MARGIN_PX, 0), left + width + MARGIN_PX)
            templates.append(Template(names[number], difference[rows, columns].copy()))
    return templates


def _overlaps(owners: Labels, count: int, cells_px: FloatArray, labels: Labels) -> npt.NDArray[np.int64]:
    """How many cells of each object of the map show each region of a view, (regions + 1, objects + 1)."""
    iy, ix = np.nonzero(labels)
    pixels = cells_px[iy, ix]
    seen = np.isfinite(pixels[:, 0])
    columns, rows = np.rint(pixels[seen]).astype(int).T
    height, width = owners.shape
    regions = owners[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    objects = int(labels.max(initial=0)) + 1
    flat = regions.astype(np.int64) * objects + labels[iy, ix][seen]
    return np.bincount(flat, minlength=(count + 1) * objects).reshape(count + 1, objects)


class Identifier:
    """Identifies and measures the objects of the map in each view.

    Parameters
    ----------
    cells_px
        For each camera the raw px that each cell of the map shows, (ny, nx, 2).
    rig
        The cameras, for their look-up tables.
    backgrounds
        Each camera's empty floor.
    settings
        How to match.
    templates
        Pictures by label, uint8 RGB or RGBA, of which only the opaque pixels count. Without any they are cut from the first
        instant that shows an object.

    Attributes
    ----------
    templates
        ``{camera: [Template, ...]}``.
    """

    def __init__(
        self,
        cells_px: Mapping[str, FloatArray],
        rig: Rig,
        backgrounds: Mapping[str, Background],
        settings: IdentifierSettings,
        templates: Mapping[str, Image],
    ) -> None:
        self.cells_px, self.backgrounds, self.settings = cells_px, backgrounds, settings
        self.tables: dict[str, ScaleTable] = {
            name: scale_table(camera, cell_px=settings.cell_px) for name, camera in rig.cameras.items()
        }
        given = [_given(label, picture) for label, picture in templates.items()]
        self.given = bool(given)
        self.templates: dict[str, list[Template]] = {name: given for name in rig.cameras} if given else {}

    def sightings(self, image: Image, evidence: Evidence, name: str) -> list[Sighting]:
        """The known objects in one camera's uint8 RGB image."""
        foreground = evidence.values > evidence.level
        searched = evidence.values
        if self.given:
            background = self.backgrounds[name]
            searched = adjust_intensity(to_grey(image), background.grey)
        return identify(searched, foreground, self.templates.get(name, []), self.settings)

    def identify(
        self, images: Mapping[str, Image], evidence: Mapping[str, Evidence], labels: Labels
    ) -> dict[int, Identified]:
        """Label and size of the objects of the map, by their index; those that no view identifies are left out.

        Parameters
        ----------
        images, evidence
            Of each camera that can be trusted.
        labels
            int (ny, nx): 0, or the index of the cell's object plus 1.
        """
        if not any(self.templates.values()):
            self._cut(evidence, labels, {number: f"object {number}" for number in range(1, labels.max(initial=0) + 1)})
        claims: dict[int, list[tuple[float, str, float]]] = {}  # object -> score, label, size of each view
        for name, one in evidence.items():
            for seen in self.sightings(images[name], one, name):
                cells = _overlaps(seen.pixels.astype(np.int32), 1, self.cells_px[name], labels)[1, 1:]
                if cells.any():
                    size = self.tables[name].actual_area(seen.region)
                    score = _dissimilarity(seen.match, self.settings)
                    claims.setdefault(int(cells.argmax()), []).append((score, seen.label, size))
        known = _settled(claims)
        late = {name: one for name, one in evidence.items() if not self.templates.get(name)}
        self._cut(late, labels, {i + 1: identified.label for i, identified in known.items()})
        return known

    def _cut(self, evidence: Mapping[str, Evidence], labels: Labels, names: Mapping[int, str]) -> None:
        """Cut templates for these cameras, of those objects of the map that have a name."""
        for camera, one in evidence.items() if names else ():
            self.templates[camera] = cut_templates(
                one.values,
                one.values > one.level,
                self.cells_px[camera],
                labels,
                names,
                min_area_px=self.settings.min_area_px,
            )


def read_templates(folder: str | Path) -> dict[str, Image]:
    """Pictures of known objects, ``LABEL.png``: ``{label: uint8 RGBA (H, W, 4)}``; what is transparent does not count."""
    templates = {}
    for path in sorted(Path(folder).glob("*.png")):
        picture = read_image(path, alpha=True)
        opaque = np.full((*picture.shape[:2], 1), 255, np.uint8)
        templates[path.stem] = picture if picture.shape[2] == 4 else np.dstack([picture, opaque])
    if not templates:
        raise ValueError(f"{folder}: expected pictures named LABEL.png, found none")
    return templates


def opaque_part(label: str, picture: npt.ArrayLike) -> tuple[Image, Mask | None]:
    """The colours of an object's picture, uint8 RGB or RGBA, and the pixels that count: bool (h, w), or None for all."""
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


def _given(label: str, picture: Image) -> Template:
    """A picture of an object as a template: its grey levels, and its opaque pixels."""
    colours, opaque = opaque_part(label, picture)
    return Template(label, to_grey(colours), opaque)


def _settled(claims: Mapping[int, Sequence[tuple[float, str, float]]]) -> dict[int, Identified]:
    """The label of the most similar view for each object, no label twice; the mean size of the views that agree with it."""
    labels: dict[int, str] = {}
    for _, label, number in sorted(
        (score, label, number) for number, views in claims.items() for score, label, _ in views
    ):
        if number not in labels and label not in labels.values():
            labels[number] = label
    sizes = {
        number: [size for _, own, size in claims[number] if own == label and np.isfinite(size)]
        for number, label in labels.items()
    }
    return {n: Identified(label, float(np.mean(sizes[n])) if sizes[n] else None) for n, label in labels.items()}
