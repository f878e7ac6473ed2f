# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""While a target is tracked, few images are searched as a whole: on simulated images."""

from dataclasses import replace

import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import ExtractionOptions
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.maths.rotation import conjugate, radec_from_unit, rotate
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.target import TargetTracker
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.target import Target, TargetOptions
from startracker_ros.tools.figures.correctness import error_over_bound

EPOCH_YEAR = 2026.2
START_NS = stamp_from_epoch_year(EPOCH_YEAR)
ORBIT = {'inclination_deg': 30.0, 'node_deg': 40.0, 'latitude_deg': 60.0}
# By the number of stars, all are among the brightest spots that are extracted.
OPTIONS = StarTrackerOptions(extraction=ExtractionOptions(max_stars=200))


class Scene:
    """A satellite that looks at a target, and its pipeline; begins_s is when the target is lit."""

    def __init__(self, magnitude, *, rate_hz=10.0, begins_s=0.0, seed=1):
        target = TargetOptions(
            target=True, target_altitude_km=1090.0, target_inclination_deg=30.3,
            target_node_deg=40.0, target_anomaly_deg=62.0, target_magnitude=magnitude)
        line = Target(target, EPOCH_YEAR).at(0.0)[0] - motion_from_options(
            MotionOptions(**ORBIT)).at(0.0).position_m
        ra, dec = np.degrees(radec_from_unit(line))
        motion = motion_from_options(MotionOptions(
            motion='low_earth_orbit', ra_deg=float(ra) - 1.0, dec_deg=float(dec) + 1.0, **ORBIT))
        made = [SkySimulator(CAMERA, motion, load_catalog(), EPOCH_YEAR, seed=seed,
                             target_options=options, frame_rate_hz=rate_hz)
                for options in (replace(target, target=False), target)]
        self.without, self.sky = made
        self.rate_hz, self.begins_s, self.index = rate_hz, begins_s, 0
        self.pipeline = StarTracker.with_options(CAMERA, EPOCH_YEAR, OPTIONS)
        self.tracker = TargetTracker(CAMERA, self.pipeline.tracker.sky)
        self.target = None

    def predicted(self):
        """Return what the star tracker publishes."""
        stars = self.pipeline.tracker
        return stars.predicted if stars.attitude is None else stars.predicted.joined(
            self.tracker.predicted(stars.attitude.rate_rad_s))

    def step(self):
        """Process the next image; return whether it was windowed, and the error of the target."""
        time_s, self.index = self.index / self.rate_hz, self.index + 1
        frame = (self.sky if time_s >= self.begins_s else self.without).frame(time_s)
        predicted, stamp_ns = self.predicted(), START_NS + round(time_s * 1e9)
        self.pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
        centroids = self.pipeline.extraction.process(stamp_ns, frame.image, predicted).centroids
        windowed = self.pipeline.extraction.windowed
        trusted = self.pipeline.process_centroids(stamp_ns, centroids, windowed).attitude
        if trusted is not None:
            assert error_over_bound(trusted.quaternion, trusted.covariance_sensor,
                                    frame.state.q_icrf_from_sensor) < 1
        self.target = None
        if (tracked := self.pipeline.tracker.attitude) is not None:
            self.target = self.tracker.update(stamp_ns, tracked.attitude, centroids, windowed)
        self.pipeline.tracker.acquire_new_stars()
        if self.target is None:
            return windowed, np.nan
        view = self.sky.target.seen_from(frame.state, time_s, aberration=True)
        uv = CAMERA.project(rotate(conjugate(frame.state.q_icrf_from_sensor), view.direction))
        return windowed, float(np.linalg.norm(self.target.centroid.uv[0] - uv))


@pytest.mark.parametrize(('magnitude', 'snr', 'frames', 'error_px'),
                         [(5.0, 100.0, 25, 0.05), (10.0, 7.5, 50, 0.8)])
def test_a_target_is_measured_in_images_that_are_not_searched(magnitude, snr, frames, error_px):
    scene, snrs = Scene(magnitude), []
    rows = []
    for _ in range(frames):
        rows.append(scene.step())
        snrs += [] if scene.target is None else [float(scene.target.centroid.snr[0])]
    windowed, errors = np.array(rows).T
    found = np.isfinite(errors)
    assert np.median(snrs) == pytest.approx(snr, rel=0.2) and np.nanmax(errors) < error_px
    assert found[-15:].all() and (found & (windowed == 1)).sum() >= 15
    assert windowed[5:].mean() > 0.7


def test_a_new_target_is_found_within_two_seconds():
    scene = Scene(5.0, begins_s=2.05)
    windowed, errors = np.array([scene.step() for _ in range(42)]).T
    first = int(np.flatnonzero(np.isfinite(errors))[0])
    assert 21 + 4 <= first <= 21 + 10 + 6
    # Without a spot that is not a star, one image a second is enough.
    assert windowed[5:20].sum() >= 13


def with_targets(predicted, uv):
    """Return a prediction with targets at uv (K, 2)."""
    count = len(uv)
    return predicted.joined(PredictedCentroids(
        predicted.stamp_ns, uv, np.full((count, 2), 300.0), np.full(count, 0.1),
        np.zeros(count, np.int32), 0))


def test_targets_that_are_missed_or_seen_are_not_stars():
    """They change neither which images are searched, nor the motion of the stars."""
    scene = Scene(5.0, begins_s=99.0)
    for _ in range(6):
        scene.step()
    stage, predicted = scene.pipeline.extraction, scene.predicted()
    frame = scene.without.frame(0.6)
    nowhere = with_targets(predicted, np.random.default_rng(1).uniform(10, 400, (40, 2)))
    found = stage.process(START_NS + 600_000_000, frame.image, nowhere)
    assert stage.windowed and found.streak is None
    # The stars are hidden, forty targets are not.
    level = int(np.median(frame.image))
    hidden = np.random.default_rng(2).normal(level, 3, frame.image.shape)
    uv = np.stack(np.meshgrid(np.arange(40, 480, 60), np.arange(40, 340, 60)), -1).reshape(-1, 2)
    for u, v in uv:
        hidden[v - 1:v + 2, u - 1:u + 2] += np.outer([0.5, 1, 0.5], [0.5, 1, 0.5]) * 300
    # With their motion since the prediction, 0.2 s ago.
    shown = with_targets(predicted, uv - 60.0)
    found = stage.process(START_NS + 700_000_000, hidden.astype(np.uint16), shown)
    assert not stage.windowed and len(found.centroids) >= 20


def test_a_target_that_may_be_anywhere_has_the_whole_image_searched():
    scene = Scene(5.0, begins_s=99.0)
    for _ in range(6):
        scene.step()
    stage, predicted = scene.pipeline.extraction, scene.predicted()
    image = scene.without.frame(0.6).image
    anywhere = predicted.joined(PredictedCentroids(
        predicted.stamp_ns, np.array([[255.5, 255.5]]), np.zeros((1, 2)), np.array([512.0]),
        np.zeros(1, np.int32), 0))
    for step, wanted in enumerate((predicted, anywhere, predicted)):
        stage.process(START_NS + (6 + step) * 100_000_000, image + np.uint16(step % 2), wanted)
        assert stage.windowed == (wanted is predicted)
