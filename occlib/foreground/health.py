"""Cameras that cannot be trusted at an instant: missing, black, covered, frozen, or in light that nothing explains.

A view that shows nothing of the floor would say "free" everywhere, and a frozen one what was there once. Found
here, it can be left out and reported, and what only it sees is unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base import checks
from occlib.base.arrays import Image, Mask
from occlib.foreground.background import Background, as_background
from occlib.foreground.intensity import to_grey
from occlib.foreground.pictures import picture_of
from occlib.foreground.reference import reference_of
from occlib.recordings import check_size

SAMPLES = (80, 60)
"""About as many columns and rows of pixels are looked at, whatever the picture's size: cheap, and plenty."""


BLOCKS = (8, 6)
"""Columns and rows of blocks in which structure is looked for, so that one cluttered corner does not speak for all."""


EDGES = 8
"""Steps between neighbouring samples by which a block is recognised: the background's steadiest."""


AGREE = 6
"""Of the ``EDGES`` steps, as many must be there for a block to be recognised; a patterned cloth has 2 or 3 by chance."""


STEP_RANGE = (0.3, 3.0)
"""A step is there if it is within these times the background's: gains of 0.6 to 1.5, and noise, stay inside."""


LEAST_STEP = 6.0
"""Grey levels, and twice the background's noise, that a step has at least: fainter ones drown in the noise."""


LEAST_BLOCKS = 12
"""Structure in fewer of the 48 blocks is no basis: one object may hide it all. The lab's views have 37 and more."""


LOST = 0.2
"""A view is covered when no more than this share of its blocks is recognised. Measured on ``data/lab`` and ufes-lab: all
frames have 0.70 and more, with gain 1.5 and offset 30 (much is white) 0.45, trembling by 3 px 0.44, behind anything over
half of the view 0.36, behind a crowd over two thirds 0.22 (one of 168: 0.17). A plain cover over nine tenths leaves at
most 0.19, one with a coarse pattern 0.18 in 95 of 100 places, and over everything 0.06 and 0.12."""


DARK = 0.15
"""Of the background's mean level; a picture below is black rather than covered. A dark room is dark in both."""


FLAT = 0.2
"""Of the background's standard deviation: below, and the background's being 10 grey levels or more, a picture is
uniform. Used where the background has too little structure for anything better."""


SAME = 1e-3
"""Share of the sampled values that may differ in a repeated picture: a codec may touch up a few. Of two frames in a row
of ufes-lab (H.264) 0.2 of the pixels differ, of ``data/lab`` 0.7, of a nearly noise-free room in MPEG-4 0.009. A frozen
picture that is encoded anew in MPEG-4 changes in 0.001 to 0.05 and is not found: a quiet room looks the same."""


LEAST_FLOOR = 0.1
"""Share of the blocks of light that are floor by their texture, at least: fewer say nothing."""


UNLIT = 0.5
"""A view whose floor, as far as its texture tells it, is to a larger share in light that is not known is in no usable light. Measured on six
development rooms, four_robots and wooden_room, two views each: 0.00 to 0.07 as they are, up to 0.18 with a lamp over half of the picture or a
shaded patch; spots of coloured light 0.94 and more, a spotlight or stripes of sun mostly 0.5 and more."""


class CameraMonitor:
    """Watches the cameras of a rig from one instant to the next.

    Every decision is relative to the camera's background: a dark room is not black, and a bare one not covered. What is
    compared is structure, the steps between neighbouring samples, so that light and exposure (gain 0.6 to 1.5, offset
    +-30 grey levels) do not matter, nor a camera bumped by some px. One that was turned away has lost its structure and counts as covered.

    Parameters
    ----------
    backgrounds
        For each camera a ``Background``, or a uint8 RGB picture of the empty floor.
    repetitions
        A camera is frozen from so many repetitions of a picture in a row on, at least 1. Choose more if one camera delivers
        fewer frames a second than the others.

    Raises
    ------
    ValueError
        No background, one that is not uint8 RGB (H, W, 3), or ``repetitions`` below 1.

    Examples
    --------
    >>> from occlib.recordings import open_recording
    >>> recording = open_recording("robot")
    >>> monitor = CameraMonitor({name: images[0] for name, images in recording.background_images().items()})
    >>> _, images = next(recording.images())
    >>> monitor.check(images)
    {}
    >>> monitor.check({"left": images["left"] // 10})
    {'left': 'black', 'right': 'missing'}
    """

    def __init__(self, backgrounds: Mapping[str, Background | npt.ArrayLike], *, repetitions: int = 3) -> None:
        if not backgrounds:
            raise ValueError("backgrounds: expected one for every camera, got none")
        self.repetitions = checks.whole("repetitions", repetitions, least=1)
        self._views = {name: _View(as_background(background)) for name, background in backgrounds.items()}
        self._last: dict[str, Image] = {}
        self._repeated = dict.fromkeys(self._views, 0)

    def check(self, images: Mapping[str, Image | None]) -> dict[str, str]:
        """The cameras that cannot be used at this instant, and why; to be called once per instant, in order.

        Parameters
        ----------
        images
            ``{camera: uint8 RGB (H, W, 3)}``; a camera that has dropped out is absent or ``None``. Cameras without a
            background are ignored.

        Returns
        -------
        ``{camera: reason}`` in the order of the backgrounds, empty if all is well. The reasons:

        - ``"missing"``: no picture.
        - ``"black"``: the structure of the background is gone, and the picture is dark against it.
        - ``"covered"``: the structure is gone from more than four fifths of the view.
        - ``"light"``: the structure is there, under light that the background cannot be predicted in: stripes of sun, coloured spots,
          a picture that is mostly white. Objects cannot be told from it.
        - ``"frozen"``: the picture has been repeated ``repetitions`` times while another camera's changed. Instants at which
          no picture changes do not count: a paused recording is not frozen, nor is ever a single camera. A picture
          that changes is usable at once.

        Raises
        ------
        ValueError
            A picture has the wrong size or dtype. The instant then does not count.
        """
        present = {name: image for name in self._views if (image := images.get(name)) is not None}
        for name, image in present.items():
            check_size(image, self._views[name].size, f"image of {name}")
        samples = {name: self._views[name].sample(image) for name, image in present.items()}
        changed = {name for name, sample in samples.items() if not _same(sample, self._last.get(name))}
        for name, sample in samples.items():
            if name in changed:  # else the first of the run stays, so that slow change adds up
                self._last[name], self._repeated[name] = sample, 0
            elif changed:
                self._repeated[name] += 1
        reasons = {name: self._reason(name, present.get(name), samples.get(name)) for name in self._views}
        return {name: reason for name, reason in reasons.items() if reason}

    def _reason(self, name: str, image: Image | None, sample: Image | None) -> str:
        if image is None or sample is None:
            return "missing"
        frozen = "frozen" if self._repeated[name] >= self.repetitions else ""
        return self._views[name].loss(image, sample) or frozen


