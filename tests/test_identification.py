"""The paper's identification: planted pictures are found where they are, labelled once, measured by the table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from occlib.foreground import Evidence
from occlib.identification import (
    MARGIN_PX,
    Identified,
    Identifier,
    IdentifierSettings,
    Sighting,
    Template,
    _settled,
    cut_templates,
    identify,
    opaque_part,
    read_templates,
)
from occlib.localization import scale_table
from occlib.pipeline import Pipeline, backgrounds_of, settings_for
from occlib.recordings import open_recording


def picture(*patches: tuple[int, int, np.ndarray]) -> np.ndarray:
    """A black image (90, 120) with patches at (x, y)."""
    image = np.zeros((90, 120), np.uint8)
    for x, y, patch in patches:
        image[y : y + patch.shape[0], x : x + patch.shape[1]] = patch
    return image


STRIPES = np.tile(np.array([[200], [90]], np.uint8), (8, 14))
CHECKS = np.kron(np.indices((4, 4)).sum(axis=0) % 2, np.ones((4, 4))).astype(np.uint8) * 120 + 80
TEMPLATES = [Template("stripes", np.pad(STRIPES, 3)), Template("checks", np.pad(CHECKS, 3))]


def test_planted_objects_are_found_labelled_and_measured() -> None:
    image = picture((20, 30, STRIPES), (80, 50, CHECKS))
    seen = identify(image, image > 40, TEMPLATES)
    assert {one.label: (one.match.x + 3, one.match.y + 3) for one in seen} == {"stripes": (20, 30), "checks": (80, 50)}
    assert all(one.match.score == 0 for one in seen)
    by_label = {one.label: one for one in seen}
    assert by_label["stripes"].region.area == STRIPES.size == by_label["stripes"].pixels.sum()
    assert by_label["checks"].region.centroid == (87.5, 57.5)


def test_a_template_labels_one_object_and_the_most_similar_wins() -> None:
    faded = (CHECKS * 0.7).astype(np.uint8)
    image = picture((20, 30, faded), (80, 50, CHECKS))
    (seen,) = identify(image, image > 40, TEMPLATES[1:])
    assert seen.match.x + 3 == 80
    assert identify(image, np.zeros(image.shape, bool), TEMPLATES) == []  # nothing in the foreground is no object
    assert identify(image, image > 40, []) == []
    large = Template("large", np.zeros((91, 5), np.uint8))
    assert [one.label for one in identify(image, image > 40, [large, TEMPLATES[1]])] == ["checks"]


def test_objects_that_touch_are_told_apart_by_what_their_templates_cover() -> None:
    image = picture((20, 30, STRIPES), (34, 30, CHECKS))
    seen = {one.label: one for one in identify(image, image > 40, TEMPLATES)}
    assert set(seen) == {"stripes", "checks"}
    assert not (seen["stripes"].pixels & seen["checks"].pixels)[:, 40:].any()
    assert seen["stripes"].region.area < (image > 40).sum()


def test_templates_are_cut_where_an_object_stands_apart() -> None:
    image = picture((20, 30, STRIPES), (80, 50, CHECKS))
    labels = np.zeros((3, 4), np.int32)
    labels[0, :2], labels[2, 3] = 1, 2
    cells = np.full((3, 4, 2), np.nan)
    cells[0, 0], cells[0, 1], cells[2, 3] = (25, 35), (24, 36), (85, 55)
    names = {1: "object 1", 2: "object 2"}
    cut = cut_templates(image, image > 40, cells, labels, names, min_area_px=40)
    assert [one.label for one in cut] == ["object 1", "object 2"]
    assert cut[0].picture.shape == (16 + 2 * MARGIN_PX, 14 + 2 * MARGIN_PX)
    np.testing.assert_array_equal(cut[0].picture[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX], STRIPES)
    (named,) = cut_templates(image, image > 40, cells, labels, {2: "cup"}, min_area_px=40)
    assert named.label == "cup"
    cells[2, 3] = (26, 36)  # the second object now lies behind the first
    assert cut_templates(image, image > 40, cells, labels, names, min_area_px=40) == []


def test_no_label_twice_and_sizes_are_means() -> None:
    claims = {0: [(5.0, "a", 0.2), (9.0, "b", 0.4)], 1: [(6.0, "a", np.nan)], 2: [(7.0, "c", 0.1)]}
    assert _settled(claims) == {0: Identified("a", pytest.approx(0.2)), 2: Identified("c", pytest.approx(0.1))}


def test_the_paper_profile_labels_the_robots_and_measures_them_by_the_table() -> None:
    recording = open_recording("robot")
    pipeline = Pipeline(recording.rig, backgrounds_of(recording), settings_for("paper"))
    seen: list[list[Sighting]] = []
    identifier = pipeline.finder.identifier
    assert isinstance(identifier, Identifier)
    for frame, images in recording.images(recording.frames[:3]):
        (robot,) = pipeline.process(images, recording.time(frame)).objects
        evidence = {
            name: pipeline.settings.foreground.evidence(images[name], pipeline.backgrounds[name]) for name in images
        }
        seen = [identifier.sightings(images[name], evidence[name], name) for name in images]
        sizes = [
            one.region.area * scale_table(recording.rig[name]).lookup([one.region.centroid])[0]
            for name, view in zip(images, seen, strict=True)
            for one in view
        ]
        assert robot.label == "object 1" and robot.size_m2 == pytest.approx(np.mean(sizes))
        assert robot.to_dict()["size"] == round(float(np.mean(sizes)), 4)
    assert [len(view) for view in seen] == [1] * len(seen)


@pytest.mark.slow
def test_given_pictures_name_the_objects(tmp_path: Path) -> None:
    recording = open_recording("robot", ["left", "right"])
    backgrounds = backgrounds_of(recording)
    first, *_ = recording.images()
    scout = Pipeline(recording.rig, backgrounds, settings_for("paper"))
    scout.process(first[1], 0.0)
    template = scout.finder.identifier.templates["left"][0]
    difference = scout.settings.foreground.evidence(first[1]["left"], scout.backgrounds["left"]).values
    y, x = np.argwhere(
        (np.lib.stride_tricks.sliding_window_view(difference, template.picture.shape) == template.picture).all(
            axis=(2, 3)
        )
    )[0]
    height, width = template.picture.shape
    colours = first[1]["left"][y : y + height, x : x + width]
    opaque = np.where(template.picture > 30, np.uint8(255), np.uint8(0))
    cv2.imwrite(str(tmp_path / "rover.png"), cv2.cvtColor(np.dstack([colours, opaque]), cv2.COLOR_RGBA2BGRA))
    known = Pipeline(recording.rig, backgrounds, settings_for("paper"), read_templates(tmp_path))
    (robot,) = known.process(first[1], 0.0).objects
    assert robot.label == "rover" and robot.size_m2 is not None


def test_bad_templates_and_settings_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"templates\['x'\]: expected uint8 RGB or RGBA"):
        opaque_part("x", np.zeros((9, 9), np.uint8))
    with pytest.raises(ValueError, match="expected pixels that are more opaque than not"):
        opaque_part("x", np.zeros((9, 9, 4), np.uint8))
    with pytest.raises(ValueError, match=r"expected pictures named LABEL.png, found none"):
        read_templates(tmp_path)
    with pytest.raises(ValueError, match="limit: expected a score, default, otsu or mad, got 'half'"):
        IdentifierSettings(limit="half")
    with pytest.raises(ValueError, match="optima: expected one of components, nms, got 'best'"):
        IdentifierSettings(optima="best")


def test_a_sighting_outside_the_map_names_nothing() -> None:
    """An identified region none of whose pixels any cell of the map shows is left out."""
    recording = open_recording("robot", ["left", "right"])
    identifier = Identifier(
        {name: np.full((2, 2, 2), np.nan) for name in recording.rig.cameras},
        recording.rig,
        backgrounds_of(recording),
        IdentifierSettings(),
        {"x": np.full((9, 9, 3), 200, np.uint8)},
    )
    image = np.zeros((480, 640, 3), np.uint8)
    image[100:140, 100:140] = 200
    evidence = {"left": Evidence.of_mask(image[..., 0] > 0)}
    assert identifier.identify({"left": image}, evidence, np.ones((2, 2), np.int32)) == {}


@pytest.mark.parametrize("method", ["ssd", "sad", "ncc", "zncc"])
def test_the_most_similar_template_wins_whichever_way_the_measure_counts(method: str) -> None:
    image = picture((80, 50, CHECKS))
    noise = np.random.default_rng(0).integers(-60, 61, CHECKS.shape)
    noisy = np.pad(np.clip(CHECKS.astype(int) + noise, 41, 255).astype(np.uint8), 3)
    both = [Template("noisy", noisy), TEMPLATES[1]]
    (seen,) = identify(image, image > 40, both, IdentifierSettings(method=method, limit="default"))
    assert seen.label == "checks"


def test_a_camera_that_drops_out_at_first_gets_its_templates_later() -> None:
    recording = open_recording("four_robots", ["left", "right", "front"])
    pipeline = Pipeline(recording.rig, backgrounds_of(recording), settings_for("paper"))
    identifier = pipeline.finder.identifier
    assert isinstance(identifier, Identifier)
    for frame, images in recording.images(recording.frames[:2]):
        shown = {**images, "front": None} if frame == recording.frames[0] else images
        objects = pipeline.process(shown, recording.time(frame)).objects
        assert ("front" in identifier.templates) == (frame != recording.frames[0])
    labels = {one.label for one in objects}
    assert labels == {f"object {k}" for k in range(1, 5)}
    assert {template.label for template in identifier.templates["front"]} <= labels


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"method": "foo"}, "method: expected one of ssd, "),
        ({"limit": float("nan")}, "limit: expected a score, got nan"),
        ({"cell_px": 0}, "cell_px: expected"),
        ({"min_area_px": 0}, "min_area_px: expected"),
    ],
)
def test_settings_that_cannot_work_are_named(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        IdentifierSettings(**wrong)
