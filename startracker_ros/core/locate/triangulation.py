# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Triangulation of a target from two lines of sight, in one compiled call.

Gao and Cui 2016: the target is at r = R_j + rho_j V_j. The cross product with V_j removes the
range: r x V_j = R_j x V_j. Errors e_R of the position and e_V of the direction move a line by
e_R + rho_j e_V, of which only the component across V_j matters.
"""

import math

import numpy as np
from startracker_ros.core.compiled import compiled

(LOCATED, NOT_FINITE, NOT_UNIT, SHORT_BASELINE, PARALLEL, BEHIND_FIRST, BEHIND_SECOND,
 COVARIANCE) = range(8)
"""Status returned by triangulate()."""

_ITERATIONS = 3
"""The second iteration has the ranges, the third removes the rounding errors of the second."""


@compiled
def triangulate(position: np.ndarray, direction: np.ndarray, covariance: np.ndarray,
                weighted: bool, min_baseline_m: float, min_sine: float, target: np.ndarray,
                target_covariance: np.ndarray, measures: np.ndarray) -> int:
    """
    Return the status; fill target (3,), target_covariance (3, 3) and measures (5,).

    position (2, 3) m, direction (2, 3) unit vectors, covariance (2, 6, 6) of position and
    direction. target in m, its covariance in m^2; measures are both ranges in m, the sine of
    the angle between the lines, their smallest distance in m and its sigma.
    """
    status = _status_of_input(position, direction)
    if status != LOCATED:
        return status
    # Relative to the first observer: rounding errors are smaller than in geocentric positions.
    origin = np.zeros((2, 3))
    for i in range(3):
        origin[1, i] = position[1, i] - position[0, i]
    if math.sqrt(origin[1, 0] * origin[1, 0] + origin[1, 1] * origin[1, 1]
                 + origin[1, 2] * origin[1, 2]) < min_baseline_m:
        return SHORT_BASELINE
    normal = np.cross(direction[0], direction[1])
    sine = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    measures[2] = sine
    if sine < min_sine:
        return PARALLEL
    for i in range(3):
        normal[i] /= sine
    r, line_covariance = np.zeros(3), np.zeros((2, 3, 3))
    status = _solve(origin, direction, covariance, weighted, r, line_covariance,
                    target_covariance, measures[:2])
    if status != LOCATED:
        return status
    measures[3], measures[4] = _miss(normal, origin[1], line_covariance)
    for i in range(3):
        target[i] = position[0, i] + r[i]
    for i in range(3):
        if not (target_covariance[i, i] >= 0 and math.isfinite(target[i])):
            return COVARIANCE
    return LOCATED


@compiled
def triangulate_all(position: np.ndarray, direction: np.ndarray, covariance: np.ndarray,
                    weighted: bool, min_baseline_m: float, min_sine: float
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return triangulate() of N pairs: status (N,), target, target_covariance and measures.

    positions (N, 2, 3), directions (N, 2, 3), covariances (N, 2, 6, 6).
    """
    count = len(position)
    status = np.empty(count, np.int64)
    target, target_covariance = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    measures = np.full((count, 5), np.nan)
    for n in range(count):
        status[n] = triangulate(
            position[n], direction[n], covariance[n], weighted, min_baseline_m, min_sine,
            target[n], target_covariance[n], measures[n])
    return status, target, target_covariance, measures


@compiled
def _status_of_input(position: np.ndarray, direction: np.ndarray) -> int:
    """Return NOT_FINITE, NOT_UNIT (to 1e-6) or LOCATED for the lines, (2, 3) each."""
    for j in range(2):
        square = 0.0
        for i in range(3):
            square += direction[j, i] ** 2
            if not math.isfinite(position[j, i]):
                return NOT_FINITE
        if not math.isfinite(square):
            return NOT_FINITE
        if abs(square - 1) > 1e-6:
            return NOT_UNIT
    return LOCATED


