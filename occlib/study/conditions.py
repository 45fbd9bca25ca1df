"""What disturbs a template search, one factor at a time: the table :data:`CONDITIONS`.

A condition carries all that the study must know of it: how it changes a picture and at which moment, what else its
level stands for, where it can be tried, and how it is judged. A new one is one more entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import cv2
import numpy as np

from occlib.base.arrays import Image

Box: TypeAlias = tuple[int, int, int, int]  # x, y of the top-left pixel, width, height in px

Apply: TypeAlias = Callable[[Image, Box, float, np.random.Generator], Image]

CONSTANT_LIGHT, CHANGING_LIGHT = "constant light", "changing light"
"""Groups of conditions, of which the verdicts give the means."""


@dataclass(frozen=True)
class Condition:
    """One factor that makes a template search harder.

    Attributes
    ----------
    name, unit, about
        How it is called, the unit of its levels, and a line for tables.
    clean
        The level that changes nothing.
    levels
        The levels to try, rising.
    apply
        ``apply(image, box, level, rng) -> image`` degrades a grey uint8 picture around ``box``, the target.
    moment
        When that happens: to the ``"scene"``, before the search image is cut from the whole picture, so that what
        turns or shrinks into view is real; in the ``"light"``, before the sensor adds its noise; in the ``"file"``,
        after it.
    under
        Noise (standard deviation, grey levels) beside the sensor's own, under which all levels are tried.
    level_is
        What else the level stands for: the ``"side"`` of the template in px, or the ``"delay"`` in frames between
        template and search image.
    removes_target
        Whether the target is gone at all levels but the clean one: then whatever is accepted is a false alarm.
    group
        The mean of the verdicts that it counts in, or None.
    """

    name: str
    unit: str
    clean: float
    levels: tuple[float, ...]
    about: str
    apply: Apply
    moment: Literal["scene", "light", "file"] = "light"
    under: float = 0.0
    level_is: Literal["side", "delay"] | None = None
    removes_target: bool = False
    group: str | None = CONSTANT_LIGHT

    def side(self, level: float, otherwise: int) -> int:
        """Side of the template in px: the level, or ``otherwise`` where that stands for something else."""
        return int(level) if self.level_is == "side" else otherwise

    def delay(self, level: float) -> int:
        """Frames between template and search image."""
        return int(level) if self.level_is == "delay" else 0

    def suits(self, side: int, *, filmed: bool) -> bool:
        """Whether it can be tried with templates of this side, on a source that is ``filmed`` (objects move) or not."""
        return {"side": side == self.clean, "delay": filmed, None: True}[self.level_is]

    def degrade(self, moment: str, image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
        """The picture after this moment: changed if it is the condition's and the level is not the clean one."""
        return self.apply(image, box, level, rng) if moment == self.moment and level != self.clean else image

    def is_undisturbed(self, level: float) -> bool:
        """Whether the search image is the clean one, without the noise that some conditions are tried under."""
        return level == self.clean and not self.under

    @property
    def worst_first(self) -> bool:
        """Whether low levels are the bad ones, as of a quality."""
        return self.clean == max(self.levels)

    @property
    def few_levels(self) -> tuple[float, ...]:
        """Clean, both ends and the middle, for a fast run."""
        levels = self.levels
        return tuple(x for x in levels if x in (self.clean, levels[0], levels[len(levels) // 2], levels[-1]))


def _bytes(values: Any) -> Image:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _ramp(image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
    return _bytes(image * np.linspace(1 - level, 1 + level, image.shape[1]))


def _noise(image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
    return _bytes(image + level * rng.standard_normal(image.shape))


def _turn(image: Image, box: Box, angle: float, scale: float) -> Image:
    """Turn (degrees, anticlockwise as seen) and scale about the centre of the box."""
    centre = box[0] + (box[2] - 1) / 2, box[1] + (box[3] - 1) / 2
    if scale < 1:  # as a camera farther away would see it: without aliasing
        image = cv2.GaussianBlur(image, (0, 0), 0.5 * np.sqrt(scale**-2 - 1))
    warp = cv2.getRotationMatrix2D(centre, angle, scale)
    return cv2.warpAffine(image, warp, image.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def _elsewhere(image: Image, box: Box, rng: np.random.Generator) -> Image:
    """A piece of the picture as large as the box, drawn from those that do not overlap it, or else barely do."""
    x, y, w, h = box
    corners = rng.integers(0, [image.shape[1] - w + 1, image.shape[0] - h + 1], (200, 2))
    gap = np.maximum(abs(corners[:, 0] - x) / w, abs(corners[:, 1] - y) / h)
    column, row = corners[np.argmax(gap >= 1) if (gap >= 1).any() else np.argmax(gap)]
    return image[row : row + h, column : column + w]


def _occlude(image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
    """From one side, drawn at random, another piece of the picture moves over the box: exact to one pixel."""
    x, y, w, h = box
    other, side, changed = _elsewhere(image, box, rng), int(rng.integers(4)), image.copy()
    covered = np.rot90(np.arange(w * h).reshape(h, w) < round(level * w * h), side) if w == h else None
    if covered is None:
        raise ValueError(f"box: expected a square to occlude, got {w} x {h} px")
    changed[y : y + h, x : x + w][covered] = other[covered]
    return changed


def _clutter(image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
    """Look-alikes: the target mirrored or turned by quarters, pasted where they do not cover it."""
    x, y, w, h = box
    changed, piece = image.copy(), image[y : y + h, x : x + w]
    for _ in range(round(level)):
        kind = int(rng.integers(1, 8))  # the symmetries of the square but for the identity
        corners = rng.integers(0, [image.shape[1] - w + 1, image.shape[0] - h + 1], (50, 2))
        free = (abs(corners - (x, y)) >= (w, h)).any(axis=1)
        if free.any():  # a large template in the middle leaves no room
            column, row = corners[np.argmax(free)]
            changed[row : row + h, column : column + w] = np.rot90(piece[:, ::-1] if kind > 3 else piece, kind % 4)
    return changed


def _jpeg(image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(level)])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE))


def _remove(image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
    """Another piece of the picture covers the target and a quarter of its size around it."""
    x, y, w, h = box
    x0, y0, x1, y1 = max(x - w // 4, 0), max(y - h // 4, 0), x + w + w // 4, y + h + h // 4
    changed = image.copy()
    hole = changed[y0:y1, x0:x1]
    hole[:] = _elsewhere(image, (x0, y0, hole.shape[1], hole.shape[0]), rng)
    return changed


def _nothing(image: Image, box: Box, level: float, rng: np.random.Generator) -> Image:
    return image  # the level is the side of the template or a delay


CONDITIONS: dict[str, Condition] = {
    condition.name: condition
    for condition in (
        Condition("gain", "factor", 1, (0.4, 0.6, 0.8, 1, 1.25, 1.6, 2), "grey levels multiplied, clipped",
                  lambda image, box, level, rng: _bytes(level * image.astype(float)), group=CHANGING_LIGHT),
        Condition("offset", "grey levels", 0, (-80, -40, -20, 0, 20, 40, 80), "grey levels added, clipped",
                  lambda image, box, level, rng: _bytes(image + float(level)), group=CHANGING_LIGHT),
        Condition("gradient", "share", 0, (0, 0.2, 0.4, 0.6, 0.8), "gain 1 - level at the left border of the search "
                  "image, rising linearly to 1 + level at the right one, clipped", _ramp,
                  group=CHANGING_LIGHT),
        Condition("noise", "grey levels", 0, (0, 10, 20, 40, 80), "standard deviation of Gaussian noise", _noise),
        Condition("blur", "px", 0, (0, 1, 2, 4, 6), "standard deviation of a Gaussian blur",
                  lambda image, box, level, rng: cv2.GaussianBlur(image, (0, 0), level)),
        Condition("occlusion", "share", 0, (0, 0.2, 0.4, 0.6, 0.8), "share of the target covered by another piece of "
                  "the picture", _occlude),
        Condition("rotation", "degrees", 0, (0, 5, 10, 20, 30, 45), "picture turned about the target",
                  lambda image, box, level, rng: _turn(image, box, level, 1.0), moment="scene"),
        Condition("scale", "factor", 1, (0.6, 0.8, 0.9, 1, 1.1, 1.25, 1.6), "picture scaled about the target",
                  lambda image, box, level, rng: _turn(image, box, 0.0, level), moment="scene"),
        Condition("clutter", "count", 0, (0, 2, 4, 8, 16), "mirrored or turned copies of the target, under noise of "
                  "40 grey levels", _clutter, under=40),
        Condition("jpeg", "quality", 100, (2, 5, 10, 30, 100), "JPEG quality; 100 stands for not compressed", _jpeg,
                  moment="file"),
        Condition("side", "px", 48, (16, 32, 48, 64, 96, 128), "side of the square template, under noise of 40 grey "
                  "levels", _nothing, under=40, level_is="side"),
        Condition("time", "frames", 0, (0, 4, 8, 16, 32), "frames (0.1 s) between template and search image; "
                  "only where objects move", _nothing, level_is="delay", group=None),
        Condition("absent", "yes or no", 0, (0, 1), "the target is covered: whatever is accepted is a false alarm",
                  _remove, moment="scene", removes_target=True, group=None),
    )
}  # fmt: skip
"""The conditions by name. Add a :class:`Condition` to study one of your own."""
