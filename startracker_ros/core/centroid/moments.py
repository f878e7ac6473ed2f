# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Centroids as weighted means of the pixels above a threshold, and their errors.

Gao and Cui 2016: u = sum(x G) / sum(G) over the window of a star. The weight G of a pixel with
grey value g is 1, g, g^2 or g - t where g >= t, the threshold, and 0 elsewhere.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.gaussian_fit import Fit
from startracker_ros.core.centroid.noise import NoiseModel, pixel_variance
from startracker_ros.core.centroid.psf import FLUX, LEVEL, profile, SHARE, SIGMA
from startracker_ros.core.centroid.windows import Windows
from startracker_ros.core.compiled import compiled

WEIGHTS = ('binary', 'grey', 'squared', 'thresholded')
SEGMENT_SIGMAS = 3.0  # noise of a pixel, above which it belongs to a star
BINARY, GREY, SQUARED, THRESHOLDED = range(4)
PHASES = 32  # positions of a star within its pixel over which its error is averaged
_STRIDE = 13  # of a lattice with one point in each of 32 columns and 32 rows
_CONVERGED, _MAX_ITERATIONS = 1e-3, 30  # of the iterative threshold: share of the range
_FAR_SIGMAS = 8.0  # noise never lifts a pixel that far to the threshold


class Segmentation(NamedTuple):
    """
    Which pixels belong to a star: threshold_dn if positive, else a threshold of each window.

    That is SEGMENT_SIGMAS of noise, and if iterative no less than the iterative threshold. All
    are above the local background and multiplied by factor.
    """

    threshold_dn: float
    iterative: bool
    factor: float


@compiled
def weighted_means(kind: int, windows: Windows, fit: Fit, noise: NoiseModel,
                   segmentation: Segmentation) -> tuple[np.ndarray, np.ndarray]:
    """
    Return uv (K, 2) px and their 1-sigma errors (K,) px; NaN where no pixel is left.

    kind is an index of WEIGHTS. The fitted flux of neighbours is subtracted first. The error is
    computed for a star of the fitted flux and width: the noise of the mean together with its bias
    by pixels and threshold, rms over the positions of the star within a pixel.
    """
    stars, count = windows.data.shape[:2]
    uv, sigma = np.empty((stars, 2)), np.empty(stars)
    for i in range(stars):
        # Saturated pixels count with their value: without them there would be a hole.
        grey = fit.own[i, :, :count] + fit.parameters[i, LEVEL]
        threshold = _threshold(segmentation, grey, windows.variance[i])
        total = across = down = 0.0
        for y in range(count):
            for x in range(count):
                if grey[y, x] >= threshold:
                    weight = _weight(kind, grey[y, x], threshold)
                    total, across, down = total + weight, across + weight * x, down + weight * y
        uv[i, 0] = windows.corner[i, 0] + across / total
        uv[i, 1] = windows.corner[i, 1] + down / total
        sigma[i] = math.sqrt(_square_error(kind, windows, fit, i, noise, segmentation))
    return uv, sigma


@compiled
def _threshold(segmentation: Segmentation, grey: np.ndarray, variance: float) -> float:
    """Return the threshold of a window (n, n) above a background of this variance."""
    if segmentation.threshold_dn > 0:
        return segmentation.factor * segmentation.threshold_dn
    threshold = SEGMENT_SIGMAS * math.sqrt(variance)
    if segmentation.iterative:
        threshold = max(threshold, iterative_threshold(grey))
    return segmentation.factor * threshold


@compiled
def _weight(kind: int, grey: float, threshold: float) -> float:
    if kind == BINARY:
        return 1.0
    if kind == GREY:
        return grey
    if kind == SQUARED:
        return grey * grey
    return grey - threshold


