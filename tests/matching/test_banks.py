"""Turned and scaled templates, and the search from coarse to fine: planted objects, and the full search."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage import data

from occlib.matching import banks
from occlib.matching.banks import Bank, warps
from occlib.matching.measures import METHODS
from occlib.matching.search import Match, default_threshold, find, similarity

Array = npt.NDArray[Any]
LAB = Path(__file__).parents[2] / "data/lab/robot/frames"
every_method = pytest.mark.parametrize("method", METHODS)
COARSE = [name for name, method in METHODS.items() if method.coarse_to_fine]
coarse_method = pytest.mark.parametrize("method", COARSE)


def scene(shape: tuple[int, ...] = (90, 120), seed: int = 0) -> Array:
    """A textured but not periodic uint8 picture, smooth enough to have edges."""
    coarse = np.random.default_rng(seed).integers(20, 236, (shape[0] // 6 + 1, shape[1] // 6 + 1, *shape[2:]))
    return np.kron(coarse, np.ones((6, 6) + (1,) * (len(shape) - 2), int))[: shape[0], : shape[1]].astype(np.uint8)


def thing(x: Any, y: Any) -> Array:
    """Grey values of a smooth object about the origin, without symmetry, 18 px in radius; (x, y) in px, y down."""
    inside = np.clip((18 - np.hypot(x, y)) / 3, 0, 1)
    inner = 60 * np.sin(x / 4) + 50 * np.cos(y / 5 + 0.5) + 3 * x
    return np.asarray(110 + inside * inner)


def picture_of(shape: tuple[int, int], centre: tuple[float, float], angle: float = 0.0, scale: float = 1.0) -> Array:
    """The object with its centre (x, y), turned by degrees counter-clockwise as seen, scaled: exactly resampled."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    x, y = (x - centre[0]) / scale, (y - centre[1]) / scale
    cosine, sine = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    return np.rint(thing(cosine * x - sine * y, sine * x + cosine * y)).clip(0, 255).astype(np.uint8)


# ---------------------------------------------------------------- the warped templates


