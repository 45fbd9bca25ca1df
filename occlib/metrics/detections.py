"""Detections against hand-marked or planted truth: MODA, MODP, precision, recall, and who was reported hidden.

MODA and MODP follow Kasturi et al. (2009), "Framework for Performance Evaluation of Face, Text, and
Vehicle Detection and Tracking in Video", IEEE TPAMI 31(2), doi:10.1109/TPAMI.2008.57, with distances on
the floor (Chavdarova et al. 2018, WILDTRACK) in place of overlaps in the image. Conventions:

* every frame of the truth counts, with or without detections; frames that the truth lacks are ignored;
* MODA is never clamped: with many false positives it is negative (``moda_public`` keeps both habits of the
  public evaluator, which flatter: it clamps, and skips the frames in which nothing was detected);
* a pair matches when its distance is *strictly* below the radius;
* a score that is undefined (no truth, no match, ...) is ``None``, never NaN.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from occlib.base.arrays import FloatArray, Mask, as_points
from occlib.formats import DetectedObject, TrueObject, Truth
from occlib.metrics.maps import ratio

T = TypeVar("T")


class Detected(Protocol):
    """What can be scored: an object vector of the tracker, or an object of ``objects.jsonl``."""

    @property
    def x(self) -> float:
        """Metres."""

    @property
    def y(self) -> float:
        """Metres."""

    @property
    def id(self) -> Any:
        """The same in every frame; ``None`` if it has none."""

    @property
    def hidden_in(self) -> Sequence[str]:
        """Cameras in which something hides it."""


Detections: TypeAlias = Mapping[int, Sequence[Detected] | npt.ArrayLike]  # frame -> objects, or an (N, 2) array in m


Pair: TypeAlias = tuple[int, int, float]  # index of the detection, index of the truth, distance in m


@dataclass(frozen=True)
class Score:
    """How well detections agree with the truth. Ratios and metres; ``None`` where undefined.

    Parameters
    ----------
    moda
        Multiple Object Detection Accuracy, ``1 - (fn + fp) / truth_count``, in (-inf, 1], higher is
        better; ``None`` without truth.
    moda_public
        The same as the field's public evaluator counts it: frames without a detection left out, clamped
        at 0. Only for tables beside published numbers.
    modp
        Multiple Object Detection Precision, the mean of ``1 - distance / radius`` over the matches, in
        (0, 1], higher is better.
    precision, recall, f1
        In [0, 1], higher is better.
    error_mean_m, error_median_m
        Distance between matched detection and truth in m, in [0, radius), lower is better.
    tp, fp, fn, truth_count, frames
        Matches, false positives, misses, true objects (``tp + fn``), frames of the truth.
    ghosts_per_frame
        ``fp / frames``, in [0, inf), lower is better; ``None`` without frames.
    id_switches
        How often a true object is matched under another id than the last time; ``None`` if detections
        or truth carry no ids.
    """

    moda: float | None
    moda_public: float | None
    modp: float | None
    precision: float | None
    recall: float | None
    f1: float | None
    error_mean_m: float | None
    error_median_m: float | None
    tp: int
    fp: int
    fn: int
    truth_count: int
    frames: int
    ghosts_per_frame: float | None
    id_switches: int | None

    def to_dict(self) -> dict[str, float | int | None]:
        """The scores as plain numbers and ``None``, ready for ``json.dumps``."""
        return asdict(self)


@dataclass(frozen=True)
class HiddenScore:
    """How well the cameras named in ``hidden_in`` agree with the truth's ``hidden_fraction``.

    Parameters
    ----------
    precision, recall, f1
        In [0, 1], higher is better; ``None`` where undefined (nothing reported hidden, nothing hidden, neither).
    tp, fp, fn
        Counts of (object, camera): hidden and reported, reported but not hidden, hidden but not reported.
    compared
        How many (matched object, camera) had a known hidden fraction. The hidden ones of lost objects are in
        ``fn`` but not here.
    """

    precision: float | None
    recall: float | None
    f1: float | None
    tp: int
    fp: int
    fn: int
    compared: int


def match_points(detected_m: npt.ArrayLike, true_m: npt.ArrayLike, radius: float) -> list[Pair]:
    """One-to-one pairs closer than ``radius``: as many as possible, then the smallest total distance.

    Parameters
    ----------
    detected_m, true_m
        Floor points in m, shapes (N, 2) and (M, 2).
    radius
        Metres; a pair at exactly this distance does not match.

    Returns
    -------
    list of (int, int, float)
        Index of the detection, index of the truth, distance in m; ordered by detection.

    Notes
    -----
    The Hungarian method (`scipy.optimize.linear_sum_assignment`): a forbidden pair costs more than all
    permitted ones together.

    >>> match_points([[0, 0], [1, 0]], [[0.75, 0]], radius=0.5)
    [(1, 0, 0.25)]
    """
    distance = _distances(detected_m, true_m)
    forbidden = radius * (min(distance.shape) + 1)
    rows, columns = linear_sum_assignment(np.where(distance < radius, distance, forbidden))
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(i, j, float(distance[i, j])) for i, j in pairs if distance[i, j] < radius]


def inside_polygon(points_m: npt.ArrayLike, polygon_m: npt.ArrayLike) -> Mask:
    """Which points (N, 2) lie in a simple polygon (M, 2); a point on its boundary is inside.

    >>> inside_polygon([[0.5, 0.5], [1, 0.5], [1.1, 0.5]], [[0, 0], [1, 0], [1, 1], [0, 1]])
    array([ True,  True, False])
    """
    points, start = as_points(points_m)[:, None], as_points(polygon_m, name="polygon_m")[None]
    edge, offset = np.roll(start, -1, axis=1) - start, points - start
    side = edge[..., 0] * offset[..., 1] - edge[..., 1] * offset[..., 0]
    upward = (offset[..., 1] >= 0) & (offset[..., 1] < edge[..., 1])
    downward = (offset[..., 1] < 0) & (offset[..., 1] >= edge[..., 1])
    winding = (upward & (side > 0)).sum(axis=1) - (downward & (side < 0)).sum(axis=1)
    along = np.clip((offset * edge).sum(-1) / np.maximum((edge**2).sum(-1), 1e-300), 0, 1)
    on_boundary = np.linalg.norm(offset - along[..., None] * edge, axis=-1).min(axis=1, initial=np.inf) < 1e-9
    return np.asarray((winding != 0) | on_boundary)


def evaluate(detections: Detections, truth: Truth, *, roi: str | None = None, radius: float = 0.5) -> Score:
    """Score detections on the floor against the truth.

    Parameters
    ----------
    detections
        For each frame its objects: those of a :class:`~occlib.pipeline.FrameResult`, of ``objects.jsonl``
        (:func:`~occlib.formats.load_objects`), or an (N, 2) array of floor points in m. A frame that is missing has no
        detections.
    truth
        What is there (:func:`~occlib.formats.load_truth`).
    roi
        Name of a polygon in ``truth.roi``. Truth and detections outside it are dropped before
        matching; a point on its boundary is inside.
    radius
        Metres; a detection and a true object match when closer than this. 0.5 m is the field's
        convention for people.

    Raises
    ------
    ValueError
        Unknown ``roi``, ``radius`` not positive, detections that are neither objects nor points, places that are not finite.

    Examples
    --------
    >>> truth = Truth({0: [TrueObject(x=0, y=0)], 1: [TrueObject(x=1, y=0)]})
    >>> score = evaluate({0: [[0.1, 0.0]]}, truth)
    >>> score.moda, score.recall, score.precision
    (0.5, 0.5, 1.0)
    """
    errors: list[float] = []
    found = expected = false = seen = seen_wrong = switches = 0
    last_id: dict[Any, Any] = {}
    with_ids, frames = True, 0
    for detected, true, pairs in _matched_frames(detections, truth, roi, radius):
        frames += 1
        found, expected, false = found + len(pairs), expected + len(true), false + len(detected) - len(pairs)
        errors += [distance for _, _, distance in pairs]
        if detected:
            seen, seen_wrong = seen + len(true), seen_wrong + len(true) + len(detected) - 2 * len(pairs)
        with_ids = with_ids and all(each.id is not None for group in (detected, true) for each in group)
        for i, j, _ in pairs if with_ids else ():
            switches += last_id.get(true[j].id, detected[i].id) != detected[i].id
            last_id[true[j].id] = detected[i].id
    missed = expected - found
    return Score(
        moda=1 - (missed + false) / expected if expected else None,
        moda_public=max(0.0, 1 - seen_wrong / seen) if seen else None,
        modp=float(np.mean(1 - np.array(errors) / radius)) if errors else None,
        precision=ratio(found, found + false),
        recall=ratio(found, expected),
        f1=ratio(2 * found, 2 * found + false + missed),
        error_mean_m=float(np.mean(errors)) if errors else None,
        error_median_m=float(np.median(errors)) if errors else None,
        tp=found,
        fp=false,
        fn=missed,
        truth_count=expected,
        frames=frames,
        ghosts_per_frame=ratio(false, frames),
        id_switches=switches if with_ids and errors else None,
    )


def evaluate_hidden(
    detections: Detections,
    truth: Truth,
    *,
    cameras: Sequence[str] | None = None,
    hidden: float = 0.9,
    roi: str | None = None,
    radius: float = 0.5,
) -> HiddenScore:
    """Score which cameras the detections name in ``hidden_in`` against the truth's ``hidden_fraction``.

    Each true object is compared in each camera of which its ``hidden_fraction`` is known: it is hidden there
    from the fraction ``hidden`` on, and reported so if its matched detection names the camera. A true object
    without a match was not reported: where it is hidden it counts as ``fn``. A false positive has no true
    state to compare with; :func:`evaluate` counts it.

    Parameters
    ----------
    detections, truth, roi, radius
        As for :func:`evaluate`. A detection without ``hidden_in`` reports nothing hidden.
    cameras
        Compare only in these; all that the true object names for ``None``. A camera that the true object does
        not name is skipped: its state is unknown.
    hidden
        Fraction in (0, 1] from which (``>=``) an object counts as hidden.

    Raises
    ------
    ValueError
        ``hidden`` outside (0, 1], ``cameras`` a single string, and as :func:`evaluate`.

    Examples
    --------
    >>> truth = Truth({0: [TrueObject(x=0, y=0, hidden_fraction={"left": 1.0, "right": 0.2})]})
    >>> evaluate_hidden({0: [DetectedObject(x=0, y=0, hidden_in=("left", "right"))]}, truth)
    HiddenScore(precision=0.5, recall=1.0, f1=0.66..., tp=1, fp=1, fn=0, compared=2)
    """
    _check_fraction(hidden, "hidden")
    _check_cameras(cameras)
    outcomes: Counter[tuple[bool, bool]] = Counter()  # (reported, hidden)
    compared = 0
    for detected, true, pairs in _matched_frames(detections, truth, roi, radius):
        reported = {j: detected[i].hidden_in for i, j, _ in pairs}
        for j, each in enumerate(true):
            known = _known_fractions(each, cameras)
            outcomes.update((name in reported.get(j, ()), known[name] >= hidden) for name in known)
            compared += len(known) if j in reported else 0
    tp, fp, fn = outcomes[True, True], outcomes[True, False], outcomes[False, True]
    return HiddenScore(
        precision=ratio(tp, tp + fp),
        recall=ratio(tp, tp + fn),
        f1=ratio(2 * tp, 2 * tp + fp + fn),
        tp=tp,
        fp=fp,
        fn=fn,
        compared=compared,
    )


def recall_by_hidden_fraction(
    detections: Detections,
    truth: Truth,
    *,
    cameras: Sequence[str] | None = None,
    edges: Sequence[float] = (0.0, 0.25, 0.5, 0.75, 1.0),
    best_below: float | None = None,
    roi: str | None = None,
    radius: float = 0.5,
) -> list[dict[str, float | int | None]]:
    """Recall for objects grouped by how much of them their worst view hides.

    The worst view is the largest ``hidden_fraction`` (in [0, 1], 0 where absent) over ``cameras``, or over
    all cameras for ``None``. A bin holds ``low <= fraction < high``, the last one also ``high``.
    Returns one ``{"low", "high", "count", "recall"}`` a bin; ``recall`` is ``None`` for an empty one.

    ``best_below``, in (0, 1], keeps only objects that some view is known to hide less than this: with
    ``edges=(0.9, 1), best_below=0.9`` those that one camera lost and another sees, the case that the second
    camera is there for. A camera absent from ``hidden_fraction`` is not known to see the object.

    Raises ``ValueError`` for edges that do not increase, ``best_below`` outside (0, 1], ``cameras`` a single
    string, and as :func:`evaluate`.

    >>> truth = Truth({0: [TrueObject(x=0, y=0, hidden_fraction={"left": 1.0})]})
    >>> recall_by_hidden_fraction({0: [[0, 0]]}, truth, edges=(0, 0.5, 1))[1]
    {'low': 0.5, 'high': 1.0, 'count': 1, 'recall': 1.0}
    """
    if len(edges) < 2 or not np.all(np.diff(edges) > 0):
        raise ValueError(f"edges: expected two or more increasing numbers, got {tuple(edges)}")
    if best_below is not None:
        _check_fraction(best_below, "best_below")
    _check_cameras(cameras)
    total, hits = np.zeros(len(edges) - 1, int), np.zeros(len(edges) - 1, int)
    for _, true, pairs in _matched_frames(detections, truth, roi, radius):
        matched = {j for _, j, _ in pairs}
        for j, each in enumerate(true):
            known = _known_fractions(each, cameras).values()
            worst, best = max(known, default=0.0), min(known, default=np.inf)
            if edges[0] <= worst <= edges[-1] and (best_below is None or best < best_below):
                index = min(int(np.searchsorted(edges, worst, side="right")) - 1, len(total) - 1)
                total[index] += 1
                hits[index] += j in matched
    return [
        {"low": float(low), "high": float(high), "count": int(n), "recall": ratio(int(hit), int(n))}
        for low, high, n, hit in zip(edges[:-1], edges[1:], total, hits, strict=True)
    ]


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
    >>> truth = Truth({frame: [TrueObject(id="A", x=0, y=0)] for frame in range(3)})
    >>> found = {frame: [DetectedObject(x=0, y=0, label=label)] for frame, label in enumerate(["cup", "cup", None])}
    >>> evaluate_identity(found, truth)
    IdentityScore(right=2, wrong=0, unlabelled=1, label_of={'A': 'cup'}, size_ratio={})
    """
    counts: Counter[tuple[str, str]] = Counter()
    unlabelled, ratios = 0, dict[str, list[float]]()
    for detected, true, pairs in _matched_frames(detections, truth, None, radius):
        for i, j, _ in pairs:
            name, label = str(true[j].id), getattr(detected[i], "label", None)
            unlabelled += label is None
            counts.update([(name, label)] if label is not None else [])
            size = getattr(detected[i], "size_m2", getattr(detected[i], "size", None))
            footprint = true[j].footprint
            if size is not None and footprint is not None:
                ratios.setdefault(name, []).append(size / polygon_area(footprint))
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


