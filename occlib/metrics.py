"""Scores: detections against hand-marked or planted truth, and maps against true footprints.

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

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import count
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.optimize import linear_sum_assignment

from occlib.base.arrays import FloatArray, Mask, as_points
from occlib.formats.truth import _check_hidden_fraction, _detected_things, _region, _things, _truth_frames
from occlib.geometry import Floor

Detections: TypeAlias = Mapping[int, Any]  # frame -> (N, 2) array in m, or a list of {"x", "y", "id"?, "hidden_in"?}


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
    permitted ones together. :func:`match_points_naive` is the readable reference.

    >>> match_points([[0, 0], [1, 0]], [[0.75, 0]], radius=0.5)
    [(1, 0, 0.25)]
    """
    distance = _distances(detected_m, true_m)
    forbidden = radius * (min(distance.shape) + 1)
    rows, columns = linear_sum_assignment(np.where(distance < radius, distance, forbidden))
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(i, j, float(distance[i, j])) for i, j in pairs if distance[i, j] < radius]


def match_points_naive(detected_m: npt.ArrayLike, true_m: npt.ArrayLike, radius: float) -> list[Pair]:
    """The same as :func:`match_points` by trying every assignment; only for a handful of points.

    >>> match_points_naive([[0, 0], [1, 0]], [[0.75, 0]], radius=0.5)
    [(1, 0, 0.25)]
    """
    distance = _distances(detected_m, true_m)

    def best(i: int, free: frozenset[int]) -> list[Pair]:
        if i == len(distance):
            return []
        options = [best(i + 1, free)]
        for j in sorted(free):
            if distance[i, j] < radius:
                options.append([(i, j, float(distance[i, j])), *best(i + 1, free - {j})])
        return min(options, key=lambda pairs: (-len(pairs), sum(d for _, _, d in pairs)))

    return best(0, frozenset(range(distance.shape[1])))


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