@pytest.mark.parametrize("size", [(7, 10), (8, 5), (6, 6), (9, 9), (3, 5)])
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_quarter_turns_are_exact_and_counter_clockwise(size: tuple[int, int], turns: int) -> None:
    """``np.rot90`` turns counter-clockwise as one sees the picture. The canvas keeps the parity of the template's."""
    template: Array = np.random.default_rng(1).integers(0, 256, (*size, 1)).astype(np.uint8)
    (warp,) = warps(template, np.ones(size, bool), (40, 40), [90 * turns], [1])
    expected = np.rot90(template, turns)
    assert warp.angle == 90 * turns and warp.scale == 1 and warp.mask.dtype == bool
    assert [a % 2 for a in warp.mask.shape] == [a % 2 for a in size]
    if sum(size) % 2 == 0:  # else the turned pixels' centres fall between the canvas's
        inside = tuple(
            slice((a - b) // 2, (a + b) // 2) for a, b in zip(warp.mask.shape, expected.shape[:2], strict=True)
        )
        np.testing.assert_array_equal(warp.template[inside], expected)
        assert warp.mask[inside].all() and warp.mask.sum() == warp.mask[inside].size


def test_the_template_itself_is_not_resampled() -> None:
    template, mask = scene((8, 9, 3)), np.ones((8, 9), bool)
    for angle in (0, 360, -720):
        (warp,) = warps(template, mask, (20, 20), [angle], [1.0])
        assert warp.template is template and warp.mask is mask and warp.angle == angle


@pytest.mark.parametrize("size", [(20, 30), (21, 30), (15, 15)])
@pytest.mark.parametrize("angle, scale", [(45, 1.0), (30, 0.7), (-60, 1.6), (10, 0.1), (0, 2.0), (0, 0.5)])
def test_the_canvas_just_holds_the_warped_template(size: tuple[int, int], angle: float, scale: float) -> None:
    template = np.full((*size, 1), 100.0)
    (warp,) = warps(template, np.ones(size, bool), (200, 200), [angle], [scale])
    c, s = abs(np.cos(np.deg2rad(angle))) * scale, abs(np.sin(np.deg2rad(angle))) * scale
    needed = s * size[1] + c * size[0], c * size[1] + s * size[0]
    for got, least, before in zip(warp.mask.shape, needed, size, strict=True):
        assert least - 1e-6 <= got < least + 2 + 1e-6 and got % 2 == before % 2
    assert warp.mask[(warp.mask.shape[0] - 1) // 2, (warp.mask.shape[1] - 1) // 2]
    assert warp.mask.sum() <= size[0] * size[1] * scale**2 + 1
    if scale > 0.5:  # what is only partly covered, a rim of about half a px, does not count
        assert warp.mask.sum() >= (size[0] * scale - 2) * (size[1] * scale - 2)
    if angle in (45, 30):
        assert not warp.mask[0, 0] and not warp.mask[-1, -1]
    np.testing.assert_allclose(warp.template[warp.mask], 100, atol=1e-9)


def test_shrinking_smooths_fine_detail_away() -> None:
    """A checkerboard of single px is grey from afar, not a coarser checkerboard."""
    board = (np.indices((32, 32)).sum(axis=0) % 2 * 255).astype(np.uint8)[:, :, None]
    (warp,) = warps(board, np.ones((32, 32), bool), (40, 40), [0], [0.3])
    assert np.ptp(warp.template[warp.mask]) < 20 and abs(warp.template[warp.mask].mean() - 127.5) < 5


def test_weights_are_warped_and_hidden_pixels_leak_into_none_that_counts() -> None:
    template, weights = np.full((20, 20, 1), 50.0), np.full((20, 20), 0.5)
    weights[:, 10:] = 1
    weights[:, :5] = 0
    template[:, :5] = 1e30
    (warp,) = warps(template, weights, (60, 60), [30], [1])
    assert warp.mask.dtype == np.float64 and set(np.unique(warp.mask.round(3))) >= {0.0, 0.5, 1.0}
    assert warp.mask.min() == 0 and warp.mask.max() <= 1 + 1e-12
    np.testing.assert_allclose(warp.template[warp.mask > 0], 50)
    (warp,) = warps(template, weights > 0, (60, 60), [30], [1])
    np.testing.assert_allclose(warp.template[warp.mask], 50)


def test_what_does_not_fit_is_left_out() -> None:
    template, mask = scene((30, 10, 1)), np.ones((30, 10), bool)
    found = warps(template, mask, (32, 20), [0, 90, 180], [1, 0.5, 3])
    assert [(warp.angle, warp.scale) for warp in found] == [(0, 1), (0, 0.5), (90, 0.5), (180, 1), (180, 0.5)]
    image = np.full((32, 20), 128, np.uint8)
    image[1:31, 4:14] = template[:, :, 0]
    for method in METHODS:
        bank = find(image, template, method, angles=(0, 90))
        assert bank == find(image, template, method) and (bank[0].x, bank[0].y) == (4, 1)


# ---------------------------------------------------------------- turned and scaled objects


@pytest.mark.slow
@every_method
@pytest.mark.parametrize("size", [(45, 45), (46, 46), (45, 46)])
@pytest.mark.parametrize("angle, scale", [(0, 1), (30, 1), (-75, 1), (120, 0.75), (45, 1.25), (0, 1.25), (0, 0.75)])
def test_a_planted_object_is_found_with_its_angle_scale_and_centre(
    method: str, size: tuple[int, int], angle: float, scale: float
) -> None:
    template = picture_of(size, ((size[1] - 1) / 2, (size[0] - 1) / 2))
    centre = 61.5 - size[1] % 2 / 2, 44.5 - size[0] % 2 / 2
    image = picture_of((96, 130), centre, angle, scale)
    found = find(image, template, method, angles=range(-165, 181, 15) if angle else (0,), scales=(0.75, 1, 1.25))
    best = found[0]
    assert (best.angle, best.scale) == (angle, scale)
    assert np.hypot(*np.subtract(best.centre_px, centre)) < 0.5 + 0.25 * (method == "sed")
    assert (best.width, best.height) == (size[1] * scale, size[0] * scale)
    if method in ("ssd", "zncc"):
        fine = find(image, template, method, angles=[angle], scales=[scale], subpixel=True)[0]
        assert np.hypot(*np.subtract(fine.centre_px, centre)) < 0.15


@every_method
@pytest.mark.parametrize("size", [(24, 31), (25, 31), (24, 30), (21, 21)])
def test_two_headings_of_one_object(method: str, size: tuple[int, int]) -> None:
    """Centres to half a px where the parity of a quarter turn does not fit the grid, else exact."""
    template = np.pad(scene((size[0] - 8, size[1] - 8), 3), 4, constant_values=128)
    image = np.full((90, 130), 128, np.uint8)
    image[10 : 10 + size[0], 12 : 12 + size[1]] = template
    turned = np.rot90(template)
    image[50 : 50 + size[1], 80 : 80 + size[0]] = turned
    upright, left = find(image, template, method, angles=(0, 90), max_count=2)
    assert (upright.angle, upright.x, upright.y) == (0, 12, 10)
    assert upright.score == (1 if METHODS[method].higher_is_better else 0)
    exact = sum(size) % 2 == 0
    assert left.angle == 90
    middle = 80 + (size[0] - 1) / 2, 50 + (size[1] - 1) / 2
    assert np.abs(np.subtract(left.centre_px, middle)).max() <= (0 if exact else 0.5)
    if exact:
        corners = {tuple(corner) for corner in left.corners_px.round(6)}
        x, y = 79.5, 49.5
        assert corners == {(x, y), (x + size[0], y), (x, y + size[1]), (x + size[0], y + size[1])}
        np.testing.assert_allclose(left.corners_px[0], (x, y + size[1]))  # the top-left one went down


@pytest.mark.slow
@every_method
def test_the_template_as_it_is_scores_in_a_bank_as_alone(method: str) -> None:
    for image, template in [(scene(), scene()[20:45, 30:62]), (scene() / 255, scene()[20:45, 30:62] / 255)]:
        alone = similarity(image, template, method)
        measure, mask = METHODS[method], np.ones(template.shape, bool)
        bank = Bank.of(measure, image[:, :, None], warps(template[:, :, None], mask, image.shape, (0, 90), [1]))
        cost, which = bank.cost()
        y, x = (a // 2 - b for a, b in zip((25 - 1, 32 - 1), bank.first_centre, strict=True))
        part = np.s_[y : y + alone.shape[0], x : x + alone.shape[1]]
        score = -cost[part] if measure.higher_is_better else cost[part]
        own = which[part] == 0
        np.testing.assert_array_equal(score[own], alone[own])
        assert own.any() and (score >= alone if measure.higher_is_better else score <= alone).all()
        assert np.isinf(cost).any() == (cost.shape != alone.shape)  # corners that no template reaches
        plain = find(image, template, method)
        assert find(image, template, method, angles=[0], scales=[1]) == plain
        assert find(image, template, method, angles=0, scales=1) == plain  # type: ignore[arg-type]


def test_of_equal_templates_the_first_counts() -> None:
    image = scene()
    for pyramid in (0, 2):
        found = find(image, image[20:45, 30:55], "ssd", angles=(360, 0), pyramid=pyramid)
        assert found[0] == Match(30, 20, 0.0, 25, 25, 360, 1)
    template, mask = image[20:45, 30:55, None], np.ones((25, 25), bool)
    bank = Bank.of(METHODS["ssd"], image[:, :, None], warps(template, mask, image.shape, (360, 0), [1]))
    cost, which = np.full((66, 96), np.inf), np.zeros((66, 96), np.intp)
    for number in (1, 0):  # whichever is computed first
        bank._lay_over(cost, which, number)
        assert (which == number).all()


@pytest.mark.slow
@every_method
def test_masks_turn_with_the_template(method: str) -> None:
    """What is hidden is different in the image, and the object is still found."""
    template = picture_of((45, 45), (22, 22))
    image = picture_of((90, 120), (50, 40), 60)
    y, x = np.mgrid[:45, :45] - 22
    mask = (np.hypot(x, y) < 20) & ~((np.abs(x) < 5) & (y > 6))
    cosine, sine = np.cos(np.deg2rad(60)), np.sin(np.deg2rad(60))
    y, x = np.mgrid[:90, :120] - np.array([40, 50])[:, None, None]
    u, v = cosine * x - sine * y, sine * x + cosine * y
    image[(np.abs(u) < 4) & (v > 8) & (v < 18)] = 255
    for used in (mask, mask * 0.7 + 0.0, mask * np.linspace(0.5, 1, 45)):
        best = find(image, template, method, angles=range(0, 360, 20), mask=used)[0]
        assert best.angle == 60 and np.hypot(*np.subtract(best.centre_px, (50, 40))) < 1
        without = find(image, template, method, angles=[60], threshold=-1 if METHODS[method].higher_is_better else 1e9)
        better = best.score > without[0].score if METHODS[method].higher_is_better else best.score < without[0].score
        assert better or method == "sed"


# ---------------------------------------------------------------- from coarse to fine


def assert_same(image: Array, template: Array, method: str, *, exact: bool = True, **options: Any) -> list[Match]:
    full = find(image, template, method, **options)
    for pyramid in (1, 2, 3):
        found = find(image, template, method, pyramid=pyramid, **options)
        if exact:
            assert found == full
        else:  # sums of floats round differently over the whole image and over a part
            assert len(found) == len(full)
            for a, b in zip(found, full, strict=True):
                np.testing.assert_allclose([*a.corners_px.ravel(), a.score], [*b.corners_px.ravel(), b.score],
                                           rtol=1e-9, atol=1e-6)  # fmt: skip
    return full


@pytest.fixture
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles so small that a place near a found one is not computed by luck."""
    monkeypatch.setattr(banks, "TILE", 16)


def lab(camera: str, frame: int, grey: bool = True) -> Array:
    return np.asarray(cv2.imread(str(LAB / camera / f"{frame:04d}.jpg"), 0 if grey else 1))


@pytest.mark.slow
@every_method
@pytest.mark.parametrize("rule", ["components", "nms"])
@pytest.mark.usefixtures("small_tiles")
def test_the_pyramid_finds_what_the_full_search_finds_in_the_lab(method: str, rule: str) -> None:
    """The robot's template comes from another frame."""
    template = lab("left", 0)[150:214, 290:354]
    for frame in (0, 1, 4):
        assert_same(lab("left", frame)[60:420, 120:520], template, method, rule=rule, subpixel=True)
    assert_same(lab("right", 2)[100:300, 200:440], template, method, rule=rule, angles=(0, 40), subpixel=True)


@pytest.mark.slow
@coarse_method
@pytest.mark.parametrize("name, part", [("astronaut", (20, 200)), ("coins", (50, 110)), ("brick", (60, 80)),
                                        ("page", (20, 120)), ("camera", (70, 220)), ("chelsea", (80, 130))])  # fmt: skip
@pytest.mark.usefixtures("small_tiles")
def test_the_pyramid_finds_what_the_full_search_finds_in_photographs(
    method: str, name: str, part: tuple[int, int]
) -> None:
    image = getattr(data, name)()[:300, :360]
    y, x = part
    template = image[y : y + 37, x : x + 50]
    assert_same(image, template, method, subpixel=True)
    assert_same(image, template, method, rule="nms")
    disc = np.hypot(*np.ogrid[-1 : 1 : 37 * 1j, -1 : 1 : 50 * 1j]) < 1  # type: ignore[misc]
    assert_same(image, template, method, mask=disc, angles=(0, 25), subpixel=True)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    method=st.sampled_from(COARSE),
    rule=st.sampled_from(["components", "nms"]),
    subpixel=st.booleans(),
    turned=st.booleans(),
    masked=st.sampled_from(["no", "disc", "weights"]),
    tail=st.sampled_from([(), (3,)]),
)
def test_the_pyramid_finds_what_the_full_search_finds_in_random_scenes(
    seed: int, method: str, rule: str, subpixel: bool, turned: bool, masked: str, tail: tuple[int, ...]
) -> None:
    """Several copies of an object, other things, and noise; the default threshold."""
    rng = np.random.default_rng(seed)
    h, w = (int(n) for n in rng.integers(17, 50, 2))
    template = np.pad(scene((h - 6, w - 6, *tail), seed), ((3, 3), (3, 3)) + ((0, 0),) * len(tail), mode="edge")
    image = scene((150, 180, *tail), seed + 1).astype(float) * 0.2 + 100
    for _ in range(3):
        y, x = rng.integers(0, 150 - h + 1), rng.integers(0, 180 - w + 1)
        image[y : y + h, x : x + w] = template
    image = np.clip(image + rng.normal(0, 5, image.shape), 0, 255).astype(np.uint8)
    disc = np.hypot(*np.meshgrid(np.linspace(-1, 1, h), np.linspace(-1, 1, w), indexing="ij")) <= 1
    mask = {"no": None, "disc": disc, "weights": disc * np.linspace(0.2, 1, w)}[masked]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(banks, "TILE", 16)
        assert_same(image, template, method, rule=rule, subpixel=subpixel, mask=mask, exact=masked != "weights",
                    angles=(0, 33, 90) if turned else (0,), scales=(1, 0.8) if turned else (1,))  # fmt: skip


@pytest.mark.slow
@coarse_method
@pytest.mark.usefixtures("small_tiles")
def test_the_pyramid_finds_exact_copies_anywhere(method: str) -> None:
    """At each offset to the coarse grid, at each border, whatever lies around."""
    template = scene((36, 41), 5)
    for offset in range(8):
        for y, x in [(0, 0), (offset, 80 + offset), (64 - offset, 119 - offset), (64, 119), (64, offset), (30, 119)]:
            image = np.full((100, 160), 255, np.uint8)
            image[:, ::2] = 0
            image[y : y + 36, x : x + 41] = template
            for pyramid in (1, 2, 3):
                found = find(image, template, method, pyramid=pyramid)
                assert (found[0].x, found[0].y) == (x, y)


@pytest.mark.slow
@coarse_method
@pytest.mark.parametrize("step", [2, 4, 8])
def test_there_is_hope_where_the_copy_is_and_little_elsewhere(method: str, step: int) -> None:
    template = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 256, (40, 44)).astype(float), (0, 0), 4)
    (warp,) = warps(template[:, :, None] * 3 - 250, np.ones((40, 44), bool), (100, 160), [0], [1])
    for i in range(9):
        y, x = (0, 60 - i, 30 + i, 59, 60)[i % 5], (116, 0, i, 40 + i, 116 - i)[i % 5]
        image = np.zeros((100, 160, 1))
        image[::2] = 255.0
        image[y : y + 40, x : x + 44] = warp.template
        measure = METHODS[method]
        cost = -0.999 if measure.higher_is_better else 0.1
        hopeful = banks._hopeful(measure, banks._smaller(image, step), warp, cost, step, (61, 117))
        assert hopeful[y, x] and (step == 8 or hopeful.mean() < 0.5)


