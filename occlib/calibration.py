"""Camera calibration from checkerboards, and the floor from marks on it (section 2 of the paper, Figs 1, 2).

"We use a 2D square grid ... The square corner coordinates are manually marked from checkerboard's image at
different orientations. With the known sizes of the square, MatLab toolbox calculates the camera parameters."
Here OpenCV takes the toolbox's place (Zhang 2000, doi:10.1109/34.888718, with the Brown-Conrady distortion
k1, k2, p1, p2, k3). Corners are found automatically, or marked by hand and refined.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt
import yaml
from scipy.optimize import least_squares

from occlib.base.arrays import FloatArray, Image, as_points
from occlib.base.files import read_image, read_yaml, write_file
from occlib.geometry import Camera, Rig, apply_homography, invert_homography

Pattern: TypeAlias = tuple[int, int]


_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-6)


_MIN_VIEWS = 3


_MIN_TILT_DEG = 5.0


@dataclass(frozen=True)
class Calibration:
    """The intrinsics of a camera, and how well they explain the views.

    Parameters
    ----------
    size
        ``(width, height)`` in px.
    matrix
        3x3 intrinsic matrix in px.
    distortion
        ``(k1, k2, p1, p2, k3)``, shape (5,).
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
    matrix: FloatArray
    distortion: FloatArray
    rms_px: float
    views_used: int
    view_rms_px: FloatArray = field(default_factory=lambda: np.empty(0))
    rotations: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))
    translations: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    images_used: tuple[str, ...] = ()
    images_skipped: tuple[str, ...] = ()

    def camera(self, name: str, image_to_floor: npt.ArrayLike) -> Camera:
        """The calibrated camera with its homography to the floor (3x3, undistorted px to m)."""
        homography = np.asarray(image_to_floor, dtype=np.float64)
        invert_homography(homography, "image_to_floor")
        return Camera(name, self.size, self.matrix, self.distortion, homography)


