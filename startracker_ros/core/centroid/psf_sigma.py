# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""PSF sigma of the stars of a frame."""

from functools import partial
from statistics import median

import numpy as np
from startracker_ros.core.centroid.detection import Peaks
from startracker_ros.core.centroid.frame import Frame
from startracker_ros.core.centroid.noise import initial_noise_model
from startracker_ros.core.centroid.point_stars import fit_free_sigma
from startracker_ros.core.centroid.psf import FLUX, SIGMA
from startracker_ros.core.centroid.streak_search import MAX_MISFIT, misfit

BATCH = 10  # peaks fitted at a time, brightest first
MAX_BATCHES = 6
ENOUGH_STARS, STAR_SHARE = 3, 0.5  # of the spots, whose median is the PSF sigma
MAX_ERROR = 0.25  # relative, of the PSF sigma of a star that counts
NARROWEST_PX = 0.3  # of such a star in the middle of its pixel no other one has a share
ITERATIONS = 4
NARROW_QUANTILE = 0.1


def measure_psf_sigma(frame: Frame, narrow: bool = False) -> tuple[float, bool]:
    """
    Return the median PSF sigma (px) of the brightest stars, and whether it is certain.

    It is when a Gaussian explains most of the spots: others may be hits. Without any spot it is
    that of the filter that found the peaks. Where narrow it is that of the narrowest stars,
    as most may be debris out of focus.
    """
    typical = partial(np.quantile, q=NARROW_QUANTILE) if narrow else median
    sigmas, stars, peaks = [], [], frame.search.peaks
    for first in range(0, min(len(peaks.uv), MAX_BATCHES * BATCH), BATCH):
        sigma, explained = _sigmas(frame, peaks.select(slice(first, first + BATCH)))
        sigmas += sigma.tolist()
        stars += sigma[explained].tolist()
        if not narrow and len(stars) >= max(ENOUGH_STARS, STAR_SHARE * len(sigmas)):
            return median(stars), True
    if len(stars) >= ENOUGH_STARS:
        return float(typical(stars)), False
    return median(sigmas[:BATCH]) if sigmas else frame.kernel.sigma_px, False


def _sigmas(frame: Frame, peaks: Peaks) -> tuple[np.ndarray, np.ndarray]:
    """Return sigmas (N,) of peaks that may be unsaturated stars, and which Gaussians explain."""
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    star, covariance, chi2, dof, round_spot = fit_free_sigma(
        frame.image, frame.mesh, frame.kernel, frame.full_scale_dn, peaks, noise,
        frame.kernel.sigma_px, ITERATIONS)
    sigma, variance = star[:, SIGMA], covariance[:, SIGMA, SIGMA]
    # That of a fit that fails may be negative.
    error = np.sqrt(np.where(variance >= 0, variance, np.inf))
    explained = (sigma > NARROWEST_PX) & (
        misfit(chi2, dof, star[:, FLUX], covariance[:, FLUX, FLUX]) < MAX_MISFIT)
    counts = (error < MAX_ERROR * sigma) & round_spot
    return sigma[counts], explained[counts]
