# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The best fit from an initial rotation, its covariance and its residuals: compiled."""

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import sensor_directions, turn_matrix
from startracker_ros.core.maths.small_algebra import adjugate


# Each step doubles the digits; a few arcseconds become rounding in two.
_CONVERGED = 5

MIN_GAP = 1e-12
"""Least gap of the eigenvalues, as of davenport(), that is observable. Below it double precision
no longer holds the third axis: rounding alone (2e-16) would turn it by 2e-4 rad. Two
stars of equal weight reach it 0.3 arcsec apart."""


@compiled
def refine(matrix: np.ndarray, sensor: np.ndarray, icrf: np.ndarray, weight: np.ndarray,
           most_steps: int = _CONVERGED) -> tuple[np.ndarray, float]:
    """
    Refine a matrix (3, 3) to the best fit in place; return the covariance at unit weight.

    At most most_steps steps of Gauss-Newton on sum w |sensor - matrix^T icrf|^2 (Wahba's problem)
    over unit vectors (N, 3) and weights (N,). Covariance and determinant are those of
    inverse_information().
    """
    covariance = np.empty((3, 3))
    determinant = 0.0
    for _ in range(most_steps):
        predicted = sensor_directions(matrix, icrf)
        covariance, determinant = inverse_information(predicted, weight)
        if determinant <= 0:
            return covariance, 0.0
        gx = gy = gz = 0.0
        for i in range(len(weight)):
            # Scalars alone: a view of a row costs more than the arithmetic with it.
            x, y, z, w = sensor[i, 0], sensor[i, 1], sensor[i, 2], weight[i]
            gx += w * (y * predicted[i, 2] - z * predicted[i, 1])
            gy += w * (z * predicted[i, 0] - x * predicted[i, 2])
            gz += w * (x * predicted[i, 1] - y * predicted[i, 0])
        dx = covariance[0, 0] * gx + covariance[0, 1] * gy + covariance[0, 2] * gz
        dy = covariance[1, 0] * gx + covariance[1, 1] * gy + covariance[1, 2] * gz
        dz = covariance[2, 0] * gx + covariance[2, 1] * gy + covariance[2, 2] * gz
        turn_matrix(matrix, dx / 2, dy / 2, dz / 2)
        if dx * dx + dy * dy + dz * dz < 1e-20:
            break
    return covariance, determinant


@compiled
def information(directions: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return F = sum w (I - p p^T) (3, 3) of unit vectors p (N, 3) and weights w (N,)."""
    xx = xy = xz = yy = yz = zz = 0.0
    for i in range(len(weight)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        w = weight[i]
        xx += w * (y * y + z * z)
        yy += w * (x * x + z * z)
        zz += w * (x * x + y * y)
        xy -= w * x * y
        xz -= w * x * z
        yz -= w * y * z
    return np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


@compiled
def inverse_information(directions: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Return the inverse Fisher information (3, 3) of unit vectors (N, 3), its determinant.

    The covariance about their axes for weights (N,) 1 / sigma^2 (Shuster and Oh, J. Guid.
    Control 4, 1981, eq. 98). A determinant of zero: by MIN_GAP the rotation is not
    observable, and there is no inverse.
    """
    F = information(directions, weight)
    xx, xy, xz, yy, yz, zz = F[0, 0], F[0, 1], F[0, 2], F[1, 1], F[1, 2], F[2, 2]
    axx, axy, axz, ayy, ayz, azz = adjugate(xx, xy, xz, yy, yz, zz)
    inverse = np.array(((axx, axy, axz), (axy, ayy, ayz), (axz, ayz, azz)))
    determinant = xx * axx + xy * axy + xz * axz
    # The least eigenvalue is half the gap, for weights whose sum is half the trace.
    minors = axx + ayy + azz
    if not determinant > MIN_GAP / 4 * (xx + yy + zz) * minors:
        return inverse, 0.0
    inverse /= determinant
    return inverse, determinant


@compiled
def residuals(sensor: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Return the angles (N,) in rad between measured and predicted unit vectors (N, 3)."""
    angle = np.empty(len(sensor))
    for i in range(len(sensor)):
        square = 0.0
        for k in range(3):
            square += (sensor[i, k] - predicted[i, k]) ** 2
        # Of the chord: the cosine of a small angle has no digits left.
        angle[i] = 2 * np.arcsin(min(np.sqrt(square) / 2, 1.0))
    return angle
