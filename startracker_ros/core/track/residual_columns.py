# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Whitened residuals fitted with columns, compiled.

A residual r of a star with covariance R = L L^T is whitened as L^-1 r. Columns that are no error
of the rows or of the lens (a rotation of all stars, a scale) are taken out by an orthonormal basis
Q: x <- x - Q Q^T x.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled, reordered

_ROTATION, _ROTATION_AND_RADIAL = 3, 5
_DEPENDENT = 1e-9
"""A column that keeps less of its length beside the columns before is a sum of them."""

_LEAST_ENERGY = 1e-12
"""Of a column that is a pattern: that of stars that do not move is zero."""


class RowFit(NamedTuple):
    """
    Residuals r against columns c of P patterns along the rows, first a line, then steps.

    product (P,) is c^T r, energy (P,) c^T c, chi2 r^T r, and edges (P - 1,) where the steps are.
    """

    product: np.ndarray
    energy: np.ndarray
    chi2: float
    edges: np.ndarray


class StrongestPattern(NamedTuple):
    """
    The pattern along the rows that explains most of chi2, and the line, pattern 0.

    best is its number, product and energy are those of RowFit, edge where it steps, NaN for the
    line; mean_square is that of the velocity components, px^2/s^2.
    """

    best: int
    product: float
    energy: float
    edge: float
    line_product: float
    line_energy: float
    chi2: float
    mean_square: float


class LensSums(NamedTuple):
    """
    Residuals without their rotation.

    outwards and square are r^T W d and d^T W d of the distances d from the axis, W = 1 / sigma^2.
    residual and away (K, 2) are r and d, left (K,) the share that r holds of the variance of
    errors that are as large for all stars, and variance (K,) that of the centroids, px^2.
    """

    outwards: float
    square: float
    residual: np.ndarray
    away: np.ndarray
    left: np.ndarray
    variance: np.ndarray


