# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras for the native core, and what it computes of them."""

from functools import lru_cache

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.distortion import MODELS
from startracker_ros.core.camera.model import Camera

_LENSES = list(MODELS)


@lru_cache(maxsize=16)
def native_camera(camera: Camera) -> np.ndarray:
    """Return a CAMERA, read-only."""
    made = np.zeros((), native.CAMERA)
    made['width_px'], made['height_px'] = camera.width, camera.height
    made['fx_px'], made['fy_px'] = camera.fx, camera.fy
    made['cx_px'], made['cy_px'] = camera.cx, camera.cy
    made['distortion'][:len(camera.distortion)] = camera.distortion
    made['model'] = _LENSES.index(camera.distortion_model)
    made.flags.writeable = False
    return made


def image_jacobian(camera: Camera, directions: np.ndarray) -> np.ndarray:
    """
    Return d(u, v)/dt per body rate, (N, 2, 3) in px/rad, of directions (N, 3).

    Under the body rate w (rad/s, sensor axes) a direction d changes by -w x d. NaN for a direction
    behind the camera.
    """
    lens, directions = native_camera(camera), np.ascontiguousarray(directions, float)
    jacobian = np.empty((len(directions), 2, 3))
    native.check(native.library().st_image_flow(
        lens.ctypes.data, directions.ctypes.data, jacobian.ctypes.data,
        len(directions)))
    return jacobian
