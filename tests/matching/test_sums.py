"""Sums over windows are exact for integers, however large."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib.matching import sums
from occlib.matching.search import similarity

Array = npt.NDArray[Any]


@pytest.mark.parametrize("bits", [(8, 8), (32, 20), (20, 34), (26, 26)])
def test_correlations_of_all_digits_are_exact(bits: tuple[int, int]) -> None:
    rng = np.random.default_rng(12)
    image: Array = rng.integers(0, 2 ** bits[0], (40, 50))
    kernel: Array = rng.integers(-(2 ** bits[1]), 2 ** bits[1], (11, 8))
    windows = np.lib.stride_tricks.sliding_window_view(image, kernel.shape)
    for pairs in ([(image, kernel)], [(image, kernel), (image, np.abs(kernel))]):
        expected = sum((windows * k).sum(axis=(2, 3)) for _, k in pairs)
        np.testing.assert_array_equal(sums.correlations(pairs)[0], expected)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_correlations_of_large_integers_are_exact(data: st.DataObject) -> None:
    """Beyond what one Fourier transform can hold, the digits are split."""
    shape = data.draw(st.sampled_from([(1, 5), (6, 1), (4, 7), (9, 9)]))
    size = tuple(data.draw(st.integers(1, side)) for side in shape)
    bits = data.draw(st.sampled_from([(8, 8), (32, 8), (32, 20), (20, 34), (26, 26)]))
    image = data.draw(hnp.arrays(np.int64, shape, elements=st.integers(0, 2 ** bits[0] - 1)))
    kernel = data.draw(hnp.arrays(np.int64, size, elements=st.integers(-(2 ** bits[1]) + 1, 2 ** bits[1] - 1)))
    (found,) = sums.correlations([(image, kernel)])
    windows = np.lib.stride_tricks.sliding_window_view(image, size)
    np.testing.assert_array_equal(found, (windows * kernel).sum(axis=(2, 3)))
    assert found.dtype == np.int64


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


def test_what_is_shared_is_computed_once_and_only_within_the_block(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Array] = []

    def make(values: Array) -> Array:
        calls.append(values)
        return values * 2

    values = np.arange(3)
    with sums.shared():
        assert (sums.once(make, values) == sums.once(make, values.copy())).all() and len(calls) == 1
        sums.once(make, values.astype(float))
        sums.once(make, values + 1)
        assert len(calls) == 3
        with sums.shared():
            sums.once(make, values)
            assert len(calls) == 4
        sums.once(make, values)
        assert len(calls) == 4
    sums.once(make, values)
    sums.once(make, values)
    assert len(calls) == 6


@pytest.mark.parametrize("method", ["ssd", "sad", "ncc", "zncc", "sed"])
def test_shared_sums_change_no_score(method: str) -> None:
    image = np.random.default_rng(3).integers(0, 256, (40, 50)).astype(np.uint8)
    alone = similarity(image, image[10:30, 5:25], method)
    with sums.shared():
        for _ in range(2):
            for other in ("ssd", "ncc", "zncc", "sed"):
                similarity(image, image[10:30, 5:25], other)
            assert np.array_equal(similarity(image, image[10:30, 5:25], method), alone)


def test_correlate_is_the_sum_of_products() -> None:
    rng = np.random.default_rng(4)
    image, template = rng.normal(size=(12, 15, 2)), rng.normal(size=(4, 3, 2))
    windows = np.lib.stride_tricks.sliding_window_view(image, (4, 3), axis=(0, 1))
    expected = np.einsum("rcduv,uvd->rc", windows, template)
    assert np.allclose(sums.correlate(image, template), expected)
    as_vectors = sums.correlate(image[..., 0] + 1j * image[..., 1], template[..., 0] + 1j * template[..., 1])
    assert np.allclose(as_vectors, expected)
    assert sums.correlate([[1, 2, 3]], [[1, 0]]).shape == (1, 2)


@pytest.mark.parametrize("template", [np.ones((13, 3)), np.ones((3, 3, 2)), np.ones((2, 2, 2, 2))])
def test_correlate_refuses_what_does_not_fit(template: Array) -> None:
    with pytest.raises(ValueError, match="template: expected one that fits"):
        sums.correlate(np.ones((12, 15)), template)
