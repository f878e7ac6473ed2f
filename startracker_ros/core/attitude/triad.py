# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
A rotation from two directions: exact in the first, within the plane of both. Compiled.

Black, AIAA Journal 2 (1964); covariance of Shuster and Oh, J. Guid. Control 4 (1981).
"""

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.small_algebra import cross


@compiled
def triad(sensor: np.ndarray, icrf: np.ndarray, first: int, second: int) -> np.ndarray:
    """
    Return the matrix (3, 3) to ICRF that fits two of the directions (N, 3), the first exactly.

    The two must not be parallel.
    """
    frame, other = _frame(sensor, first, second), _frame(icrf, first, second)
    matrix = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                matrix[i, j] += other[k, i] * frame[k, j]
    return matrix


@compiled
def _frame(vectors: np.ndarray, first: int, second: int) -> np.ndarray:
    """Return three axes (3, 3): a vector, the normal of the plane of two, and across."""
    axes = np.empty((3, 3))
    for k in range(3):
        axes[0, k] = vectors[first, k]
        axes[2, k] = vectors[second, k]
    for row, a, b in ((1, 0, 2), (2, 0, 1)):
        x, y, z = cross(axes[a, 0], axes[a, 1], axes[a, 2], axes[b, 0], axes[b, 1], axes[b, 2])
        length = np.sqrt(x * x + y * y + z * z)
        axes[row, 0], axes[row, 1], axes[row, 2] = x / length, y / length, z / length
    return axes


@compiled
def best_partner(sensor: np.ndarray, icrf: np.ndarray, sigma: np.ndarray, first: int
                 ) -> tuple[int, float, float]:
    """
    Return the best second star for a first one, the variance of both and their sine squared.

    The variance is the trace of the covariance in rad^2; the sine is the geometric mean of the
    sensor's and the catalogue's: 0 where the stars are parallel in either. -1, infinity and 0
    when there is none.
    """
    partner, least, best_sine2 = -1, np.inf, 0.0
    for second in range(len(sigma)):
        sine2 = np.sqrt(_sine2(sensor, first, second) * _sine2(icrf, first, second))
        if sine2 > 0:
            variance = sigma[first] ** 2 + (sigma[first] ** 2 + sigma[second] ** 2) / sine2
            if variance < least:
                partner, least, best_sine2 = second, variance, sine2
    return partner, least, best_sine2


@compiled
def best_pair(sensor: np.ndarray, icrf: np.ndarray, sigma: np.ndarray) -> tuple[int, int, float]:
    """
    Return the two stars whose TRIAD attitude varies least, and their sine squared.

    Of two, the more accurate one is the first. -1, -1 and 0 when all are parallel.
    """
    first, second, least, best_sine2 = -1, -1, np.inf, 0.0
    for i in range(len(sigma)):
        partner, variance, sine2 = best_partner(sensor, icrf, sigma, i)
        if variance < least:
            first, second, least, best_sine2 = i, partner, variance, sine2
    return first, second, best_sine2


@compiled
def _sine2(vectors: np.ndarray, first: int, second: int) -> float:
    """Return the square of the sine of the angle between two of the unit vectors (N, 3)."""
    ax, ay, az = vectors[first]
    bx, by, bz = vectors[second]
    x, y, z = cross(ax, ay, az, bx, by, bz)
    return x * x + y * y + z * z


@compiled
def triad_covariance(directions: np.ndarray, sigma: np.ndarray, first: int, second: int
                     ) -> np.ndarray:
    """Return the covariance (3, 3) rad^2 about the axes of the true directions (N, 3)."""
    a, b = directions[first], directions[second]
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    sine2 = _sine2(directions, first, second)
    square, other = sigma[first] ** 2, sigma[second] ** 2
    covariance = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            covariance[i, j] = (square * cosine * (a[i] * b[j] + b[i] * a[j])
                                + (other - square) * a[i] * a[j]) / sine2
        covariance[i, i] += square
    return covariance
