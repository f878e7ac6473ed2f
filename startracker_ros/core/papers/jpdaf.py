# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The JPDA filter: prediction and update of many tracks at once.

state (N, 4) is [u, u_rate, v, v_rate], covariance (N, 4, 4); steps 1 and 7 to 9 of the
filter of Sadeghi, Sabahi and Saberali. Arguments are finite, covariances positive semidefinite
and variances positive; the caller ensures it. The results are so, too.
"""

import numpy as np
from startracker_ros.core.compiled import compiled


def predict(state: np.ndarray, covariance: np.ndarray, transition: np.ndarray,
            noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return F x and F P F^T + Q of transition F (4, 4) and noise Q, (4, 4) or (N, 4, 4)."""
    return _predict(np.ascontiguousarray(state), np.ascontiguousarray(covariance),
                    np.ascontiguousarray(transition),
                    np.ascontiguousarray(noise).reshape(-1, 4, 4))


@compiled
def _predict(state: np.ndarray, covariance: np.ndarray, transition: np.ndarray, noise: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray]:
    new_state, new_covariance = np.zeros_like(state), np.empty_like(covariance)
    half = np.empty((4, 4))
    for track in range(len(state)):
        own_noise = noise[track if len(noise) > 1 else 0]
        for i in range(4):
            for j in range(4):
                new_state[track, i] += transition[i, j] * state[track, j]
                half[i, j] = 0.0
                for k in range(4):
                    half[i, j] += transition[i, k] * covariance[track, k, j]
        for i in range(4):
            for j in range(i + 1):
                total = own_noise[i, j]
                for k in range(4):
                    total += half[i, k] * transition[j, k]
                # An asymmetry by rounding would grow from frame to frame.
                new_covariance[track, i, j] = new_covariance[track, j, i] = total
    return new_state, new_covariance


def update(state: np.ndarray, covariance: np.ndarray, uv: np.ndarray, variance: np.ndarray,
           probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return state and covariance after centroids uv (M, 2) of variance (M,) px^2 per axis.

    probability (N, M + 1) as of joint_probabilities. Each track becomes the mean and
    covariance of the mixture of its single-centroid updates. With one variance for all
    centroids these are the combined innovation and the covariance of the innovations; with
    different ones each centroid has its own gain.
    """
    return _update(np.ascontiguousarray(state), np.ascontiguousarray(covariance),
                   np.ascontiguousarray(uv), np.ascontiguousarray(variance),
                   np.ascontiguousarray(probability))


@compiled
def _update(state: np.ndarray, covariance: np.ndarray, uv: np.ndarray, variance: np.ndarray,
            probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Add the updates of single centroids up, one after the other (Welford 1962).

    x_j = x + K_j z_j with covariance P_j; with B = beta_0 + .. + beta_j and d = x_j - mean:
    mean += beta_j / B d, B P += beta_j P_j + (B - beta_j) beta_j / B d d^T. Differences of large
    numbers would make the covariance negative where a prior is far wider than R.
    """
    new_state, new_covariance = state.copy(), np.empty_like(covariance)
    K, P_j = np.empty((4, 2)), np.empty((4, 4))
    mean, d = np.empty(4), np.empty(4)
    for track in range(len(state)):
        P, mixture = covariance[track], new_covariance[track]
        total = probability[track, 0]
        mean[:] = 0.0
        mixture[:] = total * P
        for centroid in range(len(uv)):
            beta = probability[track, centroid + 1]
            if beta == 0:
                continue
            _single_update(P, variance[centroid], K, P_j)
            du = uv[centroid, 0] - state[track, 0]
            dv = uv[centroid, 1] - state[track, 2]
            share = beta / (total + beta)
            for i in range(4):
                d[i] = K[i, 0] * du + K[i, 1] * dv - mean[i]
                mean[i] += share * d[i]
            for i in range(4):
                for j in range(i + 1):
                    mixture[i, j] += beta * P_j[i, j] + total * share * d[i] * d[j]
            total += beta
        for i in range(4):
            new_state[track, i] += mean[i]
            for j in range(i):
                mixture[j, i] = mixture[i, j]
    return new_state, new_covariance


@compiled
def _single_update(P: np.ndarray, variance: float, K: np.ndarray, P_j: np.ndarray) -> None:
    """
    Fill the gain K (4, 2) and the lower triangle of the covariance P_j (4, 4) of one centroid.

    H takes u and v out of the state: S = H P H^T + R, K = P H^T S^-1, and in Joseph's form
    P_j = (I - K H) P (I - K H)^T + K R K^T.
    """
    uu, cross, vv = P[0, 0] + variance, P[0, 2], P[2, 2] + variance
    determinant = uu * vv - cross * cross
    # Columns u and v of I - K H; the other two are those of I.
    rest, half = np.empty((4, 2)), np.empty((4, 4))
    for i in range(4):
        K[i, 0] = (P[i, 0] * vv - P[i, 2] * cross) / determinant
        K[i, 1] = (P[i, 2] * uu - P[i, 0] * cross) / determinant
        rest[i, 0], rest[i, 1] = (i == 0) - K[i, 0], (i == 2) - K[i, 1]
    for i in range(4):
        for j in range(4):
            half[i, j] = rest[i, 0] * P[0, j] + rest[i, 1] * P[2, j]
            if i % 2:
                half[i, j] += P[i, j]
        for j in range(i + 1):
            P_j[i, j] = (half[i, 0] * rest[j, 0] + half[i, 2] * rest[j, 1]
                         + variance * (K[i, 0] * K[j, 0] + K[i, 1] * K[j, 1]))
            if j % 2:
                P_j[i, j] += half[i, j]
