"""star_tracker: centroids, stars, camera_info -> tracks, tracker_state."""

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import PointCloud2

from startracker_ros.catalog.places import camera_places
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, status_message, WARN
from startracker_ros.ros.messages import (
    centroids_from_message, centroids_from_rows, ns_from_stamp, read_cloud, STAR_DTYPE,
    tracks_to_message)
from startracker_ros.ros.node import CameraNode, main_of
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.tracker import StarTracker, TrackerState


class StarTrackerNode(CameraNode):
    """Follows identified stars from frame to frame and says how sure it is of them."""

    option_classes = (TrackerOptions,)
    task = 'tracking'

    def __init__(self) -> None:
        super().__init__('star_tracker')
        self._tracks = self.give(PointCloud2, 'tracks', qos.LIST)
        self._state = self.give(DiagnosticStatus, 'tracker_state', qos.STATE)
        self.take(PointCloud2, 'centroids', self._take_centroids, qos.LIST)
        self.take(PointCloud2, 'stars', self._take_stars, qos.LIST)
        self.offer_reset()

    def configure(self) -> None:
        if self.camera is not None:
            options = self.options(TrackerOptions)
            places = camera_places(load_catalog(), self.camera, self.epoch_year,
                                   options.magnitude_limit)
            self._tracker = StarTracker(self.camera, places, options)
            self._publish_state()

    def _take_centroids(self, message: PointCloud2) -> None:
        centroids = centroids_from_message(message)
        if not self.has_camera() or not self.in_order('centroids', message.header.stamp):
            return
        tracks = self._tracker.update(ns_from_stamp(message.header.stamp), centroids)
        if tracks is None:
            return
        self._tracks.publish(tracks_to_message(tracks, self.camera, message.header))
        self._publish_state()

    def _take_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        if not self.has_camera() or not self.in_order('stars', message.header.stamp):
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
                  'reason': tracker.reason}
        self._state.publish(status_message(
            'star_tracker: state', self.hardware_id, level, tracker.state.value, values))
        self.diagnostics.values.update(values)
        self.diagnostics.report(level, f'{tracker.state.value}: {tracker.reason}')


main = main_of(StarTrackerNode)

if __name__ == '__main__':
    main()
