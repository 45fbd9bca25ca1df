"""Answers of chapter 02, "Subtract the background"."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy import ndimage

from occlib import foreground
from occlib.base.arrays import Image, Mask
from occlib.course.checking import Mistake, exercise, number, numbers
from occlib.course.lessons.subtract_the_background import LabelledView, belt_and_far, labelled_views, noisy_copy
from occlib.foreground import Background
from occlib.recordings import open_recording

FLOOR, PIXEL = np.array([180, 150, 120]), np.array([120, 100, 60])
L1_CHROMA = float(np.abs(PIXEL - PIXEL @ FLOOR / (FLOOR @ FLOOR) * FLOOR).sum())
SIDES = range(1, 17)


@cache
def view_of(camera: str) -> tuple[LabelledView, Background]:
    """The view of instant 1 that the exercises use, and its background."""
    recording = open_recording("robot", [camera])
    (view,) = labelled_views(recording, "robot", [1])
    return view, foreground.average_background(recording.background_images()[camera])


def grey_difference(camera: str, *, size: int = 1, colour: bool = False) -> Image:
    """The difference of that view."""
    view, background = view_of(camera)
    return foreground.smooth(foreground.subtract_background(view.image, background, colour=colour), size=size)


def alpha_and_chroma(pixel: np.ndarray, floor: np.ndarray) -> tuple[float, float]:
    """Brightness ratio, and what of the colour it does not explain."""
    alpha = float(pixel @ floor / (floor @ floor))
    return alpha, float(np.linalg.norm(pixel - alpha * floor))


def kept(values: Image) -> tuple[float, float]:
    """Share of the noise and of the reflection that a filter leaves of the left view's difference."""
    raw, (belt, far) = grey_difference("left"), belt_and_far(view_of("left")[0].silhouette)
    return float(values[far].std() / raw[far].std()), float(values[belt].mean() / raw[belt].mean())


def median_kept() -> tuple[float, float]:
    """What the median filter leaves."""
    return kept(ndimage.median_filter(grey_difference("left"), 5))


def mean_kept() -> float:
    """Share of the mean, not of the spread, that the median filter leaves far from the robot."""
    raw, far = grey_difference("left"), belt_and_far(view_of("left")[0].silhouette)[1]
    return float(ndimage.median_filter(raw, 5)[far].mean() / raw[far].mean())


def left_over() -> tuple[float, float]:
    """Spread and mean themselves, in grey levels, after the median filter."""
    values = ndimage.median_filter(grey_difference("left"), 5)
    belt, far = belt_and_far(view_of("left")[0].silhouette)
    return float(values[far].std()), float(values[belt].mean())


def overlap(
    camera: str = "right", *, size: int = 5, colour: bool = False, threshold: str = "otsu", union: bool = False
) -> float:
    """F-measure of a view under a threshold; with ``union`` intersection over union instead."""
    view, background = view_of(camera)
    values = grey_difference(camera, size=size, colour=colour)
    mask: Mask = values > foreground.threshold_level(values, threshold, noise_floor=background.noise_floor)
    hit = int((mask & view.silhouette).sum())
    return hit / int((mask | view.silhouette).sum()) if union else 2 * hit / int(mask.sum() + view.silhouette.sum())


def shares() -> tuple[float, float]:
    """Of the right view: the share of the silhouette that the mask holds, and of the mask that is robot."""
    view, background = view_of("right")
    values = grey_difference("right", size=5)
    mask = values > foreground.threshold_level(values, "otsu", noise_floor=background.noise_floor)
    hit = int((mask & view.silhouette).sum())
    return hit / int(view.silhouette.sum()), hit / int(mask.sum())


@cache
def smallest_side(noise_floor: float = 0.0, size: int = 1) -> int:
    """The smallest square in the empty difference that Otsu's threshold finds and nothing else."""
    _, background = view_of("left")
    second = noisy_copy(background.image, np.random.default_rng(0))
    nothing = foreground.subtract_background(second, background, colour=False)
    for side in SIDES:
        planted = nothing.copy()
        planted[200 : 200 + side, 300 : 300 + side] = 60
        planted = foreground.smooth(planted, size=size)
        if (planted > foreground.threshold_level(planted, "otsu", noise_floor=noise_floor)).sum() == side**2:
            return side
    raise ValueError("no square is large enough")


