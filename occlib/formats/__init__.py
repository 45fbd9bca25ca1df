"""The files that occlib reads and writes: a camera's pictures in several forms; the others are typed structures.

Each structure has one owner, and a JSON Schema in ``docs/schemas``.
"""
# fmt: off

from occlib.formats.claims import PLACE, Claim, Evidence, Kind, VerdictWord
from occlib.formats.decoding import convert, parse_json, read_bytes, short
from occlib.formats.footage import Footage, input_format
from occlib.formats.manifests import LabManifest, Metric, RunManifest, SweepManifest
from occlib.formats.message import Header, MapFloor, MapObject
from occlib.formats.objects import DetectedObject, ObjectsLine, load_objects
from occlib.formats.rig import CameraEntry, FloorEntry, RigFile, load_rig, rig_file
from occlib.formats.scene import RoomFile, SceneFile
from occlib.formats.schemas import SCHEMAS, json_schema, write_schemas
from occlib.formats.truth import TrueObject, Truth, load_truth

__all__ = [
    "PLACE", "SCHEMAS", "CameraEntry", "Claim", "DetectedObject", "Evidence", "FloorEntry", "Footage", "Header",
    "Kind", "LabManifest", "MapFloor", "MapObject", "Metric", "ObjectsLine", "RigFile", "RoomFile", "RunManifest",
    "SceneFile", "SweepManifest", "TrueObject", "Truth", "VerdictWord", "convert", "input_format", "json_schema",
    "load_objects", "load_rig", "load_truth", "parse_json", "read_bytes", "rig_file", "short", "write_schemas",
]
