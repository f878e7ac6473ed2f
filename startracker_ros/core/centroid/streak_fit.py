# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Maximum-likelihood fit of streaks: a Gaussian, moved along a line during the exposure.

With a and b the coordinates of a pixel along and across the streak, from its middle, the flux of
a star of flux F, streak length L and width sigma is

    I = F g(b) h(a),    g(b) = phi(b / s) / s,
    h(a) = (Phi((a + L/2) / s) - Phi((a - L/2) / s)) / L,    s^2 = sigma^2 + 1/12,

phi the normal density and Phi its integral. The 1/12 is the variance of a pixel in any direction:
a streak crosses pixels at all phases, so that it need not be integrated over each. Gauss-Newton
steps as in gaussian_fit.py, with weights that follow the model.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.background import background_at, Mesh, slope_at
from startracker_ros.core.centroid.noise import NoiseModel, pixel_variance
from startracker_ros.core.centroid.normal_equations import invert, RIDGE
from startracker_ros.core.centroid.psf import FLUX, LEVEL, SIGMA, U, V
from startracker_ros.core.compiled import compiled

LENGTH, ANGLE = 5, 6  # columns of the parameters of a streak, after those of a star
LEAST_LENGTH_PX = 0.3
REACH_SIGMAS = 3.5  # of the pixels that are fitted, from the line
REACH_PX = 1.0
SLOPE_PX = 8  # reach over which the slope of the background is taken
CONVERGED_PX = 1e-3
MAX_STEP_PX = 0.7
MAX_STEP_SHARE = 0.15  # of the length
MAX_ANGLE_STEP = 0.1
SIGMA_RANGE_PX = (0.2, 8.0)
MIN_FLUX_DN = 1e-3
OUTLIER_SIGMAS = 5.0  # a brighter pixel was hit by a particle,
OUTLIER_SHARE = 0.5  # if it also exceeds the model by this share of the flux of the streak
_SQRT_HALF = math.sqrt(0.5)
_DENSITY = 1 / math.sqrt(2 * math.pi)


class StreakFit(NamedTuple):
    """
    K fitted streaks.

    parameters (K, 7): u, v px, flux DN, level DN above the background, sigma px, length px, angle
    rad from +u towards +v; covariance (K, p, p) of the first p = 4, or of all; chi2 and dof (K,),
    0 where no pixel can be used.
    """

    parameters: np.ndarray
    covariance: np.ndarray
    chi2: np.ndarray
    dof: np.ndarray


class Pixels(NamedTuple):
    """
    What a fit sees: image (H, W); variance (K,) DN^2 of the background of each star.

    Its level in DN is background (K, 3), (a, b, c) for a + b x + c y at pixel x, y. Pixels from
    full_scale DN on are left out.
    """

    image: np.ndarray
    background: np.ndarray
    variance: np.ndarray
    full_scale: float


def pixels_at(image: np.ndarray, mesh: Mesh, uv: np.ndarray, variance: np.ndarray,
              full_scale: float) -> Pixels:
    """Return the image with the background of the mesh at uv (K, 2)."""
    background = np.empty((len(uv), 3))
    for row, (u, v) in zip(background, np.round(uv).astype(int).tolist()):
        across, down = slope_at(mesh, u, v, SLOPE_PX)
        row[:] = background_at(mesh, u, v)[0] - across * u - down * v, across, down
    return Pixels(image, background, variance, full_scale)


@compiled
def _above(pixels: Pixels, i: int, x: int, y: int) -> float:
    """Return a pixel less the background of star i."""
    a, b, c = pixels.background[i, 0], pixels.background[i, 1], pixels.background[i, 2]
    return pixels.image[y, x] - (a + b * x + c * y)


@compiled
def fit_streaks(pixels: Pixels, start: np.ndarray, noise: NoiseModel, free: int,
                iterations: int) -> StreakFit:
    """Fit streaks from start (K, 7); free is 4, or 7 with width, length and angle."""
    count = len(start)
    star, covariance = start.copy(), np.zeros((count, free, free))
    chi2, dof = np.zeros(count), np.zeros(count, np.int64)
    neighbours = _neighbours(start)
    gradient, row = np.empty(free), np.empty(7)
    converged = np.zeros(count, np.bool_)
    for k in range(iterations + 1):
        for i in range(count):
            if converged[i] and k < iterations:
                continue
            chi2[i], dof[i] = _normal_equations(pixels, star, neighbours[i], i, noise, k > 1,
                                                covariance[i], gradient, row)
            invert(covariance[i])
            if k < iterations:
                converged[i] = _step(star[i], covariance[i], gradient) < CONVERGED_PX
    return StreakFit(star, covariance, chi2, dof)


