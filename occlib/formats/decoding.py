"""From plain values to typed structures, and errors that name the field, what came and what was expected.

Every structure of a file is a ``msgspec.Struct``. What a value must be stands once, as the ``description`` of its type: it is
what the error says was expected, and what the JSON Schema says about the field.
"""

from __future__ import annotations

import json
import sys
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar, Union, get_args, get_origin

import msgspec
import numpy as np
from msgspec import Meta, Struct

T = TypeVar("T")

LARGEST = 1e12
"""Of any number in a file that is not a matrix: metres, seconds since 1970. Larger ones are mistakes, and overflow when squared."""

Number: TypeAlias = Annotated[float, Meta(ge=-LARGEST, le=LARGEST, description="a finite number")]
Metres: TypeAlias = Annotated[float, Meta(ge=-LARGEST, le=LARGEST, description="finite metres")]
Finite: TypeAlias = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
"""Neither NaN nor infinite. It has no description: what it is part of says what was expected."""

AsWritten: TypeAlias = (
    Annotated[int, Meta(ge=-int(LARGEST), le=int(LARGEST))] | Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
)
"""A finite number that stays whole if it is written so: what is made of it and written again looks the same."""

Count: TypeAlias = Annotated[int, Meta(ge=0, description="a whole number >= 0")]
RGB: TypeAlias = Annotated[
    tuple[AsWritten, AsWritten, AsWritten], Meta(description="[r, g, b], 3 finite numbers from 0 to 255")
]
Name: TypeAlias = Annotated[str | int | float, Meta(description="a name or number")]
Polygon: TypeAlias = Annotated[
    tuple[tuple[Finite, Finite], ...], Meta(min_length=3, description="three or more finite points [x, y]")
]


def read_bytes(path: str | Path) -> bytes:
    """The content of a file; ``ValueError`` in one line if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot read ({error.strerror})") from None


def parse_json(text: bytes, where: str) -> Any:
    """The value of a JSON text in UTF-8, with or without a byte order mark; errors begin with ``where``."""
    try:
        return json.loads(text.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError(f"{where}: not UTF-8 text") from None
    except (ValueError, RecursionError) as error:  # ValueError: also a number of over 4300 digits
        raise ValueError(f"{where}: not valid JSON ({str(error).splitlines()[0]})") from None


def given(entry: Any) -> Any:
    """A mapping without the fields that are null: they are as good as left out. Anything else as it is."""
    return {key: value for key, value in entry.items() if value is not None} if isinstance(entry, Mapping) else entry


def short(value: Any) -> str:
    """The start of a value, in ASCII, for an error message."""
    return ascii(value[:60] if isinstance(value, str | bytes) else value)[:60]


def convert(value: Any, kind: type[T], where: str = "", *, inside: str | None = None, strict: bool = True) -> T:
    """A plain value, as JSON and YAML give it, as a structure.

    Parameters
    ----------
    value
        Mappings, lists, text, numbers and ``None``. Numbers and arrays of numpy count as numbers and lists.
    kind
        A ``msgspec.Struct``, or any other type that ``msgspec.convert`` knows.
    where
        Name of the value in error messages; empty for none.
    inside
        What the names of its fields begin with; ``where`` for ``None``.
    strict
        ``False`` takes numbers in text, too: to YAML ``1e-3``, without a point, is a text.

    Raises
    ------
    ValueError
        One line: the field, what was expected there and what came.

    Examples
    --------
    >>> convert([1, 2.5], tuple[Metres, Metres], "at")
    (1.0, 2.5)
    >>> convert({"left": "wide"}, dict[str, Metres], "size")
    Traceback (most recent call last):
    ValueError: size.left: expected finite metres, got 'wide'
    """
    try:
        return msgspec.convert(value, kind, strict=strict)
    except (msgspec.ValidationError, UnicodeEncodeError):
        value = plain(value)
    fault = _fault(value, kind, where, where if inside is None else inside, strict)
    if fault is None:
        return msgspec.convert(value, kind, strict=strict)
    raise ValueError(fault or f"{where or 'content'}: malformed, got {short(value)}")


def plain(value: Any) -> Any:
    """The value as JSON has it: without tuples and numpy's types."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def _fault(value: Any, kind: Any, where: str, inside: str, strict: bool) -> str | None:
    """What is wrong, told of the innermost part that has a description; ``None`` if nothing is, empty if no part has one."""
    try:
        msgspec.convert(value, kind, strict=strict)
        return None
    except (msgspec.ValidationError, UnicodeEncodeError) as error:
        reason = str(error).split(" - at `")[0]
    bare, metas = _bare(kind)
    expected = next((meta.description for meta in metas if meta.description), None)
    if isinstance(bare, type) and issubclass(bare, Struct):
        if isinstance(value, Mapping):
            names = [field.name for field in msgspec.structs.fields(bare)]
            required = [field.name for field in msgspec.structs.fields(bare) if field.required]
            if bare.__struct_config__.forbid_unknown_fields and (wrong := _wrong_names(value, names, required)):
                return _join(where, f"expected the fields {', '.join(names)}; missing or not known: {wrong}")
        elif bare.__struct_config__.forbid_unknown_fields:
            expected = f"the fields {', '.join(bare.__struct_fields__)}"
        else:
            expected = expected or "a mapping"
    for part, part_kind, name in _parts(value, bare, metas, where, inside):
        if (fault := _fault(part, part_kind, name, name, strict)) is not None:
            if fault:
                return fault
            break
    else:
        if isinstance(bare, type) and issubclass(bare, Struct) and isinstance(value, Mapping):
            if reason.startswith("expected"):  # what the structure itself says, of all of it or of a field
                return _join(where, reason)
            return f"{inside}.{reason}" if inside else reason
    return _join(where, f"expected {expected}, got {short(value)}") if expected else ""


