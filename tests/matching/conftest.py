"""Pictures that several of the tests look for templates in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[Any]


@pytest.fixture
def robot() -> Array:
    """A 20 x 24 px object with a margin of floor."""
    picture = np.full((20, 24), 120, np.uint8)
    picture[5:15, 5:19] = 30
    picture[7:10, 8:16] = 220
    picture[11:13, 6:10] = 170
    return picture


@pytest.fixture
def floor_with_robots(robot: Array) -> Callable[..., Array]:
    """``floor_with_robots((x, y), ...)``: a 90 x 120 px floor with a robot at each top-left corner."""

    def make(*corners: tuple[int, int]) -> Array:
        image = np.full((90, 120), 120, np.uint8)
        for x, y in corners:
            image[y : y + 20, x : x + 24] = robot
        return image

    return make


@pytest.fixture(scope="session")
def textured() -> Callable[..., Array]:
    """``textured(shape, seed)``: a textured but not periodic uint8 picture, smooth enough to have edges."""

    def make(shape: tuple[int, ...] = (90, 120), seed: int = 0) -> Array:
        coarse = np.random.default_rng(seed).integers(20, 236, (shape[0] // 6 + 1, shape[1] // 6 + 1, *shape[2:]))
        blocks = np.kron(coarse, np.ones((6, 6) + (1,) * (len(shape) - 2), int))
        return np.asarray(blocks[: shape[0], : shape[1]].astype(np.uint8))

    return make
