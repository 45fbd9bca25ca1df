"""The occupancy map that the robots receive (section 5 of the paper), and its files for ROS.

Values are those of ``nav_msgs/OccupancyGrid``: 0 free, 100 occupied, -1 unknown. What no camera sees is
unknown, never free. Files are the pair of ROS ``map_server`` (https://wiki.ros.org/map_server): ``NAME.pgm``
with 254 free, 0 occupied and 205 unknown, and ``NAME.yaml``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import yaml

from occlib.geometry import Floor, Mask
from occlib.recordings import read_image, read_yaml, write_file

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
BLIND, ONE_VIEW, DISAGREE, UNCONFIRMED = 1, 2, 3, 4
REASONS = {BLIND: "no camera sees it", ONE_VIEW: "one view only", DISAGREE: "views disagree", UNCONFIRMED: "new"}
"""Why a cell is unknown: blind; foreground in the only view that is left; foreground that the objects on the map explain; or
something new that may be a ghost."""
MapData: TypeAlias = npt.NDArray[np.int8]

_GREY = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
_OCCUPIED_THRESH = 0.65
_FREE_THRESH = 0.196  # 205 is (255 - 205) / 255 = 0.19608: with 0.25 it would read as free


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """What is known of the floor at one instant.

    Parameters
    ----------
    data
        int8 (ny, nx): 0 free, 100 occupied, -1 unknown. Row 0 is the smallest ``y`` (ROS order).
    floor
        Where the map lies.
    """

    data: MapData
    floor: Floor

    def __post_init__(self) -> None:
        if self.data.shape != self.floor.shape or self.data.dtype != np.int8:
            raise ValueError(f"data: expected int8 {self.floor.shape}, got {self.data.dtype} {self.data.shape}")

    def __eq__(self, other: object) -> bool:
        """Same values on the same floor."""
        if not isinstance(other, OccupancyMap):
            return NotImplemented
        return self.floor == other.floor and np.array_equal(self.data, other.data)


def occupancy_map(occupied: Mask, visible: Mask, floor: Floor) -> OccupancyMap:
    """The map of one instant from what the views agree on.

    Parameters
    ----------
    occupied
        bool (ny, nx), cells that the fusion rule claims. They are occupied even where not ``visible``.
    visible
        bool (ny, nx), cells that enough cameras see. The others are unknown unless occupied.
    floor
        The map's floor.

    Examples
    --------
    >>> grid = occupancy_map(np.array([[True, False, False]]), np.array([[True, True, False]]),
    ...                      Floor((0, 3), (0, 1), 1.0))
    >>> grid.data
    array([[100,   0,  -1]], dtype=int8)
    """
    for name, mask in (("occupied", occupied), ("visible", visible)):
        if mask.shape != floor.shape or mask.dtype != bool:
            raise ValueError(f"{name}: expected bool {floor.shape}, got {mask.dtype} {mask.shape}")
    # Plain int8 arithmetic, ten times as fast as masked assignment: 101, 1 or 0, less one.
    claimed = occupied.view(np.int8) * np.int8(OCCUPIED - UNKNOWN)
    return OccupancyMap(np.maximum(claimed, visible.view(np.int8)) + np.int8(UNKNOWN), floor)


def save_map(path: str | Path, grid: OccupancyMap) -> Path:
    """Write ``NAME.pgm``, then ``NAME.yaml`` beside it; return the latter's path.

    Parameters
    ----------
    path
        ``NAME``, ``NAME.yaml`` or ``NAME.pgm``.
    grid
        The map. Row 0 of the PGM is the *largest* ``y``.

    Raises
    ------
    ValueError
        A value other than -1, 0 and 100, or the files cannot be written.
    """
    target = Path(path)
    stem = target.stem if target.suffix in (".yaml", ".yml", ".pgm") else target.name
    image, description = target.with_name(f"{stem}.pgm"), target.with_name(f"{stem}.yaml")
    write_file(image, _pgm(grid.data))
    fields = {
        "image": image.name,
        "mode": "trinary",
        "resolution": float(grid.floor.resolution),
        "origin": [float(grid.floor.x[0]), float(grid.floor.y[0]), 0.0],
        "negate": 0,
        "occupied_thresh": _OCCUPIED_THRESH,
        "free_thresh": _FREE_THRESH,
    }
    return write_file(description, yaml.safe_dump(fields, sort_keys=False, default_flow_style=None))


def load_map(path: str | Path) -> OccupancyMap:
    """Read a ``map_server`` pair by its YAML file, with the strict comparisons of ``map_server``.

    A cell of grey ``v`` has ``p = (255 - v) / 255`` (``v / 255`` if ``negate``): occupied if
    ``p > occupied_thresh``, free if ``p < free_thresh``, else unknown. The floor's far edges are rounded to
    1e-9 m.

    Raises
    ------
    ValueError
        Names the file and field: unreadable, missing or wrong; a mode other than trinary or a turned
        ``origin``, which this map cannot hold.
    """
    fields = read_yaml(path)
    if not isinstance(fields, dict) or not isinstance(fields.get("image"), str):
        raise ValueError(f"{path}: expected a mapping with 'image', 'resolution' and 'origin'")
    try:
        resolution, occupied_above, free_below, negate = _settings(fields)
        origin_x, origin_y = _origin(fields.get("origin"))
        grey = read_image(Path(path).parent / fields["image"]).mean(axis=2)[::-1]
        end_x = round(origin_x + grey.shape[1] * resolution, 9)
        end_y = round(origin_y + len(grey) * resolution, 9)
        floor = Floor((origin_x, end_x), (origin_y, end_y), resolution)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    p = (grey if negate else 255 - grey) / 255
    data = np.select([p > occupied_above, p < free_below], [OCCUPIED, FREE], UNKNOWN)
    return OccupancyMap(data.astype(np.int8), floor)


def _pgm(data: MapData) -> bytes:
    """A binary PGM file, highest row first."""
    grey = np.full(data.shape, 255, np.uint8)
    for value, shade in _GREY.items():
        grey[data == value] = shade
    if (grey == 255).any():
        raise ValueError(f"data: expected only -1, 0 and 100, got {int(data[grey == 255][0])}")
    ny, nx = data.shape
    return b"P5\n%d %d\n255\n" % (nx, ny) + grey[::-1].tobytes()


def _settings(fields: dict[str, Any]) -> tuple[float, float, float, bool]:
    """Resolution, thresholds and ``negate`` of a map description."""
    if fields.get("mode", "trinary") != "trinary":
        raise ValueError(f"mode: expected 'trinary', got {fields['mode']!r}")
    if fields.get("negate", 0) not in (0, 1):
        raise ValueError(f"negate: expected 0 or 1, got {fields['negate']!r}")
    resolution = _number(fields.get("resolution"), "resolution")
    occupied = _number(fields.get("occupied_thresh", _OCCUPIED_THRESH), "occupied_thresh")
    free = _number(fields.get("free_thresh", _FREE_THRESH), "free_thresh")
    if not 0 <= free <= occupied <= 1:
        raise ValueError(f"free_thresh: expected 0 <= free <= occupied <= 1, got {free} and {occupied}")
    return resolution, occupied, free, bool(fields.get("negate", 0))


def _origin(value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"origin: expected [x, y, yaw], got {value!r}")
    x, y, yaw = (_number(v, "origin") for v in value)
    if yaw != 0:
        raise ValueError(f"origin: expected yaw 0, got {yaw}")
    return x, y


def _number(value: Any, name: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{name}: expected a finite number, got {value!r}")
    return float(value)
