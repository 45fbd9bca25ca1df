"""JSON Schemas of the formats, for programs in other languages."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import msgspec

from occlib.base.files import write_file
from occlib.formats.claims import Claim
from occlib.formats.manifests import LabManifest, RunManifest, SweepManifest
from occlib.formats.message import Header
from occlib.formats.objects import ObjectsLine
from occlib.formats.rig import RigFile
from occlib.formats.scene import RoomFile, SceneFile
from occlib.formats.truth import Truth

SCHEMAS: dict[str, Any] = {
    "rig": RigFile,
    "truth": Truth,
    "objects": ObjectsLine,
    "message_header": Header,
    "scene": SceneFile,
    "room": RoomFile,
    "lab_manifest": LabManifest,
    "run_manifest": RunManifest,
    "sweep_manifest": SweepManifest,
    "claims": list[Claim],
}
"""What is written as a JSON Schema: name of the file, and the structure. ``objects`` is one line of ``objects.jsonl``."""


def json_schema(name: str) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of one of :data:`SCHEMAS`."""
    schema = msgspec.json.schema(SCHEMAS[name])
    for definition in schema["$defs"].values():  # their descriptions are docstrings
        definition["description"] = inspect.cleandoc(definition["description"]).split("\n\nExamples\n")[0]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_schemas(folder: str | Path) -> list[Path]:
    """Write ``NAME.json`` for each of :data:`SCHEMAS` to a folder; the paths."""
    return [
        write_file(Path(folder) / f"{name}.json", json.dumps(json_schema(name), indent=1) + "\n") for name in SCHEMAS
    ]
