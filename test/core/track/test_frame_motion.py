# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The body rate by two frames of stars that nobody has identified yet."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_evaluation.campaign.integrity_motion import (
    attitudes, by_rows, MotionCondition, onboard_stars)
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import (
    multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.frame_motion import rate_between_frames
from startracker_ros.tools.datasheet.tally import CAMERA, EPOCH_YEAR, START_NS

LINE_TIME_S = 80e-6
FAST = MotionCondition('sway', 0.0, 1.0, steady_deg_s=5.0)


def frames(rate_deg_s, *, false=0, line_time_s=LINE_TIME_S, seed=3, step_s=0.1, count=2):
    """Return frames of a steady turn about a random axis, and its rate."""
    rng = np.random.default_rng(seed)
    rate = rng.standard_normal(3)
    rate *= np.radians(rate_deg_s) / np.linalg.norm(rate)
    start = random_attitude(rng)

    def attitude(times_s):
        return np.array([multiply(start, quaternion_from_rotation_vector(rate * t))
                         for t in times_s])
    found = []
    for k in range(count):
        seen, hip = star_list(onboard_stars(), CAMERA, attitude([k * step_s])[0], 0.1, rng,
                              missing=0.1, false=false)
        found.append(by_rows(seen, hip, attitude, k * step_s, line_time_s))
    return found, rate


@pytest.mark.parametrize('rate_deg_s', [0.0, 0.5, 5.0, 12.0])
@pytest.mark.parametrize('line_time_s', [1e-9, LINE_TIME_S, -LINE_TIME_S])
def test_the_rate_is_that_of_the_body(rate_deg_s, line_time_s):
    (before, after), rate = frames(rate_deg_s, line_time_s=line_time_s, false=10)
    found = rate_between_frames(CAMERA, before, after, 0.1)
    # 0.1 px of ten stars over 0.1 s; the image is less certain in roll.
    assert np.abs(found - rate)[:2].max() < np.radians(0.02)
    assert abs(found - rate)[2] < np.radians(0.3)


def test_frames_that_have_nothing_in_common_have_no_rate():
    for seed in range(20):
        (before, _), _ = frames(1.0, seed=seed)
        (_, after), _ = frames(1.0, seed=seed + 100)
        assert rate_between_frames(CAMERA, before, after, 0.1) is None
        assert rate_between_frames(CAMERA, before.select(slice(3)), before, 0.1) is None
        assert rate_between_frames(CAMERA, before, before, 5.0) is None
        assert rate_between_frames(CAMERA, before.select(slice(0)), after, 0.1) is None


@pytest.mark.parametrize('seed', range(4))
def test_a_fast_turn_of_a_rolling_shutter_is_tracked_from_the_third_frame_on(seed):
    """Single frames are sheared by 35 px: some were identified only after three seconds."""
    rng = np.random.default_rng(seed)
    attitude = attitudes(FAST, rng, 10)
    tracker = StarTracker(CAMERA, EPOCH_YEAR, aberration='none')
    for k in range(5):
        time_s = (k + 1) * 0.1
        seen, hip = star_list(onboard_stars(), CAMERA, attitude(np.array([time_s]))[0], 0.1, rng)
        result = tracker.process_centroids(START_NS + k * 100_000_000, replace(
            by_rows(seen, hip, attitude, time_s, LINE_TIME_S), exposure_s=(0.0, 0.0)))
    assert result.attitude is not None
    error = multiply(result.attitude.quaternion * [-1, -1, -1, 1],
                     attitude(np.array([time_s]))[0])
    assert np.linalg.norm(error[:2]) < 2e-5


@pytest.mark.parametrize('jump_deg', [0.5, 5.0])
def test_a_body_that_jumps_has_an_attitude_again_after_three_frames(jump_deg):
    """The attitude of the third is the first that two identified frames show."""
    rng = np.random.default_rng(7)
    attitude, tracker = random_attitude(rng), StarTracker(CAMERA, EPOCH_YEAR, aberration='none')
    missing = []
    for k in range(40):
        if k in (10, 25):
            axis = rng.standard_normal(3)
            attitude = multiply(attitude, quaternion_from_rotation_vector(
                np.radians(jump_deg) * axis / np.linalg.norm(axis)))
        seen, _ = star_list(onboard_stars(), CAMERA, attitude, 0.1, rng, missing=0.05, false=3)
        result = tracker.process_centroids(START_NS + k * 100_000_000, seen)
        if result.attitude is None:
            missing.append(k)
        else:
            error = multiply(result.attitude.quaternion * [-1, -1, -1, 1], attitude)
            assert np.linalg.norm(error[:2]) < 2e-5
    assert missing == [0, 1, 10, 11, 12, 25, 26, 27]
