"""Beyond AND: the fewest upright objects that explain all silhouettes; where they stand, who hides whom."""
# fmt: off

from occlib.explaining.appearance import axis_colours, colour_agreement
from occlib.explaining.evidence import PolarEvidence, PolarView, PolarWarp
from occlib.explaining.explainer import Explainer, Explaining, ExplainingFinder, footprints, standing_places
from occlib.explaining.feet import standing_points
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.prisms import BOX, Prism, outline_points, parts, plausible
from occlib.explaining.silhouettes import silhouette
from occlib.explaining.refining import DEFAULT, ExplainSettings
from occlib.explaining.search import Explanation, explain

__all__ = [
    "BOX",
    "DEFAULT",
    "ExplainSettings",
    "Explainer",
    "Explaining",
    "ExplainingFinder",
    "Explanation",
    "PolarEvidence",
    "PolarView",
    "PolarWarp",
    "Prism",
    "axis_colours",
    "colour_agreement",
    "explain",
    "footprints",
    "occlusion_state",
    "outline_points",
    "parts",
    "plausible",
    "silhouette",
    "standing_places",
    "standing_points",
]
