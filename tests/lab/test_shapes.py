"""A shape's mesh and its ray test are the same solid, and a new one is one entry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial import ConvexHull

from occlib.base.arrays import FloatArray
from occlib.lab.crowds import upright, wall_rig
from occlib.lab.ghosts import shadow_mask, shadow_outline_m
from occlib.lab.scenes import load_scene
from occlib.lab.shapes import SHAPES, Shape, Span, hit_distance, rotation_xyz, unit_mesh
from occlib.lab.truth import silhouettes
from occlib.recordings import LAB


def octahedron_mesh() -> tuple[FloatArray, FloatArray]:
    vertices = np.vstack([np.eye(3), -np.eye(3)]) / 2
    return vertices, ConvexHull(vertices).simplices


def in_octahedron(origin: FloatArray, directions: FloatArray) -> Span:
    near, far = np.full(len(directions), -np.inf), np.full(len(directions), np.inf)
    for normal in ([1, 1, 1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]):
        a, b = ((side - origin @ normal) / (directions @ normal) for side in (-0.5, 0.5))
        near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
    return near, far


@pytest.fixture(autouse=True)
def octahedron(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shape of the user's own."""
    monkeypatch.setitem(SHAPES, "octahedron", Shape(octahedron_mesh, in_octahedron))


@pytest.mark.parametrize(
    "station", [(-3.0, 0.5, 1.5), (0.0, -2.0, 2.8), (0.5, 1.8, -1.9)], ids=["aside", "above", "below"]
)
@pytest.mark.parametrize("name", [*SHAPES, "octahedron"])
def test_rays_and_mesh_are_the_same_solid(name: str, station: tuple[float, float, float]) -> None:
    rng, matrix = np.random.default_rng(0), np.eye(4)
    matrix[:3, :3] = rotation_xyz((20, -35, 50)) @ np.diag([0.5, 0.8, 0.3])
    matrix[:3, 3] = 0.2, -0.1, 0.4
    vertices, faces = unit_mesh(name)
    assert np.array_equal([vertices.min(axis=0), vertices.max(axis=0)], [[-0.5] * 3, [0.5] * 3])
    assert set(faces.ravel()) == set(range(len(vertices)))
    origin, aims = np.array(station), rng.uniform(-0.3, 0.3, (500, 3)) + matrix[:3, 3]
    depth = hit_distance(name, matrix, origin, aims - origin)
    hull = ConvexHull(vertices @ matrix[:3, :3].T + matrix[:3, 3])
    facing = (aims - origin) @ hull.equations[:, :3].T  # > 0 where a ray leaves the half-space of a face
    to_face = -(hull.equations[:, :3] @ origin + hull.equations[:, 3]) / facing
    near, far = np.where(facing < 0, to_face, -np.inf).max(axis=1), np.where(facing > 0, to_face, np.inf).min(axis=1)
    expected = np.where(near <= far, near, np.inf)
    assert 100 < np.isfinite(depth).sum() < 450
    assert np.mean(np.isclose(depth, expected, rtol=0, atol=0.003)) > 0.99  # all but grazing rays


def test_a_new_shape_stands_in_a_scene_and_casts_its_shadow(tmp_path: Path) -> None:
    content = yaml.safe_load((LAB / "robot/scene.yaml").read_text())
    content |= {"room": str(LAB / "room.yaml"), "frames": 1}
    part = {"shape": "octahedron", "centre": [0, 0, 0.2], "size": [0.4, 0.4, 0.4]}
    path = [{"frame": 0, "at": [0.3, 0.1], "heading": 0}]
    content["objects"] = [{"id": "A", "label": "diamond", "colour": [9, 9, 9], "parts": [part], "path": path}]
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    scene = load_scene(tmp_path)
    assert scene.objects[0].height == pytest.approx(0.4)
    corners = {(0.5, 0.1), (0.1, 0.1), (0.3, 0.3), (0.3, -0.1)}
    assert {(round(float(x), 9), round(float(y), 9)) for x, y in scene.objects[0].footprint(0)} == corners
    assert all(masks["A"][1].sum() > 300 for masks in silhouettes(scene, 0).values())


def test_shadow_of_a_new_shape_is_its_outline() -> None:
    rig, diamond = wall_rig(1), upright("octahedron", (0.5, 0.2), 0.4, 0.4)
    outline = rig.floor.polygon_mask(shadow_outline_m(rig["left"], diamond))
    shadow = shadow_mask(rig["left"], diamond, rig.floor)
    assert shadow.sum() > 200 and (outline != shadow).sum() < 0.05 * shadow.sum()


def test_an_unknown_shape_is_named_with_those_that_are_known() -> None:
    with pytest.raises(
        ValueError, match="shape: expected one of box, ellipsoid, cylinder, cone, octahedron, got 'torus'"
    ):
        upright("torus", (0.0, 0.0), 0.4, 0.4)
