# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lines of sight: from a camera of known position and attitude through a pixel."""

from dataclasses import dataclass
import math

import numpy as np
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.camera.lens import distortion_jacobian, Lens, ray, undistort
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_quaternion


@dataclass(frozen=True)
class LineOfSight:
    """
    From position_m (3,) along the unit vector direction (3,), ICRF axes.

    covariance (6, 6) is that of position and direction, in m^2, m rad and rad^2; errors of the
    direction are across it.
    """

    position_m: np.ndarray
    direction: np.ndarray
    covariance: np.ndarray


def line_of_sight(camera: Camera, uv: np.ndarray, sigma_px: float, quaternion: np.ndarray,
                  attitude_covariance: np.ndarray, position_m: np.ndarray,
                  position_covariance: np.ndarray) -> LineOfSight:
    """
    Return the line of sight to pixel uv (2,) with sigma_px on each axis.

    quaternion (4,) is q_icrf_from_sensor; attitude_covariance (3, 3), rad^2, is that of a
    rotation about ICRF axes; position_m (3,) with covariance (3, 3) in m^2. ValueError for a
    quaternion that is not of unit length.
    """
    if not abs(math.hypot(*quaternion) - 1) < 1e-6:
        raise ValueError(f'quaternion {np.asarray(quaternion).tolist()} is no attitude')
    direction, covariance = np.empty(3), np.zeros((6, 6))
    _direction_and_covariance(
        camera.lens, float(uv[0]), float(uv[1]), float(sigma_px),
        np.asarray(quaternion, float), np.ascontiguousarray(attitude_covariance, float),
        direction, covariance)
    covariance[:3, :3] = position_covariance
    return LineOfSight(np.asarray(position_m, float), direction, covariance)


@compiled
def _direction_and_covariance(lens: Lens, u: float, v: float, sigma_px: float, q: np.ndarray,
                              attitude: np.ndarray, direction: np.ndarray,
                              covariance: np.ndarray) -> None:
    """
    Fill direction (3,) and the lower right (3, 3) of covariance (6, 6).

    The covariance of d = R s(a, b) is sigma^2 J J' + [d]x C [d]x', with the undistorted
    coordinates a, b of the pixel, J = R ds/d(a, b) d(a, b)/d(u, v), and the attitude
    covariance C.
    """
    a, b = undistort(lens, (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy)
    xx, cross, yy = distortion_jacobian(lens.terms, a, b)
    matrix = matrix_from_quaternion(q)
    direction[:] = matrix @ np.array(ray(lens.equidistant, a, b))
    ds_dab = _ray_jacobian(lens.equidistant, a, b)
    dab_duv = np.array([[yy / lens.fx, -cross / lens.fy],
                        [-cross / lens.fx, xx / lens.fy]]) / (xx * yy - cross * cross)
    j = matrix @ (ds_dab @ dab_duv) * sigma_px
    skew = np.array([[0.0, direction[2], -direction[1]], [-direction[2], 0.0, direction[0]],
                     [direction[1], -direction[0], 0.0]])
    covariance[3:, 3:] = j @ j.T + skew @ attitude @ skew.T


@compiled
def _ray_jacobian(equidistant: bool, a: float, b: float) -> np.ndarray:
    """
    Return ds/d(a, b) (3, 2) of the unit vector s = ray(a, b).

    s = (k a, k b, z) with dk = m (a da + b db), dz = -n (a da + b db).
    """
    if equidistant:
        theta = math.hypot(a, b)
        k, m = 1.0, -1.0 / 3
        if theta > 0:
            k = math.sin(theta) / theta
            m = (math.cos(theta) - k) / theta ** 2
        n = k
    else:
        k = 1 / math.sqrt(a * a + b * b + 1)
        m, n = -k ** 3, k ** 3
    return np.array([[k + m * a * a, m * a * b], [m * a * b, k + m * b * b], [-n * a, -n * b]])


def without_aberration(direction: np.ndarray, velocity_m_s: np.ndarray, *,
                       boresight: np.ndarray | None = None,
                       stars_velocity_m_s: np.ndarray | None = None) -> np.ndarray:
    """
    Return the geometric direction (3,) to a target from its apparent direction (3,).

    velocity_m_s (3,) is the velocity of the observer in the frame of the target position. An
    attitude that was fitted to stars without their aberration is rotated by it; boresight (3,)
    and stars_velocity_m_s (3,), that of the observer about the Sun, remove this rotation.
    """
    if boresight is not None and stars_velocity_m_s is not None:
        apparent = aberrate(boresight[None], stars_velocity_m_s)[0]
        # Rodrigues' formula for the rotation from the boresight to its apparent direction.
        axis, cosine = np.cross(boresight, apparent), float(boresight @ apparent)
        direction = (cosine * direction + np.cross(axis, direction)
                     + axis * (axis @ direction) / (1 + cosine))
    return aberrate(direction[None], -velocity_m_s)[0]
