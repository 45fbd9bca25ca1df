"""Where an object stands: a person between the feet, all else at the mean of the places that explain as much."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled
from occlib.explaining.cylinders import PERSON_M, Cylinder, as_array, cylinder_at, plausible
from occlib.explaining.evidence import PolarEvidence, view_at
from occlib.explaining.objective import FULL, TINY, cover_all, gain, workspace
from occlib.explaining.search import DEFAULT, ExplainSettings

FEET_M, SPREAD_M = 0.35, 0.4
"""A person's feet are looked for up to this height above the floor and this far to the sides of its axis, in m."""

LEGS_M2, MAX_LEGS = 0.08, 2.6
"""Area in m2 that two legs show there. What shows more shows something else as well: beyond ``MAX_LEGS - 1`` times as
much the view is trusted less, from ``MAX_LEGS`` times on not at all."""

EDGE = 14
"""Of the foreground around the feet this part of the whole (a fourteenth) is left out on either side: noise."""

FEET_TRUST = 4.0
"""How much more a view that shows two legs is trusted than the axis: the square of 8 cm over 4 cm."""

FEET_ROUNDS = 3
"""So many times the feet are looked for, each time around the point found before."""

LEAN_M = 0.15
"""No person's feet are further from its axis, in m: then the views show something else."""

MARGIN_M = 0.05
"""Others are enlarged by so many m before they are left out, where a person's feet are looked for."""

MEAN_SHARE, MAX_EXPONENT = 0.02, 50.0
"""A place that explains this share less counts 1/e in the mean; the exponent is limited, so that it does not overflow."""

MEAN_VIEWS = 2
"""The mean runs along the sight-lines of so many views, those nearest to the object."""

MEAN_STEPS, MEAN_STEP_M, MEAN_SIZE_STEP_M = 4, 0.01, 0.015
"""Steps to either side along a sight-line and their length in m; one step in m up and down of radius and height."""


@compiled
def _between_feet(view: Any, size: Any, weights: Any, x: float, y: float) -> Any:
    """Azimuth in rad halfway between the outer edges of the foreground around the feet, and how much it is to be trusted.

    That is the share of two legs that it shows, 0 to 1, and less again if it shows more than legs."""
    distance = max(np.hypot(x - view.x, y - view.y), 2 * SPREAD_M)
    azimuth = (np.arctan2(y - view.y, x - view.x) - view.middle + np.pi) % (2 * np.pi) - np.pi
    half = SPREAD_M / distance
    first = max(int(np.ceil((azimuth - half - view.left) / view.step)), 0)
    last = min(int(np.floor((azimuth + half - view.left) / view.step)) + 1, size[0])
    top = max(int(np.ceil((np.arctan2(view.height - FEET_M, distance) - view.top) / view.step)), 0)
    foot = min(int(np.floor((np.arctan2(view.height, distance - SPREAD_M) - view.top) / view.step)) + 1, size[1])
    legs = np.zeros(max(last - first, 0))
    for column in range(first, last):
        for row in range(top, foot):
            legs[column - first] += max(weights[row, column], 0) / FULL
    total, below, left, right = legs.sum(), 0.0, 0.0, 0.0
    for i in range(len(legs)):
        if legs[i] > 0:
            if below < total / EDGE <= below + legs[i]:
                left = i - 0.5 + (total / EDGE - below) / legs[i]
            if below < total * (EDGE - 1) / EDGE <= below + legs[i]:
                right = i - 0.5 + (total * (EDGE - 1) / EDGE - below) / legs[i]
            below += legs[i]
    shown = total * (view.step * np.hypot(distance, view.height)) ** 2 / LEGS_M2
    shown = min(shown, 1.0, max(MAX_LEGS - shown, 0.0))
    return view.middle + view.left + (first + (left + right) / 2) * view.step, shown


