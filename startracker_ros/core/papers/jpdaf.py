# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The JPDA filter of Sadeghi, Sabahi and Saberali: prediction, association, update of many tracks.

state (N, 4) is [u, u_rate, v, v_rate], covariance (N, 4, 4). Arguments are finite, covariances
positive semidefinite and variances positive; the caller ensures it. The results are so, too.
"""

from functools import cache

import numpy as np
from startracker_ros.core.centroid.centroids import round_errors
from startracker_ros.core.compiled import compiled
from startracker_ros.core.track.association import (
    DetectionModel, event_weights, gated_density, joint_probabilities)

# --- prediction, step 1 ---


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


# --- association, steps 2 to 6: three factors of the false centroids, confirmation by SNA ---


def associate_stars(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray,
                    variance: np.ndarray, detection: DetectionModel, association: str,
                    confirmed: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the probabilities (N, M + 1), and the mask (M,) of the centroids in no gate.

    predicted (N, 2) px with covariance (N, 2, 2), centroids uv (M, 2) of variance (M,) px^2 per
    axis; association is one of options.ASSOCIATIONS. confirmed (N,) has the centroid of each star
    whose predicted place another test has confirmed, -1 for a star without, which is missed:
    only these centroids are associated, with any of the confirmed stars.
    """
    density = gated_density(predicted, covariance, uv, round_errors(variance), detection.gate)
    unassociated = np.logical_not(density.any(axis=0))
    if confirmed is not None:
        density[confirmed < 0] = 0
        density[:, ~np.isin(np.arange(len(uv)), confirmed)] = 0
    if association == 'diffuse':
        gates = gate_areas(covariance, variance, detection.gate)
        return diffuse_probabilities(density, detection, float(gates.sum())), unassociated
    # One more than counted: the density must be positive.
    clutter_px2: float = (1 + np.count_nonzero(unassociated)) / detection.image_px2
    if association == 'normalised':
        # Each row and each column of the matrix of sums over all events, missed stars and false
        # centroids included, has the same total: one division normalises rows and columns. Without
        # a factor for a false centroid the sums are those of a density of one per px^2.
        clutter_px2 = 1.0
    return joint_probabilities(_weights(density, detection, clutter_px2)), unassociated


def gate_areas(covariance: np.ndarray, variance: np.ndarray, gate: float) -> np.ndarray:
    """Return the areas (N,) in px^2 of gates about predictions, for the mean variance (M,)."""
    mean = np.mean(variance) if len(variance) else 0.0
    return np.pi * gate * np.sqrt(np.linalg.det(covariance + mean * np.eye(2)))


def diffuse_probabilities(density: np.ndarray, detection: DetectionModel, gates_px2: float
                          ) -> np.ndarray:
    """
    Return the association probabilities (N, M + 1) with the factor phi! / V^phi, V = gates_px2.

    density (N, M) as of gated_density(); phi counts the false ones of the centroids in a gate.
    phi! / V^phi is the integral of (x / V)^phi e^-x over x >= 0, so a sum over events is that
    of false centroids of the density x / V, integrated over x: that sum is a polynomial of x, for
    which the Gauss-Laguerre rule is exact.
    """
    gated = int(np.count_nonzero(density.any(axis=0)))
    if not gated:
        return joint_probabilities(_weights(density, detection, 1.0))
    probability, log_weight = [], []
    for x, node_weight in zip(*_gauss_laguerre(gated // 2 + 1)):
        weight = _weights(density, detection, x / gates_px2)
        probability.append(joint_probabilities(weight))
        log_weight.append(np.log(node_weight) + gated * np.log(x) + log_event_sum(weight))
    share = np.exp(np.array(log_weight) - max(log_weight))
    return np.tensordot(share / share.sum(), np.array(probability), 1)


@cache
def _gauss_laguerre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes and weights of the rule of that many nodes, without those that vanish."""
    # Takes long to import, and is needed for this factor only.
    from scipy.special import roots_laguerre
    nodes, weights = roots_laguerre(count)
    return nodes[weights > 0], weights[weights > 0]


def log_event_sum(weight: np.ndarray) -> float:
    """
    Return the logarithm of the sum over all joint events of the product of their weights.

    weight (N, M + 1) as of event_weights(). The event in which all stars that share a centroid
    are missed has a known product, and a probability: that of the first of them to be missed,
    times that of the second to be missed if the first is, and so on.
    """
    shared = weight[:, 1:][:, np.count_nonzero(weight[:, 1:], axis=0) > 1].any(axis=1)
    total = np.log(weight[~shared].sum(axis=1)).sum()
    rows = weight[shared]
    for first in range(len(rows)):
        total += np.log(rows[first, 0]) - np.log(joint_probabilities(rows[first:])[0, 0])
    return float(total)


def _weights(density: np.ndarray, detection: DetectionModel, clutter_px2: float) -> np.ndarray:
    return event_weights(density, detection.detection_probability, detection.gate_probability,
                         clutter_px2)


# --- update, steps 7 to 9 ---


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
