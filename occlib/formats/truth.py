"""DOC"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from occlib.base.arrays import FloatArray, as_points


def load_objects(path: str | Path) -> dict[int, list[dict[str, Any]]]:
    """Read ``objects.jsonl``: for each frame its objects, each with at least finite ``x`` and ``y`` in m.

    Raises ``ValueError`` with file and line number: not JSON, no ``frame`` or ``objects``, an object
    without finite ``x`` and ``y``, or a frame that comes twice. Blank lines are skipped.
    """
    frames: dict[int, list[dict[str, Any]]] = {}
    for number, line in enumerate(_read(path).splitlines(), start=1):
        if not line.strip():
            continue
        where = f"{path}:{number}"
        entry = _parse_json(line, where)
        frame = entry.get("frame") if isinstance(entry, dict) else None
        if not isinstance(frame, int) or isinstance(frame, bool):
            raise ValueError(f"{where}: expected an object with an integer 'frame'")
        if frame in frames:
            raise ValueError(f"{where}: frame {frame} comes twice")
        frames[frame] = _detected_things(entry.get("objects"), f"{where}: objects")
    return frames


def load_truth(path: str | Path) -> dict[str, Any]:
    """Read and check ``truth.json``; ``ValueError`` names the file, frame and field that is wrong."""
    content = _parse_json(_read(path), str(path))
    try:
        for frame, things in _truth_frames(content).items():
            for index, thing in enumerate(things):
                _check_true_object(thing, f"truth.frames.{frame}[{index}]")
        regions = content.get("roi") or {}
        if not isinstance(regions, Mapping):
            raise ValueError(f"roi: expected a mapping of names to polygons, got {type(regions).__name__}")
        for name in regions:
            _region(content, name)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return dict(content)


def _read(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot read ({error.strerror})") from None


def _parse_json(text: bytes, where: str) -> Any:
    try:
        return json.loads(text.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError(f"{where}: not UTF-8 text") from None
    except (ValueError, RecursionError) as error:  # ValueError: also a number of over 4300 digits
        raise ValueError(f"{where}: not valid JSON ({str(error).splitlines()[0]})") from None


def _things(entries: Any, where: str) -> list[dict[str, Any]]:
    """Check that each entry is a mapping with finite ``x`` and ``y``."""
    if not isinstance(entries, list):
        raise ValueError(f"{where}: expected a list, got {type(entries).__name__}")
    for index, entry in enumerate(entries):
        if not isinstance(entry, Mapping):
            raise ValueError(f"{where}[{index}]: expected a mapping with x and y, got {type(entry).__name__}")
        for name in ("x", "y"):
            value = entry.get(name)
            if not _is_number(value):
                raise ValueError(f"{where}[{index}].{name}: expected finite metres, got {str(value)[:40]}")
        if not isinstance(entry.get("id"), str | int | float | None):
            raise ValueError(f"{where}[{index}].id: expected a name or number, got {str(entry['id'])[:40]}")
    return entries


def _detected_things(entries: Any, where: str) -> list[dict[str, Any]]:
    """Check what :func:`_things` checks, and that ``hidden_in`` lists names."""
    for index, entry in enumerate(_things(entries, where)):
        names = entry.get("hidden_in")
        if not (isinstance(names, list | tuple | None) and all(isinstance(name, str) for name in names or ())):
            raise ValueError(f"{where}[{index}].hidden_in: expected a list of cameras, got {str(names)[:40]}")
    return list(entries)


def _truth_frames(truth: Any) -> dict[int, list[dict[str, Any]]]:
    """The true objects of each frame, frames in increasing order."""
    if not isinstance(truth, Mapping) or not isinstance(truth.get("frames"), Mapping):
        raise ValueError("truth: expected a mapping with 'units' and 'frames'")
    if truth.get("units", "m") != "m":
        raise ValueError(f"truth.units: expected 'm', got {truth['units']!r}")
    frames: dict[int, list[dict[str, Any]]] = {}
    for key, entries in truth["frames"].items():
        try:
            frame = int(key)
        except (TypeError, ValueError):
            raise ValueError(f"truth.frames: expected whole numbers as keys, got {key!r}") from None
        if frame in frames:
            raise ValueError(f"truth.frames: frame {frame} comes twice")
        frames[frame] = _things(entries, f"truth.frames.{key}")
    return dict(sorted(frames.items()))


def _check_true_object(thing: Mapping[str, Any], where: str) -> None:
    """Check the fields that only a truth file has."""
    if thing.get("footprint") is not None:
        _polygon(thing["footprint"], f"{where}.footprint")
    if thing.get("hidden_fraction") is not None:
        _check_hidden_fraction(thing["hidden_fraction"], where)


def _check_hidden_fraction(hidden: Any, where: str) -> None:
    if not (isinstance(hidden, Mapping) and all(map(_is_number, hidden.values()))):
        raise ValueError(f"{where}.hidden_fraction: expected a mapping of cameras to numbers, got {str(hidden)[:40]}")


def _is_number(value: Any) -> bool:
    """Whether a value from a file is a finite number of a sane size."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e12


def _polygon(value: Any, name: str) -> FloatArray:
    try:
        polygon = as_points(value, name=name)
    except (TypeError, ValueError, OverflowError):
        polygon = np.empty((0, 2))
    if len(polygon) < 3 or not np.isfinite(polygon).all():
        raise ValueError(f"{name}: expected three or more finite points [x, y]")
    return polygon


def _region(truth: Mapping[str, Any], roi: str) -> FloatArray:
    known = truth.get("roi") or {}
    if not isinstance(known, Mapping) or roi not in known:
        raise ValueError(f"roi: {roi!r} is not in the truth, which has {', '.join(map(str, known)) or 'none'}")
    return _polygon(known[roi], f"roi {roi!r}")
