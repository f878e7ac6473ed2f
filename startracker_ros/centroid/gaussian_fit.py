"""Gaussian point spread function, integrated over the pixels, fitted to all stars at once."""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from startracker_ros.centroid.noise import NoiseModel, pixel_variance
from startracker_ros.centroid.windows import Windows
from startracker_ros.compiled import compiled, fused

U, V, FLUX, LEVEL, SIGMA = range(5)  # columns of the parameters
MAX_STEP_PX = 0.7
MAX_WIDTH_STEP_PX = 0.3
SIGMA_RANGE_PX = (0.2, 8.0)
LEAST_FLUX_DN = 1e-3
ENOUGH_PX = 3e-4  # a step shorter than this ends the iteration
TABLE_END = 6.0  # standard deviations, beyond which a normal distribution is 0 or 1
TABLE_STEPS = 32  # a standard deviation
RIDGE = 1e-12  # a star without usable pixels, or without light, must not divide by zero
_NODES = np.arange(-TABLE_END * TABLE_STEPS, TABLE_END * TABLE_STEPS + 1) / TABLE_STEPS
_BELOW = ndtr(_NODES)
_SLOPE = np.exp(-0.5 * _NODES ** 2) / (np.sqrt(2 * np.pi) * TABLE_STEPS)  # a step


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


@fused
def profile(centre, sigma, first, share):
    """Fill share (3, n) for n pixels from `first` on, along one axis.

    Its rows: the share of light in a pixel, its derivative by centre and that by sigma.
    """
    per_sigma = 1 / sigma
    z = (first - 0.5 - centre) * per_sigma
    below, density = _normal(z)
    for k in range(share.shape[1]):
        next_z = (first + k + 0.5 - centre) * per_sigma
        next_below, next_density = _normal(next_z)
        share[0, k] = next_below - below
        share[1, k] = (density - next_density) * per_sigma
        share[2, k] = (z * density - next_z * next_density) * per_sigma
        z, density, below = next_z, next_density, next_below


@fused
def _normal(z):
    """Return the standard normal distribution and its density, to 4e-9 and 4e-7.

    A cubic through values and slopes of a table takes a fifth of the time of erf() and exp().
    """
    if not -TABLE_END < z < TABLE_END:
        return 1.0 if z > 0 else 0.0, 0.0
    place = (z + TABLE_END) * TABLE_STEPS
    k = int(place)
    t, start, slope, next_slope = place - k, _BELOW[k], _SLOPE[k], _SLOPE[k + 1]
    rise = _BELOW[k + 1] - start
    square, cube = 3 * rise - 2 * slope - next_slope, slope + next_slope - 2 * rise
    return (start + t * (slope + t * (square + t * cube)),
            TABLE_STEPS * (slope + t * (2 * square + 3 * t * cube)))


@fused
def _others(windows, i, parameters, share, others):
    """Fill others (n, n) with the light of the neighbours in window i."""
    for y in range(others.shape[0]):
        for x in range(others.shape[1]):
            others[y, x] = 0
    for k in range(windows.first[i], windows.first[i + 1]):
        star = parameters[windows.sources[k]]
        profile(star[U], star[SIGMA], windows.corner[i, 0], share[0])
        profile(star[V], star[SIGMA], windows.corner[i, 1], share[1])
        for y in range(others.shape[0]):
            for x in range(others.shape[1]):
                others[y, x] += star[FLUX] * share[1, 0, y] * share[0, 0, x]


@fused
def _normal_equations(windows, i, star, noise, others, share, normal, slope):
    """Fill normal (p, p) and slope (p,) of star (5,) in window i; return its chi2.

    The derivatives are products of a factor of the row y and one of the column x: a, b, c are
    those of the column for flux, u and sigma. So the sums are taken first along a row, then
    down; written out, because sums in registers are several times faster than sums in arrays.
    """
    profile(star[U], star[SIGMA], windows.corner[i, 0], share[0])
    profile(star[V], star[SIGMA], windows.corner[i, 1], share[1])
    flux, level, background = star[FLUX], star[LEVEL], windows.variance[i]
    uu = uv = uf = ul = us = vv = vf = vl = vs = ff = fl = fs = ll = ls = ss = 0.0
    u_slope = v_slope = f_slope = l_slope = s_slope = chi2 = 0.0
    for y in range(others.shape[0]):
        d, dv, ds = share[1, 0, y], flux * share[1, 1, y], flux * share[1, 2, y]
        df = flux * d
        w_0 = w_a = w_b = w_c = w_aa = w_ab = w_ac = w_bb = w_bc = w_cc = 0.0
        r_0 = r_a = r_b = r_c = 0.0
        for x in range(others.shape[1]):
            if not windows.used[i, y, x]:
                continue
            a, b, c = share[0, 0, x], share[0, 1, x], share[0, 2, x]
            light = df * a
            w = 1 / pixel_variance(noise, background, light + others[y, x])
            residual = windows.data[i, y, x] - others[y, x] - level - light
            wa, wb, wc, wr = w * a, w * b, w * c, w * residual
            w_0, w_a, w_b, w_c = w_0 + w, w_a + wa, w_b + wb, w_c + wc
            w_aa, w_ab, w_ac = w_aa + wa * a, w_ab + wa * b, w_ac + wa * c
            w_bb, w_bc, w_cc = w_bb + wb * b, w_bc + wb * c, w_cc + wc * c
            r_0, r_a, r_b, r_c = r_0 + wr, r_a + wr * a, r_b + wr * b, r_c + wr * c
            chi2 += residual * wr
        w_sa, w_sb = df * w_ac + ds * w_aa, df * w_bc + ds * w_ab
        w_s, r_s = df * w_c + ds * w_a, df * r_c + ds * r_a
        w_ss = df * (df * w_cc + 2 * ds * w_ac) + ds * ds * w_aa
        uu, uv, uf = uu + df * df * w_bb, uv + df * dv * w_ab, uf + df * d * w_ab
        ul, us = ul + df * w_b, us + df * w_sb
        vv, vf, vl, vs = vv + dv * dv * w_aa, vf + dv * d * w_aa, vl + dv * w_a, vs + dv * w_sa
        ff, fl, fs = ff + d * d * w_aa, fl + d * w_a, fs + d * w_sa
        ll, ls, ss = ll + w_0, ls + w_s, ss + w_ss
        u_slope, v_slope, f_slope = u_slope + df * r_b, v_slope + dv * r_a, f_slope + d * r_a
        l_slope, s_slope = l_slope + r_0, s_slope + r_s
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


@fused
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


@fused
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
