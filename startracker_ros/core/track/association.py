# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Joint probabilistic data association (JPDA): which centroid belongs to which track.

Weights and probabilities are (tracks, centroids + 1): column 0 is the hypothesis that the
star was missed. Steps 2 to 6 of the filter of Sadeghi, Sabahi and Saberali, with false
centroids as a Poisson process of known density (Bar-Shalom and Fortmann 1988) instead
of phi! / V^phi: then clusters of tracks without a common centroid are independent.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.track.joint_events import marginals

MAX_STEPS = 1_000_000
"""Bound of the steps of a frame: pairings of track and shared centroid (missed counts as one)
times the states after each track (joint_events). Twelve stars that all share twelve
centroids, 10^10 events, are within it and exact. Beyond it only the most probable states
stay, so that no frame takes longer than some 0.1 s."""


class DetectionModel(NamedTuple):
    """
    Gate, probabilities of a detection, and the area of the image.

    gate is a squared Mahalanobis distance; gate_probability that of a detected star to be inside
    it; detection_probability that of a star to have a centroid; image_px2 is the area in which
    false centroids occur.
    """

    gate: float
    gate_probability: float
    detection_probability: float
    image_px2: float


@compiled
def associate(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray, error: np.ndarray,
              detection: DetectionModel) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the probabilities (N, M + 1), and the mask (M,) of the centroids in no gate.

    Arguments are those of gated_density(); the density of false centroids is
    that of the centroids in no gate.
    """
    density = _gated_density(predicted, covariance, uv, error, detection.gate)
    unassociated = np.ones(len(uv), np.bool_)
    # One more than counted: the density must be positive.
    clutter = 1
    for centroid in range(len(uv)):
        for track in range(len(predicted)):
            if density[track, centroid] > 0:
                unassociated[centroid] = False
        clutter += unassociated[centroid]
    weight = event_weights(density, detection.detection_probability, detection.gate_probability,
                           clutter / detection.image_px2)
    return marginals(weight, MAX_STEPS), unassociated


@compiled
def most_probable(probability: np.ndarray) -> np.ndarray:
    """Return the most probable centroid (N,) of each track, 0 where there is none at all."""
    best = np.zeros(len(probability), np.int64)
    for track in range(len(probability)):
        for centroid in range(1, probability.shape[1] - 1):
            if probability[track, centroid + 1] > probability[track, best[track] + 1]:
                best[track] = centroid
    return best


def gate_size(probability: float) -> float:
    """Return the squared Mahalanobis distance in two dimensions not exceeded with probability."""
    return -2 * np.log1p(-probability)


def gated_density(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray,
                  error: np.ndarray, gate: float) -> np.ndarray:
    """
    Return the density (N, M) per px^2 of centroids about predictions, 0 outside the gate.

    predicted (N, 2) px with covariance (N, 2, 2); centroids uv (M, 2) with covariance error
    (M, 2, 2); gate is a squared Mahalanobis distance. All finite, error positive definite,
    covariance positive semidefinite; the caller ensures it.
    """
    return _gated_density(np.ascontiguousarray(predicted), np.ascontiguousarray(covariance),
                          np.ascontiguousarray(uv), np.ascontiguousarray(error), gate)


@compiled
def _gated_density(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray,
                   error: np.ndarray, gate: float) -> np.ndarray:
    density = np.zeros((len(predicted), len(uv)))
    for track in range(len(predicted)):
        for centroid in range(len(uv)):
            du = uv[centroid, 0] - predicted[track, 0]
            uu = covariance[track, 0, 0] + error[centroid, 0, 0]
            # Outside on one axis is outside: true of most pairs.
            if du * du > gate * uu:
                continue
            dv = uv[centroid, 1] - predicted[track, 1]
            vv = covariance[track, 1, 1] + error[centroid, 1, 1]
            if dv * dv > gate * vv:
                continue
            cross = covariance[track, 0, 1] + error[centroid, 0, 1]
            determinant = uu * vv - cross * cross
            distance2 = (vv * du * du - 2 * cross * du * dv + uu * dv * dv) / determinant
            if distance2 <= gate:
                density[track, centroid] = (
                    np.exp(-distance2 / 2) / (2 * np.pi * np.sqrt(determinant)))
    return density


@compiled
def event_weights(density: np.ndarray, detection_probability: float, gate_probability: float,
                  clutter_px2: float) -> np.ndarray:
    """
    Return the factors (N, M + 1) of joint events, relative to every centroid being false.

    clutter_px2 > 0 is the density of false centroids per px^2; both probabilities are below 1.
    """
    weight = np.empty((density.shape[0], density.shape[1] + 1))
    weight[:, 0] = 1 - detection_probability * gate_probability
    weight[:, 1:] = density * (detection_probability / clutter_px2)
    return weight


def joint_probabilities(weight: np.ndarray) -> np.ndarray:
    """
    Return the association probabilities (N, M + 1) of event weights (N, M + 1).

    A joint event gives each track one centroid or none and each centroid to one track at
    most; its probability is proportional to the product of its weights. Exact, up to
    MAX_STEPS and joint_events.OPEN_CENTROIDS. Weights are finite and not negative, and
    positive in column 0.
    """
    return marginals(np.ascontiguousarray(weight), MAX_STEPS)
