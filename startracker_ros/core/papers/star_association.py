# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
JPDA of star-by-star filters: three factors of the false centroids, and confirmation by SNA.

Steps 2 to 6 of the filter of Sadeghi, Sabahi and Saberali.
"""

from functools import cache

import numpy as np
from startracker_ros.core.centroid.centroids import round_errors
from startracker_ros.core.track.association import (
    DetectionModel, event_weights, gated_density, joint_probabilities)


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
