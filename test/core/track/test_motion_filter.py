# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The filter of several modes of motion, by textbook filters and by motions that are known."""

import numpy as np
import pytest
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.maths.compiled_rotation import rotation_between, turned
from startracker_ros.core.track.motion_filter import (
    ahead, by_experience, CENTRE, KIND, lacking, least_variances, MISSED, mixed, mixture, Motion,
    predicted, SIZE, started, state_of, STEADY, SWING, tail_sigmas, TORQUE, transition_and_noise,
    updated, W2, with_measured)

STEP_S = 0.1
SIGMA = 2e-6
ACCELERATION = np.full(3, np.radians(0.05))
LEAST = np.full(len(KIND), 1e-4)
NO_RATES = np.empty((0, 3)), np.empty(0)
NO_WALK = np.zeros(3)


def at_rest(rate=(0.0, 0.0, 0.0)):
    """Return the motion of a body of which two frames are known."""
    R = np.eye(3) * SIGMA ** 2
    P = np.zeros((9, 9))
    P[:3, :3], P[3:6, 3:6] = R, 2 * R / STEP_S ** 2
    P[:3, 3:6] = P[3:6, :3] = R / STEP_S
    state = AttitudeState(0, np.array([0.0, 0.0, 0.0, 1.0]), np.array(rate), np.zeros(3), P)
    return started(state, np.full(3, SIGMA ** 2), STEP_S)


def flown(angles, rng, about=(1.0, 0.0, 0.0)):
    """Yield motion and true attitude after each frame of a body turned by angles (K,) rad."""
    R, about = np.eye(3) * SIGMA ** 2, np.array(about)
    start = np.array([0.0, 0.0, 0.0, 1.0])
    motion = at_rest(about * (angles[1] - angles[0]) / STEP_S)
    motion = motion._replace(quaternion=turned(start, about * angles[0]))
    for k in range(1, len(angles)):
        truth = turned(start, about * angles[k])
        seen = turned(truth, SIGMA * rng.standard_normal(3))
        before_ns, stamp_ns = motion.stamp_ns, round(k * STEP_S * 1e9)
        motion = predicted(motion, stamp_ns, np.array([STEP_S]), *NO_RATES, ACCELERATION, NO_WALK)
        information = np.linalg.inv(R)
        turn = rotation_between(motion.quaternion, seen)
        motion = updated(motion, motion.quaternion, np.zeros(3), information, information @ turn,
                         np.zeros((3, 3)), np.zeros(3))
        motion = with_measured(motion, before_ns, seen, R)
        yield motion, truth


