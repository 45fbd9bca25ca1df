"""Occupancy maps: unknown is never free, and map_server files read back as they were written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from scipy import ndimage

from occlib import mapping
from occlib.base import files
from occlib.geometry import Floor, Rig
from occlib.mapping import (
    EDGE,
    EDGE_M,
    FREE,
    MODES,
    OCCUPIED,
    REASONS,
    UNKNOWN,
    OccupancyMap,
    Remembered,
    inflate,
    instant_map,
    load_map,
    occupancy_map,
    save_map,
)
from occlib.pipeline import Pipeline, settings_for
from occlib.plotting import new_figure, show_map

FLOOR = Floor((-1.0, 0.5), (2.0, 3.0), 0.25)  # 4 x 6 cells


def asymmetric() -> OccupancyMap:
    data = np.zeros(FLOOR.shape, np.int8)
    data[0, 0] = 100  # smallest x, smallest y
    data[3, 4:] = -1  # largest y
    data[1, 2] = 100
    return OccupancyMap(data, FLOOR)


def read_as_map_server(path: Path) -> np.ndarray[Any, Any]:
    """The rule of ROS map_server, written out cell by cell, without our loader."""
    fields = yaml.safe_load(path.read_text())
    magic, size, depth, pixels = (path.parent / fields["image"]).read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    assert (magic, depth, len(pixels)) == (b"P5", b"255", width * height)
    data = np.empty((height, width), int)
    for j in range(height):
        for i in range(width):
            p = (255 - pixels[(height - j - 1) * width + i]) / 255.0
            data[j, i] = 100 if p > fields["occupied_thresh"] else 0 if p < fields["free_thresh"] else -1
    return data


def test_every_combination_of_occupied_and_visible() -> None:
    occupied = np.array([[True, True, False, False]])
    visible = np.array([[True, False, True, False]])
    before = occupied.copy(), visible.copy()
    grid = occupancy_map(occupied, visible, Floor((0, 4), (0, 1), 1.0))
    assert grid.data.tolist() == [[100, 100, 0, -1]] and grid.data.dtype == np.int8
    assert np.array_equal(before, (occupied, visible))


@settings(max_examples=50, deadline=None)
@given(hnp.arrays(bool, (4, 6)), hnp.arrays(bool, (4, 6)))
def test_nothing_unseen_is_ever_free(occupied: np.ndarray[Any, Any], visible: np.ndarray[Any, Any]) -> None:
    data = occupancy_map(occupied, visible, FLOOR).data
    assert set(np.unique(data)) <= {-1, 0, 100}
    assert np.array_equal(data == 100, occupied)
    assert visible[data == 0].all() and not visible[data == -1].any()


# --- beside an object -------------------------------------------------------------------------------------
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), resolution=st.sampled_from([0.02, 0.05, 0.06, 0.12, 0.2]), coasts=st.booleans())
def test_bare_floor_beside_an_object_seen_or_remembered_is_unknown_and_nothing_else_changes(
    seed: int, resolution: float, coasts: bool
) -> None:
    floor = Floor((0.0, 20 * resolution), (1.0, 1.0 + 12 * resolution), resolution)
    rng = np.random.default_rng(seed)

    def cells(share: float) -> np.ndarray[Any, Any]:
        return rng.random(floor.shape) < share

    labels = cells(0.03).astype(np.int32)
    views, visible = {"left": cells(0.2)}, {"left": cells(0.8), "right": cells(0.5)}
    way = cells(0.1)
    remembered = Remembered(way & cells(0.5), way) if coasts else None
    given_ = (labels, cells(0.1) & (labels == 0), cells(0.2), views, visible, 1, floor, remembered)
    grid, reason = instant_map(*given_)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mapping, "EDGE_M", 0.0)
        plain, why = instant_map(*given_)
    stands = np.argwhere((plain.data == OCCUPIED) | (way & coasts))  # or may stand
    beside = np.zeros(floor.shape, bool)
    for iy, ix in np.ndindex(floor.shape):
        far = np.hypot(*(stands - (iy, ix)).T) * resolution
        beside[iy, ix] = plain.data[iy, ix] == FREE and (far < EDGE_M - 1e-6).any()
    np.testing.assert_array_equal(grid.data == OCCUPIED, plain.data == OCCUPIED)
    np.testing.assert_array_equal(reason, np.where(beside, EDGE, why))
    np.testing.assert_array_equal(grid.data, np.where(beside, UNKNOWN, plain.data))


def test_an_objects_edge_is_as_wide_as_it_says() -> None:
    floor = Floor((0.0, 1.0), (0.0, 0.02), 0.02)
    nothing, labels = np.zeros(floor.shape, bool), np.zeros(floor.shape, np.int32)
    labels[0, :5] = 1
    grid, reason = instant_map(labels, nothing, labels > 0, {"a": labels > 0}, {"a": ~nothing}, 1, floor)
    assert grid.data[0].tolist() == [OCCUPIED] * 5 + [UNKNOWN] * 5 + [FREE] * 40  # centres 2 to 10 cm away, not 12
    assert reason[0].tolist() == [0] * 5 + [EDGE] * 5 + [0] * 40
    assert REASONS[EDGE] == "beside an object" and EDGE == max(REASONS) == len(REASONS)
    empty, none = instant_map(labels * 0, nothing, nothing, {"a": nothing}, {"a": ~nothing}, 1, floor)
    assert (empty.data == FREE).all() and not none.any()


# --- files ------------------------------------------------------------------------------------------------
@settings(max_examples=30, deadline=None)
@given(data=hnp.arrays(np.int8, (4, 6), elements=st.sampled_from([-1, 0, 100])))
def test_files_read_back_equal(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    grid = OccupancyMap(data, FLOOR)
    path = save_map(tmp_path_factory.mktemp("map") / "map", grid)
    assert load_map(path) == grid
    assert np.array_equal(read_as_map_server(path), data)


def read_as_nav2(path: Path) -> np.ndarray[Any, Any]:
    """``loadMapFromFile`` of nav2_map_server, cell by cell, on the pixels as Pillow decodes them."""
    fields = yaml.safe_load(path.read_text())
    image = Image.open(path.parent / fields["image"])
    high, low = fields["occupied_thresh"], fields["free_thresh"]
    data = np.empty(image.size[::-1], int)
    for y in range(image.height):
        for x in range(image.width):
            *colours, alpha = image.convert("RGBA").getpixel((x, y))  # type: ignore[misc]
            shade = sum(colours) / 3 / 255
            if fields["mode"] == "trinary" and image.mode.endswith("A"):
                shade = (sum(colours) + alpha) / 4 / 255
            occupied = shade if fields["negate"] else 1 - shade
            if fields["mode"] == "raw":
                cell = round(shade * 255) if round(shade * 255) <= 100 else -1
            elif fields["mode"] == "scale" and alpha != 255:
                cell = -1
            elif occupied > high:
                cell = 100
            elif occupied < low:
                cell = 0
            else:
                cell = -1 if fields["mode"] == "trinary" else round((occupied - low) / (high - low) * 100)
            data[image.height - y - 1, x] = cell
    return data


VALUES = np.arange(-1, 101, dtype=np.int8).reshape(6, 17)
VALUES_FLOOR = Floor((-1.7, 0.0), (0.3, 0.9), 0.1)


@pytest.mark.parametrize("mode", ["scale", "raw"])
def test_every_value_reads_back_and_nav2_reads_the_same(tmp_path: Path, mode: str) -> None:
    path = save_map(tmp_path / "map", OccupancyMap(VALUES, VALUES_FLOOR), mode=mode)
    assert load_map(path) == OccupancyMap(VALUES, VALUES_FLOOR)
    assert np.array_equal(read_as_nav2(path), VALUES)
    fields = yaml.safe_load(path.read_text())
    assert (fields["mode"], fields["image"]) == (mode, "map.png" if mode == "scale" else "map.pgm")


@settings(max_examples=60, deadline=None)
@given(
    data=hnp.arrays(np.int8, (4, 6), elements=st.integers(-1, 100)),
    mode=st.sampled_from(MODES),
    suffix=st.sampled_from(["", ".png", ".pgm", ".yaml"]),
)
def test_maps_read_back_in_every_mode(
    tmp_path_factory: pytest.TempPathFactory, data: Any, mode: str, suffix: str
) -> None:
    if mode == "trinary":
        data = np.select([data < 34, data < 67], [-1, 0], 100).astype(np.int8)
    if mode == "scale" and suffix == ".pgm":
        data = np.abs(data)
    before = data.copy()
    path = save_map(tmp_path_factory.mktemp("map") / f"map{suffix}", OccupancyMap(data, FLOOR), mode=mode)
    assert load_map(path) == OccupancyMap(before, FLOOR)
    assert np.array_equal(read_as_nav2(path), before)


def test_ros1_reads_scale_at_most_two_lower_and_raw_alike(tmp_path: Path) -> None:
    """The arithmetic of ``image_loader.cpp``: ``99 * ratio`` truncated, alpha looked at between the thresholds only."""
    path = save_map(tmp_path / "map", OccupancyMap(VALUES, VALUES_FLOOR), mode="scale")
    grey, alpha = np.moveaxis(np.array(Image.open(tmp_path / "map.png"))[::-1, :, 2:].astype(float), 2, 0)
    fields, p = yaml.safe_load(path.read_text()), (255 - grey) / 255
    ratio = (p - fields["free_thresh"]) / (fields["occupied_thresh"] - fields["free_thresh"])
    between = np.where(alpha < 1, -1, np.trunc(99 * ratio))
    read = np.select([p > fields["occupied_thresh"], p < fields["free_thresh"]], [100, 0], between)
    assert np.array_equal(read == -1, VALUES == -1)
    assert (VALUES - read).min() == 0 and (VALUES - read).max() <= 2
    save_map(tmp_path / "raw", OccupancyMap(VALUES, VALUES_FLOOR), mode="raw")
    pixels = np.array(Image.open(tmp_path / "raw.pgm"))[::-1]
    assert np.array_equal(pixels.view(np.int8), VALUES)  # unsigned char to int8


def test_pictures_with_alpha_made_elsewhere(tmp_path: Path) -> None:
    path = save_map(tmp_path / "map.png", asymmetric(), mode="trinary")
    rgba = np.zeros((4, 6, 4), np.uint8)
    rgba[0] = (254, 254, 254, 255)
    rgba[1] = (205, 205, 205, 255)
    rgba[2] = (0, 0, 0, 255)  # (255 - 63.75) / 255 = 0.75: still occupied
    rgba[3] = (254, 254, 254, 0)  # (255 - 190.5) / 255 = 0.25: unknown
    Image.fromarray(rgba).save(tmp_path / "map.png")
    assert load_map(path).data[:, 0].tolist() == [-1, 100, 0, 0] == read_as_nav2(path)[:, 0].tolist()
    text = path.read_text()
    path.write_text(text.replace("trinary", "raw"))
    assert load_map(path).data[:, 0].tolist() == [-1, 0, -1, -1] == read_as_nav2(path)[:, 0].tolist()
    path.write_text(text.replace("trinary", "scale").replace("negate: 0", "negate: 1"))
    assert load_map(path).data[:, 0].tolist() == [-1, 0, 100, 100] == read_as_nav2(path)[:, 0].tolist()


def test_raw_greys_above_100_are_unknown_and_negate_does_not_matter(tmp_path: Path) -> None:
    path = save_map(tmp_path / "map", asymmetric(), mode="raw")
    (tmp_path / "map.pgm").write_bytes(b"P5\n6 1\n255\n" + bytes([0, 99, 100, 101, 180, 255]))
    for text in (path.read_text(), path.read_text().replace("negate: 0", "negate: 1")):
        path.write_text(text)
        assert load_map(path).data.tolist() == [[0, 99, 100, -1, -1, -1]] == read_as_nav2(path).tolist()


def test_pictures_of_map_saver_with_a_comment_are_read(tmp_path: Path) -> None:
    path = save_map(tmp_path / "map", asymmetric())
    header = b"P5\n# CREATOR: map_saver.cpp 0.250 m/pix\n3 1\n255\n"
    (tmp_path / "map.pgm").write_bytes(header + bytes([0, 205, 254]))
    assert load_map(path).data.tolist() == [[100, -1, 0]]


def test_alpha_of_16_bit_pictures(tmp_path: Path) -> None:
    rgba = np.full((1, 3, 4), 0xFEFE, np.uint16)
    rgba[0, :, 3] = 0xFFFF, 0x80FF, 0
    assert cv2.imwrite(str(tmp_path / "map.png"), rgba)
    assert files.read_image(tmp_path / "map.png", alpha=True)[0].tolist() == [[254] * 3 + [a] for a in (255, 128, 0)]
    assert files.read_image(tmp_path / "map.png").shape == (1, 3, 3)
    assert cv2.imwrite(str(tmp_path / "grey.png"), np.zeros((1, 3), np.uint8))
    assert files.read_image(tmp_path / "grey.png", alpha=True).shape == (1, 3, 3)


@settings(max_examples=60, deadline=None)
@given(data=hnp.arrays(np.int8, (5, 7), elements=st.sampled_from([-1, 0, 40, 100])), radius=st.floats(0, 1.2))
def test_inflation_agrees_with_every_pair_of_cells(data: Any, radius: float) -> None:
    floor = Floor((0.0, 0.7), (1.0, 1.5), 0.1)
    before, expected = data.copy(), data.copy()
    for iy, ix in np.ndindex(data.shape):
        for jy, jx in np.argwhere(data == 100):
            if data[iy, ix] != -1 and (iy - jy) ** 2 + (ix - jx) ** 2 < (radius / 0.1) ** 2 - 1e-5:
                expected[iy, ix] = 100
    inflated = inflate(OccupancyMap(data, floor), radius)
    assert np.array_equal(inflated.data, expected) and inflated.floor == floor
    assert np.array_equal(data, before)


def test_inflation_is_open_and_needs_a_radius() -> None:
    grid = asymmetric()
    assert inflate(grid, 0.25) == grid  # the next centre is not closer than that
    assert (inflate(grid, 0.26).data == 100).sum() == 3 + 5  # the corner with two neighbours, the other with four
    for radius in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="radius_m: expected metres >= 0"):
            inflate(grid, radius)


def test_the_first_row_of_the_picture_is_the_largest_y(tmp_path: Path) -> None:
    save_map(tmp_path / "map.yaml", asymmetric())
    picture = files.read_image(tmp_path / "map.pgm")[..., 0]
    assert picture.shape == (4, 6)
    assert picture[3, 0] == 0 and picture[0, 0] == 254 and picture[0, 5] == 205 and picture[2, 2] == 0


def test_description_has_the_fields_of_map_server(tmp_path: Path) -> None:
    path = save_map(tmp_path / "deep" / "map.0040", asymmetric())
    assert path.name == "map.0040.yaml"
    assert yaml.safe_load(path.read_text()) == {
        "image": "map.0040.pgm",
        "mode": "trinary",
        "resolution": 0.25,
        "origin": [-1.0, 2.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    assert sorted(p.name for p in path.parent.iterdir()) == ["map.0040.pgm", "map.0040.yaml"]


def test_a_real_floor_keeps_its_edges(tmp_path: Path) -> None:
    floor = Floor((-2.5, 2.5), (-2.0, 2.5), 0.02)
    path = save_map(tmp_path / "map", OccupancyMap(np.zeros(floor.shape, np.int8), floor))
    assert load_map(path).floor == floor


def test_saving_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    grid = asymmetric()
    before = grid.data.copy()
    first, second = (save_map(tmp_path / name / "map", grid) for name in "ab")
    for suffix in (".yaml", ".pgm"):
        assert first.with_suffix(suffix).read_bytes() == second.with_suffix(suffix).read_bytes()
    assert np.array_equal(before, grid.data)


def test_negate_and_other_thresholds_are_honoured(tmp_path: Path) -> None:
    path = save_map(tmp_path / "map", asymmetric())
    path.write_text(path.read_text().replace("negate: 0", "negate: 1"))
    assert load_map(path).data[0, 0] == 0 and load_map(path).data[0, 1] == 100
    path.write_text(path.read_text().replace("negate: 1", "negate: 0").replace("0.196", "0.25"))
    assert load_map(path).data[3, 5] == 0  # the trap: 205 reads as free


def test_thresholds_are_strict(tmp_path: Path) -> None:
    path = save_map(tmp_path / "map", asymmetric())
    text = path.read_text().replace("0.196", repr(50 / 255)).replace("0.65", "1.0")
    path.write_text(text)
    assert load_map(path).data[3, 5] == -1 and load_map(path).data[0, 0] == -1


def test_maps_compare_by_value() -> None:
    other = OccupancyMap(asymmetric().data, Floor((0.0, 1.5), (2.0, 3.0), 0.25))
    assert asymmetric() == asymmetric()
    assert asymmetric() != other and asymmetric() != "map"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("trinary", "scaled", "mode: expected one of trinary, scale, raw, got 'scaled'"),
        ("negate: 0", "negate: 2", "negate: expected 0 or 1, got 2"),
        ("resolution: 0.25", "resolution: fine", "resolution: expected a finite number, got 'fine'"),
        ("resolution: 0.25", "resolution: -0.25", "floor.x: expected"),
        ("[-1.0, 2.0, 0.0]", "[-1.0, 2.0]", r"origin: expected \[x, y, yaw\]"),
        ("[-1.0, 2.0, 0.0]", "[-1.0, 2.0, 0.5]", "origin: expected yaw 0, got 0.5"),
        ("[-1.0, 2.0, 0.0]", "[-1.0, .nan, 0.0]", "origin: expected a finite number, got nan"),
        ("0.196", "0.7", "free_thresh: expected 0 <= free <= occupied <= 1"),
        ("image: map.pgm", "image: other.pgm", "other.pgm: cannot read"),
        ("image: map.pgm", "image: 7", "expected a mapping with 'image'"),
        ("image: map.pgm", "image: [", "not valid YAML"),
    ],
)
def test_malformed_descriptions(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = save_map(tmp_path / "map", asymmetric())
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ValueError, match=f"map.yaml: .*{message}"):
        load_map(path)


def test_wrong_arrays_are_named() -> None:
    good = np.zeros(FLOOR.shape, bool)
    with pytest.raises(ValueError, match=r"occupied: expected bool \(4, 6\), got uint8 \(4, 6\)"):
        occupancy_map(good.astype(np.uint8), good, FLOOR)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"visible: expected bool \(4, 6\), got bool \(6, 4\)"):
        occupancy_map(good, good.T, FLOOR)
    with pytest.raises(ValueError, match=r"data: expected int8 \(4, 6\), got int64"):
        OccupancyMap(good.astype(np.int64), FLOOR)  # type: ignore[arg-type]


def test_other_values_are_not_saved(tmp_path: Path) -> None:
    half = OccupancyMap(np.full(FLOOR.shape, 50, np.int8), FLOOR)
    with pytest.raises(ValueError, match="data: expected only -1, 0 and 100, got 50; modes scale and raw hold it"):
        save_map(tmp_path / "map", half)
    with pytest.raises(ValueError, match="mode: expected one of trinary, scale, raw, got 'grey'"):
        save_map(tmp_path / "map", half, mode="grey")
    with pytest.raises(ValueError, match="data: a PGM cannot hold unknown cells in mode scale"):
        save_map(tmp_path / "map.pgm", asymmetric(), mode="scale")
    for value in (-2, 101):
        with pytest.raises(ValueError, match=f"data: expected -1 to 100, got {value} to {value}"):
            OccupancyMap(np.full(FLOOR.shape, value, np.int8), FLOOR)
    assert not list(tmp_path.iterdir())


def test_a_failed_write_is_a_one_line_error_and_leaves_no_description(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(ValueError, match="cannot write"):
        save_map(tmp_path / "file" / "map", asymmetric())

    def full_disk(path: Path, content: bytes | str) -> Path:
        raise ValueError(f"{path}: cannot write (No space left on device)")

    monkeypatch.setattr(mapping, "write_file", full_disk)
    with pytest.raises(ValueError, match=r"map.pgm: cannot write \(No space left"):  # the picture comes first
        save_map(tmp_path / "map", asymmetric())
    assert not (tmp_path / "map.yaml").exists()


# --- the right way round ---------------------------------------------------------------------------------
L_PLACES = {(200, 30, 30): (0.8, 0.7), (30, 140, 30): (0.8, 2.3), (30, 30, 200): (3.1, 0.7)}
"""An L: the corner at small x and y, the long leg along x, the short one along y. Colours tell the boxes apart."""


def turn(points: Sequence[Sequence[float]]) -> float:
    """Twice the signed area of a triangle: its sign changes when a picture is mirrored, not when it is turned."""
    (ax, ay), (bx, by), (cx, cy) = points
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@pytest.fixture
def l_scene(tiny_rig: Rig, draw: Any, box: Any) -> tuple[OccupancyMap, dict[str, np.ndarray[Any, Any]]]:
    """The map that the whole chain makes of the L, and the pictures that it was made from."""
    boxes = [box("", *place, side=0.35, height=0.05, colour=colour) for colour, place in L_PLACES.items()]
    images = draw(boxes)
    settings = settings_for(rule="and", threshold="half-otsu")
    return Pipeline(tiny_rig, draw([]), settings).process(images, 0.0).map, images


def dark_blobs(picture: np.ndarray[Any, Any]) -> list[tuple[float, float]]:
    """Centres (column, row) of the black areas of a picture, from left to right."""
    labels, count = ndimage.label(picture == 0)
    assert count == 3
    return sorted((x, y) for y, x in ndimage.center_of_mass(labels > 0, labels, range(1, 4)))


@pytest.mark.parametrize("mode", MODES)
def test_the_saved_picture_shows_the_scene_the_right_way_up(l_scene: Any, tmp_path: Path, mode: str) -> None:
    grid, images = l_scene
    path = save_map(tmp_path / "map", grid, mode=mode)
    picture = np.array(Image.open(path.parent / yaml.safe_load(path.read_text())["image"]).convert("L"))
    black = picture if mode != "raw" else 100 - picture  # raw pictures are dark where free
    seen = dark_blobs(black)
    expected = sorted((x / 0.05 - 0.5, (3.0 - y) / 0.05 - 0.5) for x, y in L_PLACES.values())  # row 0 at y = 3 m
    corner, leg = sorted(seen[:2], key=lambda place: -place[1])  # the lower in the picture is the corner
    np.testing.assert_allclose([*sorted([corner, leg]), seen[2]], expected, atol=1.5)
    # Each camera looks down on the floor, so its picture is turned and foreshortened against the map, never mirrored.
    for image in images.values():
        places = [np.argwhere((image == colour).all(axis=2)).mean(axis=0)[::-1] for colour in L_PLACES]
        assert turn(places) * turn([corner, leg, seen[2]]) > 0


def test_left_and_right_of_the_cameras_are_those_of_the_map(tiny_rig: Rig, l_scene: Any) -> None:
    """The left camera looks along +x: what is further along y is further to its left. The right camera looks back."""
    _, images = l_scene
    columns = {}
    for name, image in images.items():
        columns[name] = [np.argwhere((image == colour).all(axis=2))[:, 1].mean() for colour in L_PLACES]
        projected = tiny_rig[name].project([(*place, 0.05) for place in L_PLACES.values()])[:, 0]
        np.testing.assert_allclose(columns[name], projected, atol=2.5)
    (corner, up, _), (corner_back, up_back, _) = columns["left"], columns["right"]
    assert up < corner and up_back > corner_back


def test_the_drawn_map_has_y_up_and_x_to_the_right(l_scene: Any) -> None:
    grid, _ = l_scene
    figure, ax = new_figure()
    show_map(ax, grid)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., 0]
    origin, right, up = ax.transData.transform([(0, 0), (1, 0), (0, 1)])
    assert right[0] > origin[0] and up[1] > origin[1]  # Matplotlib's own pixels count from the bottom
    for x, y in L_PLACES.values():
        column, row = ax.transData.transform((x, y)).round().astype(int)
        assert pixels[pixels.shape[0] - 1 - row, column] < 60
    column, row = ax.transData.transform((3.1, 2.3)).round().astype(int)
    assert pixels[pixels.shape[0] - 1 - row, column] > 200  # the empty corner
