"""Maps against true footprints, and foreground masks against true silhouettes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from occlib.base.arrays import FloatArray, Mask
from occlib.geometry import Floor


def footprint_coverage(occupied: Mask, floor: Floor, footprints: Sequence[npt.ArrayLike]) -> FloatArray:
    """Fraction of each true footprint that the map claims as occupied, in [0, 1], higher is better.

    Parameters
    ----------
    occupied
        bool (ny, nx).
    floor
        The map's floor.
    footprints
        Polygons (M, 2) in m.

    Returns
    -------
    ndarray, shape (N,)
        Only cells of the map count: a footprint with no cell centre on the map gives NaN.

    >>> floor = Floor((0, 1), (0, 1), 0.5)
    >>> footprint_coverage(np.array([[True, False], [True, False]]), floor, [[[0, 0], [1, 0], [1, 1], [0, 1]]])
    array([0.5])
    """
    _check_map(occupied, floor)
    masks = [floor.polygon_mask(footprint) for footprint in footprints]
    return np.array([occupied[mask].mean() if mask.any() else np.nan for mask in masks], dtype=np.float64)


def claimed_area_ratio(occupied: Mask, floor: Floor, footprints: Sequence[npt.ArrayLike]) -> float | None:
    """Claimed area over true area (the union of the footprints): 1 is best, more is falsified occupancy.

    The paper's section 5 names the excess "reduction of available workspace". ``None`` when no footprint
    lies on the map.

    >>> floor = Floor((0, 1), (0, 1), 0.5)
    >>> claimed_area_ratio(np.ones((2, 2), bool), floor, [[[0, 0], [0.5, 0], [0.5, 1], [0, 1]]])
    2.0
    """
    _check_map(occupied, floor)
    return ratio(int(occupied.sum()), int(_union(floor, footprints).sum()))


def foreground_scores(mask: Mask, truth: Mask, difference: npt.ArrayLike, *, level: float = 15.0) -> dict[str, float]:
    """How well a mask fits the true silhouettes, and how well it tells shadows from objects.

    Parameters
    ----------
    mask, truth
        bool (H, W).
    difference
        Absolute difference from the background in grey levels, (H, W): what differs by more than ``level`` and is no object, beyond
        2 px around one, is shadow or reflection.

    Returns
    -------
    dict
        ``f_measure``; ``shadow_detection``, the share of shadow that is kept out of the mask; ``shadow_discrimination``, the share of the
        object that differs and is in it (Prati et al. 2003, doi:10.1109/TPAMI.2003.1206520). NaN where there is nothing to count.

    Examples
    --------
    A row of six pixels: two of object, one found; three of shadow that begin at its foot, one of them taken for object.

    >>> row = lambda *values: np.array([values])
    >>> foreground_scores(row(1, 0, 0, 0, 0, 1) > 0, row(1, 1, 0, 0, 0, 0) > 0, row(90, 60, 40, 40, 40, 40))
    {'f_measure': 0.5, 'shadow_detection': 0.5, 'shadow_discrimination': 0.5}
    """
    changed = np.asarray(difference, dtype=np.float64) > level
    if not mask.shape == truth.shape == changed.shape or mask.dtype != bool or truth.dtype != bool or mask.ndim != 2:
        raise ValueError(
            f"mask, truth, difference: expected bool, bool and numbers of one shape, got {mask.dtype} {mask.shape}, "
            f"{truth.dtype} {truth.shape}, {changed.shape}"
        )
    shadow = changed & ~ndimage.binary_dilation(truth, np.ones((3, 3)), iterations=2)
    pairs = {
        "f_measure": (2 * (mask & truth).sum(), mask.sum() + truth.sum()),
        "shadow_detection": ((shadow & ~mask).sum(), shadow.sum()),
        "shadow_discrimination": ((changed & truth & mask).sum(), (changed & truth).sum()),
    }
    return {name: float(part / whole) if whole else math.nan for name, (part, whole) in pairs.items()}


def ratio(part: int, whole: int) -> float | None:
    """A share; ``None`` of nothing."""
    return part / whole if whole else None


def _union(floor: Floor, footprints: Sequence[npt.ArrayLike]) -> Mask:
    union = np.zeros(floor.shape, dtype=bool)
    for footprint in footprints:
        union |= floor.polygon_mask(footprint)
    return union


def _check_map(occupied: Mask, floor: Floor) -> None:
    if occupied.shape != floor.shape or occupied.dtype != bool:
        raise ValueError(f"occupied: expected bool {floor.shape}, got {occupied.dtype} {occupied.shape}")
