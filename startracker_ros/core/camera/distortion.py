# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The distortion models of sensor_msgs/CameraInfo, as OpenCV defines them.

All are one function of undistorted image coordinates (a, b) of unit focal length. These are
x / z, y / z for plumb_bob (Brown 1966) and rational_polynomial, and theta (x, y) / sqrt(x2 + y2),
theta the angle to the optical axis, for equidistant (Kannala and Brandt 2006, cv2.fisheye). With
s = a2 + b2 and

    L = (1 + k1 s + k2 s2 + k3 s3 + k4 s4) / (1 + d1 s + d2 s2 + d3 s3)

the distorted coordinates are a L + 2 p1 a b + p2 (s + 2 a2), b L + p1 (s + 2 b2) + 2 p2 a b.
"""

import math
from typing import NamedTuple

import numpy as np

Terms = tuple[float, float, float, float, float, float, float, float, float]
"""k1, k2, p1, p2, k3, k4, d1, d2, d3."""


class DistortionModel(NamedTuple):
    """
    Names of the coefficients in the order of the messages, and whether (a, b) is an angle.

    limit_deg is the widest field of view, edge to edge, that the model can have.
    """

    coefficients: tuple[str, ...]
    equidistant: bool
    limit_deg: float


LARGEST_RAD = math.radians(175.0)
"""The largest angle of a pixel to the optical axis: straight back is not a direction."""

PLUMB_BOB, RATIONAL, EQUIDISTANT = 'plumb_bob', 'rational_polynomial', 'equidistant'
MODELS = {
    PLUMB_BOB: DistortionModel(('k1', 'k2', 'p1', 'p2', 'k3'), False, 170.0),
    RATIONAL: DistortionModel(('k1', 'k2', 'p1', 'p2', 'k3', 'd1', 'd2', 'd3'), False, 170.0),
    EQUIDISTANT: DistortionModel(('k1', 'k2', 'k3', 'k4'), True, 350.0)}
"""By the name in CameraInfo; its k4, k5, k6 of rational_polynomial are d1, d2, d3 here."""


def terms_of(model: str, coefficients: tuple[float, ...]) -> Terms:
    """Return all terms of the coefficients of a model."""
    value = dict(zip(MODELS[model].coefficients, map(float, coefficients)))
    k1, k2, p1, p2, k3, k4, d1, d2, d3 = (
        value.get(name, 0.0) for name in ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'd1', 'd2', 'd3'))
    return k1, k2, p1, p2, k3, k4, d1, d2, d3


_ANGLE_STEP_RAD = 1 / 256


def farthest_angle(model: str, coefficients: tuple[float, ...]) -> float:
    """
    Return the largest angle to the axis that has a pixel: beyond, an equidistant lens folds.

    Infinity for other lenses, which must not fold within their images.
    """
    if not MODELS[model].equidistant:
        return math.inf
    theta = np.arange(1, LARGEST_RAD / _ANGLE_STEP_RAD) * _ANGLE_STEP_RAD
    k1, k2, k3, k4 = coefficients
    slope = np.polyval([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1], theta ** 2)
    folded = np.flatnonzero(~(slope > 0))
    return float(theta[folded[0]] - _ANGLE_STEP_RAD) if len(folded) else LARGEST_RAD


def plane_points(equidistant: bool, directions: np.ndarray) -> np.ndarray:
    """
    Return the undistorted coordinates a, b (N, 2) of directions (N, 3).

    NaN where one has none: behind a camera, or straight back.
    """
    along = directions[:, 2:]
    with np.errstate(invalid='ignore', divide='ignore'):
        if not equidistant:
            return np.where(along > 0, directions[:, :2] / along, np.nan)
        across = np.hypot(directions[:, :1], directions[:, 1:2])
        ahead = np.where(along > 0, 1.0, np.nan)
        return directions[:, :2] * np.where(across > 0, np.arctan2(across, along) / across, ahead)


def rays(equidistant: bool, plane: np.ndarray) -> np.ndarray:
    """Return the unit vectors (N, 3) of undistorted coordinates (N, 2)."""
    theta = np.hypot(*plane.T)[:, None]
    if equidistant:
        # numpy.sinc is that of pi times its argument.
        return np.hstack([np.sinc(theta / np.pi) * plane, np.cos(theta)])
    return np.insert(plane, 2, 1.0, axis=1) / np.hypot(theta, 1)
