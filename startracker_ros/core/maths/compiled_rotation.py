# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Single rotations for compiled functions, and where NumPy takes ten times as long."""

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths import rotation as formulas

_product = compiled(formulas.product)
_from_rotation_vector = compiled(formulas.from_rotation_vector)
_matrix_rows = compiled(formulas.matrix_rows)
_from_matrix = compiled(formulas.from_matrix)


@compiled
def matrix_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,)."""
    return np.array(_matrix_rows(q))


@compiled
def matrix_from_rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) exp([v]x) of a rotation vector v (3,) in rad."""
    return np.array(_matrix_rows(_from_rotation_vector(rotation)))


@compiled
def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,), w >= 0, of a rotation matrix (3, 3)."""
    return np.array(_from_matrix(matrix))


@compiled
def turned(q: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return a quaternion (4,) after a turn by a rotation vector (3,) rad about sensor axes."""
    after = np.array(_product(q, _from_rotation_vector(rotation)))
    return after / np.sqrt(np.sum(after * after))


@compiled
def turn_matrix(matrix: np.ndarray, gx: float, gy: float, gz: float) -> None:
    """
    Turn a matrix (3, 3) in place about its sensor axes by a Rodrigues (Gibbs) vector g.

    R (I + 2 ([g]x + [g]x^2) / (1 + g.g)). The length of g is the tangent of half the angle: the
    matrix stays a rotation at any size.
    """
    scale = 2 / (1 + gx * gx + gy * gy + gz * gz)
    for i in range(3):
        a, b, c = matrix[i, 0], matrix[i, 1], matrix[i, 2]
        px, py, pz = b * gz - c * gy, c * gx - a * gz, a * gy - b * gx
        qx, qy, qz = py * gz - pz * gy, pz * gx - px * gz, px * gy - py * gx
        matrix[i, 0] = a + scale * (px + qx)
        matrix[i, 1] = b + scale * (py + qy)
        matrix[i, 2] = c + scale * (pz + qz)


@compiled
def sensor_directions(matrix: np.ndarray, icrf: np.ndarray) -> np.ndarray:
    """Return R^T v (N, 3): directions icrf (N, 3) on the axes of the sensor."""
    sensor = np.empty((len(icrf), 3))
    for i in range(len(icrf)):
        x, y, z = icrf[i, 0], icrf[i, 1], icrf[i, 2]
        for k in range(3):
            sensor[i, k] = matrix[0, k] * x + matrix[1, k] * y + matrix[2, k] * z
    return sensor


@compiled
def rotation_between(q: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) rad about the axes of q (4,) to another attitude (4,)."""
    x, y, z, w = _product((-q[0], -q[1], -q[2], q[3]), other)
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    sine = np.sqrt(x * x + y * y + z * z)
    scale = 2 * np.arctan2(sine, w) / sine if sine > 0 else 2.0
    return np.array((scale * x, scale * y, scale * z))


def mean_attitude(attitudes: np.ndarray) -> np.ndarray:
    """Return the mean (4,) of attitudes (K, 4) that are near each other, about the middle one."""
    middle = attitudes[len(attitudes) // 2]
    return turned(middle, np.mean([rotation_between(middle, one) for one in attitudes], axis=0))
