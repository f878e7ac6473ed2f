# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The common rotation of all stars of a frame, and the outliers."""

from dataclasses import dataclass
import math

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate, estimate_attitude
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.integrity.checks import FEW_AGREE, STAR_OUTLIER
from startracker_ros.core.maths.rotation import conjugate, rotate

OUTLIER_SIGMA = STAR_OUTLIER.sigmas

RAYLEIGH_MEDIAN = np.sqrt(2 * np.log(2))
"""Median distance from the truth in two dimensions, in units of sigma per axis."""


def median(values: np.ndarray) -> float:
    """Return NumPy's median of (N,) in a fifth of its time, NaN for none or where one is NaN."""
    ranked = sorted(values.tolist())
    middle = len(ranked) // 2
    if not ranked or np.isnan(values).any():
        return math.nan
    return ranked[middle] if len(ranked) % 2 else (ranked[middle - 1] + ranked[middle]) / 2


@dataclass(frozen=True)
class RotationFit:
    """
    An attitude and the residuals of the stars.

    normalised (N,) is the residual of each star over its own sigma times scale, which is above 1
    where a lens that is not calibrated moves all stars; inlier (N,) masks the stars of the fit;
    residual_px is their rms residual.
    """

    attitude: AttitudeEstimate
    normalised: np.ndarray
    scale: float
    inlier: np.ndarray
    residual_px: float

    def is_good(self, stars: int, min_stars: int, max_residual_px: float) -> bool:
        """Return whether min_stars, and a third of stars, fit within max_residual_px rms."""
        return is_good(int(np.count_nonzero(self.inlier)), stars, self.residual_px, min_stars,
                       max_residual_px)


def is_good(inliers: int, stars: int, residual_px: float, min_stars: int, max_residual_px: float
            ) -> bool:
    """Return whether min_stars, and a third of stars, fit within max_residual_px rms."""
    least = max(min_stars, math.ceil(stars / FEW_AGREE.limits['stars_for_one']))
    return inliers >= least and residual_px <= max_residual_px


def fit_rotation(camera: Camera, icrf: np.ndarray, uv: np.ndarray, sigma_px: np.ndarray,
                 candidate: np.ndarray, solver: str = 'quest') -> RotationFit:
    """
    Return the attitude of the candidates (N,) without outliers, and the residuals of all stars.

    icrf (N, 3), uv (N, 2) px, sigma_px (N,) per axis. One outlier is removed
    at a time, the worst: it biases the fit. Outliers and residuals are those of the best fit of
    all stars, the attitude is that of the solver. AttitudeError when too few are left.
    """
    sensor = camera.unproject(uv)
    sigma_rad = sigma_px * camera.pixel_rad
    inlier = candidate.copy()
    while True:
        attitude = estimate_attitude(sensor[inlier], icrf[inlier], sigma_rad[inlier])
        predicted = camera.project(rotate(conjugate(attitude.quaternion), icrf))
        distance = np.hypot(*(uv - predicted).T)
        normalised = distance / sigma_px
        scale = max(1.0, median(normalised[inlier]) / RAYLEIGH_MEDIAN)
        normalised = np.where(np.isfinite(normalised), normalised / scale, np.inf)
        worst = np.argmax(np.where(inlier, normalised, 0))
        if normalised[worst] <= OUTLIER_SIGMA:
            if solver != 'quest':
                attitude = estimate_attitude(
                    sensor[inlier], icrf[inlier], sigma_rad[inlier], solver)
            return RotationFit(attitude, normalised, float(scale), inlier,
                               float(np.sqrt(np.mean(distance[inlier] ** 2))))
        inlier[worst] = False
