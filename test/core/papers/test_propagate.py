# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The predicted attitude against closed forms, and its uncertainty against what happens."""

import numpy as np
import pytest
from scipy.stats import chi2
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.gyro import Gyro, GyroErrorOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_pointing, quaternion_from_rotation_vector)
from startracker_ros.core.papers.extended_grid import AttitudePropagator

START = quaternion_from_pointing(*np.radians([251.3, -37.2, 118.0]))
RATE = np.radians([0.3, -0.8, 0.5])
SMALL = np.eye(3) * (3 * ARCSEC) ** 2
S = 1_000_000_000
DEG_H = np.radians(1 / 3600)


def started(**options):
    propagator = AttitudePropagator(GyroErrorOptions(**options))
    propagator.start(0, START, SMALL)
    return propagator


def sigma_arcsec(prediction):
    return np.sqrt(np.diag(prediction.covariance_sensor)) / ARCSEC


@pytest.mark.parametrize('stamps_s', [[7.3], [1, 2.5, 2.6, 7.3]])
def test_a_steady_turn_in_any_steps(stamps_s):
    propagator = started()
    for k in range(1, 9):
        assert propagator.add_rate(k * S, RATE)
    for stamp_s in stamps_s:
        prediction = propagator.predict(round(stamp_s * S))
    truth = multiply(START, quaternion_from_rotation_vector(RATE * 7.3))
    np.testing.assert_allclose(attitude_error(prediction.quaternion, truth), 0, atol=1e-12)


def test_each_rate_counts_for_the_time_before_it():
    propagator = started()
    for stamp_s, rate in ((1, RATE), (2, -RATE), (3, 2 * RATE)):
        propagator.add_rate(stamp_s * S, rate)
    turn = (1 - 1 + 0.5 * 2) * RATE
    truth = multiply(START, quaternion_from_rotation_vector(turn))
    np.testing.assert_allclose(
        attitude_error(propagator.predict(2 * S + S // 2).quaternion, truth), 0, atol=1e-12)


def test_nothing_is_predicted_from_nothing():
    propagator = AttitudePropagator()
    propagator.add_rate(S, RATE)
    assert propagator.predict(2 * S) is None
    propagator = started()
    assert not propagator.has_rates and propagator.predict(S) is None
    propagator.add_rate(S, RATE)
    assert propagator.predict(S) is not None
    assert propagator.predict(S // 2) is None


def test_rates_that_come_late_are_used_by_the_next_prediction():
    """Frames overtake the rates of a process that was stopped."""
    options = {'gyro_rate_change_deg_s2': 0.1}
    late, in_time = started(**options), started(**options)
    for propagator in (late, in_time):
        propagator.add_rate(S, RATE)
    assert np.all(sigma_arcsec(late.predict(6 * S)) > 1000)
    for propagator in (late, in_time):
        for second in range(2, 8):
            propagator.add_rate(second * S, RATE)
    found, expected = late.predict(7 * S), in_time.predict(7 * S)
    np.testing.assert_allclose(found.quaternion, expected.quaternion, atol=1e-14)
    np.testing.assert_allclose(found.covariance_sensor, expected.covariance_sensor, rtol=1e-9)


@pytest.mark.parametrize('rate', [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -1e3]])
def test_a_rate_that_cannot_be_is_a_gap(rate):
    propagator = started(gyro_rate_change_deg_s2=0.1)
    propagator.add_rate(S, RATE)
    before = sigma_arcsec(propagator.predict(S))
    assert not propagator.add_rate(2 * S, rate)
    after = sigma_arcsec(propagator.predict(11 * S))
    # Ten seconds from the last rate, which may change by 0.1 deg/s in each.
    assert np.all(before < 400) and np.all(after > 0.1 * 10 * 10 / 2 * 3600)


@pytest.mark.parametrize('corrected', [False, True])
def test_the_errors_are_as_large_as_it_says(corrected):
    """Gyros of random drift and noise, with frames every 2 s or without any."""
    rng = np.random.default_rng(3)
    options = GyroErrorOptions(gyro_drift_deg_h=20.0, gyro_noise_deg_sqrt_h=0.1,
                               gyro_rate_change_deg_s2=0.0)
    normalised, drift_left = [], []
    for _ in range(150):
        propagator = AttitudePropagator(options)
        drift = rng.normal(0, 20 * DEG_H, 3)
        truth = START
        propagator.start(0, blurred(truth, rng), SMALL)
        for k in range(1, 21):
            truth = multiply(truth, quaternion_from_rotation_vector(RATE))
            noise = rng.normal(0, np.radians(0.1 / 60), 3)
            propagator.add_rate(k * S, RATE + drift + noise)
            prediction = propagator.predict(k * S)
            if corrected and k % 2 == 0 and k < 20:
                propagator.correct(blurred(truth, rng), SMALL)
        error = attitude_error(prediction.quaternion, truth)
        normalised.append(error @ np.linalg.solve(prediction.covariance_sensor, error))
        drift_left.append(error)
    low, high = chi2.ppf([0.001, 0.999], 3 * 150) / 150
    assert low < np.mean(normalised) < high
    # The drift alone makes 400 arcsec of 20 s, the noise 27; frames remove most of it.
    rms = np.sqrt(np.mean(np.square(drift_left))) / ARCSEC
    assert rms < 20 if corrected else rms > 300


@pytest.mark.parametrize('late_s', [0.0, 0.2])
def test_rates_that_end_before_a_frame_have_the_noise_of_the_last_one(late_s):
    """Means over 10 ms, of which the last one stands for all that are late."""
    rng = np.random.default_rng(4)
    step_ns, frame_ns = S // 100, S
    stamps_ns = np.arange(step_ns, frame_ns - round(late_s * S) + 1, step_ns)
    options = GyroErrorOptions(gyro_drift_deg_h=0.001, gyro_noise_deg_sqrt_h=0.15,
                               gyro_rate_change_deg_s2=0.0)
    sigma = np.radians(0.15 / 60) / np.sqrt(1e-9 * step_ns)
    truth = multiply(START, quaternion_from_rotation_vector(RATE))
    normalised = []
    for _ in range(200):
        gyro = Gyro(options)
        state = AttitudeState(0, START, np.zeros(3), np.zeros(3),
                              np.eye(9) * (1e-3 * ARCSEC) ** 2)
        for stamp_ns in stamps_ns.tolist():
            gyro.add(stamp_ns, RATE + rng.normal(0, sigma, 3))
        state = gyro.propagate(state, frame_ns)
        error = np.hstack([attitude_error(state.quaternion, truth), state.rate - RATE])
        normalised.append(error @ np.linalg.solve(state.covariance[:6, :6], error))
    low, high = chi2.ppf([0.001, 0.999], 6 * 200) / 200
    assert low < np.mean(normalised) < high


def blurred(q, rng):
    return multiply(q, quaternion_from_rotation_vector(rng.normal(0, 3 * ARCSEC, 3)))
