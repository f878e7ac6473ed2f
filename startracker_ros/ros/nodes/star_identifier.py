"""star_identifier: centroids, camera_info, tracker_state -> stars."""

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import PointCloud2

from startracker_ros.identify.identification import IdentificationOptions
from startracker_ros.identify.methods import make_identifier
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages import centroids_from_message, identification_to_message
from startracker_ros.ros.node import CameraNode, main_of
from startracker_ros.track.tracker import TrackerState


class StarIdentifierNode(CameraNode):
    """Identifies stars lost-in-space, except while a star tracker says that it is tracking."""

    option_classes = (IdentificationOptions,)
    task = 'identification'

    def __init__(self) -> None:
        super().__init__('star_identifier')
        self._tracking = False
        self._stars = self.give(PointCloud2, 'stars', qos.LIST)
        self.take(PointCloud2, 'centroids', self._take_centroids, qos.LIST)
        self.take(DiagnosticStatus, 'tracker_state', self._take_tracker_state, qos.STATE)
        self.offer_reset()

    def configure(self) -> None:
        if self.camera is not None:
            self._identifier = make_identifier(
                self.camera, self.epoch_year, self.options(IdentificationOptions))

    def _take_tracker_state(self, message: DiagnosticStatus) -> None:
        self._tracking = message.message == TrackerState.TRACKING.value

    def _take_centroids(self, message: PointCloud2) -> None:
        centroids = centroids_from_message(message)
        if not self.has_camera() or not self.in_order('centroids', message.header.stamp):
            return
        if self._tracking:
            self.diagnostics.report(OK, 'resting while the star tracker tracks')
            return
        result = self._identifier.identify(centroids)
        self._stars.publish(identification_to_message(
            centroids, result, self.camera, message.header))
        self.diagnostics.counts[result.status] += 1
        self.diagnostics.values.update({
            'matched': result.matched,
            'false_alarm_probability': f'{result.false_alarm_probability:.1e}',
            'focal_ratio': f'{result.focal_ratio:.5f}'})
        identified = result.status == 'identified'
        self.diagnostics.report(OK if identified else WARN,
                                'identifying stars' if identified else result.reason)


main = main_of(StarIdentifierNode)

if __name__ == '__main__':
    main()
