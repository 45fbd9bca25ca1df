"""A view's evidence says itself whether it is odds or a difference, and what each of its values means."""

from __future__ import annotations

import numpy as np
import pytest

from occlib.foreground import Background, Difference, Evidence, ShadowModel
from occlib.pipeline import Pipeline, settings_for
from occlib.recordings import open_recording


def test_the_meaning_of_a_value_does_not_hang_on_the_level() -> None:
    """A difference thresholded at 127, the level of soft evidence, is a difference like that at 126 or 128."""
    values = np.zeros((1, 1), np.uint8)
    surely = [int(np.argmax(Evidence(values, level, level, soft=False).weights() >= 255)) for level in (126, 127, 128)]
    assert surely == sorted(surely) and surely[2] - surely[0] <= 4 and surely[1] < 200
    assert int(np.argmax(Evidence(values, 127.5, 127, soft=True).weights() >= 255)) == 255


@pytest.mark.parametrize("soft", [True, False])
@pytest.mark.parametrize("level", [8, 30, 127])
def test_weights_rise_through_zero_at_the_level(level: int, soft: bool) -> None:
    weights = Evidence(np.zeros((1, 1), np.uint8), level, level, soft).weights()
    assert weights.shape == (256,) and weights.dtype == np.float32
    assert (np.diff(weights) >= 0).all() and (np.abs(weights) <= 255).all()
    assert (weights[: level + 1] < 0).all() and (weights[level + 1 :] > 0).all()


def test_a_mask_is_evidence_that_is_sure() -> None:
    evidence = Evidence.of_mask(np.array([[True, False]]))
    assert (evidence.values > evidence.level).tolist() == [[True, False]] and evidence.soft
    assert evidence.weights()[evidence.values].tolist() == [[255.0, -255.0]]
    assert evidence.core_level(0.5) == 127 and evidence.core_level(1.5) == 191


def test_a_rule_is_never_below_the_noise_and_a_number_is_taken_as_it_is() -> None:
    floor = np.full((20, 20, 3), 100, np.uint8)
    image = floor.copy()
    image[5:15, 5:15] = 112
    noisy = Background(floor, noise=3.0)
    assert Difference("otsu", min_level=0.0).evidence(image, noisy).level == 18
    assert Difference("otsu", min_level=40.0).evidence(image, noisy).level == 40
    assert Difference(5.0).evidence(image, noisy).level == 5
    soft = ShadowModel().evidence(image, noisy)
    assert soft.soft and soft.level == 127 and soft.core_level(1.5) == 191
    for bad, message in (
        ({"threshold": "ostu"}, "threshold: expected"),
        ({"smoothing_px": 4}, "size: expected an odd"),
    ):
        with pytest.raises(ValueError, match=message):
            Difference(**bad)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_threshold_of_127_finds_what_its_neighbours_find() -> None:
    recording = open_recording("four_robots", ["left", "right"])
    backgrounds = {name: images[0] for name, images in recording.background_images().items()}
    (_, images), *_ = recording.images([10])
    found = []
    for threshold in (126.0, 127.0, 128.0):
        settings = settings_for("and", threshold=threshold)
        found.append(Pipeline(recording.rig, backgrounds, settings).process(images, 0.0).objects)
    areas = [sum(one.area_m2 for one in objects) for objects in found]
    assert len({len(objects) for objects in found}) == 1
    assert areas[1] == pytest.approx((areas[0] + areas[2]) / 2, rel=0.05, abs=0.02)
