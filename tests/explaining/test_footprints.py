"""Footprints: the cells of each object that explains the views."""

from __future__ import annotations

import numpy as np
import pytest

from occlib.explaining import Prism, footprints
from occlib.explaining.prisms import BOX
from occlib.geometry import Floor

FLOOR = Floor((0.0, 2.0), (0.0, 1.0), 0.05)
X, Y = np.meshgrid(0.025 + 0.05 * np.arange(40), 0.025 + 0.05 * np.arange(20))


def test_cells_under_the_cylinder_and_evidence_beside_it() -> None:
    occupied = np.zeros(FLOOR.shape, bool)
    occupied[:, :24] = True
    labels = footprints([Prism(1.0, 0.5, 0.2, 1.0)], occupied, FLOOR)
    assert labels.dtype == np.int32 and set(np.unique(labels)) == {0, 1}
    distance = np.hypot(X - 1.0, Y - 0.5)
    assert (labels[distance <= 0.2] == 1).all()
    assert labels[(distance > 0.2) & ~occupied].max() == 0
    assert labels[(distance > 0.2) & (distance < 0.28) & occupied].min() == 1
    assert labels[distance > 0.31].max() == 0


@pytest.mark.parametrize("heading", [0.0, 0.6, -2.0])
@pytest.mark.parametrize("upper", [1.0, 0.3])
def test_cells_under_a_box_and_evidence_beside_it(heading: float, upper: float) -> None:
    """Whatever its waist: it stands on its base."""
    occupied = X < 1.1
    box = Prism(1.0, 0.5, 0.3, 1.0, BOX, heading, 0.4, 1.0 if upper == 1.0 else 0.5, upper)
    labels = footprints([box], occupied, FLOOR)
    along = (X - 1.0) * np.cos(heading) + (Y - 0.5) * np.sin(heading)
    across = (Y - 0.5) * np.cos(heading) - (X - 1.0) * np.sin(heading)
    beyond = np.maximum(abs(along) - 0.3, abs(across) - 0.12)
    spare = 0.05 + 0.3 / 4  # a quarter of half its length, and 5 cm
    mine = (beyond <= 0) | ((beyond <= spare) & occupied)
    close = (abs(beyond) < 1e-6) | (abs(beyond - spare) < 1e-6)  # where rounding decides
    np.testing.assert_array_equal(labels[~close], mine[~close])
    assert 0.8 * 0.6 * 0.24 < (labels[~occupied | (beyond <= 0)] > 0).sum() * 0.05**2 < 1.2 * 0.6 * 0.24


def test_a_cell_between_two_belongs_to_the_nearer_rim() -> None:
    labels = footprints([Prism(0.8, 0.5, 0.3, 1.0), Prism(1.2, 0.5, 0.3, 1.0)], np.ones(FLOOR.shape, bool), FLOOR)
    assert (labels[10, 10:19] == 1).all() and (labels[10, 21:30] == 2).all()
    boxes = [Prism(0.6, 0.5, 0.4, 1.0, BOX, np.pi / 2, 0.5), Prism(1.2, 0.5, 0.3, 1.0, BOX, 0.0, 0.5)]
    labels = footprints(boxes, np.ones(FLOOR.shape, bool), FLOOR)  # their rims at 0.8 and 0.9
    assert (labels[10, 8:17] == 1).all() and (labels[10, 17:30] == 2).all()


def test_an_object_outside_the_floor_has_no_cells_and_takes_none() -> None:
    outside = [Prism(-3.0, 0.5, 0.2, 1.0), Prism(1.0, 5.0, 0.2, 1.0), Prism(9.0, -9.0, 0.2, 1.0)]
    labels = footprints([*outside, Prism(1.0, 0.5, 0.2, 1.0)], np.ones(FLOOR.shape, bool), FLOOR)
    assert set(np.unique(labels)) == {0, 4}
    assert not footprints([], np.ones(FLOOR.shape, bool), FLOOR).any()
