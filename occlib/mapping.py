"""The occupancy map that the robots receive (section 5 of the paper), and its files for ROS.

Values are those of ``nav_msgs/OccupancyGrid``: 0 free, 100 occupied, -1 unknown, and in between how likely a cell is
occupied, in percent. What no camera sees is unknown, never free. Files are the pair of ROS ``map_server``
(https://wiki.ros.org/map_server): a picture ``NAME.pgm`` or ``NAME.png``, and ``NAME.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import yaml

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, Mask
from occlib.base.files import encode_image, read_image, read_yaml, write_file
from occlib.geometry import Floor

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""The values of a cell that is decided, and of one that is not."""


BLIND, ONE_VIEW, DISAGREE, UNCONFIRMED, NOT_SEEN, EDGE = 1, 2, 3, 4, 5, 6
"""Numbers of the reasons why a cell is unknown, see :data:`REASONS`; 0 is none."""


REASONS = {
    BLIND: "no camera sees it",
    ONE_VIEW: "one view only",
    DISAGREE: "views disagree",
    UNCONFIRMED: "new",
    NOT_SEEN: "not seen now",
    EDGE: "beside an object",
}
"""Why a cell is unknown: blind; foreground in the only view that is left; foreground that the objects on the map explain;
something new that may be a ghost; what looks like bare floor, where an object was a moment ago that is not seen now; or bare floor so close
to an object (:data:`EDGE_M`) that the object's edge may be there."""

EDGE_M = 0.12
"""Bare floor closer than this to an object's footprint, in m between centres of cells, is not called free: the edge is known no better."""


MapData: TypeAlias = npt.NDArray[np.int8]


MODES = ("trinary", "scale", "raw")
"""How ``map_server`` turns the greys of a picture into values: see :func:`load_map`."""


_GREY = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}


_OCCUPIED_THRESH = 0.65


_FREE_THRESH = 0.196  # 205 is (255 - 205) / 255 = 0.19608: with 0.25 it would read as free


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """What is known of the floor at one instant.

    Parameters
    ----------
    data
        int8 (ny, nx): 0 free to 100 occupied, -1 unknown. Row 0 is the smallest ``y`` (ROS order).
    floor
        Where the map lies.
    """

    data: MapData
    floor: Floor

    def __post_init__(self) -> None:
        if self.data.shape != self.floor.shape or self.data.dtype != np.int8:
            raise ValueError(f"data: expected int8 {self.floor.shape}, got {self.data.dtype} {self.data.shape}")
        if self.data.min() < UNKNOWN or self.data.max() > OCCUPIED:
            raise ValueError(f"data: expected -1 to 100, got {self.data.min()} to {self.data.max()}")

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
        checks.mask(name, mask, floor.shape)
    # Plain int8 arithmetic, ten times as fast as masked assignment: 101, 1 or 0, less one.
    claimed = occupied.view(np.int8) * np.int8(OCCUPIED - UNKNOWN)
    return OccupancyMap(np.maximum(claimed, visible.view(np.int8)) + np.int8(UNKNOWN), floor)


class Remembered(NamedTuple):
    """Cells of the objects that are not seen now but were a moment ago, bool (ny, nx) each: see :mod:`occlib.memory`.

    Parameters
    ----------
    expected
        Where they are expected now.
    way
        Where they may be: there, where they were seen last, and all between.
    """

    expected: Mask
    way: Mask


