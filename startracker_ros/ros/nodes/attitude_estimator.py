"""attitude_estimator: tracks and tracked_attitude, or stars -> attitude in four message types."""

from dataclasses import dataclass

import numpy as np
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.astro.observer_motion import AberrationOptions, ObserverMotion
from startracker_ros.attitude.validation import ValidationOptions
from startracker_ros.bag.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.centroid.synthetic_field import WARM_UP_CAMERA, WARM_UP_EPOCH_YEAR
from startracker_ros.options import option, Options
from startracker_ros.pipeline.attitude import AttitudeStage
from startracker_ros.pipeline.cloud_rows import centroids_from_rows
from startracker_ros.ros import qos
from startracker_ros.ros.attitude_output import AttitudeImuOptions, AttitudeOutput
from startracker_ros.ros.body_output import MountOptions
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.frames import ExtraFrameOptions, FrameOptions
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.clouds import tracks_from_message
from startracker_ros.ros.node import main_of
from startracker_ros.ros.odometry_input import OdometryInput
from startracker_ros.track.tracks import TrackedAttitude

_TRACKED = 'tracked_attitude'
_MAX_FRAMES = 64


@dataclass(frozen=True)
class SourceOptions(Options):
    """Where the stars come from."""

    source: str = option(
        'tracks', 'tracks of the star tracker, with its own attitude where it publishes one, or '
        'stars of single frames identified lost-in-space',
        choices=('tracks', 'stars'), read_only=True)


class AttitudeEstimatorNode(CameraNode):
    """Publishes the attitude of each frame that has a trusted one, in ICRF."""

    option_classes = (SourceOptions, ValidationOptions, FrameOptions, ExtraFrameOptions,
                      MountOptions, AttitudeImuOptions, AberrationOptions)
    task = 'attitude'

    def __init__(self) -> None:
        super().__init__('attitude_estimator')
        self._observer = OdometryInput(self, FrameOptions)
        self._output = AttitudeOutput(self, self._observer)
        self._source = self.options(SourceOptions).source
        # By stamp; tracks and tracked_attitude may arrive in either order.
        self._tracked: dict[int, TrackedAttitude | None] = {}
        self._waiting: PointCloud2 | None = None
        if self._source == 'tracks':
            self.frame_topic = 'tracks'
            self.subscribe(Imu, _TRACKED, self._on_tracked_attitude, qos.LIST)
            self.subscribe(PointCloud2, 'tracks', self._on_tracks, qos.LIST)
        else:
            self.subscribe(PointCloud2, 'stars', self._on_stars, qos.LIST)
        self.advertise_reset()

    def rebuild(self) -> None:
        self._observer.rebuild()
        self._output.rebuild()
        if self.camera is not None:
            self._tracked.clear()
            self._waiting = None
            self._stage = AttitudeStage(
                self.camera, self.epoch_year, self.options(ValidationOptions),
                self._observer.motion)

    def set_live_options(self) -> None:
        if self.camera is not None:
            self._stage.set_limits(self.options(ValidationOptions))

    def warm_up(self) -> None:
        AttitudeStage(WARM_UP_CAMERA, WARM_UP_EPOCH_YEAR, motion=ObserverMotion(
            self.options(AberrationOptions))).warm_up()

    def _on_tracked_attitude(self, message: Imu) -> None:
        """Store the attitude of a frame for its tracks, or use it if they are here."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._tracked[stamp_ns] = tracked_attitude_from_imu(message)
        while len(self._tracked) > _MAX_FRAMES:
            del self._tracked[next(iter(self._tracked))]
        waiting = self._waiting
        if waiting is not None and ns_from_stamp(waiting.header.stamp) == stamp_ns:
            self._waiting = None
            self._use_tracks(stamp_ns, waiting)

    def _on_tracks(self, message: PointCloud2) -> None:
        if self.camera_or_drop() is None or not self.in_order('tracks', message.header.stamp):
            return
        if self._waiting is not None:
            self.diagnostics.counts['tracks without tracked_attitude'] += 1
            self._waiting = None
        stamp_ns = ns_from_stamp(message.header.stamp)
        if stamp_ns not in self._tracked and self.count_publishers(_TRACKED):
            self._waiting = message
        else:
            self._use_tracks(stamp_ns, message)

    def _use_tracks(self, stamp_ns: int, message: PointCloud2) -> None:
        tracks, tracked = tracks_from_message(message), self._tracked.get(stamp_ns)
        result = (self._stage.from_tracks(stamp_ns, tracks, tracked) if stamp_ns in self._tracked
                  else self._stage.from_tracks_alone(stamp_ns, tracks))
        self._output.publish(stamp_ns, result, tracked)

    def _on_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        if self.camera_or_drop() is not None and self.in_order('stars', message.header.stamp):
            stamp_ns = ns_from_stamp(message.header.stamp)
            self._output.publish(stamp_ns, self._stage.from_stars(
                stamp_ns, centroids_from_rows(rows), rows['hip'].astype(np.int32)), None)


main = main_of(AttitudeEstimatorNode)

if __name__ == '__main__':
    main()
