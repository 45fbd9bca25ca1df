"""What the notebooks are taught with: drawings, exercises that answer back, copies for students; and the book."""
# fmt: off

from occlib.course.book import build_book, build_pages, check_site
from occlib.course.checking import check
from occlib.course.drawings import cover_heads, fill_hull, film_frame, frame_strip, lamps_and_shadows
from occlib.course.drawings import outline_cylinders
from occlib.course.drawings import rig_in_3d, rig_section, show_mask_errors, vector_life, view_points_m
from occlib.course.drawings import views_and_map
from occlib.course.explorable import explorable
from occlib.course.ledger import broken_references, claims_table, load_claims, markdown_table, measured_text
from occlib.course.ledger import stale_files, verdict_counts, write_generated
from occlib.course.numbers import Measured, Quoted, check_quotes, given_numbers, load_metrics, prose_of
from occlib.course.numbers import quoted_numbers, unmarked_numbers
from occlib.course.students import student_copies, student_copy

__all__ = [
    "Measured", "Quoted", "broken_references", "build_book", "build_pages", "check", "check_quotes", "check_site",
    "claims_table", "cover_heads", "explorable", "fill_hull", "film_frame", "frame_strip", "given_numbers",
    "lamps_and_shadows", "load_claims", "load_metrics", "markdown_table", "measured_text", "outline_cylinders",
    "prose_of", "quoted_numbers", "rig_in_3d", "rig_section", "show_mask_errors", "stale_files", "student_copies",
    "student_copy", "unmarked_numbers", "vector_life", "verdict_counts", "view_points_m", "views_and_map",
    "write_generated",
]
