# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One compiled call from directions to attitude, covariance and residuals."""

import numpy as np
from startracker_ros.core.attitude.davenport import attitude_profile, davenport
from startracker_ros.core.attitude.quest import quest
from startracker_ros.core.attitude.refinement import inverse_information, MIN_GAP, residuals
from startracker_ros.core.attitude.triad import best_pair, triad, triad_covariance
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import (
    matrix_from_quaternion, quaternion_from_matrix, sensor_directions)

QUEST, DAVENPORT, SVD, TRIAD = range(4)

SOLVED, NOT_FINITE, SIGMA, ZERO_LENGTH, SAME_STAR, PARALLEL = range(6)
"""Status of solve()."""


@compiled
def solve(solver: int, sensor: np.ndarray, icrf: np.ndarray, sigma: np.ndarray
          ) -> tuple[int, int, int, np.ndarray, np.ndarray, np.ndarray, float]:
    """
    Return the status, the two stars of SAME_STAR (-1 else) and the solution.

    sensor and icrf (N, 3), N at least 2, are made unit vectors in place; sigma (N,) in rad. The
    solution is a quaternion (4,), a covariance (3, 3), residuals (N,) in rad and chi2.
    """
    count = len(sigma)
    quaternion, covariance, residual = np.empty(4), np.empty((3, 3)), np.empty(count)
    star, twin = _twins(sensor, icrf)
    status = _check(sensor, icrf, sigma)
    if status == SOLVED and twin >= 0:
        status = SAME_STAR
    if status != SOLVED:
        return status, star, twin, quaternion, covariance, residual, 0.0
    least = sigma.min()
    weight = (least / sigma) ** 2
    total = weight.sum()
    weight /= total
    if solver == TRIAD:
        first, second, sine2 = best_pair(sensor, icrf, sigma)
        # The gap of these two stars alone.
        gap = sine2 / 2
        if gap < MIN_GAP:
            return PARALLEL, -1, -1, quaternion, covariance, residual, 0.0
        matrix = triad(sensor, icrf, first, second)
        predicted = sensor_directions(matrix, icrf)
        covariance = triad_covariance(predicted, sigma, first, second)
    else:
        if solver == QUEST:
            matrix, gap = quest(sensor, icrf, sigma, weight)
        elif solver == DAVENPORT:
            quaternion, gap = davenport(sensor, icrf, weight)
            matrix = matrix_from_quaternion(quaternion)
        else:
            matrix, gap = svd(sensor, icrf, weight)
        predicted = sensor_directions(matrix, icrf)
        # The catalogue is exact: its angles, not the measured ones, determine what is observable.
        covariance, determinant = inverse_information(predicted, weight)
        if gap < MIN_GAP or determinant <= 0:
            return PARALLEL, -1, -1, quaternion, covariance, residual, 0.0
        covariance *= least ** 2 / total
    residual = residuals(sensor, predicted)
    return (SOLVED, -1, -1, quaternion_from_matrix(matrix), covariance, residual,
            np.sum((residual / sigma) ** 2))


@compiled
def _check(sensor: np.ndarray, icrf: np.ndarray, sigma: np.ndarray) -> int:
    """Make the directions unit vectors; return SOLVED or what is wrong with them."""
    status = SOLVED
    for i in range(len(sigma)):
        if not np.isfinite(sigma[i]):
            return NOT_FINITE
        if sigma[i] <= 0:
            status = SIGMA
        for vectors in (sensor, icrf):
            x, y, z = vectors[i]
            if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
                return NOT_FINITE
            # Divided by the largest first: the squares of huge or tiny ones are no numbers.
            largest = max(abs(x), abs(y), abs(z))
            if largest > 0:
                x, y, z = x / largest, y / largest, z / largest
                length = np.sqrt(x * x + y * y + z * z)
                vectors[i, 0], vectors[i, 1], vectors[i, 2] = x / length, y / length, z / length
            elif status == SOLVED:
                status = ZERO_LENGTH
    return status


@compiled
def _twins(sensor: np.ndarray, icrf: np.ndarray) -> tuple[int, int]:
    """Return two stars with equal directions in image and catalogue; -1 for none."""
    for i in range(len(sensor)):
        for j in range(i):
            if (sensor[i, 0] == sensor[j, 0] and sensor[i, 1] == sensor[j, 1]
                    and sensor[i, 2] == sensor[j, 2] and icrf[i, 0] == icrf[j, 0]
                    and icrf[i, 1] == icrf[j, 1] and icrf[i, 2] == icrf[j, 2]):
                return j, i
    return -1, -1


@compiled
def svd(sensor: np.ndarray, icrf: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Return the matrix (3, 3) to ICRF and the gap, as davenport().

    Of the singular vectors of the attitude profile (Markley, J. Astronaut. Sci. 36, 1988).
    The gap is 2 (s2 + d s3) of the singular values s, d = -1 for mirrored directions.
    """
    left, singular, right = np.linalg.svd(attitude_profile(sensor, icrf, weight))
    # Right-handed: two stars leave the third direction and its sign open.
    third_left = np.cross(left[:, 0], left[:, 1])
    third_right = np.cross(right[0], right[1])
    mirror = np.dot(third_left, left[:, 2].copy()) * np.dot(third_right, right[2].copy())
    matrix = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            matrix[i, j] = (left[i, 0] * right[0, j] + left[i, 1] * right[1, j]
                            + third_left[i] * third_right[j])
    return matrix, 2 * (singular[1] + mirror * singular[2])