class _View:
    """What one camera's picture is held against: its background's level, contrast and steps."""

    def __init__(self, background: Background) -> None:
        height, width = background.grey.shape
        self.size = (width, height)
        self._step = max(1, min(width // SAMPLES[0], height // SAMPLES[1]))
        grey = to_grey(self.sample(background.image))
        self._mean, self._deviation = float(grey.mean()), float(grey.std())
        by = self._step // 2
        shaken = [np.roll(background.image, shift, (0, 1)) for shift in ((by, 0), (-by, 0), (0, by), (0, -by))]
        self._background = background
        self._reference = reference_of(self.sample(background.image), background.noise, None)
        self._from, self._to = _steps_to_watch(
            [grey, *(to_grey(self.sample(image)) for image in shaken)], max(LEAST_STEP, 2.0 * background.noise)
        )
        steps = self._steps(grey)
        self._sign, size = np.sign(steps), np.abs(steps)
        self._low, self._high = STEP_RANGE[0] * size, STEP_RANGE[1] * size

    def sample(self, image: Image) -> Image:
        """One pixel in ``step`` x ``step``, uint8 RGB: a copy, as the caller may use the picture's memory again."""
        step = self._step
        return image[step // 2 :: step, step // 2 :: step].copy()

    def loss(self, image: Image, sample: Image) -> str:
        """``"black"``, ``"covered"``, ``"light"``, or nothing."""
        reason = self._loss(sample)
        if reason and any(shift := self._shift(image)):
            x, y = np.rint(shift).astype(int)
            reason = self._loss(self.sample(np.roll(image, (-y, -x), (0, 1))))
        return reason

    def _loss(self, sample: Image) -> str:
        grey = to_grey(sample)
        dark = bool(grey.mean() < DARK * self._mean)
        if len(self._from) >= LEAST_BLOCKS:
            lost = bool(self._there(grey).mean() <= LOST)
        else:
            lost = dark or bool(self._deviation >= 10.0 and grey.std() < FLAT * self._deviation)
        if lost:
            return "black" if dark else "covered"
        return "light" if self._unexplained(sample) > UNLIT else ""

    def _there(self, grey: Image) -> Mask:
        """Which blocks are recognised."""
        steps = self._steps(grey) * self._sign
        return np.asarray(((steps >= self._low) & (steps <= self._high)).sum(axis=1) >= AGREE)

    def _shift(self, image: Image) -> tuple[float, float]:
        """By how many px the camera was bumped."""
        return self._background.reference.shift(picture_of(image))

    def _unexplained(self, sample: Image) -> float:
        """Of the blocks that are floor by their texture, the share whose light is not known."""
        _, light = self._reference.light(picture_of(sample))
        return float((light.floor & ~light.known).sum() / max(light.floor.sum(), LEAST_FLOOR * light.floor.size))

    def _steps(self, grey: Image) -> npt.NDArray[np.int16]:
        levels = grey.ravel().astype(np.int16)
        return levels[self._to] - levels[self._from]


def _steps_to_watch(greys: Sequence[Image], least: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Flat indices of neighbours between which the level steps, (blocks, EDGES) each, for the blocks that have enough.

    Of the steps of ``least`` grey levels in the first picture, those are chosen that stay largest in the others, which
    show the same a few px aside: fine texture would be gone as soon as the camera trembles.
    """
    index = np.arange(greys[0].size).reshape(greys[0].shape)
    first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
    second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
    steps = [levels[second] - levels[first] for levels in (grey.ravel().astype(np.int16) for grey in greys)]
    steady = np.min([step * np.sign(steps[0]) for step in steps], axis=0)
    y, x = np.divmod(first, greys[0].shape[1])
    block = y * BLOCKS[1] // greys[0].shape[0] * BLOCKS[0] + x * BLOCKS[0] // greys[0].shape[1]
    chosen = [np.empty(0, np.intp)]
    for number in range(BLOCKS[0] * BLOCKS[1]):
        inside = np.flatnonzero((block == number) & (np.abs(steps[0]) >= least))
        if len(inside) >= EDGES:
            chosen.append(inside[np.argsort(-steady[inside], kind="stable")[:EDGES]])
    best = np.concatenate(chosen).reshape(-1, EDGES)
    return first[best], second[best]


def _same(sample: Image, last: Image | None) -> bool:
    return last is not None and bool(np.count_nonzero(cv2.absdiff(sample, last)) <= SAME * sample.size)
