# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How star images move at a constant velocity; one is [u, u_rate, v, v_rate] in px and px/s."""

import numpy as np

POSITION = [0, 2]
VELOCITY = [1, 3]


def constant_velocity(dt_s: float, acceleration_px_s2: tuple[float, float]
                      ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the transition (4, 4) and process noise (4, 4) of the CV model.

    White acceleration of 1-sigma (u, v), constant within the step: Q = E diag(s^2) E^T
    (Sadeghi, Sabahi and Saberali). dt_s > 0.
    """
    half = dt_s * dt_s / 2
    transition = np.array([[1, dt_s, 0, 0], [0, 1, 0, 0], [0, 0, 1, dt_s], [0, 0, 0, 1]], float)
    effect = np.array([[half, 0], [dt_s, 0], [0, half], [0, dt_s]]) * acceleration_px_s2
    return transition, effect @ effect.T
