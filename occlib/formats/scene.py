"""``scene.yaml`` and ``room.yaml``: rendered laboratories. A field that is not known is an error: nobody else writes these files."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from msgspec import Meta, Struct

from occlib.formats.decoding import LARGEST, RGB, AsWritten, Count, Name, Number

Pair: TypeAlias = Annotated[tuple[AsWritten, AsWritten], Meta(description="2 finite numbers")]
Triple: TypeAlias = Annotated[tuple[AsWritten, AsWritten, AsWritten], Meta(description="3 finite numbers")]
Positive: TypeAlias = Annotated[float, Meta(gt=0, le=LARGEST, description="a finite number > 0")]
PerFrame: TypeAlias = Annotated[tuple[Annotated[float, Meta(ge=0, le=1000)], ...], Meta(description="factors >= 0")]
Length: TypeAlias = Annotated[int, Meta(gt=0)] | Annotated[float, Meta(gt=0, le=LARGEST)]


class _Strict(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mapping without other fields than these."""


class SwingEntry(_Strict, frozen=True):
    """A pendulum about the y axis of its object: ``degrees * sin(2 pi (frame / period + phase))``, pivot in m, period in frames."""

    pivot: Triple
    degrees: Number
    period: Positive
    phase: Number = 0.0


class PartEntry(_Strict, frozen=True):
    """A unit shape: its centre, its full extents in m, and how it is turned about x, y and z in degrees.

    The shapes are :data:`occlib.lab.shapes.SHAPES`; without a colour it has its object's. Limbs of walking people swing.
    """

    shape: Annotated[str, Meta(description="a shape")]
    centre: Triple
    size: Annotated[tuple[Length, Length, Length], Meta(description="three lengths > 0")]
    colour: RGB | None = None
    turn: Triple = (0, 0, 0)
    swing: Annotated[SwingEntry | None, Meta(description="a mapping with 'pivot', 'degrees' and 'period'")] = None


class WaypointEntry(_Strict, frozen=True):
    """Where an object is at a frame, in m; heading in degrees, or along its path."""

    frame: Count
    at: Pair
    heading: Number | None = None


class ObjectEntry(_Strict, frozen=True):
    """Parts that move together along a path."""

    id: Name
    label: Name
    colour: RGB
    parts: Annotated[list[PartEntry], Meta(description="a list of parts")]
    path: Annotated[list[WaypointEntry], Meta(description="a list of waypoints")]

    def __post_init__(self) -> None:
        frames = [waypoint.frame for waypoint in self.path]
        if not self.parts or not frames or sorted(set(frames)) != frames:
            raise ValueError(f"expected parts, and a path whose frames increase, got frames {frames}")


class BoardEntry(_Strict, frozen=True):
    """A checkerboard before a camera: its square in m, the px of its centre, its distance in m, degrees from facing the camera."""

    camera: Name
    square: Positive
    pixel: Pair
    distance: Positive
    turn: Triple


class FloorBoardEntry(_Strict, frozen=True):
    """A checkerboard on the floor: its square in m, the place of its first inner corner in m, and where its rows point."""

    square: AsWritten
    origin: Pair
    angle_deg: AsWritten


class SceneFile(_Strict, frozen=True):
    """The content of ``scene.yaml``."""

    room: Annotated[str, Meta(description="the name of a file")]
    cameras: Annotated[list[str], Meta(min_length=1, description="a list of names")]
    frames: Count
    background: Count = 1
    seed: Count = 0
    fps: Positive = 10.0
    objects: Annotated[list[ObjectEntry], Meta(description="a list of objects")] = []
    boards: Annotated[list[BoardEntry], Meta(description="a list of boards")] = []
    floor_board: FloorBoardEntry | None = None
    marks: Annotated[list[tuple[Number, Number]], Meta(description="a list of points [x, y] in m")] = []
    vinyl: Annotated[dict[str, Any], Meta(description="a mapping of what differs from the room's vinyl")] = {}
    wood: Annotated[dict[str, Any], Meta(description="a mapping of what differs from the room's wood")] = {}
    window: Annotated[dict[str, Any], Meta(description="a mapping of what differs from the room's window")] = {}
    lamps: Annotated[
        dict[str, PerFrame], Meta(description="a mapping of lamps to a factor >= 0 on their light for each frame")
    ] = {}
    exposure: Annotated[
        dict[str, PerFrame], Meta(description="a mapping of cameras to a factor >= 0 on their exposure for each frame")
    ] = {}

    def __post_init__(self) -> None:
        ids = [str(each.id) for each in self.objects]
        if len(set(ids)) != len(ids):
            raise ValueError(f"objects: expected different ids, got {ids}")
        for field, changes in (("lamps", self.lamps), ("exposure", self.exposure)):
            for name, factors in changes.items():
                if len(factors) != self.frames:
                    raise ValueError(f"{field}.{name}: expected {self.frames} factors, one a frame, got {len(factors)}")


class RoomFloor(Struct, frozen=True):
    """The mapped rectangle: [min, max] of x and of y in m, and the map's metres per cell."""

    x: Pair
    y: Pair
    resolution: AsWritten