@dataclass(frozen=True)
class FloorFit:
    """A homography fitted to marks on the floor, and its residuals mark by mark.

    Parameters
    ----------
    image_to_floor
        3x3, undistorted px to m.
    error_px
        Distance of each mark from its reprojection, undistorted px, shape (N,).
    error_m
        The same on the floor in m, shape (N,).
    leave_one_out_m
        Error in m at each mark when the others alone are fitted: what to expect at a new point. Shape
        (N,), or ``None`` with four marks, or when a mark is needed to fix the homography.
    """

    image_to_floor: FloatArray
    error_px: FloatArray
    error_m: FloatArray
    leave_one_out_m: FloatArray | None


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
    if not 1e-9 < square < 1e6:
        raise ValueError(f"square: expected metres > 0, got {square}")
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
    if window_px < 1:
        raise ValueError(f"window_px: expected a half side >= 1 px, got {window_px}")
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
    return np.asarray(cv2.cornerSubPix(grey, start, window, (-1, -1), _CRITERIA), np.float64).reshape(-1, 2)


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
        objects = [plane.astype(np.float32)] * len(views)
        pixels = [corners.astype(np.float32).reshape(-1, 1, 2) for corners in views]
        solution = cv2.calibrateCameraExtended(objects, pixels, size, None, None)  # type: ignore[call-overload]
    except cv2.error as error:
        raise ValueError(f"corner_sets: OpenCV cannot calibrate from these views ({error.err})") from None
    rms, matrix, distortion, turns, shifts, _, _, view_rms = solution
    rotations = np.array([cv2.Rodrigues(np.asarray(turn, np.float64))[0] for turn in turns])
    _check_tilt(rotations)
    return Calibration(
        size=(int(size[0]), int(size[1])),
        matrix=np.asarray(matrix, np.float64),
        distortion=np.asarray(distortion, np.float64).ravel()[:5],
        rms_px=float(rms),
        views_used=len(views),
        view_rms_px=np.asarray(view_rms, np.float64).ravel(),
        rotations=rotations,
        translations=np.asarray(shifts, np.float64).reshape(-1, 3),
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
    return Calibration(**{**vars(found), "images_used": tuple(used), "images_skipped": tuple(skipped)})


def reprojection_error(
    lens: Camera | Calibration,
    rotation: npt.ArrayLike,
    translation: npt.ArrayLike,
    points_m: npt.ArrayLike,
    pixels: npt.ArrayLike,
) -> FloatArray:
    """Distance in raw px between points seen (N, 2) and points (N, 3) projected by a pose. Shape (N,)."""
    turn, _ = cv2.Rodrigues(np.asarray(rotation, dtype=np.float64))
    shift = np.asarray(translation, dtype=np.float64).reshape(3, 1)
    points, seen = as_points(points_m, dimensions=3, name="points_m"), as_points(pixels, name="pixels")
    if len(points) != len(seen):
        raise ValueError(f"pixels: expected {len(points)} points like points_m, got {len(seen)}")
    projected, _ = cv2.projectPoints(points.reshape(-1, 1, 3), turn, shift, lens.matrix, lens.distortion)
    return np.linalg.norm(np.asarray(projected).reshape(-1, 2) - seen, axis=1)


def floor_homography_from_marks(lens: Camera | Calibration, pixels: npt.ArrayLike, floor_m: npt.ArrayLike) -> FloorFit:
    """The homography to the floor from marks whose floor coordinates are known.

    Parameters
    ----------
    lens
        Anything with ``size``, ``matrix`` and ``distortion``.
    pixels
        Marks (N, 2) in raw px, four or more, no three of four on a line.
    floor_m
        The same marks (N, 2) on the floor in m.

    Returns
    -------
    FloorFit
        The homography with the least squared distance in undistorted px, where marking errors arise, and
        its residuals.

    Notes
    -----
    Normalised DLT (Hartley & Zisserman 2004, section 4.4), then Gauss-Newton, all in float64
    (`cv2.findHomography` rounds its points to float32).
    """
    floor, raw = as_points(floor_m, name="floor_m"), as_points(pixels, name="pixels")
    if len(raw) != len(floor) or len(raw) < 4 or not (np.isfinite(raw).all() and np.isfinite(floor).all()):
        raise ValueError(f"pixels, floor_m: expected 4 or more finite pairs, got {len(raw)} and {len(floor)}")
    ideal = Camera("", lens.size, lens.matrix, lens.distortion, np.eye(3)).undistort_points(raw)
    floor_to_image = _fit_homography(floor, ideal)
    image_to_floor = invert_homography(floor_to_image, "floor_m")
    return FloorFit(
        image_to_floor,
        np.linalg.norm(apply_homography(floor_to_image, floor) - ideal, axis=1),
        np.linalg.norm(apply_homography(image_to_floor, ideal) - floor, axis=1),
        _leave_one_out(ideal, floor),
    )


def board_on_floor(
    pattern: Pattern, square: float, origin_m: tuple[float, float] = (0.0, 0.0), angle: float = 0.0
) -> FloatArray:
    """Floor coordinates of the corners of a board that lies face up, in the order of `find_checkerboard`.

    Parameters
    ----------
    pattern, square
        As for :func:`board_points`.
    origin_m
        Where the first corner lies, m.
    angle
        Direction of the first row, from its first to its last corner, counter-clockwise from the floor's x
        axis, rad. Seen from above, the next row lies to its right.

    Returns
    -------
    ndarray, shape (columns * rows, 2)
        In m.

    >>> board_on_floor((3, 3), 0.5, (1.0, 1.0))[[0, 2, 3]].tolist()
    [[1.0, 1.0], [2.0, 1.0], [1.0, 0.5]]
    """
    along, across = board_points(pattern, square)[:, :2].T
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([along * c + across * s, along * s - across * c]) + np.asarray(origin_m, float)


def solve_floor_pose(
    lens: Camera | Calibration, pixels: npt.ArrayLike, floor_m: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Pose of the camera from points on the floor, such as a board that lies there.

    Parameters
    ----------
    lens
        Anything with ``matrix`` and ``distortion``.
    pixels
        Points (N, 2) in raw px, four or more.
    floor_m
        The same points (N, 2) on the floor in m (:func:`board_on_floor`).

    Returns
    -------
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        World to camera, m.

    Raises
    ------
    ValueError
        No pose fits, or the camera would be under the floor: the points come in mirrored order.

    Notes
    -----
    IPPE (Collins & Bartoli 2014, doi:10.1007/s11263-014-0725-5), then Levenberg-Marquardt on the
    reprojection error.
    """
    floor, seen = as_points(floor_m, name="floor_m"), as_points(pixels, name="pixels")
    if len(seen) != len(floor) or len(seen) < 4:
        raise ValueError(f"pixels, floor_m: expected 4 or more pairs, got {len(seen)} and {len(floor)}")
    points = np.column_stack([floor, np.zeros(len(floor))])
    arguments = (points, seen.reshape(-1, 1, 2), lens.matrix, lens.distortion)
    try:
        _, turn, shift = cv2.solvePnP(*arguments, flags=cv2.SOLVEPNP_IPPE)
        turn, shift = cv2.solvePnPRefineLM(*arguments, turn, shift, _CRITERIA)
    except cv2.error:
        raise ValueError("pixels, floor_m: no pose of the camera fits these points") from None
    rotation, translation = cv2.Rodrigues(np.asarray(turn, np.float64))[0], np.asarray(shift, np.float64).ravel()
    height = -(rotation.T @ translation)[2]
    if not height > 0:
        raise ValueError(f"floor_m: the camera would be {-height:.2f} m under the floor; the points are mirrored")
    return np.asarray(rotation, np.float64), translation


def floor_homography_from_pose(
    lens: Camera | Calibration, rotation: npt.ArrayLike, translation: npt.ArrayLike
) -> FloatArray:
    """The homography (3, 3), undistorted px to m, of a pose (world to camera, m): ``(K [r1 r2 t])^-1``."""
    return Camera.from_pose("pose", lens.size, lens.matrix, lens.distortion, rotation, translation).image_to_floor


def save_calibration(path: str | Path, calibration: Calibration) -> Path:
    """Write ``size``, ``matrix``, ``distortion``, ``rms_px`` and ``views_used`` as YAML."""
    fields = {
        "size": list(calibration.size),
        "matrix": calibration.matrix.tolist(),
        "distortion": calibration.distortion.tolist(),
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
        camera = _rig_camera({name: fields.get(name) for name in ("size", "matrix", "distortion")})
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix('cameras.camera.')}") from None
    rms, views = fields.get("rms_px"), fields.get("views_used")
    if not isinstance(rms, int | float) or isinstance(rms, bool) or not 0 <= rms < np.inf:
        raise ValueError(f"{path}: rms_px: expected px >= 0, got {rms!r}")
    if not isinstance(views, int) or isinstance(views, bool) or views < 1:
        raise ValueError(f"{path}: views_used: expected a number of views, got {views!r}")
    return Calibration(camera.size, camera.matrix, camera.distortion, float(rms), views)


def load_marks(path: str | Path) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Read hand-marked floor points: for each camera raw px (N, 2) and floor m (N, 2).

    The file is YAML, ``marks: {camera: [{pixel: [u, v], floor: [x, y]}, ...]}``.
    """
    content = read_yaml(path)
    cameras = content.get("marks") if isinstance(content, dict) else None
    if not isinstance(cameras, dict):
        raise ValueError(f"{path}: expected a mapping 'marks' of cameras")
    marks = {}
    for name, entries in cameras.items():
        try:
            pair = [as_points([entry[key] for entry in entries], name=key) for key in ("pixel", "floor")]
        except (KeyError, TypeError, ValueError):
            pair = [np.full((1, 2), np.nan)]
        if not all(np.isfinite(points).all() for points in pair):
            raise ValueError(f"{path}: marks.{name}: expected a list of {{pixel: [u, v], floor: [x, y]}}")
        marks[str(name)] = (pair[0], pair[1])
    return marks


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


def _fit_homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """The 3x3 homography with the least squared distance in the target plane; (N, 2) each, N >= 4."""
    to_source, to_target = _normalising(source), _normalising(target)
    a, b = apply_homography(to_source, source), apply_homography(to_target, target)
    ones, zeros = np.ones((len(a), 1)), np.zeros((len(a), 3))
    xyw = np.hstack([a, ones])
    system = np.vstack([np.hstack([xyw, zeros, -b[:, :1] * xyw]), np.hstack([zeros, xyw, -b[:, 1:] * xyw])])
    _, values, vectors = np.linalg.svd(system)
    if values[7] < 1e-6 * values[0]:
        raise ValueError("floor_m: the marks do not fix a homography (too many on one line)")
    start = vectors[8] / np.linalg.norm(vectors[8])

    def residuals(h: FloatArray) -> FloatArray:
        projected = xyw @ h.reshape(3, 3).T
        return (projected[:, :2] / projected[:, 2:] - b).ravel()

    # The scale of h is free: the trust-region step leaves it alone.
    best = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x.reshape(3, 3)
    homography = np.linalg.inv(to_target) @ best @ to_source
    return np.asarray(homography / np.linalg.norm(homography))


def _normalising(points: FloatArray) -> FloatArray:
    """Similarity that moves points to mean 0 and mean distance sqrt(2)."""
    mean = points.mean(axis=0)
    scale = np.sqrt(2) / max(np.linalg.norm(points - mean, axis=1).mean(), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def _leave_one_out(ideal: FloatArray, floor: FloatArray) -> FloatArray | None:
    if len(floor) < 5:
        return None
    errors = []
    for i in range(len(floor)):
        others = np.arange(len(floor)) != i
        try:
            fit = invert_homography(_fit_homography(floor[others], ideal[others]))
        except ValueError:
            return None
        errors.append(np.linalg.norm(apply_homography(fit, ideal[i]) - floor[i]))
    return np.array(errors)


def _rig_camera(fields: dict[str, Any]) -> Camera:
    """Check intrinsics by the rules of ``rig.yaml``."""
    floor = {"x": [0, 1], "y": [0, 1], "resolution": 1}
    camera = {**fields, "floor_homography": np.eye(3).tolist()}
    return Rig.from_dict({"floor": floor, "cameras": {"camera": camera}})["camera"]
