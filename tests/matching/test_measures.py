"""The similarity measures: fast against literal, exactness, degenerate pictures, light, layouts, memory."""

import tracemalloc
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from occlib.matching.measures import METHODS
from occlib.matching.reference import REFERENCES, reference_similarity
from occlib.matching.search import find, similarity

Array = npt.NDArray[Any]
DIFFERENCES = ["ssd", "sad"]
every_method = pytest.mark.parametrize("method", METHODS)


def scene(shape: tuple[int, ...] = (90, 120), seed: int = 0) -> Array:
    """A textured but not periodic uint8 picture, smooth enough to have edges."""
    coarse = np.random.default_rng(seed).integers(20, 236, (shape[0] // 6 + 1, shape[1] // 6 + 1, *shape[2:]))
    return np.kron(coarse, np.ones((6, 6) + (1,) * (len(shape) - 2), int))[: shape[0], : shape[1]].astype(np.uint8)


def perfect(method: str) -> float:
    return 1.0 if METHODS[method].higher_is_better else 0.0


# ---------------------------------------------------------------- fast against literal


def test_integers_beyond_16_bit_and_below_0() -> None:
    image: Array = np.array([[2**40, 70000, -5, 1]])
    assert similarity(image, [[70000]], "sad").tolist() == [[2**40 - 70000, 0, 70005, 69999]]
    np.testing.assert_allclose(similarity(image, [[70000]], "ssd"), (image - 70000.0) ** 2, rtol=1e-15)
    assert similarity(np.uint8([[3, 200]]), np.int8([[-5]]), "sad").tolist() == [[8, 205]]


def test_float_ssd_keeps_its_precision_under_a_large_offset() -> None:
    image = scene() / 64.0  # exact in binary, with or without the offset
    template = image[31:61, 47:87] + 0.25
    np.testing.assert_allclose(
        similarity(image + 2.0**20, template + 2.0**20), similarity(image, template), rtol=0, atol=1e-11
    )


@every_method
def test_weights_by_hand(method: str) -> None:
    image, template, weights = np.array([[4.0, 1.0]]), np.array([[1.0, 3.0]]), np.array([[3.0, 1.0]])
    expected = {
        "ssd": (3 * 9 + 4) / 4,
        "sad": (3 * 3 + 2) / 4,
        "ncc": (3 * 4 + 3) / np.sqrt((3 + 9) * (3 * 16 + 1)),
        "zncc": -1.0,
        "sed": 1 + 2**2,  # no edges: the squared diagonal
    }
    assert similarity(image, template, method, weights)[0, 0] == pytest.approx(expected[method], rel=1e-12)


@every_method
def test_only_the_ratios_of_weights_matter(method: str) -> None:
    image = scene((40, 44))
    template = image[3:27, 4:29]
    weights = np.random.default_rng(8).integers(0, 4, template.shape)
    plain = similarity(image, template, method, weights)
    for same in (weights * 0.1, weights * 1e-200, (weights * 3).astype(np.float32)):
        np.testing.assert_allclose(similarity(image, template, method, same), plain, rtol=1e-9, atol=1e-9)
    yes = weights > 1
    for mask in (yes * 5, yes * 0.1, yes.astype(np.int8)):
        np.testing.assert_array_equal(
            similarity(image, template, method, mask), similarity(image, template, method, yes)
        )
    assert np.abs(similarity(image, template, method, yes) - plain).max() > 1e-3


def test_sed_ignores_template_edges_within_3_px_of_the_border() -> None:
    """A vertical step between columns 9 and 10 of the template is an edge of the one or the other."""
    image = np.zeros((40, 60), np.uint8)
    image[:, 30:] = 255
    column = int(np.flatnonzero(similarity(image, image[5:25, 20:40], "sed")[0] == 0)[0])
    assert column == 20
    edge = next(c for c in (29, 30) if similarity(image, image[5:25, c - 3 : c + 10], "sed").max() < 40**2 + 60**2)
    assert similarity(image, image[5:25, edge - 2 : edge + 10], "sed").min() == 40**2 + 60**2  # too near: none left
    assert similarity(image, image[5:25, edge - 10 : edge + 4], "sed").min() == 0
    assert similarity(image, image[5:25, edge - 10 : edge + 3], "sed").min() == 40**2 + 60**2


def test_sed_takes_its_own_thresholds_of_gradient() -> None:
    """|gx| of a step of s is 3 s after the smoothing: above 40 for s = 14, not for 13; above 100 for 34, not for 33."""
    for step, image_edge, template_edge in [(13, False, False), (14, True, False), (33, True, False), (34, True, True)]:
        image = np.full((30, 40), 100, np.uint8)
        image[:, 20:] += np.uint8(step)
        strong = np.full((30, 40), 100, np.uint8)
        strong[:, 20:] = 200
        none = 30**2 + 40**2
        assert (similarity(image, strong[5:20, 10:30], "sed").min() < none) == image_edge
        assert (similarity(strong, image[5:20, 10:30], "sed").min() < none) == template_edge


def test_equation_2_by_hand() -> None:
    image: Array = np.array([[10, 20, 30], [40, 50, 60]], np.uint8)
    template: Array = np.array([[20, 30]], np.uint8)
    np.testing.assert_array_equal(similarity(image, template, "ssd"), [[100, 0], [400, 900]])
    np.testing.assert_array_equal(similarity(image, template, "sad"), [[10, 0], [20, 30]])
    assert similarity(image, template, "ncc")[0, 0] == pytest.approx(800 / np.sqrt(500 * 1300))
    np.testing.assert_allclose(similarity(image, template, "zncc"), 1)


def test_sed_by_hand() -> None:
    """Edges in straight lines: a shift by s px off a lone vertical edge costs s^2."""
    image = np.zeros((40, 60), np.uint8)
    image[:, 30:] = 255
    score = similarity(image, image[5:25, 20:40], "sed")
    np.testing.assert_array_equal(score[0, 20:29], np.arange(9) ** 2)


@every_method
def test_a_grey_picture_scores_like_its_three_channel_copy(method: str) -> None:
    image = scene((40, 50))
    template = image[8:28, 10:34]
    colour = similarity(np.dstack([image] * 3), np.dstack([template] * 3), method)
    np.testing.assert_allclose(colour, similarity(image, template, method), rtol=1e-12, atol=1e-12)


# ---------------------------------------------------------------- an exact copy


@every_method
@pytest.mark.parametrize("tail", [(), (3,)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int64])
@pytest.mark.parametrize("masked", [False, True])
def test_an_exact_copy_of_integers_scores_exactly(method: str, tail: tuple[int, ...], kind: type, masked: bool) -> None:
    image: Array = scene((90, 120, *tail)).astype(kind) * kind(1 if kind is np.uint8 else 257)
    mask = np.random.default_rng(9).random((40, 50)) < 0.8 if masked else None
    score = similarity(image, image[10:50, 20:70], method, mask)
    assert score[10, 20] == perfect(method)
    assert (score == perfect(method)).sum() == 1


@every_method
@pytest.mark.parametrize("gain, offset", [(1 / 255, 0), (1e-30, 0), (0.1, 1e6), (1e90, -1e90)])
@pytest.mark.parametrize("mask", ["none", "half", "weights"])
def test_an_exact_copy_of_floats_scores_exactly_0_or_nearly_1(
    method: str, gain: float, offset: float, mask: str
) -> None:
    image = scene() * gain + offset
    random = np.random.default_rng(9).random((40, 50))
    used = {"none": None, "half": random < 0.5, "weights": random}[mask]
    score = similarity(image, image[10:50, 20:70], method, used)[10, 20]
    assert score == (pytest.approx(1, abs=1e-9) if METHODS[method].higher_is_better else 0)


@pytest.mark.parametrize("method", DIFFERENCES)
def test_an_exact_copy_of_integers_with_weights_scores_exactly_0(method: str) -> None:
    weights = np.random.default_rng(9).random((40, 50))
    assert similarity(scene(), scene()[10:50, 20:70], method, weights)[10, 20] == 0
    assert similarity(scene(), scene()[10:50, 20:70], "sed", weights)[10, 20] == 0


# ---------------------------------------------------------------- light


def test_zncc_ignores_gain_and_offset_ncc_gain_and_ssd_neither() -> None:
    image = scene().astype(np.uint16)
    template = image[31:61, 47:87].copy()
    for kind in (np.uint16, np.float64):
        bright, brighter = (3 * image).astype(kind), (3 * image + 40).astype(kind)
        plain = {method: similarity(image, template, method) for method in METHODS}
        np.testing.assert_allclose(similarity(brighter, template, "zncc"), plain["zncc"], atol=1e-9)
        np.testing.assert_allclose(similarity(bright, template, "ncc"), plain["ncc"], atol=1e-9)
        assert np.abs(similarity(brighter, template, "ncc") - plain["ncc"]).max() > 0.01
        assert similarity(image + 40, template, "ssd")[31, 47] == 1600
        assert similarity(image + 40, template, "sad")[31, 47] == 40
        assert find(image + 100, template, "ssd") == []


def test_zncc_ignores_an_offset_of_one_channel() -> None:
    image = scene((60, 70, 3)).astype(np.uint16)
    template = image[10:40, 20:50]
    tinted = image + np.array([0, 25, 60], np.uint16)
    np.testing.assert_allclose(similarity(tinted, template, "zncc"), similarity(image, template, "zncc"), atol=1e-9)


def test_zncc_of_floats_ignores_a_large_offset_of_one_channel() -> None:
    image = scene((60, 70, 3)) / 256
    template = image[10:40, 20:50]
    tinted = image + np.array([0, 2.0**20, -(2.0**20)])
    np.testing.assert_allclose(similarity(tinted, template, "zncc"), similarity(image, template, "zncc"), atol=1e-9)


def test_sed_finds_the_target_at_half_the_light() -> None:
    image = scene()
    match = find(image // 2, image[31:61, 47:87], "sed")[0]
    assert (match.x, match.y) == (47, 31)


def test_sed_edges_of_the_image_may_be_fainter_than_the_template_s() -> None:
    image = np.full((60, 70), 100, np.uint8)
    image[20:35, 30:50] = 140
    score = similarity(image // 2, image[15:40, 25:55], "sed")
    assert score[15, 25] == 0 and score.max() > 0


def test_zncc_of_a_negative_is_minus_one() -> None:
    image = scene()
    assert similarity(255 - image, image[31:61, 47:87], "zncc")[31, 47] == pytest.approx(-1, abs=1e-12)


# ---------------------------------------------------------------- nothing to compare


@every_method
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("image_value, template_value", [(0, 0), (0, 9), (9, 0), (9, 9), (200, None), (None, 200)])
def test_flat_and_black_stay_finite(method: str, kind: type, image_value: Any, template_value: Any) -> None:
    image: Array = (scene((30, 40)) if image_value is None else np.full((30, 40), image_value)).astype(kind)
    template: Array = (scene((12, 15)) if template_value is None else np.full((12, 15), template_value)).astype(kind)
    if np.issubdtype(kind, np.floating):
        image, template = image / kind(10), template / kind(10)  # 0.1 is no binary fraction: sums round
    score = similarity(image, template, method)
    assert np.isfinite(score).all()
    if method == "zncc":
        assert (score == 0).all()
    if method == "ncc" and 0 in (image_value, template_value):
        assert (score == 0).all()
    if method == "sed":
        assert (score == 30**2 + 40**2).all()
    find(image, template, method)


def test_flat_windows_of_a_textured_picture_score_zero() -> None:
    for image, template in [(scene((60, 60)), scene((12, 12), 5)), (scene((60, 60)) / 255, scene((12, 12), 5) / 255)]:
        image[20:50, 20:50] = image[0, 0]
        score = similarity(image, template, "zncc")
        assert (score[20:39, 20:39] == 0).all() and np.abs(score).max() > 0.1


def test_opencv_flat_template_does_not_score_1_everywhere() -> None:
    """opencv/opencv #15768: ``TM_CCOEFF_NORMED`` of a flat template is 1 everywhere."""
    assert (similarity(scene(), np.full((9, 9), 77, np.uint8), "zncc") == 0).all()
    assert (similarity(scene() / 7, np.full((9, 9), 0.1), "zncc") == 0).all()


def test_opencv_flat_image_has_no_structure_to_match() -> None:
    for kind in (np.uint8, np.uint16, float):
        image = np.full((40, 50), 0.1 if kind is float else 77, kind)
        assert (similarity(image, scene((12, 15)).astype(kind), "zncc") == 0).all()


def test_opencv_black_image_has_no_energy() -> None:
    for kind in (np.uint8, np.uint16, float):
        for method in ("ncc", "zncc"):
            assert (similarity(np.zeros((40, 50), kind), scene((12, 15)).astype(kind), method) == 0).all()
            assert (similarity(scene((40, 50)).astype(kind), np.zeros((12, 15), kind), method) == 0).all()


@every_method
@pytest.mark.parametrize("kind", [bool, np.uint8, float])
def test_opencv_all_zero_mask_is_refused(method: str, kind: type) -> None:
    with pytest.raises(ValueError, match="mask: expected at least one pixel that counts, got none"):
        similarity(scene(), scene()[:9, :9], method, np.zeros((9, 9), kind))


def test_opencv_one_pixel_template() -> None:
    image: Array = np.array([[0, 50, 255]], np.uint8)
    assert similarity(image, [[50]], "ssd").tolist() == [[2500, 0, 205**2]]
    assert similarity(image, [[50]], "sad").tolist() == [[50, 0, 205]]
    assert similarity(image, np.uint8([[50]]), "ncc").tolist() == [[0, 1, 1]]
    assert similarity(image, [[50]], "zncc").tolist() == [[0, 0, 0]]
    assert similarity(image, [[50]], "sed").tolist() == [[10, 10, 10]]


@every_method
def test_subnormal_numbers_stay_finite(method: str) -> None:
    image = np.random.default_rng(10).random((30, 40)) * 1e-310
    assert np.isfinite(similarity(image, image[5:20, 5:25], method)).all()


@every_method
def test_constant_similarity_images_give_no_otsu_match(method: str) -> None:
    assert find(np.zeros((20, 20), np.uint8), np.zeros((9, 9), np.uint8), method, threshold="otsu") == []


@every_method
def test_template_as_large_as_the_image(method: str) -> None:
    image = scene((40, 50))
    score = similarity(image, image, method)
    assert score.shape == (1, 1)
    assert score[0, 0] == (1.0 if METHODS[method].higher_is_better else 0.0)
    assert [(match.x, match.y) for match in find(image, image, method)] == [(0, 0)]


@every_method
def test_one_pixel_templates_and_images(method: str) -> None:
    assert np.isfinite(similarity(scene((20, 20)), [[50]], method)).all()
    assert np.isfinite(similarity([[3.5]], [[-2.5]], method)).all()
    assert np.isfinite(similarity([[1e99, 0, -1e99]], [[1e-99, 0]], method)).all()


@pytest.mark.parametrize("method", [name for name in METHODS if name != "sed"])
def test_what_the_mask_hides_does_not_count(method: str) -> None:
    """Rubbish under the mask changes nothing (``sed`` excepted: edges need their surroundings)."""
    image = scene((40, 40)) / 255
    template = image[5:20, 5:20].copy()
    mask = np.ones(template.shape, bool)
    mask[3:6, 2:9] = False
    rubbish = np.where(mask, template, 1e30)
    np.testing.assert_allclose(similarity(image, rubbish, method, mask), similarity(image, template, method, mask))


# ---------------------------------------------------------------- layouts and memory


@pytest.mark.slow
@every_method
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float64])
@pytest.mark.parametrize("tail", [(), (3,)])
def test_the_layout_of_the_arrays_does_not_matter(method: str, kind: type, tail: tuple[int, ...]) -> None:
    image: Array = scene((40, 50, *tail)).astype(kind)
    template = image[5:25, 6:28].copy()
    mask = np.random.default_rng(11).random((20, 22)).round(1)
    expected, masked = (similarity(image, template, method, used) for used in (mask, mask > 0.5))
    twice = np.repeat(np.repeat(image, 2, axis=0), 3, axis=1)[::2, ::3]
    swapped = [array.astype(array.dtype.newbyteorder()) for array in (image, template, mask)]
    for arrays in (
        (np.asfortranarray(image), np.asfortranarray(template), np.asfortranarray(mask)),
        (twice, image[5:25, 6:28], mask[::-1][::-1]),
        (image[::-1, ::-1].copy()[::-1, ::-1], template[:, ::-1].copy()[:, ::-1], mask.T.copy().T),
        swapped,
    ):
        weighted, yes = (similarity(*arrays[:2], method, used) for used in (arrays[2], arrays[2] > 0.5))
        np.testing.assert_allclose(weighted, expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(yes, masked, rtol=0, atol=1e-12 if kind is np.float64 else 0)
    assert swapped[1].dtype.byteorder == ">" or kind is np.uint8


@every_method
@pytest.mark.parametrize("mask", ["none", "disc", "weights"])
def test_peak_memory_is_at_most_12_images_of_float64(method: str, mask: str) -> None:
    """numpy allocates OpenCV's arrays too, so all of them are counted."""
    image = scene((480, 640))
    disc = np.hypot(*np.ogrid[-1 : 1 : 64 * 1j, -1 : 1 : 64 * 1j]) < 1  # type: ignore[misc]
    used = {"none": None, "disc": disc, "weights": disc * np.linspace(0.5, 1, 64)}[mask]
    similarity(image[:80, :80], image[:64, :64], method, used)
    tracemalloc.start()
    similarity(image, image[100:164, 100:164], method, used)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert image.size < peak < 12 * image.size * 8


@every_method
def test_inputs_stay_unchanged(method: str) -> None:
    for kind in (np.uint8, np.float64):
        image = scene((40, 50)).astype(kind)
        template, mask = image[5:25, 5:25].copy(), np.ones((20, 20), bool)
        mask[0] = False
        before = [array.copy() for array in (image, template, mask)]
        for array in (image, template, mask):
            array.flags.writeable = False
        find(image, template, method, mask=mask)
        if method in REFERENCES:
            reference_similarity(image[:22, :22], template, method, mask)
        for array, copy in zip((image, template, mask), before, strict=True):
            np.testing.assert_array_equal(array, copy)
