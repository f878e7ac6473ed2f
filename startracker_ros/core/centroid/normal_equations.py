# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Normal equations N x = g of one star's window: N = J^T W J and g = J^T W r.

J holds the derivatives of the model F a(x) d(y) + B of a pixel, each a product of a factor of
its column x and one of its row y:

    J_u = F a_u d,  J_v = F a d_v,  J_F = a d,  J_B = 1,  J_sigma = F (a_sigma d + a d_sigma)

W is the diagonal of the weights w, r the residuals. The sums over y, such as W_DD = sum_y w d^2,
are taken first, for several columns at a time. What is left are sums over x, such as
N_uu = F^2 sum_x a_u^2 W_DD.
"""

import numpy as np
from startracker_ros.core.centroid.psf import D_CENTRE, D_SIGMA, FLUX, LEVEL, SHARE, SIGMA, U, V
from startracker_ros.core.compiled import compiled, fused

MAX_COLUMNS = 64  # of a window
RIDGE = 1e-12  # keeps N regular without usable pixels or without flux
# Where the sums over y begin: of w and of w r, times d, v = d_v and s = d_sigma. The array is
# flat, with constant steps, for the compiler to see that no sum overlaps another.
# W_ROW and R_ROW hold the weights and residuals of the row that is added.
(W, W_D, W_V, W_DD, W_DV, W_VV, R, R_D, R_V, CHI2, W_ROW, R_ROW, W_S, W_DS, W_VS, W_SS, R_S,
 _END) = range(0, 18 * MAX_COLUMNS, MAX_COLUMNS)


@compiled
def column_sums(parameters: int) -> np.ndarray:
    """Return a work array for the sums over y of a fit of 4 parameters, or of 5 with sigma."""
    return np.empty(W_S if parameters <= SIGMA else _END, np.float32)


@fused
def add_row(d: np.float32, v: np.float32, count: int, sums: np.ndarray) -> None:
    """Add the row of weights W_ROW and residuals R_ROW, `count` pixels, to the sums over y."""
    dd, dv, vv = d * d, d * v, v * v
    for x in range(count):
        w, residual = sums[W_ROW + x], sums[R_ROW + x]
        r = w * residual
        sums[W + x] += w
        sums[W_D + x] += w * d
        sums[W_V + x] += w * v
        sums[W_DD + x] += w * dd
        sums[W_DV + x] += w * dv
        sums[W_VV + x] += w * vv
        sums[R + x] += r
        sums[R_D + x] += r * d
        sums[R_V + x] += r * v
        sums[CHI2 + x] += r * residual


@fused
def add_sigma_row(d: np.float32, v: np.float32, s: np.float32, count: int, sums: np.ndarray
                  ) -> None:
    """Add the row to those sums over y that only a free sigma needs."""
    ds, vs, ss = d * s, v * s, s * s
    for x in range(count):
        w = sums[W_ROW + x]
        sums[W_S + x] += w * s
        sums[W_DS + x] += w * ds
        sums[W_VS + x] += w * vs
        sums[W_SS + x] += w * ss
        sums[R_S + x] += w * sums[R_ROW + x] * s


@fused
def normal_equations(columns: np.ndarray, sums: np.ndarray, flux: float, n: np.ndarray,
                     g: np.ndarray) -> np.floating:
    """
    Fill n (p, p) and g (p,) for p = 4 or 5 parameters; return chi-square, sum w r^2.

    columns (3, m) is the profile of the star along u; sums are the sums over y.
    """
    chi2 = _set_gradient(columns, sums, flux, g)
    _set_information(columns, sums, flux, n)
    if len(g) > SIGMA:
        _set_sigma(columns, sums, flux, n, g)
    for p in range(len(g)):
        n[p, p] = n[p, p] * (1 + RIDGE) + RIDGE
        for q in range(p):
            n[p, q] = n[q, p]
    return chi2


@fused
def _set_gradient(columns: np.ndarray, sums: np.ndarray, flux: float, g: np.ndarray
                  ) -> np.floating:
    """Fill g = J^T W r without sigma, such as g_u = F sum_x a_u R_D; return chi-square."""
    g_u = g_v = g_f = g_b = chi2 = np.float32(0)
    for x in range(columns.shape[1]):
        a, a_u = columns[SHARE, x], columns[D_CENTRE, x]
        g_u += a_u * sums[R_D + x]
        g_v += a * sums[R_V + x]
        g_f += a * sums[R_D + x]
        g_b += sums[R + x]
        chi2 += sums[CHI2 + x]
    g[U], g[V], g[FLUX], g[LEVEL] = flux * g_u, flux * g_v, g_f, g_b
    return chi2


@fused
def _set_information(columns: np.ndarray, sums: np.ndarray, flux: float, n: np.ndarray) -> None:
    """Fill the upper triangle of N = J^T W J without sigma, such as N_uF = F sum_x a_u a W_DD."""
    uu = uv = uf = ub = vv = vf = vb = ff = fb = bb = np.float32(0)
    for x in range(columns.shape[1]):
        a, a_u = columns[SHARE, x], columns[D_CENTRE, x]
        aa, a_ua = a * a, a_u * a
        uu += a_u * a_u * sums[W_DD + x]
        uv += a_ua * sums[W_DV + x]
        uf += a_ua * sums[W_DD + x]
        ub += a_u * sums[W_D + x]
        vv += aa * sums[W_VV + x]
        vf += aa * sums[W_DV + x]
        vb += a * sums[W_V + x]
        ff += aa * sums[W_DD + x]
        fb += a * sums[W_D + x]
        bb += sums[W + x]
    square = flux * flux
    n[U, U], n[U, V], n[U, FLUX], n[U, LEVEL] = square * uu, square * uv, flux * uf, flux * ub
    n[V, V], n[V, FLUX], n[V, LEVEL] = square * vv, flux * vf, flux * vb
    n[FLUX, FLUX], n[FLUX, LEVEL], n[LEVEL, LEVEL] = ff, fb, bb


@fused
def _set_sigma(columns: np.ndarray, sums: np.ndarray, flux: float, n: np.ndarray, g: np.ndarray
               ) -> None:
    """Fill what sigma adds to g and to the upper triangle of N; J_sigma has two products."""
    us = vs = fs = bs = ss = g_s = np.float32(0)
    for x in range(columns.shape[1]):
        a, a_u, a_s = columns[SHARE, x], columns[D_CENTRE, x], columns[D_SIGMA, x]
        us += a_u * (a_s * sums[W_DD + x] + a * sums[W_DS + x])
        vs += a * (a_s * sums[W_DV + x] + a * sums[W_VS + x])
        fs += a * (a_s * sums[W_DD + x] + a * sums[W_DS + x])
        bs += a_s * sums[W_D + x] + a * sums[W_S + x]
        ss += (a_s * a_s * sums[W_DD + x] + a * (a_s * sums[W_DS + x] + a_s * sums[W_DS + x]
                                                 + a * sums[W_SS + x]))
        g_s += a_s * sums[R_D + x] + a * sums[R_S + x]
    square = flux * flux
    g[SIGMA] = flux * g_s
    n[U, SIGMA], n[V, SIGMA], n[SIGMA, SIGMA] = square * us, square * vs, square * ss
    n[FLUX, SIGMA], n[LEVEL, SIGMA] = flux * fs, flux * bs


@compiled
def invert(matrix: np.ndarray) -> None:
    """Invert a positive definite matrix (p, p) in place, by Gauss-Jordan elimination."""
    count = len(matrix)
    for k in range(count):
        scale = 1 / matrix[k, k]
        matrix[k, k] = 1
        for q in range(count):
            matrix[k, q] *= scale
        for p in range(count):
            if p != k:
                factor = matrix[p, k]
                matrix[p, k] = 0
                for q in range(count):
                    matrix[p, q] -= factor * matrix[k, q]
