# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
How star images move: at a constant velocity, and under a turn of the camera.

The state of one star is [u, u_rate, v, v_rate] in px and px/s. Under the body rate w
(rad/s, sensor axes) a direction d in the sensor frame changes by -w x d.
"""

import numpy as np
from startracker_ros.core.camera.lens import distortion_jacobian, Lens
from startracker_ros.core.compiled import compiled

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


@compiled
def image_flow(lens: Lens, a: float, b: float, jacobian: np.ndarray) -> None:
    """
    Fill the jacobian (2, 3) of image motion per body rate at undistorted coordinates a, b.

    A direction d moves by -e x d where the body turns about an axis e. Then (da, db) is
    (h a b, c + h b2), -(c + h a2, h a b) and (b, -a) for the three axes; c = h = 1 where a, b are
    x / z, y / z, and c = theta cot theta, h = (1 - c) / theta2 for an equidistant lens.
    """
    xx, cross, yy = distortion_jacobian(lens.terms, a, b)
    c = h = 1.0
    if lens.equidistant:
        theta2 = a * a + b * b
        if theta2 > 0:
            theta = np.sqrt(theta2)
            c = theta / np.tan(theta)
            h = (1 - c) / theta2
    for axis in range(3):
        if axis == 0:
            da, db = h * a * b, c + h * b * b
        elif axis == 1:
            da, db = -(c + h * a * a), -h * a * b
        else:
            da, db = b, -a
        jacobian[0, axis] = lens.fx * (xx * da + cross * db)
        jacobian[1, axis] = lens.fy * (cross * da + yy * db)
