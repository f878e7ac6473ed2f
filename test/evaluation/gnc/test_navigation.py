# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The navigation between measurements: what it uses, how long it holds, when it gives up."""

import numpy as np
import pytest
from startracker_evaluation.gnc.navigation import Navigation, NavigationOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

INERTIA = np.array([11.0, 9.0, 10.0])
STEP_NS = 200_000_000
SIGMA = np.array([0.5, 0.5, 5.0]) * ARCSEC
COVARIANCE = np.diag(SIGMA ** 2)
NONE = np.zeros(3)


def run(navigation, frames, rng, *, rate=NONE, begin=0, q=None, torque=NONE, offset=NONE):
    """Feed measurements of a steady turn; return the truth at the last."""
    q = random_attitude(rng) if q is None else q
    for frame in range(begin, begin + frames):
        time_ns = frame * STEP_NS
        truth = multiply(q, quaternion_from_rotation_vector(rate * time_ns * 1e-9))
        measured = multiply(truth, quaternion_from_rotation_vector(
            offset + rng.normal(0, SIGMA)))
        navigation.propagate(time_ns, torque, NONE)
        navigation.correct(time_ns, measured, COVARIANCE, rate)
    return truth


def test_it_filters_and_its_covariance_contains_the_error():
    rng, errors = np.random.default_rng(1), []
    options = NavigationOptions(inflation=1.0, sigma_floor_rad=0.0)
    for _ in range(20):
        navigation = Navigation(INERTIA, options)
        truth = run(navigation, 100, rng)
        error = attitude_error(navigation.state.q_icrf_from_body, truth)
        errors.append(error / np.sqrt(navigation.state.covariance.diagonal()[:3]))
    squared = np.square(errors).sum(axis=1)
    # Larger by disturbances that it allows for and that do not happen here.
    low, high = mean_chi_square_bounds(3, len(squared))
    assert low / 2 < np.mean(squared) < high, (low / 2, np.mean(squared), high)


def test_a_torque_that_is_known_is_not_an_innovation():
    rng = np.random.default_rng(2)
    torque, q = np.array([0.01, 0.0, 0.0]), random_attitude(rng)
    navigation = Navigation(INERTIA)
    for frame in range(100):
        time_s = frame * STEP_NS * 1e-9
        angle = torque / INERTIA * time_s ** 2 / 2
        navigation.propagate(frame * STEP_NS, torque, NONE)
        navigation.correct(frame * STEP_NS, multiply(q, quaternion_from_rotation_vector(angle)),
                           COVARIANCE, torque / INERTIA * time_s)
    assert navigation.rejected == 0
    assert navigation.state.rate_rad_s == pytest.approx(torque / INERTIA * time_s, abs=1e-6)


def test_a_wrong_attitude_is_rejected_and_the_attitude_held():
    rng = np.random.default_rng(3)
    navigation = Navigation(INERTIA)
    truth = run(navigation, 50, rng)
    navigation.propagate(50 * STEP_NS, NONE, NONE)
    wrong = multiply(truth, quaternion_from_rotation_vector([np.radians(1), 0, 0]))
    assert navigation.correct(50 * STEP_NS, wrong, COVARIANCE, NONE) is None
    assert navigation.rejected == 1
    assert navigation.hold_s(50 * STEP_NS) == pytest.approx(0.2)
    error = attitude_error(navigation.state.q_icrf_from_body, truth)
    assert np.abs(error[:2]).max() < 2 * ARCSEC


def test_it_begins_anew_only_after_many_measurements_that_do_not_fit():
    rng = np.random.default_rng(4)
    navigation = Navigation(INERTIA)
    q = random_attitude(rng)
    run(navigation, 50, rng, q=q)
    allowed = NavigationOptions().rejected_max
    run(navigation, allowed, rng, q=q, begin=50, offset=np.radians([1.0, 0, 0]))
    assert (navigation.rejected, navigation.restarts) == (allowed, 0)
    run(navigation, 1, rng, q=q, begin=50 + allowed, offset=np.radians([1.0, 0, 0]))
    assert navigation.restarts == 1


def test_a_hold_ends_when_the_attitude_is_no_longer_known():
    navigation = Navigation(INERTIA)
    run(navigation, 50, np.random.default_rng(5))
    held_s = 0.0
    for frame in range(50, 5000):
        navigation.propagate(frame * STEP_NS, NONE, NONE)
        if navigation.state is None:
            break
        held_s = navigation.hold_s(frame * STEP_NS)
    assert 30 < held_s <= NavigationOptions().hold_max_s


def test_the_error_of_the_time_tag_grows_with_the_rate_and_along_it():
    q, rate = random_attitude(np.random.default_rng(6)), np.array([0.0, np.radians(1.0), 0.0])
    still, turning = (Navigation(INERTIA).correct(0, q, COVARIANCE, each)
                      for each in (NONE, rate))
    sigma = np.sqrt((turning - still).diagonal()) / ARCSEC
    assert sigma == pytest.approx([0, 3600 * NavigationOptions().time_sigma_s, 0])


def test_a_rate_that_follows_a_wrong_time_tag_does_not_shrink_its_error():
    """Of tags 50 ms late and then early, a tracker sees half of the rate or less."""
    navigation, rate = Navigation(INERTIA), np.array([0.0, np.radians(3.0), 0.0])
    truth = run(navigation, 20, np.random.default_rng(7), rate=rate)
    navigation.propagate(20 * STEP_NS, NONE, NONE)
    late = multiply(truth, quaternion_from_rotation_vector(rate * 0.15))
    used = navigation.correct(20 * STEP_NS, late, COVARIANCE, 0.3 * rate)
    error = attitude_error(late, multiply(truth, quaternion_from_rotation_vector(rate * 0.2)))
    assert used is not None and np.abs(error[1]) < 3 * np.sqrt(used[1, 1])
