"""``truth.json``: where the objects of a recording really are."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from occlib.base.files import write_file
from occlib.formats.decoding import RGB, Metres, Name, Number, Polygon, convert, given, parse_json, plain, read_bytes


class TrueObject(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One object of the truth at one instant.

    Parameters
    ----------
    id
        Its name, the same in every frame; ``None`` if it has none.
    x, y
        Where it stands, m.
    heading_deg
        Direction in which it looks, degrees anticlockwise from x.
    label, colour, height
        What it is, its (r, g, b) from 0 to 255, and its highest point in m.
    footprint
        Outline of its vertical projection on the floor: three or more points (x, y) in m.
    hidden_fraction
        For each camera the share of it that other objects hide, 0 to 1; a camera outside whose picture it is, is left out.
    sigma
        Standard deviation of x and of y in m, of truth marked by hand.
    state
        For each camera what a person who marked it by hand saw: ``"visible"``, ``"partly"``, ``"feet_hidden"``, ...

    Examples
    --------
    >>> TrueObject(x=1.3, y=0.4, id="A").to_dict()
    {'id': 'A', 'x': 1.3, 'y': 0.4}
    """

    id: Name | None = None
    x: Metres
    y: Metres
    heading_deg: Number | None = None
    label: Annotated[str, Meta(description="a name")] | None = None
    colour: RGB | None = None
    height: Metres | None = None
    footprint: Polygon | None = None
    hidden_fraction: Annotated[dict[str, Number], Meta(description="a mapping of cameras to numbers")] = {}
    sigma: Metres | None = None
    state: Annotated[dict[str, str], Meta(description="a mapping of cameras to words")] = {}

    def to_dict(self) -> dict[str, Any]:
        """Its entry in ``truth.json``, without the fields that it does not have."""
        entry: dict[str, Any] = plain(msgspec.to_builtins(self))
        return entry


class Truth(Struct, frozen=True):
    """Where the objects of a recording really are.

    Parameters
    ----------
    frames
        For each marked frame its objects, frames in increasing order. A frame without objects has an empty list.
    roi
        Regions of the floor by name: polygons of three or more points (x, y) in m.
    units
        Always ``"m"``.

    Examples
    --------
    >>> truth = Truth({0: [TrueObject(x=0, y=0)], 4: [TrueObject(x=1, y=0)]})
    >>> truth.frames[4][0].x, list(truth.select([4]).frames)
    (1, [4])
    """

    frames: Annotated[
        dict[
            int,
            Annotated[
                list[Annotated[TrueObject, Meta(description="a mapping with x and y")]], Meta(description="a list")
            ],
        ],
        Meta(description="a mapping of frame numbers to objects"),
    ]
    roi: Annotated[dict[str, Polygon], Meta(description="a mapping of names to polygons")] = {}
    units: Annotated[Literal["m"], Meta(description="'m'")] = "m"

    @classmethod
    def from_dict(cls, content: Any) -> Truth:
        """The mapping that ``truth.json`` holds, checked; frames may be text, as in JSON, or numbers.

        Raises ``ValueError`` with the field that is wrong.

        >>> Truth.from_dict({"units": "m", "frames": {"40": [{"id": "A", "x": 1.3, "y": 0.4}]}}).frames[40][0].id
        'A'
        """
        if not isinstance(content, Mapping) or not isinstance(content.get("frames"), Mapping):
            raise ValueError("truth: expected a mapping with 'units' and 'frames'")
        frames: dict[int, Any] = {}
        for key, entries in content["frames"].items():
            try:
                frame = int(key)
            except (TypeError, ValueError):
                raise ValueError(f"truth.frames: expected whole numbers as keys, got {key!r}") from None
            if frame in frames:
                raise ValueError(f"truth.frames: frame {frame} comes twice")
            frames[frame] = [given(entry) for entry in entries] if isinstance(entries, list) else entries
        return convert({**given(content), "frames": dict(sorted(frames.items()))}, cls, "truth")

    def to_dict(self) -> dict[str, Any]:
        """The mapping that :meth:`from_dict` reads and ``truth.json`` holds: frames are text."""
        frames = {str(frame): [each.to_dict() for each in objects] for frame, objects in self.frames.items()}
        regions = {"roi": plain(self.roi)}
        return {"units": self.units, **(regions if self.roi else {}), "frames": frames}

    def save(self, path: str | Path) -> Path:
        """Write ``truth.json``, one frame a line: short, and still readable."""
        content = self.to_dict()
        lines = [f"{json.dumps(frame)}: {json.dumps(objects)}" for frame, objects in content.pop("frames").items()]
        return write_file(path, json.dumps(content)[:-1] + ', "frames": {\n' + ",\n".join(lines) + "\n}}\n")

    def select(self, frames: Iterable[int]) -> Truth:
        """The truth of these frames only; frames that it does not have are left out, regions stay."""
        wanted = set(frames)
        return msgspec.structs.replace(self, frames={k: objects for k, objects in self.frames.items() if k in wanted})

    def region(self, name: str) -> tuple[tuple[float, float], ...]:
        """The polygon of a region in m; ``ValueError`` lists those that there are."""
        if name not in self.roi:
            raise ValueError(f"roi: {name!r} is not in the truth, which has {', '.join(self.roi) or 'none'}")
        return self.roi[name]


def load_truth(path: str | Path) -> Truth:
    """Read and check ``truth.json``; ``ValueError`` names the file, frame and field that is wrong.

    Fields that nobody here knows are skipped, and one that is null is as good as left out.
    """
    content = parse_json(read_bytes(path), str(path))
    try:
        return Truth.from_dict(content)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
