# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
QUEST: the rotation that fits weighted directions best, without an eigendecomposition.

Shuster and Oh, J. Guid. Control 4 (1981). As published it finds the largest eigenvalue of
Davenport's K by Newton's method from its upper limit, the sum of the weights, and then the
Rodrigues vector, which is infinite for half turns; the frame is turned about an axis then.
Here the frame is first turned to the TRIAD attitude of two stars, whatever the
angle. What is left is small. So are the sums, which are written for it: they hold
differences of directions instead of directions, and keep their digits for close stars.
"""

import numpy as np
from startracker_ros.core.attitude.triad import best_partner, triad
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import sensor_directions, turn_matrix
from startracker_ros.core.maths.small_algebra import adjugate

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
