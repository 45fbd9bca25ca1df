"""Where an object is, what shape it has, how big it really is (section 4; Fig 7, Eq 3-5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, find_objects

from occlib.base import checks
from occlib.base.arrays import FloatArray, Mask, as_points
from occlib.geometry import Camera


@dataclass(frozen=True)
class Region:
    """A connected region of a mask: of a view's foreground, or of the floor map.

    Parameters
    ----------
    label
        Its number in the label image, from 1.
    area
        The paper's *n*: its number of px (cells).
    centroid
        ``(x_c, y_c)``, mean column and row in px (Eq 3, 4).
    box
        ``(left, top, width, height)`` of its bounding box in px.
    """

    label: int
    area: int
    centroid: tuple[float, float]
    box: tuple[int, int, int, int]

    @property
    def middle(self) -> tuple[float, float]:
        """Centre of the bounding box in px.

        Half of a footprint that is missing, as behind furniture, pulls the centroid away; where both ends of the
        object still show, the middle between them stays.
        """
        left, top, width, height = self.box
        return (left + (width - 1) / 2, top + (height - 1) / 2)


def find_regions(
    mask: Mask, *, min_area: float = 1, join: int = 0, within: Sequence[Mask] = ()
) -> tuple[npt.NDArray[np.int32], list[Region]]:
    """Connected regions of a mask, 8-connected, or groups of nearby fragments.

    Parameters
    ----------
    mask
        Bool (H, W).
    min_area
        Regions of fewer px are dropped as noise.
    join
        Fragments at most this many px apart form one region; the gap between them stays empty.
    within
        Bool (H, W) masks that contain ``mask``, such as the single views: fragments are joined only if each of these connects
        them. Two feet belong to one body in every view; two objects side by side have floor between them in some view.

    Returns
    -------
    labels
        int32 (H, W), 0 background, then 1, 2, ... in row-major order of first appearance.
    regions
        One ``Region`` for each label.
    """
    for name, array in [("mask", mask), *(("within", other) for other in within)]:
        if array.dtype != np.bool_ or array.ndim != 2 or array.shape != mask.shape:
            raise ValueError(f"{name}: expected bool {mask.shape}, got {array.dtype} {array.shape}")
    checks.number("join", join, least=0, unit="px")
    labels = np.zeros(mask.shape, np.int32)
    pixels = mask.view(np.uint8)
    left, top, width, height = cv2.boundingRect(pixels)  # most of a floor is empty: label only where something is
    if width == 0:
        return labels, []
    window = np.s_[top : top + height, left : left + width]
    # the default algorithm is faster but numbers by blocks of 2 x 2 px, this one in row-major order of the px
    count, found = _components(pixels[window], cv2.CCL_WU)
    if join and count > 2:
        bridged = _components(_bridge(pixels[window], join))[1]
        found = _joined(found, count, [bridged, *(_open_rim(other)[window] for other in within)])
    labels[window], regions = measured_regions(found, min_area, left, top)
    return labels, regions


def split_regions(
    labels: npt.NDArray[np.int32],
    regions: list[Region],
    core: Mask,
    *,
    min_area: float = 1,
    within: Sequence[Mask] = (),
) -> tuple[npt.NDArray[np.int32], list[Region]]:
    """Split each region that holds several cores; a pixel goes to the nearest core.

    Soft evidence, such as shadows that touch, runs neighbours together. Their cores, the evidence above a higher
    threshold, tell them apart. Cores that every view connects are parts of one body, as in :func:`find_regions`.

    Parameters
    ----------
    labels, regions
        What :func:`find_regions` returned; not changed.
    core
        Bool (H, W), surer evidence.
    min_area
        Cores of fewer px do not count.
    within
        Bool (H, W) masks of the single views' cores.

    Returns
    -------
    labels, regions
        As :func:`find_regions` returns them; the parts of split regions come last.
    """
    checks.mask("core", core, labels.shape)
    left, top, width, height = cv2.boundingRect((core & (labels > 0)).view(np.uint8))
    window = np.s_[top : top + height, left : left + width]
    inner = labels[window]
    count, found = _components((core[window] & (inner > 0)).view(np.uint8), cv2.CCL_WU) if width else (1, inner)
    if count <= len(regions) + 1 and len(set(inner[found > 0].tolist())) == count - 1:
        return labels, regions
    cores, parts = measured_regions(
        _joined(found, count, [inner, *(_open_rim(view)[window] for view in within)]), min_area
    )
    owner = [int(inner[cores == part.label][0]) for part in parts]
    split = sorted({label for label in owner if owner.count(label) > 1})
    if not split:
        return labels, regions
    divided = labels.copy()
    for region in split:
        seeds = np.isin(cores, [part.label for part, label in zip(parts, owner, strict=True) if label == region])
        nearest = np.zeros(labels.shape, np.int32)
        nearest[window] = np.where(seeds, cores, 0)
        iy, ix = distance_transform_edt(nearest == 0, return_distances=False, return_indices=True)
        inside = labels == region
        divided[inside] = len(regions) + nearest[iy[inside], ix[inside]]
    return measured_regions(divided, 1)


def measured_regions(
    found: npt.NDArray[np.int32], min_area: float = 1, left: int = 0, top: int = 0
) -> tuple[npt.NDArray[np.int32], list[Region]]:
    """Drop the small ones of numbered regions, number the others 1, 2, ... and measure them.

    Parameters
    ----------
    found
        int32 (H, W), 0 background, else the number of the pixel's region, which need not be connected.
    min_area
        Regions of fewer px are dropped.
    left, top
        Where ``found`` lies in the whole picture, in px.

    Returns
    -------
    labels, regions
        The new numbers, int32 (H, W), and one ``Region`` for each.

    Examples
    --------
    >>> measured_regions(np.array([[2, 0, 2], [0, 0, 2]], np.int32))[1]
    [Region(label=1, area=3, centroid=(1.33..., 0.33...), box=(0, 0, 3, 2))]
    """
    labels = np.zeros_like(found)
    regions: list[Region] = []
    for value, box in enumerate(find_objects(found), start=1):
        if box is None:
            continue
        own = found[box] == value
        area = int(np.count_nonzero(own))
        if area < max(min_area, 1):
            continue
        moments, x, y = cv2.moments(own.view(np.uint8), binaryImage=True), left + box[1].start, top + box[0].start
        centroid = (moments["m10"] / area + x, moments["m01"] / area + y)
        regions.append(Region(len(regions) + 1, area, centroid, (x, y, own.shape[1], own.shape[0])))
        labels[box][own] = len(regions)
    return labels, regions


def _components(pixels: npt.NDArray[Any], algorithm: int = cv2.CCL_DEFAULT) -> tuple[int, npt.NDArray[np.int32]]:
    count, labels = cv2.connectedComponentsWithAlgorithm(pixels, 8, cv2.CV_32S, algorithm)
    return count, np.asarray(labels, dtype=np.int32)


def _joined(
    fragments: npt.NDArray[np.int32], count: int, connections: Sequence[npt.NDArray[np.int32]]
) -> npt.NDArray[np.int32]:
    """Relabel fragments: one number for those to which each of the connections gives one number."""
    first = np.full(count, -1)
    flat = fragments.ravel()
    first[flat[::-1]] = np.arange(flat.size - 1, -1, -1)  # the last assignment, the first px in row-major order, stays
    groups: dict[tuple[int, ...], int] = {}
    renumber = [0] + [
        groups.setdefault(tuple(int(c.flat[first[i]]) for c in connections), len(groups) + 1) for i in range(1, count)
    ]
    return np.array(renumber, np.int32)[fragments]


def _open_rim(mask: Mask) -> npt.NDArray[np.int32]:
    """Component numbers; what leaves the map may be connected out there, so all that touches the rim is one."""
    padded = cv2.copyMakeBorder(mask.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
    return _components(padded)[1][1:-1, 1:-1]


def _bridge(pixels: npt.NDArray[np.uint8], join: int) -> npt.NDArray[np.uint8]:
    size = join + 1  # a closing of this size bridges a gap of ``join`` px
    padded = cv2.copyMakeBorder(pixels, size, size, size, size, cv2.BORDER_CONSTANT, value=0)
    square, anchor = np.ones((size, size), np.uint8), size // 2
    mirrored = size - 1 - anchor  # a square of even side has no middle: MORPH_CLOSE would move or lose the result
    closed = cv2.dilate(padded, square, anchor=(mirrored, mirrored))
    closed = cv2.erode(closed, square, anchor=(anchor, anchor))
    return np.ascontiguousarray(closed[size:-size, size:-size])


def contour(mask: Mask) -> FloatArray:
    """Outer contour of a mask's largest region, in order around it. Points (N, 2) in px."""
    labels, regions = find_regions(mask.astype(np.bool_))
    if not regions:
        raise ValueError("mask: expected at least one foreground px, got none")
    largest = (labels == max(regions, key=lambda region: region.area).label).view(np.uint8)
    found, _ = cv2.findContours(largest, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return as_points(np.asarray(found[0]).reshape(-1, 2))


def contour_polar(contour_px: npt.ArrayLike, centroid_px: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """The contour as ``d = f(theta)`` about the centroid (Eq 5, Fig 7).

    Eq 5 writes the angle with a plain inverse tangent, which cannot tell opposite quadrants apart; the four-quadrant one is
    used here.

    Returns
    -------
    theta, d
        Angles in radians, ascending from -pi to pi (clockwise on the screen, as rows grow downwards), and distances in px.
    """
    offset = as_points(contour_px, name="contour_px") - np.asarray(centroid_px, dtype=np.float64)
    theta = np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(theta, kind="stable")
    return theta[order], np.hypot(*offset.T)[order]


@dataclass(frozen=True)
class ScaleTable:
    """The paper's look-up table: m2 of floor that one pixel covers, for each grid cell of the image.

    Parameters
    ----------
    cell_px
        Side of a grid cell in px.
    factors
        m2 per px, shape (rows, columns); NaN where the cell does not show the floor.
    """

    cell_px: int
    factors: FloatArray

    def lookup(self, points_px: npt.ArrayLike) -> FloatArray:
        """Scale factor in m2 per px at raw px (N, 2); ``ValueError`` outside the image."""
        column, row = np.floor((as_points(points_px, name="points_px") + 0.5) / self.cell_px).astype(int).T
        rows, columns = self.factors.shape
        if ((column < 0) | (row < 0) | (column >= columns) | (row >= rows)).any():
            raise ValueError(f"points_px: expected px inside the table's {columns} x {rows} cells of {self.cell_px} px")
        return self.factors[row, column]

    def actual_area(self, region: Region) -> float:
        """The paper's actual size in m2: number of px times the factor at the centroid."""
        return float(region.area * self.lookup([region.centroid])[0])


def scale_table(camera: Camera, *, cell_px: int = 40) -> ScaleTable:
    """Scale factors of every grid cell, from the camera's model at the cell's centre.

    The paper determines them by experiment. They hold for what lies flat on the floor: an upright object covers more px than
    its base, and comes out too large.
    """
    checks.number("cell_px", cell_px, least=1, unit="px")
    width, height = camera.size
    columns, rows = -(-width // cell_px), -(-height // cell_px)
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    centre = np.minimum((grid + 0.5) * cell_px - 0.5, np.array(camera.size) - 1.0)
    corners = [
        camera.pixels_to_floor(centre + offset) for offset in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    ]
    diagonal, other = corners[2] - corners[0], corners[3] - corners[1]
    area = np.abs(diagonal[:, 0] * other[:, 1] - diagonal[:, 1] * other[:, 0]) / 2
    rotation, translation = camera.pose
    depth = corners[0] @ rotation[2, :2] + translation[2]
    return ScaleTable(cell_px, np.where(depth > 0, area, np.nan).reshape(rows, columns))