def _matched_frames(
    detections: Detections, truth: Truth, roi: str | None, radius: float
) -> Iterator[tuple[list[Detected], list[TrueObject], list[Pair]]]:
    """For each frame of the truth: detections and true objects in the region, and their pairs."""
    if not isinstance(truth, Truth):
        raise ValueError(f"truth: expected a Truth, as load_truth gives it, got {type(truth).__name__}")
    if not (np.isfinite(radius) and radius > 0):
        raise ValueError(f"radius: expected metres > 0, got {radius}")
    polygon = None if roi is None else truth.region(roi)
    for frame, true in sorted(truth.frames.items()):
        detected = _detected(detections.get(frame, ()), f"detections[{frame}]")
        found_m, true_m = _places_m(detected, f"detections[{frame}]"), _places_m(true, f"truth.frames.{frame}")
        if polygon is not None:
            kept, of_truth = inside_polygon(found_m, polygon), inside_polygon(true_m, polygon)
            detected, true = _kept(detected, kept), _kept(true, of_truth)
            found_m, true_m = found_m[kept], true_m[of_truth]
        yield detected, true, match_points(found_m, true_m, radius)


def _known_fractions(true: TrueObject, cameras: Sequence[str] | None) -> dict[str, float]:
    """A true object's hidden fraction in each of the cameras that it names; of all that it names for ``None``."""
    known = true.hidden_fraction
    return {name: known[name] for name in (known if cameras is None else cameras) if name in known}


