"""What has nothing to do with cameras: arrays, checks of arguments, files, videos, Markdown, interrupts, intervals, compiled loops."""
# fmt: off

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, Mask, as_points
from occlib.base.extras import MissingExtraError, check_extra, import_extra, lazy_extra
from occlib.base.files import encode_image, file_hash, file_hashes, folder_hash, load_json, read_image, read_yaml
from occlib.base.files import sha256, staged_folder, write_file
from occlib.base.interrupts import stoppable, uninterrupted
from occlib.base.intervals import stratified_interval, t_interval, wilson_interval

__all__ = [
    "FloatArray", "Image", "Mask", "MissingExtraError", "as_points", "check_extra", "checks", "encode_image",
    "file_hash", "file_hashes", "folder_hash", "import_extra", "lazy_extra", "load_json", "read_image", "read_yaml",
    "sha256", "staged_folder", "stoppable", "stratified_interval", "t_interval", "uninterrupted", "wilson_interval",
    "write_file",
]
