# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The terms of the published covariance: their sum, and what each of them is for."""

from dataclasses import replace

import numpy as np
import pytest
from skies import onboard_stars, SMALL_CAMERA, START_NS
import startracker_ros as st
from startracker_ros.core.attitude.error_budget import ErrorBudget
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import (
    ARCSEC, multiply, quaternion_from_pointing, quaternion_from_rotation_vector)
from startracker_ros.io.bags.cloud_rows import tracker_state_values

RATE_RAD_S = np.radians([0.3, -0.2, 0.1])


def flown(frames=30, jump_at=None, common_px2=None, **options):
    """Return the tracker and the attitudes of a body that turns steadily."""
    tracker = st.StarTracker(SMALL_CAMERA, 2026.5, **{'aberration': 'none', **options})
    rng, attitudes = np.random.default_rng(1), []
    start = quaternion_from_pointing(1.0, 0.3, 0.2)
    for k in range(frames):
        time_s = 0.1 * k
        turn = RATE_RAD_S * (time_s + 2 * max(time_s - 0.1 * jump_at, 0) if jump_at else time_s)
        seen, _ = star_list(onboard_stars(SMALL_CAMERA, 2026.5), SMALL_CAMERA, multiply(
            start, quaternion_from_rotation_vector(turn)), 0.05, rng)
        if common_px2 is not None:
            seen = replace(seen, common=np.tile(common_px2, (len(seen), 1, 1)))
        attitudes.append(tracker.process_centroids(START_NS + round(time_s * 1e9), seen).attitude)
    return tracker, attitudes


def test_the_terms_add_up_to_the_covariance():
    _, attitudes = flown(aberration='full')
    for attitude in attitudes[2:]:
        np.testing.assert_allclose(attitude.budget.covariance, attitude.covariance_sensor)
        assert set(attitude.budget._fields) == set(ErrorBudget._fields)
        assert attitude.at(attitude.stamp_ns + 10 ** 8).budget is None


@pytest.mark.parametrize('term, options', [
    ('exposure', {'common_px2': np.diag([0.01, 0.02])}), ('observer', {'aberration': 'full'})])
def test_a_term_is_what_its_cause_adds(term, options):
    """Against the same flight without it."""
    sigma = flown(**options)[1][-1].budget.sigma_arcsec[term]
    without = flown()[1][-1].budget.sigma_arcsec[term]
    assert not without.any() and sigma.max() > 0.01


def test_motion_is_the_term_of_the_frame_in_which_a_motion_begins():
    _, attitudes = flown(jump_at=20)
    motion = [one.budget.sigma_arcsec['motion'].max() for one in attitudes[2:]]
    assert max(motion[20:23]) > 3 * np.median(motion[10:19])


def test_the_state_of_a_tracker_has_one_sigma_of_each_term():
    tracker, attitudes = flown()
    values = tracker_state_values(tracker.tracker)
    for name, sigma in attitudes[-1].budget.sigma_arcsec.items():
        found = [float(one) for one in values[f'error_budget.{name}_arcsec'].split()]
        np.testing.assert_allclose(found, sigma, rtol=0.01, atol=1e-9)
    assert attitudes[-1].budget.stars[0, 0] == pytest.approx(
        (float(values['error_budget.stars_arcsec'].split()[0]) * ARCSEC) ** 2, rel=0.02)
    assert not any(key.startswith('error_budget')
                   for key in tracker_state_values(st.StarTracker(SMALL_CAMERA, 2026.5).tracker))
