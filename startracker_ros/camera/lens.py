"""The camera model for compiled functions: between pixels and directions."""

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
    """Return whether a pixel lies in the image; NaN does not."""
    return -0.5 <= u <= lens.width - 0.5 and -0.5 <= v <= lens.height - 0.5


distort = compiled(distortion.distort)
distortion_jacobian = compiled(distortion.distortion_jacobian)


@compiled
def undistort(lens: Lens, x: float, y: float) -> tuple[float, float]:
    """Return x / z, y / z of the direction that the lens shows at x, y (Newton's method)."""
    if lens.distortion == (0.0, 0.0, 0.0, 0.0, 0.0):
        return x, y
    a, b = x, y
    for _ in range(20):
        at_x, at_y = distort(lens.distortion, a, b)
        ex, ey = at_x - x, at_y - y
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
    clear = np.empty_like(tangent)
    for i in range(len(tangent)):
        clear[i, 0], clear[i, 1] = undistort(lens, tangent[i, 0], tangent[i, 1])
    return clear
