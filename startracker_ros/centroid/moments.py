"""
Centroids as weighted means of the pixels above a threshold, and the errors they make.

Gao and Cui 2016: sum(x G) / sum(G) over the window of a star, with G of the light g of a pixel
1, g, g^2 or g - t where g >= t, else 0.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.centroid.gaussian_fit import Fit
from startracker_ros.centroid.noise import NoiseModel, pixel_variance
from startracker_ros.centroid.psf import FLUX, LEVEL, profile, SIGMA
from startracker_ros.centroid.threshold import iterative_threshold
from startracker_ros.centroid.windows import Windows
from startracker_ros.compiled import compiled

WEIGHTS = ('binary', 'grey', 'squared', 'thresholded')
SEGMENT_SIGMAS = 3.0  # noise of a pixel, above which it belongs to a star
BINARY, GREY, SQUARED, THRESHOLDED = range(4)
PHASES = 32  # places of a star within its pixel over which its error is averaged
_STRIDE = 13  # a lattice that meets each of 32 columns and each of 32 rows once
_FAR_SIGMAS = 8.0  # a pixel so far from the threshold is certainly on its side


class Segmentation(NamedTuple):
    """
    Which pixels belong to a star: threshold_dn if positive, else a threshold of each window.

    That is SEGMENT_SIGMAS of noise, and if iterative no less than the iterative threshold; all
    above the local background, and times factor.
    """

    threshold_dn: float
    iterative: bool
    factor: float


def weighted_means(method: str, windows: Windows, fit: Fit, noise: NoiseModel,
                   segmentation: Segmentation) -> tuple[np.ndarray, np.ndarray]:
    """
    Return places (K, 2) px and their 1-sigma errors (K,) px; NaN where no pixel is left.

    The light of neighbours, as fitted, is taken off first. The error follows from flux and
    width of the fit: that of the mean over pixels with their noise, together with the bias
    which pixels and threshold give it, as root mean square over all places of the star
    within a pixel.
    """
    return _means(WEIGHTS.index(method), windows, fit, noise, segmentation)


@compiled
def _means(kind: int, windows: Windows, fit: Fit, noise: NoiseModel, segmentation: Segmentation
           ) -> tuple[np.ndarray, np.ndarray]:
    stars, count = windows.data.shape[:2]
    uv, sigma = np.empty((stars, 2)), np.empty(stars)
    for i in range(stars):
        # A saturated pixel counts with what it shows: without it there would be a hole.
        light = fit.own[i, :, :count] + fit.parameters[i, LEVEL]
        threshold = _threshold(segmentation, light, windows.variance[i])
        total = across = down = 0.0
        for y in range(count):
            for x in range(count):
                if light[y, x] >= threshold:
                    weight = _weight(kind, light[y, x], threshold)
                    total, across, down = total + weight, across + weight * x, down + weight * y
        uv[i, 0] = windows.corner[i, 0] + across / total
        uv[i, 1] = windows.corner[i, 1] + down / total
        sigma[i] = math.sqrt(_square_error(kind, windows, fit, i, noise, segmentation))
    return uv, sigma


@compiled
def _threshold(segmentation: Segmentation, light: np.ndarray, variance: float) -> float:
    """Return the threshold of a window with this light (n, n) above a sky of this variance."""
    if segmentation.threshold_dn > 0:
        return segmentation.factor * segmentation.threshold_dn
    threshold = SEGMENT_SIGMAS * math.sqrt(variance)
    if segmentation.iterative:
        threshold = max(threshold, iterative_threshold(light))
    return segmentation.factor * threshold


@compiled
def _weight(kind: int, light: float, threshold: float) -> float:
    if kind == BINARY:
        return 1.0
    if kind == GREY:
        return light
    if kind == SQUARED:
        return light * light
    return light - threshold


@compiled
def _square_error(kind: int, windows: Windows, fit: Fit, i: int, noise: NoiseModel,
                  segmentation: Segmentation) -> float:
    """Return the mean square error per axis in px^2 of star i."""
    count = windows.data.shape[1]
    share, light = np.empty((2, 3, count)), np.empty((count, count))
    first, spread = np.empty((count, count)), np.empty((count, count))
    flux, width, middle = fit.parameters[i, FLUX], fit.parameters[i, SIGMA], count // 2
    error = 0.0
    for phase in range(PHASES):
        u = middle + (phase + 0.5) / PHASES - 0.5
        v = middle + (phase * _STRIDE % PHASES + 0.5) / PHASES - 0.5
        profile(u, width, 0, share[0])
        profile(v, width, 0, share[1])
        for y in range(count):
            for x in range(count):
                light[y, x] = windows.used[i, y, x] * flux * share[1, 0, y] * share[0, 0, x]
        threshold = _threshold(segmentation, light, windows.variance[i])
        total = across = down = 0.0
        for y in range(count):
            for x in range(count):
                first[y, x] = spread[y, x] = 0
                if windows.used[i, y, x]:
                    variance = pixel_variance(noise, windows.variance[i], light[y, x])
                    mean, square = _expected(kind, light[y, x], math.sqrt(variance), threshold)
                    first[y, x], spread[y, x] = mean, square - mean * mean
                    total, across, down = total + mean, across + mean * x, down + mean * y
        across, down = across / total, down / total
        error += (across - u) ** 2 + (down - v) ** 2
        for y in range(count):
            for x in range(count):
                error += spread[y, x] * ((x - across) ** 2 + (y - down) ** 2) / total ** 2
    return error / (2 * PHASES)


@compiled
def _expected(kind: int, light: float, sigma: float, threshold: float) -> tuple[float, float]:
    """Return the mean of the weight of a pixel and of its square, over normal noise."""
    a = (threshold - light) / sigma
    if a > _FAR_SIGMAS:
        return 0.0, 0.0
    above = 0.5 * math.erfc(a * math.sqrt(0.5))
    density = math.exp(-0.5 * a * a) / math.sqrt(2 * math.pi)
    if kind == BINARY:
        return above, above
    # Moments of the part of a normal distribution above a.
    second, third = above + a * density, (a * a + 2) * density
    fourth = 3 * above + (a * a + 3) * a * density
    m, s = (light - threshold if kind == THRESHOLDED else light), sigma
    square = m * m * above + 2 * m * s * density + s * s * second
    if kind == SQUARED:
        return square, (m ** 4 * above + 4 * m ** 3 * s * density + 6 * m * m * s * s * second
                        + 4 * m * s ** 3 * third + s ** 4 * fourth)
    return m * above + s * density, square
