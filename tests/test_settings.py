"""Every setting that is listed has a say, is reached by name, and is refused in one line where it cannot be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from occlib.explaining import Explaining
from occlib.finding import Regions
from occlib.foreground import Difference, ShadowModel
from occlib.pipeline import PROFILES, settings_for
from occlib.settings import list_settings


@pytest.mark.parametrize("profile", PROFILES)
def test_every_listed_setting_can_be_set_to_what_it_is_as_a_value_and_as_text(profile: str) -> None:
    for name, value in list_settings(PROFILES[profile]).items():
        text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        for given in (value, text):
            assert settings_for(profile, **{name: given}) == PROFILES[profile], name


def test_a_profile_lists_the_settings_of_its_own_stages_only() -> None:
    recommended, paper = list_settings(PROFILES["recommended"]), list_settings(PROFILES["paper"])
    assert {"foreground.chroma", "finder.cost", "finder.spare", "tracker.confirm_s"} <= set(recommended)
    assert {"foreground.threshold", "finder.rule", "finder.method", "finder.cell_px", "tracker.gate_m"} <= set(paper)
    assert not {"finder.rule", "foreground.threshold", "finder.core"} & set(recommended)
    assert not {"finder.cost", "foreground.chroma"} & set(paper)


def test_rule_and_threshold_choose_the_stages() -> None:
    assert isinstance(settings_for(rule="and").finder, Regions)
    assert isinstance(settings_for("paper", rule="explain").finder, Explaining)
    assert isinstance(settings_for(threshold="otsu").foreground, Difference)
    assert isinstance(settings_for("paper", threshold="evidence").foreground, ShadowModel)
    assert settings_for("and", rule="or").finder == replace(PROFILES["and"].finder, rule="or")  # type: ignore[type-var]
    assert settings_for("paper", threshold=40.0).foreground == replace(  # type: ignore[type-var]
        PROFILES["paper"].foreground, threshold=40.0
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"finder.cots": 1}, r"setting 'finder.cots': expected one of foreground\.chroma, "),
        ({"core": 1.0}, "setting 'core': expected one of "),  # no say where objects explain silhouettes
        ({"finder.cost": "much"}, "setting 'finder.cost': expected a number, got 'much'"),
        ({"finder.cost": "nan"}, "setting 'finder.cost': expected a number, got 'nan'"),
        ({"finder.max_objects": "1.5"}, "setting 'finder.max_objects': expected a whole number, got '1.5'"),
        ({"finder.spare": "1.5"}, "spare: expected a share from 0 to 1, got 1.5"),
        ({"finder.planes_m": "0,high"}, "setting 'finder.planes_m': expected numbers such as 0,0.1,0.3"),
        ({"finder.planes_m": "-1"}, "planes_m: expected metres"),
        ({"finder.planes_m": "0,nan"}, "setting 'finder.planes_m': expected numbers such as 0,0.1,0.3"),
        ({"profile": "paper", "min_area_px": 40.5}, "setting 'min_area_px': expected a whole number, got 40.5"),
        ({"finder.rim_m": "-1"}, "rim_m: expected metres"),
        ({"finder.step_px": "1e300"}, "step_px: expected px"),
        ({"foreground.steepness": "0"}, "steepness: expected a number > 0, got 0"),
        ({"foreground.darkest": "1"}, "darkest: expected"),
        ({"tracker.position_noise_m": "1e200"}, "position_noise_m: expected a finite number"),
        ({"profile": "and", "finder.join_m": "1e5"}, "join_m: expected metres"),
        ({"rule": "xor"}, "rule: expected one of and, .*, explain, got 'xor'"),
        ({"tracker.gate_m": "-1"}, "gate_m: expected a finite number > 0"),
        ({"confirm_s": "inf"}, "setting 'confirm_s': expected a number, got 'inf'"),
    ],
)
def test_what_cannot_be_set_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        settings_for(**changes)


def test_a_truth_value_is_true_or_false() -> None:
    assert settings_for("and", remove_ghosts="false").finder == replace(PROFILES["and"].finder, remove_ghosts=False)  # type: ignore[type-var]
    with pytest.raises(ValueError, match="setting 'remove_ghosts': expected true or false, got 'no'"):
        settings_for("and", remove_ghosts="no")
    assert settings_for("and", core=None) == PROFILES["and"]
