# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The compiled steps of the fusion beside the same equations in NumPy."""

import numpy as np
import pytest
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.fusion.state import BODY, body_attitude, FusedState, Measurement
from startracker_ros.core.maths.compiled_rotation import turned
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, matrix_from_quaternion, multiply, quaternion_from_rotation_vector,
    random_attitude)
from startracker_ros.core.track.motion_filter import predicted

TINY = 1e-5  # errors in rad, of which a turn is a vector


@pytest.fixture
def rng():
    return np.random.default_rng(9)


def covariance(size, rng):
    root = rng.standard_normal((size, size))
    return root @ root.T


def state_with(mounts, rng):
    """Return a state with so many coefficients, which all modes share."""
    body = AttitudeState(0, random_attitude(rng), np.zeros(3), np.zeros(3),
                         TINY ** 2 * covariance(BODY + mounts, rng))
    return FusedState.begin(body, np.full(3, TINY ** 2), 0.1, TINY * rng.standard_normal(mounts))


def test_mounts_go_with_the_body_from_frame_to_frame(rng):
    """Their covariance with the turn gets that with the rate times the time, and they walk."""
    before, walk, dt_s = state_with(6, rng), np.r_[np.zeros(3), rng.random(6)] * TINY ** 2, 0.1
    after = FusedState.of(predicted(
        before.motion, round(dt_s * 1e9), np.array([dt_s]), np.empty((0, 3)), np.empty(0),
        np.full(3, 1e-4), walk))
    P, later = before.covariance, after.covariance
    np.testing.assert_allclose(later[BODY:, :3], P[BODY:, :3] + dt_s * P[BODY:, 3:6], rtol=1e-6)
    np.testing.assert_allclose(later[BODY:, BODY:], P[BODY:, BODY:] + np.diag(walk[3:]) * dt_s,
                               rtol=1e-6)
    np.testing.assert_allclose(after.coefficients, before.coefficients, rtol=1e-6)


@pytest.mark.parametrize('terms', [0, 1, 4])
def test_a_state_is_updated(rng, terms):
    """As by one Kalman filter: attitude, drift and mounts are alike in all modes."""
    state, B = state_with(15, rng), rng.standard_normal((3, 3 * terms))
    R, columns = TINY ** 2 * covariance(3, rng), slice(12, 12 + 3 * terms)
    measured = Measurement(turned(state.quaternion, TINY * rng.standard_normal(3)), R, columns, B)
    H = np.zeros((3, 24))
    H[:, :3], H[:, columns] = np.eye(3), B
    P = state.covariance
    S = H @ P @ H.T + R
    z = attitude_error(measured.quaternion, state.quaternion)
    innovation = state.innovation(measured)
    np.testing.assert_allclose(innovation.vector, z, atol=1e-12)
    assert innovation.nis == pytest.approx(z @ np.linalg.solve(S, z), rel=1e-6)
    K = P @ H.T @ np.linalg.inv(S)
    after = state.updated(measured, 0)
    np.testing.assert_allclose(after.covariance, P - K @ S @ K.T, rtol=1e-5, atol=1e-6 * TINY ** 2)
    np.testing.assert_allclose(attitude_error(after.quaternion, state.quaternion), (K @ z)[:3],
                               rtol=1e-4, atol=1e-5 * TINY)
    np.testing.assert_allclose(after.coefficients - state.coefficients, (K @ z)[BODY:],
                               rtol=1e-4, atol=1e-5 * TINY)


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
