"""Where an object stands: a person between the feet, all else at the mean of the places that explain as much."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray
from occlib.base.kernels import compiled
from occlib.explaining.evidence import PolarEvidence, view_at
from occlib.explaining.objective import ADD, FULL, TAKE, TINY, gain, put_all, workspace
from occlib.explaining.prisms import Prism, as_array, is_person, plausible, prism_at, resized
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
def _between_feet(view: Any, size: Any, sums: Any, x: float, y: float) -> Any:
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
            legs[column - first] += max(sums[row + 1, column] - sums[row, column], 0) / FULL
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
def _mean_place(work: Any, sums: Any, prism: Any, cost: float) -> Any:
    """The mean of places along the sight-lines of the nearest views, weighed by how much prisms there explain."""
    best = max(gain(work, sums, prism, cost).value, TINY)
    total, x, y = 0.0, 0.0, 0.0
    for k in np.argsort(np.hypot(prism.x - work.views[:, 0], prism.y - work.views[:, 1]))[:MEAN_VIEWS]:
        view = view_at(work.views, k)
        dx, dy = prism.x - view.x, prism.y - view.y
        distance = max(np.hypot(dx, dy), TINY)
        slope = (view.height - prism.height) / distance
        for step in range(-MEAN_STEPS, MEAN_STEPS + 1):
            for wider in range(-1, 2):
                for higher in range(-1, 2):
                    other = resized(
                        prism,
                        prism.x + MEAN_STEP_M * step * dx / distance,
                        prism.y + MEAN_STEP_M * step * dy / distance,
                        prism.radius + MEAN_SIZE_STEP_M * wider,
                        # farther and lower looks the same
                        prism.height + (MEAN_SIZE_STEP_M * higher - MEAN_STEP_M * step * slope),
                    )
                    if plausible(other):
                        value = gain(work, sums, other, cost).value
                        weight = np.exp(min((value / best - 1) / MEAN_SHARE, MAX_EXPONENT))
                        total, x, y = total + weight, x + weight * other.x, y + weight * other.y
    if total == 0:
        return prism.x, prism.y
    return x / total, y / total


@compiled
def _feet(work: Any, sums: Any, prism: Any) -> Any:
    """The point that agrees best with a person's axis and with the bearings between the feet, within :data:`LEAN_M`.

    The least squares of :func:`standing_points`, by their normal equations: ``[[a, b], [b, c]] (x, y) = (u, v)``.
    """
    x, y = prism.x, prism.y
    for _ in range(FEET_ROUNDS):
        a, b, c, u, v = 1.0, 0.0, 1.0, prism.x, prism.y
        for k in range(len(work.views)):
            view = view_at(work.views, k)
            azimuth, shown = _between_feet(view, work.sizes[k], sums[k], x, y)
            p, q, trust = -np.sin(azimuth), np.cos(azimuth), FEET_TRUST * shown * shown
            off = p * view.x + q * view.y
            a, b, c = a + trust * p * p, b + trust * p * q, c + trust * q * q
            u, v = u + trust * off * p, v + trust * off * q
        x, y = (c * u - b * v) / (a * c - b * b), (a * v - b * u) / (a * c - b * b)
    share = min(LEAN_M / max(np.hypot(x - prism.x, y - prism.y), TINY), 1.0)
    return prism.x + share * (x - prism.x), prism.y + share * (y - prism.y)


@compiled
def _stand(work: Any, prisms: Any, cost: float, points: Any) -> None:
    """Fill ``points`` (N, 2): of each prism, from the evidence that the others leave."""
    for i in range(len(prisms)):
        prism = prism_at(prisms, i)
        cover, margin = work.scratch, MARGIN_M if is_person(prism) else 0.0
        put_all(work, cover, prisms, len(prisms), i, margin, ADD)
        if is_person(prism):
            points[i] = _feet(work, cover.sums, prism)
        else:
            points[i] = _mean_place(work, cover.sums, prism, cost)
        put_all(work, cover, prisms, len(prisms), i, margin, TAKE)


def standing_points(
    evidence: PolarEvidence, prisms: Sequence[Prism], *, settings: ExplainSettings = DEFAULT
) -> FloatArray:
    """Where on the floor each object stands.

    The prism that explains most is one of many that explain nearly as much, above all where only one view sees the
    object: a little farther and lower looks the same. Its point is the mean over those within 4 cm along the
    sight-lines of the two nearest views, with weights ``exp((gain / largest - 1) / 0.02)``, other objects left as they
    are.

    A person, a prism of 1.4 m or more, leans, and stands where the legs are: its point is the one that agrees best
    with its axis ``p`` and with the bearing ``a_k`` halfway between its feet in each view::

        argmin |x - p|^2 + sum over views of 4 s_k^2 (n_k . (x - c_k))^2,    n_k = (-sin a_k, cos a_k)

    where ``c_k`` is the camera's station and ``s_k`` the share of two legs that it shows, other objects left out; 0, if
    it shows far more than legs. It lies within 0.15 m of the axis.

    Parameters
    ----------
    evidence
        What the views say.
    prisms
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
    array = as_array(prisms, "prisms")
    points = array[:, :2].copy()
    if len(array):
        _stand(workspace(evidence), array, settings.cost, points)
    return points
