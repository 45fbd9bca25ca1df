"""DOC"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled
from occlib.explaining.cylinders import PERSON_M, Cylinder, _as_array, plausible
from occlib.explaining.evidence import PolarEvidence
from occlib.explaining.search import DEFAULT, Explanation, _cover_all, _gain, _search

FEET_M, SPREAD_M, LEGS_M2, FEET_TRUST = 0.35, 0.4, 0.08, 4.0
"""Where a body's feet are looked for: so high above the floor and so far to the sides of its axis, in m; what two legs show there, in
m2; and by how much a view that shows them is trusted more than the axis (8 cm against 4 cm)."""


LEAN_M = 0.15
"""No body's feet are further from its axis, in m: then the views show something else."""


MEAN_SHARE = 0.02
"""A place that explains this share less counts 1/e in the mean."""


@compiled
def _between_feet(view: Any, size: Any, weights: Any, x: float, y: float) -> Any:
    """Azimuth in rad halfway between the outer edges of the foreground around the feet, and how much of two legs it shows, 0 to 1."""
    distance = max(np.hypot(x - view[0], y - view[1]), 2 * SPREAD_M)
    azimuth = (np.arctan2(y - view[1], x - view[0]) - view[3] + np.pi) % (2 * np.pi) - np.pi
    half = SPREAD_M / distance
    first = max(int(np.ceil((azimuth - half - view[4]) / view[6])), 0)
    last = min(int(np.floor((azimuth + half - view[4]) / view[6])) + 1, size[0])
    top = max(int(np.ceil((np.arctan2(view[2] - FEET_M, distance) - view[5]) / view[6])), 0)
    foot = min(int(np.floor((np.arctan2(view[2], distance - SPREAD_M) - view[5]) / view[6])) + 1, size[1])
    legs = np.zeros(max(last - first, 0))
    for column in range(first, last):
        for row in range(top, foot):
            legs[column - first] += max(weights[row, column], 0) / 255.0
    total, below, left, right = legs.sum(), 0.0, 0.0, 0.0
    for i in range(len(legs)):  # the outer edges, but for a fourteenth on either side
        if legs[i] > 0:
            if below < total / 14 <= below + legs[i]:
                left = i - 0.5 + (total / 14 - below) / legs[i]
            if below < total * 13 / 14 <= below + legs[i]:
                right = i - 0.5 + (total * 13 / 14 - below) / legs[i]
            below += legs[i]
    shown = total * (view[6] * np.hypot(distance, view[2])) ** 2 / LEGS_M2
    shown = min(shown, 1.0, max(2.6 - shown, 0.0))  # what shows more than legs shows something else, too
    return view[3] + view[4] + (first + (left + right) / 2) * view[6], shown


@compiled
def _mean_place(at: Any, sums: Any, thing: Any, cost: float) -> Any:
    """The mean of the places along the sight-lines of the two nearest views, each by how nearly a cylinder there explains as much."""
    best = max(_gain(at, sums, thing, cost), 1e-9)
    total, x, y = 0.0, 0.0, 0.0
    for k in np.argsort(np.hypot(thing[0] - at.views[:, 0], thing[1] - at.views[:, 1]))[:2]:
        dx, dy = thing[0] - at.views[k, 0], thing[1] - at.views[k, 1]
        distance = max(np.hypot(dx, dy), 1e-9)
        slope = (at.views[k, 2] - thing[3]) / distance
        for step in range(-4, 5):
            for wider in range(-1, 2):
                for higher in range(-1, 2):
                    other = thing.copy()
                    other[0] += 0.01 * step * dx / distance
                    other[1] += 0.01 * step * dy / distance
                    other[2] += 0.015 * wider
                    other[3] += 0.015 * higher - 0.01 * step * slope  # farther and lower looks the same
                    if plausible(other[2], other[3]):
                        weight = np.exp(min((_gain(at, sums, other, cost) / best - 1) / MEAN_SHARE, 50.0))
                        total, x, y = total + weight, x + weight * other[0], y + weight * other[1]
    if total == 0:
        return thing[0], thing[1]
    return x / total, y / total


@compiled
def _feet(at: Any, weights: Any, thing: Any) -> Any:
    """The point that agrees best with a body's axis and with the bearings between its feet, no further than it may lean."""
    x, y = thing[0], thing[1]
    for _ in range(3):
        a, b, c, u, v = 1.0, 0.0, 1.0, thing[0], thing[1]
        for k in range(len(at.views)):
            azimuth, shown = _between_feet(at.views[k], at.sizes[k], weights[k], x, y)
            p, q, trust = -np.sin(azimuth), np.cos(azimuth), FEET_TRUST * shown * shown
            off = p * at.views[k, 0] + q * at.views[k, 1]
            a, b, c = a + trust * p * p, b + trust * p * q, c + trust * q * q
            u, v = u + trust * off * p, v + trust * off * q
        x, y = (c * u - b * v) / (a * c - b * b), (a * v - b * u) / (a * c - b * b)
    share = min(LEAN_M / max(np.hypot(x - thing[0], y - thing[1]), 1e-9), 1.0)
    return thing[0] + share * (x - thing[0]), thing[1] + share * (y - thing[1])


@compiled
def _stand(at: Any, things: Any, cost: float, out: Any) -> None:
    for i in range(len(things)):
        body = things[i, 3] >= PERSON_M
        _cover_all(at, at.spare, at.spare_sums, things, len(things), i, 0.05 if body else 0.0)
        if body:
            out[i] = _feet(at, at.spare, things[i])
        else:
            out[i] = _mean_place(at, at.spare_sums, things[i], cost)


def standing_points(evidence: PolarEvidence, things: Sequence[Cylinder], *, how: Explanation = DEFAULT) -> FloatArray:
    """Where on the floor each object stands.

    The cylinder that explains most is one of many that explain nearly as much, above all where only one view sees the object: a
    little farther and lower looks the same. Its point is the mean over those within 4 cm along the sight-lines of the two nearest views, with weights
    ``exp((gain / largest - 1) / 0.02)``, other objects left as they are.

    A body leans, and its feet are where its legs are: its point is the one that agrees best with its axis ``p`` and with
    the bearing ``a_k`` halfway between its feet in each view,

        argmin |x - p|^2 + sum over views of 4 s_k^2 (n_k . (x - c_k))^2,    n_k = (-sin a_k, cos a_k)

    where ``c_k`` is the camera's station and ``s_k`` the share of two legs that it shows, other objects left out; none, if it shows
    far more than legs. It lies within 0.15 m of the axis.

    Parameters
    ----------
    evidence
        What the views say.
    things
        What :func:`explain` found in it.
    how
        Thresholds, of which the cost counts.

    Returns
    -------
    Floor points (N, 2) in m.

    Raises
    ------
    ValueError
        A place or size that is not finite, or a size that is not positive.
    """
    array = _as_array(things, "things")
    points = array[:, :2].copy()
    if len(array):
        _stand(_search(evidence), array, how.cost, points)
    return points
