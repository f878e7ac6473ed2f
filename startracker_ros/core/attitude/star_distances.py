# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How far stars are from where an attitude has them: compiled."""

import numpy as np
from startracker_ros.core.camera.lens import Lens, project
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_quaternion, sensor_directions


@compiled
def star_distances(lens: Lens, quaternion: np.ndarray, icrf: np.ndarray, uv: np.ndarray
                   ) -> tuple[np.ndarray, float]:
    """
    Return the distances (N,) px of pixels uv (N, 2) from stars icrf (N, 3), and their rms.

    By an attitude (4,), q_icrf_from_sensor; NaN for a star behind the camera.
    """
    predicted = project(lens, sensor_directions(matrix_from_quaternion(quaternion), icrf))
    distance, square = np.empty(len(uv)), 0.0
    for n in range(len(uv)):
        distance[n] = np.hypot(uv[n, 0] - predicted[n, 0], uv[n, 1] - predicted[n, 1])
        square += distance[n] ** 2
    return distance, np.sqrt(square / len(uv))
