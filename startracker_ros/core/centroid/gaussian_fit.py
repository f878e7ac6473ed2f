# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Weighted least squares fit of pixel-integrated Gaussians to all stars of an image.

The model of the pixels in a star's window is F a(x) d(y) + B + neighbours (psf.py), F the flux
and B the level above the mesh background. Gauss-Newton steps x = N^-1 g solve the normal
equations (normal_equations.py) until chi-square, sum w r^2, is least. The covariance is the
inverse of the information N.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.noise import NoiseModel
from startracker_ros.core.centroid.normal_equations import (
    add_row, add_sigma_row, column_sums, invert, normal_equations, R_ROW, W_ROW)
from startracker_ros.core.centroid.psf import (
    D_CENTRE, D_SIGMA, FLUX, LEVEL, profile, SHARE, SIGMA, U, V)
from startracker_ros.core.centroid.windows import Windows
from startracker_ros.core.compiled import compiled, fused

MAX_STEP_PX = 0.7
MAX_SIGMA_STEP_PX = 0.3
SIGMA_RANGE_PX = (0.2, 8.0)
MIN_FLUX_DN = 1e-3
ITERATIONS = 12
CONVERGED_PX = 3e-4  # a shorter step ends the iteration


class Fit(NamedTuple):
    """
    Fitted stars; window arrays are (K, n, m) float32, with rows filled up as in Windows.

    parameters (K, 5): u, v px, flux DN, level DN above the mesh background, sigma px;
    covariance (K, p, p) of the first p = 4 or 5 of them; model: F a d, that of the star
    itself; own: data without neighbours and level, so that the residual is own - model;
    weight: 1 / variance of the pixels, 0 if not used; dof (K,): degrees of freedom, pixels less
    parameters; chi2 (K,).
    """

    parameters: np.ndarray
    covariance: np.ndarray
    model: np.ndarray
    own: np.ndarray
    weight: np.ndarray
    dof: np.ndarray
    chi2: np.ndarray


class _Work(NamedTuple):
    """
    Work arrays of a fit: profiles columns (3, m) and rows (3, n), flux of neighbours (n, m).

    sums is of column_sums(); gradient (p,) is J^T W r.
    """

    columns: np.ndarray
    rows: np.ndarray
    neighbours: np.ndarray
    sums: np.ndarray
    gradient: np.ndarray


@fused
def fit_stars(windows: Windows, start: np.ndarray, noise: NoiseModel, free: int, iterations: int
              ) -> Fit:
    """
    Fit all stars by Gauss-Newton from start (K, 5): 4 free parameters, or 5 with sigma.

    The weights follow the model, not the data, which would bias the flux low: with noise that
    follows the model too this is maximum likelihood. Neighbours are fitted in turns: each
    star to the data less the others' last model. In the end each star is evaluated once more at
    its last parameters.
    """
    stars, fit, work = len(start), _empty_fit(windows, start, free), _empty_work(windows, free)
    converged, lone = np.zeros(stars, np.bool_), windows.first[1:] == windows.first[:-1]
    for k in range(iterations + 1):
        last = k == iterations or converged.all()
        for i in range(stars):
            if converged[i] and lone[i] and not last:
                continue
            star, covariance = fit.parameters[i], fit.covariance[i]
            if lone[i]:
                work.neighbours[:] = 0
            else:
                _set_neighbours(fit.parameters, windows, i, work)
            profile(star[U], star[SIGMA], windows.corner[i, 0], work.columns)
            profile(star[V], star[SIGMA], windows.corner[i, 1], work.rows)
            _set_sums(windows, i, star, noise, work)
            fit.chi2[i] = normal_equations(work.columns, work.sums, star[FLUX], covariance,
                                           work.gradient)
            invert(covariance)
            if last:
                _set_model(fit, windows, i, noise, work)
                fit.dof[i] = np.count_nonzero(windows.used[i]) - free
            else:
                converged[i] = _step(star, covariance, work.gradient) < CONVERGED_PX
        if last:
            break
    return fit


@compiled
def _empty_fit(windows: Windows, start: np.ndarray, free: int) -> Fit:
    stars, shape = len(start), windows.data.shape
    return Fit(start.copy(), np.empty((stars, free, free)), np.empty(shape, np.float32),
               np.empty(shape, np.float32), np.empty(shape, np.float32),
               np.empty(stars, np.int64), np.empty(stars))


