"""The similarity measures: fast against literal, exactness, degenerate pictures, light, layouts, memory."""

import tracemalloc
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib.matching import measures
from occlib.matching.measures import METHODS
from occlib.matching.search import find, reference_similarity, similarity

Array = npt.NDArray[Any]
DIFFERENCES = ["ssd", "sad"]
every_method = pytest.mark.parametrize("method", METHODS)


def scene(shape: tuple[int, ...] = (90, 120), seed: int = 0) -> Array:
    """A textured but not periodic uint8 picture, smooth enough to have edges."""
    coarse = np.random.default_rng(seed).integers(20, 236, (shape[0] // 6 + 1, shape[1] // 6 + 1, *shape[2:]))
    return np.kron(coarse, np.ones((6, 6) + (1,) * (len(shape) - 2), int))[: shape[0], : shape[1]].astype(np.uint8)


def perfect(method: str) -> float:
    return 1.0 if METHODS[method].higher_is_better else 0.0


@st.composite
def pairs(draw: st.DrawFn, kind: str) -> tuple[Array, Array, Array | None]:
    """Image, template and mask or weights, small, of one kind, grey or colour; values repeat often, so flat windows
    occur, and every other template is cut from the image."""
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    h, w = draw(st.integers(1, height)), draw(st.integers(1, width))
    tail = draw(st.sampled_from([(), (3,)]))
    top = {"uint8": 255, "uint16": 65535, "float": 1000}[kind]
    values = st.one_of(st.sampled_from([0, 1, top]), st.integers(0, top))
    dtype = np.uint8 if kind == "uint8" else np.uint16
    image: Array = draw(hnp.arrays(dtype, (height, width, *tail), elements=values))
    template: Array = draw(hnp.arrays(dtype, (h, w, *tail), elements=values))
    if draw(st.booleans()):
        template = image[height - h :, width - w :].copy()
    weights = hnp.arrays(np.float64, (h, w), elements=st.sampled_from([0.0, 1e-3, 0.25, 1.0, 7.0]))
    mask = draw(st.none() | hnp.arrays(bool, (h, w)).filter(np.any) | weights.filter(np.any))
    if kind == "float":
        gain, offset = draw(st.sampled_from([1.0, 1e-6, 1e40])), draw(st.sampled_from([0.0, -50.0, 1e6]))
        image, template = (values / 7 * gain + offset * gain for values in (image, template))
        if draw(st.booleans()):
            image[0, 0] *= 1e7  # one glint, and every other window is nearly flat
    return image, template, mask


# ---------------------------------------------------------------- fast against literal


@pytest.mark.slow
@every_method
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float"])
@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_similarity_equals_the_literal_form(method: str, kind: str, data: st.DataObject) -> None:
    image, template, mask = data.draw(pairs(kind))
    fast = similarity(image, template, method, mask)
    literal = reference_similarity(image, template, method, mask)
    assert fast.shape == (image.shape[0] - template.shape[0] + 1, image.shape[1] - template.shape[1] + 1)
    assert fast.dtype == np.float64 and np.isfinite(fast).all()
    if kind != "float" and method in DIFFERENCES and (mask is None or mask.dtype == bool):
        np.testing.assert_array_equal(fast, literal)
    scale = 1.0 if METHODS[method].higher_is_better else np.abs(literal).max()
    np.testing.assert_allclose(fast, literal, rtol=0, atol=1e-9 * scale)


@every_method
@pytest.mark.parametrize(
    "shape, size",
    [((1, 1), (1, 1)), ((1, 2), (1, 1)), ((1, 7), (1, 3)), ((7, 1), (3, 1)), ((2, 1), (2, 1)), ((13, 1), (1, 1)),
     ((1, 640), (1, 5)), ((331, 1), (4, 1)), ((2, 2), (1, 2)), ((3, 2), (2, 2)), ((17, 19), (17, 3)), ((16, 18), (1, 18))],
)  # fmt: skip
def test_pictures_of_one_row_or_column_and_odd_and_even_sizes(
    method: str, shape: tuple[int, int], size: tuple[int, int]
) -> None:
    rng = np.random.default_rng(4)
    for kind in (np.uint8, np.float64):
        image, template = (rng.integers(0, 256, s).astype(kind) for s in (shape, size))
        fast, literal = similarity(image, template, method), reference_similarity(image, template, method)
        np.testing.assert_allclose(fast, literal, rtol=0, atol=1e-9 * max(1.0, np.abs(literal).max()))


@pytest.mark.parametrize("method", ["ncc", "zncc"])
@pytest.mark.parametrize("spread", [1e-4, 3e-5, 1.1e-5, 9e-6, 1e-6])
def test_nearly_flat_float_windows_equal_the_literal_form(method: str, spread: float) -> None:
    """Where the sums cancel; below a spread of 1e-5 of the range nothing is left to compare."""
    rng = np.random.default_rng(5)
    image = np.where(rng.random((40, 50)) < 0.5, -1.0, 1.0) * spread * 100 + 1000.0 * (method == "zncc")
    image[:3, :3] = 1000 + 100 * np.eye(3)
    template = image[20:26, 20:27].copy()
    fast = similarity(image, template, method)
    np.testing.assert_allclose(fast, reference_similarity(image, template, method), rtol=0, atol=1e-9)
    if method == "zncc":
        assert fast[20, 20] == (pytest.approx(1) if spread > 1e-5 else 0)


@pytest.mark.parametrize("tail", [(), (3,)])
@pytest.mark.parametrize("masked", [False, True])
def test_sed_equals_the_literal_form_where_there_are_edges(tail: tuple[int, ...], masked: bool) -> None:
    image = scene((34, 40, *tail))
    template = image[4:26, 6:30]
    mask = np.random.default_rng(1).random(template.shape[:2]) < 0.5 if masked else None
    fast = similarity(image, template, "sed", mask)
    assert 0 < fast.max() < 34**2 + 40**2  # real distances, not the constant for "no edges"
    np.testing.assert_allclose(fast, reference_similarity(image, template, "sed", mask), rtol=1e-12)


@pytest.mark.parametrize("dtype, top", [(np.uint8, 255), (np.uint16, 65535)])
@pytest.mark.parametrize("masked", [False, True])
def test_integer_sums_are_exact_for_large_pictures(dtype: type, top: int, masked: bool) -> None:
    rng = np.random.default_rng(2)
    image: Array = rng.integers(top - 3, top + 1, (300, 400)).astype(dtype)
    template: Array = rng.integers(0, top + 1, (100, 90)).astype(dtype)
    mask = rng.random(template.shape) < 0.7 if masked else np.ones(template.shape, bool)
    ssd, sad = similarity(image, template, "ssd", mask), similarity(image, template, "sad", mask)
    for row, column in [(0, 0), (200, 310), (77, 123)]:
        window = image[row : row + 100, column : column + 90].astype(int)
        difference = (window - template.astype(int))[mask]
        assert ssd[row, column] == (difference**2).sum() / mask.sum()
        assert sad[row, column] == np.abs(difference).sum() / mask.sum()


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


def test_ssd_keeps_a_small_difference_beside_huge_values() -> None:
    assert similarity([[1, 1e100, 3]], [[2, 1e100, 3]])[0, 0] == pytest.approx(1 / 3, rel=1e-12)
    pattern = np.tile([-1e6, 1e6], (40, 20))
    noisy = pattern + np.random.default_rng(6).normal(0, 1, pattern.shape)
    score = similarity(noisy, pattern[:10, :10])[::1, ::2]
    literal = reference_similarity(noisy, pattern[:10, :10])[::1, ::2]  # about 1, where the sums are about 1e12
    np.testing.assert_allclose(score, literal, rtol=1e-9)


@pytest.mark.parametrize("bits", [(8, 8), (32, 20), (20, 34), (26, 26)])
def test_correlations_of_all_digits_are_exact(bits: tuple[int, int]) -> None:
    rng = np.random.default_rng(12)
    image: Array = rng.integers(0, 2 ** bits[0], (40, 50))
    kernel: Array = rng.integers(-(2 ** bits[1]), 2 ** bits[1], (11, 8))
    windows = np.lib.stride_tricks.sliding_window_view(image, kernel.shape)
    for pairs in ([(image, kernel)], [(image, kernel), (image, np.abs(kernel))]):
        expected = sum((windows * k).sum(axis=(2, 3)) for _, k in pairs)
        np.testing.assert_array_equal(measures._correlations(pairs)[0], expected)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_correlations_of_large_integers_are_exact(data: st.DataObject) -> None:
    """Beyond what one Fourier transform can hold, the digits are split."""
    shape = data.draw(st.sampled_from([(1, 5), (6, 1), (4, 7), (9, 9)]))
    size = tuple(data.draw(st.integers(1, side)) for side in shape)
    bits = data.draw(st.sampled_from([(8, 8), (32, 8), (32, 20), (20, 34), (26, 26)]))
    image = data.draw(hnp.arrays(np.int64, shape, elements=st.integers(0, 2 ** bits[0] - 1)))
    kernel = data.draw(hnp.arrays(np.int64, size, elements=st.integers(-(2 ** bits[1]) + 1, 2 ** bits[1] - 1)))
    (found,) = measures._correlations([(image, kernel)])
    windows = np.lib.stride_tricks.sliding_window_view(image, size)
    np.testing.assert_array_equal(found, (windows * kernel).sum(axis=(2, 3)))
    assert found.dtype == np.int64


@pytest.mark.parametrize("width", [255, 256, 257, 511, 512, 513, 520])
@pytest.mark.parametrize("masked", [False, True])
def test_wide_templates_do_not_overflow_the_sums_of_rows(width: int, masked: bool) -> None:
    """256 differences of 255 fill 16 bit."""
    image: Array = np.zeros((3, width + 2), np.uint8)
    image[:, -1] = 255
    template: Array = np.full((2, width), 255, np.uint8)
    mask = np.ones((2, width), bool)
    mask[0, 0] = not masked
    expected = np.full((2, 3), 255.0)
    expected[:, 2] -= 255 * 2 / mask.sum()
    np.testing.assert_allclose(similarity(image, template, "sad", mask), expected, rtol=1e-15)
    np.testing.assert_allclose(similarity(image.astype(np.uint16) * 257, template * np.uint16(257), "sad", mask),
                               expected * 257, rtol=1e-15)  # fmt: skip


@pytest.mark.parametrize("side, low", [(255, 0), (260, 65500), (310, 0)])
@pytest.mark.parametrize("masked", [False, True])
def test_correlation_of_large_16_bit_templates_is_exact(side: int, low: int, masked: bool) -> None:
    """Their products of sums pass 64 bit at 260 px, where float64 loses faint contrast; their covariance at 310."""
    rng = np.random.default_rng(7)
    image = rng.choice([low, 65535] if low == 0 else np.arange(low, 65536), (side + 2, side + 1)).astype(np.uint16)
    template = image[1 : side + 1, 1:].copy()
    mask = np.ones(template.shape, bool)
    mask[:3, :3] = not masked
    score = similarity(image, template, "zncc", mask)
    assert score[1, 1] == 1 and similarity(image, template, "ncc", mask)[1, 1] == 1
    assert similarity(np.uint16(65535) - (image - np.uint16(low)), template, "zncc", mask)[1, 1] == -1
    t, f = (np.array([int(v) for v in a[mask]], dtype=object) for a in (template, image[:side, :side]))
    n = len(t)
    cross, own, energy = (n * (a * b).sum() - a.sum() * b.sum() for a, b in ((t, f), (t, t), (f, f)))
    assert score[0, 0] == pytest.approx(float(cross) / np.sqrt(float(own) * float(energy)), abs=1e-14)


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


@settings(max_examples=60, deadline=None)
@given(pairs("float"))
@example((np.array([[1e100, -1e100, 1e-300, 0.0]]), np.array([[1e-300, 1e100]]), None))
@example((np.full((4, 4), 0.1), np.full((2, 2), 0.1), np.array([[1.0, 1e-300], [1e-9, 0.0]])))
def test_bounds(pair: tuple[Array, Array, Array | None]) -> None:
    image, template, mask = pair
    for method in METHODS:
        score = similarity(image, template, method, mask)
        low, high = (-1, 1) if METHODS[method].higher_is_better else (0, np.inf)
        assert (score >= low).all() and (score <= high).all()


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
        reference_similarity(image[:22, :22], template, method, mask)
        for array, copy in zip((image, template, mask), before, strict=True):
            np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("method", ["ncc", "zncc"])
def test_black_windows_of_float_pictures_score_zero(method: str) -> None:
    image = np.zeros((60, 80))
    image[20:40, 30:50] = np.random.default_rng(0).random((20, 20))
    template = image[25:37, 33:47]
    score = similarity(image, template, method)
    assert (score[:5, :10] == 0).all() and score[25, 33] == pytest.approx(1)
    np.testing.assert_allclose(score, reference_similarity(image, template, method), atol=1e-9)
