"""Shapes of which objects are built, each a unit shape under an affine map.

A shape is an entry of :data:`SHAPES`: its mesh and its ray test. All else follows from these two: footprints and
shadows are the convex hull of the mesh's vertices, silhouettes and truth come from rays, pictures from the mesh. A ray
test takes the ray back to the unit shape, where it is one closed formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from occlib.base.arrays import FloatArray

AROUND = 96
"""Vertices around a round mesh: on an object 0.5 m wide the polygon lies within 0.14 mm of the circle."""

RINGS = 47
"""Rings of vertices from pole to pole of an ellipsoid's mesh."""

Span = tuple[FloatArray, FloatArray]
"""Where rays enter and leave a shape, each (N,), in units of their directions; near > far, or NaN, is a miss."""


@dataclass(frozen=True)
class Shape:
    """A convex shape that reaches from -0.5 to 0.5 along each axis.

    Parameters
    ----------
    mesh
        Gives its vertices (N, 3) and triangles (M, 3), indices of vertices, anticlockwise as seen from outside.
    span
        From the origin (3,) and the directions (N, 3) of rays in the shape's own frame, gives their :data:`Span`. It
        may divide by 0.
    """

    mesh: Callable[[], tuple[FloatArray, FloatArray]]
    span: Callable[[FloatArray, FloatArray], Span]


@dataclass(frozen=True)
class Swing:
    """A pendulum about the y axis through ``pivot`` (m): ``degrees * sin(2 pi (frame / period + phase))``."""

    pivot: tuple[float, float, float]
    degrees: float
    period: float
    phase: float = 0.0

    def matrix(self, frame: float) -> FloatArray:
        """The turn at a frame, 4x4."""
        matrix = np.eye(4)
        angle = self.degrees * np.sin(2 * np.pi * (frame / self.period + self.phase))
        matrix[:3, :3] = rotation_xyz((0.0, angle, 0.0))
        matrix[:3, 3] = np.array(self.pivot) - matrix[:3, :3] @ self.pivot
        return matrix


@dataclass(frozen=True)
class Part:
    """A unit shape under an affine map: ``size`` are full extents in m, ``turn`` degrees about x, y, z."""

    shape: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    colour: tuple[float, float, float]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    swing: Swing | None = None

    @property
    def matrix(self) -> FloatArray:
        """4x4, unit shape to the frame of the object, as it is without its swing."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_xyz(self.turn) @ np.diag(self.size)
        matrix[:3, 3] = self.centre
        return matrix

    def matrix_at(self, frame: float) -> FloatArray:
        """4x4, unit shape to the frame of the object at a frame."""
        return self.matrix if self.swing is None else self.swing.matrix(frame) @ self.matrix


def rotation_xyz(degrees: Iterable[float]) -> FloatArray:
    """Rotation about x, then y, then z, 3x3."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(list(degrees))), np.sin(np.radians(list(degrees)))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def unit_mesh(shape: str) -> tuple[FloatArray, FloatArray]:
    """Vertices (N, 3) and triangles (M, 3) of a unit shape, extents -0.5 to 0.5."""
    return SHAPES[shape].mesh()


def hit_distance(shape: str, matrix: FloatArray, origin: FloatArray, directions: FloatArray) -> FloatArray:
    """Distance along each ray (N, 3), in units of its direction, to a unit shape under ``matrix``; inf if missed.

    The camera is taken to be outside the shape.
    """
    inverse = np.linalg.inv(matrix)
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = SHAPES[shape].span(inverse[:3, :3] @ origin + inverse[:3, 3], directions @ inverse[:3, :3].T)
        return np.where((near <= far) & (far > 0), near, np.inf)


def _box_mesh() -> tuple[FloatArray, FloatArray]:
    vertices = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def _cylinder_mesh() -> tuple[FloatArray, FloatArray]:
    return revolved_mesh([(1.0, -0.5), (1.0, 0.5)])


