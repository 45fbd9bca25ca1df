"""Occupancy maps: unknown is never free, and map_server files read back as they were written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from occlib import mapping, recordings
from occlib.geometry import Floor
from occlib.mapping import OccupancyMap, load_map, occupancy_map, save_map

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


@settings(max_examples=30, deadline=None)
@given(data=hnp.arrays(np.int8, (4, 6), elements=st.sampled_from([-1, 0, 100])))
def test_files_read_back_equal(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    grid = OccupancyMap(data, FLOOR)
    path = save_map(tmp_path_factory.mktemp("map") / "map", grid)
    assert load_map(path) == grid
    assert np.array_equal(read_as_map_server(path), data)


def test_the_first_row_of_the_picture_is_the_largest_y(tmp_path: Path) -> None:
    save_map(tmp_path / "map.yaml", asymmetric())
    picture = recordings.read_image(tmp_path / "map.pgm")[..., 0]
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
        ("trinary", "scale", "mode: expected 'trinary', got 'scale'"),
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
    with pytest.raises(ValueError, match="data: expected only -1, 0 and 100, got 50"):
        save_map(tmp_path / "map", OccupancyMap(np.full(FLOOR.shape, 50, np.int8), FLOOR))
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
