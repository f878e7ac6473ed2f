# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Rotations, quaternions and celestial pointing.

Quaternions are Hamilton, order x, y, z, w, arrays of shape (4,) or (..., 4).
q_icrf_from_sensor rotates sensor-frame vectors into ICRF: v_icrf = R(q) v_sensor.
The sensor frame is optical: x right, y down, z along the boresight out of the lens.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# --- formulas of unit quaternions x, y, z, w (Hamilton): a number or an array per component ---
#
# The same functions serve arrays and single rotations.

Components = tuple[Any, Any, Any, Any]


def product(a: Any, b: Any) -> Components:
    """Return the Hamilton product a b: first the rotation b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz)


def matrix_rows(q: Any) -> tuple[tuple[Any, Any, Any], ...]:
    """Return the rows of the rotation matrix R(q)."""
    x, y, z, w = q
    return ((1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)))


def from_matrix(rows: Any) -> Components:
    """
    Return the quaternion, w >= 0, of the rows of one rotation matrix (Shepperd 1978).

    4 q q^T is linear in the matrix. Its row with the largest diagonal element is the
    quaternion up to scale, without loss of precision.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    largest = max(xx, yy, zz, xx + yy + zz)
    if xx == largest:
        x, y, z, w = 1 + xx - yy - zz, xy + yx, xz + zx, zy - yz
    elif yy == largest:
        x, y, z, w = xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx
    elif zz == largest:
        x, y, z, w = xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy
    else:
        x, y, z, w = zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz
    length = np.sqrt(x * x + y * y + z * z + w * w)
    if w < 0:
        length = -length
    return x / length, y / length, z / length, w / length


# --- arrays ---

ARCSEC = np.pi / (180 * 3600)
"""One second of arc in radians."""


def matrix_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    q = np.asarray(q, float)
    if q.ndim == 1:
        # Python's floats are several times faster than NumPy's for a single quaternion.
        return np.array(matrix_rows(q.tolist()))
    return np.moveaxis(np.array(matrix_rows(np.moveaxis(q, -1, 0))), (0, 1), (-2, -1))


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (4,), w >= 0, of one rotation matrix (3, 3)."""
    return np.array(from_matrix(np.asarray(matrix, float).tolist()))


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton product a b, (..., 4): first b, then a."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.ndim == b.ndim == 1:
        return np.array(product(a.tolist(), b.tolist()))
    return np.stack(product(np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)), -1)


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverse rotation of unit quaternions (..., 4)."""
    return np.asarray(q, float) * [-1.0, -1.0, -1.0, 1.0]


def rotate(q: np.ndarray, vectors: ArrayLike) -> np.ndarray:
    """Return R(q) v for one quaternion (4,) and vectors (3,) or (N, 3)."""
    return np.asarray(vectors, float) @ matrix_from_quaternion(q).T


def quaternion_from_rotation_vector(rotation: ArrayLike) -> np.ndarray:
    """
    Return quaternions (..., 4) of rotation vectors (..., 3) in rad.

    q = [v sin(a / 2) / a, cos(a / 2)] of a vector v of length a.
    """
    rotation = np.asarray(rotation, float)
    if rotation.ndim == 1:
        x, y, z = rotation.tolist()
        half = math.sqrt(x * x + y * y + z * z) / 2
        # The limit of sin(a / 2) / a at zero.
        scale = np.sin(half) / (2 * half) if half > 0 else 0.5
        return np.array((x * scale, y * scale, z * scale, np.cos(half)))
    halves = np.sqrt(np.sum(rotation ** 2, -1, keepdims=True)) / 2
    scales = np.full_like(halves, 0.5)
    np.divide(np.sin(halves), 2 * halves, out=scales, where=halves > 0)
    return np.concatenate([rotation * scales, np.cos(halves)], -1)


