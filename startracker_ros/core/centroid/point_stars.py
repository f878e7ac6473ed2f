# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stars that are points: fits of a Gaussian to peaks, and which of them are no stars."""

from dataclasses import replace

import numpy as np
from startracker_ros.core.centroid.centroids import Centroids, ROUND
from startracker_ros.core.centroid.detection import Peaks
from startracker_ros.core.centroid.frame import Frame
from startracker_ros.core.centroid.gaussian_fit import Fit, fit_stars
from startracker_ros.core.centroid.moments import Segmentation, weighted_means
from startracker_ros.core.centroid.noise import initial_noise_model, NoiseModel
from startracker_ros.core.centroid.noise_fit import refine_noise_model
from startracker_ros.core.centroid.position import drifted, duplicates
from startracker_ros.core.centroid.psf import FLUX, U, V
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.shape import classify_shapes, lone_pixels
from startracker_ros.core.centroid.windows import Windows

ROUGH_ITERATIONS = 2
EDGE_SIGMAS = 1.5  # closest distance of a star to the edge of the image, in PSF sigmas
MAX_SATURATED_PX = 24  # of the 5 x 5 pixels around the peak: its flanks show where a star is,
FEW_SATURATED_PX = 4  # but each pixel more than these may have bloomed
BLOOMING_PX = 0.02
FAINT = 0.85  # of the threshold: the fit frees position and level too, so its SNR is lower
MISFIT = 3.0  # standard deviations of chi-square beyond which errors are inflated


def measure_points(frame: Frame, peaks: Peaks, sigma_px: float, threshold_sigmas: float,
                   method: str, segmentation: Segmentation, rejections: Rejections
                   ) -> tuple[Centroids, bool]:
    """Fit stars of this PSF sigma to the peaks; return good ones, and whether all are smeared."""
    windows, start = frame.windows(peaks, sigma_px)
    keep = rejections.reject(
        peaks.uv, edge=_border_px(frame, peaks) < np.ceil(EDGE_SIGMAS * sigma_px),
        saturated=windows.saturated_cores() > MAX_SATURATED_PX)
    windows, start, noise, smeared = _fit_roughly(
        frame, windows.select(keep), start[keep], rejections)
    fit = fit_stars(windows, start, noise)
    centroids = _centroids(fit)
    blooming_px = BLOOMING_PX * np.maximum(windows.saturated_cores() - FEW_SATURATED_PX, 0)
    if blooming_px.any():
        centroids = replace(centroids, sigma_px=np.hypot(centroids.sigma_px, blooming_px),
                            covariance=ROUND)
    keep = rejections.reject(
        centroids.uv, not_fitted=drifted(fit, windows) | duplicates(fit, windows),
        faint=_significance(fit) < FAINT * threshold_sigmas)
    if method != 'gaussian':
        uv, error_px = weighted_means(method, windows, fit, noise, segmentation)
        centroids = replace(centroids, uv=uv, sigma_px=error_px, covariance=ROUND)
        keep &= rejections.reject(uv, faint=keep & ~np.isfinite(uv[:, 0]))
    return centroids.select(keep), smeared


def inflation(chi2: np.ndarray, dof: np.ndarray) -> np.ndarray:
    """Return factors (K,) of the errors: sqrt(chi2 / dof) for a misfit beyond chance, else 1."""
    ratio = chi2 / dof
    return np.where(ratio > 1 + MISFIT * np.sqrt(2 / dof), np.sqrt(ratio), 1.0)


def _fit_roughly(frame: Frame, windows: Windows, start: np.ndarray, rejections: Rejections
                 ) -> tuple[Windows, np.ndarray, NoiseModel, bool]:
    """
    Reject what is no star; return windows, parameters (K, 5) and noise model of the rest.

    The last result is whether all spots are smeared.
    """
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_stars(windows, start, noise, iterations=ROUGH_ITERATIONS)
    shape = classify_shapes(fit, windows)
    keep = rejections.reject(
        fit.parameters[:, :V + 1],
        hot_pixel=shape.narrow & lone_pixels(windows.data), cosmic_ray=shape.narrow,
        elongated=shape.elongated, too_wide=shape.wide, not_fitted=drifted(fit, windows))
    noise = refine_noise_model(noise, fit, windows, keep & (windows.saturated_cores() == 0))
    return windows.select(keep), fit.parameters[keep], noise, shape.smeared


def _border_px(frame: Frame, peaks: Peaks) -> np.ndarray:
    """Return the distance (K,) of the peaks to the edge of the image."""
    (height, width), (u, v) = frame.image.shape, peaks.uv.T
    return np.minimum(np.minimum(u, width - 1 - u), np.minimum(v, height - 1 - v))


def _significance(fit: Fit) -> np.ndarray:
    """Return flux (K,) over its 1-sigma error by the noise model alone."""
    return fit.parameters[:, FLUX] / np.sqrt(fit.covariance[:, FLUX, FLUX])


def _centroids(fit: Fit) -> Centroids:
    """Return all fitted stars."""
    factor = inflation(fit.chi2, fit.dof)
    variance = (fit.covariance[:, U, U] + fit.covariance[:, V, V]) / 2
    return Centroids(fit.parameters[:, :V + 1], fit.parameters[:, FLUX],
                     _significance(fit) / factor, factor * np.sqrt(variance))
