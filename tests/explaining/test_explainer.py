"""From evidence to cylinders: with a view that misses an object, or says nothing at all."""

from __future__ import annotations

import numpy as np
import pytest

from occlib.explaining import Explainer, Explaining
from occlib.foreground import Evidence
from occlib.lab import Simulation, places_m, upright, wall_rig


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