def rotation_vector_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Return rotation vectors (..., 3) in rad, length at most pi, of quaternions (..., 4)."""
    q = np.asarray(q, float)
    if q.ndim == 1:
        x, y, z, w = (-q if q[3] < 0 else q).tolist()
        sine = math.sqrt(x * x + y * y + z * z)
        scale = 2 * math.atan2(sine, w) / sine if sine > 0 else 2.0
        return np.array((x * scale, y * scale, z * scale))
    q = np.where(q[..., 3:] < 0, -q, q)
    sines = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angles = 2 * np.arctan2(sines, q[..., 3:])
    with np.errstate(invalid='ignore', divide='ignore'):
        scales = np.where(sines > 0, angles / sines, 2.0)
    return q[..., :3] * scales


def attitude_error(q_estimate: np.ndarray, q_truth: np.ndarray) -> np.ndarray:
    """
    Return the rotation vector (..., 3) in rad about sensor axes from truth to estimate.

    R(estimate) = R(truth) exp([error]x): x and y are cross-boresight, z is roll.
    """
    return rotation_vector_from_quaternion(multiply(conjugate(q_truth), q_estimate))


def turned(q: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return a quaternion (4,) after a turn by a rotation vector (3,) rad about sensor axes."""
    after = multiply(q, quaternion_from_rotation_vector(rotation))
    return after / np.sqrt(after @ after)


def mean_attitude(attitudes: np.ndarray) -> np.ndarray:
    """Return the mean (4,) of attitudes (K, 4) that are near each other, about the middle one."""
    middle = attitudes[len(attitudes) // 2]
    return turned(middle, attitude_error(attitudes, middle).mean(0))


def sign_continuous(q: np.ndarray, previous: np.ndarray | None) -> np.ndarray:
    """Return q or -q, whichever lies nearer to previous; with no previous, w >= 0."""
    reference = q[3] if previous is None else float(np.dot(q, previous))
    return -q if reference < 0 else q


def unit_from_radec(ra_rad: np.ndarray, dec_rad: np.ndarray) -> np.ndarray:
    """Return the unit vectors (..., 3) of right ascension and declination in rad."""
    ra_rad, dec_rad = np.asarray(ra_rad, float), np.asarray(dec_rad, float)
    return np.stack([np.cos(dec_rad) * np.cos(ra_rad),
                     np.cos(dec_rad) * np.sin(ra_rad),
                     np.sin(dec_rad)], -1)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles (...) in rad between unit vectors (..., 3), also small ones exactly."""
    return 2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=-1) / 2, 1.0))


def east_and_north(unit: np.ndarray) -> np.ndarray:
    """Return the unit vectors (..., 2, 3) to the east and north at unit vectors (..., 3)."""
    east = np.stack([-unit[..., 1], unit[..., 0], np.zeros(unit.shape[:-1])], -1)
    east /= np.linalg.norm(east, axis=-1, keepdims=True)
    return np.stack([east, np.cross(unit, east)], -2)


def radec_from_unit(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return right ascension in [0, 2 pi) and declination in rad of vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(unit, float), -1, 0)
    return np.arctan2(y, x) % (2 * np.pi), np.arctan2(z, np.hypot(x, y))


def quaternion_from_pointing(ra_rad: float, dec_rad: float, roll_rad: float) -> np.ndarray:
    """
    Return q_icrf_from_sensor (4,) of a boresight and a roll in rad.

    Roll is the position angle of image up (-y), from celestial north through east.
    """
    sin_ra, cos_ra = np.sin(ra_rad), np.cos(ra_rad)
    sin_dec, cos_dec = np.sin(dec_rad), np.cos(dec_rad)
    north = np.array([-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec])
    east = np.array([-sin_ra, cos_ra, 0.0])
    boresight = np.array([cos_dec * cos_ra, cos_dec * sin_ra, sin_dec])
    down = -(np.cos(roll_rad) * north + np.sin(roll_rad) * east)
    return quaternion_from_matrix(np.stack([np.cross(down, boresight), down, boresight], -1))


def quaternion_from_axes(z: np.ndarray, towards_y: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) of axes z, a unit vector, and y, in the plane of both vectors."""
    y = towards_y - z * (z @ towards_y)
    y /= np.linalg.norm(y)
    return quaternion_from_matrix(np.stack([np.cross(y, z), y, z], -1))


def pointing_from_quaternion(q: np.ndarray) -> tuple[float, float, float]:
    """Return right ascension and roll in [0, 2 pi) and declination, in rad."""
    matrix = matrix_from_quaternion(q)
    ra, dec = radec_from_unit(matrix[:, 2])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    up = -matrix[:, 1]
    return float(ra), float(dec), float(np.arctan2(up @ east, up @ north) % (2 * np.pi))


def random_attitude(rng: np.random.Generator) -> np.ndarray:
    """Return a quaternion (4,), uniformly distributed over all rotations."""
    q = rng.standard_normal(4)
    return q / np.linalg.norm(q)
