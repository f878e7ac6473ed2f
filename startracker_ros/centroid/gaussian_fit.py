"""Gaussian point spread function, integrated over the pixels, fitted to all stars at once."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.centroid.noise import NoiseModel
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
MOST_COLUMNS = 64  # of a window
(W, W_D, W_V, W_DD, W_DV, W_VV, R, R_D, R_V, CHI2, WEIGHT, PULL, W_S, W_SD, W_SV, W_SS, R_S,
 SUMS) = range(0, 18 * MOST_COLUMNS, MOST_COLUMNS)
"""Where the sums of _weigh() begin: of weights W and weighted residuals R, times row factors."""
S_SUMS = W_S  # from here on for a free sigma
RIDGE = 1e-12  # a star without usable pixels, or without light, must not divide by zero
_NODES = np.arange(-TABLE_END * TABLE_STEPS, TABLE_END * TABLE_STEPS + 1) / TABLE_STEPS
_BELOW = np.array([0.5 * math.erfc(-node * math.sqrt(0.5)) for node in _NODES])
_DENSITY = np.exp(-0.5 * _NODES ** 2) / np.sqrt(2 * np.pi)


class Fit(NamedTuple):
    """
    Fitted stars; window arrays are (K, n, m) float32, with rows filled up as in Windows.

    parameters (K, 5): u, v px, flux DN, level DN above the mesh background, sigma px;
    covariance (K, p, p) of the first p = 4 or 5 of them; light: model of the star itself;
    own: data without neighbours and level; weight: 1 / variance of the pixels, 0 if not used;
    freedom (K,): pixels less parameters; chi2 (K,).
    """

    parameters: np.ndarray
    covariance: np.ndarray
    light: np.ndarray
    own: np.ndarray
    weight: np.ndarray
    freedom: np.ndarray
    chi2: np.ndarray


def fit_stars(windows: Windows, start: np.ndarray, noise: NoiseModel, *,
              free_sigma: bool = False, iterations: int = 12) -> Fit:
    """
    Weighted least squares by Gauss-Newton from start (K, 5); sigma is free on request.

    The weights follow the model, not the data, which would bias the flux low: with noise that
    follows the model too this is maximum likelihood. Neighbours are fitted in turns: each
    star against the data less the others' last model.
    """
    return Fit(*_fit(windows, start, noise, 5 if free_sigma else 4, iterations))


@fused
def profile(centre: float, sigma: float, first: int, share: np.ndarray) -> None:
    """
    Fill share (3, n) for n pixels from `first` on, along one axis.

    Its rows: the share of light in a pixel, its derivative by centre and that by sigma. The
    normal distribution and its density, to 1e-9 and 4e-8, are series around the nearest node of
    a table, which takes a tenth of the time of erf() and exp().
    """
    per_sigma, start = 1 / sigma, (first - 0.5 - centre) / sigma
    edge = edge_density = edge_below = 0.0
    for k in range(share.shape[1] + 1):
        z = min(max(start + k * per_sigma, -TABLE_END), TABLE_END)
        place = np.uintp((z + TABLE_END) * TABLE_STEPS + 0.5)
        node, at_node = place * (1 / TABLE_STEPS) - TABLE_END, _DENSITY[place]
        t, square = z - node, node * node
        below = _BELOW[place] + at_node * t * (1 - t * (node / 2 - t * ((square - 1) / 6)))
        density = at_node * (1 - t * (node - t * ((square - 1) / 2
                                                  - t * (node * (square - 3) / 6))))
        if k:
            share[0, k - 1] = below - edge_below
            share[1, k - 1] = (edge_density - density) * per_sigma
            share[2, k - 1] = (edge * edge_density - z * density) * per_sigma
        edge, edge_density, edge_below = z, density, below


@fused
def _others(windows: Windows, i: int, parameters: np.ndarray, columns: np.ndarray,
            rows: np.ndarray, others: np.ndarray) -> None:
    """Fill others (n, m) with the light of the neighbours in window i."""
    others[:] = 0
    for k in range(windows.first[i], windows.first[i + 1]):
        star = parameters[windows.sources[k]]
        profile(star[U], star[SIGMA], windows.corner[i, 0], columns)
        profile(star[V], star[SIGMA], windows.corner[i, 1], rows)
        for y in range(others.shape[0]):
            light = np.float32(star[FLUX]) * rows[0, y]
            for x in range(others.shape[1]):
                others[y, x] += light * columns[0, x]


@fused
def _weigh(windows: Windows, i: int, star: np.ndarray, noise: NoiseModel, others: np.ndarray,
           columns: np.ndarray, rows: np.ndarray, sums: np.ndarray) -> None:
    """
    Fill sums, SUMS of them in each of m columns, from the rows of window i.

    columns (3, m) and rows (3, n) are the profiles of star (5,). The derivatives of the model
    are products of a factor of the row y and one of the column x, so they are summed down
    the columns first, several columns at a time. sums is flat, with steps of MOST_COLUMNS, for
    the compiler to see that none of them lies within another.
    """
    flux, level = np.float32(star[FLUX]), np.float32(star[LEVEL])
    background, gain = np.float32(windows.variance[i]), np.float32(noise.gain_dn)
    square, none = np.float32(noise.model_error ** 2), np.float32(0)
    sums[:] = 0
    for y in range(others.shape[0]):
        d, dv, ds = rows[0, y], rows[1, y], rows[2, y]
        df, dd, dvd, dvv = flux * d, d * d, d * dv, dv * dv
        for x in range(others.shape[1]):
            light = df * columns[0, x]
            # pixel_variance(), in float32
            total = light + others[y, x]
            total = total if total > none else none
            variance = background + total * (gain + square * total)
            w = np.float32(windows.used[i, y, x]) / variance
            residual = windows.data[i, y, x] - others[y, x] - level - light
            r = w * residual
            sums[W + x] += w
            sums[W_D + x] += w * d
            sums[W_V + x] += w * dv
            sums[W_DD + x] += w * dd
            sums[W_DV + x] += w * dvd
            sums[W_VV + x] += w * dvv
            sums[R + x] += r
            sums[R_D + x] += r * d
            sums[R_V + x] += r * dv
            sums[CHI2 + x] += r * residual
            sums[WEIGHT + x] = w
            sums[PULL + x] = r
        if len(sums) > S_SUMS:
            dds, dvs, dss = d * ds, dv * ds, ds * ds
            for x in range(others.shape[1]):
                w = sums[WEIGHT + x]
                sums[W_S + x] += w * ds
                sums[W_SD + x] += w * dds
                sums[W_SV + x] += w * dvs
                sums[W_SS + x] += w * dss
                sums[R_S + x] += sums[PULL + x] * ds


@fused
def _normal_equations(windows: Windows, i: int, star: np.ndarray, noise: NoiseModel,
                      others: np.ndarray, columns: np.ndarray, rows: np.ndarray, sums: np.ndarray,
                      normal: np.ndarray, slope: np.ndarray) -> np.floating:
    """Fill normal (p, p) and slope (p,) of star (5,) in window i; return its chi2."""
    profile(star[U], star[SIGMA], windows.corner[i, 0], columns)
    profile(star[V], star[SIGMA], windows.corner[i, 1], rows)
    _weigh(windows, i, star, noise, others, columns, rows, sums)
    none = np.float32(0)
    uu = uv = uf = ul = vv = vf = vl = ff = fl = ll = none
    u_slope = v_slope = f_slope = l_slope = chi2 = none
    for x in range(columns.shape[1]):
        a, b = columns[0, x], columns[1, x]
        aa, ab = a * a, a * b
        uu += b * b * sums[W_DD + x]
        uv += ab * sums[W_DV + x]
        uf += ab * sums[W_DD + x]
        ul += b * sums[W_D + x]
        vv += aa * sums[W_VV + x]
        vf += aa * sums[W_DV + x]
        vl += a * sums[W_V + x]
        ff += aa * sums[W_DD + x]
        fl += a * sums[W_D + x]
        ll += sums[W + x]
        u_slope += b * sums[R_D + x]
        v_slope += a * sums[R_V + x]
        f_slope += a * sums[R_D + x]
        l_slope += sums[R + x]
        chi2 += sums[CHI2 + x]
    flux = star[FLUX]
    slope[U], slope[V] = flux * u_slope, flux * v_slope
    slope[FLUX], slope[LEVEL] = f_slope, l_slope
    normal[U, U], normal[U, V], normal[U, FLUX], normal[U, LEVEL] = (
        flux * flux * uu, flux * flux * uv, flux * uf, flux * ul)
    normal[V, V], normal[V, FLUX], normal[V, LEVEL] = flux * flux * vv, flux * vf, flux * vl
    normal[FLUX, FLUX], normal[FLUX, LEVEL], normal[LEVEL, LEVEL] = ff, fl, ll
    if len(slope) > SIGMA:
        us = vs = fs = ls = ss = s_slope = none
        for x in range(columns.shape[1]):
            a, b, c = columns[0, x], columns[1, x], columns[2, x]
            # The derivative by sigma is a sum of two products, that of d c and that of ds a.
            us += b * (c * sums[W_DD + x] + a * sums[W_SD + x])
            vs += a * (c * sums[W_DV + x] + a * sums[W_SV + x])
            fs += a * (c * sums[W_DD + x] + a * sums[W_SD + x])
            ls += c * sums[W_D + x] + a * sums[W_S + x]
            ss += (c * c * sums[W_DD + x] + a * (c * sums[W_SD + x] + c * sums[W_SD + x]
                                                 + a * sums[W_SS + x]))
            s_slope += c * sums[R_D + x] + a * sums[R_S + x]
        slope[SIGMA] = flux * s_slope
        normal[U, SIGMA], normal[V, SIGMA] = flux * flux * us, flux * flux * vs
        normal[FLUX, SIGMA], normal[LEVEL, SIGMA] = flux * fs, flux * ls
        normal[SIGMA, SIGMA] = flux * flux * ss
    for a in range(len(slope)):
        normal[a, a] = normal[a, a] * (1 + RIDGE) + RIDGE
        for b in range(a):
            normal[a, b] = normal[b, a]
    return chi2


@compiled
def _invert(matrix: np.ndarray) -> None:
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
def _advance(star: np.ndarray, inverse: np.ndarray, slope: np.ndarray) -> float:
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
def _fit(windows: Windows, start: np.ndarray, noise: NoiseModel, free: int, iterations: int
         ) -> tuple[np.ndarray, ...]:
    """Return the fields of Fit."""
    stars, count, filled = windows.data.shape
    parameters, covariance = start.copy(), np.empty((stars, free, free))
    light, own = np.empty(windows.data.shape, np.float32), np.empty(windows.data.shape, np.float32)
    weight = np.empty(windows.data.shape, np.float32)
    freedom, chi2 = np.empty(stars, np.int64), np.empty(stars)
    columns, rows = np.empty((3, filled), np.float32), np.empty((3, count), np.float32)
    others, slope = np.zeros((count, filled), np.float32), np.empty(free)
    sums = np.empty(S_SUMS if free <= SIGMA else SUMS, np.float32)
    settled, lone = np.zeros(stars, np.bool_), windows.first[1:] == windows.first[:-1]
    for _ in range(iterations):
        for i in range(stars):
            if settled[i] and lone[i]:
                continue
            if not lone[i]:
                _others(windows, i, parameters, columns, rows, others)
            normal, star = covariance[i], parameters[i]
            _normal_equations(windows, i, star, noise, others, columns, rows, sums, normal, slope)
            _invert(normal)
            settled[i] = _advance(star, normal, slope) < ENOUGH_PX
            if not lone[i]:
                others[:] = 0
        if settled.all():
            break
    for i in range(stars):
        if not lone[i]:
            _others(windows, i, parameters, columns, rows, others)
        inverse, star = covariance[i], parameters[i]
        chi2[i] = _normal_equations(windows, i, star, noise, others, columns, rows, sums,
                                    inverse, slope)
        _invert(inverse)
        freedom[i] = np.count_nonzero(windows.used[i]) - free
        _account(windows, i, star, noise, others, columns, rows, light, own, weight)
        if not lone[i]:
            others[:] = 0
    return parameters, covariance, light, own, weight, freedom, chi2


@fused
def _account(windows: Windows, i: int, star: np.ndarray, noise: NoiseModel, others: np.ndarray,
             columns: np.ndarray, rows: np.ndarray, light: np.ndarray, own: np.ndarray,
             weight: np.ndarray) -> None:
    """Fill light, own and weight of star i, (5,), whose profiles are columns and rows."""
    flux, level = np.float32(star[FLUX]), np.float32(star[LEVEL])
    background, gain = np.float32(windows.variance[i]), np.float32(noise.gain_dn)
    square, none = np.float32(noise.model_error ** 2), np.float32(0)
    for y in range(others.shape[0]):
        df = flux * rows[0, y]
        for x in range(others.shape[1]):
            light[i, y, x] = df * columns[0, x]
        for x in range(others.shape[1]):
            own[i, y, x] = windows.data[i, y, x] - others[y, x] - level
        for x in range(others.shape[1]):
            total = light[i, y, x] + others[y, x]
            total = total if total > none else none
            weight[i, y, x] = (np.float32(windows.used[i, y, x])
                               / (background + total * (gain + square * total)))


@fused
def leverage(fit: Fit, windows: Windows, i: int, columns: np.ndarray, rows: np.ndarray,
             work: np.ndarray) -> None:
    """
    Fill work (n, m) with the share of each pixel's noise that the fit of star i absorbs.

    columns (3, m) and rows (3, n) are for work.
    """
    star, c = fit.parameters[i], fit.covariance[i]
    profile(star[U], star[SIGMA], windows.corner[i, 0], columns)
    profile(star[V], star[SIGMA], windows.corner[i, 1], rows)
    for y in range(work.shape[0]):
        # The derivatives are u b, v a, f a and 1, with a, b of the column.
        u, v, f = star[FLUX] * rows[0, y], star[FLUX] * rows[1, y], float(rows[0, y])
        bb, ab = np.float32(u * u * c[U, U]), np.float32(2 * u * (v * c[U, V] + f * c[U, FLUX]))
        aa = np.float32(v * v * c[V, V] + 2 * v * f * c[V, FLUX] + f * f * c[FLUX, FLUX])
        b_1, one = np.float32(2 * u * c[U, LEVEL]), np.float32(c[LEVEL, LEVEL])
        a_1 = np.float32(2 * (v * c[V, LEVEL] + f * c[FLUX, LEVEL]))
        for x in range(work.shape[1]):
            a, b = columns[0, x], columns[1, x]
            total = b * (bb * b + ab * a + b_1) + a * (aa * a + a_1) + one
            work[y, x] = total * fit.weight[i, y, x]
