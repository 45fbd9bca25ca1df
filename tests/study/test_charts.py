"""Charts of template matching: what is plotted, where, under which label. Never the bytes of a PNG."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from occlib.matching import search
from occlib.matching.measures import METHODS
from occlib.study import charts, tables, work
from occlib.study.trials import Trial


@pytest.fixture
def ax():
    fig, axes = plt.subplots()
    yield axes
    plt.close(fig)


@pytest.fixture(scope="module")
def compared():
    """A square twice as bright as the background, once, and what three measures make of it."""
    image = np.full((30, 40), 50, np.uint8)
    image[10:18, 20:28] = 200
    template = image[8:20, 18:30]
    return image, template, search.compare(image, template, ["ssd", "zncc"])


def lines(ax):
    """Data of each labelled line of an axes."""
    return {line.get_label(): line.get_xydata() for line in ax.lines if not line.get_label().startswith("_")}


def legend_texts(fig):
    return [text.get_text() for text in fig.legends[0].get_texts()]


# --- one image ---------------------------------------------------------------------------------------


def test_comparison_table_has_best_place_and_threshold(compared):
    _, template, results = compared
    table = charts.comparison_table(results)
    assert list(table.columns) == ["best", "x", "y", "threshold", "matches", "ms"]
    assert table.loc["ssd", ["best", "x", "y", "matches"]].tolist() == [0, 18, 8, 1]
    assert table.loc["zncc", ["best", "x", "y", "matches"]].tolist() == [1, 18, 8, 1]
    assert table.loc["ssd", "threshold"] == pytest.approx(template.var() / 2)
    assert (table["ms"] > 0).all() and table.index.name == "method"


def test_comparison_figure_has_a_column_a_measure(compared):
    image, template, results = compared
    axes = np.array(charts.comparison_figure(image, template, results).axes[:9]).reshape(3, 3)
    assert np.array_equal(axes[0, 0].images[0].get_array(), template)
    assert np.array_equal(axes[1, 0].images[0].get_array(), image)
    assert axes[0, 0].get_title() == "template\n12 x 12 px"
    for column, name in ((1, "ssd"), (2, "zncc")):
        assert axes[0, column].get_title().startswith(f"{name}\n")
        assert axes[2, column].get_title() == "1 match"
        assert np.array_equal(axes[2, column].images[0].get_array(), image)
    assert axes[1, 1].get_xlabel() == "score, low is alike" and axes[1, 2].get_xlabel() == "score, high is alike"
    assert axes[1, 1].get_ylabel() == "places"


@pytest.mark.parametrize(("higher", "side", "shaded"), [(False, "below", (-0.18, 3)), (True, "above", (3, 9.18))])
def test_score_histogram_counts_places_and_shades_what_is_accepted(ax, higher, side, shaded):
    scores = np.array([[0.0, 1, 1, 4, 9, np.inf]])
    charts.score_histogram(ax, scores, 3.0, higher_is_better=higher, bins=9)
    counts, edges, _ = ax.patches[0].get_data()
    assert counts.tolist() == [1, 2, 0, 0, 1, 0, 0, 0, 1] and edges[[0, -1]].tolist() == [0, 9]
    x = ax.patches[1].get_extents().transformed(ax.transData.inverted())
    assert sorted([x.x0, x.x1]) == pytest.approx(shaded)
    assert ax.get_title() == f"accepted {side} 3" and ax.get_yscale() == "log"


def test_score_histogram_reaches_to_a_threshold_that_nothing_reaches(ax):
    charts.score_histogram(ax, np.array([[5.0, 6, 9]]), 1.0, higher_is_better=False)
    assert ax.get_xlim() == pytest.approx((1 - 0.16, 9 + 0.16))


def test_nothing_found_and_too_much_to_draw(compared):
    image, template, _ = compared
    none = search.compare(image, template[::-1] // 2, ["ssd"], threshold=0)
    assert none["ssd"].matches == []
    line = charts.comparison_figure(image, template, none).axes[5]
    assert line.get_title() == "0 matches, best place dashed"
    assert line.lines[0].get_linestyle() == "--" and line.lines[0].get_xydata().shape == (5, 2)
    dots = np.zeros((60, 90), np.uint8)
    dots[::4, ::4] = 200
    many = search.compare(dots, dots[3:6, 3:6], ["ssd"])
    axes = charts.comparison_figure(dots, dots[3:6, 3:6], many).axes
    assert len(many["ssd"].matches) > 100
    assert axes[5].get_title().endswith("matches, best 100 drawn") and len(axes[5].lines) == 200  # frame and cross


def test_score_histogram_without_a_threshold(ax):
    charts.score_histogram(ax, np.ones((4, 4)), np.nan, higher_is_better=True)
    assert ax.get_title() == "nothing to split: no threshold" and len(ax.patches) == 1


# --- the study ---------------------------------------------------------------------------------------


def test_styles_are_fixed_distinct_and_cycle_for_measures_of_your_own():
    styles = charts.measure_styles([*METHODS, "mine", "yours"])
    looks = [(style["color"], style["marker"]) for style in styles.values()]
    assert len(set(looks)) == len(looks) == len(METHODS) + 2
    assert charts.measure_styles(["zncc"]) == {"zncc": styles["zncc"]}
    many = charts.measure_styles([f"own{i}" for i in range(2 * len(charts.OTHER_STYLES))])
    assert many["own0"] == many[f"own{len(charts.OTHER_STYLES)}"]
    assert not {style["color"] for style in styles.values()} & {charts.ACCEPTED}


def test_contact_sheet_frames_the_true_place():
    image = np.arange(60 * 80, dtype=np.uint16).reshape(60, 80).astype(np.uint8)
    unknown = np.full((2, 2), np.nan)
    there = Trial(image, image[10:26, 20:36], np.array([20.25, 10.0]), unknown)
    gone = Trial(image, image[10:26, 20:36], None, unknown)
    fig = charts.contact_sheet({"clean": there, "absent": gone}, columns=2)
    template, clean, absent, blank = fig.axes
    assert [a.get_title() for a in fig.axes] == ["template, 16 x 16 px", "clean", "absent", ""]
    assert np.array_equal(template.images[0].get_array(), there.template)
    assert np.ptp(template.get_xlim()) == 80 and np.ptp(template.get_ylim()) == 60  # to the scale of the pictures
    frame = clean.lines[0].get_xydata()
    assert frame.min(axis=0).tolist() == [19.75, 9.5] and frame.max(axis=0).tolist() == [35.75, 25.5]
    assert not absent.lines and not blank.images


@pytest.fixture
def summary():
    """Two conditions and two measures, one of them unknown; and a condition with one level."""
    rows = [
        (condition, level, method, 1 - 0.1 * i - 0.3 * (method == "mine"))
        for condition, levels in (("jpeg", (2.0, 10.0, 100.0)), ("noise", (0.0, 20.0)), ("absent", (0.0,)))
        for i, level in enumerate(levels)
        for method in ("ssd", "mine")
    ]
    table = pd.DataFrame(rows, columns=["condition", "level", "method", "recall"])
    return table.assign(recall_low=table["recall"] - 0.05, recall_high=table["recall"] + 0.02)


def test_level_curves_plot_values_intervals_and_units(summary):
    fig = charts.level_curves(summary)
    jpeg, noise = fig.axes
    assert (jpeg.get_title(), noise.get_title()) == ("jpeg", "noise")  # one level is no curve
    assert (jpeg.get_xlabel(), noise.get_xlabel()) == ("quality", "grey levels")
    assert [t.get_text() for t in jpeg.get_xticklabels()] == ["100", "10", "2"]  # worse to the right
    assert [t.get_text() for t in noise.get_xticklabels()] == ["0", "20"]
    drawn = lines(jpeg)
    assert drawn["ssd"][:, 1] == pytest.approx([0.8, 0.9, 1.0]) and drawn["mine"][:, 1] == pytest.approx(
        [0.5, 0.6, 0.7]
    )
    assert drawn["ssd"][:, 0] == pytest.approx(np.arange(3) - 0.045)  # side by side, around the level
    assert drawn["mine"][:, 0] == pytest.approx(np.arange(3) + 0.045)
    bars = np.array([bar for bar in jpeg.collections[0].get_segments()])
    assert bars[:, :, 1] == pytest.approx(np.column_stack([[0.75, 0.85, 0.95], [0.82, 0.92, 1.02]]))
    assert legend_texts(fig) == ["ssd", "mine"] and jpeg.get_ylabel() == "recall at rank 1"


def test_level_curves_of_other_values_and_lines(summary):
    table = summary.rename(columns={"method": "rule"}).assign(rmse_px=2.0)[["condition", "level", "rule", "rmse_px"]]
    looks = {"ssd": {"color": "red", "marker": "x"}}
    fig = charts.level_curves(table, "rmse_px", by="rule", log=True, styles=looks, columns=1)
    assert legend_texts(fig) == ["ssd"] and fig.axes[0].get_yscale() == "log"
    assert fig.axes[0].get_ylim() == pytest.approx((2 / 1.8, 2 * 1.8))
    assert all(a.get_ylabel() == "RMSE (px)" and not a.collections for a in fig.axes)
    assert fig.axes[0].lines[0].get_color() == "red"


def test_level_curves_without_a_curve_say_so(summary):
    with pytest.raises(ValueError, match="summary: expected a condition with two levels or more"):
        charts.level_curves(summary[summary["condition"] == "absent"])


def test_precision_recall_curves_mark_the_best_f1():
    curves = pd.DataFrame(
        {
            "condition": "noise",
            "method": "sad",
            "recall": [0.2, 0.6, 0.8],
            "precision": [1, 0.9, 0.3],
            "f1": [0.3, 0.7, 0.4],
        }
    )
    fig = charts.precision_recall_curves(pd.concat([curves, curves.assign(condition="blur", method="zncc")]))
    noise, blur = fig.axes
    assert [a.get_title() for a in fig.axes] == ["noise", "blur"] and legend_texts(fig) == ["sad", "zncc"]
    assert noise.lines[0].get_xydata() == pytest.approx(np.array([[0.2, 1], [0.6, 0.9], [0.8, 0.3]]))
    assert noise.lines[1].get_xydata() == pytest.approx(np.array([[0.6, 0.9]]))
    assert noise.lines[1].get_marker() == "s" and to_hex(noise.lines[0].get_color()) == "#56b4e9"
    assert noise.get_ylabel() == "precision" and blur.get_xlabel() == "recall"


def test_runtime_curves_are_ordered_by_side(ax):
    times = pd.DataFrame({"side": [64, 16], "method": "sad", "median_ms": [8.0, 0.5]})
    charts.runtime_curves(ax, times)
    assert lines(ax)["sad"].tolist() == [[16, 0.5], [64, 8]]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("side of the template (px)", "run time (ms)")
    assert [t.get_text() for t in ax.get_xticklabels()] == ["16", "64"] and ax.get_xscale() == ax.get_yscale() == "log"


def test_heatmap_writes_numbers_and_frames_the_marked(ax):
    values = pd.DataFrame({"ssd": [0.0, 1.0], "zncc": [np.nan, 0.254]}, index=["gain", "noise"])
    charts.heatmap(ax, values, "area", marked=values > 0.5)
    assert {(*t.get_position(), t.get_text(), t.get_fontweight()) for t in ax.texts} == {
        (0, 0, "0.00", "normal"),
        (0, 1, "1.00", "bold"),
        (1, 1, "0.25", "normal"),
    }
    assert np.array_equal(ax.images[0].get_array().filled(np.nan), values.to_numpy(), equal_nan=True)
    assert len(ax.lines) == 1 and ax.lines[0].get_xydata().mean(axis=0) == pytest.approx([0, 1], abs=0.2)
    assert [t.get_text() for t in ax.get_yticklabels()] == ["gain", "noise"]


def test_verdict_figure_frames_the_best_and_what_is_tied():
    trials = work.run(
        work.batches("fast", seeds=[0, 1], sources=["coins"], conditions=["offset", "occlusion"]),
        ["ssd", "zncc"],
        progress=False,
    )
    verdicts = tables.verdicts(trials)
    fig = charts.verdict_figure(verdicts)
    fig.draw_without_rendering()
    left, right = fig.axes
    titles = [ax.title.get_window_extent() for ax in (left, right)]
    assert titles[0].x1 < titles[1].x0  # however few the measures
    rows = verdicts[~verdicts["condition"].str.startswith("claim")]
    assert [t.get_text() for t in left.get_xticklabels()] == ["ssd", "zncc"]
    assert [t.get_text() for t in left.get_yticklabels()] == [f"{r.condition} ({r.best})" for r in rows.itertuples()]
    assert np.asarray(left.images[0].get_array()) == pytest.approx(rows[["ssd", "zncc"]].to_numpy())
    frames = [line for line in left.lines if line.get_color() == charts.ACCEPTED]
    assert len(frames) == sum(1 + bool(tied) for tied in rows["tied"])
    rule = next(line for line in left.lines if line not in frames)  # between the conditions and their means
    assert rule.get_ydata()[0] == pytest.approx(list(rows["condition"]).index("constant light") - 0.5)
    assert right.lines[-1].get_xdata() == pytest.approx(rows["area"].to_numpy()) and right.get_xlabel() == "area"
