# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The filter against the textbook Kalman filter, the paper's formula and its own covariance."""

from native_bank import coordinated_turn, predict, update
import numpy as np
import pytest
from scipy.stats import chi2
from startracker_ros.core.native import NativeError
from startracker_ros.core.track.association import DetectionModel, StarFilter
from startracker_ros.core.track.motion_models import constant_velocity

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


def test_covariance_of_the_innovations_as_published():
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
    scatter = (innovation.T * beta[0, 1:]) @ innovation - np.outer(combined, combined)
    np.testing.assert_allclose(new_state[0], state[0] + gain @ combined)
    np.testing.assert_allclose(
        new_covariance[0], p - 0.9 * gain @ s @ gain.T + gain @ scatter @ gain.T, atol=1e-9)


def test_prediction():
    state, covariance = some_tracks(np.random.default_rng(5), 3)
    transition, noise = coordinated_turn(0.3, 0.7, (0.5, 2.0))
    new_state, new_covariance = predict(state, covariance, transition, noise)
    np.testing.assert_allclose(new_state, state @ transition.T)
    np.testing.assert_allclose(new_covariance, transition @ covariance @ transition.T + noise)


@pytest.mark.parametrize('transition, noise', [
    constant_velocity(0.1, (0.8, 1.5)), coordinated_turn(0.1, 0.9, (0.3, 0.5))])
def test_covariance_is_consistent(transition, noise):
    """NEES of 300 stars among false centroids, now and then missed, after 60 frames."""
    rng = np.random.default_rng(2)
    count, variance, seen, gate_probability = 300, 0.15 ** 2, 0.9, 0.9999
    false_points, side_px = 60, 1500
    # Too far apart to be mistaken for each other: each is a run of its own.
    u, v = (place.ravel()[:count] for place in np.meshgrid(*[np.arange(40, side_px, 80)] * 2))
    truth = np.column_stack([u, rng.normal(0, 2, count), v, rng.normal(0, 2, count)])
    covariance = np.tile(np.diag([variance, 4.0, variance, 4.0]), (count, 1, 1))
    state = truth + rng.normal(0, np.sqrt(np.diag(covariance[0])), (count, 4))
    root = np.linalg.cholesky(noise + 1e-15 * np.eye(4))
    tracks = StarFilter(DetectionModel(
        gate_probability, seen, side_px ** 2, false_points / side_px ** 2), state, covariance,
        count + false_points)
    for _ in range(60):
        truth = truth @ transition.T + rng.normal(0, 1, (count, 4)) @ root.T
        uv = truth[rng.random(count) < seen][:, ::2]
        uv = np.concatenate([uv + rng.normal(0, variance ** 0.5, uv.shape),
                             rng.uniform(0, side_px, (false_points, 2))])
        tracks.step(transition, noise, uv, np.full(len(uv), variance))
    state, covariance = tracks.state, tracks.covariance
    error = state - truth
    nees = np.einsum('ni,nij,nj->n', error, np.linalg.inv(covariance), error).sum()
    assert chi2.ppf(0.025, 4 * count) < nees < chi2.ppf(0.975, 4 * count)


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


def test_covariance_stays_positive_from_an_uninformative_prior():
    """A million px before, a thousandth of a px after: 10^18 times less variance."""
    covariance = 1e12 * (np.eye(4) + 0.5)[None]
    state, uv = np.array([[5.0, 0, 5, 0]]), np.array([[3.0, 4.0], [3.0, 4.002]])
    for share in ([0.0, 1, 0], [0.0, 0.5, 0.5]):
        after = update(state, covariance, uv, np.full(2, 1e-6), np.array([share]))[1][0]
        assert np.linalg.eigvalsh(after[::2, ::2]).min() > 0.9e-6 and after[0, 0] < 3e-6


def test_nothing_to_do():
    state, covariance = some_tracks(np.random.default_rng(4), 3)
    tracks = StarFilter(DetectionModel(0.999, 0.9, 1e4), state, covariance, 0)
    probability = tracks.step(np.eye(4), np.zeros((4, 4)), np.empty((0, 2)), np.empty(0))
    np.testing.assert_array_equal(probability, np.ones((3, 1)))
    np.testing.assert_array_equal(tracks.state, state)
    np.testing.assert_allclose(tracks.covariance, covariance)


def test_wrong_use_is_an_error():
    state, covariance = some_tracks(np.random.default_rng(4), 3)
    frame = np.eye(4), np.eye(4), np.zeros((2, 2)), np.ones(2)
    with pytest.raises(NativeError, match='memory'):
        StarFilter(DetectionModel(0.999, 0.9, 1e4), state, covariance, 0).step(*frame)
    for wrong in (DetectionModel(0.0, 0.9, 1e4), DetectionModel(0.9, 0.9, 0.0),
                  DetectionModel(0.9, 0.9, 1e4, -1.0)):
        with pytest.raises(NativeError, match='not possible'):
            StarFilter(wrong, state, covariance, 2).step(*frame)