@compiled
def _square_error(kind: int, windows: Windows, fit: Fit, i: int, noise: NoiseModel,
                  segmentation: Segmentation) -> float:
    """Return the mean square error per axis in px^2 of star i, averaged over PHASES."""
    count = windows.data.shape[1]
    share, grey = np.empty((2, 3, count)), np.empty((count, count))
    flux, width, middle = fit.parameters[i, FLUX], fit.parameters[i, SIGMA], count // 2
    used, background, error = windows.used[i], windows.variance[i], 0.0
    for phase in range(PHASES):
        u = middle + (phase + 0.5) / PHASES - 0.5
        v = middle + (phase * _STRIDE % PHASES + 0.5) / PHASES - 0.5
        profile(u, width, 0, share[0])
        profile(v, width, 0, share[1])
        for y in range(count):
            for x in range(count):
                grey[y, x] = used[y, x] * flux * share[1, SHARE, y] * share[0, SHARE, x]
        threshold = _threshold(segmentation, grey, background)
        error = _add_error(error, kind, grey, used, noise, background, threshold, u, v)
    return error / (2 * PHASES)


@compiled
def _add_error(error: float, kind: int, grey: np.ndarray, used: np.ndarray, noise: NoiseModel,
               background: float, threshold: float, u: float, v: float) -> float:
    """
    Return error plus the expected square error, of both axes, of a star at u, v of (n, n).

    Per axis it is the bias and the noise of the mean, E_k the mean and V_k the variance of the
    weight of pixel k:

        (x - u)^2 + sum((x_k - x)^2 V_k) / sum(E_k)^2,  x = sum(x_k E_k) / sum(E_k)
    """
    count = len(grey)
    weight_variance = np.empty((count, count))
    total = across = down = 0.0
    for y in range(count):
        for x in range(count):
            weight_variance[y, x] = 0
            if used[y, x]:
                variance = pixel_variance(noise, background, grey[y, x])
                mean, square = _expected(kind, grey[y, x], math.sqrt(variance), threshold)
                weight_variance[y, x] = square - mean * mean
                total, across, down = total + mean, across + mean * x, down + mean * y
    across, down = across / total, down / total
    error += (across - u) ** 2 + (down - v) ** 2
    for y in range(count):
        for x in range(count):
            error += (weight_variance[y, x] * ((x - across) ** 2 + (y - down) ** 2)
                      / total ** 2)
    return error


@compiled
def _expected(kind: int, grey: float, sigma: float, threshold: float) -> tuple[float, float]:
    """Return the means of the weight of a pixel and of its square, over normal noise."""
    a = (threshold - grey) / sigma
    if a > _FAR_SIGMAS:
        return 0.0, 0.0
    above = 0.5 * math.erfc(a * math.sqrt(0.5))
    density = math.exp(-0.5 * a * a) / math.sqrt(2 * math.pi)
    if kind == BINARY:
        return above, above
    # Moments of a standard normal distribution over z > a; grey is m + s z.
    second, third = above + a * density, (a * a + 2) * density
    fourth = 3 * above + (a * a + 3) * a * density
    m, s = (grey - threshold if kind == THRESHOLDED else grey), sigma
    square = m * m * above + 2 * m * s * density + s * s * second
    if kind == SQUARED:
        return square, (m ** 4 * above + 4 * m ** 3 * s * density + 6 * m * m * s * s * second
                        + 4 * m * s ** 3 * third + s ** 4 * fourth)
    return m * above + s * density, square


@compiled
def iterative_threshold(window: np.ndarray) -> float:
    """
    Return the value that is the mean of the means of the pixels of (n, n) below and above it.

    The iteration starts halfway between the darkest and the brightest pixel.
    """
    low, high = window.min(), window.max()
    threshold = (low + high) / 2
    for _ in range(_MAX_ITERATIONS):
        bright, total, bright_total = 0, 0.0, 0.0
        for y in range(window.shape[0]):
            for x in range(window.shape[1]):
                total += window[y, x]
                if window[y, x] >= threshold:
                    bright, bright_total = bright + 1, bright_total + window[y, x]
        if bright == 0 or bright == window.size:
            break
        before = threshold
        threshold = (bright_total / bright
                     + (total - bright_total) / (window.size - bright)) / 2
        if abs(threshold - before) < _CONVERGED * (high - low):
            break
    return threshold
