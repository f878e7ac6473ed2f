# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gain and model error of the noise, out of the residuals of all stars."""

import numpy as np
from startracker_ros.core.centroid.gaussian_fit import Fit
from startracker_ros.core.centroid.noise import NoiseModel
from startracker_ros.core.centroid.psf import D_CENTRE, FLUX, LEVEL, profile, SHARE, SIGMA, U, V
from startracker_ros.core.centroid.windows import Windows
from startracker_ros.core.compiled import fused, reordered

PRIOR_PIXELS = 10.0  # weight of the initial gain
ITERATIONS = 3
OUTLIER = 16.0  # variances, to which a squared residual is limited
MIN_FREE = 0.1  # share of a pixel's noise that its residual shows at least


@reordered
def refine_noise_model(noise: NoiseModel, fit: Fit, windows: Windows,
                       chosen: np.ndarray) -> NoiseModel:
    """
    Fit gain and model error to the residuals of chosen stars (K,), by iterated least squares.

    The squares of the residuals r, divided by 1 - h for the leverage h of their pixel, have the
    mean background + gain flux + (model_error flux)^2. The initial gain counts as
    PRIOR_PIXELS pixels, so that one or two faint stars change nothing.
    """
    square, flux, background = _pixels(fit, windows, chosen)
    gain, model_error, prior = noise.gain_dn, noise.model_error, noise.gain_dn
    for _ in range(ITERATIONS):
        # Normal equations [a b; b c] [gain, model_error^2] = [p q].
        a, b, c = PRIOR_PIXELS / prior ** 2, 0.0, 0.0
        p, q = PRIOR_PIXELS / prior, 0.0
        for k in range(len(square)):
            variance = background[k] + flux[k] * (gain + model_error ** 2 * flux[k])
            excess = min(square[k], OUTLIER * variance) - background[k]
            d_gain = flux[k] / variance
            d_error, excess = flux[k] * d_gain, excess / variance
            a, b, c = a + d_gain * d_gain, b + d_gain * d_error, c + d_error * d_error
            p, q = p + d_gain * excess, q + d_error * excess
        gain, model_error = _solve(a, b, c, p, q)
    return NoiseModel(gain, model_error)


@reordered
def _pixels(fit: Fit, windows: Windows, chosen: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return r^2 / (1 - h), flux and background variance of the used pixels of chosen stars."""
    _, count, filled = windows.data.shape
    columns, rows = np.empty((3, filled), np.float32), np.empty((3, count), np.float32)
    h, pixels = np.empty((count, filled), np.float32), 0
    size = np.count_nonzero(chosen) * count * filled
    square, flux = np.empty(size, np.float32), np.empty(size, np.float32)
    background = np.empty(size, np.float32)
    for i in range(len(chosen)):
        if chosen[i]:
            _leverage(fit, windows, i, columns, rows, h)
            for y in range(count):
                for x in range(filled):
                    if windows.used[i, y, x]:
                        square[pixels] = ((fit.own[i, y, x] - fit.model[i, y, x]) ** 2
                                          / max(1 - h[y, x], np.float32(MIN_FREE)))
                        flux[pixels] = fit.model[i, y, x]
                        background[pixels] = windows.variance[i]
                        pixels += 1
    return square[:pixels], flux[:pixels], background[:pixels]


@fused
def _leverage(fit: Fit, windows: Windows, i: int, columns: np.ndarray, rows: np.ndarray,
              h: np.ndarray) -> None:
    """
    Fill h (n, m) = w J C J^T: the share of each pixel's noise that the fit of star i absorbs.

    J = (F d a_u, F d_v a, d a, 1) and C the covariance, as in normal_equations.py. columns
    (3, m) and rows (3, n) are work arrays.
    """
    star, c = fit.parameters[i], fit.covariance[i]
    profile(star[U], star[SIGMA], windows.corner[i, 0], columns)
    profile(star[V], star[SIGMA], windows.corner[i, 1], rows)
    for y in range(h.shape[0]):
        # J C J^T is a quadratic form in a_u, a and 1, with coefficients of the row.
        d = float(rows[SHARE, y])
        fd, fdv = star[FLUX] * rows[SHARE, y], star[FLUX] * rows[D_CENTRE, y]
        c_uu = np.float32(fd * fd * c[U, U])
        c_ua = np.float32(2 * fd * (fdv * c[U, V] + d * c[U, FLUX]))
        c_aa = np.float32(fdv * fdv * c[V, V] + 2 * fdv * d * c[V, FLUX] + d * d * c[FLUX, FLUX])
        c_u1, c_11 = np.float32(2 * fd * c[U, LEVEL]), np.float32(c[LEVEL, LEVEL])
        c_a1 = np.float32(2 * (fdv * c[V, LEVEL] + d * c[FLUX, LEVEL]))
        for x in range(h.shape[1]):
            a, a_u = columns[SHARE, x], columns[D_CENTRE, x]
            total = a_u * (c_uu * a_u + c_ua * a + c_u1) + a * (c_aa * a + c_a1) + c_11
            h[y, x] = total * fit.weight[i, y, x]


@fused
def _solve(a: float, b: float, c: float, p: float, q: float) -> tuple[float, float]:
    """Return x and sqrt(y) that solve [a b; b c] [x y] = [p q] best with x, y >= 0."""
    determinant = a * c - b * b
    if determinant > 0:
        x, y = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        if x >= 0 and y >= 0:
            return x, np.sqrt(y)
    x, y = max(p, 0.0) / a, max(q, 0.0) / c if c > 0 else 0.0
    return (x, 0.0) if a * x ** 2 >= c * y ** 2 else (0.0, np.sqrt(y))