def evaluate(detections: Detections, truth: Mapping[str, Any], *, roi: str | None = None, radius: float = 0.5) -> Score:
    """Score detections on the floor against the truth.

    Parameters
    ----------
    detections
        For each frame an (N, 2) array of floor points in m, or a list of mappings with ``x`` and ``y``
        (:func:`load_objects`). A frame that is missing has no detections.
    truth
        The content of ``truth.json`` (:func:`load_truth`).
    roi
        Name of a polygon in ``truth["roi"]``. Truth and detections outside it are dropped before
        matching; a point on its boundary is inside.
    radius
        Metres; a detection and a true object match when closer than this. 0.5 m is the field's
        convention for people.

    Raises
    ------
    ValueError
        Unknown ``roi``, ``radius`` not positive, malformed truth or detections.

    Examples
    --------
    >>> truth = {"units": "m", "frames": {"0": [{"x": 0, "y": 0}], "1": [{"x": 1, "y": 0}]}}
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
        with_ids = with_ids and all("id" in thing for thing in (*detected, *true))
        for i, j, _ in pairs if with_ids else ():
            switches += last_id.get(true[j]["id"], detected[i]["id"]) != detected[i]["id"]
            last_id[true[j]["id"]] = detected[i]["id"]
    missed = expected - found
    return Score(
        moda=1 - (missed + false) / expected if expected else None,
        moda_public=max(0.0, 1 - seen_wrong / seen) if seen else None,
        modp=float(np.mean(1 - np.array(errors) / radius)) if errors else None,
        precision=_ratio(found, found + false),
        recall=_ratio(found, expected),
        f1=_ratio(2 * found, 2 * found + false + missed),
        error_mean_m=float(np.mean(errors)) if errors else None,
        error_median_m=float(np.median(errors)) if errors else None,
        tp=found,
        fp=false,
        fn=missed,
        truth_count=expected,
        frames=frames,
        ghosts_per_frame=_ratio(false, frames),
        id_switches=switches if with_ids and errors else None,
    )


def ghost_lifetimes(
    detections: Detections, truth: Mapping[str, Any], *, roi: str | None = None, radius: float = 0.5
) -> list[int]:
    """Over how many consecutive frames of the truth each ghost (false positive) stays.

    Parameters
    ----------
    detections, truth, roi, radius
        As for :func:`evaluate`.

    Returns
    -------
    list of int
        One length >= 1 in frames of the truth (not of the recording) a run, by first appearance; lower is
        better, empty without ghosts. A run ends when its id is absent, matched or outside ``roi``; when the
        id is a ghost again later, that is another run.

    Raises
    ------
    ValueError
        As :func:`evaluate`.

    Notes
    -----
    If any ghost lacks an id, ghosts of successive frames are linked by place instead, as in
    :func:`match_points`: one to one, nearer than ``radius``. With ids, one that comes twice in a frame
    counts once there.

    >>> truth = {"frames": {"0": [], "4": [], "8": []}}
    >>> ghost_lifetimes({0: [[1, 1]], 4: [[1.1, 1], [3, 3]]}, truth)
    [2, 1]
    """
    ghosts = []
    for detected, _, pairs in _matched_frames(detections, truth, roi, radius):
        matched = {i for i, _, _ in pairs}
        ghosts.append([thing for i, thing in enumerate(detected) if i not in matched])
    if all(thing.get("id") is not None for frame in ghosts for thing in frame):
        return _run_lengths([thing["id"] for thing in frame] for frame in ghosts)
    return _run_lengths(_linked(ghosts, radius))


def evaluate_hidden(
    detections: Detections,
    truth: Mapping[str, Any],
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
    >>> truth = {"frames": {"0": [{"x": 0, "y": 0, "hidden_fraction": {"left": 1.0, "right": 0.2}}]}}
    >>> evaluate_hidden({0: [{"x": 0, "y": 0, "hidden_in": ["left", "right"]}]}, truth)
    HiddenScore(precision=0.5, recall=1.0, f1=0.66..., tp=1, fp=1, fn=0, compared=2)
    """
    _check_fraction(hidden, "hidden")
    _check_cameras(cameras)
    outcomes: Counter[tuple[bool, bool]] = Counter()  # (reported, hidden)
    compared = 0
    for detected, true, pairs in _matched_frames(detections, truth, roi, radius):
        reported = {j: detected[i].get("hidden_in") or () for i, j, _ in pairs}
        for j, thing in enumerate(true):
            known = _known_fractions(thing, cameras)
            outcomes.update((name in reported.get(j, ()), known[name] >= hidden) for name in known)
            compared += len(known) if j in reported else 0
    tp, fp, fn = outcomes[True, True], outcomes[True, False], outcomes[False, True]
    return HiddenScore(
        precision=_ratio(tp, tp + fp),
        recall=_ratio(tp, tp + fn),
        f1=_ratio(2 * tp, 2 * tp + fp + fn),
        tp=tp,
        fp=fp,
        fn=fn,
        compared=compared,
    )


