"""Chapter 11: more than AND: votes, cameras, planes, colour, and the fewest objects that explain all silhouettes."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from occlib import explaining, lab, occlusion, plotting
from occlib.base.arrays import FloatArray, Mask
from occlib.base.extras import pandas as pd
from occlib.base.intervals import t_interval
from occlib.geometry import Rig
from occlib.pipeline import Pipeline, backgrounds_of, settings_for
from occlib.recordings import Recording, open_recording

Crowd = Sequence[lab.SceneObject]

RULE_STYLES = {"and": ("#0072B2", "o"), "most": ("#E69F00", "s"), "log-odds": ("#009E73", "^"), "or": ("#CC79A7", "D")}

GHOST_COLOUR = "#F0E442"


def votes_table(rules: Sequence[str], most_cameras: int = 8) -> pd.DataFrame:
    """How many of one to ``most_cameras`` views each rule wants to say yes."""
    counts = range(1, most_cameras + 1)
    table = pd.DataFrame({rule: [lab.votes_needed(rule, k) for k in counts] for rule in rules}, index=counts)
    return table.rename_axis("cameras")


def vote_figure(table: pd.DataFrame) -> Figure:
    """Share of the objects that each rule keeps against a view's recall; a panel for each number of cameras."""
    groups = [(int(k), table[table["cameras"] == k]) for k in table["cameras"].unique()]
    fig, axes = plotting.new_figure(len(groups), width=10, height=3.5)
    for ax, (k, group) in zip(axes, groups, strict=True):
        for rule, part in group.groupby("rule", sort=False):
            colour, marker = RULE_STYLES[str(rule)]
            ax.plot(part["r"], part["expected"], color=colour)
            votes = lab.votes_needed(str(rule), k)
            ax.plot(part["r"], part["found"], marker, color=colour, markersize=7, label=f"{rule}: {votes} of {k}")
        ax.set(xlabel="recall r of one view", title=f"{k} cameras", ylim=(0, 1.05))
        ax.legend(fontsize=11, loc="lower right")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("share of the objects kept")
    return fig


def camera_study(
    rig: Rig, crowds: Sequence[Crowd], cases: Mapping[float, Sequence[str]], *, seed: Sequence[int]
) -> pd.DataFrame:
    """Scores of rules for one camera up to all of a rig; index ``r``, ``rule`` and ``cameras``.

    Parameters
    ----------
    rig, crowds
        Shadows are cast once for all of its cameras; crowds of equally many objects.
    cases
        For each recall of a view the rules to score.
    seed
        For the misses.
    """
    simulation, rng, rows = lab.Simulation(rig), np.random.default_rng(list(seed)), {}
    shadows, names = [simulation.shadows(crowd) for crowd in crowds], list(rig.cameras)
    for recall, rules in cases.items():
        seen = [lab.union(one, lab.misses(names, len(crowds[0]), recall, rng)) for one in shadows]
        for k in range(1, len(names) + 1):
            views = [{name: one[name] for name in names[:k]} for one in seen]
            for rule in rules:
                found = [lab.region_places(simulation.fused(one, rule), rig.floor) for one in views]
                rows[recall, rule, k] = lab.score_places(found, crowds)
    return pd.DataFrame(rows).T.rename_axis(["r", "rule", "cameras"])


def camera_figure(table: pd.DataFrame, recall: float) -> Figure:
    """MODA against the number of cameras: perfect masks, and views that miss objects; a table of :func:`camera_study`."""
    fig, axes = plotting.new_figure(2, width=10, height=3.6)
    for ax, r, title in zip(
        axes, (1.0, recall), ("perfect masks", f"each view finds {100 * recall:.0f} %"), strict=True
    ):
        for rule in table.loc[r].index.unique("rule"):
            colour, marker = RULE_STYLES[str(rule)]
            ax.plot(table["MODA"].xs((r, rule), level=("r", "rule")), color=colour, marker=marker, label=str(rule))
        ax.set(xlabel="number of cameras", title=title, xticks=table.index.unique("cameras"), ylim=(0.4, 1.03))
        ax.legend(fontsize=11, loc="lower right")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("MODA (1 is best)")
    return fig


