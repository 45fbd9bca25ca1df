"""Template matching: planted targets, sub-pixel positions, measures side by side, wrong arguments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from occlib.matching.measures import METHODS
from occlib.matching.optima import best
from occlib.matching.reference import reference_similarity
from occlib.matching.search import Match, compare, default_threshold, find, similarity
from occlib.matching.thresholds import score_threshold

Array = npt.NDArray[Any]
IMAGE = np.arange(30.0).reshape(5, 6)
every_method = pytest.mark.parametrize("method", list(METHODS))


@every_method
@pytest.mark.parametrize("tail", [(), (3,)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_a_planted_target_is_found_at_its_place(
    textured: Callable[..., Array], method: str, tail: tuple[int, ...], kind: type
) -> None:
    image: Array = textured((90, 120, *tail)).astype(kind)
    template = image[31:61, 47:87].copy()
    score = similarity(image, template, method)
    assert best(score, method) == (31, 47)
    assert score[31, 47] == pytest.approx(1.0 if METHODS[method].higher_is_better else 0.0, abs=1e-12)
    match = find(image, template, method)[0]
    assert (match.x, match.y, match.width, match.height) == (47, 31, 40, 30)
    assert match.score == score[31, 47]
    assert match.centre_px == (66.5, 45.5)


@every_method
def test_a_mask_hides_what_differs(textured: Callable[..., Array], method: str) -> None:
    image = textured()
    template = image[30:60, 40:80].copy()
    mask = np.ones(template.shape, bool)
    mask[:14, :14] = False
    template[:10, :10] = 255 - template[:10, :10]  # something stood in front
    assert best(similarity(image, template, method, mask), method) == (30, 40)
    expected = 1.0 if METHODS[method].higher_is_better else 0.0
    assert similarity(image, template, method, mask)[30, 40] == expected
    assert similarity(image, template, method)[30, 40] != expected


@pytest.mark.parametrize(
    "method, gap", [*((name, gap) for name in METHODS if name != "sed" for gap in (0, 1, 30)), ("sed", 30)]
)
def test_two_targets_give_one_match_each(
    robot: Array, floor_with_robots: Callable[..., Array], method: str, gap: int
) -> None:
    """Not ``sed`` side by side: halfway between, the edges of both make up a third, false match."""
    image = floor_with_robots((12, 50), (36 + gap, 50))
    matches = find(image, robot, method)
    assert [(match.x, match.y) for match in matches] == [(12, 50), (36 + gap, 50)]


@every_method
def test_best_first(robot: Array, floor_with_robots: Callable[..., Array], method: str) -> None:
    image = floor_with_robots((80, 60), (10, 10))
    image[15:18, 20:24] = 90  # the first in row-major order is no longer the better one
    matches = find(image, robot, method)
    assert [(match.x, match.y) for match in matches] == [(80, 60), (10, 10)]
    costs = [-match.score if METHODS[method].higher_is_better else match.score for match in matches]
    assert costs == sorted(costs) and costs[0] < costs[1]


@every_method
def test_no_target_no_match(robot: Array, method: str) -> None:
    noise = np.random.default_rng(3).normal(120, 3, (90, 120)).round().astype(np.uint8)
    assert find(noise, robot, method) == []


@every_method
@pytest.mark.parametrize("rule", ["components", "nms"])
def test_at_most_so_many_and_those_are_the_best(
    robot: Array, floor_with_robots: Callable[..., Array], method: str, rule: str
) -> None:
    image = floor_with_robots((80, 60), (10, 10), (50, 10))
    image[15:18, 20:24] = 90
    every = find(image, robot, method, rule=rule)
    assert len(every) >= 3
    for count in (1, np.int64(2), 100):
        assert find(image, robot, method, rule=rule, max_count=count) == every[:count]


def waves(x: Any, y: Any) -> Array:
    """A smooth picture that is known between the pixels."""
    return np.asarray(128 + 45 * np.sin(x / 3.1 + 0.4 * np.cos(y / 5)) + 45 * np.cos(y / 3.7 - 0.5 * np.sin(x / 4.3)))


@pytest.mark.parametrize("method, bound", [("ssd", 0.04), ("sad", 0.12), ("ncc", 0.04), ("zncc", 0.04)])
def test_a_known_shift_is_found_to_a_fraction_of_a_pixel(method: str, bound: float) -> None:
    y, x = np.mgrid[:60, :70].astype(float)
    ty, tx = np.mgrid[:21, :24].astype(float)
    for dx, dy in [(0.0, 0.0), (0.25, -0.4), (-0.3, 0.45), (0.1, 0.2)]:
        template = waves(tx + 27 + dx, ty + 19 + dy)
        for f, t in (
            (waves(x, y), template),
            (waves(x, y).round().astype(np.uint8), template.round().astype(np.uint8)),
        ):
            match = find(f, t, method, subpixel=True)[0]
            assert abs(match.x - 27 - dx) < bound and abs(match.y - 19 - dy) < bound
            whole = find(f, t, method)[0]
            assert (whole.x, whole.y) == (27, 19) and match.score == whole.score


def test_an_edge_distance_is_refined_by_half_a_pixel_at_most(
    robot: Array, floor_with_robots: Callable[..., Array]
) -> None:
    matches = find(floor_with_robots((40, 30)), robot, "sed", subpixel=True)
    assert abs(matches[0].x - 40) <= 0.5 and abs(matches[0].y - 30) <= 0.5


def test_corners_by_hand() -> None:
    """Turned by 90 degrees counter-clockwise as seen, the top-left corner is at the bottom left."""
    match = Match(10, 20, 0.0, 4, 2)
    assert match.centre_px == (11.5, 20.5)
    np.testing.assert_allclose(match.corners_px, [[9.5, 19.5], [13.5, 19.5], [13.5, 21.5], [9.5, 21.5]])
    turned = Match(10, 20, 0.0, 4, 2, angle=90)
    np.testing.assert_allclose(turned.corners_px, [[10.5, 22.5], [10.5, 18.5], [12.5, 18.5], [12.5, 22.5]])


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("rule", ["components", "nms"])
def test_compare_is_similarity_and_find_of_every_measure(
    robot: Array, floor_with_robots: Callable[..., Array], rule: str, masked: bool
) -> None:
    image = floor_with_robots((12, 50), (70, 20))
    mask = np.random.default_rng(1).random((20, 24)) < 0.7 if masked else None
    results = compare(image, robot, mask=mask, rule=rule, max_count=2)
    assert list(results) == list(METHODS)
    for name, result in results.items():
        assert result.method is METHODS[name] and result.seconds > 0
        np.testing.assert_array_equal(result.score, similarity(image, robot, name, mask))
        assert result.matches == find(image, robot, name, mask=mask, rule=rule, max_count=2)
        assert result.threshold == default_threshold(image, robot, name, mask)
    assert list(compare(image, robot, ["zncc", "ssd"])) == ["zncc", "ssd"]
    for rule_of_scores in ("otsu", "mad"):
        result = compare(image, robot, ["sad"], threshold=rule_of_scores)["sad"]
        assert result.threshold == score_threshold(result.score, "sad", rule_of_scores)
        assert result.matches == find(image, robot, "sad", rule_of_scores)


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
        ({"method": "zssd"}, "method: expected one of ssd, .*, got 'zssd'"),
        ({"method": None}, "method: expected one of"),
    ],
)
@pytest.mark.parametrize("function", [similarity, reference_similarity, find, default_threshold])
def test_wrong_arguments(function: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        function(**{"image": IMAGE, "template": np.array([[1.0, 2.0], [3.0, 5.0]]), **arguments})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"rule": "peaks"}, "rule: expected one of components, nms, got 'peaks'"),
        *(
            ({"max_count": count}, "max_count: expected a whole number >= 1 or None, got")
            for count in (0, -1, 1.5, True, "2")
        ),
        *(
            ({"pyramid": levels}, "pyramid: expected a whole number from 0 to 8, got")
            for levels in (-1, 9, 1.0, True, None)
        ),
        *(
            ({"angles": a}, "angles: expected one or more finite numbers, got")
            for a in ([], [np.nan], "a", [[1]], [True])
        ),
        *(({"scales": s}, "scales: expected one or more finite numbers, got") for s in ([], [np.inf], None, [1j])),
        ({"scales": [1, 0]}, "scales: expected numbers > 0, got 0"),
        ({"scales": [-2]}, "scales: expected numbers > 0, got -2"),
        (
            {"scales": [9]},
            r"scales: expected a template, turned and scaled, with .* than the image \(5, 6\); none of 1 is",
        ),
    ],
)
def test_wrong_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        find(IMAGE, IMAGE[:2, :2], "ssd", **options)
    assert "\n" not in str(caught.value)


def test_compare_refuses_what_its_parts_refuse() -> None:
    for options, message in [
        ({"methods": ["ssd", "sift"]}, "method: expected one of ssd, .*, got 'sift'"),
        ({"threshold": 7}, "threshold: expected -1 to 1 for ncc, got 7"),
        ({"rule": "x"}, "rule: expected"),
        ({"max_count": 0}, "max_count: expected"),
        ({"mask": np.zeros((2, 2))}, "mask: expected"),
    ]:
        with pytest.raises(ValueError, match=message):
            compare(IMAGE, IMAGE[:2, :2], **options)  # type: ignore[arg-type]
