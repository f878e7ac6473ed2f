# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A cycle of the filter against a listing of all association matrices, as in the paper."""

from itertools import product
from math import factorial

from native_bank import associate_stars, events, update
import numpy as np
import pytest
from scipy.stats import multivariate_normal
from startracker_ros.core.track.association import DetectionModel, StarFilter
from startracker_ros.core.track.options import ASSOCIATIONS

H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])
DETECTION = DetectionModel(0.999, 0.9, 1e4)
NUMBERS = DETECTION.gate, *DETECTION[:3]
VARIANCE = 0.3


def crowded_scene(rng):
    """Return states and covariances of three stars that share some of four or five centroids."""
    root = rng.normal(0, 0.5, (3, 4, 4))
    covariance = root @ np.swapaxes(root, 1, 2) + 0.2 * np.eye(4)
    state = np.zeros((3, 4))
    state[:, [0, 2]] = rng.uniform(40, 42, (3, 2))
    uv = np.concatenate([state[:, [0, 2]] + rng.normal(0, 0.7, (3, 2)),
                         rng.uniform(39, 43, (rng.integers(0, 2), 2)), [[300.0, 300.0]]])
    return state, covariance, uv


def listed(state, covariance, uv, association, allowed):
    """Return beta (T, m + 1) from the sums over every binary matrix (m, T) that is an event."""
    predicted, S = state[:, [0, 2]], H @ covariance @ H.T + VARIANCE * np.eye(2)
    offset = uv[:, None] - predicted
    distance = np.einsum('jri,rik,jrk->jr', offset, np.linalg.inv(S), offset)
    inside = distance <= DETECTION.gate
    omega = inside & allowed
    validated = omega.any(axis=1).sum()
    volume = np.sum(np.pi * DETECTION.gate * np.sqrt(np.linalg.det(S)))
    clutter = (1 + np.sum(~inside.any(axis=1))) / DETECTION.image_px2
    found = DETECTION.detection_probability
    missed = 1 - found * DETECTION.gate_probability
    sums = np.zeros((len(predicted) + 1, len(uv) + 1))
    pairs = np.argwhere(omega)
    for chosen in product([False, True], repeat=len(pairs)):
        event = pairs[list(chosen)]
        if len(set(event[:, 0])) < len(event) or len(set(event[:, 1])) < len(event):
            continue
        phi = validated - len(event)
        weight = {'poisson': clutter ** phi, 'diffuse': factorial(phi) / volume ** phi,
                  'normalised': 1.0}[association]
        for j, r in event:
            weight *= found * multivariate_normal(predicted[r], S[r]).pdf(uv[j])
        weight *= missed ** (len(predicted) - len(event))
        star, centroid = set(range(len(predicted))), set(np.flatnonzero(omega.any(axis=1)))
        for j, r in event:
            sums[r + 1, j + 1] += weight
            star.discard(r)
            centroid.discard(j)
        for r in star:
            sums[r + 1, 0] += weight
        for j in centroid:
            sums[0, j + 1] += weight
    beta = sums / sums[1].sum()
    # Rows of stars and columns of centroids at once.
    np.testing.assert_allclose(beta[1:].sum(axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(beta[:, 1:][:, omega.any(axis=1)].sum(axis=0), 1, rtol=1e-12)
    return beta[1:]


@pytest.mark.parametrize('association', ASSOCIATIONS)
@pytest.mark.parametrize('seed', range(12))
def test_a_cycle_is_that_of_all_matrices(association, seed):
    rng = np.random.default_rng(seed)
    state, covariance, uv = crowded_scene(rng)
    confirmed = None if seed % 2 else np.array([0, -1, 2])
    allowed = np.ones((len(uv), 3), bool)
    if confirmed is not None:
        allowed[:, 1] = False
        allowed[[j for j in range(len(uv)) if j not in (0, 2)]] = False
    variance = np.full(len(uv), VARIANCE)
    beta, unassociated = associate_stars(
        state[:, [0, 2]], covariance[:, ::2, ::2], uv, variance, NUMBERS, association, confirmed)
    expected = listed(state, covariance, uv, association, allowed)
    np.testing.assert_allclose(beta, expected, rtol=0, atol=1e-12)
    assert unassociated[-1] and not unassociated[:3].all()
    # Steps 7 to 9.
    new_state, new_covariance = update(state, covariance, uv, variance, beta)
    for r in range(3):
        P, S = covariance[r], H @ covariance[r] @ H.T + VARIANCE * np.eye(2)
        K = P @ H.T @ np.linalg.inv(S)
        v = uv - H @ state[r]
        combined = expected[r, 1:] @ v
        spread = (v.T * expected[r, 1:]) @ v - np.outer(combined, combined)
        np.testing.assert_allclose(new_state[r], state[r] + K @ combined, rtol=0, atol=1e-10)
        np.testing.assert_allclose(
            new_covariance[r], P - expected[r, 1:].sum() * K @ S @ K.T + K @ spread @ K.T,
            rtol=0, atol=1e-9)
    if confirmed is None:
        tracks = StarFilter(
            DETECTION._replace(association=association), state, covariance, len(uv))
        at_once = tracks.step(np.eye(4), np.zeros((4, 4)), uv, variance)
        np.testing.assert_allclose(at_once, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(tracks.state, new_state, rtol=1e-12)
        np.testing.assert_allclose(tracks.covariance, new_covariance, rtol=0, atol=1e-12)


def test_the_variants_differ_where_centroids_are_shared():
    state, covariance, uv = crowded_scene(np.random.default_rng(1))
    found = [associate_stars(state[:, [0, 2]], covariance[:, ::2, ::2], uv, np.full(
        len(uv), VARIANCE), NUMBERS, association)[0] for association in ASSOCIATIONS]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(found[a] - found[b]).max() > 1e-3


def test_frames_without_centroids_and_without_stars():
    for association in ASSOCIATIONS:
        beta, unassociated = associate_stars(
            np.array([[5.0, 5.0]]), np.eye(2)[None], np.empty((0, 2)), np.empty(0), NUMBERS,
            association)
        np.testing.assert_array_equal(beta, [[1.0]])
        beta, unassociated = associate_stars(
            np.empty((0, 2)), np.empty((0, 2, 2)), np.ones((2, 2)), np.ones(2), NUMBERS,
            association)
        assert beta.shape == (0, 3) and unassociated.all()


def test_hundreds_of_stars_have_probabilities_without_a_known_density():
    predicted = np.stack(np.meshgrid(*[np.arange(20) * 20.0] * 2), -1).reshape(-1, 2)
    beta, _ = associate_stars(predicted, np.tile(np.eye(2), (400, 1, 1)), predicted + 0.3,
                              np.ones(400), NUMBERS, 'diffuse')
    np.testing.assert_allclose(beta.sum(axis=1), 1, rtol=1e-9)
    np.testing.assert_allclose(beta[np.arange(400), np.arange(400) + 1], beta[0, 1], rtol=1e-9)
    assert 0.5 < beta[0, 1] < 1


def test_event_sum_of_a_chain_and_of_separate_stars():
    weight = np.array([[0.2, 3.0, 0.5, 0.0], [0.1, 0.0, 2.0, 0.7], [0.4, 0.0, 0.0, 0.0]])
    # Of the first two stars all pairs of choices but the shared second centroid twice.
    expected = (3.7 * 2.8 - 0.5 * 2.0) * 0.4
    assert events(weight)[1] == pytest.approx(np.log(expected), abs=1e-12)
