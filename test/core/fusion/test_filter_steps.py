# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The compiled steps of the fusion beside the same equations in NumPy."""

import numpy as np
import pytest
from startracker_ros.core.fusion.state import body_attitude, correction, innovation, propagated
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, matrix_from_quaternion, multiply, quaternion_from_rotation_vector,
    random_attitude)


@pytest.fixture
def rng():
    return np.random.default_rng(9)


def covariance(size, rng):
    root = rng.standard_normal((size, size))
    return root @ root.T


def test_a_covariance_is_propagated(rng):
    P, turn, walk = covariance(15, rng), rng.normal(0, 0.3, 3), rng.random(6)
    A = matrix_from_quaternion(quaternion_from_rotation_vector(-turn))
    one, none = np.eye(3), np.zeros((3, 3))
    a, b, c, d = transition = (0.2, -0.3, 0.7, -1.0)
    q = (1.0, 0.2, 3.0, -0.4, 5.0)
    F, Q = np.eye(15), np.zeros((15, 15))
    F[:9, :9] = np.block([[A, a * one, b * one], [none, c * one, d * one], [none, none, one]])
    Q[:9, :9] = np.block([[q[0] * one, q[1] * one, q[3] * one], [q[1] * one, q[2] * one, none],
                          [q[3] * one, none, q[4] * one]])
    Q[9:, 9:] = np.diag(walk)
    np.testing.assert_allclose(
        propagated(P, turn, transition, q, walk), F @ P @ F.T + Q, atol=1e-12)


@pytest.mark.parametrize('terms', [0, 1, 4])
def test_a_state_is_updated(rng, terms):
    P, R, B = covariance(24, rng), covariance(3, rng), rng.standard_normal((3, 3 * terms))
    q = random_attitude(rng)
    measured = multiply(q, quaternion_from_rotation_vector(rng.normal(0, 0.1, 3)))
    H = np.zeros((3, 24))
    H[:, :3], H[:, 12:12 + 3 * terms] = np.eye(3), B
    S = H @ P @ H.T + R
    z, nis, information, cross = innovation(q, P, measured, R, B, 12)
    np.testing.assert_allclose(z, attitude_error(measured, q), atol=1e-12)
    np.testing.assert_allclose(information, np.linalg.inv(S), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(cross, P @ H.T, rtol=1e-9)
    np.testing.assert_allclose(nis, z @ np.linalg.solve(S, z), rtol=1e-6)
    K = P @ H.T @ np.linalg.inv(S)
    change, after = correction(P, z, information, cross)
    np.testing.assert_allclose(change, K @ z, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(after, P - K @ S @ K.T, rtol=1e-6, atol=1e-6)


def test_an_attitude_of_a_head_is_that_of_the_body(rng):
    mount, q, C = random_attitude(rng), random_attitude(rng), covariance(3, rng)
    B, c = rng.standard_normal((3, 6)), rng.normal(0, 0.01, 6)
    bent = multiply(quaternion_from_rotation_vector(B @ c), mount)
    M = matrix_from_quaternion(mount)
    body, about_body = body_attitude(q, conjugate(mount), M, C, B, c)
    np.testing.assert_allclose(attitude_error(body, multiply(q, conjugate(bent))), 0, atol=1e-12)
    np.testing.assert_allclose(about_body, M @ C @ M.T)
    body, _ = body_attitude(q, conjugate(mount), M, C, np.zeros((3, 0)), np.zeros(0))
    np.testing.assert_allclose(attitude_error(body, multiply(q, conjugate(mount))), 0, atol=1e-12)
