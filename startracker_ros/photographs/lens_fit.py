# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled functions of the fit of a lens to one image (learnt_lens.py).

A lens here is a camera model and an attitude q (4,). The parameters d (3,), a, b, g, h, k (1,)
change it: the attitude by a turn d about the sensor axes, the focal length by e^a, the pixel ratio
by e^b, the principal point by w (g, h), w the width, and k1 by k. Those of a fisheye have k (4,)
of k1 to k4.
"""

import numpy as np
from startracker_ros.core.camera.lens import (
    distort, distortion_errors, farthest_angle, Lens, plane_point, project, ray, shows, undistort)
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import (
    matrix_from_quaternion, sensor_directions, turned)
from startracker_ros.core.track.motion_models import image_flow

RADIAL = 7  # where k begins
LEAST_ERROR_PX = 0.1
_MOST_RADIAL = 4
_STEPS = 3  # of Gauss-Newton for each association
_SMALL_PX = 1e-3  # a smaller change is the last
# Points along each side at which a lens must not fold its image, and the largest error there.
_CHECKED, _MOST_ERROR = 9, 1e-9


@compiled
def changed(lens: Lens, q: np.ndarray, change: np.ndarray) -> tuple[Lens, np.ndarray]:
    """Return the lens and the attitude (4,) with their parameters changed by change (P,)."""
    a, b, g, h = change[3], change[4], change[5], change[6]
    k = np.zeros(_MOST_RADIAL)
    k[:len(change) - RADIAL] = change[RADIAL:]
    k1, k2, p1, p2, k3, k4, d1, d2, d3 = lens.terms
    terms = (k1 + k[0], k2 + k[1], p1, p2, k3 + k[2], k4 + k[3], d1, d2, d3)
    distorted = False
    for term in terms:
        distorted = distorted or term != 0
    return (Lens(lens.width, lens.height, lens.fx * np.exp(a), lens.fy * np.exp(a + b),
                 lens.cx + lens.width * g, lens.cy + lens.width * h, terms, distorted,
                 lens.equidistant, farthest_angle(lens.equidistant, terms)),
            turned(q, change[:3]))


@compiled
def drift(lens: Lens, start: Lens, count: int) -> np.ndarray:
    """Return the parameters (count,) of a lens relative to those of another, d being zero."""
    parameters = np.zeros(count)
    parameters[3] = np.log(lens.fx / start.fx)
    parameters[4] = np.log(lens.fy / start.fy) - parameters[3]
    parameters[5] = (lens.cx - start.cx) / start.width
    parameters[6] = (lens.cy - start.cy) / start.width
    k1, k2, _, _, k3, k4, _, _, _ = lens.terms
    start_k1, start_k2, _, _, start_k3, start_k4, _, _, _ = start.terms
    k = np.array([k1 - start_k1, k2 - start_k2, k3 - start_k3, k4 - start_k4])
    parameters[RADIAL:] = k[:count - RADIAL]
    return parameters


@compiled
def linearised(lens: Lens, q: np.ndarray, icrf: np.ndarray, count: int
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) of directions (N, 3), their derivatives (N, 2, count) by parameters."""
    sensor = sensor_directions(matrix_from_quaternion(q), icrf)
    pixel, partial = project(lens, sensor), np.zeros((len(icrf), 2, count))
    turn = np.empty((2, 3))
    for i in range(len(icrf)):
        x, y = plane_point(lens.equidistant, sensor[i, 0], sensor[i, 1], sensor[i, 2])
        image_flow(lens, x, y, turn)
        partial[i, :, :3] = turn
        partial[i, 0, 3], partial[i, 1, 3] = pixel[i, 0] - lens.cx, pixel[i, 1] - lens.cy
        partial[i, 1, 4] = partial[i, 1, 3]
        partial[i, 0, 5] = partial[i, 1, 6] = lens.width
        square = power = x * x + y * y
        for k in range(RADIAL, count):
            partial[i, 0, k], partial[i, 1, k] = lens.fx * x * power, lens.fy * y * power
            power *= square
    return pixel, partial


