"""The memory in the map: an object that one instant misses does not become free floor.

A tracked object may blink out for a moment while it stands in plain view, as when its colour is taken for the floor's in a shadow. The
tracker lets it coast (:meth:`occlib.tracking.Tracker.coasting`), and its cells stay on the map: its last footprint, moved to where it is
expected. They become free when it is seen elsewhere, has left the floor, or has coasted for ``max_missed_s``. Identity is that of the
track. What the paper says of this is that vectors "are created and destroyed based on the appearance and disappearance of the
objects" (section 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import Mask
from occlib.geometry import Floor
from occlib.mapping import Remembered
from occlib.tracking import ObjectVector, Point

Labels = npt.NDArray[np.int32]


class FootprintMemory:
    """The last footprint of each object, for as long as it coasts.

    Parameters
    ----------
    floor
        The map's floor.

    Examples
    --------
    >>> memory = FootprintMemory(Floor((0, 4), (0, 1), 1.0))
    >>> seen, expected = (ObjectVector(7, (x, 0.5), (0.0, 0.0), 1.0, (0, 0, 0)) for x in (0.5, 2.5))
    >>> memory.update(np.array([[1, 0, 0, 0]], np.int32), [seen], [])
    >>> memory.update(np.zeros((1, 4), np.int32), [], [expected])
    Remembered(expected=array([[False, False,  True, False]]), way=array([[ True,  True,  True, False]]))
    """

    def __init__(self, floor: Floor) -> None:
        self.floor = floor
        self._labels, self._objects = np.zeros(floor.shape, np.int32), dict[int, tuple[int, Point]]()
        self._held: dict[int, _Footprint] = {}

    def update(
        self, labels: Labels, objects: Sequence[ObjectVector], coasting: Sequence[ObjectVector]
    ) -> Remembered | None:
        """Take the footprints of one instant; return the cells of the objects that coast, if there are any.

        Parameters
        ----------
        labels
            int32 (ny, nx): 0, or the index of the cell's object in ``objects`` plus 1. It is read again in the next call.
        objects
            The confirmed objects that are seen.
        coasting
            Those that are not, where they are expected. What is neither seen nor among them is forgotten.
        """
        held = {one.id: footprint for one in coasting if (footprint := self._held.get(one.id) or self._last(one.id))}
        self._labels, self._held = labels, held
        self._objects = {one.id: (number, one.position_m) for number, one in enumerate(objects, start=1)}
        if not held:
            return None
        remembered = Remembered(np.zeros(self.floor.shape, bool), np.zeros(self.floor.shape, bool))
        for one in coasting:
            if one.id in held:
                self._add(remembered, held[one.id], one.position_m)
        return remembered

    def _last(self, identity: int) -> _Footprint | None:
        """The footprint that an object had in the last instant; ``None`` if it had no cells."""
        number, position = self._objects.get(identity, (-1, (0.0, 0.0)))
        iy, ix = np.nonzero(self._labels == number)
        if not len(iy):
            return None
        row, column = int(iy.min()), int(ix.min())
        cells = np.zeros((int(iy.max()) - row + 1, int(ix.max()) - column + 1), bool)
        cells[iy - row, ix - column] = True
        return _Footprint(cells, row, column, position)

    def _add(self, remembered: Remembered, footprint: _Footprint, expected: Point) -> None:
        """Set the cells of a footprint whose object is expected at a place, in m, and those on the way there."""
        shift = np.rint(np.subtract(expected, footprint.position_m) / self.floor.resolution)
        steps = max(1, int(np.abs(shift).max()))
        for step in range(steps + 1):
            right, up = np.rint(shift * (step / steps)).astype(int).tolist()
            footprint.add_to(remembered.way, right, up)
        footprint.add_to(remembered.expected, right, up)


class _Footprint(NamedTuple):
    """The cells of an object, bool (h, w), the map's row and column where they begin, and where the object was seen."""

    cells: Mask
    row: int
    column: int
    position_m: Point

    def add_to(self, mask: Mask, right: int, up: int) -> None:
        """Set these cells in a mask (ny, nx), moved by so many; what is beyond the edge is left out."""
        row, column, (ny, nx) = self.row + up, self.column + right, mask.shape
        part = self.cells[max(0, -row) : max(0, ny - row), max(0, -column) : max(0, nx - column)]
        row, column = max(0, row), max(0, column)
        mask[row : row + part.shape[0], column : column + part.shape[1]] |= part