def instant_map(
    labels: npt.NDArray[np.int32],
    unconfirmed: Mask,
    occupied: Mask,
    views: Mapping[str, Mask],
    visible: Mapping[str, Mask],
    needed: int,
    floor: Floor,
    remembered: Remembered | None = None,
) -> tuple[OccupancyMap, npt.NDArray[np.uint8]]:
    """The map of one instant: occupied where an object is, free where a view looks at bare floor, else unknown.

    Where an object was a moment ago that is not seen now, no view is believed that says "bare floor": that it says so, wrongly, may
    be just why the object is not seen. Such cells are not free. They are occupied where the object is expected now and no view says
    so. Nor is bare floor free beside an object, seen or remembered, closer than :data:`EDGE_M`, as no edge is known better than that.

    Parameters
    ----------
    labels
        int (ny, nx): 0, or the object of each cell.
    unconfirmed
        bool (ny, nx), cells of what may yet turn out to be no object.
    occupied
        bool (ny, nx), the fused foreground.
    views
        ``{camera: bool (ny, nx)}``, the foreground of each camera that can be trusted now.
    visible
        ``{camera: bool (ny, nx)}``, the cells that each camera of the rig sees, whether it can be trusted now or not.
    needed
        So many cameras must see a cell before it is called occupied.
    floor
        The map's floor.
    remembered
        Cells of objects that are not seen now, if there are any.

    Returns
    -------
    map, reason
        The map, and uint8 (ny, nx), why a cell is unknown (:data:`REASONS`), 0 where it is known.
    """
    count = np.sum([visible[name] for name in views], axis=0) if views else np.zeros(floor.shape, int)
    bare = np.zeros(floor.shape, bool)
    for name, view in views.items():
        bare |= visible[name] & ~view
    lost = np.zeros(floor.shape, bool)  # a camera that is excluded leaves its cells to one view: not free
    for name in visible.keys() - views.keys():
        lost |= visible[name] & (count < needed)
    reason = np.zeros(floor.shape, np.uint8)
    reason[occupied | ~bare] = DISAGREE
    reason[~bare & (count < needed) | lost] = ONE_VIEW
    reason[unconfirmed] = UNCONFIRMED
    reason[count == 0] = BLIND
    taken = labels > 0
    stands = taken  # or may stand
    if remembered is not None:
        taken = taken | (remembered.expected & ~bare)
        stands = taken | remembered.way
        reason[remembered.way & (reason == 0)] = NOT_SEEN
    if stands.any():
        reason[floor.near(stands, EDGE_M) & (reason == 0)] = EDGE
    reason[taken] = 0
    return occupancy_map(taken, reason == 0, floor), reason


def inflate(grid: OccupancyMap, radius_m: float) -> OccupancyMap:
    """The map for the centre of a round robot: what is closer than its radius to something occupied is occupied, too.

    Unknown stays unknown, and is not inflated: it is for the planner to say whether a robot may go there. Values between
    0 and 100 are kept where nothing occupied is near; only 100 counts as occupied.

    Parameters
    ----------
    grid
        The map; left as it is.
    radius_m
        In m, >= 0, between centres of cells and exact: see :meth:`occlib.geometry.Floor.near`.

    Examples
    --------
    >>> grid = OccupancyMap(np.array([[100, 0, 0, 0, -1]], np.int8), Floor((0, 5), (0, 1), 1.0))
    >>> inflate(grid, 2.5).data
    array([[100, 100, 100,   0,  -1]], dtype=int8)
    """
    near = grid.floor.near(grid.data == OCCUPIED, radius_m)
    return OccupancyMap(np.where(near & (grid.data != UNKNOWN), np.int8(OCCUPIED), grid.data), grid.floor)


