"""From evidence to cylinders and footprints: outside the map, near its rim, and with a view that misses an object."""

from __future__ import annotations

import numpy as np
import pytest

from occlib.explaining import Cylinder, Explainer, Explaining, footprints
from occlib.foreground import Evidence
from occlib.geometry import Floor
from occlib.lab import Simulation, places_m, upright, wall_rig


@pytest.mark.parametrize("x, y", [(-0.3, 0.5), (1.2, 0.5), (0.5, -0.4), (0.5, 1.3), (9.0, 9.0)])
def test_a_cylinder_outside_the_map_has_no_cells_and_disturbs_no_other(x: float, y: float) -> None:
    floor = Floor((0, 1), (0, 1), 0.05)
    inside = Cylinder(0.5, 0.5, 0.1, 0.3)
    alone = footprints([inside], np.zeros(floor.shape, bool), floor)
    both = footprints([inside, Cylinder(x, y, 0.15, 0.3)], np.zeros(floor.shape, bool), floor)
    np.testing.assert_array_equal(both == 1, alone == 1)
    assert (alone == 1).sum() * floor.cell_area == pytest.approx(np.pi * 0.1**2, rel=0.15)


def test_with_one_view_to_spare_an_object_that_a_view_misses_is_found() -> None:
    simulation = Simulation(wall_rig(3))
    crowd = [upright("cylinder", (0.3, 0.2), 0.3, 0.4)]
    masks = simulation.masks(crowd)
    masks["left"] = np.zeros_like(masks["left"])
    evidence = {name: Evidence.of_mask(mask) for name, mask in masks.items()}
    assert Explainer(simulation.rig).explain(evidence) == []
    (found,) = Explainer(simulation.rig, Explaining(spare=1)).explain(evidence)
    assert np.hypot(*(np.array([found.x, found.y]) - places_m(crowd)[0])) < 0.05


def test_a_camera_without_evidence_says_nothing() -> None:
    simulation = Simulation(wall_rig(3))
    crowd = [upright("cylinder", (0.3, 0.2), 0.3, 0.4)]
    evidence = {name: Evidence.of_mask(mask) for name, mask in simulation.masks(crowd).items() if name != "left"}
    explainer = Explainer(simulation.rig)
    polar = explainer.polar(evidence)
    silent = list(simulation.rig.cameras).index("left")
    assert not polar.seen[silent].any() and not polar.weights[silent].any()
    assert len(explainer.explain(evidence)) == 1 and explainer.explain({}) == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step_px": 0.0}, "step_px"),
        ({"planes_m": ()}, "planes_m"),
        ({"spare": -1}, "spare"),
        ({"dark_level": 120.0}, "dark_level"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Explaining(**settings)  # type: ignore[arg-type]
