"""attitude_estimator: tracks and tracked_attitude, or stars -> attitude in four message types."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from sensor_msgs.msg import PointCloud2
from startracker_ros.core.astro.observer_motion import AberrationOptions, ObserverMotion
from startracker_ros.core.attitude.protection import ProtectionOptions
from startracker_ros.core.attitude.validation import UNUSED_SOLVER, ValidationOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import WARM_UP_CAMERA, WARM_UP_EPOCH_YEAR
from startracker_ros.core.options import option, Options
from startracker_ros.core.stages.attitude import AttitudeStage
from startracker_ros.core.track.tracks import TrackedAttitude, Tracks
from startracker_ros.io.bags.cloud_rows import centroids_from_rows
from startracker_ros.io.bags.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.ros import qos
from startracker_ros.ros.attitude_output import AttitudeImuOptions, AttitudeOutput
from startracker_ros.ros.body_output import MountOptions
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.frames import ExtraFrameOptions, FrameOptions
from startracker_ros.ros.node import main_of
from startracker_ros.ros.odometry_input import OdometryInput
from startracker_ros.ros.tracks_input import TracksInput


@dataclass(frozen=True)
class SourceOptions(Options):
    """Where the stars come from."""

    source: str = option(
        'tracks', 'tracks of the star tracker, with its own attitude where it publishes one, or '
        'stars of single frames identified lost-in-space',
        choices=('tracks', 'stars'), read_only=True)


class AttitudeEstimatorNode(CameraNode):
    """Publishes the attitude of each frame that has a trusted one, in ICRF."""

    option_classes = (SourceOptions, ValidationOptions, ProtectionOptions, FrameOptions,
                      ExtraFrameOptions, MountOptions, AttitudeImuOptions, AberrationOptions)
    task = 'attitude'

    def __init__(self) -> None:
        super().__init__('attitude_estimator')
        self._observer = OdometryInput(self, FrameOptions)
        self._output = AttitudeOutput(self, self._observer)
        self._tracks: TracksInput | None = None
        if self.options(SourceOptions).source == 'tracks':
            self.frame_topic = 'tracks'
            self._tracks = TracksInput(self, self._on_frame, self._on_tracks_alone)
        else:
            self.subscribe(PointCloud2, 'stars', self._on_stars, qos.LIST)
        self.advertise_reset()

    def restart(self) -> None:
        self._observer.rebuild()
        self._output.rebuild()
        if self._tracks is not None:
            self._tracks.clear()

    def builder(self, camera: Camera, epoch_year: float) -> Callable[[], AttitudeStage]:
        return partial(AttitudeStage, camera, epoch_year, self.options(ValidationOptions),
                       self._observer.motion, protection=self.options(ProtectionOptions))

    def use(self, built: AttitudeStage) -> None:
        self._stage = built

    def set_live_options(self) -> None:
        if self.camera is not None:
            self._stage.set_limits(self.options(ValidationOptions),
                                   self.options(ProtectionOptions))

    def warm_up(self) -> None:
        AttitudeStage(WARM_UP_CAMERA, WARM_UP_EPOCH_YEAR, motion=ObserverMotion(
            self.options(AberrationOptions))).warm_up()

    def _on_frame(self, stamp_ns: int, tracks: Tracks, tracked: TrackedAttitude | None) -> None:
        solver = self.options(ValidationOptions).solver
        if solver != ValidationOptions.solver:
            self.diagnostics.report_event(UNUSED_SOLVER.format(solver))
        self._output.publish(stamp_ns, self._stage.from_tracks(stamp_ns, tracks, tracked), tracked)

    def _on_tracks_alone(self, stamp_ns: int, tracks: Tracks) -> None:
        self._output.publish(stamp_ns, self._stage.from_tracks_alone(stamp_ns, tracks), None)

    def _on_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        if self.camera_or_drop() is not None and self.in_order('stars', message.header.stamp):
            stamp_ns = ns_from_stamp(message.header.stamp)
            self._output.publish(stamp_ns, self._stage.from_stars(
                stamp_ns, centroids_from_rows(rows), rows['hip'].astype(np.int32)), None)


main = main_of(AttitudeEstimatorNode)

if __name__ == '__main__':
    main()
