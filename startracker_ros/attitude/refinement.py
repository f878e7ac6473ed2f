"""The best fit from a nearly right rotation, its covariance and its residuals: compiled."""

import numpy as np
from startracker_ros.compiled import compiled


# Each step doubles the digits; a few arcseconds become rounding in two.
_CONVERGED = 5

MIN_GAP = 1e-12
"""Least gap of the eigenvalues, as of davenport(), that is observable. Below it double precision
no longer holds the third axis: rounding alone (2e-16) would turn it by 2e-4 rad. Two
stars of equal weight reach it 0.3 arcsec apart."""


@compiled
def refine(matrix: np.ndarray, sensor: np.ndarray, icrf: np.ndarray, weight: np.ndarray,
           most_steps: int = _CONVERGED) -> tuple[np.ndarray, float]:
    """
    Turn a nearly right matrix (3, 3) to the best fit; return the covariance at unit weight.

    At most so many steps of Gauss-Newton on sum w |sensor - matrix^T icrf|^2 (Wahba's problem)
    over unit vectors (N, 3) and weights (N,). Covariance and determinant are those of
    inverse_information().
    """
    covariance = np.empty((3, 3))
    determinant = 0.0
    for _ in range(most_steps):
        place = sensor_directions(matrix, icrf)
        covariance, determinant = inverse_information(place, weight)
        if determinant <= 0:
            return covariance, 0.0
        gx = gy = gz = 0.0
        for i in range(len(weight)):
            # Scalars alone: a view of a row costs more than the arithmetic with it.
            x, y, z, w = sensor[i, 0], sensor[i, 1], sensor[i, 2], weight[i]
            gx += w * (y * place[i, 2] - z * place[i, 1])
            gy += w * (z * place[i, 0] - x * place[i, 2])
            gz += w * (x * place[i, 1] - y * place[i, 0])
        dx = covariance[0, 0] * gx + covariance[0, 1] * gy + covariance[0, 2] * gz
        dy = covariance[1, 0] * gx + covariance[1, 1] * gy + covariance[1, 2] * gz
        dz = covariance[2, 0] * gx + covariance[2, 1] * gy + covariance[2, 2] * gz
        turn(matrix, dx / 2, dy / 2, dz / 2)
        if dx * dx + dy * dy + dz * dz < 1e-20:
            break
    return covariance, determinant


@compiled
def sensor_directions(matrix: np.ndarray, icrf: np.ndarray) -> np.ndarray:
    """Return where a matrix (3, 3) to ICRF has the stars icrf (N, 3) in the sensor frame."""
    place = np.empty((len(icrf), 3))
    for i in range(len(icrf)):
        x, y, z = icrf[i, 0], icrf[i, 1], icrf[i, 2]
        for k in range(3):
            place[i, k] = matrix[0, k] * x + matrix[1, k] * y + matrix[2, k] * z
    return place


@compiled
def inverse_information(directions: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Return the inverse Fisher information (3, 3) of unit vectors (N, 3), its determinant.

    The covariance about their axes for weights (N,) 1 / sigma^2 (Shuster and Oh, J. Guid.
    Control 4, 1981, eq. 98). A determinant of zero says that the rotation is not
    observable, by MIN_GAP; there is no inverse then.
    """
    xx = xy = xz = yy = yz = zz = 0.0
    for i in range(len(weight)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        w = weight[i]
        xx += w * (y * y + z * z)
        yy += w * (x * x + z * z)
        zz += w * (x * x + y * y)
        xy -= w * x * y
        xz -= w * x * z
        yz -= w * y * z
    inverse = np.empty((3, 3))
    inverse[0, 0] = yy * zz - yz * yz
    inverse[0, 1] = inverse[1, 0] = xz * yz - xy * zz
    inverse[0, 2] = inverse[2, 0] = xy * yz - xz * yy
    inverse[1, 1] = xx * zz - xz * xz
    inverse[1, 2] = inverse[2, 1] = xy * xz - xx * yz
    inverse[2, 2] = xx * yy - xy * xy
    determinant = xx * inverse[0, 0] + xy * inverse[0, 1] + xz * inverse[0, 2]
    # The least eigenvalue is half the gap, for weights whose sum is half the trace.
    minors = inverse[0, 0] + inverse[1, 1] + inverse[2, 2]
    if not determinant > MIN_GAP / 4 * (xx + yy + zz) * minors:
        return inverse, 0.0
    inverse /= determinant
    return inverse, determinant


@compiled
def residuals(sensor: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the angles (N,) in rad between unit vectors (N, 3) and their places (N, 3)."""
    angle = np.empty(len(sensor))
    for i in range(len(sensor)):
        square = 0.0
        for k in range(3):
            square += (sensor[i, k] - place[i, k]) ** 2
        # Of the chord: the cosine of a small angle has no digits left.
        angle[i] = 2 * np.arcsin(min(np.sqrt(square) / 2, 1.0))
    return angle


@compiled
def turn(matrix: np.ndarray, hx: float, hy: float, hz: float) -> None:
    """
    Turn a matrix (3, 3) in place about its sensor axes by a Rodrigues (Gibbs) vector.

    Its length is the tangent of half the angle: the matrix stays a rotation at any size.
    """
    scale = 2 / (1 + hx * hx + hy * hy + hz * hz)
    for i in range(3):
        a, b, c = matrix[i, 0], matrix[i, 1], matrix[i, 2]
        # Row times (I + scale ([h] + [h]^2)).
        px, py, pz = b * hz - c * hy, c * hx - a * hz, a * hy - b * hx
        qx, qy, qz = py * hz - pz * hy, pz * hx - px * hz, px * hy - py * hx
        matrix[i, 0] = a + scale * (px + qx)
        matrix[i, 1] = b + scale * (py + qy)
        matrix[i, 2] = c + scale * (pz + qz)


@compiled
def matrix_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,)."""
    x, y, z, w = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


@compiled
def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,), w >= 0, of a rotation matrix (3, 3) (Shepperd 1978)."""
    q = np.empty(4)
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    largest = 3
    value = trace
    for i in range(3):
        if matrix[i, i] > value:
            largest, value = i, matrix[i, i]
    if largest == 3:
        q[3] = 1 + trace
        q[0] = matrix[2, 1] - matrix[1, 2]
        q[1] = matrix[0, 2] - matrix[2, 0]
        q[2] = matrix[1, 0] - matrix[0, 1]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q[i] = 1 + 2 * matrix[i, i] - trace
        q[j] = matrix[j, i] + matrix[i, j]
        q[k] = matrix[k, i] + matrix[i, k]
        q[3] = matrix[k, j] - matrix[j, k]
    length = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    if q[3] < 0:
        length = -length
    return q / length
