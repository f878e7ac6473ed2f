# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How fast star images move in the image when the camera turns."""

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.model import Camera


def image_jacobian(camera: Camera, directions: np.ndarray) -> np.ndarray:
    """
    Return d(u, v)/dt per body rate, (N, 2, 3) in px/rad, of directions (N, 3).

    Under the body rate w (rad/s, sensor axes) a direction d changes by -w x d. NaN for a direction
    behind the camera.
    """
    lens, directions = camera.native, np.ascontiguousarray(directions, float)
    jacobian = np.empty((len(directions), 2, 3))
    native.check(native.library().st_image_flow(
        lens.ctypes.data, directions.ctypes.data, jacobian.ctypes.data,
        len(directions)))
    return jacobian
