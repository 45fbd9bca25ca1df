"""The mirror in the floor: how much of the objects it shows is read off below their bases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.prisms import (
    LEFT_RIGHT,
    THREE,
    Array,
    Watch,
    any_prisms,
    lower_rows,
    mirror_masks,
    plausible_boxes,
    plausible_cylinders,
    sample_masks,
    seen_from,
    watch,
)
from occlib.explaining.evidence import PolarEvidence
from occlib.explaining.mirror import LEAST_SAMPLES, mirrored_shares
from occlib.explaining.prisms import BOX, Prism

DRUM, BOARD = Prism(0.1, 0.2, 0.25, 0.5), Prism(-0.6, -0.5, 0.3, 0.35, BOX, 0.5, 0.5)


def glossy(at: Watch, prisms: Sequence[Prism], gloss: Sequence[float]) -> Array:
    """Foreground where rays meet a prism, so much of it where the floor mirrors one, else background."""
    weights = np.full(at.seen.shape, -150)
    for k, share in enumerate(gloss):
        for prism in prisms:
            image = mirror_masks(at, prism)[k]
            weights[k][image] = np.maximum(weights[k][image], round(255 * share) if share else -150)
    for prism in prisms:
        weights[sample_masks(at, prism)] = 255
    return np.asarray(weights * at.seen, np.int32)


def test_the_share_is_what_was_planted_in_each_view() -> None:
    at = watch(THREE)
    shares = mirrored_shares(at.evidence(glossy(at, [DRUM, BOARD], [0.8, 0.0, 0.3])), [DRUM, BOARD])
    assert shares.shape == (2, 3)
    np.testing.assert_allclose(shares, [[0.8, 0, 0.3]] * 2, atol=0.03)
    assert mirrored_shares(at.evidence(), []).shape == (0, 3)


@settings(max_examples=20, deadline=None)
@given(
    prisms=st.lists(st.one_of(plausible_cylinders, plausible_boxes), min_size=1, max_size=3), seed=st.integers(0, 99)
)
def test_it_is_the_mean_of_the_foreground_in_the_image_where_no_object_stands(prisms: list[Prism], seed: int) -> None:
    """Sample by sample; NaN where fewer than 30 are clear."""
    at = watch(LEFT_RIGHT)
    weights = np.random.default_rng(seed).integers(-255, 256, at.seen.shape) * at.seen
    shares = mirrored_shares(at.evidence(weights), prisms)
    taken = np.any([sample_masks(at, prism) for prism in prisms], axis=0)
    for i, prism in enumerate(prisms):
        image = lower_rows(mirror_masks(at, prism), sample_masks(at, prism)) & ~taken & at.seen
        for k in range(2):
            found = np.maximum(weights[k][image[k]], 0) / 255
            if len(found) > LEAST_SAMPLES + 10:
                # at the rims rounding decides about a sample a column
                assert shares[i, k] == pytest.approx(found.mean(), abs=0.02 + 2 / np.sqrt(len(found)) ** 1.5)
            elif len(found) < LEAST_SAMPLES - 10:
                assert np.isnan(shares[i, k])


@settings(max_examples=10, deadline=None)
@given(prism=any_prisms)
def test_a_share_lies_between_0_and_1_and_is_that_of_the_view(prism: Prism) -> None:
    at = watch(THREE)
    weights = np.array([255, 0, -255])[:, None, None] * at.seen
    for share, whole in zip(mirrored_shares(at.evidence(weights), [prism])[0], (1, 0, 0), strict=True):
        assert np.isnan(share) or share == whole


def test_an_image_that_nobody_sees_says_nothing() -> None:
    at = watch()
    seen = seen_from(LEFT_RIGHT, [DRUM])
    assert np.isfinite(mirrored_shares(seen, [DRUM])).all()
    blind = PolarEvidence(seen.views, seen.sizes, seen.weights, seen.seen & ~mirror_masks(at, DRUM))
    assert np.isnan(mirrored_shares(blind, [DRUM])).all()
    before = Prism(-0.3, 0.18, 0.35, 0.5)  # from the left it stands before the whole image
    shares = mirrored_shares(seen_from(LEFT_RIGHT, [DRUM, before]), [DRUM, before])
    assert np.isnan(shares[0, 0]) and np.isfinite(shares[0, 1])


@pytest.mark.xfail(strict=True, reason="the image of what has a waist is taken to be as wide as its base throughout")
def test_of_a_robot_with_a_mast_it_is_what_was_planted_too() -> None:
    at, robot = watch(), Prism(0.1, 0.2, 0.25, 0.8, waist=0.25, upper=0.25)
    shares = mirrored_shares(at.evidence(glossy(at, [robot], [0.8, 0.8])), [robot])
    np.testing.assert_allclose(shares, 0.8, atol=0.05)
