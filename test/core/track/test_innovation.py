# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The combined innovation and the normal equations against their definitions."""

from hypothesis import given, settings, strategies as st
import numpy as np
from startracker_ros.core.centroid.centroids import round_errors
from startracker_ros.core.track.innovation import combined_innovation, normal_equations


@given(st.integers(0, 2 ** 32 - 1), st.integers(1, 6), st.integers(1, 6))
@settings(max_examples=50)
def test_moments_of_the_mixture(seed, stars, centroids):
    rng = np.random.default_rng(seed)
    uv, frame_uv = rng.normal(0, 3, (stars, 2)), rng.normal(0, 3, (centroids, 2))
    variance = rng.uniform(0.01, 1, centroids)
    probability = rng.dirichlet(np.ones(centroids + 1), stars)
    mean, covariance = combined_innovation(uv, frame_uv, round_errors(variance), probability)
    for i in range(stars):
        share = probability[i, 1:] / probability[i, 1:].sum()
        offset = frame_uv - uv[i]
        np.testing.assert_allclose(mean[i], share @ offset, atol=1e-12)
        moment = np.einsum('j,jk,jl', share, offset, offset) + np.eye(2) * (share @ variance)
        moment -= np.outer(mean[i], mean[i])
        np.testing.assert_allclose(covariance[i], moment, atol=1e-12)


def test_weighted_least_squares():
    rng = np.random.default_rng(1)
    jacobian, mean = rng.normal(0, 5000, (5, 2, 3)), rng.normal(0, 1, (5, 2))
    root = rng.normal(0, 1, (5, 2, 2))
    covariance = root @ np.swapaxes(root, 1, 2)
    weight = rng.uniform(0.1, 1, 5)
    weight[2] = 0
    information, vector = normal_equations(jacobian, mean, covariance, weight)
    inverse = weight[:, None, None] * np.linalg.inv(covariance)
    part = np.swapaxes(jacobian, 1, 2) @ inverse
    np.testing.assert_allclose(information, np.sum(part @ jacobian, axis=0), rtol=1e-9)
    np.testing.assert_allclose(vector, np.einsum('nij,nj->i', part, mean), rtol=1e-9)


def test_a_missed_star_has_weight_zero():
    mean, covariance = combined_innovation(
        np.zeros((1, 2)), np.ones((2, 2)), round_errors(np.ones(2)), np.array([[1.0, 0.0, 0.0]]))
    assert not mean.any() and not covariance.any()
    information, vector = normal_equations(np.ones((1, 2, 3)), mean, covariance, np.zeros(1))
    assert not information.any() and not vector.any()
