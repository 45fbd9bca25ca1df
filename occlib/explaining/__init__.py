"""Beyond AND: the fewest upright objects that explain all silhouettes."""
# fmt: off

from occlib.explaining.appearance import axis_colours, colour_agreement
from occlib.explaining.cylinders import Cylinder
from occlib.explaining.evidence import PolarEvidence, PolarWarp
from occlib.explaining.explainer import Explainer, Explaining, ExplainingFinder, footprints, standing_places
from occlib.explaining.feet import standing_points
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.search import DEFAULT, Explanation, explain

__all__ = [
    "DEFAULT",
    "Cylinder",
    "Explainer",
    "Explaining",
    "ExplainingFinder",
    "Explanation",
    "PolarEvidence",
    "PolarWarp",
    "axis_colours",
    "colour_agreement",
    "explain",
    "footprints",
    "occlusion_state",
    "standing_places",
    "standing_points",
]
