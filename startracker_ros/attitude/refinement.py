"""A rotation from two directions, and its least-squares refinement by all: compiled."""

import numpy as np

from startracker_ros.compiled import compiled


# Each step doubles the digits; a few arcseconds become rounding in two.
_MOST_STEPS = 5


@compiled
def triad(sensor, icrf, first, second):
    """Return the matrix (3, 3) to ICRF that fits two of the directions (N, 3), the first exactly.

    Black, AIAA Journal 2 (1964). The two must not be parallel.
    """
    frame, other = _frame(sensor, first, second), _frame(icrf, first, second)
    matrix = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                matrix[i, j] += other[k, i] * frame[k, j]
    return matrix


@compiled
def _frame(vectors, first, second):
    """Return three axes (3, 3): a vector, the normal of the plane of two, and across."""
    axes = np.empty((3, 3))
    for k in range(3):
        axes[0, k] = vectors[first, k]
        axes[2, k] = vectors[second, k]
    for row, a, b in ((1, 0, 2), (2, 0, 1)):
        x = axes[a, 1] * axes[b, 2] - axes[a, 2] * axes[b, 1]
        y = axes[a, 2] * axes[b, 0] - axes[a, 0] * axes[b, 2]
        z = axes[a, 0] * axes[b, 1] - axes[a, 1] * axes[b, 0]
        length = np.sqrt(x * x + y * y + z * z)
        axes[row, 0], axes[row, 1], axes[row, 2] = x / length, y / length, z / length
    return axes


@compiled
def refine(matrix, sensor, icrf, weight):
    """Turn a nearly right matrix (3, 3) to the best fit; return the covariance at unit weight.

    Gauss-Newton on sum w |sensor - matrix^T icrf|^2 (Wahba's problem) over unit vectors
    (N, 3) and weights (N,). The covariance (3, 3) about sensor axes is the inverse Fisher
    information (Shuster and Oh, J. Guid. Control 4, 1981, eq. 98) for weights 1 / sigma^2.
    A determinant of zero says that the rotation is not observable; it is returned too.
    """
    covariance = np.empty((3, 3))
    determinant = 0.0
    for _ in range(_MOST_STEPS):
        xx = xy = xz = yy = yz = zz = 0.0
        gx = gy = gz = 0.0
        for i in range(len(weight)):
            v, c, w = sensor[i], icrf[i], weight[i]
            sx = matrix[0, 0] * c[0] + matrix[1, 0] * c[1] + matrix[2, 0] * c[2]
            sy = matrix[0, 1] * c[0] + matrix[1, 1] * c[1] + matrix[2, 1] * c[2]
            sz = matrix[0, 2] * c[0] + matrix[1, 2] * c[1] + matrix[2, 2] * c[2]
            xx += w * (sy * sy + sz * sz)
            yy += w * (sx * sx + sz * sz)
            zz += w * (sx * sx + sy * sy)
            xy -= w * sx * sy
            xz -= w * sx * sz
            yz -= w * sy * sz
            gx += w * (v[1] * sz - v[2] * sy)
            gy += w * (v[2] * sx - v[0] * sz)
            gz += w * (v[0] * sy - v[1] * sx)
        covariance[0, 0] = yy * zz - yz * yz
        covariance[0, 1] = covariance[1, 0] = xz * yz - xy * zz
        covariance[0, 2] = covariance[2, 0] = xy * yz - xz * yy
        covariance[1, 1] = xx * zz - xz * xz
        covariance[1, 2] = covariance[2, 1] = xy * xz - xx * yz
        covariance[2, 2] = xx * yy - xy * xy
        determinant = (xx * covariance[0, 0] + xy * covariance[0, 1] + xz * covariance[0, 2])
        if determinant <= 0:
            return covariance, 0.0
        covariance /= determinant
        dx = covariance[0, 0] * gx + covariance[0, 1] * gy + covariance[0, 2] * gz
        dy = covariance[1, 0] * gx + covariance[1, 1] * gy + covariance[1, 2] * gz
        dz = covariance[2, 0] * gx + covariance[2, 1] * gy + covariance[2, 2] * gz
        _turn(matrix, dx, dy, dz)
        if dx * dx + dy * dy + dz * dz < 1e-20:
            break
    return covariance, determinant


@compiled
def _turn(matrix, dx, dy, dz):
    """Turn a matrix (3, 3) in place by a small rotation vector about its sensor axes."""
    # The half-angle tangent (Rodrigues) vector keeps the matrix a rotation, whatever the size.
    hx, hy, hz = dx / 2, dy / 2, dz / 2
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
def quaternion_from_matrix(matrix):
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
