# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Centroids of a rolling shutter: each is exposed at the time of its own row.

A star with the image velocity f (px/s) that is exposed delay_s after the time of the frame is
f delay_s away from where it was at that time.
"""

from dataclasses import replace

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import conjugate, rotate
from startracker_ros.core.track.motion_models import image_jacobian

LEAST_STARS = 6
LEAST_SHEAR_S = 1e-6  # spread of the delays from which on a rate moves stars apart


def at_frame_time(camera: Camera, centroids: Centroids, rate_rad_s: np.ndarray) -> Centroids:
    """Return the centroids where they were at the time of the frame, for a body rate (3,)."""
    if not centroids.delay_s.any():
        return centroids
    velocity = image_jacobian(camera, camera.unproject(centroids.uv)) @ rate_rad_s
    return replace(centroids, uv=centroids.uv - velocity * centroids.delay_s[:, None],
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