@compiled
def fit_lens(lens: Lens, q: np.ndarray, start: Lens, free: np.ndarray, icrf: np.ndarray,
             uv: np.ndarray, sigma_px: np.ndarray
             ) -> tuple[Lens, np.ndarray, np.ndarray, float]:
    """
    Return the lens fitted to stars icrf (N, 3) at uv (N, 2) px of errors sigma_px (N,).

    With it the attitude (4,), the covariance (P, P) of the parameters and the error per axis in
    px. free (P,) are the prior standard deviations of the parameters about those of start.
    """
    count, parameters, error_px = len(uv), len(free), 0.0
    prior = free ** -2.0
    covariance = np.diag(free ** 2)
    for _ in range(_STEPS):
        pixel, partial = linearised(lens, q, icrf, parameters)
        residual = uv - pixel
        square = np.sum(residual ** 2, axis=1)
        error_px = _error_px(square)
        information, gradient = np.diag(prior), -drift(lens, start, parameters) * prior
        for i in range(count):
            # A star that has left the image of this lens is of no use for the next one.
            if np.isnan(square[i]):
                continue
            variance = max(sigma_px[i] ** 2 + LEAST_ERROR_PX ** 2, error_px ** 2)
            weight = 1 / (variance * (1 + square[i] / (9 * variance)))
            for j in range(parameters):
                along, across = weight * partial[i, 0, j], weight * partial[i, 1, j]
                gradient[j] += along * residual[i, 0] + across * residual[i, 1]
                for k in range(parameters):
                    information[j, k] += along * partial[i, 0, k] + across * partial[i, 1, k]
        covariance = np.linalg.inv(information)
        change = covariance @ gradient
        lens, q = changed(lens, q, change)
        if np.abs(change[:3]).max() * lens.fx < _SMALL_PX:
            break
    return lens, q, covariance, error_px


@compiled
def _error_px(square: np.ndarray) -> float:
    """Return the error per axis of residuals of these squares (N,), NaN for none."""
    square = square[~np.isnan(square)]
    count = len(square)
    if not count:
        return 0.0
    # For two axes the median is 2 ln 2 variances; few stars have hardly any freedom left.
    freedom = max(1 - 4.0 / (2 * count), 0.2)
    return np.sqrt(np.median(square) / (2 * np.log(2)) / freedom)


@compiled
def folds(lens: Lens) -> bool:
    """Return whether a lens folds its image over itself, or is none at all."""
    if not (lens.fx > 0 and lens.fy > 0):
        return True
    pixel = np.empty((_CHECKED * _CHECKED, 2))
    for i in range(_CHECKED):
        for j in range(_CHECKED):
            pixel[i * _CHECKED + j, 0] = i * (lens.width - 1) / (_CHECKED - 1)
            pixel[i * _CHECKED + j, 1] = j * (lens.height - 1) / (_CHECKED - 1)
    error, determinant = distortion_errors(lens, pixel)
    return not (error < _MOST_ERROR and determinant > 0)


@compiled
def stars_in_image(lens: Lens, q: np.ndarray, icrf: np.ndarray
                   ) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices (M,) of the directions (N, 3) in the image, and pixels (M, 2)."""
    matrix, least = matrix_from_quaternion(q), _least_cosine(lens)
    index, pixel = np.empty(len(icrf), np.int64), np.empty((len(icrf), 2))
    count = 0
    for i in range(len(icrf)):
        x, y, z = icrf[i, 0], icrf[i, 1], icrf[i, 2]
        along = matrix[0, 2] * x + matrix[1, 2] * y + matrix[2, 2] * z
        # Farther off a distortion may fold back into the image.
        if along < least:
            continue
        a, b = plane_point(lens.equidistant,
                           matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0] * z,
                           matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1] * z, along)
        a, b = distort(lens.terms, a, b)
        u, v = lens.fx * a + lens.cx, lens.fy * b + lens.cy
        if shows(lens, u, v):
            index[count], pixel[count, 0], pixel[count, 1] = i, u, v
            count += 1
    return index[:count].copy(), pixel[:count].copy()


@compiled
def _least_cosine(lens: Lens) -> float:
    """Return the cosine of the largest angle between the axis and a corner of the image."""
    least = 1.0
    for u in (-0.5, lens.width - 0.5):
        for v in (-0.5, lens.height - 0.5):
            a, b = undistort(lens, (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy)
            # Outside the circle of a fisheye.
            least = min(least, np.cos(lens.farthest_rad) if np.isnan(a)
                        else ray(lens.equidistant, a, b)[2])
    return least
