"""Figures: what is plotted, where, in which colour and unit. Never the bytes of a PNG."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from occlib.course.drawings import (
    cover_heads,
    fill_hull,
    frame_strip,
    lamps_and_shadows,
    outline_cylinders,
    views_and_map,
)
from occlib.explaining.evidence import PolarWarp
from occlib.explaining.prisms import Prism
from occlib.formats import TrueObject, Truth
from occlib.geometry import Floor, Rig
from occlib.mapping import REASONS, OccupancyMap
from occlib.pipeline import FrameResult, Pipeline
from occlib.plotting import (
    CAMERA_COLOURS,
    REASON_COLOURS,
    TRUTH_COLOUR,
    camera_colours,
    figure_png,
    new_figure,
    outline_on_image,
    overview,
    show_floor,
    show_footprints,
    show_image,
    show_map,
    show_views_on_floor,
)
from occlib.tracking import ObjectVector

Array = np.ndarray[Any, Any]
Draw = Callable[[Sequence[Any]], dict[str, Array]]
FLOOR = Floor((-1.0, 3.0), (0.0, 2.0), 0.5)


@pytest.fixture
def ax() -> Axes:
    return new_figure()[1]


def texts(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.texts]


def legend(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def pixels(ax: Axes) -> Array:
    return np.asarray(ax.images[0].get_array())


def thing(x: float, y: float, **more: Any) -> ObjectVector:
    return ObjectVector(more.pop("id", 1), (x, y), more.pop("v", (0.0, 0.0)), 0.04, (255, 0, 51), **more)


# --- colours and frames ----------------------------------------------------------------------------------
def test_each_camera_keeps_its_colour_and_no_two_of_eight_share_one() -> None:
    assert camera_colours(["left", "right"]) == {"left": "#0072B2", "right": "#E69F00"}
    assert len(set(CAMERA_COLOURS)) == len(CAMERA_COLOURS) >= 8
    many = camera_colours([f"cam{i}" for i in range(20)])
    assert len(many) == 20 and set(many.values()) == set(CAMERA_COLOURS)


def test_new_figure_is_no_business_of_pyplot() -> None:
    others = plt.get_fignums()
    fig, axes = new_figure(3, 2, width=6, height=3)
    assert axes.shape == (2, 3)
    assert fig.get_size_inches().tolist() == [6, 3]
    assert isinstance(new_figure()[1], Axes)
    assert plt.get_fignums() == others


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (bool, 1)])
def test_an_image_is_shown_as_it_is_without_ticks(ax: Axes, dtype: Any, top: int) -> None:
    image = np.random.default_rng(0).integers(0, 2, (4, 6)).astype(dtype)
    kept = image.copy()
    picture = show_image(ax, image, "left", colour="#0072B2")
    np.testing.assert_array_equal(pixels(ax), image)
    assert picture.get_clim() == (0, top) and picture.get_cmap().name == "gray"
    assert ax.get_title() == "left" and ax.title.get_color() == "#0072B2"
    assert list(ax.get_xticks()) == list(ax.get_yticks()) == []
    assert ax.get_ylim()[0] > ax.get_ylim()[1]  # row 0 is on top
    np.testing.assert_array_equal(image, kept)


def test_options_win_over_the_defaults(ax: Axes) -> None:
    picture = show_image(ax, np.eye(3), vmax=1, cmap="magma")
    assert picture.get_clim() == (0, 1) and picture.get_cmap().name == "magma"


def test_a_floor_has_axes_in_metres_and_north_up(ax: Axes) -> None:
    values = np.zeros(FLOOR.shape, bool)
    values[3, 0] = True  # large y, small x
    picture = show_floor(ax, values, FLOOR, "map")
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_title()) == ("x (m)", "y (m)", "map")
    assert picture.get_extent() == [-1.0, 3.0, 0.0, 2.0] and picture.origin == "lower"
    assert ax.get_xlim() == (-1.0, 3.0) and ax.get_ylim() == (0.0, 2.0)
    assert picture.get_clim() == (0, 1)
    np.testing.assert_array_equal(pixels(ax), values)


# --- the floor ---------------------------------------------------------------------------------------------
def masks() -> dict[str, Array]:
    left, right = np.zeros(FLOOR.shape, bool), np.zeros(FLOOR.shape, bool)
    left[0, :4], right[0, 3:6] = True, True
    return {"left": left, "right": right}


def test_views_on_the_floor_are_white_coloured_and_dark_where_both_agree(ax: Axes) -> None:
    show_views_on_floor(ax, masks(), FLOOR, "foreground")
    canvas = pixels(ax)
    assert (canvas[1:] == 1).all() and (canvas[0, 6:] == 1).all()
    assert (canvas[0, 3] == 0.1).all()
    blue, orange = canvas[0, 0], canvas[0, 5]
    assert blue[2] > blue[0] and orange[0] > orange[2]
    assert legend(ax) == ["left only", "right only", "both"]
    assert ax.get_title() == "foreground"


def test_three_views_agree_where_all_do_and_one_alone_keeps_its_colour() -> None:
    three = {**masks(), "front": np.ones(FLOOR.shape, bool)}
    ax = new_figure()[1]
    show_views_on_floor(ax, three, FLOOR)
    assert legend(ax)[-1] == "all"
    assert np.argwhere((pixels(ax) == 0.1).all(axis=2)).tolist() == [[0, 3]]
    ax = new_figure()[1]
    show_views_on_floor(ax, {"left": masks()["left"]}, FLOOR)
    assert legend(ax) == ["left only"]
    np.testing.assert_allclose(pixels(ax)[0, 0], 0.35 + 0.65 * np.array(to_rgb("#0072B2")))


def grid() -> OccupancyMap:
    data = np.zeros(FLOOR.shape, np.int8)
    data[0, 0], data[3, 7] = 100, -1
    return OccupancyMap(data, FLOOR)


def test_the_map_is_white_free_black_occupied_grey_unknown(ax: Axes) -> None:
    show_map(ax, grid(), title="map")
    shade = pixels(ax)
    assert (shade[0, 0], shade[1, 1], shade[3, 7]) == (0.1, 1.0, 0.75)
    assert ax.images[0].get_clim() == (0, 1) and ax.images[0].get_cmap().name == "gray"
    assert ax.get_title() == "map" and ax.get_legend() is None and not ax.lines


def test_what_is_unknown_is_tinted_by_its_reason(ax: Axes) -> None:
    data, reason = np.zeros(FLOOR.shape, np.int8), np.zeros(FLOOR.shape, np.uint8)
    data[0, 0], data[3, 7], data[2, 2] = 100, -1, -1
    reason[3, 7], reason[2, 2] = 3, 1
    show_map(ax, OccupancyMap(data, FLOOR), reason=reason)
    canvas = pixels(ax)
    assert (canvas[0, 0] == 0.1).all() and (canvas[1, 1] == 1.0).all()
    assert tuple(canvas[3, 7]) == to_rgb(REASON_COLOURS[3]) and tuple(canvas[2, 2]) == to_rgb(REASON_COLOURS[1])
    assert legend(ax) == ["unknown: no camera sees it", "unknown: views disagree"]  # only those that occur
    known = new_figure()[1]
    show_map(known, OccupancyMap(np.zeros(FLOOR.shape, np.int8), FLOOR), reason=np.zeros(FLOOR.shape, np.uint8))
    assert known.get_legend() is None
    assert set(REASON_COLOURS) == set(REASONS)
    light = [to_rgb(colour) @ np.array([0.3, 0.6, 0.1]) for colour in REASON_COLOURS.values()]
    assert min(light) > 0.7 and max(light) < 0.95  # between the black of the objects and the white of bare floor


def test_objects_stand_where_they_are_in_their_colour_with_their_number_and_velocity(ax: Axes) -> None:
    show_map(ax, grid(), [thing(0.5, 1.5, id=7, v=(0.4, -0.2)), thing(2.0, 1.0, id=8, v=(0.01, 0.0))])
    assert [tuple(line.get_xydata()[0]) for line in ax.lines] == [(0.5, 1.5), (2.0, 1.0)]
    assert to_rgb(ax.lines[0].get_color()) == (1.0, 0.0, 0.2)
    assert texts(ax) == ["7", "", "8"]  # the second is the arrow; slower than 5 cm/s there is none
    assert ax.texts[1].xyann == (0.5, 1.5)
    assert ax.texts[1].xy == pytest.approx((0.9, 1.3))  # its tip: where the object is after a second


def test_what_coasts_is_hollow_and_dashed_where_it_is_expected(ax: Axes) -> None:
    show_map(ax, grid(), [thing(0.5, 1.5, id=7)], coasting=[thing(2.0, 1.0, id=8, v=(0.4, 0.0))])
    (ring,) = ax.collections
    assert ring.get_offsets().tolist() == [[2.0, 1.0]]
    assert len(ring.get_facecolor()) == 0 and to_rgb(ring.get_edgecolor()[0]) == (1.0, 0.0, 0.2)
    ((_, dashes),) = ring.get_linestyle()
    assert dashes is not None  # a solid line has none
    assert texts(ax) == ["7", "8"] and ax.texts[1].xyann != (0, 0)  # no arrow: it is drawn where it would be by now


def test_true_footprints_are_closed_and_dashed_and_bare_points_are_crosses(ax: Axes) -> None:
    square = ((0, 0), (1, 0), (1, 1), (0, 1))
    show_footprints(ax, [TrueObject(x=0.5, y=0.5, footprint=square), TrueObject(x=2.0, y=1.0), np.array(square)])
    outline, cross, again, _ = ax.lines
    assert outline.get_xydata().tolist() == again.get_xydata().tolist() == [list(at) for at in (*square, square[0])]
    assert outline.get_linestyle() == "--" and outline.get_color() == TRUTH_COLOUR
    assert cross.get_xydata().tolist() == [[2.0, 1.0]] and cross.get_marker() == "+"
    assert legend(ax) == ["truth"]
    empty = new_figure()[1]
    show_footprints(empty, [])
    assert not empty.lines and empty.get_legend() is None


def test_a_hull_leaves_inner_points_out(ax: Axes) -> None:
    points = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.5], [2.0, 1.0], [0.0, 1.0]])
    corners = fill_hull(ax, points, facecolor="red")
    assert {tuple(corner) for corner in corners.tolist()} == {(0, 0), (2, 0), (2, 1), (0, 1)}
    assert ax.patches[0].get_facecolor() == (1.0, 0.0, 0.0, 1.0)


def test_an_outline_on_the_image_follows_the_lens_and_ends_at_the_border(ax: Axes, tiny_rig: Rig) -> None:
    camera = tiny_rig["left"]
    square = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]])
    outline_on_image(ax, camera, square, color="white")
    (line,) = ax.lines
    drawn = line.get_xydata()
    np.testing.assert_array_equal(drawn[0], drawn[-1])
    np.testing.assert_allclose(drawn[[0, 8, 16, 24]], camera.floor_to_pixels(square))
    np.testing.assert_allclose(camera.pixels_to_floor(drawn[4:5]), [[2.0, 1.0]], atol=1e-6)  # halfway along a side
    outline_on_image(ax, camera, square + np.array([-4.0, 0.0]))  # partly behind the camera
    beyond = ax.lines[1].get_xydata()
    assert np.isnan(beyond).any() and camera.inside(beyond[np.isfinite(beyond[:, 0])]).all()


def test_lamps_and_shadows_have_the_shadow_of_similar_triangles(ax: Axes) -> None:
    lamps_and_shadows(ax, {"left": (-2.0, 2.5), "right": (4.0, 2.5)}, {"box": (0.5, 1.0, 1.25)}, (-2.0, 5.0))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "height (m)")
    assert texts(ax) == ["left camera", "left says occupied", "right camera", "right says occupied",
                         "both say occupied", "box"]  # fmt: skip
    shadows = [strip.get_paths()[0].get_extents() for strip in ax.collections]
    cell = 7 / 2000
    assert (shadows[0].x0, shadows[0].x1) == pytest.approx((0.5, 4.0), abs=2 * cell)  # twice as far as the lamp
    assert (shadows[1].x0, shadows[1].x1) == pytest.approx((-2.0, 1.0), abs=2 * cell)
    assert (shadows[2].x0, shadows[2].x1) == pytest.approx((0.5, 1.0), abs=2 * cell)  # the umbra is the box's base


# --- whole figures ----------------------------------------------------------------------------------------------
def box(name: str, x: float, y: float, height: float, hidden: dict[str, float]) -> SimpleNamespace:
    footprint = tuple((x + 0.2 * i, y + 0.2 * j) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    truth = TrueObject(label=name, x=x, y=y, footprint=footprint, hidden_fraction=hidden)
    return SimpleNamespace(height=height, colour=(120, 20, 20), footprint=footprint, truth=truth)


Shown = tuple[dict[str, Array], FrameResult, list[TrueObject]]


@pytest.fixture
def shown(tiny_rig: Rig, draw: Draw) -> Shown:
    """Images, result and truth of two boxes, the second hidden on the left."""
    boxes = [
        box("tall", 1.5, 1.5, 0.7, {"left": 0.0, "right": 0.0}),
        box("low", 2.5, 1.5, 0.1, {"left": 1.0, "right": 0.0}),
    ]
    images = draw(boxes)
    return images, Pipeline(tiny_rig, draw([])).process(images, 0.0), [b.truth for b in boxes]


def test_overview_shows_each_view_the_foreground_and_the_map(tiny_rig: Rig, shown: Shown) -> None:
    images, result, truth = shown
    fig = overview(tiny_rig, images, result, title="frame 3", truth=truth)
    left, right, foreground, grid = fig.axes
    assert [ax.get_title() for ax in fig.axes] == ["left", "right", "foreground on the floor", "map: 2 objects"]
    assert fig.get_suptitle() == "frame 3"
    np.testing.assert_array_equal(pixels(left), images["left"])
    np.testing.assert_array_equal(pixels(right), images["right"])
    assert left.title.get_color() == "#0072B2" and right.title.get_color() == "#E69F00"
    assert left.get_xlim() == (-0.5, 159.5) and left.get_ylim() == (119.5, -0.5)
    assert (foreground.get_xlabel(), grid.get_ylabel()) == ("x (m)", "y (m)")
    np.testing.assert_array_equal((pixels(grid) == 0.1).all(axis=2), result.map.data == 100)
    hidden = [str(o.id) + " hidden" for o in result.objects if "left" in o.hidden_in]
    assert len(hidden) == 1 and set(hidden) < set(texts(left))
    assert not any("hidden" in text for text in texts(right))
    unknown = [f"unknown: {REASONS[kind]}" for kind in REASONS if (result.reason == kind).any()]
    assert legend(grid) == [*unknown, "truth"]


def test_overview_shows_what_is_not_seen_now(tiny_rig: Rig, draw: Draw) -> None:
    pipeline, still, blinks = Pipeline(tiny_rig, draw([])), box("a", 1.0, 0.8, 0.3, {}), box("b", 2.9, 2.2, 0.3, {})
    first = pipeline.process(draw([still, blinks]), 0.0)
    result = pipeline.process(draw([still]), 0.1)
    left, right, _, shown = overview(tiny_rig, draw([still]), result).axes
    assert shown.get_title() == "map: 1 object, 1 not seen now"
    assert "unknown: not seen now" in legend(shown)
    (one,) = result.coasting
    assert {one.id, result.objects[0].id} == {each.id for each in first.objects}
    for ax, name in ((left, "left"), (right, "right")):
        (ring,) = ax.collections
        np.testing.assert_allclose(ring.get_offsets(), tiny_rig[name].floor_to_pixels([one.position_m]))
        assert texts(ax) == [str(result.objects[0].id), f"{one.id} not seen"]


def test_overview_counts_one_object_in_the_singular_and_takes_one_camera(tiny_rig: Rig, draw: Draw) -> None:
    rig = tiny_rig.select(["left"])
    images = draw([box("low", 2.0, 1.5, 0.1, {})])
    fig = overview(rig, images, Pipeline(rig, draw([])).process(images, 0.0))
    assert [ax.get_title() for ax in fig.axes] == ["left", "foreground on the floor", "map: 1 object"]
    assert fig.get_suptitle() == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("picture", "text"), [("none", "no picture"), ("absent", "no picture"), ("dark", "black, not used")]
)
def test_figures_of_an_instant_without_a_camera(
    tiny_rig: Rig, draw: Draw, shown: Shown, picture: str, text: str
) -> None:
    images: dict[str, Any] = {**shown[0], "left": np.zeros_like(shown[0]["left"]) if picture == "dark" else None}
    pipeline = Pipeline(tiny_rig, draw([]))
    pipeline.process(shown[0], 0.0)  # objects are known from two views, and followed in one
    result = pipeline.process(images, 0.1)
    if picture == "absent":
        del images["left"]
    truth, crop = shown[2], (10, 150, 20, 110)
    fig = overview(tiny_rig, images, result, truth=truth)
    left, right, foreground, grid = fig.axes
    assert left.get_title() == "left" and texts(left) == [text]  # no objects where they cannot be seen
    assert pixels(left).shape == (120, 160, 3) and len(np.unique(pixels(left))) == 1
    assert left.get_xlim() == (-0.5, 159.5) and left.get_ylim() == (119.5, -0.5)
    assert len(texts(right)) == len(result.objects) > 0
    assert legend(foreground) == ["right only"]
    seen = pixels(foreground)[result.views["right"]]
    np.testing.assert_allclose(seen, np.broadcast_to(0.35 + 0.65 * np.array(to_rgb("#E69F00")), seen.shape))
    assert legend(grid) == ["unknown: one view only", "truth"]
    options = {"crops": {"left": crop, "right": crop}, "window_m": (0.5, 3.5, 0.5, 2.5)}
    fig = views_and_map(tiny_rig, images, result, truth, **options)
    assert fig.axes[0].get_title() == f"left view: {result.excluded['left']}" and texts(fig.axes[0]) == [text]
    assert fig.axes[2].get_title().startswith("map from right: ")
    strip = frame_strip(tiny_rig, {3: images}, {3: result}, Truth({3: truth}), **options)
    assert texts(strip.axes[0]) == [text] and texts(strip.axes[1]) == []
    figure_png(fig, dpi=40)


def test_figures_of_an_instant_without_any_camera(tiny_rig: Rig, draw: Draw) -> None:
    images: dict[str, Any] = {"left": None, "right": None}
    result = Pipeline(tiny_rig, draw([])).process(images, 0.0)
    fig = overview(tiny_rig, images, result)
    assert fig.axes[2].get_legend() is None
    assert legend(fig.axes[3]) == ["unknown: no camera sees it"]
    figure_png(fig, dpi=40)


def test_views_and_map_names_what_is_hidden(tiny_rig: Rig, shown: Shown) -> None:
    images, result, truth = shown
    crop = (10, 150, 20, 110)
    fig = views_and_map(
        tiny_rig, images, result, truth, crops={"left": crop, "right": crop}, window_m=(0.5, 3.5, 0.5, 2.5)
    )
    left, right, grid = fig.axes
    assert left.get_title() == "left view: 1 of 2 objects" and right.get_title() == "right view: 2 of 2 objects"
    assert "low: hidden here" in texts(left) and "low" in texts(right) and "tall" in texts(left)
    assert left.get_xlim() == (10, 150) and left.get_ylim() == (110, 20)
    assert grid.get_xlim() == (0.5, 3.5) and grid.get_ylim() == (0.5, 2.5)
    assert any("2" in text for text in (grid.get_title(), *texts(grid)))


def test_figure_png_is_a_png_of_the_asked_size_and_the_same_twice() -> None:
    def figure() -> Figure:
        fig, ax = new_figure(width=3, height=2)
        show_floor(ax, np.eye(4, 8), FLOOR)
        return fig

    data = figure_png(figure(), dpi=50)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.shape == (100, 150, 3)
    assert data == figure_png(figure(), dpi=50)


def test_drawing_changes_no_input(tiny_rig: Rig, shown: Shown) -> None:
    images, result, truth = shown
    kept = {name: image.copy() for name, image in images.items()}
    data, view = result.map.data.copy(), result.views["left"].copy()
    figure_png(overview(tiny_rig, images, result, truth=truth), dpi=40)
    for name, image in kept.items():
        np.testing.assert_array_equal(images[name], image)
    np.testing.assert_array_equal(result.map.data, data)
    np.testing.assert_array_equal(result.views["left"], view)


def test_a_head_is_covered_and_nothing_else(tiny_rig: Rig) -> None:
    image = np.full((120, 160, 3), 30, np.uint8)
    camera = tiny_rig["left"]
    covered = cover_heads(image, camera, [TrueObject(id="A", x=2.0, y=1.5)])
    ((x, y),) = np.rint(camera.project([[2.0, 1.5, 1.72]])).astype(int)
    assert (image == 30).all() and (covered[y, x] > 100).all()
    rows, columns = np.nonzero((covered != 30).any(axis=2))
    assert len(rows) < 0.02 * 160 * 120 and abs(columns.mean() - x) < 2
    assert (cover_heads(image, camera, [TrueObject(id="A", x=-9.0, y=1.5)]) == image).all()  # behind the camera


def test_a_cylinder_is_outlined_where_the_polar_view_shows_it(ax: Axes, tiny_rig: Rig) -> None:
    warp = PolarWarp(tiny_rig["left"], tiny_rig.floor)
    outline_cylinders(ax, warp, [Prism(2.0, 1.5, 0.2, 0.5), Prism(-9.0, 1.5, 0.2, 0.5)], color="red")
    (line,) = ax.lines  # the second one lies behind the camera
    assert texts(ax) == ["1"] and line.get_color() == "red"
    columns, rows = line.get_xdata(), line.get_ydata()
    assert columns[0] == columns[-1] and rows[0] == rows[-1]
    inside = warp.pixels[int(np.mean(rows)), int(np.mean(columns))]
    (axis,) = tiny_rig["left"].project([[2.0, 1.5, 0.25]])
    assert np.hypot(*(inside - axis)) < 4
