"""Scores: detections against the truth, maps against true footprints, masks against true silhouettes."""
# fmt: off

from occlib.metrics.detections import Detected, Detections, HiddenScore, Score, evaluate, evaluate_hidden
from occlib.metrics.detections import inside_polygon, match_points, recall_by_hidden_fraction
from occlib.metrics.maps import claimed_area_ratio, footprint_coverage, foreground_scores

__all__ = [
    "Detected", "Detections", "HiddenScore", "Score", "claimed_area_ratio", "evaluate", "evaluate_hidden",
    "footprint_coverage", "foreground_scores", "inside_polygon", "match_points", "recall_by_hidden_fraction",
]
