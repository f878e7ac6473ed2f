# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Random timestamp errors: the covariance contains the turn in that time."""

from chi_square import check_mean
import numpy as np
import pytest
from star_motion import errors_of, Motion, sky
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector)
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter
from startracker_ros.tools.figures.correctness import nees_of

ONBOARD = sky()
WARM_UP_FRAMES = 15


def flown(jitter_s, rate_deg_s, seed=0, frames=60, jerk_deg_s=0.0):
    """
    Return the errors (F, 3), their covariances (F, 3, 3) and the last sigma of the stamps.

    Every second the rate jumps by jerk_deg_s about a random axis.
    """
    rng = np.random.default_rng(seed)
    motion = Motion(ONBOARD, rate_deg_s, seed=seed)
    tracker = TrackFilter(motion.camera, ONBOARD, TrackerOptions())

    def flight():
        for frame in range(frames):
            if jerk_deg_s and frame % 10 == 0:
                axis = rng.standard_normal(3)
                here = motion.q(frame)
                motion.rate_deg_s = rate_deg_s + jerk_deg_s * axis / np.linalg.norm(axis)
                motion.q_start = multiply(here, conjugate(quaternion_from_rotation_vector(
                    np.radians(motion.rate_deg_s) * frame * 0.1)))
            stamp_ns, _, _ = motion.frame(frame)
            _, centroids, hip = motion.frame(frame + rng.normal(0, jitter_s) / 0.1)
            yield stamp_ns, centroids, hip, motion.q(frame)

    return *errors_of(tracker, flight()), tracker.stamp_sigma_s


@pytest.mark.parametrize('jitter_s, rate_deg_s', [
    (0.005, (0.1, 0.25, 0.1)), (0.02, (0.5, -0.8, 0.2)), (0.001, (1.0, 0.0, 0.0))])
def test_the_covariance_contains_the_error_of_the_stamps(jitter_s, rate_deg_s):
    runs = [flown(jitter_s, rate_deg_s, seed) for seed in range(4)]
    series = [nees_of(*run[:2])[WARM_UP_FRAMES:] for run in runs]
    values = np.concatenate(series)
    assert len(values) > 4 * 35
    check_mean(3, *series, inflation=2.0)
    assert np.mean(values < 25) > 0.97
    assert np.mean([run[2] for run in runs]) == pytest.approx(jitter_s, rel=0.4)


@pytest.mark.slow
def test_good_stamps_and_manoeuvres_are_not_errors_of_the_stamps():
    assert not any(flown(0.0, (0.1, 0.25, 0.1), seed)[2] for seed in range(10))
    assert not any(flown(0.0, (0.1, 0.25, 0.1), seed, jerk_deg_s=0.1)[2] for seed in range(10))
    assert not any(flown(0.0, (0.0, 0.0, 0.0), seed)[2] for seed in range(5))


class Swinging(Motion):
    """A camera that swings within four frames and a half besides, along its rate or not."""

    def q(self, frame):
        angle = np.radians(0.01) * np.sin(2 * np.pi * frame / 4.5)
        return multiply(super().q(frame), quaternion_from_rotation_vector([angle, 0.0, 0.0]))


class Shaken(Motion):
    """A camera that is somewhere else in each frame, by 0.01 deg about x and y."""

    def q(self, frame):
        shift = np.random.default_rng([self.seed, round(frame)]).normal(0, 1.0, 2)
        return multiply(super().q(frame), quaternion_from_rotation_vector(
            [*np.radians(0.01) * shift, 0.0]))


def estimated(motion, frames=60):
    """Return the sigma of the stamps, exact ones, after each frame of a motion."""
    tracker, sigmas = TrackFilter(motion.camera, ONBOARD, TrackerOptions()), []
    for frame in range(frames):
        stamp_ns, centroids, hip = motion.frame(frame)
        tracker.update(stamp_ns, centroids)
        if tracker.state is not TrackerState.TRACKING:
            tracker.identified(stamp_ns, centroids, hip)
        sigmas.append(tracker.stamp_sigma_s)
    return np.array(sigmas)[WARM_UP_FRAMES:]


@pytest.mark.parametrize('rate_deg_s', [(0.05, 0.1, 0.0), (0.0, 0.0, 0.0)])
def test_an_oscillation_is_not_an_error_of_the_stamps(rate_deg_s):
    sigmas = [estimated(Swinging(ONBOARD, rate_deg_s, seed=seed)) for seed in range(4)]
    assert np.mean(np.array(sigmas) > 0) < 0.15


def test_a_shaken_camera_is_no_larger_error_of_the_stamps_than_it_moves():
    # Along the rate it moves now and then more than across it.
    sigmas = [estimated(Shaken(ONBOARD, (0.1, 0.0, 0.0), seed=seed)) for seed in range(10)]
    assert 0.1 * np.array(sigmas).max() < 0.01
