"""Notebooks run, figures and metrics published."""
# fmt: off

from occlib.reproduce.notebook import expect, keep_table, open_or_stop, record, record_all, resume, save
from occlib.reproduce.notebook import save_film, show_versions
from occlib.reproduce.publish import Report, read_metrics, recorded_metrics, reproduce
from occlib.reproduce.runner import Run, find_root, is_current, plan_runs, read_notebook, select_notebooks, tags

__all__ = [
    "Report", "Run", "expect", "find_root", "is_current", "keep_table", "open_or_stop", "plan_runs", "read_metrics",
    "read_notebook", "record", "record_all", "recorded_metrics", "reproduce", "resume", "save", "save_film",
    "select_notebooks", "show_versions", "tags",
]
