# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small vectors and symmetric matrices, compiled: a fraction of the time of LAPACK."""

import numpy as np
from startracker_ros.core.compiled import compiled


@compiled
def cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float
          ) -> tuple[float, float, float]:
    """Return a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@compiled
def adjugate(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
             ) -> tuple[float, float, float, float, float, float]:
    """Return the elements xx, xy, xz, yy, yz, zz of adj(A) = det(A) A^-1, A symmetric."""
    return (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
            xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy)


@compiled
def inverse(A: np.ndarray) -> np.ndarray:
    """Return adj(A) / det(A) (3, 3) of the upper left block of A; not finite if singular."""
    xx, xy, xz, yy, yz, zz = adjugate(A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2])
    scale = 1 / (A[0, 0] * xx + A[0, 1] * xy + A[0, 2] * xz)
    return np.array(((xx * scale, xy * scale, xz * scale), (xy * scale, yy * scale, yz * scale),
                     (xz * scale, yz * scale, zz * scale)))


@compiled
def determinant(A: np.ndarray) -> float:
    """Return the determinant of the upper left block of A."""
    xx, xy, xz = adjugate(A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2])[:3]
    return A[0, 0] * xx + A[0, 1] * xy + A[0, 2] * xz


@compiled
def product(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return A B of A (n, m) and B (m, k)."""
    after = np.zeros((len(A), B.shape[1]))
    for i in range(len(A)):
        for j in range(len(B)):
            for k in range(B.shape[1]):
                after[i, k] += A[i, j] * B[j, k]
    return after


@compiled
def times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return A x of A (n, m) and x (m,)."""
    after = np.zeros(len(A))
    for i in range(len(A)):
        for j in range(len(x)):
            after[i] += A[i, j] * x[j]
    return after


@compiled
def inner(x: np.ndarray, y: np.ndarray) -> float:
    """Return x^T y of x, y (n,)."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@compiled
def inverse_and_determinant(A: np.ndarray) -> tuple[np.ndarray, float]:
    """Return those of A (n, n), by Gauss and Jordan with pivots; not finite if singular."""
    n, left, right, product = len(A), A.copy(), np.eye(len(A)), 1.0
    for column in range(n):
        pivot = column
        for row in range(column + 1, n):
            if abs(left[row, column]) > abs(left[pivot, column]):
                pivot = row
        if pivot != column:
            product = -product
            for k in range(n):
                left[column, k], left[pivot, k] = left[pivot, k], left[column, k]
                right[column, k], right[pivot, k] = right[pivot, k], right[column, k]
        product *= left[column, column]
        scale = 1 / left[column, column]
        for k in range(n):
            left[column, k] *= scale
            right[column, k] *= scale
        for row in range(n):
            factor = left[row, column]
            if row != column and factor != 0:
                for k in range(n):
                    left[row, k] -= factor * left[column, k]
                    right[row, k] -= factor * right[column, k]
    return right, product


@compiled
def is_positive_definite(A: np.ndarray) -> bool:
    """Return whether the leading minors of the upper left block of A are positive (Sylvester)."""
    xx, xy, xz = adjugate(A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2])[:3]
    return (A[0, 0] > 0 and A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1] > 0
            and A[0, 0] * xx + A[0, 1] * xy + A[0, 2] * xz > 0)