def planes_figure(
    simulation: lab.Simulation,
    crowd: Crowd,
    planes: Mapping[float, Mapping[str, Mask]],
    *,
    window_m: tuple[float, float, float, float],
) -> Figure:
    """The views on parallel planes above the floor, with the crossings that were predicted on the floor in yellow.

    Parameters
    ----------
    simulation, crowd
        Two cameras, and who stands there.
    planes
        For each height in m what every view says there, ``{camera: bool (ny, nx)}``.
    window_m
        ``(x_min, x_max, y_min, y_max)``: the part of the floor that is shown.
    """
    fig, axes = plotting.new_figure(len(planes), width=10, height=3)
    for ax, (height, views) in zip(axes, planes.items(), strict=True):
        plotting.show_views_on_floor(ax, views, simulation.rig.floor)
        plotting.show_footprints(ax, lab.truth_of([crowd]).frames[0])
        _outline(ax, lab.crossings(simulation.rig, crowd).values())
        ax.get_legend().remove()
        ax.set(xlim=window_m[:2], ylim=window_m[2:])
        ax.set_title("on the floor" if height == 0 else f"{100 * height:.0f} cm above it", fontsize=11)
    for ax in axes[1:]:
        ax.set_ylabel("")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=11)
    return fig


def _outline(ax: Axes, polygons: Iterable[FloatArray]) -> None:
    for polygon in polygons:
        ax.fill(*polygon.T, facecolor="none", edgecolor=GHOST_COLOUR, linewidth=3)


def judged_by_colour(colours: pd.DataFrame, *, lost_in_plain_view: float = 0.05) -> pd.Series[float]:
    """How well the disagreement of two views tells ghosts from objects; for the rows of :func:`occlib.lab.colour_study`.

    The limit is where ``lost_in_plain_view`` of the real objects in plain view are taken for ghosts.
    """
    values = {str(kind): part.to_numpy() for kind, part in colours.groupby("kind")["disagreement"]}
    plain, hidden, to_be = (values[kind] for kind in ("real, in plain view", "real, partly hidden", "ghost to be"))
    limit = float(np.quantile(plain, 1 - lost_in_plain_view))
    return pd.Series(
        {
            "limit (grey levels)": limit,
            "ranked right, plain view": (to_be[:, None] > plain).mean(),
            "ranked right, partly hidden": (to_be[:, None] > hidden).mean(),
            "ghosts removed": (to_be > limit).mean(),
            "real ones lost, partly hidden": (hidden > limit).mean(),
        },
        name="share",
    )


def colour_figure(recording: Recording, colours: pd.DataFrame, cameras: tuple[str, str] = ("left", "right")) -> Figure:
    """The first ghost of two cameras in both pictures, and how much two views disagree at objects and at ghosts."""
    of_both = (colours["kind"] == "ghost") & (colours["cameras"] == " + ".join(cameras))
    ghost = colours[of_both].iloc[0]
    _, pictures = next(recording.images([int(ghost["frame"])]))
    fig, axes = plotting.new_figure(3, width=10, height=3.4)
    shades = plotting.camera_colours(list(recording.rig.cameras))
    for ax, name in zip(axes, cameras, strict=False):
        plotting.show_image(ax, pictures[name], colour=shades[name])
        ax.set_title(f"{name} view", color=shades[name], fontsize=11)
        u, v = recording.rig[name].floor_to_pixels([[ghost["x"], ghost["y"]]])[0]
        ax.plot(u, v, "o", markersize=20, markerfacecolor="none", markeredgecolor=GHOST_COLOUR, markeredgewidth=3)
        ax.set(xlim=(u - 110, u + 110), ylim=(v + 90, v - 90))
    kinds = {
        "ghost": "#D55E00",
        "ghost to be": "#E69F00",
        "real, partly hidden": "#56B4E9",
        "real, in plain view": "#0072B2",
    }
    for kind, colour in kinds.items():
        axes[2].ecdf(colours.loc[colours["kind"] == kind, "disagreement"], color=colour, label=kind, linewidth=2)
    axes[2].set(xlabel="disagreement (grey levels)", ylabel="share below")
    fig.legend(*axes[2].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=11)
    return fig


