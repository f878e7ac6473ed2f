# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude between two frames of a camera with a rolling shutter, by Attitude.at()."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.correctness import nees_of
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

CAMERA = Camera.from_fov(512, 512, 12.0)
DETECTOR = DetectorOptions(exposure_s=0.01, psf_sigma_px=0.8, motion_smear=True,
                           zero_flux_e_s=2e7, full_well_e=50000.0, line_time_us=150.0)
PERIOD_S, SKIES, FRAMES, SETTLED = 0.1, 3, 35, 15
OFFSETS_S = np.arange(-8, 9) * PERIOD_S / 16
START_NS = stamp_from_epoch_year(2026.5)


def between_frames():
    """Yield attitude and true attitude at the offsets, of settled frames at 5 deg/s."""
    for sky in range(SKIES):
        motion = motion_from_options(MotionOptions(
            motion='constant_rate', ra_deg=60.0 * sky, dec_deg=10.0 * sky - 25.0,
            rate_deg_s=(3.0, 4.0, 0.5)))
        simulator = SkySimulator(CAMERA, motion, load_catalog(), 2026.5,
                                 detector_options=DETECTOR, frame_rate_hz=1 / PERIOD_S, seed=sky)
        tracker = StarTracker(CAMERA, 2026.5, line_time_us=DETECTOR.line_time_us)
        for number in range(FRAMES):
            time_s, stamp_ns = number * PERIOD_S, START_NS + round(number * PERIOD_S * 1e9)
            frame = simulator.frame(time_s)
            tracker.motion.add_state(stamp_ns, frame.state.geocentric)
            attitude = tracker.process(stamp_ns, frame.image).attitude
            if attitude is not None and number >= SETTLED:
                yield attitude, [
                    (attitude.at(stamp_ns + round(offset_s * 1e9)),
                     motion.at(time_s + offset_s).q_icrf_from_sensor) for offset_s in OFFSETS_S]


@pytest.fixture(scope='module')
def rows():
    return list(between_frames())


def nees(pairs):
    return nees_of(np.array([attitude_error(one.quaternion, truth) for one, truth in pairs]),
                   np.array([one.covariance_sensor for one, _ in pairs]))


@pytest.mark.slow
def test_its_covariance_is_that_of_its_error(rows):
    assert len(rows) > 0.8 * SKIES * (FRAMES - SETTLED)
    # One frame in five is independent. The covariance contains motions that may begin.
    _, high = mean_chi_square_bounds(3, len(rows) // 5)
    for pairs in zip(*(pairs for _, pairs in rows)):
        assert 1.4 < nees(pairs).mean() < high


def test_it_is_better_known_before_than_after_the_newest_frame(rows):
    for _, pairs in rows:
        variances = [np.trace(one.covariance_sensor) for one, _ in pairs]
        assert variances[0] < variances[-1]


def test_a_time_in_two_steps_is_as_in_one(rows):
    # What an acceleration adds is not the same.
    attitude = replace(rows[-1][0], acceleration_rad_s2=np.zeros(3), before_rad_s2=np.zeros(3))
    steps = attitude.at(attitude.stamp_ns + 20_000_000).at(attitude.stamp_ns + 50_000_000)
    once = attitude.at(attitude.stamp_ns + 50_000_000)
    assert np.allclose(steps.covariance_sensor, once.covariance_sensor, rtol=1e-2)
    assert np.linalg.norm(attitude_error(steps.quaternion, once.quaternion)) < 1e-10


def test_without_the_correlation_the_covariance_is_a_bound(rows):
    for attitude, pairs in rows:
        bound = replace(attitude, cross_covariance=None)
        for one, _ in pairs:
            more = bound.at(one.stamp_ns).covariance_sensor - one.covariance_sensor
            assert np.trace(more) > -1e-20
