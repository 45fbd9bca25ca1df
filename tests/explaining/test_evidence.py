"""Evidence of polar views: running sums, views of different size side by side, and wrong evidence is named.

What a polar view shows of a picture is tested in ``tests/test_registration.py``, beside the other warps.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers.prisms import LEFT_RIGHT, seen_from, watch
from occlib.explaining.evidence import PolarEvidence, PolarView, running_sums, view_at


def test_running_sums_hold_what_lies_above_each_row() -> None:
    values = np.random.default_rng(0).integers(-9, 10, (2, 5, 3)).astype(np.int32)
    sums = running_sums(values)
    assert sums.shape == (2, 6, 3) and sums.dtype == np.int32
    for row in range(6):
        np.testing.assert_array_equal(sums[:, row], values[:, :row].sum(axis=1))
    assert running_sums(np.ones((1, 4, 2), bool))[0, :, 0].tolist() == [0, 1, 2, 3, 4]


def test_a_row_of_views_is_a_polar_view_by_name() -> None:
    at = watch()
    views = at.evidence().views
    assert views.shape == (2, len(PolarView._fields))
    assert [view_at(views, k) for k in range(2)] == at.views


def test_views_of_different_size_lie_side_by_side() -> None:
    view = watch().views[0]
    wide, tall = np.arange(8).reshape(2, 4) > 0, np.ones((3, 2), bool)
    evidence = PolarEvidence.of([(view, 7 * wide, wide), (view, -5 * tall, tall)])
    assert evidence.sizes.tolist() == [[4, 2], [2, 3]]
    assert evidence.weights.sum(axis=(1, 2)).tolist() == [49, -30]
    assert not evidence.weights[~evidence.seen].any() and evidence.seen.sum(axis=(1, 2)).tolist() == [7, 6]


def test_wrong_evidence_is_named() -> None:
    good = seen_from(LEFT_RIGHT, [])
    shape = good.weights.shape
    wrong: list[tuple[str, Any, str]] = [
        ("weights", good.weights.astype(np.float64), r"weights: expected int32 \(K, rows, columns\), got float64"),
        ("weights", good.weights[0], "weights: expected int32"),
        ("weights", good.weights[:, :-1], r"seen: expected bool \(2, "),
        ("seen", good.seen.astype(np.uint8), "seen: expected bool .* got uint8"),
        ("seen", good.seen[:1], "seen: expected bool"),
        ("views", good.views[:, :7], r"views: expected \(2, 8\) finite numbers, got \(2, 7\)"),
        ("views", good.views[:1], r"views: expected \(2, 8\)"),
        ("views", np.where(np.arange(8) == 2, np.nan, good.views), r"views: expected \(2, 8\) finite"),
        ("sizes", good.sizes[:1], "sizes: expected 2 times columns, rows up to"),
        ("sizes", good.sizes[:, ::-1], f"sizes: .*up to .{shape[2]}, {shape[1]}., got"),
        ("sizes", -good.sizes, "sizes: expected"),
    ]
    for field, value, message in wrong:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(good, **{field: value})