def save_map(path: str | Path, grid: OccupancyMap, *, mode: str = "trinary") -> Path:
    """Write the picture, ``NAME.pgm`` or ``NAME.png``, then ``NAME.yaml`` beside it; return the latter's path.

    :func:`load_map` gives back the same cells, in every mode; the far edges are then whole cells. So does nav2's ``map_server``; that of ROS 1 as well, but
    in mode ``"scale"`` it truncates, so that it reads 1 to 99 up to two lower.

    Parameters
    ----------
    path
        ``NAME``, ``NAME.yaml``, ``NAME.pgm`` or ``NAME.png``. Unless it says otherwise, the picture is a PGM, or in mode
        ``"scale"`` a PNG.
    grid
        The map. Row 0 of the picture is the *largest* ``y``.
    mode
        ``"trinary"`` holds -1, 0 and 100: greys 205, 254 and 0. ``"scale"`` holds every value: the darker, the more likely
        occupied; unknown is transparent, which a PGM cannot be. ``"raw"`` holds every value as the grey itself, and
        unknown as 255.

    Raises
    ------
    ValueError
        An unknown mode, values that the mode or the picture cannot hold, or the files cannot be written.
    """
    target = Path(path)
    given = target.suffix in (".yaml", ".yml", ".pgm", ".png")
    suffix = target.suffix if target.suffix in (".pgm", ".png") else ".png" if mode == "scale" else ".pgm"
    stem = target.stem if given else target.name
    image, description = target.with_name(f"{stem}{suffix}"), target.with_name(f"{stem}.yaml")
    picture = _picture(grid.data, mode, transparent=suffix == ".png")[::-1]
    write_file(image, _pgm(picture) if suffix == ".pgm" else encode_image(suffix, picture))
    fields = {
        "image": image.name,
        "mode": mode,
        "resolution": float(grid.floor.resolution),
        "origin": [float(grid.floor.x[0]), float(grid.floor.y[0]), 0.0],
        "negate": 0,
        "occupied_thresh": _OCCUPIED_THRESH,
        "free_thresh": _FREE_THRESH,
    }
    return write_file(description, yaml.safe_dump(fields, sort_keys=False, default_flow_style=None))


def load_map(path: str | Path) -> OccupancyMap:
    """Read a ``map_server`` pair by its YAML file, as nav2's ``map_server`` does.

    A cell of grey ``v``, the mean of red, green and blue, has ``p = (255 - v) / 255`` (``v / 255`` if ``negate``).

    * ``trinary``: occupied if ``p > occupied_thresh``, free if ``p < free_thresh``, else unknown. Alpha, if the picture
      has it, counts as a fourth colour.
    * ``scale``: unknown unless wholly opaque; beyond the thresholds as before; between them linear, 0 to 100, rounded.
    * ``raw``: the value is ``v`` itself, whatever ``negate`` says, and unknown above 100.

    Both comparisons are strict; nav2 made them inclusive in 2025, which matters to a grey exactly on a threshold. The
    ``map_server`` of ROS 1 differs in mode ``scale``: ``99 p'`` truncated, and a transparent cell is unknown between the
    thresholds only. The floor's far edges are rounded to 1e-9 m.

    Raises
    ------
    ValueError
        Names the file and field: unreadable, missing or wrong; an unknown mode or a turned ``origin``, which this map
        cannot hold.

    References
    ----------
    ``nav2_map_server/src/map_io.cpp`` of https://github.com/ros-navigation/navigation2 and
    ``map_server/src/image_loader.cpp`` of https://github.com/ros-planning/navigation.
    """
    fields = read_yaml(path)
    if not isinstance(fields, dict) or not isinstance(fields.get("image"), str):
        raise ValueError(f"{path}: expected a mapping with 'image', 'resolution' and 'origin'")
    try:
        settings = _settings(fields)
        origin_x, origin_y = _origin(fields.get("origin"))
        picture = read_image(Path(path).parent / fields["image"], alpha=True)[::-1]
        end_x = round(origin_x + picture.shape[1] * settings.resolution, 9)
        end_y = round(origin_y + picture.shape[0] * settings.resolution, 9)
        floor = Floor((origin_x, end_x), (origin_y, end_y), settings.resolution)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return OccupancyMap(_values(picture, settings), floor)


class _Settings(NamedTuple):
    mode: str
    resolution: float
    occupied: float
    free: float
    negate: bool