def _ellipsoid_mesh() -> tuple[FloatArray, FloatArray]:
    tilts = np.linspace(-np.pi / 2, np.pi / 2, RINGS + 2)[1:-1]
    return revolved_mesh([(np.cos(t), np.sin(t) / 2) for t in tilts])


def revolved_mesh(rings: Sequence[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    """Mesh of a shape that is round about z: for each ring its width, 0 to 1, and its z, from bottom to top."""
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) / 2
    vertices = np.vstack(
        [[[0, 0, -0.5]], *(np.column_stack([circle * r, np.full(AROUND, z)]) for r, z in rings), [[0, 0, 0.5]]]
    )
    k, following = np.arange(AROUND), (np.arange(AROUND) + 1) % AROUND
    faces = [np.column_stack([np.zeros(AROUND, int), 1 + following, 1 + k])]
    for ring in range(len(rings) - 1):
        low, high = 1 + ring * AROUND, 1 + (ring + 1) * AROUND
        faces += [
            np.column_stack([low + k, low + following, high + following]),
            np.column_stack([low + k, high + following, high + k]),
        ]
    top = 1 + (len(rings) - 1) * AROUND
    faces.append(np.column_stack([top + k, top + following, np.full(AROUND, len(vertices) - 1)]))
    return vertices, np.vstack(faces)


def _between_planes(origin: FloatArray, directions: FloatArray, axes: Sequence[int] = (0, 1, 2)) -> Span:
    """Between two planes at -0.5 and 0.5 along each of some axes."""
    near, far = np.full(len(directions), -np.inf), np.full(len(directions), np.inf)
    for axis in axes:
        a, b = (-0.5 - origin[axis]) / directions[:, axis], (0.5 - origin[axis]) / directions[:, axis]
        near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
    return near, far


def _in_sphere(origin: FloatArray, directions: FloatArray) -> Span:
    """Within 0.5 of the middle: the roots of |o + t d|^2 = 1/4; with x and y alone, within 0.5 of the z axis."""
    a, b, c = (directions**2).sum(1), directions @ origin, origin @ origin - 0.25
    root = np.sqrt(b * b - a * c)
    return (-b - root) / a, (-b + root) / a


def _in_cylinder(origin: FloatArray, directions: FloatArray) -> Span:
    (low, high), (near, far) = _between_planes(origin, directions, [2]), _in_sphere(origin[:2], directions[:, :2])
    return np.maximum(low, near), np.minimum(high, far)


def _cone_mesh() -> tuple[FloatArray, FloatArray]:
    return revolved_mesh([(1.0, -0.5)])


def _in_cone(origin: FloatArray, directions: FloatArray) -> Span:
    """Where x^2 + y^2 <= (0.5 - z)^2 / 4 and -0.5 <= z <= 0.5: a cone with its tip at the top.

    A ray that is steeper than the cone's side (a < 0) is inside beyond its roots: before the first if it goes up, after
    the second if it goes down. Beyond the other root lies the mirror image above the tip.
    """
    dz, below = directions[:, 2] / 2, (0.5 - origin[2]) / 2
    a = (directions[:, :2] ** 2).sum(1) - dz * dz
    b = directions[:, :2] @ origin[:2] + below * dz
    square = b * b - a * (origin[:2] @ origin[:2] - below**2)
    root = np.sqrt(np.where(a < 0, np.maximum(square, 0), square))
    first, last = (-b - root) / a, (-b + root) / a
    near = np.where(a > 0, first, np.where(dz > 0, -np.inf, first))
    far = np.where(a > 0, last, np.where(dz > 0, last, np.inf))
    low, high = _between_planes(origin, directions, [2])
    return np.maximum(low, near), np.minimum(high, far)


SHAPES = {
    "box": Shape(_box_mesh, _between_planes),
    "ellipsoid": Shape(_ellipsoid_mesh, _in_sphere),
    "cylinder": Shape(_cylinder_mesh, _in_cylinder),
    "cone": Shape(_cone_mesh, _in_cone),
}
"""Every shape that a scene may name."""
