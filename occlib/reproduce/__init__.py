"""Notebooks run, figures and metrics published, copies for students."""
# fmt: off

from occlib.reproduce.figures import cover_heads, fill_hull, frame_strip, lamps_and_shadows, outline_cylinders
from occlib.reproduce.figures import rig_in_3d, rig_section, show_mask_errors, vector_life, view_points_m
from occlib.reproduce.figures import views_and_map
from occlib.reproduce.notebook import keep_table, open_or_stop, record, save, show_versions
from occlib.reproduce.publish import Report, reproduce
from occlib.reproduce.runner import find_root, select_notebooks
from occlib.reproduce.students import student_copies, student_copy

__all__ = [
    "Report", "cover_heads", "fill_hull", "find_root", "frame_strip", "keep_table", "lamps_and_shadows",
    "open_or_stop", "outline_cylinders", "record", "reproduce", "rig_in_3d", "rig_section", "save", "select_notebooks",
    "show_mask_errors", "show_versions", "student_copies", "student_copy", "vector_life", "view_points_m",
    "views_and_map",
]
