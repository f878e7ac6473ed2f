"""What all centroids together say about the common rotation of their stars: compiled."""

import numpy as np
from startracker_ros.compiled import compiled


@compiled
def expected(uv: np.ndarray, frame_uv: np.ndarray, variance: np.ndarray, probability: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the mean (N, 2) and spread (N, 3) of a star's centroid about its prediction (N, 2).

    Those of the mixture of the centroids (M, 2) of variance (M,) that it may have, given that
    it has one, by the probabilities (N, M + 1): what the JPDA filter does to one star, as a
    measurement that many stars can be corrected by. Spread is uu, uv, vv.
    """
    mean, spread = np.zeros((len(uv), 2)), np.zeros((len(uv), 3))
    for i in range(len(uv)):
        found = 1 - probability[i, 0]
        for j in range(len(frame_uv)):
            share = probability[i, j + 1]
            if share > 0:
                share /= found
                u, v = frame_uv[j, 0] - uv[i, 0], frame_uv[j, 1] - uv[i, 1]
                mean[i, 0] += share * u
                mean[i, 1] += share * v
                spread[i, 0] += share * (variance[j] + u * u)
                spread[i, 1] += share * u * v
                spread[i, 2] += share * (variance[j] + v * v)
        spread[i, 0] -= mean[i, 0] * mean[i, 0]
        spread[i, 1] -= mean[i, 0] * mean[i, 1]
        spread[i, 2] -= mean[i, 1] * mean[i, 1]
    return mean, spread


@compiled
def turn_asked_for(jacobian: np.ndarray, mean: np.ndarray, spread: np.ndarray, weight: np.ndarray,
                   votes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the information (3, 3) and vector (3,) of AttitudeState.with_attitude.

    jacobian (N, 2, 3) in px/rad, mean and spread of expected(), weight (N,); only the stars
    that votes (N,) count.
    """
    information, vector = np.zeros((3, 3)), np.zeros(3)
    for i in range(len(votes)):
        if not votes[i]:
            continue
        scale = weight[i] / (spread[i, 0] * spread[i, 2] - spread[i, 1] * spread[i, 1])
        uu, vv, cross = scale * spread[i, 2], scale * spread[i, 0], -scale * spread[i, 1]
        for row in range(3):
            u = jacobian[i, 0, row] * uu + jacobian[i, 1, row] * cross
            v = jacobian[i, 0, row] * cross + jacobian[i, 1, row] * vv
            vector[row] += u * mean[i, 0] + v * mean[i, 1]
            for column in range(3):
                information[row, column] += u * jacobian[i, 0, column] + v * jacobian[
                    i, 1, column]
    return information, vector