def _detected(entries: Any, where: str) -> list[Detected]:
    """One frame's detections as objects, whichever way they came."""
    if any(hasattr(entry, "x") for entry in entries):
        if wrong := [i for i, entry in enumerate(entries) if not (hasattr(entry, "x") and hasattr(entry, "y"))]:
            raise ValueError(
                f"{where}[{wrong[0]}]: expected an object with x and y, got {type(entries[wrong[0]]).__name__}"
            )
        return list(entries)
    if any(isinstance(entry, Mapping) for entry in entries):
        raise ValueError(
            f"{where}: expected objects with x and y, or points (N, 2), got a list of {type(entries[0]).__name__}"
        )
    return [DetectedObject(x=x, y=y) for x, y in as_points(entries, name=where).tolist()]


def _kept(objects: list[T], keep: Mask) -> list[T]:
    return [each for each, inside in zip(objects, keep, strict=True) if inside]


def _places_m(objects: Sequence[Detected | TrueObject], where: str) -> FloatArray:
    places = as_points([[each.x, each.y] for each in objects])
    for i, j in np.argwhere(~np.isfinite(places))[:1].tolist():
        raise ValueError(f"{where}[{i}].{'xy'[j]}: expected finite metres, got {places[i, j]}")
    return places


def _distances(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    return np.asarray(np.linalg.norm(as_points(a)[:, None] - as_points(b)[None], axis=2))


def _check_fraction(value: float, name: str) -> None:
    if not 0 < value <= 1:
        raise ValueError(f"{name}: expected a fraction in (0, 1], got {value}")


def _check_cameras(cameras: Sequence[str] | None) -> None:
    if isinstance(cameras, str):
        raise ValueError(f"cameras: expected a sequence of names, got {cameras!r}")
