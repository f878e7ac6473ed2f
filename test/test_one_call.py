# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One call a frame gives what the four stages give, each with a tracker of its own as in nodes."""

from itertools import islice

import numpy as np
import pytest
from startracker_evaluation.campaign import integrity, integrity_motion
from startracker_ros.core import native
from startracker_ros.core.frame_result import Attitude
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.stages.attitude import AttitudeStage
from startracker_ros.core.stages.extraction import ExtractionStage
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.tracking import make_track_filter
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.tools.datasheet import image_runs
from transcripts import frames_of, NAMES

STAR_TRACKER, PIPELINE = integrity_motion.star_tracker, image_runs._pipeline


class FourStages:
    """Stages that share nothing but the motion of the observer, and what they hand on."""

    def __init__(self, camera, epoch_year, options, motion):
        self.extraction = ExtractionStage(options.extraction, options.search)
        self.identification = IdentificationStage(
            camera, epoch_year, options.identification, options.check, gyro=options.gyro,
            band=options.band)
        self.tracker = make_track_filter(
            camera, epoch_year, options.tracker, options.gyro, motion, options.band)
        self.attitude = AttitudeStage(camera, epoch_year, options.validation, motion,
                                      self.tracker.sky, options.protection)

    def reset(self):
        for stage in (self.extraction, self.identification, self.tracker, self.attitude):
            stage.reset()

    def process(self, stamp_ns, image):
        seen = self.extraction.process(stamp_ns, image, self.tracker.predicted)
        return self.process_centroids(stamp_ns, seen.centroids, self.extraction.windowed)

    def process_centroids(self, stamp_ns, centroids, windowed=False):
        """Return centroids, tracks, attitude, identification, state and residuals of a frame."""
        idle = self.identification.is_idle(stamp_ns, self.tracker.follows, windowed)
        tracks = self.tracker.update(stamp_ns, centroids) or Tracks.empty()
        tracked, found = self.tracker.attitude, None
        trusted = self.attitude.from_tracks(stamp_ns, tracks, tracked)
        attitude = None if trusted.attitude is None else Attitude.of(
            stamp_ns, trusted.attitude, tracked, self.tracker.acceleration,
            cross_covariance=self.tracker.cross_covariance,
            protection_rad=trusted.protection_rad)
        if not idle:
            found, at_once = self.identification.identify(stamp_ns, centroids)
            self.tracker.identified(stamp_ns, at_once, found.hip)
            identifier = self.identification.identifier
            found = icrf_identification(found, at_once, identifier.camera,
                                        self.attitude.sky.at(stamp_ns), identifier.options)
        return centroids, tracks, attitude, found, self.tracker


class Compared(StarTracker):
    """A star tracker whose results are compared with those of four stages."""

    def _build(self, camera, epoch, options):
        super()._build(camera, epoch, options)
        self.apart = FourStages(camera, epoch.year, options, self.motion)
        self.compared = 0
        # Of a rolling shutter the stages move the stars by sums in another order.
        self.exact = not options.extraction.line_time_us

    def reset(self):
        super().reset()
        if 'apart' in vars(self):
            self.apart.reset()

    def add_rate(self, stamp_ns, rate_rad_s):
        super().add_rate(stamp_ns, rate_rad_s)
        self.apart.tracker.add_rate(stamp_ns, rate_rad_s)

    def process(self, stamp_ns, image):
        expected = self.apart.process(stamp_ns, image)
        return self.compare(super().process(stamp_ns, image), *expected)

    def process_centroids(self, stamp_ns, centroids, windowed=False):
        expected = self.apart.process_centroids(stamp_ns, centroids, windowed)
        return self.compare(super().process_centroids(stamp_ns, centroids, windowed), *expected)

    def compare(self, frame, centroids, tracks, attitude, found, tracker):
        self.compared += 1
        same = np.testing.assert_array_equal if self.exact else close
        for name in ('uv', 'flux', 'covariance', 'common', 'delay_s', 'exposure_s'):
            same(getattr(frame.centroids, name), getattr(centroids, name))
        for name in tracks.table().dtype.names:
            same(frame.tracks.table()[name], tracks.table()[name], name)
        assert (frame.state, self.tracker.contradiction, self.tracker.checks_passed) == (
            tracker.state, tracker.contradiction, tracker.checks_passed)
        for one, other in ((frame.attitude, attitude), (frame.identification, found)):
            assert (one is None) == (other is None)
            for name in vars(other) if other is not None else ():
                self.compare_field(same, getattr(one, name), getattr(other, name))
        return frame

    def compare_field(self, same, one, other):
        if isinstance(other, str) or other is None:
            assert one == other
        elif hasattr(other, 'quaternion'):
            same(one.quaternion, other.quaternion)
            same(one.covariance_sensor, other.covariance_sensor)
        else:
            same(np.array(one, float), np.array(other, float))


def close(one, other, name=''):
    np.testing.assert_allclose(one, other, 1e-6, 1e-9, err_msg=name)


@pytest.fixture
def runs_of(monkeypatch):
    """Return what makes the runs of transcripts use a kind of star tracker; list those made."""
    def use(kind):
        made = []

        def of_kind(build):
            def star_tracker(*arguments):
                with monkeypatch.context() as patch:
                    patch.setattr(f'{build.__module__}.StarTracker', kind)
                    made.append(build.__wrapped__(*arguments))
                return made[-1]
            return star_tracker

        for module in (integrity, integrity_motion):
            monkeypatch.setattr(module, 'star_tracker', of_kind(STAR_TRACKER))
        monkeypatch.setattr(image_runs, '_pipeline', of_kind(PIPELINE))
        return made
    return use


@pytest.mark.parametrize('name', NAMES[::3] + ('rolling shutter 1 deg/s',))
def test_a_frame_has_the_same_bits(runs_of, name):
    made, frames = runs_of(Compared), list(frames_of(name))
    assert len(made) == 1 and made[0].compared >= len(frames)
    assert any(frame.attitude is not None for frame in frames)


def test_an_identification_in_slices_is_of_the_frame_that_it_began_with(runs_of, monkeypatch):
    name, standard = '30 false, 20 % missing', native.defaults
    at_once = list(islice(frames_of(name), 30))

    def in_slices():
        config = standard()
        config['identification']['slice_s'] = 3e-4
        return config

    monkeypatch.setattr(native, 'defaults', in_slices)
    runs_of(StarTracker)
    later = list(islice(frames_of(name), 30))
    number, found = next((number, frame) for number, frame in enumerate(later)
                         if frame.identification is not None)
    assert number > 0 and found.state == at_once[0].state == 'ACQUIRING'
    np.testing.assert_array_equal(found.identification.hip, at_once[0].identification.hip)
    assert later[-1].attitude is not None
