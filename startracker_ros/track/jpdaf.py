"""The JPDA filter: prediction and update of many tracks at once.

state (N, 4) is [u, u_rate, v, v_rate], covariance (N, 4, 4); steps 1 and 7 to 9 of the
filter of Sadeghi, Sabahi and Saberali.
"""

import numpy as np

from startracker_ros.track.motion_models import POSITION


def predict(state: np.ndarray, covariance: np.ndarray, transition: np.ndarray,
            noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return state and covariance one step on, by transition (4, 4) and its noise (4, 4)."""
    return state @ transition.T, transition @ covariance @ transition.T + noise


def update(state: np.ndarray, covariance: np.ndarray, uv: np.ndarray, variance: np.ndarray,
           probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return state and covariance after centroids uv (M, 2) of variance (M,) px^2 per axis.

    probability (N, M + 1) as of joint_probabilities. Each track becomes the mean and
    covariance of the mixture of its single-centroid updates: with one variance for all
    centroids that is the combined innovation and its spread, with different ones it
    gives each centroid its own gain.
    """
    track, centroid = np.nonzero(probability[:, 1:])
    share = probability[track, centroid + 1]
    cross = covariance[track][:, :, POSITION]
    innovation_covariance = cross[:, POSITION] + variance[centroid, None, None] * np.eye(2)
    gain = cross @ np.linalg.inv(innovation_covariance)
    innovation = uv[centroid] - state[track][:, POSITION]
    step = np.einsum('kij,kj->ki', gain, innovation)
    mean_step = np.zeros_like(state)
    np.add.at(mean_step, track, share[:, None] * step)
    spread = step[:, :, None] * step[:, None] - gain @ np.swapaxes(cross, 1, 2)
    covariance = covariance - mean_step[:, :, None] * mean_step[:, None]
    np.add.at(covariance, track, share[:, None, None] * spread)
    # Rounding makes P unsymmetric, and what is unsymmetric would grow from frame to frame.
    return state + mean_step, (covariance + np.swapaxes(covariance, 1, 2)) / 2
