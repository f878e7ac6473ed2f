"""Gaussian point spread function, integrated over the pixels, fitted to all stars at once."""

import math
from typing import NamedTuple

import numpy as np

from startracker_ros.centroid.noise import NoiseModel, pixel_variance
from startracker_ros.centroid.windows import Windows
from startracker_ros.compiled import compiled

U, V, FLUX, LEVEL, SIGMA = range(5)  # columns of the parameters
MAX_STEP_PX = 0.7
MAX_WIDTH_STEP_PX = 0.3
SIGMA_RANGE_PX = (0.2, 8.0)
LEAST_FLUX_DN = 1e-3
ENOUGH_PX = 3e-4  # a step shorter than this ends the iteration
RIDGE = 1e-12  # a star without usable pixels, or without light, must not divide by zero


class Fit(NamedTuple):
    """Fitted stars; window arrays are (K, n, n).

    parameters (K, 5): u, v px, flux DN, level DN above the mesh background, sigma px;
    covariance (K, p, p) of the first p = 4 or 5 of them; light: model of the star itself;
    own: data without neighbours and level; variance: noise of the pixels, DN^2;
    freedom (K,): pixels less parameters; chi2 (K,).
    """

    parameters: np.ndarray
    covariance: np.ndarray
    light: np.ndarray
    own: np.ndarray
    variance: np.ndarray
    freedom: np.ndarray
    chi2: np.ndarray


def fit_stars(windows: Windows, start: np.ndarray, noise: NoiseModel, *,
              free_sigma: bool = False, iterations: int = 12) -> Fit:
    """Weighted least squares by Gauss-Newton from start (K, 5); sigma is free on request.

    The weights follow the model, not the data, which would bias the flux low: with noise that
    follows the model too this is maximum likelihood. Neighbours are fitted in turns: each
    star against the data less the others' last model.
    """
    return Fit(*_fit(windows, start, noise, 5 if free_sigma else 4, iterations))


@compiled
def profile(centre, sigma, first, share):
    """Fill share (3, n) for n pixels from `first` on, along one axis.

    Its rows: the share of light in a pixel, its derivative by centre and that by sigma.
    """
    z = (first - 0.5 - centre) / sigma
    density, below = _density(z, sigma), math.erf(z * math.sqrt(0.5))
    for k in range(share.shape[1]):
        next_z = (first + k + 0.5 - centre) / sigma
        next_density, next_below = _density(next_z, sigma), math.erf(next_z * math.sqrt(0.5))
        share[0, k] = 0.5 * (next_below - below)
        share[1, k] = density - next_density
        share[2, k] = z * density - next_z * next_density
        z, density, below = next_z, next_density, next_below


@compiled
def _density(z, sigma):
    return math.exp(-0.5 * z * z) / (math.sqrt(2 * math.pi) * sigma)


@compiled
def _others(windows, i, parameters, share, others):
    """Fill others (n, n) with the light of the neighbours in window i."""
    others[:] = 0
    for k in range(windows.first[i], windows.first[i + 1]):
        star = parameters[windows.sources[k]]
        profile(star[U], star[SIGMA], windows.corner[i, 0], share[0])
        profile(star[V], star[SIGMA], windows.corner[i, 1], share[1])
        for y in range(others.shape[0]):
            for x in range(others.shape[1]):
                others[y, x] += star[FLUX] * share[1, 0, y] * share[0, 0, x]


@compiled
def _normal_equations(windows, i, star, noise, others, share, normal, slope):
    """Fill normal (p, p) and slope (p,) of star (5,) in window i; return its chi2.

    Written out, because sums in registers are several times faster than sums in arrays.
    """
    profile(star[U], star[SIGMA], windows.corner[i, 0], share[0])
    profile(star[V], star[SIGMA], windows.corner[i, 1], share[1])
    across, down = share[0], share[1]
    flux, level, background = star[FLUX], star[LEVEL], windows.variance[i]
    uu = uv = uf = ul = us = vv = vf = vl = vs = ff = fl = fs = ll = ls = ss = 0.0
    u_slope = v_slope = f_slope = l_slope = s_slope = chi2 = 0.0
    for y in range(others.shape[0]):
        scaled, scaled_v, scaled_s = flux * down[0, y], flux * down[1, y], flux * down[2, y]
        for x in range(others.shape[1]):
            if not windows.used[i, y, x]:
                continue
            light = scaled * across[0, x]
            w = 1 / pixel_variance(noise, background, light + others[y, x])
            residual = windows.data[i, y, x] - others[y, x] - level - light
            u, v, f = scaled * across[1, x], scaled_v * across[0, x], down[0, y] * across[0, x]
            s = scaled * across[2, x] + scaled_s * across[0, x]
            wu, wv, wf, ws, wr = w * u, w * v, w * f, w * s, w * residual
            uu, uv, uf, ul, us = uu + wu * u, uv + wu * v, uf + wu * f, ul + wu, us + wu * s
            vv, vf, vl, vs = vv + wv * v, vf + wv * f, vl + wv, vs + wv * s
            ff, fl, fs = ff + wf * f, fl + wf, fs + wf * s
            ll, ls, ss = ll + w, ls + ws, ss + ws * s
            u_slope, v_slope, f_slope = u_slope + u * wr, v_slope + v * wr, f_slope + f * wr
            l_slope, s_slope, chi2 = l_slope + wr, s_slope + s * wr, chi2 + residual * wr
    slope[U], slope[V], slope[FLUX], slope[LEVEL] = u_slope, v_slope, f_slope, l_slope
    normal[U, U], normal[U, V], normal[U, FLUX], normal[U, LEVEL] = uu, uv, uf, ul
    normal[V, V], normal[V, FLUX], normal[V, LEVEL] = vv, vf, vl
    normal[FLUX, FLUX], normal[FLUX, LEVEL], normal[LEVEL, LEVEL] = ff, fl, ll
    if len(slope) > SIGMA:
        slope[SIGMA] = s_slope
        normal[U, SIGMA], normal[V, SIGMA], normal[FLUX, SIGMA] = us, vs, fs
        normal[LEVEL, SIGMA], normal[SIGMA, SIGMA] = ls, ss
    for a in range(len(slope)):
        normal[a, a] = normal[a, a] * (1 + RIDGE) + RIDGE
        for b in range(a):
            normal[a, b] = normal[b, a]
    return chi2


