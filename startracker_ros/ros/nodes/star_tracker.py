# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""star_tracker: centroids, stars, imu, hint, camera_info -> tracks, attitude, predictions."""

from functools import partial

from geometry_msgs.msg import AccelWithCovarianceStamped
import numpy as np
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.core.astro.exclusion import ExclusionOptions
from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.stages.tracking import make_trackers
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.target import TargetTrackOptions
from startracker_ros.io.bags.cloud_rows import centroids_from_rows
from startracker_ros.io.bags.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.frames import InertialFrameOptions
from startracker_ros.ros.messages.attitude import (
    acceleration_to_message, attitude_to_imu, hint_from_imu, tracked_attitude_to_imu)
from startracker_ros.ros.messages.clouds import frame_from_message, tracks_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.node import main_of, publish_if_subscribed, publish_value
from startracker_ros.ros.odometry_input import OdometryInput
from startracker_ros.ros.star_tracker_output import (
    PredictionsOutput, TargetOutput, TrackerStateOutput)
from std_msgs.msg import Header


class StarTrackerNode(CameraNode):
    """Tracks identified stars from frame to frame and reports its state."""

    option_classes = (TrackerOptions, GyroErrorOptions, TargetTrackOptions, AberrationOptions,
                      ExclusionOptions, InertialFrameOptions, BandOptions)
    task = 'tracking'

    def __init__(self) -> None:
        super().__init__('star_tracker')
        self.frame_topic = 'centroids'
        self._tracks = self.advertise(PointCloud2, 'tracks', qos.LIST)
        self._attitude = self.advertise(Imu, 'tracked_attitude', qos.LIST)
        self._acceleration = self.advertise(
            AccelWithCovarianceStamped, 'tracked_acceleration', qos.LIST)
        self._frame_attitude = self.advertise(Imu, 'frame_attitude', qos.LIST)
        self._predicted = PredictionsOutput(self)
        self._target = TargetOutput(self)
        self._observer = OdometryInput(self, InertialFrameOptions)
        self._state = TrackerStateOutput(self, self._observer)
        self.subscribe(PointCloud2, 'centroids', self._on_centroids, qos.LIST)
        self.subscribe(PointCloud2, 'stars', self._on_stars, qos.LIST)
        self.subscribe(Imu, 'hint', self._on_hint, qos.LIST)
        self.subscribe_rates(self._add_rate)
        self.advertise_reset()
        self._processed_ns = 0
        if self.one_call is not None:
            self.one_call.tracker = self

    def builder(self, camera: Camera, epoch_year: float) -> partial:
        self._observer.rebuild()
        if self.one_call is not None and self.one_call.is_complete:
            return self.one_call.builder(camera, epoch_year, self.options(TargetTrackOptions),
                                         self._observer.motion)
        return partial(make_trackers, camera, epoch_year, self.options(TrackerOptions),
                       self.options(GyroErrorOptions), self.options(TargetTrackOptions),
                       self._observer.motion, self.options(BandOptions))

    def use(self, built: tuple) -> None:
        self._tracker, self._target_tracker, *path = built
        self._state.begin(self._tracker)
        self._processed_ns = 0
        if path and self.one_call is not None:
            self.one_call.adopt(*path)

    @property
    def follows_target(self) -> bool:
        """Whether anybody wants the target, whose predictions go to the extractor."""
        return self._target.is_wanted

    def take_processed(self, stamp_ns: int) -> None:
        """Take the figures of a frame that was processed with its image."""
        self._tracker.look(stamp_ns)
        self._processed_ns = stamp_ns

    def set_live_options(self) -> None:
        if self.camera is not None:
            self._tracker.set_limits(self.options(TrackerOptions))

    def _add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        return self.camera is None or self._tracker.add_rate(stamp_ns, rate_rad_s)

    def _on_hint(self, message: Imu) -> None:
        if self.camera is not None:
            self._tracker.add_hint(hint_from_imu(message))

    def _on_centroids(self, message: PointCloud2) -> None:
        centroids, windowed = frame_from_message(message)
        camera, stamp_ns = self.camera_or_drop(), ns_from_stamp(message.header.stamp)
        if camera is None or not self.in_order('centroids', message.header.stamp):
            return
        header = make_header(stamp_ns, self.follow_frame(message.header.frame_id))
        tracks = (self._tracker.tracks if stamp_ns == self._processed_ns else
                  self._tracker.update(stamp_ns, centroids))
        if tracks is None:
            return
        # Before the tracks, so that a subscriber of both has both when the tracks come.
        tracked = self._tracker.attitude
        publish_value(self._attitude, header, tracked, partial(
            tracked_attitude_to_imu, tracked, header))
        if tracked is not None:
            publish_if_subscribed(self._acceleration, lambda: acceleration_to_message(
                self._tracker.acceleration, header))
        publish_if_subscribed(self._frame_attitude, lambda: attitude_to_imu(
            self._tracker.frame_attitude, header))
        publish_value(self._tracks, header, tracks, partial(
            tracks_to_message, tracks, camera, header))
        self.defer(partial(self._finish, header, camera, centroids, windowed))

    def _finish(self, header: Header, camera: Camera, centroids: Centroids, windowed: bool
                ) -> None:
        """Do with a frame what its attitude does not depend on."""
        targets = self._target.update(
            self._target_tracker, self._tracker, centroids, windowed, camera, header)
        self._predicted.publish(self._tracker, targets, camera, header)
        self._state.publish(self._tracker, ns_from_stamp(header.stamp))
        self._observer.report(ns_from_stamp(header.stamp))
        self._tracker.acquire_new_stars()

    def _on_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        if self.camera_or_drop() is None or not self.in_order('stars', message.header.stamp):
            return
        self._tracker.identified(
            ns_from_stamp(message.header.stamp), centroids_from_rows(rows), rows['hip'])
        self._state.publish(self._tracker)


main = main_of(StarTrackerNode)

if __name__ == '__main__':
    main()
