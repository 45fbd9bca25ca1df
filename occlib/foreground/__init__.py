"""What has changed in a view: intensity, background, difference, threshold, shadows, health (sections 2 and 4; Figs 4-6)."""
# fmt: off

from occlib.foreground.background import Background, as_background, average_background, weighted_median
from occlib.foreground.difference import foreground_mask, smooth, subtract_background
from occlib.foreground.evidence import Difference, Evidence
from occlib.foreground.health import CameraMonitor
from occlib.foreground.intensity import adjust_intensity, channel_gain_offset, intensity_gain_offset, to_grey
from occlib.foreground.learning import learn_background
from occlib.foreground.shadows import SURE, ShadowModel, foreground_evidence
from occlib.foreground.threshold import THRESHOLDS, half_otsu_threshold, otsu_threshold, threshold_level
from occlib.foreground.threshold import triangle_threshold

__all__ = [
    "SURE",
    "THRESHOLDS",
    "Background",
    "CameraMonitor", "Difference", "Evidence",
    "ShadowModel",
    "adjust_intensity",
    "as_background",
    "average_background",
    "channel_gain_offset",
    "foreground_evidence",
    "foreground_mask",
    "half_otsu_threshold",
    "intensity_gain_offset",
    "learn_background",
    "otsu_threshold",
    "smooth",
    "subtract_background",
    "threshold_level",
    "to_grey",
    "triangle_threshold",
    "weighted_median",
]