exercise(
    "02.1",
    right=number(3.0),
    example=3.0,
    otherwise="Call foreground.threshold_level with the two numbers of the text, and give back what it returns.",
    mistakes=[
        Mistake(
            "That is the noise floor. Does it limit a level that you gave in grey levels, or only one that a rule found?",
            number(8.0),
            example=8.0,
        ),
        Mistake(
            "That is Otsu's level alone, of a picture in which nothing stands. Give the threshold as a number.",
            number(0.0),
            example=0.0,
        ),
    ],
)

exercise(
    "02.2",
    right=numbers(lambda: alpha_and_chroma(PIXEL, FLOOR), rel=0.012),
    example=lambda: alpha_and_chroma(PIXEL, FLOOR),
    otherwise="First the ratio of two scalar products, then the length of what is left of I after alpha B is taken away.",
    mistakes=[
        Mistake(
            "Divide by B · B, not by I · I: alpha says how much of the floor's light is left.",
            lambda answer: number(float(PIXEL @ FLOOR / (PIXEL @ PIXEL)), rel=0.01)(answer[0]),
            example=lambda: (PIXEL @ FLOOR / (PIXEL @ PIXEL), 30.0),
        ),
        Mistake(
            "The chroma is measured from alpha B, not from B: else every shadow would have some.",
            lambda answer: number(float(np.linalg.norm(PIXEL - FLOOR)), rel=0.01)(answer[1]),
            example=lambda: (alpha_and_chroma(PIXEL, FLOOR)[0], np.linalg.norm(PIXEL - FLOOR)),
        ),
        Mistake(
            "That is the chroma squared: take the root.",
            lambda answer: number(lambda: alpha_and_chroma(PIXEL, FLOOR)[1] ** 2, rel=0.01)(answer[1]),
            example=lambda: (alpha_and_chroma(PIXEL, FLOOR)[0], alpha_and_chroma(PIXEL, FLOOR)[1] ** 2),
        ),
        Mistake(
            "Is that the sum of the three absolute differences? The length of a vector is the root of the sum of the squares.",
            lambda answer: number(lambda: L1_CHROMA, rel=0.01)(answer[1]),
            example=lambda: (alpha_and_chroma(PIXEL, FLOOR)[0], L1_CHROMA),
        ),
        Mistake(
            "That alpha is a ratio of sums or means over the channels. It has the scalar product of I and B above, that of B and B below.",
            lambda answer: number(float(PIXEL.sum() / FLOOR.sum()), rel=0.004)(answer[0]),
            example=lambda: (PIXEL.sum() / FLOOR.sum(), 18.0),
        ),
        Mistake(
            "The chroma is one number: the length of the vector of the three differences.",
            lambda answer: np.size(answer[1]) == 3,
            example=lambda: (0.6, PIXEL - 0.6 * FLOOR),
        ),
        Mistake(
            "The other way round: first alpha, then the chroma.",
            numbers(lambda: alpha_and_chroma(PIXEL, FLOOR)[::-1], rel=0.01),
            example=lambda: alpha_and_chroma(PIXEL, FLOOR)[::-1],
        ),
    ],
)

