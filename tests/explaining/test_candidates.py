"""The candidates with which the search begins are those of a plain search."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from helpers.prisms import THREE, watch
from occlib.explaining.candidates import HEIGHTS, RADII, candidates
from occlib.explaining.objective import gain, workspace
from occlib.explaining.prisms import FIELDS, Prism, plausible


def may(radius: float, height: float) -> bool:
    return bool(plausible(Prism(0.0, 0.0, radius, height)))


def test_every_size_that_is_tried_has_a_plausible_partner() -> None:
    assert all(any(may(r, h) for h in HEIGHTS) for r in RADII)
    assert all(any(may(r, h) for r in RADII) for h in HEIGHTS)


@pytest.mark.parametrize("gloss", [0.0, 0.7])
@pytest.mark.parametrize(("seed", "share"), [(0, 0.5), (1, 0.2), (2, 0.05), (3, 0.0)])
def test_the_candidates_are_those_of_the_plain_search(seed: int, share: float, gloss: float) -> None:
    """Of every place the best radius and height by ``gain``, at heights from low to high until four were worse."""
    here, rng = watch(THREE), np.random.default_rng(seed)
    noise = np.stack([cv2.GaussianBlur(rng.normal(size=seen.shape), (0, 0), 9) for seen in here.seen])
    work = workspace(here.evidence(np.where(noise > np.quantile(noise, 1 - share), 255, -150)), [gloss, gloss / 2, 0.0])
    places = rng.uniform((-2, -1.5), (2, 1.5), (150, 2))
    plain = []
    for x, y in places:
        of_place = []
        for radius in RADII:
            tried, best = [], 0.0
            for height in (h for h in HEIGHTS if may(radius, h)):
                cylinder = Prism(x, y, radius, height)
                tried.append((gain(work, work.sums, cylinder, 0.15).value, *cylinder))
                best = max(best, tried[-1][0])
                if best > 0 and len(tried) > 4 and best not in [value for value, *_ in tried[-4:]]:
                    break
            if best > 0:
                of_place.append(max(tried, key=lambda one: one[0]))
        if of_place:
            plain.append(max(of_place, key=lambda one: one[0]))
    cylinders, values = candidates(work, work.sums, places, 0.15, 10**9)
    assert len(plain) == len(values) and (len(plain) > 8 or share < 0.1)
    np.testing.assert_allclose(cylinders, np.array([cylinder for _, *cylinder in plain]).reshape(-1, FIELDS))
    np.testing.assert_allclose(values, [value for value, *_ in plain], rtol=1e-9)
