"""Rendered scenes and crowds with exact truth: what can be known to the last digit."""
# fmt: off

from occlib.lab.colours import colour_study
from occlib.lab.crowds import BEARINGS, FLOOR, base_m, places_m, random_crowd, random_crowds, truth_of, upright, wall_rig
from occlib.lab.ghosts import crossings, expected_crossings, ghost_regions, shadow_mask, shadow_outline_m, smear_m
from occlib.lab.manifest import verify_manifest, write_manifest
from occlib.lab.missions import MAPS, MISSION_FLOOR, RADIUS_M, STEP_S, Mission, Outcome, drive_together
from occlib.lab.missions import random_mission, run_missions, summary
from occlib.lab.rendering import render
from occlib.lab.room_lists import DEVELOPMENT, REPORTED, SHIPPED, is_rendered, listed_room, listed_scene
from occlib.lab.rooms import random_scene
from occlib.lab.scenes import Scene, SceneObject, Waypoint, floor_board, floor_marks, load_scene
from occlib.lab.shapes import SHAPES, Part, Shape, hit_distance, revolved_mesh, rotation_xyz, unit_mesh
from occlib.lab.simulation import EXPLAIN, Simulation, evidence_of, measured_smear_m, misses, score
from occlib.lab.simulation import recall_study, region_places, score_places, two_view_study, union, votes_needed
from occlib.lab.truth import depth_image, ground_truth, silhouettes

__all__ = [
    "BEARINGS", "DEVELOPMENT", "EXPLAIN", "FLOOR", "MAPS", "MISSION_FLOOR", "RADIUS_M", "REPORTED", "SHAPES",
    "SHIPPED", "STEP_S", "Mission", "Outcome", "Part", "Scene", "SceneObject", "Shape", "Simulation", "Waypoint",
    "base_m", "colour_study", "crossings", "depth_image", "drive_together", "evidence_of", "expected_crossings",
    "floor_board", "floor_marks", "ghost_regions", "ground_truth", "hit_distance", "is_rendered", "listed_room",
    "listed_scene", "load_scene", "measured_smear_m", "misses", "places_m", "random_crowd", "random_crowds",
    "random_mission", "random_scene", "recall_study", "region_places", "render", "revolved_mesh", "rotation_xyz",
    "run_missions", "score", "score_places", "shadow_mask", "shadow_outline_m", "silhouettes", "smear_m", "summary",
    "truth_of", "two_view_study", "union", "unit_mesh", "upright", "verify_manifest", "votes_needed", "wall_rig",
    "write_manifest",
]
