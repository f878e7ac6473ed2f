# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Error of the pointing that all stars of an image share: motion that is not uniform in the exposure.

A camera that is kicked or vibrates during the exposure draws the same figure of every star. A
fit finds the brightest part of it, the same part of every star, so that no residual shows the
error. What the fits leave, over the flux and about the fitted position d = 0, is the same image of
all stars, L(d), with neighbours and hits of single ones.

Flux that is the same on both sides does not move a star, whatever the shape of its image: rings of
an aperture or a defocused lens, a wing, the spikes of a spider. What counts is the odd part of
each star, resampled about its fitted centre,

    A(d) = L(d) - L(-d)

Where two parts are equally bright, some stars are fitted at the one, some at the other, which
changes the sign of A: it is made that of the brightest star. Of the stars an upper quantile
counts, which neighbours and hits of single ones do not move, if most have it in their own images.
Where A exceeds its noise, A > 0 is flux beside the fitted star, of a total of 1 + sum A. The mean
pointing of the exposure is off by b = sum A d / (1 + sum A). The covariance of the correlated
error is

    C = b b^T + UNCERTAIN^2 M,  M = sum A d d^T / (1 + sum A)

where flux that is wrong by a share UNCERTAIN of itself moves b by less than UNCERTAIN sqrt(M).
The stars are not moved by b: whether its flux exceeds the noise changes from image to image.
"""

import math

import numpy as np
from startracker_ros.core.centroid.background import background_at, Mesh, slope_at
from startracker_ros.core.centroid.psf import FLUX, profile, SHARE, SIGMA, U, V
from startracker_ros.core.centroid.streak_fit import LENGTH, share_at
from startracker_ros.core.compiled import compiled, reordered
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

MOST_STARS, LEAST_STARS = 8, 3
FAINTEST, CONFIRMED_SIGMAS = 1 / 3, 3.0
"""
What the noise of faint stars has made, brighter ones do not show: those of so much of the flux of
the third, and so many standard deviations.
"""
REACH_PX = 10  # beyond the ends of a streak
MOST_REACH_PX = 24
MARGIN = 2  # for what is between pixels
SMOOTHING_PX = 0.8
SIGNIFICANT = 7.0  # standard deviations of the noise: some images in a thousand have it by chance
EXCESS_SIGMAS = 4.0  # the same of a pixel, if it also exceeds
EXCESS_SHARE = 0.15  # of the most significant one
QUANTILE = 0.65  # of the stars
EXCHANGED = 0.15  # correlation of the odd parts of two stars below which their parts are exchanged
SHARED_SHARE, SHARED_PART = 0.7, 0.3  # of the bright stars that have so much of it
UNCERTAIN = 0.15
MODEL_ERROR = 0.015  # of the flux of a star, by which a Gaussian may be wrong


@compiled
def pointing_error(image: np.ndarray, mesh: Mesh, full_scale: float, stars: np.ndarray,
                   streaked: bool) -> np.ndarray:
    """
    Return the covariance (2, 2) px^2 of the correlated error of an image, zero without any.

    stars (K, 7) are fitted, brightest first, with the parameters of streak_fit.
    """
    covariance = np.zeros((2, 2))
    longest = 0.0
    if streaked:
        for i in range(len(stars)):
            longest = max(longest, stars[i, LENGTH])
    reach = min(REACH_PX + math.ceil(longest / 2), MOST_REACH_PX)
    chosen = _chosen(image, stars, reach, full_scale)
    if len(chosen) < LEAST_STARS:
        return covariance
    left, smooth, noise = _odd_part(image, mesh, stars[chosen], streaked, reach)
    if not smooth.max() > SIGNIFICANT * noise:
        return covariance
    # In a streak the flux, and with it the error of the model, is spread over its length.
    width2 = stars[chosen[0], SIGMA] ** 2 + SMOOTHING_PX ** 2
    most, place = 0.0, (0, 0)
    for y in range(-reach, reach + 1):
        for x in range(-reach, reach + 1):
            core = MODEL_ERROR * math.exp(-(x * x + y * y) / (2 * width2)) / (2 * np.pi * width2)
            if streaked:
                core = 0.0
            ratio = smooth[y + reach, x + reach] / math.sqrt(noise * noise + core * core)
            smooth[y + reach, x + reach] = ratio
            if ratio > most:
                most, place = ratio, (y + reach, x + reach)
    if not most > SIGNIFICANT:
        return covariance
    bright = stars[chosen]
    bright = bright[bright[:, FLUX] >= FAINTEST * bright[LEAST_STARS - 1, FLUX]]
    _, seen, noise = _odd_part(image, mesh, bright, streaked, reach)
    if not seen[place] > CONFIRMED_SIGMAS * noise:
        return covariance
    shared = 0
    for i in range(len(bright)):
        _, own, _ = _odd_part(image, mesh, bright[i:i + 1], streaked, reach)
        shared += abs(own[place]) > SHARED_PART * seen[place]
    if shared < SHARED_SHARE * len(bright):
        return covariance
    total, b = 1.0, np.zeros(2)
    for y in range(-reach, reach + 1):
        for x in range(-reach, reach + 1):
            flux = left[y + reach, x + reach]
            if smooth[y + reach, x + reach] > max(EXCESS_SIGMAS, EXCESS_SHARE * most) and flux > 0:
                total += flux
                b[0] += flux * x
                b[1] += flux * y
                covariance[0, 0] += flux * x * x
                covariance[0, 1] += flux * x * y
                covariance[1, 1] += flux * y * y
    covariance[1, 0] = covariance[0, 1]
    return UNCERTAIN ** 2 * covariance / total + np.outer(b, b) / total ** 2


@compiled
def _chosen(image: np.ndarray, stars: np.ndarray, reach: int, full_scale: float) -> np.ndarray:
    """Return the indices of the stars used: bright, alone with fainter ones, not saturated."""
    height, width = image.shape
    chosen, count = np.empty(MOST_STARS, np.int64), 0
    for i in range(len(stars)):
        u, v = round(stars[i, U]), round(stars[i, V])
        far = reach + MARGIN
        good = far <= u < width - far and far <= v < height - far
        for j in range(i):
            good = good and (abs(stars[j, U] - u) > reach or abs(stars[j, V] - v) > reach)
        if good and count < MOST_STARS:
            for y in range(v - reach, v + reach + 1):
                for x in range(u - reach, u + reach + 1):
                    good = good and image[y, x] < full_scale
            if good:
                chosen[count] = i
                count += 1
    return chosen[:count]


@compiled
def _odd_part(image: np.ndarray, mesh: Mesh, stars: np.ndarray, streaked: bool, reach: int
              ) -> tuple[np.ndarray, np.ndarray, float]:
    """Return A(d) of stars (K, 7), smoothed as well, and the noise of the latter."""
    size, wide, count = 2 * reach + 1, 2 * (reach + MARGIN) + 1, len(stars)
    kept = count - int(QUANTILE * (count - 1) + 0.5)
    # The largest values so far of each pixel, in ascending order.
    largest = np.full((kept, size * size), -np.inf)
    own, first = np.empty((wide, wide)), np.empty(size * size)
    for i in range(count):
        _own_left(image, mesh, stars[i], streaked, reach + MARGIN, own)
        left = _about_centre(own, stars[i, U], stars[i, V], size).ravel()
        odd = left - left[::-1]
        if i == 0:
            first[:] = odd
        sign = -1.0 if _inner(odd, first) < -EXCHANGED * math.sqrt(
            _inner(odd, odd) * _inner(first, first)) else 1.0
        # The smaller of two values goes on to the next place: no branch depends on the data.
        odd *= sign
        for k in range(kept - 1, -1, -1):
            for x in range(len(odd)):
                value, before = odd[x], largest[k, x]
                largest[k, x] = value if value > before else before
                odd[x] = before if value > before else value
    upper = largest[0].copy().reshape((size, size))
    upper -= np.median(upper)
    smooth = _smoothed(upper)
    return upper, smooth, SIGMA_PER_MAD * np.median(np.abs(smooth))


@reordered
def _inner(a: np.ndarray, b: np.ndarray) -> float:
    """Return a^T b."""
    total = 0.0
    for x in range(len(a)):
        total += a[x] * b[x]
    return total


@compiled
def _about_centre(own: np.ndarray, u: float, v: float, size: int) -> np.ndarray:
    """Return the part (size, size) of pixels about a star (n, n), resampled about its centre."""
    wide, across, down = len(own), _cubic(u - math.floor(u)), _cubic(v - math.floor(v))
    # The first one of four pixels that are weighted.
    first_x = math.floor(u) - round(u) + MARGIN - 1
    first_y = math.floor(v) - round(v) + MARGIN - 1
    between, left = np.empty((size, wide)), np.empty((size, size))
    for y in range(size):
        for x in range(wide):
            between[y, x] = (
                down[0] * own[first_y + y, x] + down[1] * own[first_y + y + 1, x]
                + down[2] * own[first_y + y + 2, x] + down[3] * own[first_y + y + 3, x])
    for y in range(size):
        row = between[y, first_x:first_x + size + 3]
        for x in range(size):
            left[y, x] = (across[0] * row[x] + across[1] * row[x + 1]
                          + across[2] * row[x + 2] + across[3] * row[x + 3])
    return left


@compiled
def _own_left(image: np.ndarray, mesh: Mesh, star: np.ndarray, streaked: bool, reach: int,
              left: np.ndarray) -> None:
    """Set left (n, n) to what the fit of a star leaves over its flux, about its pixel."""
    size, first_u, first_v = len(left), round(star[U]) - reach, round(star[V]) - reach
    columns, rows = np.empty((3, size)), np.empty((3, size))
    level, _ = background_at(mesh, round(star[U]), round(star[V]))
    across, down = slope_at(mesh, round(star[U]), round(star[V]), reach)
    per_flux = 1 / star[FLUX]
    profile(star[U], star[SIGMA], first_u, columns)
    profile(star[V], star[SIGMA], first_v, rows)
    for y in range(size):
        seen, sky = image[first_v + y, first_u:first_u + size], level + down * (y - reach)
        for x in range(size):
            left[y, x] = rows[SHARE, y] * columns[SHARE, x]
        if streaked:
            for x in range(size):
                left[y, x] = share_at(star, first_u + x, first_v + y)
        for x in range(size):
            left[y, x] = (seen[x] - sky - across * (x - reach)) * per_flux - left[y, x]


@compiled
def _cubic(part: float) -> tuple[float, float, float, float]:
    """
    Return the weights of pixels -1, 0, 1, 2 for the value at a part 0 .. 1 of a pixel.

    Cubic convolution, Keys, IEEE Trans. Acoust. Speech Signal Process. 29, 1981, equation 15.
    """
    return (((1 - 0.5 * part) * part - 0.5) * part, (1.5 * part - 2.5) * part * part + 1,
            ((2 - 1.5 * part) * part + 0.5) * part, (0.5 * part - 0.5) * part * part)


@compiled
def _smoothed(left: np.ndarray) -> np.ndarray:
    """Return (n, n) after a Gaussian filter; there is nothing beyond the borders."""
    weight = np.exp(-0.5 * (np.arange(-2, 3) / SMOOTHING_PX) ** 2)
    weight /= weight.sum()
    size = len(left)
    half, smooth = np.zeros_like(left), np.zeros_like(left)
    for k in range(5):
        for y in range(max(0, 2 - k), min(size, size + 2 - k)):
            half[y] += weight[k] * left[y + k - 2]
    for y in range(size):
        for k in range(5):
            for x in range(max(0, 2 - k), min(size, size + 2 - k)):
                smooth[y, x] += weight[k] * half[y, x + k - 2]
    return smooth
