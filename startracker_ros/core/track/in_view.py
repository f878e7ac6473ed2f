# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which centroids are no star of the catalogue, by an attitude: compiled."""

import math

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import Lens, project, ray, undistort
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_quaternion

AHEAD_RAD = np.radians(0.5)
"""Margin around the image of the cached stars, so that most frames need no catalogue search."""

APPARENT_RAD = np.radians(1.0)
"""No apparent direction is so far from the one in the catalogue: refraction has 0.6 deg."""

BRIGHT_STARS = 64
"""In and around the image: most centroids are stars of these."""


class StarsInView:
    """
    The catalogue stars of a camera around attitudes that change little from one to the next.

    lens is that of the camera, unless a better one is known.
    """

    def __init__(self, camera: Camera, onboard: OnboardCatalog) -> None:
        self.camera, self.lens = camera, camera.lens
        self.onboard = onboard
        self._centre = np.zeros(3)
        self._cos_ahead = float(np.cos(AHEAD_RAD))
        self._cos_radius = float(np.cos(camera.corner_angle_rad))

    def unexplained(self, sky: ApparentCatalog, attitude: AttitudeEstimate, uv: np.ndarray,
                    sigma_px: np.ndarray, reach_px: float, reach_sigmas: float) -> np.ndarray:
        """
        Return which (K,) of centroids (N, 2) have no star near; none without a positive sigma.

        Near is within reach_px, or within reach_sigmas of sigma_px (N,).
        """
        arguments = (self._around(attitude), self._cos_radius, self.lens,
                     np.ascontiguousarray(uv), np.ascontiguousarray(sigma_px), reach_px,
                     reach_sigmas)
        left = _unexplained(sky.direction(self._near[:BRIGHT_STARS]), *arguments,
                            np.arange(len(uv)))
        # Most are bright stars. Only where others are left the faint ones near them are looked up.
        if len(left) and len(self._near) > BRIGHT_STARS:
            near = self._around_spots(arguments[0], uv[left], max(
                reach_px, reach_sigmas * sigma_px[left].max()))
            left = _unexplained(sky.direction(near), *arguments, left)
        return left

    def _around(self, attitude: AttitudeEstimate) -> np.ndarray:
        """Find the stars in and near the image; return the matrix (3, 3) of the attitude."""
        matrix, cos_moved = _turned(attitude.quaternion, self._centre)
        if not cos_moved > self._cos_ahead:
            self._centre = boresight = matrix[:, 2].copy()
            self._near = self.onboard.within(boresight, self.camera.corner_angle_rad + AHEAD_RAD)
            self._natural = self.onboard.direction[self._near]
        return matrix

    def _around_spots(self, matrix: np.ndarray, uv: np.ndarray, reach_px: float) -> np.ndarray:
        """Return the stars within reach_px of pixels uv (N, 2), and others around them."""
        return self._near[_beside(self._natural, matrix, self.lens,
                                  np.ascontiguousarray(uv), self._cos_reach(reach_px))]

    def _cos_reach(self, reach_px: float) -> float:
        """Return the cosine of the angle within which stars may be seen within reach_px."""
        reach_rad = APPARENT_RAD + 2 * reach_px * self.camera.pixel_rad
        return math.cos(min(reach_rad, math.pi))


@compiled
def _turned(quaternion: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the matrix (3, 3) of an attitude, and the cosine from its boresight to a centre."""
    matrix = matrix_from_quaternion(quaternion)
    return matrix, (matrix[0, 2] * centre[0] + matrix[1, 2] * centre[1]
                    + matrix[2, 2] * centre[2])


@compiled
def _in_view(near: np.ndarray, direction: np.ndarray, matrix: np.ndarray, cos_radius: float,
             lens: Lens) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stars near (N,), of direction (N, 3), in the cone, with pixels."""
    count = 0
    index = np.empty(len(near), np.int64)
    sensor = np.empty((len(near), 3))
    for i in range(len(near)):
        x, y, z = direction[i, 0], direction[i, 1], direction[i, 2]
        ahead = x * matrix[0, 2] + y * matrix[1, 2] + z * matrix[2, 2]
        if ahead >= cos_radius:
            index[count] = near[i]
            sensor[count, 0] = x * matrix[0, 0] + y * matrix[1, 0] + z * matrix[2, 0]
            sensor[count, 1] = x * matrix[0, 1] + y * matrix[1, 1] + z * matrix[2, 1]
            sensor[count, 2] = ahead
            count += 1
    return index[:count], sensor[:count], project(lens, sensor[:count])


@compiled
def _beside(direction: np.ndarray, matrix: np.ndarray, lens: Lens, uv: np.ndarray,
            cos_reach: float) -> np.ndarray:
    """Return which directions (M, 3) have one of pixels uv (N, 2) near."""
    near = np.zeros(len(direction), np.bool_)
    for i in range(len(uv)):
        if not (np.isfinite(uv[i, 0]) and np.isfinite(uv[i, 1])):
            continue
        a, b = undistort(lens, (uv[i, 0] - lens.cx) / lens.fx, (uv[i, 1] - lens.cy) / lens.fy)
        x, y, z = ray(lens.equidistant, a, b)
        X = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z
        Y = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z
        Z = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z
        for k in range(len(direction)):
            if direction[k, 0] * X + direction[k, 1] * Y + direction[k, 2] * Z >= cos_reach:
                near[k] = True
    return np.flatnonzero(near)


@compiled
def _unexplained(direction: np.ndarray, matrix: np.ndarray, cos_radius: float, lens: Lens,
                 uv: np.ndarray, sigma_px: np.ndarray, reach_px: float, reach_sigmas: float,
                 candidates: np.ndarray) -> np.ndarray:
    """Return which candidates (K,), among centroids (N, 2), are unexplained by stars (M, 3)."""
    stars = _in_view(np.arange(len(direction)), direction, matrix, cos_radius, lens)[2]
    left, count = np.empty(len(candidates), np.int64), 0
    for i in candidates:
        free = sigma_px[i] > 0 and np.isfinite(uv[i, 0]) and np.isfinite(uv[i, 1])
        reach = max(reach_px, reach_sigmas * sigma_px[i])
        for k in range(len(stars)):
            if not free:
                break
            du, dv = uv[i, 0] - stars[k, 0], uv[i, 1] - stars[k, 1]
            free = du * du + dv * dv > reach * reach
        if free:
            left[count] = i
            count += 1
    return left[:count]
