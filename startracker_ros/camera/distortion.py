"""
The plumb_bob lens distortion of Brown (1966), as in OpenCV and sensor_msgs/CameraInfo.

The functions accept arrays; camera.lens compiles them by startracker_ros.compiled for single
points.
"""

from typing import Any

Terms = tuple[float, ...]
"""k1, k2, p1, p2, k3."""


def distort(terms: Terms, a: Any, b: Any) -> tuple[Any, Any]:
    """
    Return the distorted tangents x, y of the direction with x / z = a, y / z = b.

    x = a L + 2 p1 a b + p2 (r2 + 2 a2), y = b L + p1 (r2 + 2 b2) + 2 p2 a b with
    r2 = a2 + b2 and L = 1 + k1 r2 + k2 r4 + k3 r6.
    """
    k1, k2, p1, p2, k3 = terms
    r2 = a * a + b * b
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a),
            b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b)


def distortion_jacobian(terms: Terms, a: Any, b: Any) -> tuple[Any, Any, Any]:
    """Return dx/da, dx/db = dy/da and dy/db of distort()."""
    k1, k2, p1, p2, k3 = terms
    r2 = a * a + b * b
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    return (radial + slope * a * a + 2 * p1 * b + 6 * p2 * a,
            slope * a * b + 2 * (p1 * a + p2 * b),
            radial + slope * b * b + 6 * p1 * b + 2 * p2 * a)
