# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Davenport's q-method: the rotation that fits weighted directions best. Compiled."""

import numpy as np
from startracker_ros.core.compiled import compiled


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
