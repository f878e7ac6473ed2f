"""Pinhole camera with plumb_bob distortion, as in sensor_msgs/CameraInfo and OpenCV."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

if TYPE_CHECKING:
    from startracker_ros.lens import Lens

_LARGEST_FILE_BYTES = 1_000_000


class CameraError(ValueError):
    """A camera description that cannot be a real camera."""


@dataclass(frozen=True)
class Camera:
    """
    Pinhole camera; pixel (0, 0) is the centre of the top-left pixel.

    fx, fy, cx, cy are in px; distortion is (k1, k2, p1, p2, k3), the plumb_bob
    model of Brown (1966) as OpenCV orders it. CameraError names what is wrong.
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
            raise CameraError(f'plumb_bob takes 5 distortion terms, got {len(self.distortion)}')
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
        """Refuse a model that folds over inside the image: it has no inverse there."""
        edge = np.linspace(0, 1, 9)
        grid = np.stack(np.meshgrid(edge * (self.width - 1), edge * (self.height - 1)), -1)
        pixel = grid.reshape(-1, 2)
        tangent = self._undistort(self._normalise(pixel))
        error = np.abs(self._distort(tangent) - self._normalise(pixel)).max()
        determinant = np.linalg.det(self._distortion_jacobian(tangent))
        if not (error < 1e-9 and determinant.min() > 0):
            raise CameraError(f'distortion {self.distortion} folds the image over itself')

    @classmethod
    def from_fov(cls, width: int, height: int, fov_deg: float) -> 'Camera':
        """Return an ideal camera whose full width spans fov_deg, edge to edge."""
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
        """Return the same model for compiled functions."""
        from startracker_ros.lens import Lens
        return Lens(self.width, self.height, float(self.fx), float(self.fy), float(self.cx),
                    float(self.cy), *map(float, self.distortion))

    def with_focal_ratio(self, ratio: float) -> 'Camera':
        """Return the same camera with both focal lengths multiplied by ratio."""
        return replace(self, fx=self.fx * ratio, fy=self.fy * ratio)

    def project(self, directions: np.ndarray) -> np.ndarray:
        """Return pixels (..., 2) of sensor-frame vectors (..., 3); NaN behind the camera."""
        directions = np.asarray(directions, float)
        z = directions[..., 2:]
        with np.errstate(invalid='ignore', divide='ignore'):
            tangent = np.where(z > 0, directions[..., :2] / z, np.nan)
        return self._distort(tangent) * self._focal_px + self._centre_px

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Return the unit vectors (..., 3) in the sensor frame of pixels (..., 2)."""
        tangent = self._undistort(self._normalise(np.asarray(pixels, float)))
        vector = np.empty(tangent.shape[:-1] + (3,))
        vector[..., :2] = tangent
        vector[..., 2] = 1
        return vector / np.sqrt(np.einsum('...i,...i', vector, vector))[..., None]

    def contains(self, pixels: np.ndarray, margin_px: float = 0.0) -> np.ndarray:
        """Return True where pixels (..., 2) lie in the image, at least margin_px inside."""
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
        k1, k2, p1, p2, k3 = self.distortion
        x, y = tangent[..., 0], tangent[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack([x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                         y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1)

    def _distortion_jacobian(self, tangent: np.ndarray) -> np.ndarray:
        k1, k2, p1, p2, k3 = self.distortion
        x, y = tangent[..., 0], tangent[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        cross = slope * x * y + 2 * (p1 * x + p2 * y)
        return np.stack([
            np.stack([radial + slope * x * x + 2 * p1 * y + 6 * p2 * x, cross], -1),
            np.stack([cross, radial + slope * y * y + 6 * p1 * y + 2 * p2 * x], -1)], -2)

    def _undistort(self, distorted: np.ndarray) -> np.ndarray:
        if not any(self.distortion):
            return distorted
        # Compiled code takes a third of a second to import: only lenses that need it wait.
        from startracker_ros.lens import undistort_all
        return undistort_all(self.lens, distorted.reshape(-1, 2)).reshape(distorted.shape)


def load_camera(path: str | Path) -> Camera:
    """Read a camera from a YAML file as ROS camera_calibration writes it; CameraError if bad."""
    try:
        with open(path, 'rb') as file:
            text = file.read(_LARGEST_FILE_BYTES + 1)
        if len(text) > _LARGEST_FILE_BYTES:
            raise CameraError(f'more than {_LARGEST_FILE_BYTES} bytes')
        document = yaml.safe_load(text)
        if document['distortion_model'] != 'plumb_bob':
            model = document['distortion_model']
            raise CameraError(f'distortion_model {model!r} is not plumb_bob')
        matrix = [float(value) for value in document['camera_matrix']['data']]
        distortion = tuple(float(v) for v in document['distortion_coefficients']['data'])
        width, height = document['image_width'], document['image_height']
        return Camera(int(width), int(height), matrix[0], matrix[4], matrix[2], matrix[5],
                      distortion)
    except OSError as error:
        raise CameraError(f'camera file {path}: {error.strerror}') from error
    except CameraError as error:
        raise CameraError(f'camera file {path}: {error}') from error
    except (yaml.YAMLError, KeyError, IndexError, TypeError, ValueError, OverflowError,
            RecursionError) as error:
        raise CameraError(
            f'camera file {path}: not a ROS camera calibration ({error!r})') from error


def save_camera(camera: Camera, path: str | Path, name: str = 'star_tracker') -> None:
    """Write a camera as ROS camera_calibration YAML."""
    matrix = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    document = {
        'image_width': camera.width,
        'image_height': camera.height,
        'camera_name': name,
        'camera_matrix': {'rows': 3, 'cols': 3, 'data': [float(v) for v in matrix]},
        'distortion_model': 'plumb_bob',
        'distortion_coefficients': {
            'rows': 1, 'cols': 5, 'data': [float(v) for v in camera.distortion]},
        'rectification_matrix': {
            'rows': 3, 'cols': 3, 'data': [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]},
        'projection_matrix': {
            'rows': 3, 'cols': 4,
            'data': [float(v) for v in (*matrix[:3], 0.0, *matrix[3:6], 0.0, *matrix[6:], 0.0)]},
    }
    Path(path).write_text(yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
