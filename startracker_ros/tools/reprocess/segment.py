# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One segment: messages of a bag through a pipeline of its own."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
import time
from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import catalogue_epoch, NOT_STAMPED, RESTART_NS
from startracker_ros.core.astro.observer_motion import MotionError
from startracker_ros.core.camera.model import CameraError
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.cloud_rows import centroids_from_rows
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.layouts import (
    camera_from_message, CENTROID_DTYPE, image_from_message, INERTIAL_FRAME_ID, MessageError,
    ns_from_stamp, read_cloud, SENSOR_FRAME_ID)
from startracker_ros.io.bags.reader import BagMessage, read_messages
from startracker_ros.io.bags.telemetry import (
    ExposureTimes, state_from_odometry, unit_quaternion)
from startracker_ros.io.recordings.recording import full_name
from startracker_ros.tools.reprocess.frame_fit import fit_frame, FrameFit, Stars
from startracker_ros.tools.reprocess.leftovers import Leftovers
from startracker_ros.tools.reprocess.output import SegmentBag
from startracker_ros.tools.reprocess.plan import IMAGE, Segment
from startracker_ros.tools.reprocess.smoothing import Smoothing
from startracker_ros.tools.reprocess.tables import FittedStars, NO_STARS, SegmentTables

_EPOCH_STEPS = 20
"""Epochs of the catalogue in a year: within such a step no star moves by more than 0.5 arcsec."""

_MOST_CAMERAS = 10
_TRUTH_FRAMES = 1000


class SegmentError(ValueError):
    """A segment that cannot be processed; the text says why."""


@dataclass
class Tally:
    """Counts of a segment, and the messages that were not used, by reason."""

    frames: int = 0
    attitudes: int = 0
    cpu_s: float = 0.0
    problems: Counter[str] = field(default_factory=Counter)


