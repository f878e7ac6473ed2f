# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which centroids are not stars of the catalogue, by an attitude."""

import math

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.maths.rotation import matrix_from_quaternion

AHEAD_RAD = np.radians(0.5)
"""Margin around the image of the cached stars, so that most frames need no catalogue search."""

APPARENT_RAD = np.radians(1.0)
"""No apparent direction is so far from the one in the catalogue: refraction has 0.6 deg."""

BRIGHT_STARS = 64
"""In and around the image: most centroids are stars of these."""


class StarsInView:
    """The catalogue stars of a camera around attitudes that change little."""

    def __init__(self, camera: Camera, onboard: OnboardCatalog) -> None:
        self.camera = camera
        self.onboard = onboard
        self._centre = np.zeros(3)
        self._cos_ahead = float(np.cos(AHEAD_RAD))

    def unexplained(self, sky: ApparentCatalog, attitude: AttitudeEstimate, uv: np.ndarray,
                    sigma_px: np.ndarray, reach_px: float, reach_sigmas: float) -> np.ndarray:
        """
        Return which (K,) of centroids (N, 2) have no star near; none without a positive sigma.

        Near is within reach_px, or within reach_sigmas of sigma_px (N,).
        """
        matrix = matrix_from_quaternion(attitude.quaternion)
        self._find_near(matrix[:, 2])
        known = np.flatnonzero((sigma_px > 0) & np.isfinite(uv).all(axis=1))
        reach = np.maximum(reach_px, reach_sigmas * sigma_px)

        def far_from(stars: np.ndarray, spots: np.ndarray) -> np.ndarray:
            place = self.camera.project(sky.direction(stars) @ matrix)
            # NaN, of a star without a pixel, is not near.
            du, dv = (uv[spots, axis, None] - place[:, axis] for axis in (0, 1))
            return spots[~(du * du + dv * dv <= reach[spots, None] ** 2).any(axis=1)]
        left = far_from(self._near[:BRIGHT_STARS], known)
        # Most are bright stars. Only where others are left the faint ones near them are looked up.
        if len(left) and len(self._near) > BRIGHT_STARS:
            angle_rad = APPARENT_RAD + 2 * reach[left].max() * self.camera.pixel_rad
            axes = matrix @ self.camera.unproject(uv[left]).T
            beside = (self._natural @ axes >= math.cos(min(angle_rad, math.pi))).any(axis=1)
            left = far_from(self._near[beside], left)
        return left

    def _find_near(self, boresight: np.ndarray) -> None:
        """Find the stars in and near the image, and their directions in the catalogue."""
        if not boresight @ self._centre > self._cos_ahead:
            self._centre = boresight.copy()
            self._near = self.onboard.within(boresight, self.camera.corner_angle_rad + AHEAD_RAD)
            self._natural = self.onboard.direction[self._near]
