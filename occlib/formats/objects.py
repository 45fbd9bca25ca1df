"""``objects.jsonl``: what was found, one line a frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

from msgspec import Meta, Struct

from occlib.formats.decoding import LARGEST, RGB, Metres, Name, Number, convert, given, parse_json, read_bytes

Area: TypeAlias = Annotated[float, Meta(ge=0, le=LARGEST, description="square metres >= 0")]


class DetectedObject(Struct, frozen=True, kw_only=True):
    """One object as a frame of ``objects.jsonl`` has it; only ``x`` and ``y`` must be there.

    Parameters
    ----------
    id
        The object's number, the same in every frame, or a name.
    x, y
        Where it stands, m.
    vx, vy
        Velocity, m/s.
    area
        Floor that it occupies on the map, m2.
    colour
        Mean (r, g, b), each 0 to 255.
    label
        Name of the template that it matched, or ``None``.
    hidden_in
        Cameras in which something hides it.
    size
        Actual size by the look-up table of scale factors, m2; ``None`` without a table, or where no view identifies the object.

    Examples
    --------
    >>> DetectedObject(x=1.0, y=2.0, hidden_in=("left",)).hidden_in
    ('left',)
    """

    id: Name | None = None
    x: Metres
    y: Metres
    vx: Number | None = None
    vy: Number | None = None
    area: Area | None = None
    colour: RGB | None = None
    label: Annotated[str, Meta(description="a name or null")] | None = None
    hidden_in: Annotated[tuple[str, ...], Meta(description="a list of cameras")] = ()
    size: Area | None = None


class ObjectsLine(Struct, frozen=True, kw_only=True):
    """One line of ``objects.jsonl``: the frame's number, its time in s, its objects, and the cameras that were left out and why.

    ``coasting`` is there if there are objects that were confirmed a moment ago and are not seen now: where each is expected. They are
    none of ``objects``, and are not scored.
    """

    frame: Annotated[int, Meta(description="a whole number")]
    time: Number | None = None
    objects: Annotated[
        list[Annotated[DetectedObject, Meta(description="a mapping with x and y")]], Meta(description="a list")
    ]
    coasting: Annotated[
        list[Annotated[DetectedObject, Meta(description="a mapping with x and y")]], Meta(description="a list")
    ] = []
    excluded: Annotated[dict[str, str], Meta(description="a mapping of cameras to reasons")] = {}


def load_objects(path: str | Path) -> dict[int, list[DetectedObject]]:
    """Read ``objects.jsonl``: for each frame its objects, without those that coast.

    Raises ``ValueError`` with file and line number: not JSON, no ``frame`` or ``objects``, an object
    without finite ``x`` and ``y``, another field of the wrong type, or a frame that comes twice. Blank lines are skipped, as are
    fields that nobody here knows; a field that is null is as good as left out.
    """
    frames: dict[int, list[DetectedObject]] = {}
    for number, text in enumerate(read_bytes(path).splitlines(), start=1):
        if not text.strip():
            continue
        where = f"{path}:{number}"
        content = parse_json(text, where)
        frame = content.get("frame") if isinstance(content, dict) else None
        if not isinstance(frame, int) or isinstance(frame, bool):
            raise ValueError(f"{where}: expected an object with an integer 'frame'")
        for name in ("objects", "coasting"):
            if isinstance(content.get(name), list):
                content = {**content, name: [given(entry) for entry in content[name]]}
        line = convert_line(content, where)
        if line.frame in frames:
            raise ValueError(f"{where}: frame {frame} comes twice")
        frames[line.frame] = line.objects
    return frames


def convert_line(content: object, where: str) -> ObjectsLine:
    """One line of the file, checked; errors begin with ``where``."""
    try:
        return convert(content, ObjectsLine)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
