# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""attitude_estimator: tracks and tracked_attitude, or stars -> attitude in four message types."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.integrity.protection import ProtectionOptions
from startracker_ros.core.integrity.validation import (
    TrustedAttitude, UNUSED_SOLVER, ValidationOptions)
from startracker_ros.core.options import option, Options
from startracker_ros.core.stages.attitude import AttitudeStage
from startracker_ros.core.stages.frame_path import FramePath
from startracker_ros.core.track.tracks import TrackedAttitude
from startracker_ros.io.bags.cloud_rows import centroids_from_rows
from startracker_ros.io.bags.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.ros import qos
from startracker_ros.ros.attitude_output import AttitudeImuOptions, AttitudeOutput
from startracker_ros.ros.body_output import MountOptions
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.frame_pairs import FramePairs
from startracker_ros.ros.frames import AttitudeFrameOptions, ExtraFrameOptions
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.clouds import tracks_from_message
from startracker_ros.ros.node import main_of
from startracker_ros.ros.odometry_input import OdometryInput
from startracker_ros.ros.sub_frame_output import SubFrameOptions, SubFrameOutput


@dataclass(frozen=True)
class SourceOptions(Options):
    """Where the stars come from."""

    source: str = option(
        'tracks', 'tracks of the star tracker, with its own attitude where it publishes one, or '
        'stars of single frames identified lost-in-space',
        choices=('tracks', 'stars'), read_only=True)


class AttitudeEstimatorNode(CameraNode):
    """Publishes the attitude of each frame that has a trusted one, in ICRF."""

    option_classes = (SourceOptions, ValidationOptions, ProtectionOptions, AttitudeFrameOptions,
                      ExtraFrameOptions, MountOptions, AttitudeImuOptions, SubFrameOptions,
                      AberrationOptions)
    task = 'attitude'

    def __init__(self) -> None:
        super().__init__('attitude_estimator')
        self._observer = OdometryInput(self, AttitudeFrameOptions)
        self._output = AttitudeOutput(self, self._observer)
        self._sub_frames = SubFrameOutput(self)
        # The attitude is in one message, the stars that it is checked against are in the other.
        self._pairs = FramePairs('tracks', 'tracked_attitude')
        if self.options(SourceOptions).source == 'tracks':
            self.frame_topic = 'tracks'
            self.subscribe(Imu, 'tracked_attitude', self._on_tracked_attitude, qos.LIST)
            self.subscribe(PointCloud2, 'tracks', self._on_tracks, qos.LIST)
        else:
            self.subscribe(PointCloud2, 'stars', self._on_stars, qos.LIST)
        self.advertise_reset()
        self._published_ns = 0
        # None until the tracker of the same process has built the path for both.
        self._stage: AttitudeStage | None = None
        if self.one_call is not None:
            self.one_call.estimator = self

    def restart(self) -> None:
        self._observer.rebuild()
        self._output.rebuild()
        self._pairs.clear()
        self._sub_frames.clear()
        self._published_ns = 0

    def uses_path_of(self, tracker: CameraNode) -> bool:
        """Return whether the attitude is that of a tracker, seen by the same observer."""
        return (self.options(SourceOptions).source == 'tracks'
                and self.options(AberrationOptions) == tracker.options(AberrationOptions))

    def use_path(self, path: FramePath) -> None:
        """Check on a path that serves other nodes as well."""
        self._stage = path.attitude
        # Live options that have changed meanwhile.
        self.set_live_options()

    def builder(self, camera: Camera, epoch_year: float) -> Callable[[], AttitudeStage] | None:
        if self.one_call is not None and self.one_call.is_complete:
            # use_path() is called before any tracks come.
            return None
        return partial(AttitudeStage, camera, epoch_year, self.options(ValidationOptions),
                       self._observer.motion, protection=self.options(ProtectionOptions))

    def use(self, built: AttitudeStage | None) -> None:
        self._stage = built or self._stage

    def set_live_options(self) -> None:
        if self._stage is not None:
            self._stage.set_limits(self.options(ValidationOptions),
                                   self.options(ProtectionOptions))

    def follow_frame(self, frame_id: str) -> str:
        """Return the frame of the parameter or, if that is not set, of the images."""
        frame_id = super().follow_frame(
            self.options(AttitudeFrameOptions).sensor_frame_id or frame_id)
        self._output.follow_frame(frame_id)
        return frame_id

    def publish_processed(self, stamp_ns: int, frame_id: str, path: FramePath) -> None:
        """Publish the attitude of a frame that was processed with its image."""
        self.follow_frame(frame_id)
        self._published_ns = stamp_ns
        self._publish(stamp_ns, path.trusted(), path.tracker.attitude)
        self.diagnostics.values['calls_per_frame'] = 1

    def _on_tracked_attitude(self, message: Imu) -> None:
        if ns_from_stamp(message.header.stamp) == self._published_ns:
            return
        self._pair('tracked_attitude', ns_from_stamp(message.header.stamp),
                   tracked_attitude_from_imu(message))

    def _on_tracks(self, message: PointCloud2) -> None:
        if self.camera_or_drop() is None or self._stage is None or not self.in_order(
                'tracks', message.header.stamp):
            return
        self.follow_frame(message.header.frame_id)
        stamp_ns = ns_from_stamp(message.header.stamp)
        if stamp_ns == self._published_ns:
            return
        tracks = tracks_from_message(message)
        if (self._pairs.waits('tracked_attitude', stamp_ns)
                or self.count_publishers('tracked_attitude')):
            self._pair('tracks', stamp_ns, tracks)
        else:
            self._output.publish(stamp_ns, self._stage.from_tracks_alone(stamp_ns, tracks), None)

    def _pair(self, topic: str, stamp_ns: int, value: Any) -> None:
        """Publish the attitude of a frame of which both messages have come."""
        pair = self._pairs.add(topic, stamp_ns, value)
        if unpaired := self._pairs.unpaired['tracks']:
            self.diagnostics.counts['tracks without tracked_attitude'] = unpaired
        if pair is None or self._stage is None:
            return
        tracks, tracked = pair
        solver = self.options(ValidationOptions).solver
        if solver != ValidationOptions.solver:
            self.diagnostics.report_event(UNUSED_SOLVER.format(solver))
        self._publish(stamp_ns, self._stage.from_tracks(stamp_ns, tracks, tracked), tracked)
        self.diagnostics.values['calls_per_frame'] = 3

    def _publish(self, stamp_ns: int, result: TrustedAttitude, tracked: TrackedAttitude | None
                 ) -> None:
        self._output.publish(stamp_ns, result, tracked)
        if tracked is not None:
            self._sub_frames.add(stamp_ns, result.attitude, tracked)

    def _on_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        if self.camera_or_drop() is not None and self._stage is not None and self.in_order(
                'stars', message.header.stamp):
            self.follow_frame(message.header.frame_id)
            stamp_ns = ns_from_stamp(message.header.stamp)
            self._output.publish(stamp_ns, self._stage.from_stars(
                stamp_ns, centroids_from_rows(rows), rows['hip'].astype(np.int32)), None)


main = main_of(AttitudeEstimatorNode)

if __name__ == '__main__':
    main()
