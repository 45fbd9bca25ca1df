"""Both views on one floor: projective transform, rotation of left onto right (sections 5, 6; Figs 9, 10)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from occlib.base.arrays import FloatArray, Image, Mask
from occlib.geometry import Camera, Floor, apply_homography


class ImageWarp:
    """A look-up of a camera's images: what a subclass, such as :class:`FloorWarp`, does once it knows the ``pixels``."""

    camera: Camera

    @cached_property
    def pixels(self) -> FloatArray:
        """Raw px of every sample, (rows, columns, 2); NaN where the camera does not see it."""
        raise NotImplementedError

    @cached_property
    def visible(self) -> Mask:
        """Samples that this camera can see, bool (rows, columns)."""
        return np.isfinite(self.pixels[..., 0])

    @cached_property
    def _maps(self) -> tuple[Image, Image]:
        pixels = np.nan_to_num(self.pixels, nan=-10.0).astype(np.float32)  # off the image: the border value, 0
        return cv2.convertMaps(pixels[..., 0], pixels[..., 1], cv2.CV_16SC2)

    @cached_property
    def _nearest(self) -> tuple[Image, Image]:
        # cv2.remap does not round the fixed-point maps above when asked for the nearest pixel
        return np.rint(np.nan_to_num(self.pixels, nan=-10.0)).astype(np.int16), np.empty(0, np.uint16)

    def warp(self, image: Image) -> Image:
        """An image (H, W) or (H, W, 3) of this camera as the samples show it, (rows, columns[, 3]), same dtype.

        Bilinear; a bool mask takes the nearest pixel. Samples that the camera does not see are 0.
        """
        width, height = self.camera.size
        if image.shape[:2] != (height, width):
            raise ValueError(f"image: expected {(height, width)} for {self.camera.name}, got {image.shape[:2]}")
        if image.dtype == np.bool_:
            return self._remap(image.view(np.uint8), self._nearest, cv2.INTER_NEAREST).view(np.bool_)
        return self._remap(image, self._maps, cv2.INTER_LINEAR)

    @staticmethod
    def _remap(image: Image, maps: tuple[Image, Image], interpolation: int) -> Image:
        return np.asarray(cv2.remap(image, *maps, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


@dataclass(frozen=True)
class FloorWarp(ImageWarp):
    """Takes a camera's images to the floor map, or to a plane above it, lens distortion and homography in one look-up.

    Parameters
    ----------
    camera, floor
        From the rig.
    height
        Of the plane above the floor, in m. What stands in a cell is seen by all cameras on every plane up to its own height.
    """

    camera: Camera
    floor: Floor
    height: float = 0.0

    @cached_property
    def pixels(self) -> FloatArray:
        """Raw px that each cell's centre shows, (ny, nx, 2); NaN where the camera does not see the cell."""
        cells = self.floor.cell_centres_m()
        if self.height:
            pixels = self.camera.project(np.column_stack([cells, np.full(len(cells), self.height)]))
        else:
            pixels = self.camera.floor_to_pixels(cells)
        pixels[~self.camera.inside(pixels)] = np.nan
        return pixels.reshape(*self.floor.shape, 2)


def undistort(image: Image, camera: Camera) -> Image:
    """The image as a camera without lens distortion and with the same matrix would have taken it."""
    return camera.lens.undistort_image(image)


def view_homography(camera: Camera, floor: Floor) -> FloatArray:
    """The paper's projective transform: undistorted px to a top view *as this camera looks at it*.

    The result is a 3x3 homography to map cells in which the camera looks upwards when they are shown as maps are
    (row 0 at the bottom is the near side), centred on the floor's centre, before any rotation (Fig 10). Views from
    opposite walls come out turned by 180 degrees.
    """
    return (
        rotation_about_centre(-view_angle(camera, floor), floor)
        @ np.linalg.inv(floor.cell_to_floor)
        @ camera.image_to_floor
    )


def view_angle(camera: Camera, floor: Floor) -> float:
    """Angle in radians that turns this camera's top view onto the floor's axes, counted in map cells."""
    centre = np.array([np.mean(floor.x), np.mean(floor.y)])
    dx, dy = centre - camera.centre_m[:2]
    return float(np.arctan2(dy, dx) - np.pi / 2)


def rotation_about_centre(angle: float, floor: Floor) -> FloatArray:
    """3x3 rotation of map cells ``(ix, iy)`` by ``angle`` radians about the map's centre."""
    ny, nx = floor.shape
    cx, cy = (nx - 1) / 2, (ny - 1) / 2
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, cx - c * cx + s * cy], [s, c, cy - s * cx - c * cy], [0.0, 0.0, 1.0]])


def rotation_onto(camera: Camera, reference: Camera, floor: Floor) -> FloatArray:
    """The paper's rotation: turns ``camera``'s top view onto ``reference``'s (left onto right, section 6)."""
    return rotation_about_centre(view_angle(camera, floor) - view_angle(reference, floor), floor)


def registration_error_m(camera: Camera, points_px: npt.ArrayLike, points_m: npt.ArrayLike) -> FloatArray:
    """Distance in m between where raw px land on the floor and where they should, shape (N,)."""
    return np.linalg.norm(camera.pixels_to_floor(points_px) - np.asarray(points_m, float), axis=1)


def warp_top_view(image: Image, homography: npt.ArrayLike, floor: Floor) -> Image:
    """An undistorted image through a homography to map cells, (ny, nx[, 3]), bilinear, 0 outside."""
    ny, nx = floor.shape
    apply_homography(homography, [[0.0, 0.0]])  # checks the shape
    return np.asarray(cv2.warpPerspective(image, np.asarray(homography, float), (nx, ny), flags=cv2.INTER_LINEAR))
