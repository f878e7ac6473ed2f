# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""star_identifier: centroids, camera_info, tracker_state, imu -> stars."""

from collections.abc import Callable
from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from sensor_msgs.msg import PointCloud2
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.identify.methods import CLASSES, OWN_OPTIONS
from startracker_ros.core.stages.identification import CheckOptions, IdentificationStage
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages.clouds import frame_from_message, identification_to_message
from startracker_ros.ros.node import main_of
from startracker_ros.ros.search_thread import SearchThread
from std_msgs.msg import Header

_IDLE = 'idle while the star tracker tracks'


class StarIdentifierNode(CameraNode):
    """
    Identifies stars lost-in-space; idle while a star tracker reports that it tracks.

    In a thread: tracking, diagnostics and signals never wait for a search.
    """

    option_classes = (CheckOptions, IdentificationOptions, *OWN_OPTIONS, GyroErrorOptions,
                      BandOptions)
    task = 'identification'

    def __init__(self) -> None:
        super().__init__('star_identifier')
        self.frame_topic = 'centroids'
        self._tracking = False
        self._stage: IdentificationStage | None = None
        self._subscribed_imu = False
        self._search = SearchThread(self)
        self._stars = self.advertise(PointCloud2, 'stars', qos.LIST)
        self.subscribe(PointCloud2, 'centroids', self._on_centroids, qos.LIST, last=True)
        self.subscribe(DiagnosticStatus, 'tracker_state', self._on_tracker_state, qos.STATE)
        self.advertise_reset()

    @property
    def is_busy(self) -> bool:
        return super().is_busy or self._search.is_running

    def close(self) -> None:
        self._search.clear()

    def restart(self) -> None:
        self._search.clear()
        options = self.options(IdentificationOptions)
        if CLASSES[options.method].uses_rates and not self._subscribed_imu:
            # Only if it is used: a gyro publishes a hundred messages a second.
            self.subscribe_rates(self._add_rate)
            self._subscribed_imu = True
        self.diagnostics.values.pop('prediction', None)

    def builder(self, camera: Camera, epoch_year: float) -> Callable[[], IdentificationStage]:
        options = self.options(IdentificationOptions)
        own = CLASSES[options.method].own_options
        return partial(
            IdentificationStage, camera, epoch_year, options, self.options(CheckOptions),
            None if own is None else self.options(own), self.options(GyroErrorOptions),
            self.options(BandOptions))

    def use(self, built: IdentificationStage) -> None:
        self._stage = built

    def _on_tracker_state(self, message: DiagnosticStatus) -> None:
        fix = next((one.value for one in message.values if one.key == 'frames_since_fix'), '0')
        self._tracking = message.message == TrackerState.TRACKING.value and fix == '0'

    def _add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        return self._stage is None or self._stage.add_rate(stamp_ns, rate_rad_s)

    def _on_centroids(self, message: PointCloud2) -> None:
        camera, stage = self.camera_or_drop(), self._stage
        if camera is None or stage is None or not self.in_order(
                'centroids', message.header.stamp):
            return
        self.follow_frame(message.header.frame_id)
        stamp_ns = ns_from_stamp(message.header.stamp)
        # The state that a killed tracker published last is not valid any more.
        tracking = self._tracking and self.has_publisher('tracker_state')
        # Before the centroids are read: the tracker works on them at the same time.
        if stage.is_idle(stamp_ns, tracking):
            self.diagnostics.report(OK, _IDLE)
            return
        centroids, windowed = frame_from_message(message)
        if stage.is_idle(stamp_ns, tracking, windowed):
            return
        self._search.search(partial(self._identify, stage, camera, message.header, centroids),
                            stage.identifier.until_s, self.interval_s)

    def _identify(self, stage: IdentificationStage, camera: Camera, header: Header,
                  centroids: Centroids) -> Callable[[], None]:
        """Identify a list in the thread; return what publishes the result."""
        result, centroids = stage.identify(ns_from_stamp(header.stamp), centroids)
        # The next search changes those of the stage.
        bodies, prediction = stage.body_spots, stage.prediction

        def publish() -> None:
            # Not the result of before a reset, a restart or another camera.
            if stage is self._stage and self.active and self.camera is not None:
                self._stars.publish(identification_to_message(centroids, result, camera, header))
                self.diagnostics.counts['planets, Moon and Sun'] += bodies
                if stage.uses_rates:
                    self.diagnostics.values['prediction'] = prediction
                self._report(result, stage)
        return publish

    def _report(self, result: Identification, stage: IdentificationStage) -> None:
        self.diagnostics.counts[result.status] += 1
        self.diagnostics.counts['centroids too late to be identified'] = self._search.dropped
        self.diagnostics.values.update({
            'matched': result.matched,
            'false_alarm_probability': f'{result.false_alarm_probability:.1e}',
            'focal_ratio': f'{result.focal_ratio:.5f}'})
        if result.status != 'identified':
            self.diagnostics.report(WARN, result.reason)
        elif stage.uses_rates and not stage.has_rates:
            self.diagnostics.report(WARN, 'no imu: identifying lost-in-space only')
        else:
            # A check while the star tracker tracks does not change the condition.
            self.diagnostics.report(OK, _IDLE if self._tracking else 'identifying stars')


main = main_of(StarIdentifierNode)

if __name__ == '__main__':
    main()