# --- explaining away


def cast(world: Mask) -> tuple[Mask, Mask]:
    """Shadows of the occupied cells of a grid (ny, nx) from the left, running right, and from the front, running up."""
    return np.logical_or.accumulate(world, axis=1), np.logical_or.accumulate(world, axis=0)


def explaining_sets(left: Mask, front: Mask) -> list[Mask]:
    """All worlds whose shadows (:func:`cast`) are exactly these two, bool (ny, nx) each, the smallest first.

    Only cells where both are dark are tried: at most 2 to the power of their number.
    """
    cells, found = np.argwhere(occlusion.fuse([left, front])), []
    for count in range(len(cells) + 1):
        for chosen in combinations(cells.tolist(), count):
            world = np.zeros_like(left)
            for y, x in chosen:
                world[y, x] = True
            if all(np.array_equal(a, b) for a, b in zip(cast(world), (left, front), strict=True)):
                found.append(world)
    return found


def greedy_on_grid(left: Mask, front: Mask) -> pd.DataFrame:
    """Explaining away step by step on a grid: the cell that explains most of what is left, until nothing is left.

    Columns: the cell chosen ``(x, y)``, what it explains, and what is left, in cells of both views together.
    """
    rest, rows = np.stack([left, front]).copy(), []
    candidates = [(int(x), int(y)) for y, x in np.argwhere(occlusion.fuse([left, front]))]
    while rest.any():
        explained = {}
        for x, y in candidates:
            world = np.zeros_like(left)
            world[y, x] = True
            explained[x, y] = rest & np.stack(cast(world))
        best = max(explained, key=lambda cell: int(explained[cell].sum()))
        rest &= ~explained[best]
        rows.append({"cell (x, y)": best, "explains": int(explained[best].sum()), "left to explain": int(rest.sum())})
    return pd.DataFrame(rows, index=range(1, len(rows) + 1)).rename_axis("step")


def riddle() -> tuple[Mask, Mask]:
    """Two views of a grid of 6 x 6 cells, for an exercise: what stands there?"""
    world = np.zeros((6, 6), bool)
    world[[4, 4, 2, 0], [0, 3, 2, 4]] = True
    return cast(world)


def as_objects(prisms: Iterable[explaining.Prism]) -> list[lab.SceneObject]:
    """What an explanation found, as objects that cast shadows."""
    objects = []
    for number, prism in enumerate(prisms):
        shape = "box" if prism.outline == explaining.BOX else "cylinder"
        for name, part in zip("ab", explaining.parts(prism), strict=False):
            size = (2 * part.radius, 2 * part.half_width)
            heading = float(np.degrees(part.heading))
            objects.append(
                lab.upright(shape, (part.x, part.y), size, part.height, heading=heading, name=f"{number}{name}")
            )
    return objects


def search_steps(
    simulation: lab.Simulation, masks: Mapping[str, Mask], counts: Sequence[int]
) -> dict[int, list[explaining.Prism]]:
    """What the search finds when it may use no more than so many objects."""
    explainer = explaining.Explainer(simulation.rig, simulation.settings)
    evidence = lab.evidence_of(masks)
    polar, places, search = explainer.polar(evidence), explainer.places(evidence), simulation.settings.search
    return {
        count: explaining.explain(polar, places, settings=search._replace(max_objects=count)).prisms for count in counts
    }


