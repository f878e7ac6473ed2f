# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Triangulation of targets from two lines of sight each.

Gao and Cui 2016: the target is at r = R_j + rho_j V_j. The cross product with V_j removes the
range: r x V_j = R_j x V_j. Errors e_R of the position and e_V of the direction move a line by
e_R + rho_j e_V, of which only the component across V_j matters.
"""

from typing import Any, NamedTuple

import numpy as np

(LOCATED, NOT_FINITE, NOT_UNIT, SHORT_BASELINE, PARALLEL, BEHIND_FIRST, BEHIND_SECOND,
 COVARIANCE) = range(8)
"""Status of a pair of lines."""

_ITERATIONS = 3
"""The second iteration has the ranges, the third removes the rounding errors of the second."""


class Triangulated(NamedTuple):
    """
    What N pairs of lines give; NaN where they do not locate a target.

    status (N,), target (N, 3) in m, covariance (N, 3, 3) in m^2, rho (N, 2), the ranges in m;
    sine (N,) of the angle between the lines, miss (N,), their smallest distance in m, and
    miss_sigma (N,).
    """

    status: np.ndarray
    target: np.ndarray
    covariance: np.ndarray
    rho: np.ndarray
    sine: np.ndarray
    miss: np.ndarray
    miss_sigma: np.ndarray


def triangulate(position: np.ndarray, direction: np.ndarray, covariance: np.ndarray,
                weighted: bool, min_baseline_m: float, min_sine: float) -> Triangulated:
    """
    Return where pairs of lines meet, of positions (N, 2, 3) m and unit vectors (N, 2, 3).

    covariance (N, 2, 6, 6) is that of position and direction.
    """
    status = np.full(len(position), LOCATED)

    def reject(wrong: Any, reason: int) -> None:
        status[wrong & (status == LOCATED)] = reason
    with np.errstate(all='ignore'):
        square = np.einsum('nji,nji->nj', direction, direction)
        for j in range(2):
            reject(~np.isfinite(np.column_stack([position[:, j], square[:, j]])).all(axis=1),
                   NOT_FINITE)
            reject(np.abs(square[:, j] - 1) > 1e-6, NOT_UNIT)
        # Relative to the first observer: rounding errors are smaller than in geocentric positions.
        R = position - position[:, :1]
        reject(np.linalg.norm(R[:, 1], axis=1) < min_baseline_m, SHORT_BASELINE)
        normal = np.cross(direction[:, 0], direction[:, 1])
        sine = np.linalg.norm(normal, axis=1)
        reject(sine < min_sine, PARALLEL)
        W = np.eye(3) - direction[..., None] * direction[..., None, :]
        r, N_inverse, _ = _least_squares_step(R, W, np.zeros((len(R), 3)))
        r, N_inverse, _ = _least_squares_step(R, W, r)
        for _ in range(_ITERATIONS):
            rho = np.einsum('nji,nji->nj', direction, r[:, None] - R)
            S = _line_covariance(covariance, rho[..., None, None])
            reject(rho[:, 0] <= 0, BEHIND_FIRST)
            reject(rho[:, 1] <= 0, BEHIND_SECOND)
            if not weighted:
                break
            W, is_positive = _information_across(direction, S)
            reject(~is_positive.all(axis=1), COVARIANCE)
            r, N_inverse, is_positive = _least_squares_step(R, W, r)
            reject(~is_positive, COVARIANCE)
        # The covariance of r is sum_j N^-1 W_j S_j W_j N^-1.
        gain = N_inverse[:, None] @ W
        r_covariance = (gain @ S @ np.swapaxes(gain, -1, -2)).sum(axis=1)
        target = position[:, 0] + r
        reject(~((np.diagonal(r_covariance, axis1=1, axis2=2) >= 0) & np.isfinite(target)).all(
            axis=1), COVARIANCE)
        normal /= sine[:, None]
        miss = np.abs(np.einsum('ni,ni->n', normal, R[:, 1]))
        variance = np.einsum('ni,nik,nk->n', normal, S.sum(axis=1), normal)
        found = Triangulated(status, target, r_covariance, rho, sine, miss,
                             np.sqrt(np.maximum(variance, 0.0)))
    for values in found[1:]:
        if values is not sine:
            values[status != LOCATED] = np.nan
    return found


def _line_covariance(covariance: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Return S (N, 2, 3, 3), that of e_R + rho e_V."""
    both = covariance[..., :3, 3:] + covariance[..., 3:, :3]
    return covariance[..., :3, :3] + rho * (both + rho * covariance[..., 3:, 3:])


def _information_across(v: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the inverses (N, 2, 3, 3) of S across unit vectors v (N, 2, 3), and which are positive.

    With rows a, b across v they are B' (B S B')^-1 B, B = [a; b].
    """
    a = np.cross(v, np.eye(3)[np.abs(v).argmin(axis=-1)])
    a /= np.linalg.norm(a, axis=-1, keepdims=True)
    B = np.stack([a, np.cross(v, a)], axis=-2)
    M = B @ S @ np.swapaxes(B, -1, -2)
    aa, ab, bb = M[..., 0, 0], M[..., 0, 1], M[..., 1, 1]
    determinant = aa * bb - ab * ab
    inverse = np.stack([bb, -ab, -ab, aa], axis=-1).reshape(M.shape) / determinant[
        ..., None, None]
    return np.swapaxes(B, -1, -2) @ inverse @ B, (aa > 0) & (determinant > 0)


def _least_squares_step(R: np.ndarray, W: np.ndarray, r: np.ndarray
                        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return r (N, 3) that minimises sum_j (R_j - r)' W_j (R_j - r), N^-1, and where N is positive.

    A step from r: r + N^-1 sum_j W_j (R_j - r) with N = W_1 + W_2. W_j is first the projection
    across V_j, then the inverse of the covariance across V_j, which depends on the range
    rho_j = V_j . (r - R_j).
    """
    N = W.sum(axis=1)
    # By cofactors: a singular matrix raises nothing.
    cofactor = np.cross(N[:, [1, 2, 0]], N[:, [2, 0, 1]])
    determinant = np.einsum('ni,ni->n', N[:, 0], cofactor[:, 0])
    inverse = np.swapaxes(cofactor, 1, 2) / determinant[:, None, None]
    gradient = np.einsum('njik,njk->ni', W, R - r[:, None])
    return r + np.einsum('nik,nk->ni', inverse, gradient), inverse, determinant > 0