@pytest.mark.slow
@coarse_method
@pytest.mark.parametrize("angles", [(0,), (0, 8)])
@pytest.mark.usefixtures("small_tiles")
def test_from_one_hopeful_place_the_whole_component_is_reached(
    method: str, angles: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wide component over many tiles, and what sub-pixel positions need around it."""
    template = cv2.GaussianBlur(np.random.default_rng(8).integers(0, 256, (30, 34)).astype(float), (0, 0), 9)
    template = ((template - template.min()) / np.ptp(template) * 255).astype(np.uint8)
    image = np.pad(template, (60, 460), mode="edge")  # so large that no piece is all of it
    measure, mask = METHODS[method], np.ones(template.shape, bool)
    bank = Bank.of(measure, image[:, :, None], warps(template[:, :, None], mask, image.shape, angles, [1]))
    full, which = bank.cost()
    limit = float(np.quantile(full[:120, :120], 0.2))
    best = np.argwhere((full == full.min()) & (which == 0))[0]

    def one_hope(measure: Any, coarse: Array, warp: Any, limit: float, step: int, shape: tuple[int, int]) -> Array:
        places = np.zeros(shape, bool)
        offset = np.array([part.start for part in bank._part(warp)])
        places[tuple(best - offset)] = True
        return places

    monkeypatch.setattr(banks, "_hopeful", one_hope)
    monkeypatch.setattr(banks, "TILE", 8)
    found, chosen = bank.cost(limit, 2)
    _, labels = cv2.connectedComponents((full <= limit).astype(np.uint8), connectivity=8)
    component = labels == labels[tuple(best)]
    assert component.sum() > 4 * 8 * 8
    if len(angles) == 1:
        reached = cv2.dilate(component.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        np.testing.assert_allclose(found[reached], full[reached], rtol=1e-9, atol=1e-12)
    places = np.argwhere(component)[:: component.sum() // 30]
    if len(angles) == 2:  # and those that the larger canvas just misses
        rows, columns = bank._part(bank.warps[1])
        places = np.vstack([places, [(rows.start - 1, columns.start + 20), (rows.stop, columns.start - 1)]])
    bank.complete(found, chosen, places, 2)
    for r, c in places:
        around = np.s_[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2]
        np.testing.assert_allclose(found[around], full[around], rtol=1e-9, atol=1e-12)
        assert (chosen[around] == which[around]).all()


@coarse_method
@pytest.mark.usefixtures("small_tiles")
def test_a_vertex_between_two_templates_is_that_of_the_full_search(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside the best place another template is better, though nowhere good enough to be looked for."""
    image = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (120, 160)).astype(float), (0, 0), 4)
    image = ((image - image.min()) / np.ptp(image) * 255).astype(np.uint8)
    half_way = cv2.getRotationMatrix2D((80, 60), 5, 1)
    template = cv2.warpAffine(image, half_way, (160, 120))[40:81, 60:101]
    threshold = -1.0 if METHODS[method].higher_is_better else 1e5
    full = find(image, template, method, threshold, angles=(0, -10), subpixel=True, max_count=1)
    alone = find(image, template, method, threshold, angles=(full[0].angle,), subpixel=True, max_count=1)
    assert (full[0].x, full[0].y) != (alone[0].x, alone[0].y)
    limit = full[0].score
    found_first = banks._hopeful

    def hopeful(measure: Any, coarse: Array, warp: Any, *rest: Any) -> Array:
        places = found_first(measure, coarse, warp, *rest)
        return places if warp.angle == full[0].angle else np.zeros_like(places)

    monkeypatch.setattr(banks, "_hopeful", hopeful)
    assert find(image, template, method, limit, angles=(0, -10), subpixel=True, pyramid=2) == full


