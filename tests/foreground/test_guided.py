"""Evidence that follows the edges of the change."""

from __future__ import annotations

import cv2
import numpy as np

from occlib.foreground.guided import SMOOTH, WINDOW, follow_edges
from occlib.foreground.pictures import halved


def naive(evidence: np.ndarray, change: np.ndarray) -> np.ndarray:
    coarse, guide = cv2.medianBlur(halved(evidence), 3).astype(float), halved(change).astype(float)

    def around(values: np.ndarray, reach: int) -> np.ndarray:
        padded = np.pad(values, reach, mode="reflect")
        return np.lib.stride_tricks.sliding_window_view(padded, (2 * reach + 1,) * 2)

    def near(values: np.ndarray, pick: object) -> np.ndarray:
        padded = np.pad(values, 1, mode="edge")
        return pick(np.lib.stride_tricks.sliding_window_view(padded, (3, 3)), axis=(2, 3))  # type: ignore[operator, no-any-return]

    halfway = np.rint((near(guide, np.min) + near(guide, np.max)) / 2)
    coarse = np.where(guide < halfway, near(coarse, np.min), coarse)
    reach = WINDOW // 2
    x, y = around(guide, reach), around(coarse, reach)
    middle, level = x.mean((2, 3)), y.mean((2, 3))
    slope = ((x * y).mean((2, 3)) - middle * level) / ((x * x).mean((2, 3)) - middle**2 + SMOOTH)
    lines = [around(one, reach).mean((2, 3)).repeat(2, 0).repeat(2, 1) for one in (slope, level - slope * middle)]
    return np.clip(np.floor(lines[0] * change + lines[1] + 0.5), 0, 255)


def test_the_fast_lines_equal_the_equations() -> None:
    rng = np.random.default_rng(0)
    change, evidence = rng.integers(0, 6, (60, 80)).astype(np.uint8), np.zeros((60, 80), np.uint8)
    change[20:40, 30:60] = rng.integers(60, 90, (20, 30))
    evidence[20:40, 30:60] = rng.integers(180, 256, (20, 30))
    found, expected = follow_edges(evidence, change).astype(int), naive(evidence, change)
    assert np.abs(found - expected)[14:46, 24:66].max() <= 1
    assert not found[:6].any() and not found[:, :16].any()


def test_nothing_stays_nothing_and_single_px_go() -> None:
    rng = np.random.default_rng(0)
    change, evidence = rng.integers(0, 9, (60, 81)).astype(np.uint8), np.zeros((60, 81), np.uint8)
    assert not follow_edges(evidence, change).any()
    evidence[20:22, 20:22] = 255
    assert not (follow_edges(evidence, change) >= 128).any()


def test_a_rim_counts_where_half_of_its_px_is_object() -> None:
    """All of the rim changes enough to be evidence; that does not make the object larger."""
    rng = np.random.default_rng(2)
    share = np.clip((25 - np.hypot(*(np.mgrid[:100, :120] - np.array([50, 60])[:, None, None])) + 0.5), 0, 1)
    share = cv2.GaussianBlur(share, (3, 3), 0)
    change = (100 * share + rng.integers(0, 3, share.shape)).astype(np.uint8)
    evidence = np.where(change > 8, 255, 0).astype(np.uint8)
    true = (share >= 0.5).sum()
    assert (evidence >= 128).sum() > 1.04 * true
    assert abs((follow_edges(evidence, change) >= 128).sum() / true - 1) < 0.02
