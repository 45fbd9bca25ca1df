"""How much two views disagree about the colour of what AND claims: what it takes to tell a ghost from an object."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, permutations
from typing import Any

import numpy as np

from occlib.base.arrays import Image, Mask
from occlib.explaining import axis_colours, colour_agreement
from occlib.formats import TrueObject, load_truth
from occlib.geometry import Rig, apply_homography
from occlib.lab.ghosts import LEAST_AREA_M2
from occlib.lab.scenes import load_scene
from occlib.lab.truth import silhouettes
from occlib.localization import find_regions
from occlib.recordings import open_recording
from occlib.registration import FloorWarp


def colour_study(recording: str, frames: Iterable[int], *, height: float = 0.05) -> list[dict[str, Any]]:
    """How much two views disagree at what AND claims in a recording of the lab, for every pair of its cameras.

    The masks are the scene's ideal silhouettes, the colours those of the pictures. Few frames hold a ghost. But a ghost
    shows one object to one camera and another object to the other, so for each two objects in plain view the distance
    between the colour of the one in one view and of the other in the other view is what a ghost of theirs would show.

    Parameters
    ----------
    recording
        Name of a rendered recording, such as ``"four_robots"``.
    frames
        Which of its frames.
    height
        Up to which a candidate's colour is looked at in m: no higher than the lowest object.

    Returns
    -------
    list of dict
        Rows with the keys ``frame``, ``cameras``, ``kind``, ``object``, ``x`` and ``y`` (m) and ``disagreement`` (grey
        levels). The kinds are "real, in plain view", "real, partly hidden" (more than a tenth from one of the two
        cameras), "ghost" and "ghost to be".
    """
    source, scene = open_recording(recording), load_scene(recording)
    rig, floor = source.rig, source.rig.floor
    warps = {name: FloorWarp(camera, floor) for name, camera in rig.cameras.items()}
    truth, rows = load_truth(source.path / "truth.json").frames, []
    for frame, images in source.images(sorted(set(frames))):
        seen = silhouettes(scene, frame)
        views = {name: warps[name].warp(np.any([m for m, _ in seen[name].values()], axis=0)) for name in rig.cameras}
        for pair in combinations(rig.cameras, 2):
            pictures = {name: images[name] for name in pair}
            for kind, name, (x, y), value in [
                *_claimed(views, pair, pictures, truth[frame], rig, height),
                *_ghosts_to_be(pair, pictures, truth[frame], rig),
            ]:
                row = {"frame": frame, "cameras": " + ".join(pair), "kind": kind, "object": name}
                rows.append({**row, "x": x, "y": y, "disagreement": value})
    return rows


def _plain(true: TrueObject, camera: str) -> bool:
    return true.hidden_fraction.get(camera, 1.0) < 0.1


def _claimed(
    views: Mapping[str, Mask],
    pair: tuple[str, str],
    pictures: Mapping[str, Image],
    truth: Sequence[TrueObject],
    rig: Rig,
    height: float,
) -> list[tuple[str, str, tuple[float, float], float]]:
    """Regions of the AND: kind, objects, place and disagreement."""
    floor = rig.floor
    labels, regions = find_regions(views[pair[0]] & views[pair[1]], min_area=LEAST_AREA_M2 / floor.cell_area)
    owners: dict[int, list[TrueObject]] = {region.label: [] for region in regions}
    for true in truth:
        for label in set(labels[floor.polygon_mask(true.footprint or ())].tolist()) - {0}:
            owners[label].append(true)
    places = apply_homography(floor.cell_to_floor, [region.centroid for region in regions])
    found = colour_agreement(places, height, pictures, rig)
    kinds = [
        "ghost"
        if not owners[region.label]
        else "real, in plain view"
        if all(_plain(true, name) for true in owners[region.label] for name in pair)
        else "real, partly hidden"
        for region in regions
    ]
    ids = [" + ".join(str(true.id) for true in owners[region.label]) for region in regions]
    return [
        (kind, name, (float(x), float(y)), float(d))
        for kind, name, (x, y), d in zip(kinds, ids, places, found, strict=True)
    ]


def _ghosts_to_be(
    pair: tuple[str, str], pictures: Mapping[str, Image], truth: Sequence[TrueObject], rig: Rig
) -> list[tuple[str, str, tuple[float, float], float]]:
    """Colour of one object in one view against that of another object in the other view."""
    colours = axis_colours([[t.x, t.y] for t in truth], [t.height or 0.0 for t in truth], pictures, rig)
    return [
        ("ghost to be", "", (np.nan, np.nan), float(np.linalg.norm(colours[0, i] - colours[1, j])))
        for i, j in permutations(range(len(truth)), 2)
        if _plain(truth[i], pair[0]) and _plain(truth[j], pair[1])
    ]
