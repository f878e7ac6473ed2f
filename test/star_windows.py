# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Windows of single stars for tests of the fits, without an image around them."""

import numpy as np
from scipy.stats import norm
from startracker_ros.core.centroid.windows import LANES, Windows


def psf_image(star: np.ndarray, side_px: int) -> np.ndarray:
    """Return a star (u, v, flux, level, sigma) as a Gaussian integrated over pixels."""
    u, v, flux, level, sigma = star[:5]
    a, d = (np.diff(norm.cdf(np.arange(-0.5, side_px), centre, sigma)) for centre in (u, v))
    return level + flux * np.outer(d, a)


def windows_of(data: np.ndarray, variance: float) -> Windows:
    """Return windows of data (K, n, n) DN above the background, each with its corner at 0, 0."""
    count, side_px = len(data), data.shape[1]
    filled = -(-side_px // LANES) * LANES
    windows = Windows(np.zeros((count, side_px, filled), np.float32),
                      np.zeros((count, side_px, filled), bool), np.zeros((count, 2), int),
                      np.full(count, variance), np.zeros(count + 1, int), np.empty(0, int))
    windows.data[:, :, :side_px], windows.used[:, :, :side_px] = data, True
    return windows
