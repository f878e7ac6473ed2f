# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras with the distortion models of sensor_msgs/CameraInfo."""

from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.distortion import (
    DistortionModel, farthest_angle, LARGEST_RAD, MODELS, PLUMB_BOB)
from startracker_ros.core.maths.rotation import quaternion_from_axes

LARGEST_SIDE_PX = 65536
"""Of an image, and of the sensor that it may be a part of."""

SAME_PX = 1e-3
"""Cameras in whose images no star is farther apart are the same: a third of the error of a
centroid at a signal of 300 times its noise, the best there are."""

# Points of an image (81, 2), as shares of its width and height.
_GRID = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), -1).reshape(-1, 2)


class CameraError(ValueError):
    """Parameters that no real camera has; the text names them."""


def _whole(name: str, value: Any) -> int:
    """Return a number of pixels as an int, 512.0 too; CameraError unless it is whole."""
    if not isinstance(value, Real) or float(value) != float(value) // 1:
        raise CameraError(f'{name} = {value!r} must be a whole number of px')
    return int(float(value))


@dataclass(frozen=True)
class Camera:
    """
    A camera; pixel (0, 0) is the centre of the top-left pixel.

    Args:
        width: Columns of the image, px; a whole number of any type.
        height: Rows of the image, px.
        fx: Focal length along the rows, px.
        fy: Focal length along the columns, px.
        cx: Column of the principal point, px; it may be outside of the image, which may be a part
            of that of the sensor.
        cy: Row of the principal point, px.
        distortion: Coefficients of `distortion_model` in the order of sensor_msgs/CameraInfo.
        distortion_model: `'plumb_bob'`, `'rational_polynomial'` or `'equidistant'`.

    Raises:
        CameraError: Parameters that no real camera has.

    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    distortion_model: str = PLUMB_BOB

    def __post_init__(self) -> None:
        for name in ('width', 'height'):
            object.__setattr__(self, name, _whole(name, getattr(self, name)))
        if not (0 < self.width <= LARGEST_SIDE_PX and 0 < self.height <= LARGEST_SIDE_PX):
            raise CameraError(f'image size {self.width} x {self.height} px is not possible')
        if self.distortion_model not in MODELS:
            raise CameraError(f'distortion_model {self.distortion_model!r} is not one of '
                              f'{", ".join(MODELS)}')
        wanted = len(self.model.coefficients)
        if len(self.distortion) != wanted:
            raise CameraError(f'{self.distortion_model} has {wanted} distortion terms, '
                              f'got {len(self.distortion)}')
        if not np.all(np.isfinite((self.fx, self.fy, self.cx, self.cy, *self.distortion))):
            raise CameraError('NaN or infinity among focal length, centre and distortion')
        if not (self.fx > 0 and self.fy > 0):
            raise CameraError(f'focal length ({self.fx}, {self.fy}) px must be positive')
        if not (-LARGEST_SIDE_PX <= self.cx <= self.width + LARGEST_SIDE_PX
                and -LARGEST_SIDE_PX <= self.cy <= self.height + LARGEST_SIDE_PX):
            raise CameraError(f'principal point ({self.cx}, {self.cy}) px is far off the image')
        limit_deg = self.model.limit_deg / 2
        if max(map(abs, (*self._edges_x_rad, *self._edges_y_rad))) > np.radians(limit_deg):
            raise CameraError(
                f'field of view above {limit_deg:g} deg to one side of the optical axis: no lens '
                f'of the model {self.distortion_model} has it (focal length {self.fx:g}, '
                f'{self.fy:g} px, principal point {self.cx:g}, {self.cy:g} px, image of '
                f'{self.width} x {self.height} px)')
        if not self._ideal and native.library().st_check_camera(self.native.ctypes.data, None):
            raise CameraError(f'distortion {self.distortion} folds the image over itself')

    @classmethod
    def from_fov(cls, width: int, height: int, fov_deg: float,
                 distortion_model: str = PLUMB_BOB) -> 'Camera':
        """
        Make an ideal camera of a field of view, its principal point in the middle.

        Args:
            width: Columns of the image, px.
            height: Rows of the image, px.
            fov_deg: Horizontal field of view, edge to edge, deg.
            distortion_model: Model of its distortion, which is zero.

        Returns:
            `Camera` with square pixels.

        Raises:
            CameraError: An impossible size or field of view.

        """
        model = MODELS[distortion_model]
        if not 0 < fov_deg < model.limit_deg:
            raise CameraError(f'field of view {fov_deg} deg must be within 0 .. '
                              f'{model.limit_deg:g} deg')
        width, height = _whole('width', width), _whole('height', height)
        half = np.radians(fov_deg) / 2
        focal = width / 2 / (half if model.equidistant else np.tan(half))
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2,
                   (0.0,) * len(model.coefficients), distortion_model)

    @property
    def model(self) -> DistortionModel:
        """Return the distortion model."""
        return MODELS[self.distortion_model]

    @property
    def fov_x_rad(self) -> float:
        """Horizontal field of view, edge to edge through the centre, without distortion."""
        left, right = self._edges_x_rad
        return right - left

    @property
    def fov_y_rad(self) -> float:
        """Vertical field of view, edge to edge through the centre, without distortion."""
        top, bottom = self._edges_y_rad
        return bottom - top

    @property
    def _edges_x_rad(self) -> tuple[float, float]:
        """Angles from the optical axis to the left and the right edge, without distortion."""
        return (self.angle_rad((-0.5 - self.cx) / self.fx),
                self.angle_rad((self.width - 0.5 - self.cx) / self.fx))

    @property
    def _edges_y_rad(self) -> tuple[float, float]:
        """Angles from the optical axis to the upper and the lower edge, as _edges_x_rad."""
        return (self.angle_rad((-0.5 - self.cy) / self.fy),
                self.angle_rad((self.height - 0.5 - self.cy) / self.fy))

    @property
    def seen_x_rad(self) -> float:
        """
        Horizontal field of view, edge to edge through the centre, with the distortion.

        The edges are those of the image circle where that is smaller than the image.
        """
        return self._seen_rad(0, [[-0.5, self.cy], [self.width - 0.5, self.cy]])

    @property
    def seen_y_rad(self) -> float:
        """Vertical field of view, as seen_x_rad."""
        return self._seen_rad(1, [[self.cx, -0.5], [self.cx, self.height - 0.5]])

    def _seen_rad(self, axis: int, edges: list[list[float]]) -> float:
        """Return the angle from the first to the last pixel of a column or row, about an axis."""
        direction = self.unproject(np.array(edges))
        angles = np.arctan2(direction[:, axis], direction[:, 2])
        farthest = self.farthest_rad if np.isnan(angles).any() else 0.0
        low, high = np.where(np.isnan(angles), [-farthest, farthest], angles)
        return float(high - low)

    def angle_rad(self, radius: float) -> float:
        """Return the angle from the axis at a radius in undistorted coordinates, signed."""
        if self.model.equidistant:
            return min(max(radius, -LARGEST_RAD), LARGEST_RAD)
        return float(np.arctan(radius))

    def radius(self, angle_rad: float) -> float:
        """Return the radius in undistorted coordinates at an angle from the axis."""
        return angle_rad if self.model.equidistant else float(np.tan(angle_rad))

    @cached_property
    def corner_angle_rad(self) -> float:
        """Largest angle between the optical axis and a corner of the image or of its circle."""
        right, bottom = self.width - 0.5, self.height - 0.5
        corners = self.unproject(np.array(
            [[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]))
        if np.isnan(corners).any():
            return self.farthest_rad
        return float(np.arccos(corners[:, 2].min()))

    @cached_property
    def pixel_rad(self) -> float:
        """Angle of one pixel at the centre, the mean of both axes."""
        return float(1 / np.sqrt(self.fx * self.fy))

    @cached_property
    def farthest_rad(self) -> float:
        """Largest angle to the axis that has a pixel: farthest_angle()."""
        return farthest_angle(self.distortion_model, self.distortion)

    @cached_property
    def native(self) -> np.ndarray:
        """Return the camera as an st_camera, which must not be changed."""
        return native_camera((self.width, self.height), (self.fx, self.fy), (self.cx, self.cy),
                             self.distortion, self.distortion_model)

    @cached_property
    def middle_axes(self) -> np.ndarray:
        """Return the rotation (4,) from the axes of the middle of the image to sensor axes."""
        return middle_axes(self.native)

    def with_focal_ratio(self, ratio: float) -> 'Camera':
        """Return the camera with both focal lengths multiplied by ratio."""
        return replace(self, fx=self.fx * ratio, fy=self.fy * ratio)

    def summed(self, cell: int) -> 'Camera':
        """Return the camera of an image of which each pixel is the sum of cell x cell."""
        if cell == 1:
            return self
        binned, shift = self.binned(cell, cell), (cell - 1) / (2 * cell)
        return replace(binned, cx=binned.cx - shift, cy=binned.cy - shift)

    def cropped(self, x_px: int, y_px: int, width: int, height: int) -> 'Camera':
        """Return the camera of a part of the image, whose first pixel is (x_px, y_px)."""
        return replace(self, width=width, height=height, cx=self.cx - x_px, cy=self.cy - y_px)

    def binned(self, x: int, y: int) -> 'Camera':
        """
        Return the camera of an image with x by y pixels in one, as image_geometry does.

        The principal point is divided, which is exact where one pixel of x by y is kept. Where
        all are added up it is (x - 1) / (2 x), (y - 1) / (2 y) px less.
        """
        return replace(self, width=self.width // x, height=self.height // y, fx=self.fx / x,
                       fy=self.fy / y, cx=self.cx / x, cy=self.cy / y)

    def difference_px(self, other: 'Camera') -> float:
        """
        Return how far a star is apart in the images of two cameras at most, in px.

        Infinity for images of another size.
        """
        if self == other:
            return 0.0
        if (self.width, self.height) != (other.width, other.height):
            return np.inf
        pixels = _GRID * [self.width - 1, self.height - 1]
        apart = np.abs(other.project(self.unproject(pixels)) - pixels)
        # There are no stars outside the image circle.
        seen = apart[np.isfinite(apart)]
        return float(seen.max()) if len(seen) else np.inf

    def is_same(self, other: 'Camera | None') -> bool:
        """Return whether no star shows that it is another camera; False for None."""
        return other is not None and self.difference_px(other) < SAME_PX

    def ideal(self) -> 'Camera':
        """Return the camera without distortion."""
        return replace(self, distortion=(0.0,) * len(self.distortion))

    def project(self, directions: np.ndarray) -> np.ndarray:
        """
        Project directions onto the image.

        Args:
            directions: (..., 3) vectors in the sensor frame, of any length: x right, y down, z
                along the boresight out of the lens.

        Returns:
            Pixels (..., 2) float64; NaN behind the camera.

        """
        directions = np.asarray(directions, float)
        if self._ideal:
            z = directions[..., 2:]
            with np.errstate(invalid='ignore', divide='ignore'):
                tangent = np.where(z > 0, directions[..., :2] / z, np.nan)
            return tangent * self._focal_px + self._centre_px
        return project(self.native, directions.reshape(-1, 3)).reshape(
            *directions.shape[:-1], 2)

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """
        Return the directions of pixels.

        Args:
            pixels: (..., 2) px.

        Returns:
            Unit vectors (..., 3) float64 in the sensor frame; NaN outside the image circle of an
            equidistant lens.

        """
        pixels = np.asarray(pixels, float)
        if self._ideal:
            vector = np.empty(pixels.shape[:-1] + (3,))
            vector[..., :2] = (pixels - self._centre_px) / self._focal_px
            vector[..., 2] = 1
            return vector / np.sqrt(np.einsum('...i,...i', vector, vector))[..., None]
        return unproject(self.native, pixels.reshape(-1, 2)).reshape(*pixels.shape[:-1], 3)

    def contains(self, pixels: np.ndarray, margin_px: float = 0.0) -> np.ndarray:
        """Return whether pixels (..., 2) are in the image, at least margin_px from its edges."""
        pixels = np.asarray(pixels, float)
        u, v = pixels[..., 0], pixels[..., 1]
        return ((u >= -0.5 + margin_px) & (u <= self.width - 0.5 - margin_px)
                & (v >= -0.5 + margin_px) & (v <= self.height - 0.5 - margin_px))

    @cached_property
    def _centre_px(self) -> np.ndarray:
        return np.array([self.cx, self.cy])

    @cached_property
    def _focal_px(self) -> np.ndarray:
        return np.array([self.fx, self.fy])

    @cached_property
    def _ideal(self) -> bool:
        """Whether it is a pinhole without distortion."""
        return not self.model.equidistant and not any(self.distortion)


def native_camera(size: tuple[int, int], focal_px: tuple[float, float],
                  centre_px: tuple[float, float], distortion: tuple[float, ...], model: str
                  ) -> np.ndarray:
    """Return an st_camera, unchecked."""
    terms = np.zeros(8)
    terms[:len(distortion)] = distortion
    return np.array((*size, *focal_px, *centre_px, terms, list(MODELS).index(model), 0),
                    native.CAMERA)


def project(camera: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return pixels (N, 2) of sensor-frame vectors (N, 3) in an st_camera, as Camera.project()."""
    pixels = np.empty((len(directions), 2))
    native.call('st_project', camera, np.ascontiguousarray(directions, float), pixels,
                len(directions))
    return pixels


def unproject(camera: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return unit vectors (N, 3) of pixels (N, 2) of an st_camera, as Camera.unproject()."""
    directions = np.empty((len(pixels), 3))
    native.call('st_unproject', camera, np.ascontiguousarray(pixels, float), directions,
                len(pixels))
    return directions


def middle_axes(camera: np.ndarray) -> np.ndarray:
    """
    Return the rotation (4,) from the axes of the middle of the image to sensor axes.

    Those have +z through the middle of the image of an st_camera and +y along the image, down.
    """
    centre = np.array([(camera['width_px'] - 1) / 2, (camera['height_px'] - 1) / 2])
    return quaternion_from_axes(*unproject(camera, np.array([centre, centre + [0, 1]])))
