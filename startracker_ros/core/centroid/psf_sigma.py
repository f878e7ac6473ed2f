# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""PSF sigma of the stars of a frame."""

from functools import partial
from statistics import median

import numpy as np
from startracker_ros.core.centroid.detection import Peaks
from startracker_ros.core.centroid.frame import Frame
from startracker_ros.core.centroid.gaussian_fit import fit_stars
from startracker_ros.core.centroid.noise import initial_noise_model
from startracker_ros.core.centroid.position import drifted
from startracker_ros.core.centroid.psf import FLUX, SIGMA
from startracker_ros.core.centroid.shape import lone_pixels, streaks
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
    windows, start = frame.windows(peaks, frame.kernel.sigma_px)
    chosen = (windows.saturated_cores() == 0) & ~lone_pixels(windows.data)
    windows, start = windows.select(chosen), start[chosen]
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_stars(windows, start, noise, free_sigma=True, iterations=ITERATIONS)
    sigma = fit.parameters[:, SIGMA]
    error = np.sqrt(fit.covariance[:, SIGMA, SIGMA])
    explained = (sigma > NARROWEST_PX) & (misfit(
        fit.chi2, fit.dof, fit.parameters[:, FLUX], fit.covariance[:, FLUX, FLUX]) < MAX_MISFIT)
    counts = (error < MAX_ERROR * sigma) & ~drifted(fit, windows) & ~streaks(fit, windows)
    return sigma[counts], explained[counts]
