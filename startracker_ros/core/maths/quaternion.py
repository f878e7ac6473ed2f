# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Formulas of unit quaternions x, y, z, w (Hamilton): a number or an array per component.

The same functions serve arrays and, compiled by startracker_ros.core.compiled, single rotations.
"""

from typing import Any

import numpy as np

Components = tuple[Any, Any, Any, Any]


def product(a: Any, b: Any) -> Components:
    """Return the Hamilton product a b: first the rotation b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz)


def from_rotation_vector(rotation: Any) -> Components:
    """Return q = [v sin(a / 2) / a, cos(a / 2)] of a rotation vector v of length a in rad."""
    x, y, z = rotation
    half = np.sqrt(x * x + y * y + z * z) / 2
    # sinc keeps the limit of sin(a / 2) / a at zero.
    scale = np.sinc(half / np.pi) / 2
    return x * scale, y * scale, z * scale, np.cos(half)


def matrix_rows(q: Any) -> tuple[tuple[Any, Any, Any], ...]:
    """Return the rows of the rotation matrix R(q)."""
    x, y, z, w = q
    return ((1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)))


def from_matrix(rows: Any) -> Components:
    """
    Return the quaternion, w >= 0, of the rows of one rotation matrix (Shepperd 1978).

    4 q q^T is linear in the matrix. Its row with the largest diagonal element is the
    quaternion up to scale, without loss of precision.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    largest = max(xx, yy, zz, xx + yy + zz)
    if xx == largest:
        x, y, z, w = 1 + xx - yy - zz, xy + yx, xz + zx, zy - yz
    elif yy == largest:
        x, y, z, w = xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx
    elif zz == largest:
        x, y, z, w = xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy
    else:
        x, y, z, w = zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz
    length = np.sqrt(x * x + y * y + z * z + w * w)
    if w < 0:
        length = -length
    return x / length, y / length, z / length, w / length