def explained_share(
    simulation: lab.Simulation,
    masks: Mapping[str, Mask],
    steps: Mapping[int, Sequence[explaining.Prism]],
    crowd: Crowd,
) -> pd.DataFrame:
    """For each step of :func:`search_steps`: how much foreground is explained, and how far the places are off.

    ``background covered`` is a share of the foreground, too, so that both are in the same unit.
    """
    rows, truth = {}, lab.places_m(crowd)
    total = sum(int(mask.sum()) for mask in masks.values())
    for count, prisms in steps.items():
        told = simulation.masks(as_objects(prisms))
        places = np.array([(p.x, p.y) for p in prisms]).reshape(-1, 2)
        nearest = np.linalg.norm(places[:, None] - truth, axis=2).min(axis=1)
        rows[count] = {
            "objects found": len(prisms),
            "explained": sum(int((told[n] & masks[n]).sum()) for n in masks) / total,
            "background covered": sum(int((told[n] & ~masks[n]).sum()) for n in masks) / total,
            "farthest from an object (cm)": 100 * float(nearest.max()),
        }
    return pd.DataFrame(rows).T.rename_axis("allowed")


def search_figure(
    simulation: lab.Simulation,
    masks: Mapping[str, Mask],
    steps: Mapping[int, Sequence[explaining.Prism]],
    crowd: Crowd,
) -> Figure:
    """For each step: one view's foreground, explained or not, and the AND map with what is found so far."""
    fig, axes = plotting.new_figure(len(steps), 2, width=10, height=4.2)
    name = next(iter(masks))
    rows, columns = (np.flatnonzero(masks[name].any(axis=axis)) for axis in (1, 0))
    for (top, below), (count, prisms) in zip(axes.T, steps.items(), strict=True):
        told = simulation.masks(as_objects(prisms))[name]
        canvas = np.full((*masks[name].shape, 3), 255, np.uint8)
        canvas[masks[name]] = (213, 94, 0)
        canvas[masks[name] & told] = (150, 190, 220)
        plotting.show_image(top, canvas)
        top.set_title("1 object" if count == 1 else f"{len(prisms)} objects", fontsize=12)
        top.set(ylim=(rows.max() + 9, rows.min() - 9), xlim=(columns.min() - 9, columns.max() + 9), aspect="auto")
        plotting.show_floor(below, simulation.occupied(masks), simulation.rig.floor)
        _outline(below, lab.crossings(simulation.rig, crowd).values())
        for prism in prisms:
            below.fill(*explaining.outline_points(prism).T, facecolor="none", edgecolor="#56B4E9", linewidth=3)
        below.set_ylabel("")
    axes[0, 0].set_ylabel(f"{name} view")
    axes[1, 0].set_ylabel("y (m)")
    return fig


def rules_study(
    rig: Rig,
    crowds: Sequence[Crowd],
    *,
    cameras: Sequence[int],
    recalls: Sequence[float],
    rules: Sequence[str],
    seed: Sequence[int],
) -> pd.DataFrame:
    """Scores of rules on the same crowds, with and without misses; index ``r``, ``cameras`` and ``rule``.

    ``MODA, low`` and ``MODA, high`` are the ends of the 95 % interval over the crowds.

    Parameters
    ----------
    rig, cameras
        The first so many of its cameras; each crowd's silhouettes are cast once for all.
    recalls, rules
        Of a single view, and among :data:`occlib.occlusion.RULES` and :data:`occlib.lab.EXPLAIN`.
    seed
        For the misses, with the number of cameras behind it.
    """
    names, count = list(rig.cameras), len(crowds[0])
    simulations = {k: lab.Simulation(rig.select(names[:k])) for k in cameras}
    kept = {}
    for k, recall in product(cameras, recalls):
        rng = np.random.default_rng([*seed, k])
        kept[recall, k] = [lab.misses(names[:k], count, recall, rng) for _ in crowds]
    found: dict[tuple[float, int, str], list[FloatArray]] = {(r, k, rule): [] for r, k in kept for rule in rules}
    whole = lab.Simulation(rig)
    for i, crowd in enumerate(crowds):
        silhouettes = whole.silhouettes(crowd)
        for (recall, k), seen in kept.items():
            masks = lab.union({name: silhouettes[name] for name in names[:k]}, seen[i])
            for rule in rules:
                if rule == lab.EXPLAIN[1] and k <= 2:  # two views have none to spare: the same search
                    found[recall, k, rule].append(found[recall, k, lab.EXPLAIN[0]][-1])
                else:
                    found[recall, k, rule].append(simulations[k].places(masks, rule))
    rows = {}
    for key, places in found.items():
        each = [lab.score_places([one], [crowd])["MODA"] for one, crowd in zip(places, crowds, strict=True)]
        _, low, high = t_interval(each)
        rows[key] = {**lab.score_places(places, crowds), "MODA, low": low, "MODA, high": high}
    return pd.DataFrame(rows).T.rename_axis(["r", "cameras", "rule"])


