"""Pinhole camera with plumb_bob distortion, as in sensor_msgs/CameraInfo and OpenCV."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from startracker_ros.camera.distortion import distort, distortion_jacobian

if TYPE_CHECKING:
    from startracker_ros.camera.lens import Lens


# Points of an image (81, 2), as shares of its width and height.
_GRID = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), -1).reshape(-1, 2)


class CameraError(ValueError):
    """Parameters that no real camera has; the text names them."""


@dataclass(frozen=True)
class Camera:
    """
    Pinhole camera; pixel (0, 0) is the centre of the top-left pixel.

    fx, fy, cx, cy are in px; distortion is (k1, k2, p1, p2, k3), the plumb_bob model of
    Brown (1966) in the order of OpenCV. CameraError for impossible parameters.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (0 < self.width <= 65536 and 0 < self.height <= 65536):
            raise CameraError(f'image size {self.width} x {self.height} px is not possible')
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if len(values) != 9:
            raise CameraError(f'plumb_bob has 5 distortion terms, got {len(self.distortion)}')
        if not np.all(np.isfinite(values)):
            raise CameraError('NaN or infinity among focal length, centre and distortion')
        if not (self.fx > 0 and self.fy > 0):
            raise CameraError(f'focal length ({self.fx}, {self.fy}) px must be positive')
        if not (-self.width <= self.cx <= 2 * self.width
                and -self.height <= self.cy <= 2 * self.height):
            raise CameraError(f'principal point ({self.cx}, {self.cy}) px is far off the image')
        if self.fov_x_rad > np.radians(170) or self.fov_y_rad > np.radians(170):
            raise CameraError('field of view above 170 deg: not a pinhole camera')
        if any(self.distortion):
            self._check_distortion()

    def _check_distortion(self) -> None:
        """Raise CameraError for a model that has no inverse somewhere in the image."""
        distorted = self._normalise(_GRID * [self.width - 1, self.height - 1])
        tangent = self._undistort(distorted)
        error = np.abs(self._distort(tangent) - distorted).max()
        xx, xy, yy = distortion_jacobian(self.distortion, *tangent.T)
        determinant = xx * yy - xy * xy
        if not (error < 1e-9 and determinant.min() > 0):
            raise CameraError(f'distortion {self.distortion} folds the image over itself')

    @classmethod
    def from_fov(cls, width: int, height: int, fov_deg: float) -> 'Camera':
        """Return an ideal camera with a horizontal field of view of fov_deg, edge to edge."""
        if not 0 < fov_deg < 170:
            raise CameraError(f'field of view {fov_deg} deg must be within 0 .. 170 deg')
        focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @property
    def fov_x_rad(self) -> float:
        """Horizontal field of view, edge to edge through the centre, without distortion."""
        return (np.arctan((self.cx + 0.5) / self.fx)
                + np.arctan((self.width - 0.5 - self.cx) / self.fx))

    @property
    def fov_y_rad(self) -> float:
        """Vertical field of view, edge to edge through the centre, without distortion."""
        return (np.arctan((self.cy + 0.5) / self.fy)
                + np.arctan((self.height - 0.5 - self.cy) / self.fy))

    @property
    def seen_x_rad(self) -> float:
        """Horizontal field of view, edge to edge through the centre, with the distortion."""
        left, right = self.unproject(np.array(
            [[-0.5, self.cy], [self.width - 0.5, self.cy]]))
        return float(2 * np.arcsin(np.linalg.norm(right - left) / 2))

    @cached_property
    def corner_angle_rad(self) -> float:
        """Largest angle between the optical axis and a corner of the image."""
        right, bottom = self.width - 0.5, self.height - 0.5
        corners = self.unproject(np.array(
            [[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]))
        return float(np.arccos(corners[:, 2].min()))

    @cached_property
    def pixel_rad(self) -> float:
        """Angle of one pixel at the centre, the mean of both axes."""
        return float(1 / np.sqrt(self.fx * self.fy))

    @cached_property
    def lens(self) -> 'Lens':
        """Return the camera model for compiled functions."""
        from startracker_ros.camera.lens import Lens
        k1, k2, p1, p2, k3 = map(float, self.distortion)
        return Lens(self.width, self.height, float(self.fx), float(self.fy), float(self.cx),
                    float(self.cy), (k1, k2, p1, p2, k3))

    def with_focal_ratio(self, ratio: float) -> 'Camera':
        """Return the camera with both focal lengths multiplied by ratio."""
        return replace(self, fx=self.fx * ratio, fy=self.fy * ratio)

    def project(self, directions: np.ndarray) -> np.ndarray:
        """Return pixels (..., 2) of sensor-frame vectors (..., 3); NaN behind the camera."""
        directions = np.asarray(directions, float)
        z = directions[..., 2:]
        with np.errstate(invalid='ignore', divide='ignore'):
            tangent = np.where(z > 0, directions[..., :2] / z, np.nan)
        return self._distort(tangent) * self._focal_px + self._centre_px

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Return unit vectors (..., 3) in the sensor frame of pixels (..., 2)."""
        tangent = self._undistort(self._normalise(np.asarray(pixels, float)))
        vector = np.empty(tangent.shape[:-1] + (3,))
        vector[..., :2] = tangent
        vector[..., 2] = 1
        return vector / np.sqrt(np.einsum('...i,...i', vector, vector))[..., None]

    def contains(self, pixels: np.ndarray, margin_px: float = 0.0) -> np.ndarray:
        """Return whether pixels (..., 2) are in the image, at least margin_px from its edges."""
        u, v = np.moveaxis(np.asarray(pixels, float), -1, 0)
        return ((u >= -0.5 + margin_px) & (u <= self.width - 0.5 - margin_px)
                & (v >= -0.5 + margin_px) & (v <= self.height - 0.5 - margin_px))

    @cached_property
    def _centre_px(self) -> np.ndarray:
        return np.array([self.cx, self.cy])

    @cached_property
    def _focal_px(self) -> np.ndarray:
        return np.array([self.fx, self.fy])

    def _normalise(self, pixels: np.ndarray) -> np.ndarray:
        return (pixels - self._centre_px) / self._focal_px

    def _distort(self, tangent: np.ndarray) -> np.ndarray:
        if not any(self.distortion):
            return tangent
        return np.stack(distort(self.distortion, tangent[..., 0], tangent[..., 1]), -1)

    def _undistort(self, distorted: np.ndarray) -> np.ndarray:
        if not any(self.distortion):
            return distorted
        # Imported only for distorted lenses: compiled code takes 0.3 s to import.
        from startracker_ros.camera.lens import undistort_all
        return undistort_all(self.lens, distorted.reshape(-1, 2)).reshape(distorted.shape)
