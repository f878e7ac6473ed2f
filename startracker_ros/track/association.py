"""Joint probabilistic data association (JPDA): which centroid belongs to which track.

Weights and probabilities are (tracks, centroids + 1): column 0 is the hypothesis that the
star was missed. Steps 2 to 6 of the filter of Sadeghi, Sabahi and Saberali, with false
centroids as a Poisson process of known density (Bar-Shalom and Fortmann 1988) instead
of phi! / V^phi: then clusters of tracks without a common centroid are independent.
"""

from collections.abc import Iterator

import numpy as np

MAX_EVENTS = 2000
"""Most joint events held per cluster. Twelve stars that all share all gates would have
10^13; the least probable ones are let go track by track, so that time and memory stay bounded."""


def gate_size(probability: float) -> float:
    """Return the squared Mahalanobis distance in two dimensions not exceeded with probability."""
    return -2 * np.log1p(-probability)


def gated_density(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray,
                  variance: np.ndarray, gate: float) -> np.ndarray:
    """Return the density (N, M) per px^2 of centroids about predictions, 0 outside the gate.

    predicted (N, 2) px with covariance (N, 2, 2); centroids uv (M, 2) with variance (M,)
    per axis; gate is a squared Mahalanobis distance.
    """
    du = uv[:, 0] - predicted[:, :1]
    dv = uv[:, 1] - predicted[:, 1:]
    uu = covariance[:, 0, 0, None] + variance
    vv = covariance[:, 1, 1, None] + variance
    cross = covariance[:, 0, 1, None]
    determinant = uu * vv - cross * cross
    distance2 = (vv * du * du - 2 * cross * du * dv + uu * dv * dv) / determinant
    return np.where(distance2 <= gate,
                    np.exp(-distance2 / 2) / (2 * np.pi * np.sqrt(determinant)), 0.0)


def event_weights(density: np.ndarray, detection_probability: float, gate_probability: float,
                  clutter_px2: float) -> np.ndarray:
    """Return the factors (N, M + 1) of joint events, relative to every centroid being false."""
    weight = np.empty((density.shape[0], density.shape[1] + 1))
    weight[:, 0] = 1 - detection_probability * gate_probability
    weight[:, 1:] = density * (detection_probability / clutter_px2)
    return weight


def joint_probabilities(weight: np.ndarray) -> np.ndarray:
    """Return the association probabilities (N, M + 1) of event weights (N, M + 1).

    A joint event gives each track one centroid or none and each centroid to one track at
    most; its probability is proportional to the product of its weights. Exact, up to
    MAX_EVENTS events in a cluster of tracks that share centroids.
    """
    probability = weight / weight.sum(axis=1, keepdims=True)
    gated = weight[:, 1:] > 0
    contested = gated & (gated.sum(axis=0) > 1)
    for tracks in _clusters(contested):
        columns = np.flatnonzero(np.append(True, gated[tracks].any(axis=0)))
        cell = np.ix_(tracks, columns)
        probability[cell] = _enumerate(probability[cell])
    return probability


def _clusters(contested: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the indices of tracks that are linked through contested centroids (N, M)."""
    waiting = contested.any(axis=1)
    while waiting.any():
        cluster = np.zeros(len(waiting), bool)
        grown = cluster.copy()
        grown[np.argmax(waiting)] = True
        while (grown != cluster).any():
            cluster = grown
            grown = cluster | contested[:, contested[cluster].any(axis=0)].any(axis=1)
        waiting &= ~cluster
        yield np.flatnonzero(cluster)


def _enumerate(weight: np.ndarray) -> np.ndarray:
    """Return joint_probabilities of one cluster by listing its events, track by track."""
    events = np.ones(1)
    taken = np.zeros((1, weight.shape[1]), bool)
    choices = np.empty((1, 0), int)
    for row in weight:
        possible = np.flatnonzero(row)
        event, chosen = np.nonzero(~taken[:, possible])
        chosen = possible[chosen]
        product = events[event] * row[chosen]
        if len(product) > MAX_EVENTS:
            best = np.argpartition(product, -MAX_EVENTS)[-MAX_EVENTS:]
            event, chosen, product = event[best], chosen[best], product[best]
        events = product / product.max()
        taken = taken[event]
        taken[np.arange(len(event)), chosen] = True
        taken[:, 0] = False
        choices = np.column_stack([choices[event], chosen])
    events /= events.sum()
    return np.array([np.bincount(choice, events, weight.shape[1]) for choice in choices.T])
