# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Heads on one body: mount, bending, seeds."""

import numpy as np
import pytest
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, matrix_from_quaternion, multiply, rotate)
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.mounted import HeadOptions, seed_in_namespace

MOUNT = np.array([0.5, -0.1, 0.7, 0.5])
STIFF = HeadOptions(mount_quaternion=tuple(MOUNT.tolist()))
BODY = {'motion': 'constant_rate', 'ra_deg': 40.0, 'dec_deg': -20.0,
        'rate_deg_s': (0.3, -0.1, 0.5)}
BENT = HeadOptions(mount_quaternion=tuple(MOUNT.tolist()), bend_arcsec_k=(1.0, -2.0, 0.5),
                   temperature_swing_k=10.0, temperature_period_s=600.0)


def head(options):
    return motion_from_options(MotionOptions(**BODY), head=options)


def test_all_heads_see_the_motion_of_one_body():
    body, state = head(HeadOptions()).at(30.0), head(STIFF).at(30.0)
    # v_body = R(q) v_sensor, and v_icrf = R(q_icrf_from_body) v_body.
    v = np.array([0.2, -0.3, 0.9])
    np.testing.assert_allclose(
        rotate(state.q_icrf_from_sensor, v),
        rotate(body.q_icrf_from_sensor, rotate(MOUNT, v)), atol=1e-12)
    np.testing.assert_allclose(rotate(MOUNT, state.rate_rad_s), body.rate_rad_s, atol=1e-15)
    np.testing.assert_array_equal(state.position_m, body.position_m)


def test_the_mount_bends_with_the_temperature_about_body_axes():
    warm_s = 150.0
    assert BENT.temperature_at(0.0) == 20.0
    assert BENT.temperature_at(warm_s) == pytest.approx(30.0)
    bent = multiply(BENT.mount_at(warm_s), conjugate(MOUNT))
    np.testing.assert_allclose(
        attitude_error(bent, np.array([0.0, 0.0, 0.0, 1.0])) / ARCSEC, [10.0, -20.0, 5.0],
        rtol=1e-6)
    np.testing.assert_allclose(matrix_from_quaternion(BENT.mount_at(0.0)),
                               matrix_from_quaternion(MOUNT), atol=1e-12)
    # The rate of a head that bends is the derivative of its attitude.
    motion, step_s = head(BENT), 0.05
    before, after = (motion.at(40.0 + dt).q_icrf_from_sensor for dt in (-step_s, step_s))
    np.testing.assert_allclose(attitude_error(after, before) / (2 * step_s),
                               motion.at(40.0).rate_rad_s, atol=1e-10)


def test_a_mount_that_is_not_a_rotation_is_rejected():
    with pytest.raises(ValueError, match='of norm 2.0000, a rotation has norm 1'):
        HeadOptions(mount_quaternion=(1.0, 1.0, 1.0, 1.0))


def test_each_namespace_has_a_seed_of_its_own():
    seeds = {seed_in_namespace(seed, name) for seed in (1, 2)
             for name in ('/', '/tracker_1', '/tracker_2', '/tracker_3')}
    assert len(seeds) == 8 and seed_in_namespace(1, '/') == 1
    assert seed_in_namespace(1, '/tracker_1/') == seed_in_namespace(1, 'tracker_1')
