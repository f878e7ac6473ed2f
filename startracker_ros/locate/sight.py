"""Lines of sight: from a camera at a known place and attitude to a spot in its image."""

from dataclasses import dataclass
import math

import numpy as np
from startracker_ros.astro.aberration import aberrate
from startracker_ros.camera.lens import distortion_jacobian, Lens, undistort
from startracker_ros.camera.model import Camera
from startracker_ros.compiled import compiled


@dataclass(frozen=True)
class Sight:
    """
    A line of sight: from position_m (3,) along the unit vector direction (3,), ICRF axes.

    covariance (6, 6) is that of the errors of both, in m^2, m rad and rad^2; the error
    of the direction lies across it.
    """

    position_m: np.ndarray
    direction: np.ndarray
    covariance: np.ndarray


def sight(camera: Camera, uv: np.ndarray, sigma_px: float, quaternion: np.ndarray,
          attitude_covariance: np.ndarray, position_m: np.ndarray,
          position_covariance: np.ndarray) -> Sight:
    """
    Return the line of sight to pixel uv (2,) with sigma_px on each axis.

    quaternion (4,) is q_icrf_from_sensor; attitude_covariance (3, 3) in rad^2 that of a
    rotation about ICRF axes; position_m (3,) with covariance (3, 3) in m^2. ValueError for
    a quaternion that is none.
    """
    if not abs(math.hypot(*quaternion) - 1) < 1e-6:
        raise ValueError(f'quaternion {np.asarray(quaternion).tolist()} is no attitude')
    direction, covariance = np.empty(3), np.zeros((6, 6))
    _look(camera.lens, float(uv[0]), float(uv[1]), float(sigma_px),
          np.asarray(quaternion, float), np.ascontiguousarray(attitude_covariance, float),
          direction, covariance)
    covariance[:3, :3] = position_covariance
    return Sight(np.asarray(position_m, float), direction, covariance)


@compiled
def _look(lens: Lens, u: float, v: float, sigma_px: float, q: np.ndarray, attitude: np.ndarray,
          direction: np.ndarray, covariance: np.ndarray) -> None:
    """Fill direction (3,) and the lower right (3, 3) of covariance (6, 6)."""
    a, b = undistort(lens, (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy)
    xx, cross, yy = distortion_jacobian(lens.distortion, a, b)
    length = math.sqrt(a * a + b * b + 1)
    x, y, z, w = q
    matrix = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    sensor = np.array([a / length, b / length, 1 / length])
    direction[:] = matrix @ sensor
    # How the direction follows the tangents a and b, and these the pixel.
    by_tangent = np.array([[1 - sensor[0] ** 2, -sensor[0] * sensor[1]],
                           [-sensor[0] * sensor[1], 1 - sensor[1] ** 2],
                           [-sensor[0] * sensor[2], -sensor[1] * sensor[2]]]) / length
    by_pixel = np.array([[yy / lens.fx, -cross / lens.fy],
                         [-cross / lens.fx, xx / lens.fy]]) / (xx * yy - cross * cross)
    shift = matrix @ (by_tangent @ by_pixel) * sigma_px
    turn = np.array([[0.0, direction[2], -direction[1]], [-direction[2], 0.0, direction[0]],
                     [direction[1], -direction[0], 0.0]])
    covariance[3:, 3:] = shift @ shift.T + turn @ attitude @ turn.T


def without_aberration(direction: np.ndarray, velocity_m_s: np.ndarray, *,
                       boresight: np.ndarray | None = None,
                       stars_velocity_m_s: np.ndarray | None = None) -> np.ndarray:
    """
    Return the direction (3,) to a target as an observer at rest sees it.

    velocity_m_s (3,) is that of the observer in the frame in which the place is wanted. An
    attitude fitted to stars without their aberration is off by it: stars_velocity_m_s (3,),
    that of the observer about the Sun, puts right what such an attitude says, by the turn
    that the aberration at the boresight (3,) stands for.
    """
    if boresight is not None and stars_velocity_m_s is not None:
        seen = aberrate(boresight[None], stars_velocity_m_s)[0]
        # Rodrigues' formula for the small turn from the boresight to where it is seen.
        axis, cosine = np.cross(boresight, seen), float(boresight @ seen)
        direction = (cosine * direction + np.cross(axis, direction)
                     + axis * (axis @ direction) / (1 + cosine))
    return aberrate(direction[None], -velocity_m_s)[0]
