# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A slew from rest to rest."""

import numpy as np
import pytest
from startracker_evaluation.gnc.guidance import Slew
from startracker_ros.core.maths.rotation import attitude_error, random_attitude, rotate

AXIS = np.array([0.6, 0.0, 0.8])
SLEW = Slew(random_attitude(np.random.default_rng(1)), AXIS, np.radians(90.0), 5.0)


def test_it_ends_at_rest_after_its_angle():
    for time_s, angle in ((5.0, 0.0), (SLEW.end_s, np.pi / 2), (SLEW.end_s + 100, np.pi / 2)):
        reference = SLEW.at(time_s)
        assert attitude_error(reference.quaternion, SLEW.q_start) == pytest.approx(
            AXIS * angle, abs=1e-12)
        assert np.abs(reference.rate_icrf_rad_s).max() < 1e-12
        assert np.abs(reference.acceleration_icrf_rad_s2).max() < 1e-12


@pytest.mark.parametrize('time_s', [8.0, 24.9, 25.1, 60.0, 96.0, 113.0])
def test_rate_and_acceleration_are_the_derivatives(time_s):
    before, now, after = (SLEW.at(time_s + step) for step in (-1e-3, 0.0, 1e-3))
    turn = rotate(now.quaternion, attitude_error(after.quaternion, before.quaternion))
    assert turn / 2e-3 == pytest.approx(now.rate_icrf_rad_s, abs=1e-7)
    assert (after.rate_icrf_rad_s - before.rate_icrf_rad_s) / 2e-3 == pytest.approx(
        now.acceleration_icrf_rad_s2, abs=1e-7)


def test_the_rate_stays_below_its_peak():
    rates = [np.linalg.norm(SLEW.at(time_s).rate_icrf_rad_s)
             for time_s in np.linspace(0, 130, 500)]
    assert max(rates) == pytest.approx(SLEW.peak_rad_s)
