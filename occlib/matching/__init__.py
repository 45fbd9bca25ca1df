"""Template matching: measures, similarity images and the places they point to (section 3; Eq 1 and 2)."""
# fmt: off

from occlib.matching.measures import METHODS, Method
from occlib.matching.optima import best, optima, refine
from occlib.matching.reference import REFERENCES, reference_similarity
from occlib.matching.registry import load_matchers, matcher
from occlib.matching.search import Comparison, Match, compare, default_threshold, find, similarity
from occlib.matching.sums import correlate
from occlib.matching.thresholds import score_threshold

__all__ = [
    "METHODS",
    "REFERENCES",
    "Comparison",
    "Match",
    "Method",
    "best",
    "compare",
    "correlate",
    "default_threshold",
    "find",
    "load_matchers",
    "matcher",
    "optima",
    "reference_similarity",
    "refine",
    "score_threshold",
    "similarity",
]
