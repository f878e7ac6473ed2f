# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stars that are streaks: fits of the motion of the exposure, and which are no stars."""

import numpy as np
from startracker_ros.core.centroid.background import background_at
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.frame import Frame
from startracker_ros.core.centroid.noise import initial_noise_model, NoiseModel
from startracker_ros.core.centroid.point_stars import EDGE_SIGMAS, FAINT, inflation
from startracker_ros.core.centroid.psf import FLUX, SIGMA, U, V
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.streak import Streak
from startracker_ros.core.centroid.streak_fit import (
    ANGLE, fit_streaks, flux_at, LENGTH, photon_gain, Pixels, pixels_at, StreakFit, streaks_at)
from startracker_ros.core.centroid.streak_search import MAX_MISFIT, misfit

ROUGH_ITERATIONS = 6
ITERATIONS = 8
LEAST_PIXELS = 12  # degrees of freedom of a fit


def measure_streaks(frame: Frame, uv: np.ndarray, streak: Streak, sigma_px: float,
                    threshold_sigmas: float, rejections: Rejections) -> Centroids:
    """Fit streaks of this PSF sigma that are near uv (K, 2) px; return the good ones."""
    keep = rejections.reject(uv, edge=_beyond_edge(frame, uv, streak.at(uv), sigma_px))
    start = streaks_at(uv[keep], streak.at(uv[keep]), sigma_px)
    pixels = _pixels(frame, start[:, [U, V]])
    start[:, FLUX] = flux_at(pixels, start)
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_streaks(pixels, start, noise, 4, ROUGH_ITERATIONS)
    keep = rejections.reject(fit.parameters[:, [U, V]], **_no_stars(fit, start, threshold_sigmas))
    fit = StreakFit(*(column[keep] for column in fit))
    pixels = _pixels(frame, fit.parameters[:, [U, V]])
    noise = NoiseModel(photon_gain(pixels, fit, noise))
    fit = fit_streaks(pixels, fit.parameters, noise, 4, ITERATIONS)
    keep = rejections.reject(
        fit.parameters[:, [U, V]], **_no_stars(fit, start[keep], threshold_sigmas))
    return _centroids(StreakFit(*(column[keep] for column in fit)))


def _pixels(frame: Frame, uv: np.ndarray) -> Pixels:
    """Return the image with the background at uv (K, 2)."""
    noise = np.array([background_at(frame.mesh, round(u), round(v))[1] for u, v in uv.tolist()])
    return pixels_at(frame.image, frame.mesh, uv, (noise / frame.kernel.noise_gain) ** 2,
                     frame.full_scale_dn)


def _beyond_edge(frame: Frame, uv: np.ndarray, streak_px: np.ndarray, sigma_px: float
                 ) -> np.ndarray:
    """Return which streaks (K,) do not end within the image."""
    height, width = frame.image.shape
    margin = np.ceil(EDGE_SIGMAS * sigma_px) + np.abs(streak_px) / 2
    return ((uv < margin) | (uv > [width - 1, height - 1] - margin)).any(axis=1)


def _no_stars(fit: StreakFit, start: np.ndarray, threshold_sigmas: float
              ) -> dict[str, np.ndarray]:
    """Return by reason which fits (K,) are no streaks of stars."""
    star = fit.parameters
    distance = np.hypot(*(star[:, [U, V]] - start[:, [U, V]]).T)
    variance = fit.covariance[:, FLUX, FLUX]
    with np.errstate(invalid='ignore', divide='ignore'):
        significance = star[:, FLUX] / np.sqrt(variance)
        unlike = misfit(fit.chi2, fit.dof, star[:, FLUX], variance) > MAX_MISFIT
    bad = (~np.isfinite(star).all(axis=1) | (fit.dof < LEAST_PIXELS)
           | ~(distance < star[:, LENGTH] / 2 + 3 * star[:, SIGMA]))
    return {'not_fitted': bad | _duplicates(star),
            'faint': ~(significance >= FAINT * threshold_sigmas), 'not_streaked': unlike}


def _duplicates(star: np.ndarray) -> np.ndarray:
    """Return which streaks (K,) lie upon a brighter one."""
    away = star[:, None, [U, V]] - star[:, [U, V]]
    c, s = np.cos(star[:, ANGLE]), np.sin(star[:, ANGLE])
    along = np.abs(away[..., 0] * c + away[..., 1] * s)
    across = np.abs(away[..., 1] * c - away[..., 0] * s)
    close = (along < 0.5 * star[:, LENGTH] + star[:, SIGMA]) & (across < star[:, SIGMA])
    return (close & (star[:, FLUX] > star[:, FLUX, None])).any(axis=1)


def _centroids(fit: StreakFit) -> Centroids:
    """Return fitted streaks."""
    star, factor = fit.parameters, inflation(fit.chi2, fit.dof)
    covariance = fit.covariance[:, :V + 1, :V + 1] * (factor ** 2)[:, None, None]
    return Centroids(
        star[:, [U, V]], star[:, FLUX],
        star[:, FLUX] / np.sqrt(fit.covariance[:, FLUX, FLUX]) / factor,
        np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2), covariance)