def streaks_at(uv: np.ndarray, streak_px: np.ndarray, sigma_px: float) -> np.ndarray:
    """Return parameters (K, 7) of streaks streak_px (K, 2) at uv (K, 2), without flux."""
    star = np.zeros((len(uv), 7))
    star[:, [U, V]], star[:, SIGMA] = uv, sigma_px
    star[:, LENGTH] = np.maximum(np.hypot(*streak_px.T), LEAST_LENGTH_PX)
    star[:, ANGLE] = np.arctan2(streak_px[:, 1], streak_px[:, 0])
    return star


@compiled
def _box(star: np.ndarray, reach: float, image: np.ndarray) -> tuple[int, int, int, int]:
    """Return first row, end, first column and end of the pixels within reach of a streak (7,)."""
    half = star[LENGTH] / 2
    across, down = half * abs(math.cos(star[ANGLE])), half * abs(math.sin(star[ANGLE]))
    return (max(0, math.ceil(star[V] - (down + reach))),
            min(image.shape[0], math.floor(star[V] + (down + reach)) + 1),
            max(0, math.ceil(star[U] - (across + reach))),
            min(image.shape[1], math.floor(star[U] + (across + reach)) + 1))


@compiled
def flux_at(pixels: Pixels, star: np.ndarray) -> np.ndarray:
    """Return the fluxes (K,) of streaks star (K, 7) at their positions, level free."""
    flux = np.empty(len(star))
    for i in range(len(star)):
        reach = REACH_SIGMAS * star[i, SIGMA] + REACH_PX
        top, bottom, left, right = _box(star[i], reach, pixels.image)
        n = m = mm = d = md = 0.0
        for y in range(top, bottom):
            for x in range(left, right):
                share, value = share_at(star[i], x, y), _above(pixels, i, x, y)
                n, m, mm, d, md = (n + 1, m + share, mm + share * share, d + value,
                                   md + share * value)
        flux[i] = max((n * md - m * d) / max(n * mm - m * m, 1e-12), MIN_FLUX_DN)
    return flux


@compiled
def photon_gain(pixels: Pixels, fit: StreakFit, noise: NoiseModel) -> float:
    """
    Return the DN of a photo-electron, by the residuals r of all streaks.

    With the variance V of the background and the flux I, the mean of r^2 - V is gain I; by
    least squares the gain is sum(w I (r^2 - V)) / sum(w I^2), w = 1 / (V + gain_0 I)^2.
    """
    above = total = 0.0
    row = np.empty(7)
    for i in range(len(fit.parameters)):
        star = fit.parameters[i]
        c, s = math.cos(star[ANGLE]), math.sin(star[ANGLE])
        width = math.sqrt(star[SIGMA] ** 2 + 1 / 12)
        top, bottom, left, right = _box(star, width, pixels.image)
        for y in range(top, bottom):
            for x in range(left, right):
                dx, dy = x - star[U], y - star[V]
                model = _fill_row(star, dx * c + dy * s, dy * c - dx * s, c, s, width, row)
                variance = pixel_variance(noise, pixels.variance[i], model)
                residual = _above(pixels, i, x, y) - star[LEVEL] - model
                square = min(residual * residual, OUTLIER_SIGMAS ** 2 * variance)
                weight = model / variance ** 2
                if pixels.image[y, x] < pixels.full_scale:
                    above += weight * (square - pixels.variance[i])
                    total += weight * model
    return max(above / total, noise.gain_dn) if total > 0 else noise.gain_dn


@compiled
def _neighbours(star: np.ndarray) -> np.ndarray:
    """Return (K, K) whether the flux of another streak may reach the pixels of each."""
    near = np.zeros((len(star), len(star)), np.bool_)
    for i in range(len(star)):
        for j in range(len(star)):
            reach = (star[i, LENGTH] + star[j, LENGTH]) / 2 + 2 * (
                REACH_SIGMAS * max(star[i, SIGMA], star[j, SIGMA]) + REACH_PX)
            near[i, j] = i != j and (
                (star[i, U] - star[j, U]) ** 2 + (star[i, V] - star[j, V]) ** 2 < reach * reach)
    return near


@compiled
def share_at(star: np.ndarray, x: float, y: float) -> float:
    """Return I / F of a streak (7,) at pixel x, y."""
    c, s = math.cos(star[ANGLE]), math.sin(star[ANGLE])
    dx, dy = x - star[U], y - star[V]
    a, b = dx * c + dy * s, dy * c - dx * s
    width = math.sqrt(star[SIGMA] ** 2 + 1 / 12)
    if abs(b) > 6 * width or abs(a) > star[LENGTH] / 2 + 6 * width:
        return 0.0
    half = star[LENGTH] / 2
    across = _DENSITY / width * math.exp(-0.5 * (b / width) ** 2)
    along = 0.5 * (math.erf((a + half) / width * _SQRT_HALF)
                   - math.erf((a - half) / width * _SQRT_HALF)) / star[LENGTH]
    return across * along


