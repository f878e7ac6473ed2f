"""star_tracker: centroids, stars, imu, camera_info -> tracks, attitude, state, target_centroid."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.bag.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import camera_places
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, status_message, WARN
from startracker_ros.ros.messages.attitude import tracked_attitude_to_imu
from startracker_ros.ros.messages.clouds import (
    centroids_from_message, centroids_from_rows, centroids_to_message, tracks_to_message)
from startracker_ros.ros.node import main_of
from startracker_ros.sky.star_lists import some_field
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.target import TargetTracker, TargetTrackOptions
from startracker_ros.track.tracker import StarTracker, TrackerState
from std_msgs.msg import Header


class StarTrackerNode(CameraNode):
    """Follows identified stars from frame to frame and says how sure it is of them."""

    option_classes = (TrackerOptions, GyroErrorOptions, TargetTrackOptions)
    task = 'tracking'

    def __init__(self) -> None:
        super().__init__('star_tracker')
        self.steady_topic = 'centroids'
        self._tracks = self.give(PointCloud2, 'tracks', qos.LIST)
        self._attitude = self.give(Imu, 'tracked_attitude', qos.LIST)
        self._target = self.give(PointCloud2, 'target_centroid', qos.LIST)
        self._state = self.give(DiagnosticStatus, 'tracker_state', qos.STATE)
        self.take(PointCloud2, 'centroids', self._take_centroids, qos.LIST)
        self.take(PointCloud2, 'stars', self._take_stars, qos.LIST)
        self.take_rates(self._add_rate)
        self.offer_reset()

    def configure(self) -> None:
        if self.camera is not None:
            options = self.options(TrackerOptions)
            self._places = camera_places(load_catalog(), self.camera, self.epoch_year,
                                         options.magnitude_limit)
            self._tracker = StarTracker(self.camera, self._places, options,
                                        self.options(GyroErrorOptions))
            self._targets = TargetTracker(self.camera, self._places,
                                          self.options(TargetTrackOptions))
            self._publish_state()

    def prepare(self, camera: Camera) -> None:
        self.tell_of_compiling()
        tracker = StarTracker(camera, self._places, self.options(TrackerOptions))
        centroids, hip = some_field(self._places, camera)
        for stamp_ns in (1, 2, 3):
            tracker.update(stamp_ns, centroids)
            tracker.identified(stamp_ns, centroids, hip)

    def _add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        return self.camera is None or self._tracker.add_rate(stamp_ns, rate_rad_s)

    def _take_centroids(self, message: PointCloud2) -> None:
        centroids = centroids_from_message(message)
        camera = self.known_camera()
        if camera is None or not self.in_order('centroids', message.header.stamp):
            return
        self.sensor_frame_id = message.header.frame_id
        tracks = self._tracker.update(ns_from_stamp(message.header.stamp), centroids)
        if tracks is None:
            return
        # Before the tracks: who needs both has both when these come.
        self._attitude.publish(tracked_attitude_to_imu(self._tracker.attitude, message.header))
        self._tracks.publish(tracks_to_message(tracks, camera, message.header))
        self.afterwards(partial(self._finish, message.header, camera, centroids))

    def _finish(self, header: Header, camera: Camera, centroids: Centroids) -> None:
        """Do with a frame what its attitude does not need."""
        self._publish_state()
        self._look_for_target(header, camera, centroids)
        self._tracker.acquire_new_stars()

    def _look_for_target(self, header: Header, camera: Camera, centroids: Centroids) -> None:
        """Publish the target of a frame, an empty cloud where stars are all there is."""
        if self._tracker.attitude is None or not self._target.get_subscription_count():
            return
        target = self._targets.update(
            ns_from_stamp(header.stamp), self._tracker.attitude.attitude, centroids)
        self._target.publish(centroids_to_message(
            Centroids.empty() if target is None else target.centroid, camera, header))
        self.diagnostics.values.update(
            spots_without_star=self._targets.spots,
            target='none' if target is None else f'{target.rate_deg_s:.4f} deg/s')

    def _take_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        if self.known_camera() is None or not self.in_order('stars', message.header.stamp):
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
                  'refused_centroids': tracker.rejected_centroids,
                  'gyro': tracker.gyro_condition,
                  'reason': tracker.reason}
        self._state.publish(status_message(
            'star_tracker: state', self.hardware_id, level, tracker.state.value, values))
        self.diagnostics.values.update(values)
        if tracker.gyro_trouble:
            self.diagnostics.report(WARN, f'{tracker.state.value}: {tracker.gyro_trouble}')
        else:
            self.diagnostics.report(level, f'{tracker.state.value}: {tracker.reason}')


main = main_of(StarTrackerNode)

if __name__ == '__main__':
    main()
