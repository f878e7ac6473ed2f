"""The common measurement of all stars against its definition."""

from hypothesis import given, settings, strategies as st
import numpy as np
from startracker_ros.track.star_votes import expected, turn_asked_for


@given(st.integers(0, 2 ** 32 - 1), st.integers(1, 6), st.integers(1, 6))
@settings(max_examples=50)
def test_moments_of_the_mixture(seed, stars, centroids):
    rng = np.random.default_rng(seed)
    uv, frame_uv = rng.normal(0, 3, (stars, 2)), rng.normal(0, 3, (centroids, 2))
    variance = rng.uniform(0.01, 1, centroids)
    probability = rng.dirichlet(np.ones(centroids + 1), stars)
    mean, spread = expected(uv, frame_uv, variance, probability)
    for i in range(stars):
        share = probability[i, 1:] / probability[i, 1:].sum()
        offset = frame_uv - uv[i]
        np.testing.assert_allclose(mean[i], share @ offset, atol=1e-12)
        moment = np.einsum('j,jk,jl', share, offset, offset) + np.eye(2) * (share @ variance)
        moment -= np.outer(mean[i], mean[i])
        np.testing.assert_allclose(spread[i], [moment[0, 0], moment[0, 1], moment[1, 1]],
                                   atol=1e-12)


def test_weighted_least_squares_of_those_who_vote():
    rng = np.random.default_rng(1)
    jacobian, mean = rng.normal(0, 5000, (5, 2, 3)), rng.normal(0, 1, (5, 2))
    root = rng.normal(0, 1, (5, 2, 2))
    spread = root @ np.swapaxes(root, 1, 2)
    weight = rng.uniform(0.1, 1, 5)
    votes = np.array([True, True, False, True, True])
    information, vector = turn_asked_for(
        jacobian, mean, np.stack([spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]], -1),
        weight, votes)
    inverse = weight[:, None, None] * np.linalg.inv(spread)
    part = (np.swapaxes(jacobian, 1, 2) @ inverse)[votes]
    np.testing.assert_allclose(information, np.sum(part @ jacobian[votes], axis=0), rtol=1e-9)
    np.testing.assert_allclose(vector, np.einsum('nij,nj->i', part, mean[votes]), rtol=1e-9)


def test_a_star_that_nobody_can_be_has_no_say():
    mean, spread = expected(np.zeros((1, 2)), np.ones((2, 2)), np.ones(2),
                            np.array([[1.0, 0.0, 0.0]]))
    assert not mean.any() and not spread.any()
