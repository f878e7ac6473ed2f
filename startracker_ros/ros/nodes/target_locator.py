"""target_locator: two trackers' attitude_cov, target_centroid, camera_info, odometry -> target."""

from dataclasses import dataclass
from functools import partial

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import CameraInfo, PointCloud2
from startracker_ros.bag.layouts import camera_from_message, MessageError, ns_from_stamp
from startracker_ros.camera.model import CameraError
from startracker_ros.locate.location import LocationOptions
from startracker_ros.locate.locator import Located, TargetLocator
from startracker_ros.locate.observer import Observer, ObserverOptions
from startracker_ros.options import option, Options
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages.attitude import attitude_from_pose
from startracker_ros.ros.messages.clouds import centroids_from_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.odometry import state_from_odometry
from startracker_ros.ros.messages.target import lines_to_markers, location_to_pose
from startracker_ros.ros.node import main_of, PipelineNode, StartError
from visualization_msgs.msg import MarkerArray


@dataclass(frozen=True)
class PairOptions(Options):
    """Who looks at the target, and on which axes it is located."""

    observer_1: str = option('tracker_1', 'namespace of the star tracker at whose frames the '
                             'target is located', read_only=True)
    observer_2: str = option('tracker_2', 'namespace of the other star tracker', read_only=True)
    inertial_frame_id: str = option('icrf', 'inertial frame of attitudes, odometry and target')


class TargetLocatorNode(PipelineNode):
    """Publishes where the target is at each frame in which two lines of sight meet."""

    option_classes = (PairOptions, ObserverOptions, LocationOptions)
    task = 'location'

    def __init__(self) -> None:
        super().__init__('target_locator')
        self._position = self.give(PoseWithCovarianceStamped, 'target/position', qos.LIST)
        self._lines = self.give(MarkerArray, 'target/line_of_sight', qos.LIST)
        pair = self.options(PairOptions)
        self._names = pair.observer_1, pair.observer_2
        if pair.observer_1 == pair.observer_2:
            raise StartError(f'observer_1 and observer_2 are both {pair.observer_1!r}')
        self._locator = self._new_locator()
        for index, name in enumerate(self._names):
            for message_type, topic, callback in (
                    (CameraInfo, 'camera_info', self._take_camera),
                    (Odometry, 'odometry', self._take_odometry),
                    (PoseWithCovarianceStamped, 'attitude_cov', self._take_attitude),
                    (PointCloud2, 'target_centroid', self._take_target)):
                self.take(message_type, f'{name}/{topic}', partial(callback, index), qos.LIST)
        self.offer_reset()
        # The steady clock: silence must be told when simulated time stands still.
        self.create_timer(2.0, self._tell_silence, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def configure(self) -> None:
        cameras = [one.camera for one in self._locator.observers]
        self._locator = self._new_locator()
        for one, camera in zip(self._locator.observers, cameras):
            one.camera = camera
        self._answers = 0

    def _new_locator(self) -> TargetLocator:
        return TargetLocator(self._names, self.options(ObserverOptions),
                             self.options(LocationOptions))

    def _observer(self, index: int) -> Observer:
        return self._locator.observers[index]

    def _take_camera(self, index: int, message: CameraInfo) -> None:
        try:
            self._observer(index).camera = camera_from_message(message)
        except CameraError:
            # The lens is not what it was: no line of sight until a sound camera_info comes.
            self._observer(index).camera = None
            raise

    def _take_odometry(self, index: int, message: Odometry) -> None:
        self._observer(index).add_state(
            ns_from_stamp(message.header.stamp),
            state_from_odometry(message, self.options(PairOptions).inertial_frame_id))
        self._solve()

    def _take_attitude(self, index: int, message: PoseWithCovarianceStamped) -> None:
        self._observer(index).add_attitude(
            ns_from_stamp(message.header.stamp),
            *attitude_from_pose(message, self.options(PairOptions).inertial_frame_id))
        self._solve()

    def _take_target(self, index: int, message: PointCloud2) -> None:
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
            self._answers += 1
            if isinstance(result, Located):
                self._publish(result)
            else:
                self.diagnostics.counts['refused'] += 1
                self.diagnostics.report(WARN, f'no position: {result.reason}')

    def _publish(self, located: Located) -> None:
        header = make_header(located.stamp_ns, self.options(PairOptions).inertial_frame_id)
        location = located.location
        self._position.publish(location_to_pose(location, header))
        self._lines.publish(lines_to_markers(located, header))
        self.diagnostics.counts['located'] += 1
        self.diagnostics.values.update({
            'sigma_m': f'{np.sqrt(np.trace(location.covariance_m2)):.1f}',
            'range_1_km': f'{location.range_m[0] / 1e3:.3f}',
            'range_2_km': f'{location.range_m[1] / 1e3:.3f}',
            'angle_deg': f'{np.degrees(location.angle_rad):.2f}',
            'miss_m': f'{location.miss_m:.1f}', 'miss_sigma_m': f'{location.miss_sigma_m:.1f}'})
        self.diagnostics.report(OK, 'locating the target')

    def _tell_silence(self) -> None:
        """Say what is missing when neither observer brought anything new."""
        if not self._answers:
            self.diagnostics.report(WARN, f'no position: {self._locator.missing_inputs()}')
        self._answers = 0


main = main_of(TargetLocatorNode)

if __name__ == '__main__':
    main()
