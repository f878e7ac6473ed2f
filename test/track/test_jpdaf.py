"""The filter against the textbook Kalman filter, the paper's formula and its own covariance."""

import numpy as np
from scipy.stats import chi2

from startracker_ros.track.jpdaf import predict, update
from startracker_ros.track.motion_models import constant_velocity

H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])


def some_tracks(rng, count):
    root = rng.normal(0, 1, (count, 4, 4))
    return rng.uniform(0, 100, (count, 4)), root @ np.swapaxes(root, 1, 2)


def test_one_certain_centroid_is_a_kalman_update():
    state, covariance = some_tracks(np.random.default_rng(0), 2)
    uv, variance = state[:, [0, 2]] + [[0.3, -0.2], [1, 2]], np.array([0.04, 0.09])
    new_state, new_covariance = update(state, covariance, uv, variance,
                                       np.array([[0.0, 1, 0], [1, 0, 0]]))
    p, r = covariance[0], variance[0] * np.eye(2)
    gain = p @ H.T @ np.linalg.inv(H @ p @ H.T + r)
    np.testing.assert_allclose(new_state[0], state[0] + gain @ (uv[0] - H @ state[0]))
    joseph = np.eye(4) - gain @ H
    np.testing.assert_allclose(new_covariance[0], joseph @ p @ joseph.T + gain @ r @ gain.T,
                               atol=1e-9)
    # The other star was missed: its prediction stands.
    np.testing.assert_array_equal(new_state[1], state[1])
    np.testing.assert_allclose(new_covariance[1], covariance[1])


def test_spread_of_the_innovations_as_published():
    rng = np.random.default_rng(1)
    state, covariance = some_tracks(rng, 1)
    uv = state[:, [0, 2]] + rng.normal(0, 1, (3, 2))
    beta = np.array([[0.1, 0.5, 0.15, 0.25]])
    new_state, new_covariance = update(state, covariance, uv, np.full(3, 0.5), beta)
    p = covariance[0]
    s = H @ p @ H.T + 0.5 * np.eye(2)
    gain = p @ H.T @ np.linalg.inv(s)
    innovation = uv - H @ state[0]
    combined = beta[0, 1:] @ innovation
    spread = (innovation.T * beta[0, 1:]) @ innovation - np.outer(combined, combined)
    np.testing.assert_allclose(new_state[0], state[0] + gain @ combined)
    np.testing.assert_allclose(
        new_covariance[0], p - 0.9 * gain @ s @ gain.T + gain @ spread @ gain.T, atol=1e-9)


def test_covariance_is_consistent_with_constant_velocity_motion():
    """NEES of 200 stars that accelerate at random, after 60 frames of 0.1 s."""
    rng = np.random.default_rng(2)
    count, dt_s, acceleration, sigma_px = 200, 0.1, (0.8, 1.5), 0.15
    transition, noise = constant_velocity(dt_s, acceleration)
    truth = np.column_stack([rng.uniform(0, 1000, count), rng.normal(0, 20, count)] * 2)
    covariance = np.tile(np.diag([sigma_px ** 2, 4.0, sigma_px ** 2, 4.0]), (count, 1, 1))
    state = truth + rng.normal(0, np.sqrt(np.diag(covariance[0])), (count, 4))
    certain = np.column_stack([np.zeros(count), np.eye(count)])
    for _ in range(60):
        push = np.array([[dt_s ** 2 / 2, dt_s]])
        truth = truth @ transition.T + np.concatenate(
            [push * rng.normal(0, a, (count, 1)) for a in acceleration], axis=1)
        uv = truth[:, [0, 2]] + rng.normal(0, sigma_px, (count, 2))
        state, covariance = predict(state, covariance, transition, noise)
        state, covariance = update(state, covariance, uv, np.full(count, sigma_px ** 2), certain)
    error = state - truth
    nees = np.einsum('ni,nij,nj->n', error, np.linalg.inv(covariance), error).sum()
    assert chi2.ppf(0.001, 4 * count) < nees < chi2.ppf(0.999, 4 * count)


def test_covariance_stays_symmetric_and_positive():
    transition, noise = constant_velocity(0.1, (0.5, 0.5))
    state, covariance = np.zeros((1, 4)), np.eye(4)[None]
    rng = np.random.default_rng(3)
    for _ in range(3000):
        state, covariance = predict(state, covariance, transition, noise)
        state, covariance = update(state, covariance, rng.normal(0, 0.1, (2, 2)),
                                   np.array([0.01, 0.02]), np.array([[0.1, 0.6, 0.3]]))
    np.testing.assert_array_equal(covariance, np.swapaxes(covariance, 1, 2))
    assert np.linalg.eigvalsh(covariance[0]).min() > 0 and np.abs(covariance).max() < 1


def test_nothing_to_do():
    state, covariance = some_tracks(np.random.default_rng(4), 3)
    after = update(state, covariance, np.empty((0, 2)), np.empty(0), np.ones((3, 1)))
    np.testing.assert_array_equal(after[0], state)
    np.testing.assert_allclose(after[1], covariance)
