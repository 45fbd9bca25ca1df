"""Chapter 09: messages that are refused or missed, two robots in a corridor, and what the missions say."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from occlib import lab, live, plotting
from occlib.base.arrays import FloatArray
from occlib.base.extras import pandas as pd
from occlib.base.intervals import t_interval
from occlib.geometry import Floor
from occlib.mapping import MapData, OccupancyMap, inflate
from occlib.robots import Point
from occlib.tracking import ObjectVector

ROBOT_COLOURS = ("#0072B2", "#D55E00", "#009E73")


def refusals(topic: bytes, header: bytes, cells: bytes) -> pd.DataFrame:
    """A message spoiled in four ways, and what ``decode`` answers to each."""
    spoiled = {
        "another version": [b"occlib/9/map", header, cells],
        "a map that is too short": [topic, header, cells[:-1]],
        "a value of 101": [topic, header, b"e" + cells[1:]],
        "no JSON": [topic, b"__import__('os')", cells],
    }
    answers = {}
    for name, frames in spoiled.items():
        try:
            live.decode(frames)
        except ValueError as error:
            answers[name] = str(error)
    return pd.Series(answers, name="answer").to_frame()


def late_and_slow(count: int) -> pd.Series[float]:
    """A listener that comes after the first message and then sleeps through ``count`` more: what it gets and misses."""
    small, floor, waits = np.zeros((100, 100), np.int8), Floor((0.0, 1.0), (0.0, 1.0), 0.01), []
    with live.Publisher() as publisher:
        publisher.send(small, floor, [], time.time())
        with live.Listener(publisher.address) as late:
            first = late.receive(5.0)
            for _ in range(count):
                begin = time.perf_counter()
                publisher.send(small, floor, [], time.time())
                waits.append(1000 * (time.perf_counter() - begin))
            last = first
            while message := late.receive(0.5):
                last = message
    return pd.Series(
        {
            "number of the first message received": first.sequence if first else np.nan,
            "number of the last message received": last.sequence if last else np.nan,
            "sent": count + 1,
            "received": late.received,
            "missed": late.missed,
            "received twice": late.repeats,
            "median time to send (ms)": float(np.median(waits)),
            "longest time to send (ms)": max(waits),
        },
        name="",
    )


def path_figure(
    grid: OccupancyMap, objects: Sequence[ObjectVector], radius_m: float, ways: Mapping[str, FloatArray]
) -> Figure:
    """The map as received, and inflated, with ways (n, 2) in m by name."""
    fig, axes = plotting.new_figure(2, width=10, height=4)
    plotting.show_map(axes[0], grid, objects, title="as received")
    plotting.show_map(axes[1], inflate(grid, radius_m), title=f"inflated by {100 * radius_m:.0f} cm")
    for (name, way), style, colour in zip(ways.items(), (":", "-"), ("#D55E00", "#0072B2"), strict=False):
        axes[1].plot(*way.T, style, color=colour, label=name, linewidth=2)
    axes[1].legend(loc="lower right", fontsize=11)
    return fig


def corridor() -> tuple[npt.NDArray[np.int8], Floor, dict[str, tuple[Point, Point]]]:
    """A corridor 40 cm wide with two bays, as a map and its floor, and two robots that have to change places."""
    floor = Floor((0.0, 4.0), (0.0, 1.2), 0.05)
    walls = np.full(floor.shape, 100, np.int8)
    walls[6:14] = walls[14:, 16:28] = walls[14:, 52:64] = 0
    return walls, floor, {"A": ((0.2, 0.5), (3.8, 0.5)), "B": ((3.8, 0.5), (0.2, 0.5))}


def corridor_figure(walls: MapData, floor: Floor, tracks: Mapping[str, FloatArray]) -> Figure:
    """Robots in a corridor from above, and along it against time."""
    fig, (top, along) = plotting.new_figure(2, width=10, height=3.2)
    plotting.show_map(top, OccupancyMap(walls, floor), title="from above")
    for (name, track), colour in zip(tracks.items(), ROBOT_COLOURS, strict=False):
        top.plot(*track.T, ".-", color=colour, label=name)
        along.plot(np.arange(len(track)) * lab.STEP_S, track[:, 0], ".-", color=colour, label=name)
    along.legend(fontsize=11)
    along.set(xlabel="time (s)", ylabel="x (m)")
    along.set_title("along the corridor", fontsize=10)
    return fig


def mission_figure(mission: lab.Mission, outcomes: Sequence[lab.Outcome], kinds: Sequence[str]) -> Figure:
    """One mission on several kinds of map: the first map, and the ways that were driven."""
    shown = [one for kind in kinds for one in outcomes if (one.seed, one.map) == (mission.seed, kind)]
    fig, axes = plotting.new_figure(2, -(-len(shown) // 2), width=10, height=3.6 * -(-len(shown) // 2))
    for ax, outcome in zip(axes.ravel(), shown, strict=True):
        plotting.show_map(ax, OccupancyMap(outcome.first_map, lab.MISSION_FLOOR))
        ax.set_title(f"{outcome.map}: {outcome.finished} of {outcome.robots} arrive", fontsize=12)
        for i, (path, goal) in enumerate(zip(outcome.paths, mission.goals, strict=True)):
            colour = ROBOT_COLOURS[i % len(ROBOT_COLOURS)]
            ax.plot(*path.T, ".-", color=colour, markersize=4)
            ax.plot(*path[0], "o", color="white", markeredgecolor=colour, markersize=9)
            ax.plot(*goal, "*", color=colour, markersize=14)
    return fig


def missions_figure(summary: pd.DataFrame, outcomes: Sequence[lab.Outcome]) -> Figure:
    """Who arrives and what is refused on each kind of map: means with 95 % intervals, and the missions as dots."""
    fig, axes = plotting.new_figure(2, width=10, height=3.8)
    labels = {"arrive": "share of robots that arrive", "refused (m²)": "free but refused (m²)"}
    for ax, (column, label) in zip(axes, labels.items(), strict=True):
        ends = summary[[f"{column}, low", f"{column}, high"]].sub(summary[column], axis=0).abs().fillna(0).T
        ax.bar(range(len(summary)), summary[column], yerr=ends, color="#56B4E9", capsize=4)
        for i, kind in enumerate(summary.index):
            own = [one for one in outcomes if one.map == kind]
            values = [one.finished / one.robots if column == "arrive" else one.blocked_m2 for one in own]
            ax.plot(i + np.linspace(-0.2, 0.2, len(values)), values, ".", color="0.3", markersize=5)
        ax.set_xticks(range(len(summary)), [str(kind).replace(", unknown", ",\nunknown") for kind in summary.index])
        ax.tick_params(axis="x", rotation=30)
        ax.set_ylabel(label)
    return fig


def hard_missions(outcomes: Sequence[lab.Outcome]) -> pd.Series[int]:
    """In how many missions the single view fails a robot, and how often anything touches in them with two views."""
    hard = {one.seed for one in outcomes if one.map == "one view" and (one.finished < one.robots or one.collisions)}
    both = [one for one in outcomes if one.seed in hard and one.map not in ("truth", "one view")]
    return pd.Series({"hard missions": len(hard), "collisions with two views": sum(one.collisions for one in both)})


def way_differences(outcomes: Sequence[lab.Outcome], kinds: Sequence[str]) -> pd.DataFrame:
    """By how much the ways on the map of AND are longer than on others, mission by mission, with 95 % intervals."""
    rows = [(one.seed, one.map, one.length_ratio) for one in outcomes]
    ways = pd.DataFrame(rows, columns=["seed", "map", "way"]).pivot(index="seed", columns="map", values="way")
    pairs = {kind: t_interval(ways["and"] - ways[kind]) for kind in kinds}
    return pd.DataFrame(pairs, index=["way of and minus that of", "low", "high"]).T


def refused_shares(counts: Sequence[int], *, crowds: int = 10, seed: int = 0, rule: str = "left") -> FloatArray:
    """Share of the free floor that is claimed when so many objects stand on it, a mean over random crowds each.

    Parameters
    ----------
    counts
        Of objects.
    crowds, seed
        As for :func:`occlib.lab.random_crowds`.
    rule
        ``"left"`` for the left view alone, ``"and"`` for both.
    """
    simulation = lab.Simulation(lab.wall_rig(2))
    floor, shares = simulation.rig.floor, []
    for count in counts:
        values = []
        for crowd in lab.random_crowds(crowds, count, seed):
            views = simulation.on_floor(simulation.masks(crowd))
            claimed = views["left"] if rule == "left" else simulation.fused(views, rule)
            free = ~np.any([floor.polygon_mask(lab.base_m(each)) for each in crowd], axis=0)
            values.append((claimed & free).sum() / free.sum())
        shares.append(float(np.mean(values)))
    return np.array(shares)