exercise(
    "02.3",
    right=numbers(median_kept, tol=0.005),
    example=median_kept,
    otherwise="Noise: the std in far, filtered over unfiltered. Reflection: the mean in belt, filtered over unfiltered.",
    mistakes=[
        Mistake(
            "Those are grey levels. Divide each by the value of the unfiltered difference.",
            numbers(left_over, rel=0.01),
            example=left_over,
        ),
        Mistake(
            "The other way round: first the noise, then the reflection.",
            numbers(lambda: median_kept()[::-1], tol=0.005),
            example=lambda: median_kept()[::-1],
        ),
        Mistake(
            "That is what the Gaussian leaves. Put the median filter in its place.",
            numbers(lambda: kept(grey_difference("left", size=5)), tol=0.005),
            example=lambda: kept(grey_difference("left", size=5)),
        ),
        Mistake(
            "You filtered the smoothed difference. Begin with the one that is not smoothed.",
            numbers(lambda: kept(ndimage.median_filter(grey_difference("left", size=5), 5)), tol=0.005),
            example=lambda: kept(ndimage.median_filter(grey_difference("left", size=5), 5)),
        ),
        Mistake(
            "Give ratios, not percent.",
            numbers(lambda: 100 * np.array(median_kept()), tol=0.5),
            example=lambda: 100 * np.array(median_kept()),
        ),
        Mistake(
            "Those are the shares that the filter removes. What is left?",
            numbers(lambda: 1 - np.array(median_kept()), tol=0.005),
            example=lambda: 1 - np.array(median_kept()),
        ),
        Mistake(
            "Noise is measured by its spread (std) in far, not by its mean.",
            lambda answer: number(mean_kept, tol=0.005)(answer[0]),
            example=lambda: (mean_kept(), median_kept()[1]),
        ),
    ],
)

exercise(
    "02.4",
    right=number(overlap, tol=2e-4),
    example=overlap,
    otherwise="F is twice the pixels that mask and silhouette share, over the sum of the pixels of both.",
    mistakes=[
        Mistake(
            "Was it the difference of the three channels? The paper's is grey: colour=False.",
            number(lambda: overlap(colour=True), tol=2e-4),
            example=lambda: overlap(colour=True),
        ),
        Mistake("The difference was not smoothed.", number(lambda: overlap(size=1), tol=2e-4), example=lambda: overlap(size=1)),
        Mistake(
            "That is intersection over union. F has the *sum* of the two areas below, and twice the shared one above.",
            number(lambda: overlap(union=True), tol=2e-4),
            example=lambda: overlap(union=True),
        ),
        Mistake("That is the left camera.", number(lambda: overlap("left"), tol=2e-4), example=lambda: overlap("left")),
        Mistake(
            "That is half of Otsu's level.",
            number(lambda: overlap(threshold="half-otsu"), tol=2e-4),
            example=lambda: overlap(threshold="half-otsu"),
        ),
        Mistake(
            "That is in percent; the answer is a number from 0 to 1.",
            number(lambda: 100 * overlap(), tol=0.6),
            example=lambda: 100 * overlap(),
        ),
        Mistake(
            "That is only half of F: the share of the silhouette that the mask holds, or the share of the mask that is robot.",
            lambda answer: any(number(share, tol=2e-4)(answer) for share in shares()),
            example=lambda: shares()[0],
        ),
        Mistake(
            "Close. Give all digits: colour, or no intensity adjustment, changes only the third or the fourth.",
            number(overlap, tol=0.006),
            example=lambda: round(overlap(), 2),
        ),
    ],
)  # fmt: skip

exercise(
    "02.5",
    right=number(smallest_side),
    example=smallest_side,
    otherwise="Count the pixels above foreground.otsu_threshold(planted) for sides from 1 to 16, and compare with side squared.",
    mistakes=[
        Mistake(
            "That is its area in px; the question is for the side.",
            number(lambda: smallest_side() ** 2),
            example=lambda: smallest_side() ** 2,
        ),
        Mistake(
            "That is the smallest side with the noise floor. Use Otsu's level alone.",
            number(lambda: smallest_side(8.0)),
            example=lambda: smallest_side(8.0),
        ),
        Mistake(
            "Did you smooth? Leave `planted` as it is.",
            number(lambda: smallest_side(size=5)),
            example=lambda: smallest_side(size=5),
        ),
        Mistake(
            "One off: with this side, is the number of foreground pixels really the square's?",
            number(lambda: smallest_side(), tol=1),
            example=lambda: smallest_side() - 1,
        ),
    ],
)
