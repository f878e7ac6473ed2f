# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The camera model for compiled functions: pixels to directions and back.

A direction (x, y, z) has undistorted image coordinates (a, b), which the terms of distortion.py
distort; focal lengths and principal point make pixels of them.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.distortion import Terms
from startracker_ros.core.compiled import compiled


class Lens(NamedTuple):
    """
    Image size, focal lengths and principal point in px, distortion terms.

    distorted is whether any term is not zero; equidistant whether (a, b) is an angle; farthest_rad
    is that of distortion.farthest_angle().
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    terms: Terms
    distorted: bool
    equidistant: bool
    farthest_rad: float


# Errors of an inverse in focal lengths: none, and the largest one.
_EXACT, _LARGEST_ERROR = 1e-14, 1e-9
_MOST_STEPS = 60


@compiled
def plane_point(equidistant: bool, x: float, y: float, z: float) -> tuple[float, float]:
    """Return a, b of a direction; NaN where it has none: behind a camera, or straight back."""
    if equidistant:
        r = np.hypot(x, y)
        if r > 0:
            scale = np.arctan2(r, z) / r
            return scale * x, scale * y
        return (0.0, 0.0) if z > 0 else (np.nan, np.nan)
    if z > 0:
        return x / z, y / z
    return np.nan, np.nan


@compiled
def ray(equidistant: bool, a: float, b: float) -> tuple[float, float, float]:
    """Return the unit vector of undistorted coordinates a, b."""
    if equidistant:
        theta = np.hypot(a, b)
        scale = np.sin(theta) / theta if theta > 0 else 1.0
        return scale * a, scale * b, np.cos(theta)
    scale = 1 / np.sqrt(a * a + b * b + 1)
    return scale * a, scale * b, scale


@compiled
def distort(terms: Terms, a: float, b: float) -> tuple[float, float]:
    """Return the distorted coordinates of a, b: the equations of distortion.py."""
    k1, k2, p1, p2, k3, k4, d1, d2, d3 = terms
    s = a * a + b * b
    L = ((1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
         / (1 + s * (d1 + s * (d2 + s * d3))))
    return (a * L + 2 * p1 * a * b + p2 * (s + 2 * a * a),
            b * L + p1 * (s + 2 * b * b) + 2 * p2 * a * b)


@compiled
def distortion_jacobian(terms: Terms, a: float, b: float) -> tuple[float, float, float]:
    """Return dx/da, dx/db = dy/da and dy/db of x, y = distort()."""
    k1, k2, p1, p2, k3, k4, d1, d2, d3 = terms
    s = a * a + b * b
    D = 1 + s * (d1 + s * (d2 + s * d3))
    L = (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) / D
    dN_ds = k1 + s * (2 * k2 + s * (3 * k3 + s * 4 * k4))
    dD_ds = d1 + s * (2 * d2 + s * 3 * d3)
    slope = 2 * (dN_ds - L * dD_ds) / D
    return (L + slope * a * a + 2 * p1 * b + 6 * p2 * a,
            slope * a * b + 2 * (p1 * a + p2 * b),
            L + slope * b * b + 6 * p1 * b + 2 * p2 * a)


@compiled
def undistort(lens: Lens, x: float, y: float) -> tuple[float, float]:
    """
    Return the inverse of distort() at x, y, by Newton's method.

    NaN where a pixel has no direction: beyond the farthest angle, outside the image circle.
    """
    a, b = x, y
    if lens.equidistant:
        r = np.hypot(x, y)
        scale = _angle_at(lens, r) / r if r > 0 else 1.0
        return scale * x, scale * y
    for _ in range(20 if lens.distorted else 0):
        distorted_x, distorted_y = distort(lens.terms, a, b)
        ex, ey = distorted_x - x, distorted_y - y
        if max(abs(ex), abs(ey)) < _EXACT:
            break
        xx, cross, yy = distortion_jacobian(lens.terms, a, b)
        determinant = xx * yy - cross * cross
        a -= (yy * ex - cross * ey) / determinant
        b -= (xx * ey - cross * ex) / determinant
    return a, b


@compiled
def _angle_at(lens: Lens, r: float) -> float:
    """
    Return the angle to the axis at a distorted radius of an equidistant lens, NaN for none.

    The radius grows up to the farthest angle. A step of Newton's method that leaves the bounds
    found so far is one to their middle: near the edge of an image circle it would go far beyond.
    """
    k1, k2, _, _, k3, k4, _, _, _ = lens.terms
    low, high = 0.0, lens.farthest_rad
    theta, beyond = min(r, high), np.inf
    for _ in range(_MOST_STEPS):
        s = theta * theta
        beyond = theta * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) - r
        if abs(beyond) < _EXACT:
            break
        if beyond > 0:
            high = theta
        else:
            low = theta
        theta -= beyond / (1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4))))
        if not low < theta < high:
            theta = (low + high) / 2
    return theta if abs(beyond) < _LARGEST_ERROR else np.nan


@compiled
def project(lens: Lens, directions: np.ndarray) -> np.ndarray:
    """
    Return pixels (N, 2) of directions (N, 3) on sensor axes.

    NaN where plane_point() is, and beyond the farthest angle.
    """
    uv = np.empty((len(directions), 2))
    for i in range(len(directions)):
        a, b = plane_point(lens.equidistant, directions[i, 0], directions[i, 1],
                           directions[i, 2])
        if a * a + b * b > lens.farthest_rad ** 2:
            a = b = np.nan
        x, y = distort(lens.terms, a, b)
        uv[i, 0], uv[i, 1] = lens.fx * x + lens.cx, lens.fy * y + lens.cy
    return uv


@compiled
def undistorted(lens: Lens, uv: np.ndarray) -> np.ndarray:
    """Return the undistorted coordinates a, b (N, 2) of pixels (N, 2)."""
    plane = np.empty((len(uv), 2))
    for i in range(len(uv)):
        plane[i, 0], plane[i, 1] = undistort(lens, (uv[i, 0] - lens.cx) / lens.fx,
                                             (uv[i, 1] - lens.cy) / lens.fy)
    return plane


@compiled
def rays(equidistant: bool, plane: np.ndarray) -> np.ndarray:
    """Return the unit vectors (N, 3) of undistorted coordinates (N, 2)."""
    directions = np.empty((len(plane), 3))
    for i in range(len(plane)):
        directions[i, 0], directions[i, 1], directions[i, 2] = ray(equidistant, plane[i, 0],
                                                                   plane[i, 1])
    return directions
