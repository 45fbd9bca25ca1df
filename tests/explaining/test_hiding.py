"""Who hides whom: shares of samples counted one by one, near those of ray casting, and the right hider is named."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.prisms import BIG, LOW, SMALL, THREE, Watch, any_prisms, run_masks, sample_masks, watch
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.prisms import BOX, Prism
from occlib.lab.scenes import load_scene
from occlib.lab.truth import ground_truth


@pytest.mark.slow
@pytest.mark.parametrize("name", ["four_robots", "long_occlusion"])
def test_hidden_fractions_are_near_those_of_ray_casting(name: str) -> None:
    scene = load_scene(name)
    cameras = tuple(scene.rig.cameras)
    at = watch(cameras, name)
    differences = []
    for frame in range(0, scene.frames, 25):
        cylinders = []
        for one in scene.objects:
            (x, y), radius = cv2.minEnclosingCircle(one.footprint(frame).astype(np.float32))
            cylinders.append(Prism(float(x), float(y), float(radius), one.height))
        truth = [true.hidden_fraction for true in ground_truth(scene, frames=[frame]).frames[frame]]
        expected = np.array([[entry.get(camera, np.nan) for camera in cameras] for entry in truth])
        found, by = occlusion_state(at.evidence(), cylinders)
        np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
        assert (by[expected > 0.05] >= 0).all()
        differences.append(np.abs(found - expected))
    assert np.nanmean(differences) < 0.03
    assert np.nanmax(differences) < 0.45  # a bounding cylinder hides more than a rover does


def hidden_naive(at: Watch, prisms: Sequence[Prism], k: int) -> tuple[list[float], list[int]]:
    masks = [run_masks(at, prism)[k] & at.seen[k] for prism in prisms]
    distance = [np.hypot(c.x - at.views[k].x, c.y - at.views[k].y) for c in prisms]
    fractions, by = [], []
    for i, mask in enumerate(masks):
        nearer = [j for j in range(len(prisms)) if distance[j] < distance[i]]
        hidden = np.any([mask & masks[j] for j in nearer] or [np.zeros_like(mask)], axis=0)
        overlap = {j: int((mask & masks[j]).sum()) for j in nearer}
        fractions.append(hidden.sum() / mask.sum() if mask.any() else np.nan)
        most = max(overlap, key=lambda j: (overlap[j], -j), default=-1)
        by.append(most if most >= 0 and overlap[most] else -1)
    return fractions, by


@settings(max_examples=20, deadline=None)
@given(prisms=st.lists(any_prisms, min_size=1, max_size=5))
def test_the_occlusion_state_is_the_share_of_samples_that_nearer_ones_cover(prisms: list[Prism]) -> None:
    at = watch(THREE, step_px=6.0)
    fractions, by = occlusion_state(at.evidence(), prisms)
    assert fractions.shape == by.shape == (len(prisms), 3)
    for k in range(3):
        expected, hider = hidden_naive(at, prisms, k)
        np.testing.assert_allclose(fractions[:, k], expected)
        assert by[:, k].tolist() == hider
    assert ((fractions >= 0) & (fractions <= 1) | np.isnan(fractions)).all()  # NaN also between two columns


def test_a_board_hides_less_than_a_box_and_a_mast_less_than_a_column() -> None:
    """Shares as rays meet them: what stands behind is seen over the board, and on both sides of the mast."""
    at, behind = watch(), Prism(0.6, 0.1, 0.25, 0.6)
    whole = Prism(-0.2, 0.1, 0.3, 0.9, BOX, 0.3, 0.7)
    hidden = []
    for prism in (whole, whole._replace(height=0.05), whole._replace(waist=0.15, upper=0.2), whole._replace(ratio=0.2)):
        own, other = sample_masks(at, behind)[0] & at.seen[0], sample_masks(at, prism)[0]
        fractions, by = occlusion_state(at.evidence(), [behind, prism])
        assert fractions[0, 0] == pytest.approx((own & other).sum() / own.sum(), abs=0.01)
        assert fractions[1, 0] == 0 and by[0, 0] == (1 if fractions[0, 0] > 0 else -1)
        hidden.append(fractions[0, 0])
    assert hidden[0] > 0.9 and hidden[1] < 0.05 and 0.05 < hidden[2] < 0.6 and hidden[3] < hidden[0]


def test_the_nearer_hides_the_farther_and_the_right_one_is_named() -> None:
    at = watch()
    beside = Prism(0.4, 1.0, 0.1, 0.2)
    fractions, by = occlusion_state(at.evidence(), [SMALL, beside, BIG])
    assert fractions[0].tolist() == [1, 0] and by[0].tolist() == [2, -1]  # behind BIG from the left only
    assert fractions[1].tolist() == [0, 0] and by[1].tolist() == [-1, -1]
    assert fractions[2, 0] == 0 and by[2, 0] == -1  # the small one hides nothing that is nearer
    fractions, by = occlusion_state(at.evidence(), [BIG, LOW])
    assert fractions[1].tolist() == [1, 0] and by.tolist() == [[-1, 1], [0, -1]]
    assert fractions[0, 0] == 0 and 0 < fractions[0, 1] < 0.5  # from the right it hides some of BIG, which is farther


def test_outside_the_picture_is_nan_and_nobody_hides_it() -> None:
    at = watch()
    fractions, by = occlusion_state(at.evidence(), [Prism(-6.0, 0.0, 0.2, 0.5), BIG])
    assert np.isnan(fractions[0, 0]) and by[0, 0] == -1
    assert (fractions[1] == 0).all()
    fractions, by = occlusion_state(at.evidence(), [])
    assert fractions.shape == by.shape == (0, 2)


def test_what_is_no_prism_is_named() -> None:
    with pytest.raises(ValueError, match="prisms: expected finite places, sizes > 0 and a known outline, got"):
        occlusion_state(watch().evidence(), [BIG, Prism(0, 0, 0, 0.1)])