def test_the_mixture_has_mean_and_covariance_of_its_parts():
    rng = np.random.default_rng(1)
    weight, mean = np.array([2.0, 6.0]), rng.standard_normal((2, 3))
    parts = np.array([np.diag([1.0, 2.0, 3.0]), np.eye(3)])
    middle, P = mixture(weight, mean, parts)
    drawn = np.concatenate([rng.multivariate_normal(m, C, int(w * 5e4))
                            for w, m, C in zip(weight, mean, parts)])
    np.testing.assert_allclose(middle, drawn.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(P, np.cov(drawn.T), atol=0.05)


@pytest.mark.parametrize('mode', range(len(KIND)))
def test_one_step_is_as_many_short_ones(mode):
    """Phi and Q of a time are those of its halves: Phi2 Phi1, Phi2 Q1 Phi2^T + Q2."""
    noise, w2 = np.full(3, SIGMA ** 2), 10.0

    def step(tau_s):
        return transition_and_noise(KIND[mode], SIZE[mode], tau_s, w2, noise, STEP_S, ACCELERATION)

    (whole, Q), (half, Q_half) = step(STEP_S), step(STEP_S / 2)
    np.testing.assert_allclose(whole[:2], (half @ half)[:2], atol=1e-12)
    # The noise of a swing is taken as that of a torque: its frequency changes it little.
    rtol = 0.05 if KIND[mode] == SWING else 1e-9
    both = half @ Q_half @ half.T + Q_half
    np.testing.assert_allclose(Q[:, :2, :2], both[:, :2, :2], rtol=rtol, atol=1e-30)


def test_a_mode_alone_is_the_kalman_filter():
    """Of one mode of probability 1 the update is that of the textbook, whatever L is."""
    rng, P = np.random.default_rng(2), np.eye(12) + 0.1
    motion = at_rest()
    weight = np.eye(len(KIND))[1]
    motion = motion._replace(weight=weight, covariance=np.tile(P, (len(KIND), 1, 1)))
    R, z, L = np.diag([1.0, 2.0, 3.0]), 1e-7 * rng.standard_normal(3), 0.3 * np.eye(3)
    Y = np.linalg.inv(R)
    after = updated(motion, motion.quaternion, np.zeros(3), Y, Y @ z, L, np.zeros(3))
    H = np.concatenate([np.eye(3), np.zeros((3, 3)), L, np.zeros((3, 3))], axis=1)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    np.testing.assert_allclose(after.covariance[1], P - K @ H @ P, rtol=1e-9)
    shift = rotation_between(motion.quaternion, after.quaternion) + after.mean[1, :3]
    np.testing.assert_allclose(np.r_[shift, after.mean[1, 3:]], K @ z, rtol=1e-6, atol=1e-20)


def test_the_modes_of_a_frame_have_the_probabilities_of_its_likelihoods():
    motion = predicted(at_rest(), round(STEP_S * 1e9), np.array([STEP_S]), *NO_RATES,
                       ACCELERATION, NO_WALK)
    R, z = np.eye(3) * SIGMA ** 2, np.array([5.0, -3.0, 1.0]) * SIGMA
    Y = np.linalg.inv(R)
    after = updated(motion, motion.quaternion, np.zeros(3), Y, Y @ z, np.zeros((3, 3)),
                    np.zeros(3))
    away = z - motion.mean[:, :3]
    S = motion.covariance[:, :3, :3] + R
    likelihood = np.exp(-np.einsum('mi,mij,mj->m', away, np.linalg.inv(S), away) / 2) / np.sqrt(
        np.linalg.det(S))
    expected = motion.weight * likelihood
    np.testing.assert_allclose(after.weight, expected / expected.sum(), rtol=1e-6)


def test_rates_of_a_gyro_are_measurements():
    dt_s, rates = np.array([0.05, 0.05, 0.0]), np.tile([1e-3, 0.0, 0.0], (2, 1))
    motion = predicted(at_rest(), round(STEP_S * 1e9), dt_s, rates, np.full(2, 1e-16),
                       ACCELERATION, NO_WALK)
    # The drift is known to be zero here: the body turns as the gyro says.
    np.testing.assert_allclose(state_of(motion).rate, rates[0], rtol=0.01, atol=1e-6)


@pytest.mark.parametrize('angles, kinds', [
    (lambda t: 1e-3 * t, [STEADY, TORQUE]), (lambda t: 1e-4 * t ** 2, [TORQUE]),
    (lambda t: 1e-3 * np.sin(2 * np.pi * t / 1.3), [SWING])])
def test_the_mode_of_a_motion_is_found(angles, kinds):
    *_, (motion, _) = flown(angles(np.arange(60) * STEP_S), np.random.default_rng(3))
    assert motion.weight[np.isin(KIND, kinds) & (SIZE < 20)].sum() > 0.95


def test_period_and_mean_rate_of_a_swing_are_found():
    time_s = np.arange(60) * STEP_S
    *_, (motion, _) = flown(2e-3 * time_s + 1e-3 * np.sin(2 * np.pi * time_s / 1.3),
                            np.random.default_rng(4))
    assert 2 * np.pi / np.sqrt(motion.swing[W2]) == pytest.approx(1.3, rel=0.01)
    assert motion.swing[CENTRE.start] == pytest.approx(2e-3, rel=0.05)


@pytest.mark.parametrize('angles', [
    lambda t: 1e-3 * t, lambda t: 3e-4 * np.sin(2 * np.pi * t / 2.0),
    lambda t: np.where(t > 3, 1e-3 * (t - 3), 0.0), lambda t: 2e-5 * np.maximum(t - 3, 0) ** 2])
def test_errors_are_within_the_covariance_at_any_time(angles):
    rng, squares = np.random.default_rng(5), []
    time_s = np.arange(80) * STEP_S
    for _ in range(6):
        states = list(flown(angles(time_s + rng.uniform(0, STEP_S)), rng))
        for k, (motion, truth) in enumerate(states[3:-2], 3):
            weight, mean, P = motion.weight, motion.mean, motion.covariance
            middle, own = mixture(weight, mean, P)
            own = own[:3, :3] + np.diag(np.maximum(
                least_variances(weight, mean, P, MISSED)[:3] - np.diag(own)[:3], 0.0))
            error = rotation_between(turned(motion.quaternion, middle[:3]), truth)
            assert (np.abs(error) < WRONG_SIGMAS * np.sqrt(np.diag(own))).all(), k
            squares.append(error @ np.linalg.solve(own, error))
            for frames in (-1, 1):
                modes = by_experience(motion.weight, motion.share), mean, P
                if frames > 0:
                    modes = mixed(motion, modes[0], ACCELERATION, LEAST)
                after, Q = ahead(motion, *modes, frames * STEP_S, ACCELERATION)
                error = rotation_between(turned(motion.quaternion, after[:3]),
                                         states[k + frames][1])
                if k not in (28, 29, 30, 31):  # about the frame in which a motion begins
                    assert (np.abs(error) < WRONG_SIGMAS * np.sqrt(np.diag(Q)[:3])).all(), k
    assert 1.5 < np.mean(squares) < 3.5


def test_no_mode_is_more_probable_by_a_mixing_that_hardly_any_comes_from():
    motion = at_rest()
    weight = np.full(len(KIND), 1e-6)
    weight[0] = 1.0
    wide = motion.covariance.copy()
    wide[1:] *= 1e6
    motion = motion._replace(weight=weight / weight.sum(), covariance=wide)
    after, _, P = mixed(motion, motion.weight, ACCELERATION, LEAST)
    np.testing.assert_allclose(P[0], motion.covariance[0])
    assert after.sum() == pytest.approx(1.0)


def test_the_sigma_of_an_axis_covers_improbable_modes():
    rng = np.random.default_rng(6)
    weight, mean, P = np.array([0.99, 0.01]), np.zeros((2, 12)), np.zeros((2, 12, 12))
    P[0], P[1] = np.eye(12), 400 * np.eye(12)
    sigma = np.sqrt(max(mixture(weight, mean, P)[1][0, 0],
                        least_variances(weight, mean, P, MISSED)[0]))
    drawn = np.concatenate([rng.standard_normal(990_000), 20 * rng.standard_normal(10_000)])
    assert np.mean(np.abs(drawn) > WRONG_SIGMAS * sigma) < 2 * MISSED
    # The covariance of the moments alone does not.
    moments = np.sqrt(mixture(weight, mean, P)[1][0, 0])
    assert np.mean(np.abs(drawn) > WRONG_SIGMAS * moments) > 2 * MISSED


def test_what_a_covariance_lacks_makes_an_error_as_probable_as_it_is():
    P, error = np.diag([1.0, 4.0, 9.0]), np.array([20.0, 1.0, 2.0])
    more = lacking(P, error, 0.0, 0.02)
    distance2 = error @ np.linalg.solve(P + more, error)
    assert np.sqrt(distance2) == pytest.approx(WRONG_SIGMAS - tail_sigmas(0.02, 1e-3))
    # The direction of the error is not certain.
    across = lacking(P, error, 2.0, 0.02)
    np.testing.assert_allclose(np.linalg.eigvalsh(across - more), across[0, 1] / 5, rtol=1e-6)
    assert not lacking(P, error, 0.0, 1e-3).any() and not lacking(P, 0.01 * error, 0.0, 0.5).any()


def test_a_motion_is_not_changed_by_a_step():
    motion = at_rest((1e-3, 0.0, 0.0))
    before = Motion(*(np.copy(part) for part in motion))
    predicted(motion, 10 ** 8, np.array([STEP_S]), *NO_RATES, ACCELERATION, NO_WALK)
    with_measured(motion, -10 ** 8, motion.quaternion, np.eye(3) * SIGMA ** 2)
    for one, other in zip(before, motion):
        np.testing.assert_array_equal(one, other)
