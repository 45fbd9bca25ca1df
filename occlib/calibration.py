"""Camera calibration from checkerboards (section 2 of the paper, Fig 1). The floor's turn is in :mod:`occlib.floor_marks`.

"We use a 2D square grid ... The square corner coordinates are manually marked from checkerboard's image at
different orientations. With the known sizes of the square, MatLab toolbox calculates the camera parameters."
Here OpenCV takes the toolbox's place (Zhang 2000, doi:10.1109/34.888718, with the Brown-Conrady distortion
k1, k2, p1, p2, k3). Corners are found automatically, or marked by hand and refined.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from occlib.base import checks
from occlib.base.arrays import FloatArray, Image, as_points
from occlib.base.files import read_image, read_yaml, write_file
from occlib.geometry import Camera, image_size, invert_homography
from occlib.lens import HasLens, Lens

Pattern: TypeAlias = tuple[int, int]
"""Inner corners of a board, (columns, rows)."""

_CORNER_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-6)
"""A corner is refined step by step: at most 100 steps, or until it moves by less than 1e-6 px."""

_MIN_VIEWS = 3
"""Two views leave the distortion open."""

_MIN_TILT_DEG = 5.0
"""Boards that are more nearly parallel leave focal length and distance tied."""


@dataclass(frozen=True)
class Calibration:
    """The intrinsics of a camera, and how well they explain the views.

    Parameters
    ----------
    size
        ``(width, height)`` in px.
    lens
        The intrinsic matrix, and the distortion.
    rms_px
        Root mean square reprojection error over all corners in px, lower is better.
    views_used
        Number of views.
    view_rms_px
        The same error of each view, shape (V,); empty when read from a file, as are the next two.
    rotations, translations
        Board to camera for each view, shapes (V, 3, 3) and (V, 3), in the unit of the board.
    images_used, images_skipped
        Names of the images with and without a board.
    """

    size: tuple[int, int]
    lens: Lens
    rms_px: float
    views_used: int
    view_rms_px: FloatArray = field(default_factory=lambda: np.empty(0))
    rotations: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))
    translations: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    images_used: tuple[str, ...] = ()
    images_skipped: tuple[str, ...] = ()

    @property
    def matrix(self) -> FloatArray:
        """The lens's 3x3 intrinsic matrix in px."""
        return self.lens.matrix

    @property
    def distortion(self) -> FloatArray:
        """The lens's distortion coefficients."""
        return self.lens.distortion

    def camera(self, name: str, image_to_floor: npt.ArrayLike) -> Camera:
        """The calibrated camera with its homography to the floor (3x3, undistorted px to m)."""
        homography = np.asarray(image_to_floor, dtype=np.float64)
        invert_homography(homography, "image_to_floor")
        return Camera(name, self.size, self.lens, homography)


def parse_pattern(text: str) -> Pattern:
    """Inner corners ``(columns, rows)`` of a board from a text such as ``9x6``.

    >>> parse_pattern("9x6")
    (9, 6)
    """
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts):
        raise ValueError(f"pattern: expected COLUMNSxROWS of inner corners, such as 9x6, got {text!r}")
    return _checked_pattern((int(parts[0]), int(parts[1])))


def board_points(pattern: Pattern, square: float) -> FloatArray:
    """Inner corners of a board, row by row, in its own plane ``z = 0``.

    Parameters
    ----------
    pattern
        Inner corners ``(columns, rows)``.
    square
        Side of a square in m.

    Returns
    -------
    ndarray, shape (columns * rows, 3)
        In m, x along a row, y from row to row.

    >>> board_points((3, 3), 0.5)[:4, :2].tolist()
    [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [0.0, 0.5]]
    """
    columns, rows = _checked_pattern(pattern)
    checks.number("square", square, least=1e-9, most=1e6, expected="metres > 0")
    grid = np.mgrid[:columns, :rows].T.reshape(-1, 2) * float(square)
    return np.column_stack([grid, np.zeros(len(grid))])