@pytest.mark.parametrize("method", ["ssd", "sad", "zncc"])
@pytest.mark.parametrize("step", [2, 4])
def test_there_is_hope_where_only_fine_texture_matches(method: str, step: int) -> None:
    """Nearly all of the template's contrast is finer than the coarse pixels; the rest of it, light, differs."""
    texture, light = 80.0 * (np.indices((40, 40)).sum(axis=0) % 2), np.linspace(-8, 8, 40)
    image = np.full((120, 160, 1), 120.0)
    image[33:73, 61:101, 0] = 80 + texture - light
    (warp,) = warps((80 + texture + light)[:, :, None], np.ones((40, 40), bool), (120, 160), [0], [1])
    measure = METHODS[method]
    score = measure.score(image, warp.template, warp.mask)[33, 61]
    limit = default_threshold(image, warp.template, method)
    assert score > limit if measure.higher_is_better else score < limit
    cost = -limit if measure.higher_is_better else limit
    assert banks._hopeful(measure, banks._smaller(image, step), warp, cost, step, (81, 121))[33, 61]


@coarse_method
def test_thin_masks_are_searched_in_full(method: str) -> None:
    image = np.random.default_rng(7).integers(0, 256, (100, 120)).astype(np.uint8)
    template, mask = image[20:60, 30:70], np.zeros((40, 40), bool)
    mask[::3] = True
    assert_same(image, template, method, mask=mask)
    assert find(image, template, method, mask=mask, pyramid=3)[0] == Match(
        30, 20, 1.0 if METHODS[method].higher_is_better else 0.0, 40, 40
    )


