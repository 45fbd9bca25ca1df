"""Footprints: the cells of each object that explains the views."""

from __future__ import annotations

import numpy as np

from occlib.explaining import Cylinder, footprints
from occlib.geometry import Floor

FLOOR = Floor((0.0, 2.0), (0.0, 1.0), 0.05)


def test_cells_under_the_cylinder_and_evidence_beside_it() -> None:
    occupied = np.zeros(FLOOR.shape, bool)
    occupied[:, :24] = True
    labels = footprints([Cylinder(1.0, 0.5, 0.2, 1.0)], occupied, FLOOR)
    assert labels.dtype == np.int32 and set(np.unique(labels)) == {0, 1}
    x, y = np.meshgrid(0.025 + 0.05 * np.arange(40), 0.025 + 0.05 * np.arange(20))
    distance = np.hypot(x - 1.0, y - 0.5)
    assert (labels[distance <= 0.2] == 1).all()
    assert labels[(distance > 0.2) & ~occupied].max() == 0
    assert labels[(distance > 0.2) & (distance < 0.28) & occupied].min() == 1
    assert labels[distance > 0.31].max() == 0


def test_a_cell_between_two_belongs_to_the_nearer_rim() -> None:
    labels = footprints([Cylinder(0.8, 0.5, 0.3, 1.0), Cylinder(1.2, 0.5, 0.3, 1.0)], np.ones(FLOOR.shape, bool), FLOOR)
    assert (labels[10, 10:19] == 1).all() and (labels[10, 21:30] == 2).all()


def test_an_object_outside_the_floor_has_no_cells_and_takes_none() -> None:
    outside = [Cylinder(-3.0, 0.5, 0.2, 1.0), Cylinder(1.0, 5.0, 0.2, 1.0), Cylinder(9.0, -9.0, 0.2, 1.0)]
    labels = footprints([*outside, Cylinder(1.0, 0.5, 0.2, 1.0)], np.ones(FLOOR.shape, bool), FLOOR)
    assert set(np.unique(labels)) == {0, 4}
