"""A room to explore: cameras and objects are moved, shadows, AND, ghosts and the explained objects follow."""
# fmt: off

from occlib.course.explorable.page import frame_of, page_of, preset_scene, presets, standalone_page
from occlib.course.explorable.scene import LibraryMap, crowd_of, library_map, seen_cells
from occlib.course.explorable.widget import explorable

__all__ = [
    "LibraryMap", "crowd_of", "explorable", "frame_of", "library_map", "page_of", "preset_scene", "presets",
    "seen_cells", "standalone_page",
]
