# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rotation that fits weighted directions best, by singular values. Compiled."""

import numpy as np
from startracker_ros.core.attitude.davenport import attitude_profile
from startracker_ros.core.compiled import compiled


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
