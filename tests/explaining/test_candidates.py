"""The candidates with which the search begins are those of a plain search."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from helpers.cylinders import THREE, watch
from occlib.explaining.candidates import HEIGHTS, RADII, candidates
from occlib.explaining.cylinders import Cylinder, plausible
from occlib.explaining.objective import gain, workspace


def test_every_size_that_is_tried_has_a_plausible_partner() -> None:
    assert all(any(plausible(r, h) for h in HEIGHTS) for r in RADII)
    assert all(any(plausible(r, h) for r in RADII) for h in HEIGHTS)


@pytest.mark.parametrize(("seed", "share"), [(0, 0.5), (1, 0.2), (2, 0.05), (3, 0.0)])
def test_the_candidates_are_those_of_the_plain_search(seed: int, share: float) -> None:
    """Every place and radius by ``gain``, at heights from low to high until four in a row were worse than the best."""
    here, rng = watch(THREE), np.random.default_rng(seed)
    noise = np.stack([cv2.GaussianBlur(rng.normal(size=seen.shape), (0, 0), 9) for seen in here.seen])
    work = workspace(here.evidence(np.where(noise > np.quantile(noise, 1 - share), 255, -150)))
    places = rng.uniform((-2, -1.5), (2, 1.5), (25, 2))
    plain = []
    for (x, y), radius in itertools.product(places, RADII):
        tried, best = [], 0.0
        for height in (h for h in HEIGHTS if plausible(radius, h)):
            cylinder = Cylinder(x, y, radius, height)
            tried.append((gain(work, work.sums, cylinder, 0.15).value, *cylinder))
            best = max(best, tried[-1][0])
            if best > 0 and len(tried) > 4 and best not in [value for value, *_ in tried[-4:]]:
                break
        if best > 0:
            plain.append(max(tried, key=lambda one: one[0]))
    cylinders, values = candidates(work, work.sums, places, 0.15)
    assert len(plain) == len(values) and (len(plain) > 5 or share < 0.1)
    np.testing.assert_allclose(cylinders, np.array([cylinder for _, *cylinder in plain]).reshape(-1, 4))
    np.testing.assert_allclose(values, [value for value, *_ in plain], rtol=1e-9)