def _picture(data: MapData, mode: str, *, transparent: bool) -> Image:
    """The greys of a map, uint8 (ny, nx), or RGBA (ny, nx, 4) where unknown cells have to be transparent."""
    if mode not in MODES:
        raise ValueError(f"mode: expected one of {', '.join(MODES)}, got {mode!r}")
    unknown = data == UNKNOWN
    if mode == "raw":
        return data.view(np.uint8)  # -1 is 255
    if mode == "trinary":
        grey = np.select([unknown, data == FREE, data == OCCUPIED], [_GREY[UNKNOWN], _GREY[FREE], _GREY[OCCUPIED]], 255)
        if (grey == 255).any():
            other = int(data[grey == 255][0])
            raise ValueError(f"data: expected only -1, 0 and 100, got {other}; modes scale and raw hold it")
        return grey.astype(np.uint8)
    if not transparent and unknown.any():
        raise ValueError("data: a PGM cannot hold unknown cells in mode scale, as it has no alpha; expected NAME.png")
    grey = _scale_greys()[np.where(unknown, 50, data)]
    # Four channels even for grey: GraphicsMagick, which nav2 reads with, has trouble with the alpha of grey pictures.
    return np.dstack([grey] * 3 + [np.where(unknown, 0, 255).astype(np.uint8)]) if transparent else grey


def _scale_greys() -> Image:
    """For each value 0 to 100 the grey that mode scale reads as that value, in the middle of those that do; uint8 (101,).

    There is one for each, as the thresholds are more than 100 greys apart.
    """
    p = _FREE_THRESH + np.arange(101) / 100 * (_OCCUPIED_THRESH - _FREE_THRESH)
    greys = np.rint(255 * (1 - p)).astype(np.uint8)
    greys[[FREE, OCCUPIED]] = _GREY[FREE], _GREY[OCCUPIED]
    return greys


def _pgm(grey: Image) -> bytes:
    """A binary PGM file."""
    ny, nx = grey.shape
    return b"P5\n%d %d\n255\n" % (nx, ny) + grey.tobytes()


def _values(picture: Image, settings: _Settings) -> MapData:
    """The cells of an RGB or RGBA picture."""
    grey: FloatArray = picture[..., : 4 if settings.mode == "trinary" else 3].mean(axis=2)
    if settings.mode == "raw":
        shade = np.floor(grey + 0.5)
        return np.where(shade > OCCUPIED, UNKNOWN, shade).astype(np.int8)
    p = (grey if settings.negate else 255 - grey) / 255
    between: Any = UNKNOWN
    if settings.mode == "scale":
        width = max(settings.occupied - settings.free, 1e-12)
        between = np.rint(np.clip((p - settings.free) / width, 0, 1) * 100)
    data = np.select([p > settings.occupied, p < settings.free], [OCCUPIED, FREE], between)
    if settings.mode == "scale" and picture.shape[2] == 4:
        data[picture[..., 3] < 255] = UNKNOWN
    return data.astype(np.int8)


def _settings(fields: dict[str, Any]) -> _Settings:
    """Mode, resolution, thresholds and ``negate`` of a map description."""
    mode = fields.get("mode", "trinary")
    checks.choice("mode", mode, MODES)
    if fields.get("negate", 0) not in (0, 1):
        raise ValueError(f"negate: expected 0 or 1, got {fields['negate']!r}")
    resolution = _number(fields.get("resolution"), "resolution")
    occupied = _number(fields.get("occupied_thresh", _OCCUPIED_THRESH), "occupied_thresh")
    free = _number(fields.get("free_thresh", _FREE_THRESH), "free_thresh")
    if not 0 <= free <= occupied <= 1:
        raise ValueError(f"free_thresh: expected 0 <= free <= occupied <= 1, got {free} and {occupied}")
    return _Settings(mode, resolution, occupied, free, bool(fields.get("negate", 0)))


def _origin(value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"origin: expected [x, y, yaw], got {value!r}")
    x, y, yaw = (_number(v, "origin") for v in value)
    if yaw != 0:
        raise ValueError(f"origin: expected yaw 0, got {yaw}")
    return x, y


def _number(value: Any, name: str) -> float:
    return checks.number(name, value, unit="a finite number")