def recall_by_hidden_fraction(
    detections: Detections,
    truth: Mapping[str, Any],
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

    >>> truth = {"frames": {"0": [{"x": 0, "y": 0, "hidden_fraction": {"left": 1.0}}]}}
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
        for j, thing in enumerate(true):
            known = _known_fractions(thing, cameras).values()
            worst, best = max(known, default=0.0), min(known, default=np.inf)
            if edges[0] <= worst <= edges[-1] and (best_below is None or best < best_below):
                index = min(int(np.searchsorted(edges, worst, side="right")) - 1, len(total) - 1)
                total[index] += 1
                hits[index] += j in matched
    return [
        {"low": float(low), "high": float(high), "count": int(n), "recall": _ratio(int(hit), int(n))}
        for low, high, n, hit in zip(edges[:-1], edges[1:], total, hits, strict=True)
    ]


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
    return _ratio(int(occupied.sum()), int(_union(floor, footprints).sum()))


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


def free_space_blocked(occupied: Mask, floor: Floor, footprints: Sequence[npt.ArrayLike]) -> float | None:
    """Fraction of the truly free floor that the map claims as occupied, in [0, 1], lower is better.

    A cell is free when its centre lies in no footprint. ``None`` when the footprints fill the map.

    Parameters
    ----------
    occupied
        bool (ny, nx).
    floor
        The map's floor.
    footprints
        Polygons (M, 2) in m; none: the whole map is free.

    Raises
    ------
    ValueError
        ``occupied`` not bool or not of the floor's shape.

    >>> floor = Floor((0, 1), (0, 1), 0.5)
    >>> occupied = np.array([[True, True], [True, False]])
    >>> free_space_blocked(occupied, floor, [[[0, 0], [0.5, 0], [0.5, 1], [0, 1]]])
    0.5
    """
    _check_map(occupied, floor)
    free = ~_union(floor, footprints)
    return _ratio(int((occupied & free).sum()), int(free.sum()))


def _matched_frames(
    detections: Detections, truth: Mapping[str, Any], roi: str | None, radius: float
) -> Iterator[tuple[list[dict[str, Any]], list[dict[str, Any]], list[Pair]]]:
    """For each frame of the truth: detections and true objects in the region, and their pairs."""
    if not (np.isfinite(radius) and radius > 0):
        raise ValueError(f"radius: expected metres > 0, got {radius}")
    polygon = None if roi is None else _region(truth, roi)
    for frame, true in _truth_frames(truth).items():
        detected = _detected(detections.get(frame, ()), frame)
        if polygon is not None:
            detected, true = _keep(detected, polygon), _keep(true, polygon)
        yield detected, true, match_points(_positions(detected), _positions(true), radius)


def _known_fractions(thing: Mapping[str, Any], cameras: Sequence[str] | None) -> dict[str, float]:
    """A true object's hidden fraction in each of the cameras that it names; of all that it names for ``None``."""
    known = thing.get("hidden_fraction") or {}
    _check_hidden_fraction(known, "truth")
    return {name: known[name] for name in (known if cameras is None else cameras) if name in known}


def _linked(frames: Iterable[list[dict[str, Any]]], radius: float) -> Iterator[list[int]]:
    """For each frame a number for each thing: that of its partner in the frame before, else a new one."""
    new = count()
    before, numbers = np.empty((0, 2)), list[int]()
    for things in frames:
        now = _positions(things)
        same = {j: numbers[i] for i, j, _ in match_points(before, now, radius)}
        before, numbers = now, [same[j] if j in same else next(new) for j in range(len(now))]
        yield numbers


def _run_lengths(frames: Iterable[Sequence[Hashable]]) -> list[int]:
    """For each run of successive frames that hold a key its length, by first appearance.

    >>> _run_lengths([["a"], ["a", "b"], ["b"], ["a"]])
    [2, 2, 1]
    """
    lengths: list[int] = []
    runs: dict[Hashable, int] = {}  # the last frame's keys, and the index in `lengths` of their run
    for keys in frames:
        before, runs = runs, {}
        for key in dict.fromkeys(keys):
            if key not in before:
                lengths.append(0)
            runs[key] = before.get(key, len(lengths) - 1)
            lengths[runs[key]] += 1
    return lengths


def _detected(entries: Any, frame: int) -> list[dict[str, Any]]:
    """One frame's detections as mappings, whichever way they came."""
    where = f"detections[{frame}]"
    if len(entries) and isinstance(entries[0], Mapping):
        return _detected_things(list(entries), where)
    return _things([{"x": x, "y": y} for x, y in as_points(entries, name=where).tolist()], where)


def _keep(things: list[dict[str, Any]], polygon: FloatArray) -> list[dict[str, Any]]:
    inside = inside_polygon(_positions(things), polygon)
    return [thing for thing, keep in zip(things, inside, strict=True) if keep]


def _positions(things: list[dict[str, Any]]) -> FloatArray:
    return as_points([[thing["x"], thing["y"]] for thing in things])


def _distances(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    return np.asarray(np.linalg.norm(as_points(a)[:, None] - as_points(b)[None], axis=2))


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _union(floor: Floor, footprints: Sequence[npt.ArrayLike]) -> Mask:
    union = np.zeros(floor.shape, dtype=bool)
    for footprint in footprints:
        union |= floor.polygon_mask(footprint)
    return union


def _check_fraction(value: float, name: str) -> None:
    if not 0 < value <= 1:
        raise ValueError(f"{name}: expected a fraction in (0, 1], got {value}")


def _check_cameras(cameras: Sequence[str] | None) -> None:
    if isinstance(cameras, str):
        raise ValueError(f"cameras: expected a sequence of names, got {cameras!r}")


def _check_map(occupied: Mask, floor: Floor) -> None:
    if occupied.shape != floor.shape or occupied.dtype != bool:
        raise ValueError(f"occupied: expected bool {floor.shape}, got {occupied.dtype} {occupied.shape}")