@coarse_method
@pytest.mark.usefixtures("small_tiles")
def test_what_lies_beside_a_mask_takes_no_hope_away(method: str) -> None:
    template = picture_of((40, 40), (19.5, 19.5))
    mask = np.hypot(*(np.indices((40, 40)) - 19.5)) < 11.3
    for y, x in [(30, 41), (31, 44), (33, 40)]:
        image = np.zeros((120, 160), np.uint8)
        image[:, ::2] = 255
        image[y : y + 40, x : x + 40] = np.where(mask, template, 255)
        for used in (mask, mask * 0.5 + mask * np.linspace(0.2, 0.5, 40)):
            full = assert_same(image, template, method, mask=used, exact=False)
            assert (full[0].x, full[0].y) == (x, y)


@coarse_method
def test_the_pyramid_saves_work(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer places than in the full search are computed, and never many more."""
    places = []
    measure = METHODS[method]

    def counted(image: Array, template: Array, mask: Array) -> Array:
        score = measure.score(image, template, mask)
        places.append(score.size)
        return score

    monkeypatch.setitem(METHODS, method, replace(measure, score=counted))
    template = picture_of((40, 40), (19.5, 19.5))
    image = picture_of((300, 400), (320.5, 219.5))
    counts = []
    for pyramid in (0, 1, 2, 3):
        places.clear()
        assert [(m.x, m.y) for m in find(image, template, method, pyramid=pyramid)] == [(301, 200)]
        counts.append(sum(places))
    assert (
        counts[0] == 261 * 361
        and counts[1] < counts[0] / 3
        and counts[2] < counts[0] / 8
        and counts[3] < 1.1 * counts[0]
    )
    places.clear()
    find(image, template, method, "otsu", pyramid=3)
    assert places == [261 * 361]


@pytest.mark.slow
def test_the_pyramid_of_flat_and_small_templates() -> None:
    flat = np.full((40, 40), 90, np.uint8)
    image = np.full((100, 100), 90, np.uint8)
    image[50:, 30:] = 200
    for method in COARSE:
        for template in (flat, image[48:53, 28:33], image[40:60, 28:31], [[90]]):
            assert_same(image, np.asarray(template), method)
            assert_same(image, np.asarray(template), method, threshold=0.0)
            assert_same(image / 255, np.asarray(template) / 255, method, exact=False)
    for limit in (-1, -0.5, 0, 0.3, 1):
        assert_same(image, image[40:60, 20:40], "zncc", threshold=limit, rule="nms")


@pytest.mark.parametrize("scales", [[1000], [1e12], [1e-9], [1e-3], [1e300]])
def test_scales_at_which_nothing_fits_are_refused_at_once(scales: list[float]) -> None:
    image = np.arange(64 * 64, dtype=np.uint8).reshape(64, 64)
    with pytest.raises(ValueError, match=r"scales: expected a template, turned and scaled, .* none of 1 is"):
        find(image, image[:20, :20], scales=scales)


def test_scales_that_do_not_fit_are_left_out() -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 64)).astype(np.uint8)
    plain = find(image, image[10:30, 10:30])
    assert find(image, image[10:30, 10:30], scales=[1e12, 1, 1e-9]) == plain
