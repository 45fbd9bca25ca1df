"""When a fresh result agrees with the published one, which is then left as it is.

Another machine, or another version of a library, gives other last digits, and the edges of lines another shade. That is
no change, and git should not show one: a metric keeps its row in ``metrics.csv``, and a figure its bytes, unless they
differ by more than this. With a processor's vector instructions switched off, as on another machine, 3 of 33 figures
changed, by at most 2 grey levels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from occlib.base.files import read_image

SHADE_LEVELS = 16
"""Grey levels of 255 by which a pixel may differ: what rounding does to the edge of a line, and nobody sees."""

SHADE_MEAN_LEVELS = 0.02
"""Grey levels by which the whole picture may differ on average (0.001 was measured). Five levels in a hundredth of the
picture, such as an area whose colour was changed on purpose, make 0.04."""

FILM_MEAN_LEVELS = 0.5
"""The same for a frame of a film, which is kept with losses. An object of 12 x 12 px in another place makes more."""

OTHER_PIXELS = 8
"""Pixels that may differ by more: a dot or an edge that rounding moved to the next pixel. The smallest digits that
figures have, of 7 pt at 120 dpi, differ from one another in 30 pixels or more."""


def metric_agrees(fresh: Mapping[str, str], published: Mapping[str, str]) -> bool:
    """Whether two rows of ``metrics.csv`` have one unit and their values differ by the published tolerance at most."""
    difference = abs(float(fresh["value"]) - float(published["value"]))
    return fresh["unit"] == published["unit"] and difference <= float(published["tolerance"]) * (1 + 1e-9)


def row_stays(fresh: Mapping[str, str], published: Mapping[str, str]) -> bool:
    """Whether the published row is kept: the values agree, and the tolerance was not changed on purpose.

    The tolerance that nobody gave is a millionth of the value and has other last digits, too.
    """
    tolerances = float(fresh["tolerance"]), float(published["tolerance"])
    return metric_agrees(fresh, published) and math.isclose(*tolerances, rel_tol=1e-5)


def figure_agrees(fresh: Path, published: Path) -> bool:
    """Whether two figures show the same: equal in size, no more than shades apart, whatever they say of their making."""
    if fresh.suffix == ".webp":
        return _film_agrees(fresh, published)
    try:
        one, other = (read_image(path, alpha=True).astype(np.int16) for path in (fresh, published))
    except ValueError:  # damaged, or no picture
        return False
    if one.shape != other.shape:
        return False
    difference = np.abs(one - other)
    others = np.count_nonzero(difference.max(axis=2) > SHADE_LEVELS)
    return bool(others <= OTHER_PIXELS and difference.mean() <= SHADE_MEAN_LEVELS)


def _film_agrees(fresh: Path, published: Path) -> bool:
    """Whether two films show the same, frame by frame, but for what another encoder makes of it."""
    from PIL import Image, ImageSequence

    try:
        with Image.open(fresh) as one, Image.open(published) as other:
            frames = [[np.asarray(frame.convert("RGB"), np.int16) for frame in ImageSequence.Iterator(film)]
                      for film in (one, other)]  # fmt: skip
    except OSError:
        return False
    if [frame.shape for frame in frames[0]] != [frame.shape for frame in frames[1]]:
        return False
    return all(np.abs(one - other).mean() <= FILM_MEAN_LEVELS for one, other in zip(*frames, strict=True))
