"""Tables and drawings of chapter 00: one instant scored, and a long recording run through more than one chain."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from occlib import metrics, plotting, reproduce
from occlib.base.arrays import Image, Mask
from occlib.base.extras import pandas as pd
from occlib.course.drawings import film_frame
from occlib.formats import Truth
from occlib.geometry import Floor, Rig
from occlib.pipeline import FrameResult, Pipeline
from occlib.recordings import Recording
from occlib.tracking import ObjectVector


def draw_input_score_decision(image: Image, difference: Image, mask: Mask, window: tuple[int, int, int, int]) -> Figure:
    """A picture, its difference from the background, and what is called foreground, side by side.

    ``window``: ``(left, right, top, bottom)`` in px, the part that is shown.
    """
    fig, axes = plotting.new_figure(3, width=10, height=3.4)
    plotting.show_image(axes[0], image)
    plotting.show_image(axes[1], difference, vmax=difference.max())
    plotting.show_image(axes[2], mask)
    left, right, top, bottom = window
    for ax, title in zip(axes, ("input: left view", "score: difference", "decision: foreground"), strict=True):
        ax.set_title(title, fontsize=12)
        ax.set(xlim=(left, right), ylim=(bottom, top))
    return fig


def score_maps(
    results: Mapping[str, FrameResult], truth: Truth, frame: int, floor: Floor, *, radius: float
) -> pd.DataFrame:
    """Objects, claimed area and coverage of the map of each result, against the truth of one frame.

    Parameters
    ----------
    results
        By name.
    truth, frame
        What is there, and which of its frames the results show.
    floor
        Of the maps.
    radius
        A detection this close to a true object, in m, counts as found.

    Returns
    -------
    A row for each result: ``objects`` on the map, ``labelled`` and ``found`` ones, ``claimed (m2)``, ``claimed / true`` and
    ``least coverage``, that of the worst covered footprint.
    """
    footprints = [true.footprint for true in truth.frames[frame] if true.footprint is not None]
    rows = {}
    for name, result in results.items():
        claimed = result.map.data == 100
        rows[name] = {
            "objects": len(result.objects),
            "labelled": sum(one.label is not None for one in result.objects),
            "found": metrics.evaluate({frame: result.objects}, truth.select([frame]), radius=radius).tp,
            "claimed (m2)": claimed.sum() * floor.cell_area,
            "claimed / true": metrics.claimed_area_ratio(claimed, floor, footprints),
            "least coverage": metrics.footprint_coverage(claimed, floor, footprints).min(),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


TOLERANCES = {"claimed / true": 0.15, "least coverage": 0.03}


def record_scores(scores: pd.DataFrame, pattern: str) -> None:
    """Keep the counts and ratios of a table of :func:`score_maps`, each as ``pattern.format(row=..., column=...)``."""
    names = {"objects": "objects", "labelled": "labelled", "found": "found", "claimed / true": "claimed_ratio",
             "least coverage": "least_coverage"}  # fmt: skip
    for column in scores.columns.intersection(list(names)):
        values = {pattern.format(row=row, column=names[column]): value for row, value in scores[column].items()}
        reproduce.record_all(values, tolerance=TOLERANCES.get(column))


class Followed(NamedTuple):
    """What :func:`follow` returns.

    Parameters
    ----------
    objects
        ``{chain: {frame: objects}}``.
    images
        The pictures of the kept frames.
    results
        The last chain's results of the kept frames.
    """

    objects: dict[str, dict[int, list[ObjectVector]]]
    images: dict[int, Mapping[str, Image | None]]
    results: dict[int, FrameResult]


def follow(
    recording: Recording, chains: Mapping[str, Pipeline], frames: Iterable[int], *, keep: Iterable[int] = ()
) -> Followed:
    """Run frames of a recording, one after the other, through every chain.

    Parameters
    ----------
    recording
        Its cameras must include those of the chains.
    chains
        New pipelines by name; each gets the pictures of its own cameras.
    frames
        In order.
    keep
        Frames of which pictures and the last chain's results are kept.
    """
    kept = set(keep)
    followed = Followed({name: {} for name in chains}, {}, {})
    for frame, images in recording.images(list(frames)):
        for name, chain in chains.items():
            result = chain.process({camera: images[camera] for camera in chain.rig.cameras}, recording.time(frame))
            followed.objects[name][frame] = result.objects
            if frame in kept:
                followed.images[frame], followed.results[frame] = images, result
    return followed


def film(
    rig: Rig,
    followed: Followed,
    truth: Truth,
    frames: Iterable[int],
    *,
    crops: Mapping[str, tuple[int, int, int, int]],
    window_m: tuple[float, float, float, float],
) -> list[Image]:
    """A picture of views and map, RGB uint8, for each of the frames that was kept; options as in ``views_and_map``."""
    options: dict[str, Any] = {"crops": crops, "window_m": window_m}
    return [
        film_frame(rig, followed.images[frame], followed.results[frame], truth.frames[frame], **options)
        for frame in frames
        if frame in followed.images
    ]


def recall_while_hidden(
    objects: Mapping[str, Mapping[int, list[ObjectVector]]], truth: Truth, camera: str, *, radius: float
) -> pd.DataFrame:
    """How often objects that a camera has wholly hidden are on the map, and how many identities were given.

    Parameters
    ----------
    objects
        ``{name: {frame: objects}}``.
    truth
        With the camera's hidden fractions.
    camera
        The one that loses sight.
    radius
        A detection this close to a true object, in m, counts as found.

    Returns
    -------
    A row for each name: ``recall while hidden`` and ``identities``.
    """
    rows = {}
    for name, found in objects.items():
        bins = metrics.recall_by_hidden_fraction(
            dict(found), truth.select(found), cameras=[camera], edges=(0.0, 0.999, 1.0), radius=radius
        )
        identities = {one.id for vectors in found.values() for one in vectors}
        rows[name] = {"recall while hidden": bins[1]["recall"], "identities": len(identities)}
    return pd.DataFrame.from_dict(rows, orient="index")