@compiled
def _solve(origin: np.ndarray, direction: np.ndarray, covariance: np.ndarray, weighted: bool,
           r: np.ndarray, line_covariance: np.ndarray, r_covariance: np.ndarray,
           rho: np.ndarray) -> int:
    """
    Return the status; fill r (3,), line_covariance (2, 3, 3), r_covariance (3, 3), rho (2,).

    r minimises sum_j (R_j - r)' W_j (R_j - r) with R_j = origin (2, 3). W_j is first the
    projection across V_j, then the inverse of the covariance across V_j, which depends on the
    range rho_j = V_j . (r - R_j). With N = sum_j W_j the covariance of r is
    sum_j N^-1 W_j S_j W_j N^-1, S_j the covariance of line j at the target.
    """
    weight, inverse = np.empty((2, 3, 3)), np.empty((3, 3))
    for j in range(2):
        _projection_across(direction[j], weight[j])
    _least_squares_step(origin, weight, r, inverse)
    _least_squares_step(origin, weight, r, inverse)
    for _ in range(_ITERATIONS):
        for j in range(2):
            rho[j] = 0.0
            for i in range(3):
                rho[j] += direction[j, i] * (r[i] - origin[j, i])
            _line_covariance(covariance[j], rho[j], line_covariance[j])
        if rho[0] <= 0:
            return BEHIND_FIRST
        if rho[1] <= 0:
            return BEHIND_SECOND
        if not weighted:
            break
        for j in range(2):
            if not _information_across(direction[j], line_covariance[j], weight[j]):
                return COVARIANCE
        if not _least_squares_step(origin, weight, r, inverse):
            return COVARIANCE
    r_covariance[:] = 0
    for j in range(2):
        gain = inverse @ weight[j]
        r_covariance += gain @ line_covariance[j] @ gain.T
    return LOCATED


@compiled
def _miss(normal: np.ndarray, baseline: np.ndarray, line_covariance: np.ndarray
          ) -> tuple[float, float]:
    """
    Return the smallest distance of the two lines and its sigma, both in m.

    The distance is |n . (R_2 - R_1)| and its variance n' (S_1 + S_2) n, n (3,) the unit normal
    to both lines and S_j the line covariances (2, 3, 3).
    """
    distance, variance = 0.0, 0.0
    for i in range(3):
        distance += normal[i] * baseline[i]
        for k in range(3):
            variance += normal[i] * (line_covariance[0, i, k]
                                     + line_covariance[1, i, k]) * normal[k]
    return abs(distance), math.sqrt(max(variance, 0.0))


@compiled
def _projection_across(v: np.ndarray, weight: np.ndarray) -> None:
    """Fill weight (3, 3) with I - V V', the projection across a unit vector."""
    for i in range(3):
        for k in range(3):
            weight[i, k] = (i == k) - v[i] * v[k]


@compiled
def _line_covariance(covariance: np.ndarray, rho: float, line_covariance: np.ndarray) -> None:
    """Fill line_covariance (3, 3) with the covariance of e_R + rho e_V."""
    for i in range(3):
        for k in range(3):
            line_covariance[i, k] = (covariance[i, k] + rho * (covariance[i, 3 + k]
                                                               + covariance[3 + i, k])
                                     + rho * rho * covariance[3 + i, 3 + k])


@compiled
def _information_across(v: np.ndarray, line_covariance: np.ndarray, weight: np.ndarray) -> bool:
    """
    Fill weight (3, 3) with T' (T S T')^-1 T; return False where T S T' is not positive.

    The rows of T (2, 3) are unit vectors a and b across V; S is the line covariance (3, 3).
    """
    # The coordinate axis most nearly across V defines a.
    least = 0
    for i in range(1, 3):
        if abs(v[i]) < abs(v[least]):
            least = i
    axis = np.zeros(3)
    axis[least] = 1.0
    a = np.cross(v, axis)
    a /= math.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
    b = np.cross(v, a)
    aa = ab = bb = 0.0
    for i in range(3):
        for k in range(3):
            aa += a[i] * line_covariance[i, k] * a[k]
            ab += a[i] * line_covariance[i, k] * b[k]
            bb += b[i] * line_covariance[i, k] * b[k]
    determinant = aa * bb - ab * ab
    if not (aa > 0 and determinant > 0):
        return False
    for i in range(3):
        for k in range(3):
            weight[i, k] = (bb * a[i] * a[k] + aa * b[i] * b[k]
                            - ab * (a[i] * b[k] + b[i] * a[k])) / determinant
    return True


@compiled
def _least_squares_step(origin: np.ndarray, weight: np.ndarray, r: np.ndarray,
                        inverse: np.ndarray) -> bool:
    """
    Add N^-1 sum_j W_j (R_j - r) to r (3,), N = W_1 + W_2; return whether N is positive definite.

    Fill inverse (3, 3) with N^-1, by cofactors.
    """
    n = weight[0] + weight[1]
    gradient = weight[0] @ (origin[0] - r) + weight[1] @ (origin[1] - r)
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for k in range(3):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            inverse[k, i] = n[i1, k1] * n[i2, k2] - n[i1, k2] * n[i2, k1]
    determinant = n[0, 0] * inverse[0, 0] + n[0, 1] * inverse[1, 0] + n[0, 2] * inverse[2, 0]
    if not determinant > 0:
        return False
    inverse /= determinant
    for i in range(3):
        r[i] += (inverse[i, 0] * gradient[0] + inverse[i, 1] * gradient[1]
                 + inverse[i, 2] * gradient[2])
    return True
