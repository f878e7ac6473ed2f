"""
The JPDA filter: prediction and update of many tracks at once.

state (N, 4) is [u, u_rate, v, v_rate], covariance (N, 4, 4); steps 1 and 7 to 9 of the
filter of Sadeghi, Sabahi and Saberali. All is finite and covariances are positive semidefinite,
variances positive: that is for the caller to check, and what comes out is so, too.
"""

import numpy as np
from startracker_ros.compiled import compiled


def predict(state: np.ndarray, covariance: np.ndarray, transition: np.ndarray,
            noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return state and covariance one step on, by transition (4, 4) and its noise (4, 4).

    noise (N, 4, 4) gives each track its own.
    """
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
                # What is unsymmetric by rounding would grow from frame to frame.
                new_covariance[track, i, j] = new_covariance[track, j, i] = total
    return new_state, new_covariance


def update(state: np.ndarray, covariance: np.ndarray, uv: np.ndarray, variance: np.ndarray,
           probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return state and covariance after centroids uv (M, 2) of variance (M,) px^2 per axis.

    probability (N, M + 1) as of joint_probabilities. Each track becomes the mean and
    covariance of the mixture of its single-centroid updates: with one variance for all
    centroids that is the combined innovation and its spread, with different ones it
    gives each centroid its own gain.
    """
    return _update(np.ascontiguousarray(state), np.ascontiguousarray(covariance),
                   np.ascontiguousarray(uv), np.ascontiguousarray(variance),
                   np.ascontiguousarray(probability))


@compiled
def _update(state: np.ndarray, covariance: np.ndarray, uv: np.ndarray, variance: np.ndarray,
            probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    new_state, new_covariance = state.copy(), np.empty_like(covariance)
    gain, rest, half = np.empty((4, 2)), np.empty((4, 2)), np.empty((4, 4))
    mean_step, offset = np.empty(4), np.empty(4)
    for track in range(len(state)):
        prior, mixture = covariance[track], new_covariance[track]
        so_far = probability[track, 0]
        for i in range(4):
            mean_step[i] = 0.0
            for j in range(i + 1):
                mixture[i, j] = so_far * prior[i, j]
        for centroid in range(len(uv)):
            share = probability[track, centroid + 1]
            if share == 0:
                continue
            du = uv[centroid, 0] - state[track, 0]
            dv = uv[centroid, 1] - state[track, 2]
            uu, vv = prior[0, 0] + variance[centroid], prior[2, 2] + variance[centroid]
            cross = prior[0, 2]
            determinant = uu * vv - cross * cross
            newest = share / (so_far + share)
            for i in range(4):
                gain[i, 0] = (prior[i, 0] * vv - prior[i, 2] * cross) / determinant
                gain[i, 1] = (prior[i, 2] * uu - prior[i, 0] * cross) / determinant
                # Columns u and v of I - K H; the other two are those of I.
                rest[i, 0], rest[i, 1] = (i == 0) - gain[i, 0], (i == 2) - gain[i, 1]
                offset[i] = gain[i, 0] * du + gain[i, 1] * dv - mean_step[i]
                mean_step[i] += newest * offset[i]
            # Joseph's form, and the spread as Welford (1962) adds it up: differences of large
            # numbers would make the covariance negative where a prior is far wider than R.
            for i in range(4):
                for j in range(4):
                    half[i, j] = rest[i, 0] * prior[0, j] + rest[i, 1] * prior[2, j]
                    if i % 2:
                        half[i, j] += prior[i, j]
                for j in range(i + 1):
                    single = (
                        half[i, 0] * rest[j, 0] + half[i, 2] * rest[j, 1]
                        + variance[centroid] * (gain[i, 0] * gain[j, 0] + gain[i, 1] * gain[j, 1]))
                    if j % 2:
                        single += half[i, j]
                    mixture[i, j] += share * single + (
                        so_far * newest * offset[i] * offset[j])
            so_far += share
        for i in range(4):
            new_state[track, i] += mean_step[i]
            for j in range(i):
                mixture[j, i] = mixture[i, j]
    return new_state, new_covariance