def rules_figure(table: pd.DataFrame) -> Figure:
    """MODA of the rules with 95 % intervals, a panel with and one without misses; a table of :func:`rules_study`."""
    recalls, rules = table.index.unique("r"), list(table.index.unique("rule"))
    fig, axes = plotting.new_figure(len(recalls), width=10, height=4.4)
    shades, shift = dict(zip(table.index.unique("cameras"), ("#56B4E9", "#E69F00", "#000000"), strict=False)), 0.22
    for ax, r in zip(axes, recalls, strict=True):
        for offset, (k, marker) in zip((-shift, 0, shift), zip(shades, "os^", strict=False), strict=False):
            part = table.xs((r, k), level=("r", "cameras")).reindex(rules)
            spread = [part["MODA"] - part["MODA, low"], part["MODA, high"] - part["MODA"]]
            ax.errorbar(part["MODA"], np.arange(len(rules)) + offset, xerr=spread, fmt=marker, color=shades[k],
                        label=f"{k} cameras", capsize=2)  # fmt: skip
        title = "perfect masks" if r == 1 else f"each view finds {100 * r:.0f} %"
        ax.set(title=title, xlabel="MODA (1 is best)", xlim=(0.25, 1.03), ylim=(len(rules) - 0.5, -0.5))
        ax.set_yticks(range(len(rules)), rules if ax is axes[0] else [""] * len(rules))
        ax.grid(alpha=0.3)
    axes[0].legend(loc="lower left", fontsize=11)
    return fig


def fusion_cost(rig: Rig, crowds: Sequence[Crowd], rules: Sequence[str], *, repeats: int = 2) -> pd.DataFrame:
    """Median time from the masks of an instant to the objects' places, in ms and as a ratio to the first rule."""
    simulation = lab.Simulation(rig)
    masks = [simulation.masks(crowd) for crowd in crowds]
    cost = pd.Series({rule: simulation.cost_ms(masks, rule, repeats=repeats) for rule in rules}, name="ms")
    return pd.DataFrame({"ms": cost, "ratio": cost / cost.iloc[0]}).rename_axis("rule")


def pipeline_cost(recording: str, rules: Sequence[str], *, frames: int, cameras: Sequence[str]) -> pd.DataFrame:
    """Median time from the pictures of an instant to the tracked objects, in ms and as a ratio to the first rule.

    All stages are those of the recommended profile; only the rule differs.
    """
    source, cost = open_recording(recording, list(cameras)), {}
    instants, backgrounds = list(source.images(source.frames[:frames])), backgrounds_of(source)
    for rule in rules:
        pipeline, times = Pipeline(source.rig, backgrounds, settings_for("recommended", rule=rule)), []
        for frame, images in instants:
            start = time.perf_counter()
            pipeline.process(images, source.time(frame))
            times.append(1000 * (time.perf_counter() - start))
        cost[rule] = float(np.median(times[1:]))  # the first one fills the look-up tables
    column = pd.Series(cost, name="ms")
    return pd.DataFrame({"ms": column, "ratio": column / column.iloc[0]}).rename_axis("rule")
