# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The motion of a camera on the Earth out of its attitudes."""

from night_sky import OnEarth, START_NS
import numpy as np
import pytest
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector)
from startracker_ros.tools.night.earth_motion import fit_motion

SIDEREAL_ARCSEC_S = 15.041067
"""360 deg in a sidereal day, 86164.0905 s."""


def attitudes(motion, time_s):
    stamps = START_NS + np.round(1e9 * time_s).astype(np.int64)
    return stamps, np.array([motion.at(time).q_icrf_from_sensor for time in time_s])


@pytest.mark.parametrize('rate_deg_h, step_s, tracking', (
    ((0, 0, 0), 60.0, False), ((-0.2, 0.1, 0.3), 60.0, False), ((0, 1800.0, 360.0), 5.0, True)))
def test_the_motion_is_found_but_for_wrong_attitudes(rate_deg_h, step_s, tracking):
    rate = np.radians(rate_deg_h) / 3600
    stamps, q = attitudes(OnEarth(rate), step_s * np.arange(40))
    wrong = q.copy()
    wrong[[3, 17, 30]] = multiply(q[[3, 17, 30]], quaternion_from_rotation_vector([0.1, 0, 0.3]))
    found = fit_motion(stamps, wrong, tracking)
    # Years as float64 resolve 14 us: 0.0002 arcsec of the sky.
    assert np.abs(attitude_error(found.icrf(stamps), q)).max() < 2e-3 * ARCSEC
    assert found.rate_rad_s == pytest.approx(rate, abs=1e-11)


def test_at_rest_the_sky_turns_once_in_a_sidereal_day():
    stamps, q = attitudes(OnEarth(), 60.0 * np.arange(30))
    found = fit_motion(stamps, q, False)
    rate = np.linalg.norm(found.icrf_rate(stamps), axis=1).mean() / ARCSEC
    assert rate == pytest.approx(SIDEREAL_ARCSEC_S, abs=2e-4)
