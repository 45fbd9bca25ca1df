"""Every profile on every room: rendered rooms, the lab and real recordings at hand; the table of them and its page."""
# fmt: off

from occlib.study.rooms.cases import REAL, WORDS, Case, cases_at_hand, light_cases
from occlib.study.rooms.lighting import LIGHTS, Light
from occlib.study.rooms.page import page_text, stale_page, write_page
from occlib.study.rooms.scoring import Method, methods_of, run_case, worst_instant
from occlib.study.rooms.tables import COLUMNS, difference, falls, joined, load_table, save_table, summary_text

__all__ = [
    "COLUMNS", "LIGHTS", "REAL", "WORDS", "Case", "Light", "Method", "cases_at_hand", "difference", "falls", "joined",
    "light_cases", "load_table", "methods_of", "page_text", "run_case", "save_table", "stale_page", "summary_text",
    "worst_instant", "write_page",
]
