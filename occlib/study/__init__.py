"""Which measure, when: trials under every condition, tables and charts (section 3)."""
# fmt: off

from occlib.study.charts import best_place, comparison_figure, comparison_rows, comparison_table, contact_sheet
from occlib.study.charts import frame_place, heatmap, is_constant, level_curves, measure_styles, precision_recall_curves, runtime_curves
from occlib.study.charts import score_histogram, verdict_figure
from occlib.study.conditions import CONDITIONS, Condition
from occlib.study.pictures import compare_pictures
from occlib.study.sweeps import load_matchers, run_batches
from occlib.study.tables import areas, fixed_thresholds, precision_recall, summarise, thresholds, verdicts
from occlib.study.trials import Trial, make_trial, measured_trial, runtime, sources
from occlib.study.work import Batch, batches, run, run_batch

__all__ = [
    "CONDITIONS",
    "Batch",
    "Condition",
    "Trial",
    "areas",
    "batches",
    "best_place",
    "compare_pictures",
    "comparison_figure",
    "comparison_rows",
    "comparison_table",
    "contact_sheet",
    "fixed_thresholds",
    "frame_place",
    "heatmap",
    "is_constant",
    "level_curves",
    "load_matchers",
    "make_trial",
    "measure_styles",
    "measured_trial",
    "precision_recall",
    "precision_recall_curves",
    "run",
    "run_batch",
    "run_batches",
    "runtime",
    "runtime_curves",
    "score_histogram",
    "sources",
    "summarise",
    "thresholds",
    "verdict_figure",
    "verdicts",
]
