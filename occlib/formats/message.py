"""The header of a map's message: what may come over the wire, and how much of it."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from msgspec import UNSET, Meta, Struct, UnsetType

from occlib.formats.decoding import LARGEST, short

MAX_CELLS, MAX_OBJECTS, MAX_CAMERAS, MAX_TEXT = 20_000_000, 2000, 64, 200

WHOLE = 2**53
"""Beyond this not every whole number is a JavaScript number."""

_Bounded: TypeAlias = Annotated[
    float, Meta(ge=-LARGEST, le=LARGEST, description=f"a number from {-LARGEST:g} to {LARGEST:g}")
]
_Positive: TypeAlias = Annotated[float, Meta(ge=0, le=LARGEST, description=f"a number from 0 to {LARGEST:g}")]
_Level: TypeAlias = Annotated[int, Meta(ge=0, le=255, description="a whole number from 0 to 255")]
_Cells: TypeAlias = Annotated[int, Meta(ge=1, le=MAX_CELLS, description=f"a whole number from 1 to {MAX_CELLS}")]
_Text: TypeAlias = Annotated[str, Meta(max_length=MAX_TEXT, description=f"at most {MAX_TEXT} printable characters")]
_Interval: TypeAlias = Annotated[tuple[_Bounded, _Bounded], Meta(description="a list of 2 to 2")]


class MapFloor(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the map lies, as in ``rig.yaml``: [min, max] of x and of y in m, and metres per cell."""

    x: _Interval
    y: _Interval
    resolution: _Bounded


class MapObject(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An entry of ``objects.jsonl`` with all its fields, and none of them out of bounds.

    ``size`` may be missing: publishers did not always send it.
    """

    id: Annotated[int, Meta(ge=0, le=WHOLE, description=f"a whole number from 0 to {WHOLE}")]
    x: _Bounded
    y: _Bounded
    vx: _Bounded
    vy: _Bounded
    area: _Positive
    colour: Annotated[list[_Level], Meta(min_length=3, max_length=3, description="a list of 3 to 3")]
    label: _Text | None
    hidden_in: Annotated[list[_Text], Meta(max_length=MAX_CAMERAS, description=f"a list of 0 to {MAX_CAMERAS}")]
    size: _Positive | UnsetType | None = UNSET

    def __post_init__(self) -> None:
        for name, text in (("label", self.label or ""), *(("hidden_in", camera) for camera in self.hidden_in)):
            if not text.isprintable():  # no escape codes to a terminal
                raise ValueError(f"{name}: expected at most {MAX_TEXT} printable characters, got {short(text)}")


_Objects: TypeAlias = Annotated[
    list[MapObject], Meta(max_length=MAX_OBJECTS, description=f"a list of 0 to {MAX_OBJECTS}")
]


class Header(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The header of a message: these fields and no others. See :mod:`occlib.live.messages`.

    ``coasting`` may be missing: it is sent only where an object is not seen now.
    """

    session: Annotated[str, Meta(pattern="^[0-9a-f]{32}$", max_length=32, description="32 hexadecimal digits")]
    sequence: Annotated[int, Meta(ge=1, le=WHOLE, description=f"a whole number from 1 to {WHOLE}")]
    t_capture: _Positive
    t_sent: _Positive
    floor: MapFloor
    width: _Cells
    height: _Cells
    objects: _Objects
    coasting: _Objects = []

    def __post_init__(self) -> None:
        for name in ("objects", "coasting"):
            listed = getattr(self, name)
            if len({each.id for each in listed}) < len(listed):
                raise ValueError(f"{name}: expected different ids, got one twice")
        if {each.id for each in self.objects} & {each.id for each in self.coasting}:
            raise ValueError("coasting: expected other ids than those of the objects, got one of them")
