"""Random pictures: the fast measures against their literal forms, and the bounds of their scores."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib.matching.measures import METHODS
from occlib.matching.reference import REFERENCES, reference_similarity
from occlib.matching.search import similarity

Array = npt.NDArray[Any]
DIFFERENCES = ["ssd", "sad"]
every_reference = pytest.mark.parametrize("method", REFERENCES)


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


@pytest.mark.slow
@every_reference
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


@every_reference
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
def test_sed_equals_the_literal_form_where_there_are_edges(
    textured: Callable[..., Array], tail: tuple[int, ...], masked: bool
) -> None:
    image = textured((34, 40, *tail))
    template = image[4:26, 6:30]
    mask = np.random.default_rng(1).random(template.shape[:2]) < 0.5 if masked else None
    fast = similarity(image, template, "sed", mask)
    assert 0 < fast.max() < 34**2 + 40**2  # real distances, not the constant for "no edges"
    np.testing.assert_allclose(fast, reference_similarity(image, template, "sed", mask), rtol=1e-12)


def test_ssd_keeps_a_small_difference_beside_huge_values() -> None:
    assert similarity([[1, 1e100, 3]], [[2, 1e100, 3]])[0, 0] == pytest.approx(1 / 3, rel=1e-12)
    pattern = np.tile([-1e6, 1e6], (40, 20))
    noisy = pattern + np.random.default_rng(6).normal(0, 1, pattern.shape)
    score = similarity(noisy, pattern[:10, :10])[::1, ::2]
    literal = reference_similarity(noisy, pattern[:10, :10])[::1, ::2]  # about 1, where the sums are about 1e12
    np.testing.assert_allclose(score, literal, rtol=1e-9)


@pytest.mark.parametrize("method", ["ncc", "zncc"])
def test_black_windows_of_float_pictures_score_zero(method: str) -> None:
    image = np.zeros((60, 80))
    image[20:40, 30:50] = np.random.default_rng(0).random((20, 20))
    template = image[25:37, 33:47]
    score = similarity(image, template, method)
    assert (score[:5, :10] == 0).all() and score[25, 33] == pytest.approx(1)
    np.testing.assert_allclose(score, reference_similarity(image, template, method), atol=1e-9)


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


def test_a_measure_without_a_literal_form_says_so() -> None:
    with pytest.raises(ValueError, match=r"method: expected one of ssd, sad, ncc, zncc, sed, got 'mine'"):
        reference_similarity([[1, 2, 3]], [[2, 4]], "mine")
