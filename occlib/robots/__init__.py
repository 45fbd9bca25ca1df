"""Robots that plan on the map, and keep out of each other's way."""
# fmt: off

from occlib.robots.navigation import Navigator, free_start, path_length_m, plan, plan_timed, shorten
from occlib.robots.reservations import Point, Reservations, Trajectory, position_at

__all__ = [
    "Navigator", "Point", "Reservations", "Trajectory", "free_start", "path_length_m", "plan", "plan_timed",
    "position_at", "shorten",
]
