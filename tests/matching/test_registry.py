"""Measures of your own: what they may do, what is checked, and files that hold some."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import numpy.typing as npt
import pytest

from occlib.matching import measures
from occlib.matching.measures import METHODS
from occlib.matching.reference import reference_similarity
from occlib.matching.registry import load_matchers, matcher
from occlib.matching.search import compare, default_threshold, find, similarity
from occlib.matching.thresholds import score_threshold

Array = npt.NDArray[Any]
IMAGE = np.arange(30.0).reshape(5, 6)


@pytest.fixture(autouse=True)
def built_in_measures_only() -> Iterator[None]:
    yield
    for name in [name for name in METHODS if name not in measures.BUILT_IN]:
        del METHODS[name]


@pytest.fixture
def extreme() -> str:
    @matcher("extreme", higher_is_better=False, default_threshold=lambda f, t, m: 25.0, bounds=(0, np.inf))
    def largest(image: Array, template: Array, mask: Array) -> Array:
        """Largest absolute difference.

        More than one line.
        """
        windows = np.lib.stride_tricks.sliding_window_view(image, template.shape[:2], axis=(0, 1))
        difference = np.abs(np.moveaxis(windows, 2, -1).astype(float) - template)[:, :, mask > 0]
        return np.asarray(difference.max(axis=(2, 3)).astype(np.float32))

    return "extreme"


def test_a_measure_of_ones_own_joins_all_the_others(
    robot: Array, floor_with_robots: Callable[..., Array], extreme: str
) -> None:
    image = floor_with_robots((12, 50), (70, 20))
    assert list(METHODS)[-1] == extreme and METHODS[extreme].description == "Largest absolute difference."
    score = similarity(image, robot, extreme)
    assert score.dtype == np.float64 and score.shape == (71, 97) and score[50, 12] == 0
    places = [(12, 50), (70, 20)]
    expected = sorted(places, key=lambda place: place[::-1])
    assert [(match.x, match.y) for match in find(image, robot, extreme)] == expected
    assert [(match.x, match.y) for match in find(image, robot, extreme, pyramid=2)] == expected
    assert [(match.x, match.y) for match in compare(image, robot)[extreme].matches] == expected
    assert default_threshold(image, robot, extreme) == 25
    with pytest.raises(ValueError, match="threshold: expected 0 to inf for extreme, got -1"):
        find(image, robot, extreme, -1)
    with pytest.raises(ValueError, match=r"method: expected one of ssd, .*, got 'extreme'"):
        reference_similarity(image, robot, extreme)


def test_a_measure_of_ones_own_by_default_takes_the_threshold_mad(
    robot: Array, floor_with_robots: Callable[..., Array], extreme: str
) -> None:
    @matcher("own", higher_is_better=True, description="minus the largest")
    def own(image: Array, template: Array, mask: Array) -> Array:
        return -METHODS[extreme].score(image, template, mask)

    image = floor_with_robots((12, 50))
    score = similarity(image, robot, "own")
    assert METHODS["own"].description == "minus the largest"
    assert default_threshold(image, robot, "own") == score_threshold(score, "own", "mad")
    assert [(match.x, match.y) for match in find(image, robot, "own", -25)] == [(12, 50)]
    assert find(image, robot, "own") == find(image, robot, "own", "mad")
    assert own(np.zeros((3, 3, 1)), np.zeros((1, 1, 1)), np.ones((1, 1), bool)).shape == (3, 3)  # still the function

    matcher("own", higher_is_better=False, default_threshold="otsu")(METHODS[extreme].score)  # once more, another
    assert not METHODS["own"].higher_is_better
    assert compare(image, robot, ["own"])["own"].threshold == score_threshold(-score, "own", "otsu")


def test_own_measures_search_turned_templates_without_the_pyramid(textured: Callable[..., Array], extreme: str) -> None:
    """Nothing is known of what they do with a smaller picture."""
    image = textured()
    image[40:80, 60:90] = np.rot90(image[:30, :40])
    full = find(image, image[:30, :40], extreme, angles=(0, 90), subpixel=True)
    assert [match.angle for match in full] == [0, 90]
    assert find(image, image[:30, :40], extreme, angles=(0, 90), subpixel=True, pyramid=2) == full


@pytest.mark.parametrize(
    "wrong", [np.zeros((2, 2)), np.zeros((4, 5, 1)), np.full((4, 5), np.nan), np.full((4, 5), np.inf), None, 0.0]
)
def test_scores_of_ones_own_are_checked(wrong: Any) -> None:
    matcher("wrong", higher_is_better=False)(lambda image, template, mask: wrong)
    with pytest.raises(
        ValueError, match=r"^wrong: expected (a score for each of \(4, 5\) places .*, got \(|finite scores, got NaN)"
    ):
        similarity(IMAGE, np.ones((2, 2)), "wrong")


@pytest.mark.slow
def test_a_method_survives_the_way_to_another_process(
    robot: Array, floor_with_robots: Callable[..., Array], extreme: str
) -> None:
    image = floor_with_robots((12, 50))
    script = "import pickle, sys; f, t, m, method = pickle.load(sys.stdin.buffer); sys.stdout.buffer.write(pickle.dumps(method.score(f, t, m)))"
    arrays = image[:, :, None], robot[:, :, None], np.ones((20, 24), bool)
    for method in METHODS.values():
        copy = cloudpickle.loads(cloudpickle.dumps(method))
        assert (copy.name, copy.bounds, copy.higher_is_better) == (method.name, method.bounds, method.higher_is_better)
        prepared, [pair] = copy.prepare(arrays[0], [arrays[1:]])
        np.testing.assert_array_equal(copy.score(prepared, *pair), similarity(image, robot, method.name))
    sent = cloudpickle.dumps((*arrays, METHODS[extreme]))
    there = subprocess.run([sys.executable, "-c", script], input=sent, capture_output=True, check=True)
    np.testing.assert_array_equal(pickle.loads(there.stdout), similarity(image, robot, extreme))


# ---------------------------------------------------------------- what a matcher of your own may not do


def test_a_matcher_cannot_write_into_the_pictures(textured: Callable[..., Array]) -> None:
    image = textured()
    try:

        @matcher("vandal", higher_is_better=False)
        def vandal(image: Array, template: Array, mask: Array) -> Array:
            image[:] = 0
            return image

        with pytest.raises(ValueError, match="vandal: ValueError: assignment destination is read-only"):
            similarity(image, image[:20, :20], "vandal")
    finally:
        METHODS.pop("vandal", None)
    assert image.any()


@pytest.mark.parametrize("name", ["ssd", "sed", "best", "statement", "", "a b", "../x", "1st", None, 3])
def test_names_that_a_matcher_cannot_have(name: Any) -> None:
    with pytest.raises(ValueError, match="name: expected letters, digits, _ and -, and none of ssd, sad"):
        matcher(name, higher_is_better=True)


@pytest.mark.parametrize("call", [default_threshold, find, lambda f, t, name: compare(f, t, [name])])
def test_a_default_threshold_outside_the_bounds_is_told_once(call: Callable[..., Any]) -> None:
    @matcher("distance", higher_is_better=False, bounds=(0, np.inf))
    def distance(image: Array, template: Array, mask: Array) -> Array:
        windows = np.lib.stride_tricks.sliding_window_view(image[..., 0], template.shape[:2])
        return np.abs(windows - template[..., 0]).mean(axis=(2, 3))

    expected = r"distance: its default threshold is -\d+(\.\d+)?, outside its bounds 0 to inf, so it accepts nothing"
    with pytest.warns(UserWarning, match=expected) as told:
        call(IMAGE, IMAGE[1:3, 1:3], "distance")
        call(IMAGE, IMAGE[1:3, 1:3], "distance")
    assert len(told) == 1
    assert find(IMAGE, IMAGE[1:3, 1:3], "distance", "mad") == []  # asked for: no warning


@pytest.mark.parametrize("threshold", [5, None, "half"])
def test_a_default_threshold_is_a_function_or_a_known_name(threshold: Any) -> None:
    with pytest.raises(ValueError, match="default_threshold: expected a function or one of 'otsu', 'mad', got"):
        matcher("own", higher_is_better=True, default_threshold=threshold)


# ---------------------------------------------------------------- files that hold matchers


def test_a_file_of_matchers_tells_which_are_new(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from occlib.matching import matcher\n"
        "for name in ('one', 'other'):\n"
        "    matcher(name, higher_is_better=False)(lambda f, t, m: 0 * f[: 1 - len(t) or None, : 1 - t.shape[1] or None, 0])\n"
    )
    found = load_matchers(tmp_path / "mine.py")
    assert list(found) == ["one", "other"] and METHODS["one"] is found["one"]
    assert similarity(IMAGE, IMAGE[:2, :2], "other").shape == (4, 5)
    assert list(load_matchers(tmp_path / "mine.py")) == ["one", "other"]  # registered once more, by other functions


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("x = 1", "registers no matcher; expected a function under @matching.matcher"),
        ("x = ", r"SyntaxError: invalid syntax \(mine.py, line 1\)"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("exit(2)", "SystemExit: 2"),
    ],
)
def test_matchers_that_do_not_run(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "mine.py").write_text(content)
    with pytest.raises(ValueError, match=f"mine.py: {message}"):
        load_matchers(tmp_path / "mine.py")


def test_a_file_of_matchers_that_is_not_there() -> None:
    with pytest.raises(ValueError, match=r"^nowhere.py: No such file or directory$"):
        load_matchers("nowhere.py")
