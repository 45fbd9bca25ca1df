"""Template matching: the fast measures against the literal ones, planted targets, bounds, wrong arguments."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib import matching
from occlib.matching import METHODS, Match, default_threshold, find, reference_similarity, similarity

Array = npt.NDArray[Any]
DISTANCES = [name for name, method in METHODS.items() if not method.higher_is_better]
every_method = pytest.mark.parametrize("method", METHODS)


def scene(shape: tuple[int, ...] = (90, 120), seed: int = 0) -> Array:
    """A textured but not periodic uint8 picture, smooth enough to have edges."""
    coarse = np.random.default_rng(seed).integers(20, 236, (shape[0] // 6 + 1, shape[1] // 6 + 1, *shape[2:]))
    return np.kron(coarse, np.ones((6, 6) + (1,) * (len(shape) - 2), int))[: shape[0], : shape[1]].astype(np.uint8)


def robot(gain: float = 1.0) -> Array:
    """A 20 x 24 px object with a margin of floor."""
    picture = np.full((20, 24), 120.0)
    picture[5:15, 5:19] = 30
    picture[7:10, 8:16] = 220
    picture[11:13, 6:10] = 170
    return (picture * gain).astype(np.uint8)


def floor_with_robots(*corners: tuple[int, int]) -> Array:
    image = np.full((90, 120), 120, np.uint8)
    for x, y in corners:
        image[y : y + 20, x : x + 24] = robot()
    return image


def best_place(score: Array, method: str) -> tuple[int, int]:
    flat = score.argmax() if METHODS[method].higher_is_better else score.argmin()
    row, column = np.unravel_index(flat, score.shape)
    return int(column), int(row)


@st.composite
def pairs(draw: st.DrawFn, kind: str) -> tuple[Array, Array, Array | None]:
    """Image, template and mask, small, of one kind, grey or colour; values repeat often, so flat windows occur."""
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    h, w = draw(st.integers(1, height)), draw(st.integers(1, width))
    tail = draw(st.sampled_from([(), (3,)]))
    top = {"uint8": 255, "uint16": 65535, "float": 1000}[kind]
    values = st.one_of(st.sampled_from([0, 1, top]), st.integers(0, top))
    dtype = np.uint8 if kind == "uint8" else np.uint16
    image = draw(hnp.arrays(dtype, (height, width, *tail), elements=values))
    template = draw(hnp.arrays(dtype, (h, w, *tail), elements=values))
    if draw(st.booleans()):
        template = image[:h, :w].copy()
    mask = draw(st.none() | hnp.arrays(bool, (h, w)).filter(np.any))
    if kind == "float":
        return image / 7 - 50, template / 7 - 50, mask
    return image, template, mask


# ---------------------------------------------------------------- fast against literal


@every_method
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float"])
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_similarity_equals_the_literal_form(method: str, kind: str, data: st.DataObject) -> None:
    image, template, mask = data.draw(pairs(kind))
    fast = similarity(image, template, method, mask)
    literal = reference_similarity(image, template, method, mask)
    assert fast.shape == (image.shape[0] - template.shape[0] + 1, image.shape[1] - template.shape[1] + 1)
    assert fast.dtype == np.float64 and np.isfinite(fast).all()
    if kind != "float" and method in ("ssd", "sad"):
        np.testing.assert_array_equal(fast, literal)
    scale = 1.0 if METHODS[method].higher_is_better else np.abs(literal).max()
    np.testing.assert_allclose(fast, literal, rtol=0, atol=1e-9 * scale)


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


def test_float_ssd_keeps_its_precision_under_a_large_offset() -> None:
    image = scene() / 64.0  # exact in binary, with or without the offset
    template = image[31:61, 47:87] + 0.25
    np.testing.assert_allclose(
        similarity(image + 2.0**20, template + 2.0**20), similarity(image, template), rtol=0, atol=1e-11
    )


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


# ---------------------------------------------------------------- planted targets


@every_method
@pytest.mark.parametrize("tail", [(), (3,)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_a_planted_target_is_found_at_its_place(method: str, tail: tuple[int, ...], kind: type) -> None:
    image: Array = scene((90, 120, *tail)).astype(kind)
    template = image[31:61, 47:87].copy()
    score = similarity(image, template, method)
    assert best_place(score, method) == (47, 31)
    assert score[31, 47] == pytest.approx(1.0 if METHODS[method].higher_is_better else 0.0, abs=1e-12)
    match = find(image, template, method)[0]
    assert (match.x, match.y, match.width, match.height) == (47, 31, 40, 30)
    assert match.score == score[31, 47]
    assert match.centre_px == (66.5, 45.5)


@every_method
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_an_exact_copy_scores_exactly(method: str, kind: type) -> None:
    image: Array = scene().astype(kind)
    score = similarity(image, image[10:50, 20:70], method)
    assert score[10, 20] == (1.0 if METHODS[method].higher_is_better else 0.0)


@every_method
def test_a_mask_hides_what_differs(method: str) -> None:
    image = scene()
    template = image[30:60, 40:80].copy()
    mask = np.ones(template.shape, bool)
    mask[:14, :14] = False
    template[:10, :10] = 255 - template[:10, :10]  # something stood in front
    assert best_place(similarity(image, template, method, mask), method) == (40, 30)
    expected = 1.0 if METHODS[method].higher_is_better else 0.0
    assert similarity(image, template, method, mask)[30, 40] == expected
    assert similarity(image, template, method)[30, 40] != expected


@pytest.mark.parametrize(
    "method, gap", [*((name, gap) for name in METHODS if name != "sed" for gap in (0, 1, 30)), ("sed", 30)]
)
def test_two_targets_give_one_match_each(method: str, gap: int) -> None:
    """Not ``sed`` side by side: halfway between, the edges of both make up a third, false match."""
    image = floor_with_robots((12, 50), (36 + gap, 50))
    matches = find(image, robot(), method)
    assert [(match.x, match.y) for match in matches] == [(12, 50), (36 + gap, 50)]


@every_method
def test_best_first(method: str) -> None:
    image = floor_with_robots((80, 60), (10, 10))
    image[15:18, 20:24] = 90  # the first in row-major order is no longer the better one
    matches = find(image, robot(), method)
    assert [(match.x, match.y) for match in matches] == [(80, 60), (10, 10)]
    costs = [-match.score if METHODS[method].higher_is_better else match.score for match in matches]
    assert costs == sorted(costs) and costs[0] < costs[1]


@every_method
def test_no_target_no_match(method: str) -> None:
    noise = np.random.default_rng(3).normal(120, 3, (90, 120)).round().astype(np.uint8)
    assert find(noise, robot(), method) == []


def test_one_optimum_per_8_connected_component() -> None:
    """A 1 px template makes the similarity image readable: |t - f| of each pixel."""
    image = np.array([[1, 9, 9, 9, 0], [9, 0, 9, 9, 1], [9, 9, 9, 9, 9], [2, 9, 9, 1, 1]])
    found = [(match.x, match.y, match.score) for match in find(image, [[0]], "sad", threshold=2)]
    assert found == [(4, 0, 0.0), (1, 1, 0.0), (3, 3, 1.0), (0, 3, 2.0)]


def test_ties_go_to_the_first_in_row_major_order() -> None:
    assert find(np.full((5, 6), 7), [[7]], "ssd", threshold=0) == [Match(0, 0, 0.0, 1, 1)]


def test_the_threshold_is_inclusive_and_in_units_of_the_score() -> None:
    image = np.array([[5, 0, 8]])
    assert len(find(image, [[3]], "sad", threshold=5)) == 1
    assert [match.x for match in find(image, [[3]], "sad", threshold=2.5)] == [0]
    assert find(image, [[3]], "sad", threshold=1) == []
    assert len(find(scene(), scene()[:20, :20], "zncc", threshold=1)) == 1


@every_method
def test_otsu_finds_the_planted_target(method: str) -> None:
    image = floor_with_robots((40, 30))
    match = find(image, robot(), method, threshold="otsu")[0]
    assert (match.x, match.y) == (40, 30)


@every_method
def test_default_threshold_lies_between_perfect_and_featureless(method: str) -> None:
    image = floor_with_robots((40, 30))
    limit = default_threshold(image, robot(), method)
    featureless = np.full((90, 120), 120, np.uint8)
    away = similarity(featureless, robot(), method)[0, 0]
    perfect = 1.0 if METHODS[method].higher_is_better else 0.0
    assert min(away, perfect) < limit < max(away, perfect)


def test_default_thresholds_by_hand() -> None:
    template = np.array([[0, 4], [0, 4]])
    image = np.zeros((4, 4), int)
    assert default_threshold(image, template, "ssd") == 2.0  # variance 4
    assert default_threshold(image, template, "sad") == 1.0  # mean absolute deviation 2
    assert default_threshold(image, template, "zncc") == pytest.approx(np.sqrt(0.5))
    assert default_threshold(image, template, "ncc") == pytest.approx(np.sqrt(0.75))  # flat scores sqrt(1/2)
    assert default_threshold(image, template, "sed") == (2 / 8) ** 2


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


@settings(max_examples=40, deadline=None)
@given(pairs("float"))
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


# ---------------------------------------------------------------- wrong arguments

IMAGE = np.arange(30.0).reshape(5, 6)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"template": np.ones((6, 2))}, r"template: expected no larger than the image \(5, 6\), got \(6, 2\)"),
        ({"template": np.ones((2, 7))}, "template: expected no larger"),
        ({"template": np.ones((0, 3))}, "template: expected at least one pixel"),
        ({"image": np.ones((0, 3))}, "image: expected at least one pixel"),
        ({"image": np.where(IMAGE == 3, np.nan, IMAGE)}, "image: expected finite values"),
        ({"template": [[1.0, np.inf]]}, "template: expected finite values"),
        ({"image": IMAGE * 1e120}, "image: expected magnitudes"),
        ({"image": IMAGE > 3}, "image: expected integer or float values, got dtype bool"),
        ({"template": np.ones((2, 2), complex)}, "template: expected integer or float values, got dtype complex"),
        ({"template": np.ones((2, 2), object)}, "template: expected integer or float values, got dtype object"),
        ({"template": np.ones(3)}, r"template: expected shape .*, got \(3,\)"),
        ({"image": np.ones((5, 6, 4))}, r"image: expected shape .*, got \(5, 6, 4\)"),
        ({"template": np.ones((2, 2, 3))}, "template: expected 1 channel"),
        ({"image": np.ones((5, 6, 3))}, "template: expected 3 channel"),
        ({"mask": np.ones((2, 3), bool)}, r"mask: expected bool or weights \(2, 2\), got bool \(2, 3\)"),
        ({"mask": np.ones((2, 2), complex)}, "mask: expected bool or weights .* got complex128"),
        ({"mask": np.zeros((2, 2), bool)}, "mask: expected at least one pixel that counts, got none"),
        ({"mask": np.zeros((2, 2))}, "mask: expected at least one pixel that counts, got none"),
        ({"mask": [[1, -0.5], [1, 1]]}, "mask: expected finite weights >= 0"),
        ({"mask": [[1, np.nan], [1, 1]]}, "mask: expected finite weights >= 0"),
        ({"method": "zssd"}, "method: expected one of ssd, sad, ncc, zncc, sed, got 'zssd'"),
        ({"method": None}, "method: expected one of"),
    ],
)
@pytest.mark.parametrize("function", [similarity, reference_similarity, find, default_threshold])
def test_wrong_arguments(function: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        function(**{"image": IMAGE, "template": np.array([[1.0, 2.0], [3.0, 5.0]]), **arguments})


@pytest.mark.parametrize("threshold", [np.nan, np.inf, True, "triangle", [1], 1j])
def test_wrong_threshold(threshold: Any) -> None:
    with pytest.raises(ValueError, match="threshold: expected a finite number, 'otsu', 'mad' or None, got"):
        find(IMAGE, IMAGE[:2, :2], "ssd", threshold)


@pytest.mark.parametrize("method", DISTANCES)
def test_negative_threshold_of_a_distance(method: str) -> None:
    with pytest.raises(ValueError, match=rf"threshold: expected 0 to inf for {method}, got -0\.5"):
        find(IMAGE, IMAGE[:2, :2], method, -0.5)


def test_threshold_no_correlation_can_reach() -> None:
    with pytest.raises(ValueError, match=r"threshold: expected -1 to 1 for zncc, got 1\.5"):
        find(IMAGE, IMAGE[:2, :2], "zncc", 1.5)


def test_a_method_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table is the only place that knows the methods."""
    ssd = METHODS["ssd"]
    own = matching.Method("mine", "twice the ssd", False, lambda *a: 2 * ssd.score(*a), ssd.reference, lambda *a: 1.0)
    monkeypatch.setitem(METHODS, "mine", own)
    image = scene()
    assert find(image, image[30:50, 40:60], "mine") == [Match(40, 30, 0.0, 20, 20)]
