# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motion truth: rates, continuity, the orbit frame."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from startracker_ros.core.maths.rotation import (
    attitude_error, matrix_from_quaternion, pointing_from_quaternion, rotate)
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions

MOTIONS = ('inertial', 'constant_rate', 'low_earth_orbit')
options = st.builds(
    MotionOptions, motion=st.sampled_from(MOTIONS), ra_deg=st.floats(0, 360),
    dec_deg=st.floats(-90, 90), roll_deg=st.floats(0, 360),
    rate_deg_s=st.tuples(*[st.floats(-5, 5)] * 3), inclination_deg=st.floats(0, 180),
    node_deg=st.floats(0, 360))


@given(options, st.floats(0, 6000))
@settings(max_examples=20)
def test_rate_is_the_derivative_of_attitude(chosen, time_s):
    motion, step = motion_from_options(chosen), 1e-3
    before, now, after = (motion.at(time_s + dt) for dt in (-step, 0.0, step))
    turned = attitude_error(after.q_icrf_from_sensor, before.q_icrf_from_sensor)
    np.testing.assert_allclose(turned / (2 * step), now.rate_rad_s, atol=1e-9)
    matrix = matrix_from_quaternion(now.q_icrf_from_sensor)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


@pytest.mark.parametrize('motion', MOTIONS)
def test_initial_pointing(motion):
    state = motion_from_options(MotionOptions(
        motion=motion, ra_deg=200.0, dec_deg=-35.0, roll_deg=77.0)).at(0.0)
    np.testing.assert_allclose(np.degrees(pointing_from_quaternion(state.q_icrf_from_sensor)),
                               [200.0, -35.0, 77.0], atol=1e-9)


def test_sign_is_continuous_through_many_turns():
    motion = motion_from_options(MotionOptions(
        motion='constant_rate', rate_deg_s=(3.0, -5.0, 7.0)))
    q = np.array([motion.at(t).q_icrf_from_sensor for t in np.arange(0, 300, 0.5)])
    assert (q[1:] * q[:-1]).sum(-1).min() > 0.99
    assert (q @ q[0]).min() < -0.9


def test_constant_rate_about_the_boresight_only_rolls():
    motion = motion_from_options(MotionOptions(
        motion='constant_rate', ra_deg=30.0, dec_deg=40.0, rate_deg_s=(0.0, 0.0, 2.0)))
    pointing = np.degrees(pointing_from_quaternion(motion.at(5.0).q_icrf_from_sensor))
    # Right-handed about z out of the lens: x turns towards y, so up (-y) turns from north
    # towards x, which is west, by 10 deg.
    np.testing.assert_allclose(pointing, [30.0, 40.0, 350.0], atol=1e-9)


def test_low_orbit_keeps_the_boresight_in_the_orbit_frame():
    motion = motion_from_options(MotionOptions(ra_deg=84.0, dec_deg=10.0, node_deg=25.0))
    seen = []
    for time_s in (0.0, 700.0, 3000.0):
        state = motion.at(time_s)
        outward = state.position_m / np.linalg.norm(state.position_m)
        along = state.velocity_m_s / np.linalg.norm(state.velocity_m_s)
        boresight = rotate(state.q_icrf_from_sensor, np.array([0.0, 0.0, 1.0]))
        seen.append([boresight @ outward, boresight @ along])
    np.testing.assert_allclose(seen, np.tile(seen[0], (3, 1)), atol=1e-12)
    after = motion.at(2 * np.pi / motion.orbit.rate_rad_s)
    np.testing.assert_allclose(
        attitude_error(after.q_icrf_from_sensor, motion.at(0.0).q_icrf_from_sensor),
        0.0, atol=1e-12)
    assert np.degrees(np.linalg.norm(after.rate_rad_s)) == pytest.approx(0.0607, abs=1e-4)
