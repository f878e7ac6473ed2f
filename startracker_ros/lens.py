"""The camera model for compiled functions: between pixels and directions."""

from typing import NamedTuple

import numpy as np
from startracker_ros.compiled import compiled


class Lens(NamedTuple):
    """Image size, focal lengths and principal point in px, plumb_bob distortion terms."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


@compiled
def shows(lens: Lens, u: float, v: float) -> bool:
    """Return whether a pixel lies in the image; NaN does not."""
    return -0.5 <= u <= lens.width - 0.5 and -0.5 <= v <= lens.height - 0.5


@compiled
def distort(lens: Lens, a: float, b: float) -> tuple[float, float]:
    """Return x, y where the lens shows the direction of x / z = a, y / z = b."""
    r2 = a * a + b * b
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    return (a * radial + 2 * lens.p1 * a * b + lens.p2 * (r2 + 2 * a * a),
            b * radial + lens.p1 * (r2 + 2 * b * b) + 2 * lens.p2 * a * b)


@compiled
def distortion_jacobian(lens: Lens, a: float, b: float) -> tuple[float, float, float]:
    """Return dx/da, dx/db = dy/da and dy/db of distort()."""
    r2 = a * a + b * b
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    slope = 2 * (lens.k1 + r2 * (2 * lens.k2 + r2 * 3 * lens.k3))
    return (radial + slope * a * a + 2 * lens.p1 * b + 6 * lens.p2 * a,
            slope * a * b + 2 * (lens.p1 * a + lens.p2 * b),
            radial + slope * b * b + 6 * lens.p1 * b + 2 * lens.p2 * a)


@compiled
def undistort(lens: Lens, x: float, y: float) -> tuple[float, float]:
    """Return x / z, y / z of the direction that the lens shows at x, y (Newton's method)."""
    if lens.k1 == lens.k2 == lens.p1 == lens.p2 == lens.k3 == 0:
        return x, y
    a, b = x, y
    for _ in range(20):
        at_x, at_y = distort(lens, a, b)
        ex, ey = at_x - x, at_y - y
        if max(abs(ex), abs(ey)) < 1e-14:
            break
        xx, cross, yy = distortion_jacobian(lens, a, b)
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
