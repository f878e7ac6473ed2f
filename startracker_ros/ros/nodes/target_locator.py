# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""target_locator: two trackers' attitude_cov, target_centroid, camera_info, odometry -> target."""

from dataclasses import dataclass
from functools import partial

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, PointCloud2
from startracker_ros.core.camera.model import CameraError
from startracker_ros.core.locate.location import LocationOptions
from startracker_ros.core.locate.locator import TargetLocator
from startracker_ros.core.locate.observer import Observer, ObserverOptions
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.layouts import (
    camera_from_message, INERTIAL_FRAME_ID, MessageError, ns_from_stamp)
from startracker_ros.io.bags.telemetry import state_from_odometry
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import WARN
from startracker_ros.ros.location_output import LocationOutput
from startracker_ros.ros.messages.attitude import attitude_from_pose
from startracker_ros.ros.messages.clouds import centroids_from_message
from startracker_ros.ros.node import main_of, PipelineNode, StartError


@dataclass(frozen=True)
class PairOptions(Options):
    """The two observers, and the axes of the position."""

    observer_1: str = option('tracker_1', 'namespace of the star tracker at whose frames the '
                             'target is located', read_only=True)
    observer_2: str = option('tracker_2', 'namespace of the other star tracker', read_only=True)
    inertial_frame_id: str = option(
        INERTIAL_FRAME_ID, 'inertial frame of attitudes, odometry and target')


class TargetLocatorNode(PipelineNode):
    """Publishes the position of the target, from the lines of sight of two observers."""

    option_classes = (PairOptions, ObserverOptions, LocationOptions)
    task = 'location'

    def __init__(self) -> None:
        super().__init__('target_locator')
        self._output = LocationOutput(self)
        pair = self.options(PairOptions)
        self._names = pair.observer_1, pair.observer_2
        if pair.observer_1 == pair.observer_2:
            raise StartError(f'observer_1 and observer_2 are both {pair.observer_1!r}')
        self._locator = self._new_locator()
        for index, name in enumerate(self._names):
            for message_type, topic, callback in (
                    (CameraInfo, 'camera_info', self._on_camera_info),
                    (Odometry, 'odometry', self._on_odometry),
                    (PoseWithCovarianceStamped, 'attitude_cov', self._on_attitude_cov),
                    (PointCloud2, 'target_centroid', self._on_target_centroid)):
                self.subscribe(message_type, f'{name}/{topic}', partial(callback, index), qos.LIST)
        self.advertise_reset()
        self.create_steady_timer(2.0, self._report_silence)

    def rebuild(self) -> None:
        cameras = [one.camera for one in self._locator.observers]
        self._locator = self._new_locator()
        for one, camera in zip(self._locator.observers, cameras):
            one.camera = camera
        self._results = 0

    def _new_locator(self) -> TargetLocator:
        return TargetLocator(self._names, self.options(ObserverOptions),
                             self.options(LocationOptions))

    def _observer(self, index: int) -> Observer:
        return self._locator.observers[index]

    def _on_camera_info(self, index: int, message: CameraInfo) -> None:
        try:
            self._observer(index).camera = camera_from_message(message)
        except CameraError:
            # The old camera is not valid any more either.
            self._observer(index).camera = None
            raise

    def _on_odometry(self, index: int, message: Odometry) -> None:
        self._observer(index).add_state(
            ns_from_stamp(message.header.stamp),
            state_from_odometry(message, self.options(PairOptions).inertial_frame_id))
        self._solve()

    def _on_attitude_cov(self, index: int, message: PoseWithCovarianceStamped) -> None:
        self._observer(index).add_attitude(
            ns_from_stamp(message.header.stamp),
            *attitude_from_pose(message, self.options(PairOptions).inertial_frame_id))
        self._solve()

    def _on_target_centroid(self, index: int, message: PointCloud2) -> None:
        centroids = centroids_from_message(message)
        if len(centroids) > 1:
            raise MessageError(f'{len(centroids)} points, there is one target')
        if len(centroids) and not centroids.sigma_px[0] > 0:
            raise MessageError(f'sigma_px {centroids.sigma_px[0]:g} is not positive')
        if len(centroids):
            self._observer(index).add_target(ns_from_stamp(message.header.stamp),
                                             centroids.uv[0], centroids.sigma_px[0])
            self._solve()

    def _solve(self) -> None:
        for result in self._locator.solve():
            self._results += 1
            self._output.publish(result, self.options(PairOptions).inertial_frame_id)

    def _report_silence(self) -> None:
        """Report what is missing if neither observer sent anything new."""
        if not self.active:
            return
        if not self._results:
            self.diagnostics.report(WARN, f'no position: {self._locator.missing_inputs()}')
        self._results = 0


main = main_of(TargetLocatorNode)

if __name__ == '__main__':
    main()
