"""The JSON Schemas of the formats as tables in Markdown."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any


def schema_tables(name: str, schema: Mapping[str, Any]) -> str:
    """A table of the fields for each structure of a schema, the outermost first.

    Parameters
    ----------
    name
        Of the schema: ``objects``.
    schema
        As :func:`occlib.formats.json_schema` gives it.
    """
    definitions = schema["$defs"]
    listed = schema.get("type") == "array"
    outermost = (schema["items"] if listed else schema)["$ref"].rsplit("/", 1)[-1]
    order = [outermost, *(title for title in definitions if title != outermost)]
    parts = [f"### {name}.json", "A list. Each of its entries:" if listed else ""]
    for title in order:
        definition = definitions[title]
        if title != outermost:
            parts.append(f"**{title}**")
        text = definition.get("description", "")
        parts.append(_as_markdown(text.split("\n\nParameters\n")[0]))
        parts.append(_table(definition, _explained(text)))
    return "\n\n".join(filter(None, parts)) + "\n"


def _table(definition: Mapping[str, Any], explained: Mapping[str, str]) -> str:
    required = set(definition.get("required", ()))
    rows = ["| field | value | meaning | |", "|---|---|---|---|"]
    for field, schema in definition.get("properties", {}).items():
        need = "required" if field in required else _default(schema)
        rows.append(f"| `{field}` | {_kind(schema)} | {explained.get(field, '')} | {need} |")
    return "\n".join(rows) if len(rows) > 2 else ""


def _kind(schema: Mapping[str, Any]) -> str:
    """In words what a value may be; the descriptions of the formats say it, else the type."""
    if text := schema.get("description"):
        return _as_markdown(text)
    if reference := schema.get("$ref"):
        return f"a {reference.rsplit('/', 1)[-1]}"
    if choices := schema.get("anyOf"):
        kinds = list(dict.fromkeys(map(_kind, choices)))
        said = any(kind.endswith("or null") for kind in kinds)
        return " or ".join(kind for kind in kinds if not (said and kind == "null"))
    if values := schema.get("enum"):
        return " or ".join(f"`{value}`" for value in values)
    return {"null": "null", "array": "a list", "object": "a mapping"}.get(
        schema.get("type", ""), schema.get("type", "")
    )


def _default(schema: Mapping[str, Any]) -> str:
    if "default" not in schema:
        return ""
    value = schema["default"]
    texts = {None: "null", True: "true", False: "false"}
    shown = texts.get(value, value) if isinstance(value, bool | None) else value
    return f"default `{shown}`"


def _explained(text: str) -> dict[str, str]:
    """What the section "Parameters" of a numpydoc docstring says of each field."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in text.partition("\n\nParameters\n")[2].splitlines()[1:]:
        if line.startswith("    ") and names:
            for name in names:
                found[name] = " ".join(filter(None, [found.get(name), line.strip()]))
        elif line.strip() and set(line) != {"-"}:
            names = [name.strip() for name in line.split(":")[0].split(",")]
        elif not line.strip():
            names = []
    return {name: _as_markdown(words) for name, words in found.items()}


def _as_markdown(text: str) -> str:
    text = re.sub(r":\w+:`~?([^`]*)`", r"`\1`", text).replace("``", "`")
    return " ".join(text.split()).replace("|", "\\|")
