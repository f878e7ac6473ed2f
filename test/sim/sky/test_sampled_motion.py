# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A motion given by samples: between them, beyond them, and samples that are not a motion."""

import numpy as np
import pytest
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.sim.sky.motion_state import MotionState
from startracker_ros.sim.sky.sampled_motion import KEPT_S, SampledMotion, SampleError

ORBIT = CircularOrbit(7.0e6, 0.5, 0.0, 0.0)
Q = random_attitude(np.random.default_rng(1))
SPIN, PRECESSION = np.radians(3.0), np.radians(2.0)


def precessing(time_s):
    """Return a body that spins about z, which precesses about inertial x: the rate turns."""
    q = multiply(quaternion_from_rotation_vector([PRECESSION * time_s, 0, 0]),
                 quaternion_from_rotation_vector([0, 0, SPIN * time_s]))
    cosine, sine = np.cos(SPIN * time_s), np.sin(SPIN * time_s)
    rate = np.array([PRECESSION * cosine, -PRECESSION * sine, SPIN])
    return MotionState(multiply(Q, q), rate, *ORBIT.at(time_s))


def sampled(step_s, end_s=2.0):
    motion = SampledMotion()
    for time_s in np.arange(0, end_s + 1e-9, step_s):
        motion.add(time_s, precessing(time_s))
    return motion


@pytest.mark.parametrize('step_s, bound_arcsec', [(0.02, 1e-5), (0.2, 1e-2), (1.0, 5.0)])
def test_it_interpolates_a_tumbling_body(step_s, bound_arcsec):
    motion = sampled(step_s)
    for time_s in np.linspace(0.03, 1.93, 77):
        truth, state = precessing(time_s), motion.at(time_s)
        error = attitude_error(state.q_icrf_from_sensor, truth.q_icrf_from_sensor)
        assert np.abs(error).max() < bound_arcsec * ARCSEC
        assert state.rate_rad_s == pytest.approx(truth.rate_rad_s, abs=5e-4 * step_s ** 2)
        assert state.position_m == pytest.approx(truth.position_m, abs=1e-2)
        assert state.velocity_m_s == pytest.approx(truth.velocity_m_s, abs=1e-2)


def test_beyond_the_newest_the_rate_is_constant():
    motion = sampled(0.2)
    truth, state = precessing(2.05), motion.at(2.05)
    error = np.linalg.norm(attitude_error(state.q_icrf_from_sensor, truth.q_icrf_from_sensor))
    acceleration = SPIN * PRECESSION
    assert error == pytest.approx(acceleration * 0.05 ** 2 / 2, rel=0.05)
    assert (state.rate_rad_s == precessing(2.0).rate_rad_s).all()


def test_samples_that_are_read_in_any_order_are_the_same():
    motion = sampled(0.2)
    times_s = np.random.default_rng(2).uniform(0, 2, 20)
    first = [motion.at(time_s).q_icrf_from_sensor for time_s in times_s]
    again = [motion.at(time_s).q_icrf_from_sensor for time_s in times_s[::-1]]
    assert np.array_equal(first, again[::-1])


def test_an_older_sample_is_rejected_and_changes_nothing():
    motion = sampled(0.2)
    before = motion.at(1.9).q_icrf_from_sensor
    for time_s in (2.0, 1.0):
        with pytest.raises(SampleError, match='older than the newest'):
            motion.add(time_s, precessing(0.0))
    assert motion.newest_s == 2.0
    assert (motion.at(1.9).q_icrf_from_sensor == before).all()


def test_a_rate_on_other_axes_disagrees_with_the_attitudes():
    motion, wrong = SampledMotion(), SampledMotion()
    for time_s in np.arange(0, 1, 0.1):
        state = precessing(time_s)
        agreed_rad = motion.add(time_s, state)
        flipped = MotionState(state.q_icrf_from_sensor, -state.rate_rad_s, state.position_m,
                              state.velocity_m_s)
        disagreed_rad = wrong.add(time_s, flipped)
    assert agreed_rad < 1e-4
    assert disagreed_rad == pytest.approx(0.2 * np.hypot(SPIN, PRECESSION), rel=0.01)


def test_after_a_large_turn_the_motion_begins_anew():
    motion = sampled(0.2)
    turned = multiply(precessing(2.0).q_icrf_from_sensor,
                      quaternion_from_rotation_vector([2.0, 0.0, 0.0]))
    state = MotionState(turned, np.zeros(3), *ORBIT.at(2.1))
    assert motion.add(2.1, state) == np.inf
    assert (motion.at(1.0).q_icrf_from_sensor == turned).all()


def test_it_forgets_what_is_long_ago():
    motion = sampled(0.2, end_s=10.0)
    assert motion.at(0.0).q_icrf_from_sensor == pytest.approx(
        motion.at(0.0).q_icrf_from_sensor)
    begin = 10.0 - KEPT_S
    error = attitude_error(motion.at(begin).q_icrf_from_sensor,
                           precessing(begin).q_icrf_from_sensor)
    assert np.abs(error).max() < 0.01 * ARCSEC
