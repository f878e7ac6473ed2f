# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A hint replaces the second identification, and a false one does no harm."""

import numpy as np
import pytest
from skies import CAMERA, onboard_stars
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import attitude_error, turned
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter
from startracker_ros.core.track.tracks import Hint

EPOCH_YEAR = 2026.5
START_NS = stamp_from_epoch_year(EPOCH_YEAR)
STEP_NS = 100_000_000
RATE = np.radians([0.2, -0.1, 0.3])
Q0 = np.array([0.1, 0.7, -0.3, 0.64])
Q0 /= np.linalg.norm(Q0)
DEG = np.radians(1.0)


class Run:
    """A tracker, frames of a steady turn, and identifications of all stars."""

    def __init__(self):
        self.sky = onboard_stars(CAMERA, EPOCH_YEAR, 6.5)
        self.tracker = TrackFilter(CAMERA, self.sky)
        self.rng = np.random.default_rng(3)

    def truth(self, frame):
        return turned(Q0, RATE * frame * 0.1)

    def frame(self, frame, identified=True):
        centroids, hip = star_list(self.sky, CAMERA, self.truth(frame), 0.1, self.rng)
        self.tracker.update(START_NS + frame * STEP_NS, centroids)
        if identified and self.tracker.state is not TrackerState.TRACKING:
            self.tracker.identified(START_NS + frame * STEP_NS, centroids, hip)

    def hint(self, frame, error=(0.0, 0.0, 0.0), sigma=DEG, rate=RATE, rate_sigma=1e-5):
        self.tracker.add_hint(Hint(
            START_NS + frame * STEP_NS, turned(self.truth(frame), np.array(error)),
            np.eye(3) * sigma ** 2, rate, np.eye(3) * rate_sigma ** 2))

    def is_right(self, frame):
        tracked = self.tracker.attitude
        return tracked is not None and np.linalg.norm(attitude_error(
            tracked.attitude.quaternion, self.truth(frame))) < 1e-3


@pytest.fixture
def run():
    return Run()


def test_a_hint_of_1_deg_starts_at_the_first_identified_frame(run):
    run.hint(-20, error=(0.5 * DEG, -0.8 * DEG, 1.5 * DEG))
    run.frame(0)
    assert run.tracker.state is TrackerState.TRACKING and run.is_right(0)
    assert 'where a hint has them' in run.tracker.reason
    run.frame(1)
    assert run.is_right(1)


@pytest.mark.parametrize('hint', [
    {'error': (8 * DEG, 0.0, 0.0)}, {'error': (0.02, 0.0, 0.0), 'sigma': 1e-4},
    {'sigma': 5 * DEG}, {'rate_sigma': 2 * DEG}, {'frame': -100}])
def test_a_false_loose_or_old_hint_is_not_used(run, hint):
    run.hint(**{'frame': -1, **hint})
    run.frame(0)
    assert run.tracker.state is TrackerState.ACQUIRING and run.tracker.attitude is None
    run.frame(1)
    assert run.tracker.state is TrackerState.TRACKING and run.is_right(1)


def test_a_false_rate_does_not_keep_the_tracker_from_the_stars(run):
    for frame in range(40):
        run.hint(frame, rate=np.radians([4.0, 3.0, -5.0]))
        run.frame(frame)
        assert run.tracker.attitude is None or run.is_right(frame)
    assert run.tracker.state is TrackerState.TRACKING and run.is_right(39)


def test_a_reset_forgets_the_hint(run):
    run.hint(0)
    run.tracker.reset()
    run.frame(1)
    assert run.tracker.state is TrackerState.ACQUIRING
