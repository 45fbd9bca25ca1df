"""The files that occlib reads and writes, each a typed structure with one owner."""
# fmt: off

from occlib.formats.rig import CameraEntry, FloorEntry, RigFile, load_rig, rig_file
from occlib.formats.truth import load_objects, load_truth

__all__ = ["CameraEntry", "FloorEntry", "RigFile", "load_objects", "load_rig", "load_truth", "rig_file"]
