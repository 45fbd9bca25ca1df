"""DOC"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from occlib.base.arrays import FloatArray

SHAPES = ("box", "ellipsoid", "cylinder")


@dataclass(frozen=True)
class Part:
    """A unit shape under an affine map: ``size`` are full extents in m, ``turn`` degrees about x, y, z."""

    shape: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    colour: tuple[float, float, float]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def matrix(self) -> FloatArray:
        """4x4, unit shape to the frame of the object."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_xyz(self.turn) @ np.diag(self.size)
        matrix[:3, 3] = self.centre
        return matrix


def rotation_xyz(degrees: Iterable[float]) -> FloatArray:
    """Rotation about x, then y, then z, 3x3."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(list(degrees))), np.sin(np.radians(list(degrees)))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def unit_mesh(shape: str) -> tuple[FloatArray, FloatArray]:
    """Vertices (N, 3) and triangles (M, 3) of a unit shape, extents -0.5 to 0.5."""
    if shape == "box":
        vertices = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    around = 96
    angle = np.arange(around) * 2 * np.pi / around
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) / 2
    if shape == "cylinder":
        rings = [(1.0, -0.5), (1.0, 0.5)]
    else:
        tilt = np.linspace(-np.pi / 2, np.pi / 2, 49)[1:-1]
        rings = [(np.cos(t), np.sin(t) / 2) for t in tilt]
    vertices = np.vstack(
        [[[0, 0, -0.5]], *(np.column_stack([circle * r, np.full(around, z)]) for r, z in rings), [[0, 0, 0.5]]]
    )
    k, following = np.arange(around), (np.arange(around) + 1) % around
    faces = [np.column_stack([np.zeros(around, int), 1 + following, 1 + k])]
    for ring in range(len(rings) - 1):
        low, high = 1 + ring * around, 1 + (ring + 1) * around
        faces += [
            np.column_stack([low + k, low + following, high + following]),
            np.column_stack([low + k, high + following, high + k]),
        ]
    top = 1 + (len(rings) - 1) * around
    faces.append(np.column_stack([top + k, top + following, np.full(around, len(vertices) - 1)]))
    return vertices, np.vstack(faces)


def hit_distance(shape: str, matrix: FloatArray, origin: FloatArray, directions: FloatArray) -> FloatArray:
    """Distance along each ray (N, 3), in units of its direction, to a unit shape under ``matrix``; inf if missed.

    The camera is taken to be outside the shape.
    """
    inverse = np.linalg.inv(matrix)
    o = inverse[:3, :3] @ origin + inverse[:3, 3]
    d = directions @ inverse[:3, :3].T
    axes = {"box": 3, "cylinder": 1, "ellipsoid": 0}[shape]  # slabs, counted from z
    near, far = np.full(len(d), -np.inf), np.full(len(d), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in range(3 - axes, 3):
            a, b = (-0.5 - o[axis]) / d[:, axis], (0.5 - o[axis]) / d[:, axis]
            near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
        if axes < 3:  # |o + t d|^2 = 1/4 over the round axes
            n = 3 - axes
            a, b, c = (d[:, :n] ** 2).sum(1), d[:, :n] @ o[:n], o[:n] @ o[:n] - 0.25
            root = np.sqrt(b * b - a * c)  # NaN where the ray misses
            near, far = np.maximum(near, (-b - root) / a), np.minimum(far, (-b + root) / a)
        return np.where((near <= far) & (far > 0), near, np.inf)
