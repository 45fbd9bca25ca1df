"""Which measure, when: trials under every condition, tables and charts (section 3)."""
# fmt: off

from occlib.study.charts import comparison_figure, comparison_rows, comparison_table, contact_sheet
from occlib.study.charts import frame_place, heatmap
from occlib.study.charts import is_constant, level_curves, measure_styles, precision_recall_curves, runtime_curves
from occlib.study.charts import score_histogram, verdict_figure
from occlib.study.comparison import compare_pictures
from occlib.study.conditions import CHANGING_LIGHT, CONDITIONS, CONSTANT_LIGHT, Condition
from occlib.study.sweeps import Sweep, load_matchers, run_batches, sweep
from occlib.study.tables import RULES, areas, fixed_thresholds, precision_recall, summarise, thresholds, verdicts
from occlib.study.tables import verdicts_of
from occlib.study.trials import Trial, make_trial, measured_trial, runtime, sources
from occlib.study.work import PRESETS, Batch, batches, run, run_batch

__all__ = [
    "CHANGING_LIGHT", "CONDITIONS", "CONSTANT_LIGHT", "PRESETS", "RULES", "Batch", "Condition", "Sweep", "Trial",
    "areas", "batches", "compare_pictures", "comparison_figure", "comparison_rows", "comparison_table", "contact_sheet",
    "fixed_thresholds", "frame_place", "heatmap", "is_constant", "level_curves", "load_matchers", "make_trial", "measure_styles",
    "measured_trial", "precision_recall", "precision_recall_curves", "run", "run_batch", "run_batches", "runtime",
    "runtime_curves", "score_histogram", "sources", "summarise", "sweep", "thresholds", "verdict_figure", "verdicts",
    "verdicts_of",
]