class Walls(Struct, frozen=True):
    """The four walls: [min, max] of x and of y, and their height, in m."""

    x: Pair
    y: Pair
    height: Positive
    colour: RGB


class Vinyl(Struct, frozen=True):
    """The floor's tiles: roughness (alpha) and refractive index of the coat, and a tile's side in m."""

    colour: RGB
    roughness: Positive
    ior: Positive
    tile: Positive


class Wood(_Strict, frozen=True):
    """A floor of varnished planks, along x: roughness (alpha) and refractive index of the coat, a plank's length and width in m."""

    colour: RGB
    roughness: Positive
    ior: Positive
    plank: Annotated[tuple[Length, Length], Meta(description="two lengths > 0")]


class Surface(_Strict, frozen=True):
    """A floor by its pattern, one of :data:`occlib.lab.surfaces.SURFACES`: roughness (alpha) and refractive index of the coat.

    ``size`` is the length and width of a plank or tile in m. Little gloss is left with a refractive index near 1.
    """

    pattern: Annotated[str, Meta(description="a pattern")]
    colour: RGB
    roughness: Positive
    ior: Positive
    size: Annotated[tuple[Length, Length], Meta(description="two lengths > 0")] = (1.0, 1.0)


class Window(_Strict, frozen=True):
    """A rectangle of daylight in a wall: centre, width and height in m, the direction in which it shines in degrees from x, radiance."""

    centre: Triple
    size: Annotated[tuple[Length, Length], Meta(description="two lengths > 0")]
    facing_deg: Number
    radiance: Positive
    colour: RGB = (255, 255, 255)


class Lamp(_Strict, frozen=True):
    """A level rectangle that shines down: centre, length and width in m, radiance. A small, bright one lights a spot."""

    centre: Triple
    size: Annotated[tuple[Length, Length], Meta(description="two lengths > 0")]
    radiance: Positive
    colour: RGB = (255, 255, 255)


class CeilingLight(Struct, frozen=True):
    """A rectangle of light under the ceiling: its size in m and its radiance."""

    size: Pair
    radiance: Positive


class Sensor(Struct, frozen=True):
    """What makes a picture of light: see ``data/lab/room.yaml``."""

    exposure: Positive
    vignetting: Number
    read_noise: Number
    shot_noise: Number
    jpeg_quality: Annotated[int, Meta(ge=1, le=100, description="a whole number from 1 to 100")]


class Gain(Struct, frozen=True):
    """Exposure of the pictures of the empty room and of the frames."""

    background: Positive
    frames: Positive


class RoomCamera(_Strict, frozen=True):
    """A level camera: where it hangs and looks in m, its lens in px and its exposure."""

    position: Triple
    look_at: Triple
    size: Annotated[tuple[int, int], Meta(description="2 whole numbers")]
    focal: Pair
    principal_point: Pair
    distortion: Annotated[
        tuple[AsWritten, AsWritten, AsWritten, AsWritten, AsWritten], Meta(description="5 finite numbers")
    ]
    gain: Annotated[Gain, Meta(description="a mapping with 'background' and 'frames'")]


class RoomFile(_Strict, frozen=True):
    """The content of ``room.yaml``. With ``surface``, or else with ``wood``, these take the place of the vinyl."""

    units: Annotated[Literal["m"], Meta(description="'m'")]
    floor: Annotated[RoomFloor, Meta(description="a mapping with 'x', 'y' and 'resolution'")]
    walls: Annotated[Walls, Meta(description="a mapping with 'x', 'y', 'height' and 'colour'")]
    ceiling_light: Annotated[CeilingLight, Meta(description="a mapping with 'size' and 'radiance'")]
    cameras: Annotated[dict[str, RoomCamera], Meta(description="a mapping of names to cameras")]
    sensor: Annotated[Sensor, Meta(description="a mapping with 'exposure', 'vignetting' and others")]
    furniture: Annotated[list[PartEntry], Meta(description="a list of parts")] = []
    vinyl: Annotated[Vinyl | None, Meta(description="a mapping with 'colour', 'roughness', 'ior' and 'tile'")] = None
    wood: Annotated[Wood | None, Meta(description="a mapping with 'colour', 'roughness', 'ior' and 'plank'")] = None
    window: Annotated[
        Window | None, Meta(description="a mapping with 'centre', 'size', 'facing_deg' and 'radiance'")
    ] = None
    surface: Annotated[
        Surface | None, Meta(description="a mapping with 'pattern', 'colour', 'roughness' and 'ior'")
    ] = None
    windows: Annotated[list[Window], Meta(description="a list of windows")] = []
    lamps: Annotated[dict[str, Lamp], Meta(description="a mapping of names to lamps")] = {}

    def __post_init__(self) -> None:
        if self.vinyl is self.wood is self.surface is None:
            raise ValueError("expected a floor: vinyl, wood or surface")

    @property
    def coat(self) -> Surface | Wood | Vinyl:
        """What the floor is made of: of surface, wood and vinyl the first that is given."""
        return next(each for each in (self.surface, self.wood, self.vinyl) if each is not None)

    @property
    def daylight(self) -> list[Window]:
        """All windows."""
        return [*([] if self.window is None else [self.window]), *self.windows]
