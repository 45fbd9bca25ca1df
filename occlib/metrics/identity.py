"""Whether labels name the right objects, and whether sizes are theirs (sections 3 and 4)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from occlib.base.arrays import as_points
from occlib.formats import Truth
from occlib.metrics.detections import Detections, matched_frames


@dataclass(frozen=True)
class IdentityScore:
    """How well labels name objects, and what size each object was given.

    Parameters
    ----------
    right, wrong, unlabelled
        Matched detections whose label is their object's, another's, or none.
    label_of
        ``{true id: label}``: one label an object, so that as many detections as possible are right.
    size_ratio
        ``{true id: median of size over the area of the true footprint}``; objects without either are left out.
    """

    right: int
    wrong: int
    unlabelled: int
    label_of: dict[str, str]
    size_ratio: dict[str, float]


def evaluate_identity(detections: Detections, truth: Truth, *, radius: float = 0.5) -> IdentityScore:
    """Score the labels and sizes of detections: template matching knows objects, but not by the truth's names.

    Parameters
    ----------
    detections
        Objects with ``label`` and ``size_m2``, as the pipeline gives them, or ``size``, as ``objects.jsonl`` has it.
    truth, radius
        As for :func:`evaluate`; the true objects have ids.

    Examples
    --------
    >>> from occlib.formats import DetectedObject, TrueObject
    >>> truth = Truth({frame: [TrueObject(id="A", x=0, y=0)] for frame in range(3)})
    >>> found = {frame: [DetectedObject(x=0, y=0, label=label)] for frame, label in enumerate(["cup", "cup", None])}
    >>> evaluate_identity(found, truth)
    IdentityScore(right=2, wrong=0, unlabelled=1, label_of={'A': 'cup'}, size_ratio={})
    """
    counts: Counter[tuple[str, str]] = Counter()
    unlabelled, ratios = 0, dict[str, list[float]]()
    for detected, true, pairs in matched_frames(detections, truth, None, radius):
        for i, j, _ in pairs:
            if true[j].id is None:
                raise ValueError("truth: expected objects with an id, got one without")
            name, label = str(true[j].id), getattr(detected[i], "label", None)
            unlabelled += label is None
            counts.update([(name, label)] if label is not None else [])
            size = getattr(detected[i], "size_m2", getattr(detected[i], "size", None))
            footprint = true[j].footprint
            if size is not None and footprint is not None and (area := polygon_area(footprint)) > 0:
                ratios.setdefault(name, []).append(size / area)
    names, labels = sorted({name for name, _ in counts}), sorted({label for _, label in counts})
    table = np.array([[counts[name, label] for label in labels] for name in names]).reshape(len(names), len(labels))
    rows, columns = linear_sum_assignment(table, maximize=True)
    right = int(table[rows, columns].sum())
    return IdentityScore(
        right=right,
        wrong=counts.total() - right,
        unlabelled=unlabelled,
        label_of={names[i]: labels[j] for i, j in zip(rows, columns, strict=True) if table[i, j]},
        size_ratio={name: float(np.median(values)) for name, values in sorted(ratios.items())},
    )


def polygon_area(polygon_m: npt.ArrayLike) -> float:
    """Area of a simple polygon (M, 2) in m2, by Gauss's formula.

    >>> polygon_area([[0, 0], [2, 0], [2, 1], [0, 1]])
    2.0
    """
    x, y = as_points(polygon_m, name="polygon_m").T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
