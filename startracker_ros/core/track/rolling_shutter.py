# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Centroids of a rolling shutter: each is exposed at the time of its own row.

A star is exposed d = delay_s after the time of the frame. At the rate w and the acceleration a it
is then J (w d + a d^2 / 2) away from where it was at that time, J the image jacobian.
"""

from dataclasses import replace

import numpy as np
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import conjugate, rotate

LEAST_STARS = 6
LEAST_SHEAR_S = 1e-6  # spread of the delays from which on a rate moves stars apart


def at_frame_time(camera: Camera, centroids: Centroids, rate_rad_s: np.ndarray,
                  acceleration_rad_s2: np.ndarray = np.zeros(3)) -> Centroids:
    """Return the centroids where they were at the time of the frame, for a rate (3,)."""
    if not centroids.delay_s.any():
        return centroids
    flow = image_jacobian(camera, camera.unproject(centroids.uv))
    delay_s = centroids.delay_s[:, None]
    turn = delay_s * (rate_rad_s + acceleration_rad_s2 * delay_s / 2)
    return replace(centroids, uv=centroids.uv - np.einsum('nij,nj->ni', flow, turn),
                   delay_s=np.zeros(len(centroids)))


def fit_rate(camera: Camera, icrf: np.ndarray, centroids: Centroids, quaternion: np.ndarray
             ) -> np.ndarray | None:
    """
    Return the body rate (3,) rad/s that explains the residuals of stars exposed row by row.

    icrf (N, 3) are the directions of the centroids (N,), quaternion an attitude (4,). Each
    residual is J (turn + rate delay), J the image jacobian: least squares for both. None for
    fewer than LEAST_STARS, or without delays.
    """
    if len(centroids) < LEAST_STARS or np.ptp(centroids.delay_s) < LEAST_SHEAR_S:
        return None
    predicted = rotate(conjugate(quaternion), icrf)
    flow = image_jacobian(camera, predicted)
    design = np.concatenate([flow, flow * centroids.delay_s[:, None, None]], axis=-1)
    weight = 1 / centroids.sigma_px[:, None]
    residual = (centroids.uv - camera.project(predicted)) * weight
    solution = np.linalg.lstsq((design * weight[..., None]).reshape(-1, 6), residual.reshape(-1),
                               rcond=None)[0]
    return solution[3:]
