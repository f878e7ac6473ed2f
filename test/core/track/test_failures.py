# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is named: a diverged filter, no covariance, a frozen source, a gyro at its range."""

from native_core import call
import numpy as np
from star_motion import Motion, sky, START_NS, STEP_NS
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.integrity.checks import REPEATED_FRAME
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter

ONBOARD = sky()


def tracking(motion, gyro=None, frames=12, **options):
    """Return a tracker after so many frames, with the rates of a gyro."""
    tracker = TrackFilter(motion.camera, motion.onboard, TrackerOptions(**options),
                          GyroErrorOptions(gyro_range_deg_s=5.0))
    for frame in range(frames):
        if gyro is not None and frame:
            for k in range(10):
                tracker.add_rate(START_NS + (frame - 1) * STEP_NS + (k + 1) * STEP_NS // 10, gyro)
        stamp_ns, centroids, hip = motion.frame(frame)
        tracker.update(stamp_ns, centroids)
        if tracker.state is not TrackerState.TRACKING:
            tracker.identified(stamp_ns, centroids, hip)
    assert tracker.state is TrackerState.TRACKING
    return tracker


def handle(tracker):
    """Return the native tracker."""
    return tracker._tracker.handle


def test_a_filter_that_diverges_is_given_up_whatever_max_bad_frames_is():
    motion = Motion(sky(7.0), (0.0, 0.1, 0.0), sigma_px=0.05)
    # Without jumps, which follow it.
    tracker = tracking(motion, max_bad_frames=1000, acceleration_deg_s2=1e-6,
                       roll_acceleration_deg_s2=1e-6, max_stars=100)
    for frame in range(12, 17):
        assert tracker.state is TrackerState.TRACKING
        # As by a defect of the state: it is wrong by 3 sigma of a star, and sure of that:
        # each star is in its gate, together they are off by more than 20 sigma.
        call('stt_set_motion', handle(tracker), motion.q(frame - 1 + 0.16),
             np.radians(motion.rate_deg_s), 1e-16)
        stamp_ns, centroids, _ = motion.frame(frame)
        tracker.update(stamp_ns, centroids)
        assert tracker.attitude is None
    assert tracker.state is TrackerState.LOST
    assert 'the filter has diverged: 5 frames' in tracker.reason and 'sigma' in tracker.reason


def test_a_covariance_that_is_invalid_is_given_up():
    motion = Motion(ONBOARD, (0.0, 0.1, 0.0))
    tracker = tracking(motion)
    call('stt_set_variance', handle(tracker), 4, -1e-6)
    stamp_ns, centroids, _ = motion.frame(12)
    tracker.update(stamp_ns, centroids)
    assert tracker.attitude is None and tracker.state is TrackerState.LOST
    assert 'not positive definite' in tracker.reason


def test_the_centroids_of_a_frozen_source_are_not_used():
    motion = Motion(ONBOARD, (0.0, 0.001, 0.0), sigma_px=0.05)
    tracker = tracking(motion)
    stamp_ns, centroids, hip = motion.frame(12)
    tracker.update(stamp_ns, centroids)
    assert tracker.attitude is not None
    for frame in range(13, 70):
        repeated_ns = motion.frame(frame)[0]
        assert not tracker.update(repeated_ns, centroids).usable.any()
        assert tracker.attitude is None
        if tracker.state is TrackerState.TRACKING:
            assert tracker.contradiction == REPEATED_FRAME.diagnostic
        tracker.identified(repeated_ns, centroids, hip)
    assert tracker.state is TrackerState.LOST and tracker.reason == REPEATED_FRAME.diagnostic
    assert not tracker.contradiction
    for frame in range(70, 73):
        stamp_ns, centroids, hip = motion.frame(frame)
        tracker.update(stamp_ns, centroids)
        tracker.identified(stamp_ns, centroids, hip)
    assert tracker.attitude is not None


def test_centroids_may_come_in_the_same_arrays():
    motion = Motion(ONBOARD, (0.0, 0.1, 0.0))
    tracker = tracking(motion)
    for frame in range(12, 15):
        stamp_ns, centroids, _ = motion.frame(frame)
        count = min(20, len(centroids))
        if frame == 12:
            arrays = centroids.select(np.arange(count))
        arrays.uv[:] = centroids.uv[:count]
        tracker.update(stamp_ns, arrays)
        assert tracker.attitude is not None


def test_a_gyro_at_its_range_in_the_dark_ends_the_state():
    motion = Motion(ONBOARD, (0.0, 0.1, 0.0))
    for rate, state in (([0.0, 0.1, 0.0], TrackerState.TRACKING),
                        ([0.0, 6.0, 0.0], TrackerState.LOST)):
        tracker = tracking(motion, np.radians([0.0, 0.1, 0.0]))
        assert tracker.gyro_condition == 'used'
        for k in range(10):
            tracker.add_rate(START_NS + 11 * STEP_NS + (k + 1) * STEP_NS // 10, np.radians(rate))
        tracker.update(START_NS + 12 * STEP_NS, Centroids.empty())
        assert tracker.state is state and tracker.attitude is None
    assert 'gyro_range_deg_s' in tracker.reason


def test_a_gyro_at_its_range_is_not_used_while_stars_are_seen():
    motion = Motion(ONBOARD, (0.0, 0.1, 0.0))
    tracker = tracking(motion, np.radians([0.0, 0.1, 0.0]))
    for k in range(10):
        tracker.add_rate(START_NS + 11 * STEP_NS + (k + 1) * STEP_NS // 10,
                         np.radians([0.0, 6.0, 0.0]))
    stamp_ns, centroids, _ = motion.frame(12)
    tracker.update(stamp_ns, centroids)
    assert tracker.attitude is not None and 'gyro_range_deg_s' in tracker.gyro_trouble
    assert tracker.gyro_condition == 'unused'
