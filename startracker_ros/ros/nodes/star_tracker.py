"""star_tracker: centroids, stars, imu, camera_info -> tracks, attitude, state, predictions."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.bag.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.pipeline.tracking import make_trackers
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, status_message, WARN
from startracker_ros.ros.messages.attitude import tracked_attitude_to_imu
from startracker_ros.ros.messages.clouds import (
    centroids_from_message, centroids_from_rows, predictions_to_message, tracks_to_message)
from startracker_ros.ros.node import main_of
from startracker_ros.ros.target_output import TargetOutput
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.target import TargetTrackOptions
from startracker_ros.track.tracker import TrackerState
from std_msgs.msg import Header


class StarTrackerNode(CameraNode):
    """Tracks identified stars from frame to frame and reports its state."""

    option_classes = (TrackerOptions, GyroErrorOptions, TargetTrackOptions)
    task = 'tracking'

    def __init__(self) -> None:
        super().__init__('star_tracker')
        self.frame_topic = 'centroids'
        self._tracks = self.advertise(PointCloud2, 'tracks', qos.LIST)
        self._attitude = self.advertise(Imu, 'tracked_attitude', qos.LIST)
        self._predicted = self.advertise(PointCloud2, 'predicted_centroids', qos.LIST)
        self._target = TargetOutput(self)
        self._state = self.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)
        self.subscribe(PointCloud2, 'centroids', self._on_centroids, qos.LIST)
        self.subscribe(PointCloud2, 'stars', self._on_stars, qos.LIST)
        self.subscribe_rates(self._add_rate)
        self.advertise_reset()

    def rebuild(self) -> None:
        if self.camera is not None:
            self._tracker, self._target_tracker = make_trackers(
                self.camera, self.epoch_year, self.options(TrackerOptions),
                self.options(GyroErrorOptions), self.options(TargetTrackOptions))
            self._publish_state()

    def warm_up(self) -> None:
        self.report_compiling()
        self._tracker.warm_up()

    def _add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        return self.camera is None or self._tracker.add_rate(stamp_ns, rate_rad_s)

    def _on_centroids(self, message: PointCloud2) -> None:
        centroids = centroids_from_message(message)
        camera = self.camera_or_drop()
        if camera is None or not self.in_order('centroids', message.header.stamp):
            return
        self.sensor_frame_id = message.header.frame_id
        tracks = self._tracker.update(ns_from_stamp(message.header.stamp), centroids)
        if tracks is None:
            return
        # Before the tracks, so that a subscriber of both has both when the tracks come.
        self._attitude.publish(tracked_attitude_to_imu(self._tracker.attitude, message.header))
        self._tracks.publish(tracks_to_message(tracks, camera, message.header))
        self.defer(partial(self._finish, message.header, camera, centroids))

    def _finish(self, header: Header, camera: Camera, centroids: Centroids) -> None:
        """Do with a frame what its attitude does not depend on."""
        # A target is found in whole images only: while it is searched nothing is predicted.
        self._predicted.publish(predictions_to_message(
            None if self._target.wanted else self._tracker.predicted, header))
        self._publish_state()
        if self._tracker.attitude is not None:
            self._target.update(self._target_tracker, self._tracker.attitude.attitude, centroids,
                                camera, header)
        self._tracker.acquire_new_stars()

    def _on_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        if self.camera_or_drop() is None or not self.in_order('stars', message.header.stamp):
            return
        self._tracker.identified(
            ns_from_stamp(message.header.stamp), centroids_from_rows(rows), rows['hip'])
        self._publish_state()

    def _publish_state(self) -> None:
        tracker = self._tracker
        level = OK if tracker.state is TrackerState.TRACKING else WARN
        values = {'stars_matched': tracker.stars_matched,
                  'residual_px': f'{tracker.residual_px:.3f}',
                  'frames_since_fix': tracker.frames_since_fix,
                  'checks_passed': tracker.checks_passed,
                  'late_frames': tracker.late_frames,
                  'rejected_centroids': tracker.rejected_centroids,
                  'gyro': tracker.gyro_condition,
                  'reason': tracker.contradiction or tracker.reason}
        self._state.publish(status_message(
            'star_tracker: state', self.hardware_id, level, tracker.state.value, values))
        self.diagnostics.values.update(values)
        if tracker.contradiction:
            self.diagnostics.counts['contradictory frames'] += 1
            self.diagnostics.report(WARN, f'{tracker.state.value}: {tracker.contradiction}')
        elif tracker.gyro_trouble:
            self.diagnostics.report(WARN, f'{tracker.state.value}: {tracker.gyro_trouble}')
        else:
            self.diagnostics.report(level, f'{tracker.state.value}: {tracker.reason}')


main = main_of(StarTrackerNode)

if __name__ == '__main__':
    main()
