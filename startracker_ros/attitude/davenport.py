"""Davenport's q-method: the rotation that fits weighted directions best."""

import numpy as np


def davenport(sensor: np.ndarray, icrf: np.ndarray, weight: np.ndarray
              ) -> tuple[np.ndarray, float]:
    """Return q_icrf_from_sensor (4,) and how well it is determined.

    sensor and icrf (N, 3) are unit vectors to the same stars, weight (N,) sums to 1. The
    quaternion maximises sum w icrf . R sensor (Wahba's problem): it is the eigenvector of
    the largest eigenvalue of K (Davenport 1968; Markley and Mortari, J. Astronaut. Sci. 48,
    2000, eq. 13). The gap to the next eigenvalue is twice the weighted mean square sine
    of the stars' angles from the axis that is observed worst; at 0 the rotation is not unique.
    """
    profile = (icrf * weight[:, None]).T @ sensor
    trace = profile[0, 0] + profile[1, 1] + profile[2, 2]
    k = np.empty((4, 4))
    k[:3, :3] = profile + profile.T
    k[[0, 1, 2], [0, 1, 2]] -= trace
    k[3, :3] = k[:3, 3] = (profile[2, 1] - profile[1, 2], profile[0, 2] - profile[2, 0],
                           profile[1, 0] - profile[0, 1])
    k[3, 3] = trace
    eigenvalue, eigenvector = np.linalg.eigh(k)
    q = eigenvector[:, 3]
    return (-q if q[3] < 0 else q), float(eigenvalue[3] - eigenvalue[2])
