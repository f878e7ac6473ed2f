# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From directions to an attitude with covariance and residuals, by four solvers: compiled."""

import numpy as np
from startracker_ros.core.attitude.refinement import inverse_information, MIN_GAP, residuals
from startracker_ros.core.attitude.triad import best_pair, best_partner, triad, triad_covariance
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import (
    matrix_from_quaternion, quaternion_from_matrix, sensor_directions, turn_matrix)
from startracker_ros.core.maths.small_algebra import adjugate

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


# --- Davenport's q-method: the rotation that fits weighted directions best ---


@compiled
def attitude_profile(sensor: np.ndarray, icrf: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) sum w icrf sensor^T of unit vectors (N, 3), weights (N,)."""
    profile = np.zeros((3, 3))
    for n in range(len(weight)):
        for i in range(3):
            for j in range(3):
                profile[i, j] += weight[n] * icrf[n, i] * sensor[n, j]
    return profile


@compiled
def davenport(sensor: np.ndarray, icrf: np.ndarray, weight: np.ndarray
              ) -> tuple[np.ndarray, float]:
    """
    Return q_icrf_from_sensor (4,) and how well it is determined.

    sensor and icrf (N, 3) are unit vectors to the same stars, weight (N,) sums to 1. The
    quaternion maximises sum w icrf . R sensor (Wahba's problem): it is the eigenvector of
    the largest eigenvalue of K (Davenport 1968; Keat 1977; Markley and Mortari, J. Astronaut.
    Sci. 48, 2000, eq. 13). The gap to the next eigenvalue is twice the weighted mean square
    sine of the stars' angles from the axis that is observed worst; at 0 the rotation is not
    unique.
    """
    profile = attitude_profile(sensor, icrf, weight)
    trace = profile[0, 0] + profile[1, 1] + profile[2, 2]
    k = np.empty((4, 4))
    k[:3, :3] = profile + profile.T
    for i in range(3):
        k[i, i] -= trace
        k[i, 3] = k[3, i] = (profile[(i + 2) % 3, (i + 1) % 3]
                             - profile[(i + 1) % 3, (i + 2) % 3])
    k[3, 3] = trace
    eigenvalue, eigenvector = np.linalg.eigh(k)
    q = eigenvector[:, 3].copy()
    return (-q if q[3] < 0 else q), eigenvalue[3] - eigenvalue[2]


# --- QUEST: the rotation that fits weighted directions best, without an eigendecomposition ---
#
# Shuster and Oh, J. Guid. Control 4 (1981). As published it finds the largest eigenvalue of
# Davenport's K by Newton's method from its upper limit, the sum of the weights, and then the
# Rodrigues vector, which is infinite for half turns; the frame is turned about an axis then.
# Here the frame is first turned to the TRIAD attitude of two stars, whatever the
# angle. What is left is small. So are the sums, which are written for it: they hold
# differences of directions instead of directions, and keep their digits for close stars.

# From the upper limit Newton's method never steps over the root. It doubles its digits,
# or halves its distance where two roots are one.
_MOST_STEPS = 60
_PRECISION = 1e-15
_SMALLEST = 1e-20


@compiled
def quest(sensor: np.ndarray, icrf: np.ndarray, sigma: np.ndarray, weight: np.ndarray
          ) -> tuple[np.ndarray, float]:
    """
    Return the matrix (3, 3) to ICRF and the gap, as davenport().

    The gap is a lower limit, exact in the limit of zero. sigma (N,) chooses the two stars.
    """
    first = int(np.argmin(sigma))
    second, _, sine2 = best_partner(sensor, icrf, sigma, first)
    if not sine2 > 0:
        return np.eye(3), 0.0
    start = triad(sensor, icrf, first, second)
    # The two stars may contradict the others. Then the rest is a half turn at worst, and the
    # frame is turned about its axes. In one of the four frames cos(angle / 2)^2 is 1/4 or more.
    for axis in range(-1, 3):
        matrix = start.copy()
        for k in range(3):
            if axis >= 0 and k != axis:
                for i in range(3):
                    matrix[i, k] = -matrix[i, k]
        x, y, z, w, gap = _remaining(sensor, sensor_directions(matrix, icrf), weight)
        if w != 0 and 5 * w * w > x * x + y * y + z * z + w * w:
            turn_matrix(matrix, x / w, y / w, z / w)
            break
    return matrix, gap


@compiled
def _remaining(sensor: np.ndarray, expected: np.ndarray, weight: np.ndarray) -> tuple[float, ...]:
    """
    Return the quaternion, of any length, from sensor (N, 3) to expected (N, 3), and the gap.

    I - K = [[g, -z], [-z^T, e]] has the eigenvalue m = 1 - lambda; the quaternion is
    (adj(g - m) z, det(g - m)).
    """
    gxx = gxy = gxz = gyy = gyz = gzz = 0.0
    zx = zy = zz = e = 0.0
    for i in range(len(weight)):
        bx, by, bz = sensor[i]
        rx, ry, rz = expected[i]
        w = weight[i]
        dx, dy, dz = rx - bx, ry - by, rz - bz
        e += w * (dx * dx + dy * dy + dz * dz) / 2
        zx += w * (by * dz - bz * dy)
        zy += w * (bz * dx - bx * dz)
        zz += w * (bx * dy - by * dx)
        # 1 + b.r - 2 bx rx is 2 - 2 bx rx but for the loss e.
        gxx += 2 * w * (by * ry + bz * rz)
        gyy += 2 * w * (bx * rx + bz * rz)
        gzz += 2 * w * (bx * rx + by * ry)
        gxy -= w * (bx * ry + by * rx)
        gxz -= w * (bx * rz + bz * rx)
        gyz -= w * (by * rz + bz * ry)
    gxx += e
    gyy += e
    gzz += e
    m = 0.0
    for _ in range(_MOST_STEPS):
        xx, yy, zz_ = gxx - m, gyy - m, gzz - m
        axx, axy, axz, ayy, ayz, azz = adjugate(xx, gxy, gxz, yy, gyz, zz_)
        x = axx * zx + axy * zy + axz * zz
        y = axy * zx + ayy * zy + ayz * zz
        z = axz * zx + ayz * zy + azz * zz
        w = xx * axx + gxy * axy + gxz * axz
        # p = det(I - K - m) and its slope, minus the product of the gaps to the other roots.
        value = (e - m) * w - (x * zx + y * zy + z * zz)
        trace = xx + yy + zz_
        form = (xx * zx * zx + yy * zy * zy + zz_ * zz * zz
                + 2 * (gxy * zx * zy + gxz * zx * zz + gyz * zy * zz))
        slope = (-w - (e - m) * (axx + ayy + azz) - form
                 + trace * (zx * zx + zy * zy + zz * zz))
        step = -value / slope
        if not step > _PRECISION * m + _SMALLEST:
            break
        m += step
    # The other two gaps are 2 each where one is small.
    return x, y, z, w, -slope / 4