@compiled
def _invert(matrix):
    """Invert a positive definite matrix (p, p) in place, by Gauss-Jordan."""
    count = len(matrix)
    for k in range(count):
        scale = 1 / matrix[k, k]
        matrix[k, k] = 1
        for b in range(count):
            matrix[k, b] *= scale
        for a in range(count):
            if a != k:
                factor = matrix[a, k]
                matrix[a, k] = 0
                for b in range(count):
                    matrix[a, b] -= factor * matrix[k, b]


@compiled
def _advance(star, inverse, slope):
    """Move star (5,) by one limited step; return its length in px."""
    length = 0.0
    for a in range(len(slope)):
        step = 0.0
        for b in range(len(slope)):
            step += inverse[a, b] * slope[b]
        if a in (U, V):
            step = min(max(step, -MAX_STEP_PX), MAX_STEP_PX)
        elif a == SIGMA:
            step = min(max(step, -MAX_WIDTH_STEP_PX), MAX_WIDTH_STEP_PX)
        star[a] += step
        if a in (U, V, SIGMA):
            length = max(length, abs(step))
    star[FLUX] = max(star[FLUX], LEAST_FLUX_DN)
    star[SIGMA] = min(max(star[SIGMA], SIGMA_RANGE_PX[0]), SIGMA_RANGE_PX[1])
    return length


@compiled
def _fit(windows, start, noise, free, iterations):
    """Return the fields of Fit."""
    stars, count = windows.data.shape[:2]
    parameters = start.copy()
    covariance = np.empty((stars, free, free))
    light, own = np.empty(windows.data.shape), np.empty(windows.data.shape)
    variance = np.empty(windows.data.shape)
    freedom, chi2 = np.empty(stars, np.int64), np.empty(stars)
    others, share, slope = np.zeros((count, count)), np.empty((2, 3, count)), np.empty(free)
    settled = np.zeros(stars, np.bool_)
    for _ in range(iterations):
        for i in range(stars):
            if settled[i] and windows.first[i] == windows.first[i + 1]:
                continue
            _others(windows, i, parameters, share, others)
            normal, star = covariance[i], parameters[i]
            _normal_equations(windows, i, star, noise, others, share, normal, slope)
            _invert(normal)
            settled[i] = _advance(star, normal, slope) < ENOUGH_PX
        if settled.all():
            break
    for i in range(stars):
        _others(windows, i, parameters, share, others)
        inverse, star = covariance[i], parameters[i]
        chi2[i] = _normal_equations(windows, i, star, noise, others, share, inverse, slope)
        _invert(inverse)
        freedom[i] = np.count_nonzero(windows.used[i]) - free
        for y in range(count):
            for x in range(count):
                light[i, y, x] = star[FLUX] * share[1, 0, y] * share[0, 0, x]
                own[i, y, x] = windows.data[i, y, x] - others[y, x] - star[LEVEL]
                variance[i, y, x] = pixel_variance(noise, windows.variance[i],
                                                   light[i, y, x] + others[y, x])
    return parameters, covariance, light, own, variance, freedom, chi2


@compiled
def leverage(fit, windows, i, work):
    """Fill work (n, n) with the share of each pixel's noise that the fit of star i absorbs."""
    count = len(work)
    share, jacobian = np.empty((2, 3, count)), np.ones(SIGMA)
    star, covariance = fit.parameters[i], fit.covariance[i]
    profile(star[U], star[SIGMA], windows.corner[i, 0], share[0])
    profile(star[V], star[SIGMA], windows.corner[i, 1], share[1])
    for y in range(count):
        for x in range(count):
            jacobian[U] = star[FLUX] * share[1, 0, y] * share[0, 1, x]
            jacobian[V] = star[FLUX] * share[1, 1, y] * share[0, 0, x]
            jacobian[FLUX] = share[1, 0, y] * share[0, 0, x]
            total = 0.0
            for a in range(SIGMA):
                for b in range(SIGMA):
                    total += jacobian[a] * covariance[a, b] * jacobian[b]
            work[y, x] = total / fit.variance[i, y, x]