def find_checkerboard(image: Image, pattern: Pattern, *, window_px: int = 11) -> FloatArray | None:
    """Inner corners of a checkerboard to a fraction of a px, or ``None`` if it is not wholly in view.

    Parameters
    ----------
    image
        uint8 grey (H, W) or RGB (H, W, 3).
    pattern
        Inner corners ``(columns, rows)``.
    window_px
        Largest half side of the refinement window; it never reaches further than half the smallest
        distance between corners, so that a small board's neighbours do not pull.

    Returns
    -------
    ndarray, shape (columns * rows, 2), or None
        Row by row. In the image the next row lies to the right of the direction of a row, and the first corner
        is the end nearer to the image's top left. (A board with as many columns as rows may still come
        turned by 90 degrees.)
    """
    grey, pattern = _grey(image), _checked_pattern(pattern)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(grey, pattern, flags=flags)
    if not found:  # slower, but finds boards in poor light
        found, corners = cv2.findChessboardCornersSB(grey, pattern, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    grid = _ordered(np.asarray(corners, dtype=np.float64).reshape(pattern[1], pattern[0], 2))
    spacing = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
    return refine_corners(grey, grid.reshape(-1, 2), window_px=max(2, min(window_px, int(spacing / 2))))


def refine_corners(image: Image, marks_px: npt.ArrayLike, *, window_px: int = 5) -> FloatArray:
    """Corners marked by hand, moved to where the image's gradients cross.

    Parameters
    ----------
    image
        uint8 grey (H, W) or RGB (H, W, 3).
    marks_px
        Marks (N, 2) in px, each within ``window_px`` of its corner.
    window_px
        Half side of the window that is searched. Where it shows no corner the mark stays as it is.

    Returns
    -------
    ndarray, shape (N, 2)

    Notes
    -----
    Foerstner's condition, that the gradient is orthogonal to the line to the corner
    (`cv2.cornerSubPix`).
    """
    grey, marks = _grey(image), as_points(marks_px, name="marks_px")
    checks.number("window_px", window_px, least=1, unit="half a side in px")
    height, width = grey.shape
    outside = ~((marks >= 0) & (marks <= [width - 1, height - 1])).all(axis=1)
    if outside.any():
        raise ValueError(f"marks_px: expected points in the {width}x{height} image, got {marks[outside][0].tolist()}")
    if min(grey.shape) < 2 * window_px + 5:
        raise ValueError(f"image: expected at least {2 * window_px + 5} px a side, got {width}x{height}")
    if not len(marks):
        return marks
    start = marks.astype(np.float32).reshape(-1, 1, 2)
    window = (int(window_px), int(window_px))
    return np.asarray(cv2.cornerSubPix(grey, start, window, (-1, -1), _CORNER_STEPS), np.float64).reshape(-1, 2)


def calibrate(corner_sets: Sequence[npt.ArrayLike], board: npt.ArrayLike, size: tuple[int, int]) -> Calibration:
    """Intrinsics and distortion from several views of a flat board.

    Parameters
    ----------
    corner_sets
        For each view the corners (N, 2) in px, found or marked by hand; three views or more, the board
        tilted differently in each.
    board
        The same corners (N, 3) on the board in m (:func:`board_points`).
    size
        ``(width, height)`` of the images in px.

    Raises
    ------
    ValueError
        Fewer than three views, corners that do not fit the board, or boards all within 5 degrees of parallel.
    """
    plane = as_points(board, dimensions=3, name="board")
    views = [as_points(corners, name=f"corner_sets[{i}]") for i, corners in enumerate(corner_sets)]
    if len(views) < _MIN_VIEWS:
        raise ValueError(f"corner_sets: expected at least {_MIN_VIEWS} views, got {len(views)}")
    for i, corners in enumerate(views):
        if len(corners) != len(plane) or not np.isfinite(corners).all():
            raise ValueError(f"corner_sets[{i}]: expected {len(plane)} finite corners, got shape {corners.shape}")
    try:
        lens, poses, rms_px, view_rms_px = Lens.calibrate(plane, views, size)
    except ValueError as error:
        raise ValueError(f"corner_sets: {error}") from None
    rotations = np.array([rotation for rotation, _ in poses])
    _check_tilt(rotations)
    return Calibration(
        size=(int(size[0]), int(size[1])),
        lens=lens,
        rms_px=rms_px,
        views_used=len(views),
        view_rms_px=view_rms_px,
        rotations=rotations,
        translations=np.array([translation for _, translation in poses]),
    )


def calibrate_images(
    paths: Sequence[str | Path], pattern: Pattern, square: float, *, window_px: int = 11, progress: bool = False
) -> Calibration:
    """Intrinsics from photographs of a checkerboard.

    Parameters
    ----------
    paths
        Images of one size. Those without the whole board are skipped and listed in ``images_skipped``.
    pattern
        Inner corners ``(columns, rows)``.
    square
        Side of a square in m.
    window_px
        As for :func:`find_checkerboard`. OpenCV's sample uses 11; on its own photographs 7 halves the rms.
    progress
        Print a line for each image on stderr.

    Raises
    ------
    ValueError
        An image cannot be read or has another size, or fewer than three show the board.
    """
    board = board_points(pattern, square)
    corner_sets: list[FloatArray] = []
    used: list[str] = []
    skipped: list[str] = []
    size: tuple[int, int] | None = None
    for path in paths:
        image = read_image(path)
        came = (image.shape[1], image.shape[0])
        size = size or came
        if came != size:
            raise ValueError(f"{path}: expected {size[0]}x{size[1]} px like {paths[0]}, got {came[0]}x{came[1]}")
        corners = find_checkerboard(image, pattern, window_px=window_px)
        if corners is not None:
            corner_sets.append(corners)
        (skipped if corners is None else used).append(Path(path).name)
        if progress and sys.stderr.isatty():
            print(f"{path}: {'no board, skipped' if corners is None else 'board found'}", file=sys.stderr)
    if size is None or len(used) < _MIN_VIEWS:
        what = f"a {pattern[0]}x{pattern[1]} board is in {len(used)} of {len(paths)} images"
        raise ValueError(f"images: {what}, at least {_MIN_VIEWS} are needed")
    found = calibrate(corner_sets, board, size)
    return replace(found, images_used=tuple(used), images_skipped=tuple(skipped))


def reprojection_error(
    camera: HasLens,
    rotation: npt.ArrayLike,
    translation: npt.ArrayLike,
    points_m: npt.ArrayLike,
    pixels: npt.ArrayLike,
) -> FloatArray:
    """Distance in raw px between points seen (N, 2) and points (N, 3) projected by a pose. Shape (N,); NaN behind the camera."""
    points, seen = as_points(points_m, dimensions=3, name="points_m"), as_points(pixels, name="pixels")
    if len(points) != len(seen):
        raise ValueError(f"pixels: expected {len(points)} points like points_m, got {len(seen)}")
    lens, shift = camera.lens, np.asarray(translation, dtype=np.float64).reshape(3)
    projected = lens.distort(lens.pinhole(points @ np.asarray(rotation, dtype=np.float64).T + shift))
    return np.linalg.norm(projected - seen, axis=1)


def save_calibration(path: str | Path, calibration: Calibration) -> Path:
    """Write ``size``, ``matrix``, ``distortion``, ``rms_px`` and ``views_used`` as YAML."""
    fields = {
        "size": list(calibration.size),
        **calibration.lens.to_dict(),
        "rms_px": calibration.rms_px,
        "views_used": calibration.views_used,
    }
    return write_file(path, yaml.safe_dump(fields, sort_keys=False, default_flow_style=None))


def load_calibration(path: str | Path) -> Calibration:
    """Read what :func:`save_calibration` wrote; ``ValueError`` names the file and the field that is wrong."""
    fields = read_yaml(path)
    if not isinstance(fields, dict):
        raise ValueError(f"{path}: expected a mapping with 'size', 'matrix' and 'distortion'")
    try:
        return Calibration(
            image_size("size", fields.get("size")),
            Lens.from_dict({"distortion": None} | fields),
            checks.number("rms_px", fields.get("rms_px"), least=0, unit="px"),
            checks.whole("views_used", fields.get("views_used"), least=1, unit="a number of views"),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _checked_pattern(pattern: Pattern) -> Pattern:
    if len(pattern) != 2 or any(int(n) != n or not 3 <= n <= 1000 for n in pattern):
        raise ValueError(f"pattern: expected (columns, rows) of inner corners, 3 or more each, got {tuple(pattern)}")
    return int(pattern[0]), int(pattern[1])


def _check_tilt(rotations: FloatArray) -> None:
    """Parallel boards leave focal length and distance tied, and OpenCV answers with any pair of them."""
    normals = rotations[:, :, 2]
    angle = np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1))).max()
    if not angle > _MIN_TILT_DEG:
        raise ValueError(
            f"corner_sets: the board must be tilted differently from view to view, got {angle:.1f} degrees"
        )


def _grey(image: Image) -> Image:
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape[2:] not in ((), (3,)):
        came = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f"image: expected uint8 (H, W) or (H, W, 3), got {came}")
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def _ordered(grid: FloatArray) -> FloatArray:
    """Corners (rows, columns, 2) in an order that depends on the picture only."""
    along, across = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if along[0] * across[1] - along[1] * across[0] < 0:  # mirrored
        grid = grid[:, ::-1]
    return grid[::-1, ::-1] if grid[0, 0].sum() > grid[-1, -1].sum() else grid