def _join(where: str, text: str) -> str:
    return f"{where}: {text}" if where else text


def _wrong_names(value: Mapping[Any, Any], names: list[str], required: list[str]) -> str:
    wrong = [*(name for name in required if name not in value), *(name for name in value if name not in names)]
    return ", ".join(short(name) for name in wrong[:3])


def _bare(kind: Any) -> tuple[Any, list[Meta]]:
    """A type without ``Annotated`` and without "or None", and what was annotated."""
    metas: list[Meta] = []
    while True:
        if get_origin(kind) is Annotated:
            kind, *more = get_args(kind)
            metas = [*more, *metas]
        elif get_origin(kind) in (Union, types.UnionType):
            some = [one for one in get_args(kind) if one not in (type(None), msgspec.UnsetType)]
            if len(some) > 1:
                return kind, metas
            kind = some[0]
        else:
            return kind, metas


def _parts(value: Any, bare: Any, metas: list[Meta], where: str, inside: str) -> Iterator[tuple[Any, Any, str]]:
    """Each part of a value with its type and its name; none if the value is no such container or has another length."""
    dot = f"{inside}." if inside else ""
    if isinstance(bare, type) and issubclass(bare, Struct) and isinstance(value, Mapping):
        for field in msgspec.structs.fields(bare):
            if field.required or field.name in value:
                yield value.get(field.name), field.type, f"{dot}{field.name}"
        return
    origin, inner = get_origin(bare), get_args(bare)
    if origin is dict and isinstance(value, Mapping):
        for key, item in value.items():
            yield item, inner[1], f"{dot}{key}"
    if origin in (list, tuple) and isinstance(value, list | tuple):
        fixed = origin is tuple and inner[-1] is not Ellipsis
        low, high = (len(inner),) * 2 if fixed else _lengths(metas)
        for i, item in enumerate(value) if low <= len(value) <= high else ():
            kind = inner[i] if fixed else inner[0]
            of = _bare(kind)[0]  # a number in a list shows itself; only a structure needs its index
            yield item, kind, f"{where}[{i}]" if isinstance(of, type) and issubclass(of, Struct) else where


def _lengths(metas: list[Meta]) -> tuple[float, float]:
    low = max((meta.min_length for meta in metas if meta.min_length is not None), default=0)
    return low, min((meta.max_length for meta in metas if meta.max_length is not None), default=float("inf"))
