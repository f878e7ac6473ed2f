# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lines of sight: from a camera of known position and attitude through a pixel."""

from dataclasses import dataclass
import math

import numpy as np
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import matrix_from_quaternion


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

    The covariance of the direction d = R s is sigma^2 J J' + [d]x C [d]x', J = R ds/d(u, v) and C
    that of the attitude. Under a turn e of the sensor s changes by s x e.
    """
    if not abs(math.hypot(*quaternion) - 1) < 1e-6:
        raise ValueError(f'quaternion {np.asarray(quaternion).tolist()} is not an attitude')
    matrix = matrix_from_quaternion(np.asarray(quaternion, float))
    sensor = camera.unproject(np.asarray(uv, float))
    direction, covariance = matrix @ sensor, np.zeros((6, 6))
    # The turn across the direction that moves it by a pixel: the pseudo-inverse of its flow.
    flow, = image_jacobian(camera, sensor[None])
    turn = flow.T @ np.linalg.inv(flow @ flow.T)
    J, cross = matrix @ _cross_matrix(sensor) @ turn * sigma_px, _cross_matrix(direction)
    covariance[:3, :3] = position_covariance
    covariance[3:, 3:] = J @ J.T + cross @ attitude_covariance @ cross.T
    return LineOfSight(np.asarray(position_m, float), direction, covariance)


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    """Return [v]x (3, 3): [v]x w = v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


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
