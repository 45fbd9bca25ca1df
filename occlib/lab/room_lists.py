"""Lists of random rooms, and where their recordings are: rendered once, then kept.

``python -m occlib.lab LIST`` renders those of a list that are not there yet; ``make rooms`` calls it.
"""

from __future__ import annotations

from pathlib import Path

from occlib.lab.rendering import render
from occlib.lab.rooms import random_scene
from occlib.lab.scenes import Scene
from occlib.recordings import ROOMS, cache_folder

DEVELOPMENT = (*range(1000, 1020), *range(1100, 1104))
"""Seeds of the rooms to look at and to tune on."""

REPORTED = (*range(2000, 2030), *range(2100, 2106))
"""Seeds of the rooms that results are reported for. Nobody looks at them or tunes on them; they have no seed in common
with :data:`DEVELOPMENT`, and are drawn in the same way."""

SHIPPED = (3001, 3004, 3011, 3012, 3016, 3017, 3019, 3020, 3022, 3024, 3025, 3029)
"""Seeds of the small rooms in ``data/rooms``: 320x240, two or three cameras, one picture of the empty room."""

CROWDED = (*range(1100, 1104), *range(2100, 2106))
"""Those of :data:`DEVELOPMENT` and :data:`REPORTED` with eight objects in place of three to five."""

SOME = (*REPORTED[:8], *REPORTED[30:32])
"""What ``make rooms`` renders unless told otherwise: a quarter of the reported rooms."""

LISTS = {
    "some": SOME,
    "development": DEVELOPMENT,
    "reported": REPORTED,
    "all": (*DEVELOPMENT, *REPORTED),
    "shipped": SHIPPED,
}
"""The lists that can be rendered, by name."""

FRAMES = 6
"""Frames of the listed rooms."""

SPP = 3
"""Samples a pixel of the listed rooms, before denoising."""

SHIPPED_QUALITY = 72
"""Of the JPEG files of the shipped rooms: together they take less than 2.5 MB."""


def listed_scene(seed: int) -> Scene:
    """The room of a seed as the lists have it: four cameras, eight objects if it is :data:`CROWDED`; :data:`SHIPPED` are small."""
    if seed in SHIPPED:
        size, quality = (320, 240), SHIPPED_QUALITY
        return random_scene(seed, cameras=2 + seed % 2, frames=FRAMES, size=size, background=1, quality=quality)
    return random_scene(seed, cameras=4, objects=8 if seed in CROWDED else None, frames=FRAMES)


def listed_room(seed: int, *, progress: bool = False) -> Path:
    """The recording of a listed room: ``room_SEED`` in the cache (``OCCLIB_CACHE``), or in ``data/rooms`` if it ships.

    It is rendered if it is not there, not whole, or made by another version of the generator.

    Raises
    ------
    ValueError
        Mitsuba is missing, or the folder cannot be written.
    """
    scene = listed_scene(seed)
    folder = (ROOMS if seed in SHIPPED else cache_folder()) / scene.name
    if not is_rendered(scene, folder):
        (folder / "truth.json").unlink(missing_ok=True)
        render(scene, folder, spp=SPP, progress=progress, background_suffix=".jpg" if seed in SHIPPED else ".png")
    return folder


def is_rendered(scene: Scene, folder: Path) -> bool:
    """Whether a folder holds the whole recording of a random room: all pictures, and the room and scene that they are of."""
    if not all((folder / name).is_file() for name in ("rig.yaml", "truth.json", *scene.files)):
        return False
    counts = {"background": scene.background, "frames": scene.frames}
    return all((folder / name).read_bytes() == content for name, content in scene.files.items()) and all(
        len(list((folder / kind / name).glob("[0-9]*.*"))) == count
        for kind, count in counts.items()
        for name in scene.rig.cameras
    )
