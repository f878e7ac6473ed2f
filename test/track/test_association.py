"""Association probabilities against a listing of every joint event."""

from itertools import product

from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from startracker_ros.track.association import (
    event_weights, gate_size, gated_density, joint_probabilities, MAX_EVENTS)


def brute_force(weight):
    """Return the association probabilities by the definition, over all events at once."""
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
    np.testing.assert_allclose(joint_probabilities(weight), brute_force(weight),
                               rtol=1e-9, atol=1e-12)


@given(weights(most=12))
def test_properties(weight):
    probability = joint_probabilities(weight)
    np.testing.assert_allclose(probability.sum(axis=1), 1, rtol=1e-12)
    assert (probability >= 0).all() and not probability[weight == 0].any()
    assert (probability[:, 1:].sum(axis=0) <= 1 + 1e-9).all()


def test_no_tracks_and_no_centroids():
    assert joint_probabilities(np.empty((0, 4))).shape == (0, 4)
    np.testing.assert_array_equal(joint_probabilities(np.full((3, 1), 0.1)), np.ones((3, 1)))


def test_two_tracks_share_out_two_centroids():
    """Each takes the one that the other likes less, although both prefer the same one."""
    probability = joint_probabilities(np.array([[0.01, 1000.0, 900.0], [0.01, 1000.0, 1.0]]))
    assert probability[0, 2] > 0.99 and probability[1, 1] > 0.99


def test_large_cluster_is_cut_to_its_most_probable_events():
    rng = np.random.default_rng(0)
    weight = np.exp(rng.normal(0, 4, (6, 7)))
    exact = brute_force(weight)
    events = sum(len(set(e) - {0}) == sum(c > 0 for c in e)
                 for e in product(range(7), repeat=6))
    assert events > 5 * MAX_EVENTS
    np.testing.assert_allclose(joint_probabilities(weight), exact, atol=2e-3)


def test_hopeless_cluster_still_gives_probabilities():
    """Forty tracks that all share fifty centroids: 10^60 events."""
    weight = np.exp(np.random.default_rng(1).normal(0, 2, (40, 51)))
    probability = joint_probabilities(weight)
    np.testing.assert_allclose(probability.sum(axis=1), 1)
    assert (probability[:, 1:].sum(axis=0) <= 1 + 1e-9).all()


def test_density_and_gate():
    rng = np.random.default_rng(2)
    covariance = np.array([[[0.3, 0.1], [0.1, 0.2]], [[0.05, -0.02], [-0.02, 0.4]]])
    predicted, variance = rng.uniform(0, 3, (2, 2)), np.array([0.01, 0.04, 0.3])
    uv, gate = predicted[0] + rng.normal(0, 0.7, (3, 2)), gate_size(0.9)
    assert gate == pytest.approx(chi2.ppf(0.9, 2))
    density = gated_density(predicted, covariance, uv, variance, gate)
    for track, centroid in product(range(2), range(3)):
        spread = covariance[track] + variance[centroid] * np.eye(2)
        offset = uv[centroid] - predicted[track]
        inside = offset @ np.linalg.solve(spread, offset) <= gate
        expected = multivariate_normal(predicted[track], spread).pdf(uv[centroid])
        assert density[track, centroid] == pytest.approx(expected * inside)
    assert (density > 0).any() and (density == 0).any()


def test_weights_name_the_missed_star_explicitly():
    weight = event_weights(np.array([[0.5, 0.0]]), 0.9, 0.99, 1e-3)
    np.testing.assert_allclose(weight, [[1 - 0.9 * 0.99, 0.9 * 0.5 / 1e-3, 0]])
