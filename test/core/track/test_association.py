# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Association probabilities against a listing of every joint event."""

from itertools import product

from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import native_bank
from native_bank import marginals
import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal
from startracker_ros.core.track.association import DetectionModel

OPEN_CENTROIDS = 64
"""Shared centroids between the first and the last of their tracks that the core has a bit for."""


def brute_force(weight):
    """Return the association probabilities by the definition, over all events together."""
    tracks, choices = weight.shape
    total = np.zeros_like(weight)
    for event in product(range(choices), repeat=tracks):
        found = [choice for choice in event if choice > 0]
        if len(found) == len(set(found)):
            total[range(tracks), event] += np.prod(weight[range(tracks), event])
    return total / total.sum(axis=1, keepdims=True)


@st.composite
def weights(draw, most=4):
    """Draw weights with some centroids outside some gates, over many decades."""
    shape = (draw(st.integers(1, most)), draw(st.integers(0, most)) + 1)
    weight = 10.0 ** draw(arrays(float, shape, elements=st.floats(-8, 8)))
    inside = draw(arrays(bool, shape))
    inside[:, 0] = True
    return np.where(inside, weight, 0.0)


@given(weights())
@settings(max_examples=200)
def test_agrees_with_brute_force(weight):
    np.testing.assert_allclose(marginals(weight), brute_force(weight),
                               rtol=1e-9, atol=1e-12)


@given(weights(most=12))
def test_properties(weight):
    probability = marginals(weight)
    np.testing.assert_allclose(probability.sum(axis=1), 1, rtol=1e-12)
    assert (probability >= 0).all() and not probability[weight == 0].any()
    assert (probability[:, 1:].sum(axis=0) <= 1 + 1e-9).all()


def test_no_tracks_and_no_centroids():
    assert marginals(np.empty((0, 4))).shape == (0, 4)
    np.testing.assert_array_equal(marginals(np.full((3, 1), 0.1)), np.ones((3, 1)))


def test_two_tracks_share_out_two_centroids():
    """Each gets the one less probable for the other, although both prefer the same one."""
    probability = marginals(np.array([[0.01, 1000.0, 900.0], [0.01, 1000.0, 1.0]]))
    assert probability[0, 2] > 0.99 and probability[1, 1] > 0.99


def all_events(weight):
    """Return the sum over all joint events, by the set of centroids that are assigned."""
    sums = {0: 1.0}
    for row in weight:
        after = {}
        for used, total in sums.items():
            for choice in np.flatnonzero(row):
                claim = 1 << choice if choice else 0
                if not used & claim:
                    after[used | claim] = after.get(used | claim, 0.0) + total * row[choice]
        sums = after
    return sum(sums.values())


def only(weight, track, choice):
    """Return the weights of the events in which a track has what it chose."""
    left = weight.copy()
    left[track, np.arange(weight.shape[1]) != choice] = 0
    return left


@pytest.mark.parametrize('tracks, centroids', [(8, 8), (12, 12), (3, 20)])
def test_all_share_all(tracks, centroids):
    rng = np.random.default_rng(tracks)
    weight = np.exp(rng.normal(0, 3, (tracks, centroids + 1)))
    probability, total = marginals(weight), all_events(weight)
    for track, choice in zip(rng.integers(0, tracks, 6), rng.integers(0, centroids + 1, 6)):
        expected = all_events(only(weight, track, choice)) / total
        assert probability[track, choice] == pytest.approx(expected, rel=1e-9)


def chain_events(weight):
    """Return all_events of tracks that share a centroid with each neighbour alone."""
    free, used = 1.0, 0.0
    for track, row in enumerate(weight):
        free, used = (free + used) * row[0] + free * row[track + 1], (free + used) * row[
            track + 2]
    return free + used


def test_two_hundred_tracks_in_one_cluster():
    rng = np.random.default_rng(5)
    weight, track = np.zeros((200, 202)), np.arange(200)
    for column in (0, track + 1, track + 2):
        weight[track, column] = np.exp(rng.normal(0, 1, 200))
    shuffled = rng.permutation(200)
    probability = np.empty_like(weight)
    probability[shuffled] = marginals(weight[shuffled])
    total = chain_events(weight)
    for track in (0, 1, 57, 100, 198, 199):
        for choice in (0, track + 1, track + 2):
            assert probability[track, choice] == pytest.approx(
                chain_events(only(weight, track, choice)) / total, rel=1e-9)


def test_cut_to_the_most_probable_states():
    weight = np.exp(np.random.default_rng(0).normal(0, 4, (10, 11)))
    exact = marginals(weight)
    cut = marginals(weight, 110 * 100)
    assert 1e-9 < np.abs(cut - exact).max() < 0.05
    # Even a single state is a possible event up to the last track.
    for probability in (cut, marginals(weight, 1)):
        np.testing.assert_allclose(probability.sum(axis=1), 1)
        assert (probability[:, 1:].sum(axis=0) <= 1 + 1e-9).all()


@pytest.mark.parametrize('tracks, centroids', [(40, 50), (200, 2 * OPEN_CENTROIDS)])
def test_hopeless_cluster_still_gives_probabilities(tracks, centroids):
    """Forty tracks that all share fifty centroids: 10^60 events."""
    weight = np.exp(np.random.default_rng(1).normal(0, 2, (tracks, centroids + 1)))
    probability = marginals(weight)
    np.testing.assert_allclose(probability.sum(axis=1), 1)
    assert (probability >= 0).all() and (probability[:, 1:].sum(axis=0) <= 1 + 1e-9).all()


def test_gate_density_and_weights():
    rng = np.random.default_rng(2)
    detection = DetectionModel(0.9, 0.8, 50.0)
    assert detection.gate == pytest.approx(chi2.ppf(0.9, 2))
    covariance = np.array([[[0.3, 0.1], [0.1, 0.2]], [[0.05, -0.02], [-0.02, 0.4]]])
    predicted, variance = rng.uniform(0, 3, (2, 2)), np.array([0.01, 0.04, 0.3])
    uv = predicted[0] + rng.normal(0, 0.7, (3, 2))
    error = np.array([[[v, 0.4 * v], [0.4 * v, 2 * v]] for v in variance])
    density = np.zeros((2, 3))
    for track, centroid in product(range(2), range(3)):
        innovation_covariance = covariance[track] + error[centroid]
        offset = uv[centroid] - predicted[track]
        if offset @ np.linalg.solve(innovation_covariance, offset) <= detection.gate:
            density[track, centroid] = multivariate_normal(
                predicted[track], innovation_covariance).pdf(uv[centroid])
    assert (density > 0).any() and (density == 0).any()
    probability, unassociated, _ = native_bank.associate(
        predicted, covariance, uv, error, (detection.gate, *detection[:3]))
    np.testing.assert_array_equal(unassociated, ~density.any(axis=0))
    clutter_px2 = (1 + np.count_nonzero(unassociated)) / 50.0
    weight = np.column_stack([np.full(2, 1 - 0.9 * 0.8), density * 0.8 / clutter_px2])
    np.testing.assert_allclose(probability, brute_force(weight), rtol=0, atol=1e-12)
