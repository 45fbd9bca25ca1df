"""Robots that plan on the map, and keep out of each other's way."""
# fmt: off

from occlib.robots.navigation import Navigator
from occlib.robots.paths import free_start, path_length_m, plan, shorten
from occlib.robots.reservations import Point, Reservations, Trajectory, position_at
from occlib.robots.timed import plan_timed

__all__ = [
    "Navigator", "Point", "Reservations", "Trajectory", "free_start", "path_length_m", "plan", "plan_timed",
    "position_at", "shorten",
]
