"""``rig.yaml``: the floor and the cameras that watch it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from msgspec import Meta, Struct

from occlib.base.files import read_yaml
from occlib.formats.decoding import Finite, convert

Row: TypeAlias = tuple[Finite, Finite, Finite]
Interval: TypeAlias = Annotated[tuple[Finite, Finite], Meta(description="2 finite numbers")]
Matrix: TypeAlias = Annotated[tuple[Row, Row, Row], Meta(description="3x3 finite numbers")]

SMALLEST_FOCAL_PX, LARGEST_ENTRY_PX = 1e-3, 1e9  # of a camera matrix: what is beyond is a mistake, or overflows later
LARGEST_SIZE_PX = 100_000


class FloorEntry(Struct, frozen=True):
    """The mapped rectangle of floor: [min, max] of x and of y in m, and the map's metres per cell."""

    x: Interval
    y: Interval
    resolution: Annotated[Finite, Meta(description="a finite number")]


class CameraEntry(Struct, frozen=True, omit_defaults=True):
    """A calibrated camera: its lens, and its pose as a homography of the floor or as rotation and translation.

    Parameters
    ----------
    size
        ``[width, height]`` in px, whole.
    matrix
        ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` in px.
    distortion
        ``[k1, k2, p1, p2, k3]`` of the Brown-Conrady model.
    floor_homography
        3x3, undistorted px to floor metres. If it is given, rotation and translation are not looked at.
    rotation, translation
        World to camera, 3x3 and 3 numbers in m.
    """

    size: Annotated[tuple[Finite, Finite], Meta(description="2 finite numbers")]
    matrix: Matrix
    distortion: Annotated[tuple[Finite, Finite, Finite, Finite, Finite], Meta(description="5 finite numbers")] = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    floor_homography: Matrix | None = None
    rotation: Matrix | None = None
    translation: Annotated[Row, Meta(description="3 finite numbers")] | None = None

    def __post_init__(self) -> None:
        if any(not 1 <= length <= LARGEST_SIZE_PX or length != int(length) for length in self.size):
            raise ValueError(f"size: expected [width, height] in px, got {list(self.size)}")
        (fx, skew, _), (below, fy, _), last = self.matrix
        largest = max(abs(entry) for row in self.matrix for entry in row)
        if min(fx, fy) < SMALLEST_FOCAL_PX or largest > LARGEST_ENTRY_PX or skew or below or list(last) != [0, 0, 1]:
            raise ValueError(
                "matrix: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in px with fx, fy > 0, "
                f"got {[list(row) for row in self.matrix]}"
            )
        if self.floor_homography is None and self.rotation is None:
            raise ValueError("rotation: expected 3x3 finite numbers, got None")
        if self.floor_homography is None and self.translation is None:
            raise ValueError("translation: expected 3 finite numbers, got None")


class RigFile(Struct, frozen=True, kw_only=True):
    """The content of ``rig.yaml``."""

    units: Annotated[Literal["m"], Meta(description="'m'")] = "m"
    fps: Annotated[float, Meta(gt=1e-6, lt=1e6, description="frames a second > 0")] | None = None
    floor: Annotated[FloorEntry, Meta(description="a mapping with 'x', 'y' and 'resolution'")]
    cameras: Annotated[
        dict[str, Annotated[CameraEntry, Meta(description="a mapping")]],
        Meta(min_length=1, description="a mapping with one or more cameras"),
    ]


def load_rig(path: str | Path) -> RigFile:
    """Read and check ``rig.yaml``; ``ValueError`` names the file and the field that is wrong."""
    content = read_yaml(path)
    try:
        return rig_file(content)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def rig_file(content: Any) -> RigFile:
    """The mapping that ``rig.yaml`` holds, checked."""
    if isinstance(content, Mapping) and isinstance(content.get("cameras"), Mapping):
        content = {**content, "cameras": {str(name): camera for name, camera in content["cameras"].items()}}
    kind = Annotated[RigFile, Meta(description="a mapping with 'units', 'floor' and 'cameras'")]
    return convert(content, kind, strict=False)  # type: ignore[arg-type]
