"""Scores: detections against the truth, maps against true footprints, masks against true silhouettes."""
# fmt: off

from occlib.metrics.detections import Detected, Detections, HiddenScore, IdentityScore, Score, evaluate, evaluate_hidden
from occlib.metrics.detections import evaluate_identity, inside_polygon, match_points, polygon_area
from occlib.metrics.detections import recall_by_hidden_fraction
from occlib.metrics.maps import claimed_area_ratio, footprint_coverage, foreground_scores

__all__ = [
    "Detected", "Detections", "HiddenScore", "IdentityScore", "Score", "claimed_area_ratio", "evaluate", "evaluate_hidden", "evaluate_identity",
    "footprint_coverage", "foreground_scores", "inside_polygon", "match_points", "polygon_area",
    "recall_by_hidden_fraction",
]
