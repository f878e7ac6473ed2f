# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The best fit to stars whose errors are not round, as those of streaks.

A star at p is measured as s by the pixels u with covariance R. With D = ds/du and its
pseudo-inverse D+, its residual is r = D+ (s - p) px. A turn of the sensor by a small rotation
vector x moves p by p x x, so that r changes by -A x, A = D+ [p]x. The best turn minimises
sum (r - A x)^T R^-1 (r - A x), and its covariance is (sum A^T R^-1 A)^-1.
"""

from dataclasses import replace

import numpy as np
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import (
    angle_between, conjugate, multiply, quaternion_from_rotation_vector, rotate, sign_continuous)

_ITERATIONS = 2  # of Gauss and Newton from the best fit of round errors
_STEPS_PX = 0.5 * np.array([[[1.0, 0.0]], [[-1.0, 0.0]], [[0.0, 1.0]], [[0.0, -1.0]]])
_ROUND = 1e-6  # relative difference between the axes


def fit_error_ellipses(attitude: AttitudeEstimate, camera: Camera, uv: np.ndarray,
                       icrf: np.ndarray, error_px2: np.ndarray) -> AttitudeEstimate:
    """
    Return the best fit to the errors of stars, near an attitude that is one for round errors.

    uv (N, 2) px with covariances error_px2 (N, 2, 2); icrf (N, 3) are their catalogue directions.
    """
    difference = np.hypot(error_px2[:, 0, 0] - error_px2[:, 1, 1], 2 * error_px2[:, 0, 1])
    if not (difference > _ROUND * np.trace(error_px2, axis1=1, axis2=2)).any():
        return attitude
    right, left, below, above = camera.unproject(uv + _STEPS_PX)
    into_px = np.linalg.pinv(np.stack([right - left, below - above], axis=-1))
    seen, inverse = camera.unproject(uv), np.linalg.inv(error_px2)
    quaternion = attitude.quaternion
    for _ in range(_ITERATIONS):
        predicted = rotate(conjugate(quaternion), icrf)
        A = into_px @ _cross(predicted)
        r = _times(into_px, seen - predicted)
        weighted = np.swapaxes(A, 1, 2) @ inverse
        covariance = np.linalg.inv(np.sum(weighted @ A, axis=0))
        turn = covariance @ _times(weighted, r).sum(axis=0)
        quaternion = multiply(quaternion, quaternion_from_rotation_vector(turn))
    predicted = rotate(conjugate(quaternion), icrf)
    r = _times(into_px, seen - predicted)
    return replace(
        attitude, quaternion=sign_continuous(quaternion, None), covariance_sensor=covariance,
        residual_rad=angle_between(seen, predicted),
        chi2=float(np.einsum('ni,nij,nj->', r, inverse, r)))


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return the products (N, m) of matrices (N, m, k) and vectors (N, k)."""
    return (matrix @ vector[..., None])[..., 0]


def _cross(p: np.ndarray) -> np.ndarray:
    """Return the matrices [p]x (N, 3, 3) with [p]x y = p x y, of p (N, 3)."""
    x, y, z = p.T
    none = np.zeros(len(p))
    return np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(-1, 3, 3)