class SegmentRun:
    """Reads the messages of a segment; results go to bag and tables."""

    def __init__(self, segment: Segment, options: StarTrackerOptions, bag: SegmentBag | None,
                 tables: SegmentTables, leftovers: Leftovers,
                 smoothing: Smoothing | None = None) -> None:
        self._segment, self._options = segment, options
        self._bag, self._tables, self._smoothing = bag, tables, smoothing
        self._leftovers = leftovers
        self._camera = segment.camera
        self._cameras = 0
        self._pipeline: StarTracker | None = None
        self._newest_ns: int | None = None
        self._frame_id = ''
        self._exposures = ExposureTimes()
        self._truth: dict[int, np.ndarray] = {}
        self.tally = Tally()
        handlers = {segment.source: self._on_frame, 'camera_info': self._on_camera,
                    'imu': self._on_imu, 'odometry': self._on_odometry,
                    'exposure_start': self._on_exposure, 'truth/attitude': self._on_truth}
        self._handlers = {full_name(segment.namespace, topic): handler
                          for topic, handler in handlers.items()}

    def run(self) -> Tally:
        """Process all messages; SegmentError, or OSError where results cannot be written."""
        segment, begin_s = self._segment, time.process_time()
        for message in read_messages(
                segment.bag, topics=tuple(self._handlers), start_ns=segment.start_ns,
                end_ns=segment.end_ns if self._smoothing is None else segment.stop_ns,
                tolerant=True, report=self._on_damage):
            try:
                self._handlers[message.topic](message)
            except (MessageError, CameraError, MotionError, _DecodeError) as error:
                if segment.holds(message.log_time_ns):
                    self.tally.problems[f'{message.topic}: {error}'] += 1
        self.tally.cpu_s = time.process_time() - begin_s
        return self.tally

    def _on_damage(self, problem: str) -> None:
        self.tally.problems[problem] += 1

    def _on_camera(self, message: BagMessage) -> None:
        camera = camera_from_message(_decoded(message))
        if not camera.is_same(self._camera):
            self._camera, self._pipeline = camera, None
            self._cameras += 1
            if self._cameras > _MOST_CAMERAS:
                raise SegmentError(f'{message.topic} changes with each message: two cameras '
                                   'publish on one topic')

    def _on_imu(self, message: BagMessage) -> None:
        rates = cdr.read_rates(message.data)
        if rates.covariance[0] == -1:
            raise MessageError('angular_velocity_covariance[0] is -1: no angular velocity')
        if self._frame_id not in ('', rates.header.frame_id or SENSOR_FRAME_ID):
            raise MessageError(f'frame {rates.header.frame_id!r} is not that of the centroids, '
                               f'{self._frame_id!r}')
        if self._pipeline is not None:
            self._pipeline.add_rate(rates.header.stamp_ns, rates.rate_rad_s)
        if self._smoothing is not None:
            self._smoothing.add_rate(rates.header.stamp_ns, rates.rate_rad_s)

    def _on_odometry(self, message: BagMessage) -> None:
        decoded = _decoded(message)
        state = state_from_odometry(decoded, INERTIAL_FRAME_ID)
        stamp_ns = ns_from_stamp(decoded.header.stamp)
        self._pipeline_at(stamp_ns, message.log_time_ns).motion.add_state(stamp_ns, state)

    def _on_exposure(self, message: BagMessage) -> None:
        self._exposures.add(_decoded(message))

    def _on_truth(self, message: BagMessage) -> None:
        header, quaternion = cdr.read_quaternion(message.data)
        self._truth[header.stamp_ns] = unit_quaternion(quaternion)
        if len(self._truth) > _TRUTH_FRAMES:
            del self._truth[next(iter(self._truth))]

    def _on_frame(self, message: BagMessage) -> None:
        if message.type_name == IMAGE:
            decoded = _decoded(message)
            content: Any = image_from_message(decoded)
            content.check_size(self._camera)
            stamp_ns, frame_id = ns_from_stamp(decoded.header.stamp), decoded.header.frame_id
        else:
            cloud = cdr.read_point_cloud(message.data)
            rows = read_cloud(cloud, CENTROID_DTYPE)
            content = centroids_from_rows(rows), bool(len(rows)) and bool(rows['directed'][0])
            stamp_ns, frame_id = cloud.header
        if not stamp_ns:
            raise MessageError(NOT_STAMPED)
        self._frame_id = frame_id or SENSOR_FRAME_ID
        if self._newest_ns is not None and stamp_ns <= self._newest_ns:
            if self._newest_ns - stamp_ns <= RESTART_NS:
                raise MessageError('a frame is not newer than the one before')
            # As the nodes do: a restarted simulation, or a clock that was set.
            self._pipeline, self._exposures = None, ExposureTimes()
            self.tally.problems[f'{message.topic}: time went back by more than '
                                f'{RESTART_NS * 1e-9:g} s, state forgotten'] += 1
        self._newest_ns = stamp_ns
        pipeline = self._pipeline_at(stamp_ns, message.log_time_ns)
        if message.type_name == IMAGE:
            frame = pipeline.process(stamp_ns, content.pixels, cell=content.cell,
                                     exposure_s=self._exposures.at(stamp_ns))
        else:
            frame = pipeline.process_centroids(stamp_ns, *content)
        seen = frame.centroids
        holds, truth = self._segment.holds(message.log_time_ns), self._truth.pop(stamp_ns, None)
        stars, fit = self._fit(seen, frame, pipeline)
        if holds:
            self._record(stamp_ns, seen, frame, pipeline)
            self._tables.add(stamp_ns, frame, pipeline.tracker.residual_px, truth, stars,
                             fit)
        if message.log_time_ns < self._segment.end_ns:
            self._leftovers.add(stamp_ns, self._camera, seen, frame, pipeline,
                                np.nan if fit is None else fit.zero_point_mag, holds)
        if self._smoothing is not None:
            attitude = frame.attitude
            self._smoothing.add(stamp_ns, None if attitude is None else attitude.quaternion,
                                fit, truth,
                                uses_gyro=pipeline.tracker.gyro_condition == 'used',
                                wanted=holds)
        pipeline.tracker.acquire_new_stars()

    def _record(self, stamp_ns: int, centroids: Centroids, frame: FrameResult,
                pipeline: StarTracker) -> None:
        """Count a frame and add its results to the bag."""
        self.tally.frames += 1
        no_date = pipeline.motion.why_no_date(stamp_ns)
        if no_date and pipeline.motion.at(stamp_ns).trouble:
            self.tally.problems[f'aberration not corrected: {no_date}'] += 1
        self.tally.attitudes += frame.attitude is not None
        if frame.identification is not None and frame.identification.status == 'time_limit':
            self.tally.problems['an identification reached time_limit_s: that frame may differ '
                                'on another machine'] += 1
        if self._bag is not None:
            self._bag.write(stamp_ns, self._frame_id, self._camera, centroids,
                            self._segment.source != 'centroids', frame, pipeline)

    def _fit(self, centroids: Centroids, frame: FrameResult, pipeline: StarTracker
             ) -> tuple[FittedStars, FrameFit | None]:
        """Return the stars of the fit of a frame, and this, None without an attitude."""
        attitude = frame.attitude
        if attitude is None:
            return NO_STARS, None
        tracks, sky = frame.tracks, pipeline.attitude.sky.at(frame.stamp_ns)
        used = tracks.usable
        hip, uv = tracks.hip[used], tracks.uv[used]
        stars = Stars(sky.direction(sky.onboard.index_of(hip)), uv,
                      tracks.position_sigma_px[used], tracks.magnitude[used])
        fit = fit_frame(self._camera, attitude.quaternion, stars, centroids.uv,
                        centroids.sigma_px, centroids.flux)
        if fit is None:
            return NO_STARS, None
        return FittedStars(hip[fit.star], uv[fit.star], tracks.snr[used][fit.star]), fit

    def _pipeline_at(self, stamp_ns: int, received_ns: int) -> StarTracker:
        """Return the pipeline, a new one after another camera came or time went back."""
        if self._pipeline is None:
            epoch = catalogue_epoch(stamp_ns, received_ns)
            self._pipeline = StarTracker.with_options(self._camera, epoch._replace(
                year=round(epoch.year * _EPOCH_STEPS) / _EPOCH_STEPS), self._options)
        return self._pipeline


class _DecodeError(BagError):
    """A message that is not of its type."""


def _decoded(message: BagMessage) -> Any:
    try:
        return message.decoded()
    except BagError as error:
        raise _DecodeError(str(error)) from error


def segment_folder(partial: Path, segment: Segment) -> Path:
    """Return where the bag of a segment is written: its last name is that of its file."""
    return partial / f'{segment.name}_{segment.begin_ns // 1_000_000_000}'
