"""The camera model for compiled functions: pixels to directions."""

from typing import NamedTuple

import numpy as np
from startracker_ros.camera import distortion
from startracker_ros.compiled import compiled


class Lens(NamedTuple):
    """Image size, focal lengths and principal point in px, plumb_bob terms k1, k2, p1, p2, k3."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]


@compiled
def shows(lens: Lens, u: float, v: float) -> bool:
    """Return whether a pixel is in the image; False for NaN."""
    return -0.5 <= u <= lens.width - 0.5 and -0.5 <= v <= lens.height - 0.5


distort = compiled(distortion.distort)
distortion_jacobian = compiled(distortion.distortion_jacobian)


@compiled
def undistort(lens: Lens, x: float, y: float) -> tuple[float, float]:
    """Return the inverse of distort() at x, y, by Newton's method."""
    if lens.distortion == (0.0, 0.0, 0.0, 0.0, 0.0):
        return x, y
    a, b = x, y
    for _ in range(20):
        distorted_x, distorted_y = distort(lens.distortion, a, b)
        ex, ey = distorted_x - x, distorted_y - y
        if max(abs(ex), abs(ey)) < 1e-14:
            break
        xx, cross, yy = distortion_jacobian(lens.distortion, a, b)
        determinant = xx * yy - cross * cross
        a -= (yy * ex - cross * ey) / determinant
        b -= (xx * ey - cross * ex) / determinant
    return a, b


@compiled
def undistort_all(lens: Lens, tangent: np.ndarray) -> np.ndarray:
    """Return undistort() of points (N, 2)."""
    undistorted = np.empty_like(tangent)
    for i in range(len(tangent)):
        undistorted[i, 0], undistorted[i, 1] = undistort(lens, tangent[i, 0], tangent[i, 1])
    return undistorted