@compiled
def _normal_equations(pixels: Pixels, stars: np.ndarray, neighbour: np.ndarray, i: int,
                      noise: NoiseModel, clip: bool, n: np.ndarray, g: np.ndarray,
                      row: np.ndarray) -> tuple[float, int]:
    """Fill n (p, p) and g (p,) of streak i; return chi-square and degrees of freedom."""
    star, free = stars[i], len(g)
    c, s = math.cos(star[ANGLE]), math.sin(star[ANGLE])
    width = math.sqrt(star[SIGMA] ** 2 + 1 / 12)
    reach, half = REACH_SIGMAS * width + REACH_PX, star[LENGTH] / 2
    top, bottom, left, right = _box(star, reach, pixels.image)
    peak = star[FLUX] * _DENSITY / width / max(star[LENGTH], 2 * width)
    n[:], g[:] = 0.0, 0.0
    chi2, count = 0.0, 0
    for y in range(top, bottom):
        for x in range(left, right):
            dx, dy = x - star[U], y - star[V]
            a, b = dx * c + dy * s, dy * c - dx * s
            if abs(b) > reach or abs(a) > half + reach:
                continue
            if pixels.image[y, x] >= pixels.full_scale:
                continue
            model = _fill_row(star, a, b, c, s, width, row)
            others = 0.0
            for j in range(len(stars)):
                if neighbour[j]:
                    others += stars[j, FLUX] * share_at(stars[j], x, y)
            residual = _above(pixels, i, x, y) - others - star[LEVEL] - model
            variance = pixel_variance(noise, pixels.variance[i], model + others)
            if (clip and residual > OUTLIER_SHARE * peak
                    and residual * residual > OUTLIER_SIGMAS ** 2 * variance):
                continue
            for p in range(free):
                g[p] += row[p] * residual / variance
                for q in range(p, free):
                    n[p, q] += row[p] * row[q] / variance
            chi2 += residual * residual / variance
            count += 1
    for p in range(free):
        n[p, p] = n[p, p] * (1 + RIDGE) + RIDGE
        for q in range(p):
            n[p, q] = n[q, p]
    return chi2, max(count - free, 0)


@compiled
def _fill_row(star: np.ndarray, a: float, b: float, c: float, s: float, width: float,
              row: np.ndarray) -> float:
    """Fill row (7,) with the derivatives of the flux I at (a, b); return I."""
    flux, length = star[FLUX], star[LENGTH]
    z1, z2 = (a + length / 2) / width, (a - length / 2) / width
    phi1, phi2 = _DENSITY * math.exp(-0.5 * z1 * z1), _DENSITY * math.exp(-0.5 * z2 * z2)
    h = 0.5 * (math.erf(z1 * _SQRT_HALF) - math.erf(z2 * _SQRT_HALF)) / length
    g = _DENSITY / width * math.exp(-0.5 * (b / width) ** 2)
    h_a, g_b = (phi1 - phi2) / (width * length), -b / (width * width) * g
    row[U] = flux * (s * g_b * h - c * h_a * g)
    row[V] = flux * (-c * g_b * h - s * h_a * g)
    row[FLUX], row[LEVEL] = g * h, 1.0
    row[LENGTH] = flux * g * ((phi1 + phi2) / (2 * width) - h) / length
    row[ANGLE] = flux * (h_a * b * g - g_b * a * h)
    row[SIGMA] = flux * star[SIGMA] / width * (
        h * g * (b * b / (width * width) - 1) / width
        - g * (z1 * phi1 - z2 * phi2) / (width * length))
    return flux * g * h


@compiled
def _step(star: np.ndarray, covariance: np.ndarray, gradient: np.ndarray) -> float:
    """Move a streak (7,) by the limited step N^-1 g; return the length of the step in px."""
    most = max(MAX_STEP_PX, MAX_STEP_SHARE * star[LENGTH])
    longest = 0.0
    for p in range(len(gradient)):
        step = 0.0
        for q in range(len(gradient)):
            step += covariance[p, q] * gradient[q]
        if p == ANGLE:
            step = min(max(step, -MAX_ANGLE_STEP), MAX_ANGLE_STEP)
        elif p in (U, V, LENGTH, SIGMA):
            step = min(max(step, -most), most)
            longest = max(longest, abs(step))
        star[p] += step
    star[FLUX] = max(star[FLUX], MIN_FLUX_DN)
    star[SIGMA] = min(max(star[SIGMA], SIGMA_RANGE_PX[0]), SIGMA_RANGE_PX[1])
    star[LENGTH] = max(star[LENGTH], LEAST_LENGTH_PX)
    return longest