@compiled
def fit_rows(uv: np.ndarray, residual: np.ndarray, error: np.ndarray, flow: np.ndarray,
             velocity: np.ndarray, axis: np.ndarray, height: int, steps: int) -> RowFit:
    """
    Fit residuals (K, 2) of error (K, 2, 2) with velocity (K, 2) g(v), g a line or one of steps.

    Columns of rotation, flow (K, 2, 3), of scale and of radial distortion about axis (2,) are
    taken out before.
    """
    count, first = len(uv), _ROTATION_AND_RADIAL + 1
    rows = (uv[:, 1] - (height - 1) / 2) / height
    inner = np.sort(rows)[3:-3]
    edges = np.empty(steps)
    for k in range(steps):
        edges[k] = inner[k * (len(inner) - 1) // (steps - 1)]
    columns = np.empty((first + 1 + steps, 2 * count))
    for star in range(count):
        du, dv = (uv[star, 0] - axis[0]) / height, (uv[star, 1] - axis[1]) / height
        square = du * du + dv * dv
        R = error[star]
        for k in range(_ROTATION):
            _whiten(columns[k], star, R, flow[star, 0, k], flow[star, 1, k])
        _whiten(columns[3], star, R, du, dv)
        _whiten(columns[4], star, R, du * square, dv * square)
        _whiten(columns[5], star, R, residual[star, 0], residual[star, 1])
        f, g = velocity[star]
        _whiten(columns[first], star, R, f * rows[star], g * rows[star])
        for k in range(steps):
            side = 0.5 if rows[star] > edges[k] else -0.5
            _whiten(columns[first + 1 + k], star, R, f * side, g * side)
    _take_out(columns, _ROTATION_AND_RADIAL)
    r = columns[first - 1]
    product, energy = np.empty(steps + 1), np.empty(steps + 1)
    for k in range(steps + 1):
        product[k] = _inner(columns[first + k], r)
        energy[k] = _inner(columns[first + k], columns[first + k])
    return RowFit(product, energy, _inner(r, r), edges)


@compiled
def strongest_pattern(uv: np.ndarray, residual: np.ndarray, error: np.ndarray, flow: np.ndarray,
                      velocity: np.ndarray, axis: np.ndarray, height: int, steps: int
                      ) -> StrongestPattern:
    """Return the pattern of fit_rows() with the largest (c^T r)^2 / c^T c."""
    fit = fit_rows(uv, residual, error, flow, velocity, axis, height, steps)
    energy = np.maximum(fit.energy, _LEAST_ENERGY)
    best = int(np.argmax(fit.product ** 2 / energy))
    return StrongestPattern(
        best, fit.product[best], energy[best], fit.edges[best - 1] if best else np.nan,
        fit.product[0], energy[0], fit.chi2, np.mean(velocity ** 2))


@compiled
def lens_sums(uv: np.ndarray, residual: np.ndarray, error: np.ndarray, flow: np.ndarray,
              axis: np.ndarray) -> LensSums:
    """Take the rotation out of residuals (K, 2) and of the distances from axis (2,)."""
    count = len(uv)
    columns, variance = np.empty((_ROTATION + 2, 2 * count)), np.empty(count)
    for star in range(count):
        variance[star] = (error[star, 0, 0] + error[star, 1, 1]) / 2
        root = 1 / math.sqrt(variance[star])
        for i in range(2):
            for k in range(_ROTATION):
                columns[k, 2 * star + i] = flow[star, i, k] * root
            columns[_ROTATION, 2 * star + i] = residual[star, i] * root
            columns[_ROTATION + 1, 2 * star + i] = (uv[star, i] - axis[i]) * root
    _take_out(columns, _ROTATION)
    white, outward = columns[_ROTATION], columns[_ROTATION + 1]
    found = LensSums(_inner(white, outward), _inner(outward, outward), np.empty((count, 2)),
                     np.empty((count, 2)), np.empty(count), variance)
    # Diagonal of A A^T with A = I - s Q Q^T / s and the standard deviations s.
    inner = np.zeros((_ROTATION, _ROTATION))
    for row in range(2 * count):
        for k in range(_ROTATION):
            for m in range(_ROTATION):
                inner[k, m] += columns[k, row] * columns[m, row] / variance[row // 2]
    for star in range(count):
        sigma = math.sqrt(variance[star])
        found.left[star] = 1.0
        for i in range(2):
            row = 2 * star + i
            found.residual[star, i], found.away[star, i] = white[row] * sigma, outward[row] * sigma
            for k in range(_ROTATION):
                found.left[star] -= columns[k, row] ** 2
                for m in range(_ROTATION):
                    found.left[star] += (columns[k, row] * inner[k, m] * columns[m, row]
                                         * variance[star] / 2)
    return found


@reordered
def _inner(a: np.ndarray, b: np.ndarray) -> float:
    """Return a^T b; of so few rows in less time than the call of a library."""
    total = 0.0
    for row in range(len(a)):
        total += a[row] * b[row]
    return total


@compiled
def _whiten(column: np.ndarray, star: int, R: np.ndarray, x: float, y: float) -> None:
    """Set two rows of a column to L^-1 (x, y) with R = L L^T."""
    a = math.sqrt(R[0, 0])
    b = R[0, 1] / a
    column[2 * star] = x / a
    column[2 * star + 1] = (y - b * x / a) / math.sqrt(R[1, 1] - b * b)


@compiled
def _take_out(columns: np.ndarray, count: int) -> None:
    """Make the first columns (C, N) orthonormal, or 0 if dependent, and take them out of all."""
    for k in range(len(columns)):
        before = math.sqrt(_inner(columns[k], columns[k]))
        # Twice: once leaves rounding errors of what was taken out.
        for _ in range(2):
            for m in range(min(k, count)):
                along = _inner(columns[m], columns[k])
                for row in range(columns.shape[1]):
                    columns[k, row] -= along * columns[m, row]
        if k < count:
            left = math.sqrt(_inner(columns[k], columns[k]))
            columns[k] *= 1 / left if left > _DEPENDENT * before else 0.0