@compiled
def _mean_place(work: Any, sums: Any, cylinder: Any, cost: float) -> Any:
    """The mean of places along the sight-lines of the nearest views, weighed by how much cylinders there explain."""
    best = max(gain(work, sums, cylinder, cost).value, TINY)
    total, x, y = 0.0, 0.0, 0.0
    for k in np.argsort(np.hypot(cylinder.x - work.views[:, 0], cylinder.y - work.views[:, 1]))[:MEAN_VIEWS]:
        view = view_at(work.views, k)
        dx, dy = cylinder.x - view.x, cylinder.y - view.y
        distance = max(np.hypot(dx, dy), TINY)
        slope = (view.height - cylinder.height) / distance
        for step in range(-MEAN_STEPS, MEAN_STEPS + 1):
            for wider in range(-1, 2):
                for higher in range(-1, 2):
                    other = Cylinder(
                        cylinder.x + MEAN_STEP_M * step * dx / distance,
                        cylinder.y + MEAN_STEP_M * step * dy / distance,
                        cylinder.radius + MEAN_SIZE_STEP_M * wider,
                        # farther and lower looks the same
                        cylinder.height + (MEAN_SIZE_STEP_M * higher - MEAN_STEP_M * step * slope),
                    )
                    if plausible(other.radius, other.height):
                        value = gain(work, sums, other, cost).value
                        weight = np.exp(min((value / best - 1) / MEAN_SHARE, MAX_EXPONENT))
                        total, x, y = total + weight, x + weight * other.x, y + weight * other.y
    if total == 0:
        return cylinder.x, cylinder.y
    return x / total, y / total


@compiled
def _feet(work: Any, weights: Any, cylinder: Any) -> Any:
    """The point that agrees best with a person's axis and with the bearings between the feet, within :data:`LEAN_M`.

    The least squares of :func:`standing_points`, by their normal equations: ``[[a, b], [b, c]] (x, y) = (u, v)``.
    """
    x, y = cylinder.x, cylinder.y
    for _ in range(FEET_ROUNDS):
        a, b, c, u, v = 1.0, 0.0, 1.0, cylinder.x, cylinder.y
        for k in range(len(work.views)):
            view = view_at(work.views, k)
            azimuth, shown = _between_feet(view, work.sizes[k], weights[k], x, y)
            p, q, trust = -np.sin(azimuth), np.cos(azimuth), FEET_TRUST * shown * shown
            off = p * view.x + q * view.y
            a, b, c = a + trust * p * p, b + trust * p * q, c + trust * q * q
            u, v = u + trust * off * p, v + trust * off * q
        x, y = (c * u - b * v) / (a * c - b * b), (a * v - b * u) / (a * c - b * b)
    share = min(LEAN_M / max(np.hypot(x - cylinder.x, y - cylinder.y), TINY), 1.0)
    return cylinder.x + share * (x - cylinder.x), cylinder.y + share * (y - cylinder.y)


@compiled
def _stand(work: Any, cylinders: Any, cost: float, points: Any) -> None:
    """Fill ``points`` (N, 2): of each cylinder, from the evidence that the others leave."""
    for i in range(len(cylinders)):
        cylinder = cylinder_at(cylinders, i)
        person = cylinder.height >= PERSON_M
        cover_all(work, work.left, work.left_sums, cylinders, len(cylinders), i, MARGIN_M if person else 0.0)
        if person:
            points[i] = _feet(work, work.left, cylinder)
        else:
            points[i] = _mean_place(work, work.left_sums, cylinder, cost)


def standing_points(
    evidence: PolarEvidence, cylinders: Sequence[Cylinder], *, settings: ExplainSettings = DEFAULT
) -> FloatArray:
    """Where on the floor each object stands.

    The cylinder that explains most is one of many that explain nearly as much, above all where only one view sees the
    object: a little farther and lower looks the same. Its point is the mean over those within 4 cm along the
    sight-lines of the two nearest views, with weights ``exp((gain / largest - 1) / 0.02)``, other objects left as they
    are.

    A person, a cylinder of 1.4 m or more, leans, and stands where the legs are: its point is the one that agrees best
    with its axis ``p`` and with the bearing ``a_k`` halfway between its feet in each view::

        argmin |x - p|^2 + sum over views of 4 s_k^2 (n_k . (x - c_k))^2,    n_k = (-sin a_k, cos a_k)

    where ``c_k`` is the camera's station and ``s_k`` the share of two legs that it shows, other objects left out; 0, if
    it shows far more than legs. It lies within 0.15 m of the axis.

    Parameters
    ----------
    evidence
        What the views say.
    cylinders
        What :func:`occlib.explaining.search.explain` found in it.
    settings
        Of which the cost counts.

    Returns
    -------
    Floor points (N, 2) in m.

    Raises
    ------
    ValueError
        A place or size that is not finite, or a size that is not positive.
    """
    array = as_array(cylinders, "cylinders")
    points = array[:, :2].copy()
    if len(array):
        _stand(workspace(evidence), array, settings.cost, points)
    return points
