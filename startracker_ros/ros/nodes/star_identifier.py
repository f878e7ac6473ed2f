"""star_identifier: centroids, camera_info, tracker_state, imu -> stars."""

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from sensor_msgs.msg import PointCloud2
from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.camera.model import Camera
from startracker_ros.identify.extended_grid import (
    ExtendedGridIdentifier, ExtendedGridOptions, RecursiveIdentifier)
from startracker_ros.identify.identification import IdentificationOptions
from startracker_ros.identify.methods import make_identifier
from startracker_ros.options import option, Options
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages.clouds import centroids_from_message, identification_to_message
from startracker_ros.ros.node import main_of
from startracker_ros.sky.star_lists import some_field
from startracker_ros.track.tracker import TrackerState

_PREPARED_STARS = 8
_RESTING = 'resting while the star tracker tracks'


@dataclass(frozen=True)
class CheckOptions(Options):
    """What is done while a star tracker tracks."""

    check_period_s: float = option(
        10.0, 'time between two frames that are identified lost-in-space although the star '
        'tracker tracks, so that it notices if it follows the wrong stars; 0 for never',
        unit='s', low=0.0, high=3600.0)


class StarIdentifierNode(CameraNode):
    """
    Identifies stars lost-in-space; now and then while a star tracker says that it is tracking.

    Method extended_grid carries the attitude from frame to frame by the rates of imu. It goes
    on while the star tracker tracks: where the field becomes poor the tracker loses it,
    and then only an attitude that was kept fresh can identify the two or three stars left.
    """

    option_classes = (CheckOptions, IdentificationOptions, ExtendedGridOptions, GyroErrorOptions)
    task = 'identification'

    def __init__(self) -> None:
        super().__init__('star_identifier')
        self.steady_topic = 'centroids'
        self._tracking = False
        self._identified_ns = 0
        self._recursive: RecursiveIdentifier | None = None
        self._hears_imu = False
        self._stars = self.give(PointCloud2, 'stars', qos.LIST)
        self.take(PointCloud2, 'centroids', self._take_centroids, qos.LIST, last=True)
        self.take(DiagnosticStatus, 'tracker_state', self._take_tracker_state, qos.STATE)
        self.offer_reset()

    def configure(self) -> None:
        options = self.options(IdentificationOptions)
        with_gyro = options.method == 'extended_grid'
        if with_gyro and not self._hears_imu:
            # Not before it is wanted: a gyro is a hundred messages a second.
            self.take_rates(self._add_rate)
            self._hears_imu = True
        self._recursive = None
        self.diagnostics.values.pop('prediction', None)
        if self.camera is None:
            return
        if with_gyro:
            self._recursive = RecursiveIdentifier(
                ExtendedGridIdentifier(self.camera, self.epoch_year, options,
                                       grid=self.options(ExtendedGridOptions)),
                self.options(GyroErrorOptions))
        else:
            self._identifier = make_identifier(self.camera, self.epoch_year, options)

    def prepare(self, camera: Camera) -> None:
        self.tell_of_compiling()
        if self._recursive is None:
            field, _ = some_field(self._identifier.places, camera)
            self._identifier.identify(field.select(slice(_PREPARED_STARS)))

    def _take_tracker_state(self, message: DiagnosticStatus) -> None:
        self._tracking = message.message == TrackerState.TRACKING.value

    def _add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        return self._recursive is None or self._recursive.add_rate(stamp_ns, rate_rad_s)

    def _check_is_due(self, stamp_ns: int) -> bool:
        period_s = self.options(CheckOptions).check_period_s
        return 0 < period_s <= abs(stamp_ns - self._identified_ns) * 1e-9

    def _take_centroids(self, message: PointCloud2) -> None:
        camera = self.known_camera()
        if camera is None or not self.in_order('centroids', message.header.stamp):
            return
        self.sensor_frame_id = message.header.frame_id
        stamp_ns = ns_from_stamp(message.header.stamp)
        if (self._recursive is None and self._tracking and not self._check_is_due(stamp_ns)
                # A tracker that was killed cannot take its word back.
                and self.count_publishers('tracker_state')):
            # Before the centroids are even read: the tracker works on them at the same time.
            self.diagnostics.report(OK, _RESTING)
            return
        centroids = centroids_from_message(message)
        if self._recursive is not None:
            result = self._recursive.identify(stamp_ns, centroids)
            self.diagnostics.values['prediction'] = self._recursive.condition
        else:
            result = self._identifier.identify(centroids)
        self._identified_ns = stamp_ns
        self._stars.publish(identification_to_message(
            centroids, result, camera, message.header))
        self.diagnostics.counts[result.status] += 1
        self.diagnostics.values.update({
            'matched': result.matched,
            'false_alarm_probability': f'{result.false_alarm_probability:.1e}',
            'focal_ratio': f'{result.focal_ratio:.5f}'})
        if result.status != 'identified':
            self.diagnostics.report(WARN, result.reason)
        elif self._recursive is not None and not self._recursive.has_rates:
            self.diagnostics.report(WARN, 'no imu: identifying lost-in-space only')
        else:
            # A check now and then while the star tracker tracks is no news.
            self.diagnostics.report(OK, _RESTING if self._tracking else 'identifying stars')


main = main_of(StarIdentifierNode)

if __name__ == '__main__':
    main()