@compiled
def _empty_work(windows: Windows, free: int) -> _Work:
    _, count, filled = windows.data.shape
    return _Work(np.empty((3, filled), np.float32), np.empty((3, count), np.float32),
                 np.empty((count, filled), np.float32), column_sums(free), np.empty(free))


@fused
def _set_neighbours(parameters: np.ndarray, windows: Windows, i: int, work: _Work) -> None:
    """Fill work.neighbours with the flux F a d of the other stars in window i."""
    work.neighbours[:] = 0
    for k in range(windows.first[i], windows.first[i + 1]):
        star = parameters[windows.sources[k]]
        profile(star[U], star[SIGMA], windows.corner[i, 0], work.columns)
        profile(star[V], star[SIGMA], windows.corner[i, 1], work.rows)
        for y in range(work.neighbours.shape[0]):
            flux = np.float32(star[FLUX]) * work.rows[SHARE, y]
            for x in range(work.neighbours.shape[1]):
                work.neighbours[y, x] += flux * work.columns[SHARE, x]


@fused
def _set_sums(windows: Windows, i: int, star: np.ndarray, noise: NoiseModel, work: _Work) -> None:
    """Fill work.sums with the sums over y for star (5,) in window i."""
    flux, level = np.float32(star[FLUX]), np.float32(star[LEVEL])
    background, gain = np.float32(windows.variance[i]), np.float32(noise.gain_dn)
    square = np.float32(noise.model_error ** 2)
    columns, rows, neighbours, sums = work.columns, work.rows, work.neighbours, work.sums
    sums[:] = 0
    for y in range(neighbours.shape[0]):
        df = flux * rows[SHARE, y]
        for x in range(neighbours.shape[1]):
            model = df * columns[SHARE, x]
            variance = _variance(background, gain, square, model + neighbours[y, x])
            sums[W_ROW + x] = np.float32(windows.used[i, y, x]) / variance
            sums[R_ROW + x] = windows.data[i, y, x] - neighbours[y, x] - level - model
        add_row(rows[SHARE, y], rows[D_CENTRE, y], neighbours.shape[1], sums)
        if len(work.gradient) > SIGMA:
            add_sigma_row(rows[SHARE, y], rows[D_CENTRE, y], rows[D_SIGMA, y],
                          neighbours.shape[1], sums)


@fused
def _set_model(fit: Fit, windows: Windows, i: int, noise: NoiseModel, work: _Work) -> None:
    """Fill model, own and weight of star i; its profiles and neighbours are those in work."""
    flux, level = np.float32(fit.parameters[i, FLUX]), np.float32(fit.parameters[i, LEVEL])
    background, gain = np.float32(windows.variance[i]), np.float32(noise.gain_dn)
    square, neighbours = np.float32(noise.model_error ** 2), work.neighbours
    for y in range(neighbours.shape[0]):
        df = flux * work.rows[SHARE, y]
        for x in range(neighbours.shape[1]):
            fit.model[i, y, x] = df * work.columns[SHARE, x]
        for x in range(neighbours.shape[1]):
            fit.own[i, y, x] = windows.data[i, y, x] - neighbours[y, x] - level
        for x in range(neighbours.shape[1]):
            variance = _variance(background, gain, square, fit.model[i, y, x] + neighbours[y, x])
            fit.weight[i, y, x] = np.float32(windows.used[i, y, x]) / variance


@fused
def _variance(background: np.float32, gain: np.float32, square: np.float32, flux: np.float32
              ) -> np.float32:
    """Return the pixel variance of noise.py in float32; square is model_error squared."""
    none = np.float32(0)
    flux = flux if flux > none else none
    return background + flux * (gain + square * flux)


@compiled
def _step(star: np.ndarray, covariance: np.ndarray, gradient: np.ndarray) -> float:
    """Move star (5,) by the limited step N^-1 g; return its length in px."""
    length = 0.0
    for p in range(len(gradient)):
        step = 0.0
        for q in range(len(gradient)):
            step += covariance[p, q] * gradient[q]
        if p in (U, V):
            step = min(max(step, -MAX_STEP_PX), MAX_STEP_PX)
        elif p == SIGMA:
            step = min(max(step, -MAX_SIGMA_STEP_PX), MAX_SIGMA_STEP_PX)
        star[p] += step
        if p in (U, V, SIGMA):
            length = max(length, abs(step))
    star[FLUX] = max(star[FLUX], MIN_FLUX_DN)
    star[SIGMA] = min(max(star[SIGMA], SIGMA_RANGE_PX[0]), SIGMA_RANGE_PX[1])
    return length
