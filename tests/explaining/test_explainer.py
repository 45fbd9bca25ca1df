"""From evidence to prisms: a view that misses an object, or says nothing at all; what is listed, and what is not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from occlib.explaining import DEFAULT, Explainer, Explaining, ExplainingFinder, Explanation
from occlib.explaining.explainer import renumbered
from occlib.explaining.mirror import mirrored_shares
from occlib.finding import FloorViews, Found, Instant
from occlib.foreground import Evidence
from occlib.foreground.background import Background
from occlib.geometry import Floor
from occlib.lab import SceneObject, Simulation, evidence_of, places_m, upright, wall_rig

FLOOR = Floor((-1.0, 1.0), (-0.8, 0.8), 0.02)


def test_with_one_view_to_spare_an_object_that_a_view_misses_is_found() -> None:
    simulation = Simulation(wall_rig(3))
    crowd = [upright("cylinder", (0.3, 0.2), 0.3, 0.4)]
    masks = simulation.masks(crowd)
    masks["left"] = np.zeros_like(masks["left"])
    evidence = evidence_of(masks)
    assert Explainer(simulation.rig).explain(evidence).prisms == []
    spared = Explaining(search=DEFAULT._replace(spare=0.34))
    (found,) = Explainer(simulation.rig, spared).explain(evidence).prisms
    assert np.hypot(*(np.array([found.x, found.y]) - places_m(crowd)[0])) < 0.05


def test_a_camera_without_evidence_says_nothing() -> None:
    simulation = Simulation(wall_rig(3))
    crowd = [upright("cylinder", (0.3, 0.2), 0.3, 0.4)]
    evidence = {name: Evidence.of_mask(mask) for name, mask in simulation.masks(crowd).items() if name != "left"}
    explainer = Explainer(simulation.rig)
    polar = explainer.polar(evidence)
    silent = list(simulation.rig.cameras).index("left")
    assert not polar.seen[silent].any() and not polar.weights[silent].any()
    assert len(explainer.explain(evidence).prisms) == 1
    assert explainer.explain(evidence, polar=polar) == explainer.explain(evidence)
    assert explainer.explain({}) == Explanation([])


def test_a_large_picture_is_not_sampled_finer_and_is_explained_as_well() -> None:
    crowd = [upright("box", (0.3, 0.2), (0.4, 0.3), 0.3, heading=20.0), upright("cylinder", (-0.5, -0.2), 0.3, 0.4)]
    found, samples = [], []
    for size in ((1280, 960), (2560, 1920)):
        simulation = Simulation(wall_rig(2, size=size))
        explainer = Explainer(simulation.rig)
        samples.append(explainer.warps["left"].shape)
        found.append(explainer.explain(evidence_of(simulation.masks(crowd))).prisms)
    assert np.prod(samples[1]) < 1.2 * np.prod(samples[0])
    for prisms in found:
        assert len(prisms) == 2
        places = np.array([prism[:2] for prism in prisms])
        assert np.linalg.norm(places[:, None] - places_m(crowd), axis=2).min(axis=0).max() < 0.04


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"step_px": 0.0}, "step_px"), ({"planes_m": ()}, "planes_m"), ({"dark_level": 120.0}, "dark_level")],
)
def test_wrong_settings_are_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Explaining(**settings)  # type: ignore[arg-type]


def test_a_wrong_setting_of_the_search_is_named() -> None:
    simulation = Simulation(wall_rig(2))
    evidence = evidence_of(simulation.masks([upright("cylinder", (0.3, 0.2), 0.3, 0.4)]))
    with pytest.raises(ValueError, match="spare: expected"):
        Explainer(simulation.rig, Explaining(search=DEFAULT._replace(spare=-1))).explain(evidence)


# --- what is listed --------------------------------------------------------------------------------------------
class Room:
    """A finder on a small floor between two cameras, and what it finds of a crowd."""

    def __init__(self) -> None:
        rig = wall_rig(2, floor=FLOOR)
        self.simulation, self.floor_views = Simulation(rig), FloorViews(rig)
        self.empty = {name: np.full((*camera.size[::-1], 3), 120, np.uint8) for name, camera in rig.cameras.items()}
        backgrounds = {name: Background(image) for name, image in self.empty.items()}
        self.finder = ExplainingFinder(self.floor_views, Explaining(), backgrounds, {})

    def find(self, crowd: Sequence[SceneObject]) -> Found:
        evidence = evidence_of(self.simulation.masks(crowd))
        on_floor = {name: self.floor_views.warps[name].warp(one.values) for name, one in evidence.items()}
        return self.finder.find(Instant(self.empty, evidence, on_floor))


def test_what_stands_beyond_the_floor_explains_but_is_not_listed() -> None:
    """It hides the small one from the right camera, and nobody is named as the one that hides it."""
    room = Room()
    inside, outside = upright("cylinder", (0.75, 0.1), 0.2, 0.15), upright("cylinder", (1.25, 0.1), 0.4, 0.6)
    alone = room.find([outside])
    assert alone.observations == [] and not alone.labels.any() and alone.hidden.shape == (0, 2)
    assert room.finder.explanation is not None and len(room.finder.explanation.prisms) == 1
    for _ in range(2):
        both = room.find([inside, outside])
        assert len(room.finder.explanation.prisms) == 2
        (listed,) = both.observations
        assert np.hypot(*(np.array(listed.position_m) - [0.75, 0.1])) < 0.06
        assert set(np.unique(both.labels)) == {0, 1}
        assert both.hidden.shape == both.hidden_by.shape == (1, 2)
        assert both.hidden[0, 1] > 0.5 and both.hidden[0, 0] == 0
        assert (both.hidden_by == -1).all()


def test_those_that_are_listed_hide_each_other_by_their_number_in_the_list() -> None:
    room = Room()
    crowd = [
        upright("cylinder", (1.2, -0.5), 0.5, 0.7),  # explains most, and stands beyond the floor
        upright("cylinder", (-0.3, 0.05), 0.4, 0.7),
        upright("cylinder", (0.35, 0.05), 0.25, 0.3),
    ]
    room.find(crowd)  # the small one may be found at the second instant only
    found = room.find(crowd)
    assert room.finder.explanation is not None and len(room.finder.explanation.prisms) == 3
    tall, low = np.argsort([one.position_m[0] for one in found.observations])
    assert found.hidden_by[low, 0] == tall and found.hidden[low, 0] > 0.5
    assert found.hidden_by[tall, 0] == -1
    labels = {found.labels[FLOOR.shape[0] // 2 + 3, round((x + 1) / 0.02)] for x in (-0.3, 0.35)}
    assert labels == {1, 2}


def test_the_gloss_is_learnt_from_the_first_instants() -> None:
    room = Room()
    crowd = [upright("cylinder", (0.3, 0.1), 0.4, 0.3)]
    room.find(crowd)
    assert room.finder.gloss == pytest.approx([0, 0], abs=0.02)  # the floor mirrors nothing
    polar = room.finder.explainer.polar(evidence_of(room.simulation.masks(crowd)))
    shiny = type(polar)(polar.views, polar.sizes, np.where(polar.seen, 128, 0).astype(np.int32), polar.seen)
    assert room.finder.explanation is not None
    shares = mirrored_shares(shiny, room.finder.explanation.prisms)
    np.testing.assert_allclose(shares, 128 / 255, atol=1e-6)
    before = list(room.finder.gloss)
    for _ in range(30):
        room.finder._learn_gloss(shiny, room.finder.explanation.prisms)
    np.testing.assert_allclose(room.finder.gloss, 128 / 255, atol=0.01)
    room.finder._learn_gloss(shiny, [])  # nothing stands there, nothing is learnt
    assert room.finder.gloss[0] > before[0]
    np.testing.assert_allclose(room.finder.gloss, 128 / 255, atol=0.01)


def test_indices_follow_what_is_kept() -> None:
    kept = np.array([True, False, True, True])
    by = np.array([[0, -1], [1, 3], [2, 0], [-1, 1]])
    assert renumbered(by, kept).tolist() == [[0, -1], [-1, 2], [1, 0], [-1, -1]]
    assert renumbered(np.full((0, 2), -1), np.zeros(0, bool)).shape == (0, 2)
    assert renumbered(np.array([[0, -1]]), np.zeros(1, bool)).tolist() == [[-1, -1]]
