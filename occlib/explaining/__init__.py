"""Beyond AND: the fewest upright objects that explain all silhouettes; where they stand, who hides whom."""
# fmt: off

from occlib.explaining.appearance import axis_colours, colour_agreement
from occlib.explaining.cylinders import Cylinder, plausible, silhouette
from occlib.explaining.evidence import PolarEvidence, PolarView, PolarWarp
from occlib.explaining.explainer import Explainer, Explaining, ExplainingFinder, footprints, standing_places
from occlib.explaining.feet import standing_points
from occlib.explaining.hiding import occlusion_state
from occlib.explaining.search import DEFAULT, ExplainSettings, explain

__all__ = [
    "DEFAULT",
    "Cylinder",
    "ExplainSettings",
    "Explainer",
    "Explaining",
    "ExplainingFinder",
    "PolarEvidence",
    "PolarView",
    "PolarWarp",
    "axis_colours",
    "colour_agreement",
    "explain",
    "footprints",
    "occlusion_state",
    "plausible",
    "silhouette",
    "standing_places",
    "standing_points",
]
