"""The target among the stars, beside a star tracker: target_centroid."""

from sensor_msgs.msg import PointCloud2
from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.prediction import PredictedCentroids
from startracker_ros.ros import qos
from startracker_ros.ros.messages.clouds import centroids_to_message
from startracker_ros.ros.node import PipelineNode
from startracker_ros.track.target import TargetSpot, TargetTracker
from startracker_ros.track.tracker import StarTracker
from std_msgs.msg import Header


class TargetOutput:
    """Searches each frame for the target and publishes it, while anybody subscribes."""

    def __init__(self, node: PipelineNode) -> None:
        self._diagnostics = node.diagnostics
        self._publisher = node.advertise(PointCloud2, 'target_centroid', qos.LIST)

    def update(self, targets: TargetTracker, stars: StarTracker, centroids: Centroids,
               directed: bool, camera: Camera, header: Header) -> PredictedCentroids | None:
        """
        Publish the target of a frame with an attitude, an empty cloud if there is none.

        Return where it and what may become one are, None without a subscriber.
        """
        if not self._publisher.get_subscription_count():
            return None
        stamp_ns = ns_from_stamp(header.stamp)
        if (tracked := stars.attitude) is not None:
            self._publish(targets, targets.update(
                stamp_ns, tracked.attitude, centroids, directed), camera, header)
        return None if stars.pointing is None else targets.predicted(stamp_ns, *stars.pointing)

    def _publish(self, tracker: TargetTracker, target: TargetSpot | None, camera: Camera,
                 header: Header) -> None:
        self._publisher.publish(centroids_to_message(
            Centroids.empty() if target is None else target.centroid, camera, header))
        self._diagnostics.values.update(
            spots_without_star=tracker.spots,
            target='none' if target is None else f'{target.rate_deg_s:.4f} deg/s')
