# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The target among the stars, beside a star tracker: target_centroid."""

from sensor_msgs.msg import PointCloud2
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.track.target import TargetTracker
from startracker_ros.core.track.track_filter import TrackFilter
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.clouds import centroids_to_message
from startracker_ros.ros.node import PipelineNode
from std_msgs.msg import Header


class TargetOutput:
    """Searches each frame for the target and publishes it, while anybody subscribes."""

    def __init__(self, node: PipelineNode) -> None:
        self._diagnostics = node.diagnostics
        self._publisher = node.advertise(PointCloud2, 'target_centroid', qos.LIST)

    def update(self, targets: TargetTracker, stars: TrackFilter, centroids: Centroids,
               windowed: bool, camera: Camera, header: Header) -> PredictedCentroids | None:
        """
        Publish the target of a frame, an empty cloud if there is none.

        Return where it is and what may become one, None without a subscriber or an attitude.
        """
        tracked = stars.attitude
        if tracked is None or not self._publisher.get_subscription_count():
            return None
        target = targets.update(
            ns_from_stamp(header.stamp), tracked.attitude, centroids, windowed)
        self._publisher.publish(centroids_to_message(
            Centroids.empty() if target is None else target.centroid, camera, header))
        self._diagnostics.values.update(
            spots_without_star=targets.spots,
            target='none' if target is None else f'{target.rate_deg_s:.4f} deg/s')
        return targets.predicted(tracked.rate_rad_s)
