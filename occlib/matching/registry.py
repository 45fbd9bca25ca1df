"""Measures of your own: a decorator that adds one to the built-in ones, and files that hold some."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray
from occlib.matching.measures import BUILT_IN, METHODS, Array, Method
from occlib.matching.thresholds import THRESHOLDS

RESERVED = ("condition", "criterion", "best", "tied", "area", "low", "high", "statement")
"""Columns that tables have beside those of the measures."""


def matcher(
    name: str,
    *,
    higher_is_better: bool,
    description: str = "",
    default_threshold: Callable[[Array, Array, Array], float] | Literal["otsu", "mad"] = "mad",
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> Callable[[Callable[..., npt.ArrayLike]], Callable[..., npt.ArrayLike]]:
    """Decorator: a measure of your own joins :data:`METHODS`, and with them every table and plot.

    Parameters
    ----------
    name
        How it is called from now on; none of the built-in ones.
    higher_is_better, bounds
        Which direction is better, and the least and largest score.
    description
        A few words for tables; the first line of the docstring by default.
    default_threshold
        The worst score to accept by default: a function of the same three arrays, or see :func:`score_threshold`.

    Notes
    -----
    The function gets the image (H, W, C) and the template (h, w, C), both uint8, uint16 or float64, C being 1 or 3,
    and the mask (h, w), bool or float64 weights up to 1. It returns a finite score for every place, any real type,
    (H - h + 1, W - w + 1).

    Examples
    --------
    >>> @matcher("extreme", higher_is_better=False)
    ... def extreme(image, template, mask):
    ...     "Largest absolute difference."
    ...     windows = np.lib.stride_tricks.sliding_window_view(image, template.shape[:2], axis=(0, 1))
    ...     difference = np.abs(np.moveaxis(windows, 2, -1).astype(float) - template)[:, :, mask > 0]
    ...     return difference.max(axis=(2, 3))
    >>> from occlib.matching.search import similarity
    >>> similarity([[1, 2, 3]], [[2, 4]], "extreme")
    array([[2., 1.]])
    >>> del METHODS["extreme"]
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][\w-]*", name) or name in {*BUILT_IN, *RESERVED}:
        taken = ", ".join((*BUILT_IN, *RESERVED))
        raise ValueError(f"name: expected letters, digits, _ and -, and none of {taken}; got {name!r}")
    if not callable(default_threshold) and default_threshold not in THRESHOLDS:
        known = ", ".join(map(repr, THRESHOLDS))
        raise ValueError(f"default_threshold: expected a function or one of {known}, got {default_threshold!r}")

    def register(function: Callable[..., npt.ArrayLike]) -> Callable[..., npt.ArrayLike]:
        def score(image: Array, template: Array, mask: Array) -> FloatArray:
            try:
                values = np.asarray(function(*map(_read_only, (image, template, mask))), dtype=np.float64)
            except Exception as error:
                raise ValueError(f"{name}: {type(error).__name__}: {error}") from error
            shape = image.shape[0] - template.shape[0] + 1, image.shape[1] - template.shape[1] + 1
            if values.shape != shape:
                raise ValueError(
                    f"{name}: expected a score for each of {shape} places of a template {template.shape[:2]} in an image "
                    f"{image.shape[:2]}, got {values.shape}"
                )
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: expected finite scores, got NaN or infinity")
            return values

        text = description or (function.__doc__ or name).strip().splitlines()[0]
        METHODS[name] = Method(name, text, higher_is_better, score, default_threshold, bounds=bounds)
        return function

    return register


def load_matchers(path: str | Path) -> dict[str, Method]:
    """Run a Python file that registers matchers (:func:`matcher`).

    Their functions travel to worker processes by value, with whatever of the file they use; modules that they import
    must be installed there.

    Parameters
    ----------
    path
        The file. It is run with the rights of this process: only give a file that you trust.

    Returns
    -------
    dict
        The matchers that are new, by name.

    Raises
    ------
    ValueError
        In one line: no such file, what went wrong in it, or no matcher in it.
    """
    previous = dict(METHODS)
    try:
        runpy.run_path(str(path))
    except (Exception, SystemExit) as error:
        reason = getattr(error, "strerror", None) if isinstance(error, OSError) else None
        raise ValueError(f"{path}: {reason or ' '.join(f'{type(error).__name__}: {error}'.split())}") from None
    found = {name: method for name, method in METHODS.items() if previous.get(name) is not method}
    if not found:
        raise ValueError(f"{path}: registers no matcher; expected a function under @matching.matcher(...)")
    return found


def _read_only(values: Array) -> Array:
    view = values.view()
    view.flags.writeable = False
    return view
