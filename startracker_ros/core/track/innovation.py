# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The innovations of a frame of stars as one measurement of attitude or rate: compiled."""

import numpy as np
from startracker_ros.core.compiled import compiled


@compiled
def combined_innovation(predicted: np.ndarray, uv: np.ndarray, error: np.ndarray,
                        probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the mean (N, 2) and covariance (N, 2, 2) of each star's innovation, if detected.

    The moments of the mixture of the centroids uv (M, 2) of covariance error (M, 2, 2) about the
    predictions (N, 2) px, with beta_j = probability (N, M + 1) over 1 - beta_0:
    z = sum beta_j z_j, R = sum beta_j (R_j + z_j z_j^T) - z z^T. Zeros for a star that was surely
    missed.
    """
    z, R = np.zeros((len(predicted), 2)), np.zeros((len(predicted), 2, 2))
    for i in range(len(predicted)):
        detected = 1 - probability[i, 0]
        for j in range(len(uv)):
            beta = probability[i, j + 1]
            if beta > 0:
                beta /= detected
                u, v = uv[j, 0] - predicted[i, 0], uv[j, 1] - predicted[i, 1]
                z[i, 0] += beta * u
                z[i, 1] += beta * v
                R[i, 0, 0] += beta * (error[j, 0, 0] + u * u)
                R[i, 0, 1] += beta * (error[j, 0, 1] + u * v)
                R[i, 1, 1] += beta * (error[j, 1, 1] + v * v)
        R[i, 0, 0] -= z[i, 0] * z[i, 0]
        R[i, 0, 1] -= z[i, 0] * z[i, 1]
        R[i, 1, 1] -= z[i, 1] * z[i, 1]
        R[i, 1, 0] = R[i, 0, 1]
    return z, R


@compiled
def normal_equations(H: np.ndarray, z: np.ndarray, R: np.ndarray, weight: np.ndarray
                     ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the information (3, 3) and vector (3,) of weighted least squares.

    sum w H^T R^-1 H and sum w H^T R^-1 z of H (N, 2, 3), z (N, 2), R (N, 2, 2) and
    w = weight (N,). A star of weight 0 is skipped.
    """
    information, vector = np.zeros((3, 3)), np.zeros(3)
    for i in range(len(weight)):
        if weight[i] == 0:
            continue
        scale = weight[i] / (R[i, 0, 0] * R[i, 1, 1] - R[i, 0, 1] * R[i, 0, 1])
        uu, uv, vv = scale * R[i, 1, 1], -scale * R[i, 0, 1], scale * R[i, 0, 0]
        for row in range(3):
            u = H[i, 0, row] * uu + H[i, 1, row] * uv
            v = H[i, 0, row] * uv + H[i, 1, row] * vv
            vector[row] += u * z[i, 0] + v * z[i, 1]
            for column in range(3):
                information[row, column] += u * H[i, 0, column] + v * H[i, 1, column]
    return information, vector
