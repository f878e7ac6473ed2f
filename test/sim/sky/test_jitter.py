# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The random roll: as the paper has it, and a motion like any other."""

import numpy as np
import pytest
from scipy.stats import kstest
from startracker_ros.core.maths.rotation import attitude_error, conjugate, multiply
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions

TURN = {'motion': 'constant_rate', 'rate_deg_s': (0.1, -0.2, 0.05), 'dec_deg': 20.0}
SMOOTH = motion_from_options(MotionOptions(**TURN))
SHAKEN = motion_from_options(MotionOptions(jitter_deg_s=0.5, **TURN), seed=3)


def roll_rate_deg_s(motion, time_s):
    return np.degrees(motion.at(time_s).rate_rad_s[2]) - 0.05


def test_rate_is_uniform_and_constant_over_ten_frames():
    blocks = [roll_rate_deg_s(SHAKEN, k + 0.5) for k in range(600)]
    assert kstest(blocks, 'uniform', args=(-0.5, 1.0)).pvalue > 1e-3
    for k in (0, 1, 57):
        frames = [roll_rate_deg_s(SHAKEN, k + 0.05 + i / 10) for i in range(10)]
        assert np.ptp(frames) < 1e-12 and frames[0] == pytest.approx(blocks[k])
    steps = np.corrcoef(blocks[1:], blocks[:-1])[0, 1]
    assert abs(steps) < 5 / np.sqrt(600)


def test_ten_frames_add_up_to_the_peak_at_most():
    for k in range(50):
        turn = attitude_error(
            multiply(SHAKEN.at(k + 1.0).q_icrf_from_sensor,
                     conjugate(SMOOTH.at(k + 1.0).q_icrf_from_sensor)),
            multiply(SHAKEN.at(float(k)).q_icrf_from_sensor,
                     conjugate(SMOOTH.at(float(k)).q_icrf_from_sensor)))
        assert np.degrees(np.linalg.norm(turn)) <= 0.5 + 1e-9


@pytest.mark.parametrize('time_s', [0.3, 17.77, 333.3])
def test_rate_is_the_derivative_of_the_attitude(time_s):
    step = 1e-3
    turned = attitude_error(SHAKEN.at(time_s + step).q_icrf_from_sensor,
                            SHAKEN.at(time_s - step).q_icrf_from_sensor)
    np.testing.assert_allclose(turned / (2 * step), SHAKEN.at(time_s).rate_rad_s, atol=1e-8)


def test_the_boresight_keeps_its_path_and_the_roll_never_jumps():
    for time_s in np.arange(0, 30, 0.37):
        error = attitude_error(SHAKEN.at(time_s).q_icrf_from_sensor,
                               SMOOTH.at(time_s).q_icrf_from_sensor)
        assert np.abs(error[:2]).max() < 1e-12
        step = attitude_error(SHAKEN.at(time_s + 1e-4).q_icrf_from_sensor,
                              SHAKEN.at(time_s - 1e-4).q_icrf_from_sensor)
        assert np.degrees(np.linalg.norm(step)) < 2e-4


def test_seeds_and_no_jitter():
    again = motion_from_options(MotionOptions(jitter_deg_s=0.5, **TURN), seed=3)
    np.testing.assert_array_equal(again.at(9.9).q_icrf_from_sensor,
                                  SHAKEN.at(9.9).q_icrf_from_sensor)
    other = motion_from_options(MotionOptions(jitter_deg_s=0.5, **TURN), seed=4)
    assert abs(roll_rate_deg_s(other, 9.5) - roll_rate_deg_s(SHAKEN, 9.5)) > 1e-3
    assert roll_rate_deg_s(SMOOTH, 9.5) == pytest.approx(0)
