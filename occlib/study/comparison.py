"""One image and one template, from files: what each measure makes of them, and a picture of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from occlib.base.files import read_image, write_file
from occlib.foreground.intensity import to_grey
from occlib.matching.registry import load_matchers
from occlib.matching.search import Comparison, compare
from occlib.plotting import figure_png
from occlib.study.charts import comparison_figure


def compare_pictures(
    image: str | Path,
    template: str | Path,
    out: str | Path,
    *,
    methods: Sequence[str] | None = None,
    matchers: str | Path | None = None,
    threshold: float | str | None = None,
    mask: str | Path | None = None,
    rule: str = "components",
    colour: bool = False,
) -> dict[str, Comparison]:
    """Look for a template in an image with each measure.

    Parameters
    ----------
    image, template
        Picture files, read as 8 bit; the template is no larger than the image.
    out
        Where the picture goes (:func:`occlib.study.charts.comparison_figure`), a file name that ends in ``.png``.
    methods
        Names of measures, by default all.
    matchers
        A file that registers measures of your own, see :func:`occlib.matching.registry.load_matchers`.
    threshold, rule
        As for :func:`occlib.matching.search.compare`.
    mask
        A picture of weights of the template's pixels; black ones do not count.
    colour
        Compare in colour; else in grey.

    Returns
    -------
    dict
        By measure; :func:`occlib.study.charts.comparison_table` makes a table of it.

    Raises
    ------
    ValueError
        In one line: a file that cannot be read or written, or an argument that :func:`occlib.matching.search.compare`
        refuses. Nothing is written then.
    """
    if Path(out).suffix.lower() != ".png":
        raise ValueError(f"out: expected a file name that ends in .png, got {out}")
    if matchers:
        load_matchers(matchers)
    whole, part = (read_image(path) if colour else to_grey(read_image(path)) for path in (image, template))
    weights = to_grey(read_image(mask)) if mask else None
    results = compare(whole, part, methods, threshold=threshold, mask=weights, rule=rule)
    write_file(out, figure_png(comparison_figure(whole, part, results)))
    return results
