"""Template matching: measures, similarity images and the places they point to (section 3; Eq 1 and 2)."""
# fmt: off

from occlib.matching.measures import METHODS, Method
from occlib.matching.optima import optima, refine
from occlib.matching.registry import matcher
from occlib.matching.search import Comparison, Match, compare, default_threshold, find, reference_similarity
from occlib.matching.search import similarity
from occlib.matching.thresholds import score_threshold

__all__ = [
    "METHODS",
    "Comparison",
    "Match",
    "Method",
    "compare",
    "default_threshold",
    "find",
    "matcher",
    "optima",
    "reference_similarity",
    "refine",
    "score_threshold",
    "similarity",
]
