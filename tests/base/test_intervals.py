"""Confidence intervals, by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from occlib.base import intervals


def test_wilson_interval_by_hand():
    low, high = intervals.wilson_interval([0, 5, 0], [10, 10, 0])
    z2 = 1.959964**2
    assert low[0] == 0 and high[0] == pytest.approx(z2 / (10 + z2))
    assert (low[1] + high[1]) / 2 == pytest.approx(0.5) and high[1] == pytest.approx(0.763, abs=1e-3)
    assert np.isnan(low[2]) and np.isnan(high[2])


def test_t_interval_by_hand():
    assert intervals.t_interval([4.0, 6.0]) == pytest.approx((5, 5 - 12.7062, 5 + 12.7062), rel=1e-4)  # t(1) = 12.706
    mean, low, high = intervals.t_interval([7.0, np.nan])
    assert mean == 7 and np.isnan(low) and np.isnan(high) and np.isnan(intervals.t_interval([])).all()


def test_stratified_interval_ignores_what_differs_between_sources():
    index = pd.MultiIndex.from_product([["a", "b"], [0, 1, 2]], names=["source", "seed"])
    one = intervals.stratified_interval(pd.Series([1, 2, 3, 1, 2, 3.0], index))
    far = intervals.stratified_interval(pd.Series([1, 2, 3, 101, 102, 103.0], index))
    half = 2.776445 * np.sqrt(1 * (1 / 3 + 1 / 3)) / 2  # t(4), variance 1
    assert one == pytest.approx((2, 2 - half, 2 + half)) and far == pytest.approx((52, 52 - half, 52 + half))
    still = 2.776445 * np.sqrt(3 / 6 * 0.05**2 * (1 / 3 + 1 / 3)) / 2  # nothing varies: the rule of three
    assert intervals.stratified_interval(pd.Series([1, 1, 1, 2, 2, 2.0], index)) == pytest.approx(
        (1.5, 1.5 - still, 1.5 + still)
    )
    single = intervals.stratified_interval(pd.Series([1, 2.0], index[[0, 3]]))
    assert single[0] == 1.5 and np.isnan(single[1:]).all()
