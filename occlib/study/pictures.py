"""The measures compared on two picture files of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from occlib.base.files import read_image, write_file
from occlib.foreground.intensity import to_grey
from occlib.matching.search import Comparison, compare
from occlib.plotting import figure_png
from occlib.study.charts import comparison_figure
from occlib.study.sweeps import load_matchers


def compare_pictures(
    image: str | Path,
    template: str | Path,
    methods: Sequence[str] | None = None,
    *,
    mask: str | Path | None = None,
    threshold: str | float | None = None,
    rule: str = "components",
    colour: bool = False,
    matchers: str | Path | None = None,
    out: str | Path | None = None,
) -> dict[str, Comparison]:
    """Look for a template in an image with each measure, and draw what each found.

    Parameters
    ----------
    image, template
        Picture files, read as 8 bit, grey unless ``colour``.
    methods
        Names of measures; those of the paper by default.
    mask
        A picture file of the template's size: weights of its pixels, black does not count.
    threshold, rule
        As in :func:`occlib.matching.compare`.
    matchers
        A Python file that registers measures of one's own first.
    out
        Where to write :func:`comparison_figure` of it, a PNG.

    Returns
    -------
    ``{method: Comparison}``, see :func:`occlib.study.comparison_table`.

    Raises
    ------
    ValueError
        In one line: a file that cannot be read or written, or a wrong argument.
    """
    if matchers is not None:
        load_matchers(matchers)
    scene, pattern = (read_image(path) if colour else to_grey(read_image(path)) for path in (image, template))
    weights = None if mask is None else to_grey(read_image(mask))
    results = compare(scene, pattern, methods, threshold=threshold, mask=weights, rule=rule)
    if out is not None:
        write_file(out, figure_png(comparison_figure(scene, pattern, results)))
    return results
