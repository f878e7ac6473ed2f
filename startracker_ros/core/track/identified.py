# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Identified frames: their attitude, and whether it contradicts that of the tracks."""

from dataclasses import dataclass
import math

import numpy as np
from startracker_ros.core.attitude.error_ellipses import fit_error_ellipses
from startracker_ros.core.attitude.estimate import AttitudeError, AttitudeEstimate
from startracker_ros.core.attitude.result import with_correlated_error
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import attitude_error, conjugate, rotate
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.rotation_fit import fit_rotation

CONTRADICTION_SIGMA = 10.0
"""Mahalanobis distance of an identification from the tracks: far beyond the unmodelled errors
of the lens, far below the degrees of a wrong identification."""


@dataclass(frozen=True)
class IdentifiedFrame:
    """
    A frame that fits the catalogue: star_index (N,), centroids of N stars, and the attitude.

    scale is that of RotationFit.
    """

    stamp_ns: int
    star_index: np.ndarray
    centroids: Centroids
    attitude: AttitudeEstimate
    scale: float

    def contradicts(self, tracked: AttitudeEstimate, camera: Camera, sky: ApparentCatalog,
                    max_residual_px: float) -> bool:
        """
        Return whether a tracked attitude of the same frame is too far from this one.

        In sigma and in pixels: a small sigma alone, or a poor lens alone, is no contradiction.
        """
        error = attitude_error(self.attitude.quaternion, tracked.quaternion)
        covariance = self.attitude.covariance_sensor + tracked.covariance_sensor
        sigmas = math.sqrt(error @ np.linalg.solve(covariance, error))
        sensor = rotate(conjugate(tracked.quaternion), sky.direction(self.star_index))
        residual = camera.project(sensor) - self.centroids.uv
        rms_px = np.sqrt(np.mean(np.sum(residual ** 2, axis=1)))
        return sigmas > CONTRADICTION_SIGMA and not rms_px <= 3 * max_residual_px


def fit_identified(camera: Camera, sky: ApparentCatalog, options: TrackerOptions, stamp_ns: int,
                   centroids: Centroids, error_px2: np.ndarray, hip: np.ndarray
                   ) -> tuple[IdentifiedFrame | None, str]:
    """
    Return an identified frame without outliers, None unless enough stars fit well enough.

    The second result is why the stars do not fit, empty if they do or are too few.

    error_px2 (N, 2, 2) and hip (N,) are of each centroid, hip is 0 where it is unknown. Crowded
    stars are left out. Of several centroids with one hip the first, the brightest, counts.
    """
    star_index = sky.onboard.index_of(hip)
    known = (star_index >= 0) & ~sky.crowded(star_index)
    known[known] = _first_of_each(star_index[known])
    centroids, error_px2, star_index = (
        centroids.select(known), error_px2[known], star_index[known])
    if len(star_index) < options.min_stars:
        return None, ''
    try:
        fit = fit_rotation(camera, sky.direction(star_index), centroids.uv,
                           np.sqrt(np.trace(error_px2, axis1=1, axis2=2) / 2),
                           np.ones(len(star_index), bool))
    except AttitudeError:
        return None, ''
    if not fit.is_good(len(star_index), options.min_stars, options.max_residual_px):
        return None, (f'{len(star_index)} identified stars fit to {fit.residual_px:.2g} px rms, '
                      f'max_residual_px is {options.max_residual_px:g}: calibrate the lens'
                      if fit.residual_px > options.max_residual_px else '')
    star_index, centroids = star_index[fit.inlier], centroids.select(fit.inlier)
    attitude = fit_error_ellipses(
        fit.attitude, camera, centroids.uv, sky.direction(star_index), error_px2[fit.inlier])
    return IdentifiedFrame(
        stamp_ns, star_index, centroids,
        with_correlated_error(attitude, centroids.correlated_error, camera), fit.scale), ''


def _first_of_each(values: np.ndarray) -> np.ndarray:
    """Return True (N,) at the first occurrence of each value."""
    if len(set(values.tolist())) == len(values):
        return np.ones(len(values), bool)
    first = np.zeros(len(values), bool)
    first[np.unique(values, return_index=True)[1]] = True
    return first
