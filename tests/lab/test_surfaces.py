"""Floors' pictures, and light that reaches the floor."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from occlib.formats.scene import Lamp, Surface, Window
from occlib.lab.crowds import upright
from occlib.lab.lights import light_points
from occlib.lab.scenes import load_scene
from occlib.lab.surfaces import CELL_M, SURFACES, surface_texture, to_linear


@pytest.mark.parametrize("pattern", SURFACES)
def test_a_floor_has_its_colour_and_its_own_pattern(pattern: str) -> None:
    surface = Surface(pattern=pattern, colour=(150, 120, 90), roughness=0.1, ior=1.5, size=(0.4, 0.2))
    floor = surface_texture(surface, (3.0, 2.0), 0)
    assert floor.shape == (round(2 / CELL_M), round(3 / CELL_M), 3) and floor.min() >= 0 and floor.max() <= 1
    assert np.median(floor, axis=(0, 1)) == pytest.approx(to_linear((150, 120, 90)), rel=0.12)
    assert 0.01 < floor.std(axis=(0, 1)).max() / floor.mean() < 0.5
    assert np.array_equal(floor, surface_texture(surface, (3.0, 2.0), 0))


def test_grout_lies_between_ceramic_tiles() -> None:
    surface = Surface(pattern="ceramic", colour=(20, 20, 20), roughness=0.1, ior=1.5, size=(0.4, 0.2))
    floor = surface_texture(surface, (2.0, 2.0), 0).mean(axis=2)
    bright = floor > 0.15
    assert np.flatnonzero(bright.all(axis=1))[::2].tolist() == [*range(0, 400, 40)]
    assert np.flatnonzero(bright.all(axis=0))[::2].tolist() == [*range(0, 400, 80)]


def test_an_unknown_pattern_is_named_with_those_that_are_known() -> None:
    surface = Surface(pattern="grass", colour=(1, 2, 3), roughness=0.1, ior=1.5)
    with pytest.raises(ValueError, match=r"surface\.pattern: expected one of vinyl, planks, .*, got 'grass'"):
        surface_texture(surface, (1.0, 1.0), 0)


def test_light_falls_off_with_the_square_and_objects_keep_it_away() -> None:
    room = load_scene("robot").room
    assert room is not None
    lamp = Lamp(centre=(0.0, 0.0, 2.0), size=(0.02, 0.02), radiance=1e4)
    room = msgspec.structs.replace(
        room, lamps={"spot": lamp}, ceiling_light=msgspec.structs.replace(room.ceiling_light, radiance=1e-9)
    )
    lights = light_points(room)
    below, aside = lights.irradiance([[0, 0, 0], [2, 0, 0]])
    assert below == pytest.approx(1e4 * 0.02**2 / 2**2, rel=1e-3)
    assert aside == pytest.approx(below / 4, rel=1e-3)  # cos^4 45 degrees
    box = upright("box", (0.5, 0.0), 0.2, 1.0)
    shaded = lights.shaded(np.array([[0.8, 0, 0], [0.3, 0, 0], [1.5, 0, 0], [0.8, 0.8, 0]]), [box], 0)
    assert shaded.round(6).tolist() == [1, 0, 0, 0]
    low = light_points(
        msgspec.structs.replace(room, lamps={"low": msgspec.structs.replace(lamp, centre=(0.0, 0.0, 0.3))})
    )
    assert low.shaded(np.array([[-0.5, 0, 0]]), [box], 0).tolist() == [0]  # it stands beyond the lamp


def test_a_window_shines_into_the_room() -> None:
    room = load_scene("robot").room
    assert room is not None
    window = Window(centre=(-3.19, 0.0, 1.5), size=(1.0, 1.0), facing_deg=0, radiance=5.0)
    dark = msgspec.structs.replace(room.ceiling_light, radiance=1e-9)
    lit = light_points(msgspec.structs.replace(room, windows=[window], ceiling_light=dark)).irradiance
    near, far = lit([[-1.5, 0, 0], [1.5, 0, 0]])
    assert near > 3 * far > 0.01 and lit([[-3.3, 0, 0]])[0] < 1e-8
