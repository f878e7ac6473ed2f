# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled steps of the filter in state.py, whose error state is [attitude, rate, drift, mounts].

With P (9 + M, 9 + M) its covariance, symmetric.
"""

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_quaternion import multiplied, rotation_between
from startracker_ros.core.maths.compiled_rotation import matrix_from_rotation_vector, turned
from startracker_ros.core.maths.small_algebra import adjugate

Transition = tuple[float, float, float, float]
"""a, b, c, d of F = [A a b; 0 c d; 0 0 1] in blocks of three, A = exp(-[turn]x)."""

Noise = tuple[float, float, float, float, float]
"""Diagonals of the blocks of Q: attitude, attitude and rate, rate, attitude and drift, drift."""


@compiled
def _transformed(P: np.ndarray, A: np.ndarray, F: Transition) -> np.ndarray:
    """Return F P, P (9 + M, K)."""
    a, b, c, d = F
    after = P.copy()
    for j in range(P.shape[1]):
        for i in range(3):
            after[i, j] = (A[i, 0] * P[0, j] + A[i, 1] * P[1, j] + A[i, 2] * P[2, j]
                           + a * P[3 + i, j] + b * P[6 + i, j])
            after[3 + i, j] = c * P[3 + i, j] + d * P[6 + i, j]
    return after


@compiled
def propagated(P: np.ndarray, turn: np.ndarray, F: Transition, Q: Noise, walk: np.ndarray
               ) -> np.ndarray:
    """Return F P F^T + Q after a turn (3,) rad; walk (M,) rad^2 are the variances of mounts."""
    A = matrix_from_rotation_vector(-turn)
    # P is symmetric: F (F P)^T is F P F^T.
    half = _transformed(P, A, F)
    after = _transformed(np.ascontiguousarray(half.T), A, F)
    for i in range(3):
        after[i, i] += Q[0]
        after[i, 3 + i] += Q[1]
        after[3 + i, i] += Q[1]
        after[3 + i, 3 + i] += Q[2]
        after[i, 6 + i] += Q[3]
        after[6 + i, i] += Q[3]
        after[6 + i, 6 + i] += Q[4]
    for i in range(len(walk)):
        after[9 + i, 9 + i] += walk[i]
    return after


@compiled
def with_body(P: np.ndarray, body: np.ndarray, F: np.ndarray, walk: np.ndarray) -> np.ndarray:
    """Return P after a step in which the body has got a covariance (9, 9) by F (9, 9)."""
    after, size = P.copy(), len(body)
    after[:size, :size] = body
    for j in range(size, len(P)):
        for i in range(size):
            total = 0.0
            for k in range(size):
                total += F[i, k] * P[k, j]
            after[i, j] = after[j, i] = total
        after[j, j] += walk[j - size]
    return after


@compiled
def body_attitude(q: np.ndarray, sensor_from_body: np.ndarray, matrix: np.ndarray,
                  C: np.ndarray, B: np.ndarray, c: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return q_icrf_from_body (4,) by a head, and its covariance M C M^T (3, 3) about body axes.

    q (4,) is q_icrf_from_sensor, C (3, 3) its covariance about sensor axes; sensor_from_body (4,)
    and matrix (3, 3) M, body from sensor, are the mount, B c its misalignment.
    """
    after = multiplied(q, sensor_from_body)
    if len(c):
        misalignment = np.zeros(3)
        for i in range(3):
            for k in range(len(c)):
                misalignment[i] -= B[i, k] * c[k]
        after = turned(after, misalignment)
    half, covariance = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                half[i, j] += matrix[i, k] * C[k, j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                covariance[i, j] += half[i, k] * matrix[j, k]
    return after, covariance


@compiled
def innovation(q: np.ndarray, P: np.ndarray, measured: np.ndarray, R: np.ndarray, B: np.ndarray,
               first: int) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """
    Return z (3,), z^T S^-1 z, S^-1 (3, 3) and P H^T (9 + M, 3), S = H P H^T + R.

    H = [I 0 0 B], B (3, K) in the columns from first on; R (3, 3) is the covariance of measured.
    """
    cross, S = np.empty((len(P), 3)), R.copy()
    for i in range(len(P)):
        for j in range(3):
            total = P[i, j]
            for k in range(B.shape[1]):
                total += P[i, first + k] * B[j, k]
            cross[i, j] = total
    for i in range(3):
        for j in range(3):
            S[i, j] += cross[i, j]
            for k in range(B.shape[1]):
                S[i, j] += B[i, k] * cross[first + k, j]
    z = rotation_between(q, measured)
    xx, xy, xz, yy, yz, zz = adjugate(S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2])
    determinant = S[0, 0] * xx + S[0, 1] * xy + S[0, 2] * xz
    information = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))) / determinant
    nis = 0.0
    for i in range(3):
        for j in range(3):
            nis += z[i] * information[i, j] * z[j]
    return z, nis, information, cross


@compiled
def correction(P: np.ndarray, z: np.ndarray, information: np.ndarray, cross: np.ndarray
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return K z (9 + M,) and P - K S K^T, K = P H^T S^-1."""
    size = len(P)
    change, gain, after = np.zeros(size), np.zeros((size, 3)), np.empty((size, size))
    for i in range(size):
        for j in range(3):
            for k in range(3):
                gain[i, j] += cross[i, k] * information[k, j]
            change[i] += gain[i, j] * z[j]
    for i in range(size):
        for j in range(i + 1):
            total = P[i, j]
            for k in range(3):
                total -= gain[i, k] * cross[j, k]
            after[i, j] = after[j, i] = total
    return change, after
