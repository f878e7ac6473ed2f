# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the star tracker expects of the next image: stars, targets, planets, Moon and Sun."""

from sensor_msgs.msg import PointCloud2
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.stages.bodies import Bodies, BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.core.track.track_filter import TrackFilter
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.clouds import predictions_to_message
from startracker_ros.ros.node import PipelineNode
from std_msgs.msg import Header


class PredictionsOutput:
    """Publishes predicted_centroids, and reports the bodies in the image."""

    def __init__(self, node: PipelineNode) -> None:
        self._node = node
        self._publisher = node.advertise(PointCloud2, 'predicted_centroids', qos.LIST)

    def publish(self, tracker: TrackFilter, targets: PredictedCentroids | None, camera: Camera,
                header: Header) -> None:
        """Publish what the newest frame predicts, with the targets of its time."""
        bodies = _bodies(tracker, camera, ns_from_stamp(header.stamp))
        self._node.diagnostics.values['bodies'] = ', '.join(
            body.name for body in bodies) or 'none'
        predicted = tracker.predicted
        if predicted is not None and targets is not None:
            predicted = predicted.joined(targets)
        self._publisher.publish(predictions_to_message(predicted, header, bodies))


def _bodies(tracker: TrackFilter, camera: Camera, stamp_ns: int) -> tuple[BodyInImage, ...]:
    """Return planets, Moon and Sun at the newest frame, none without an attitude."""
    tracked, observer = tracker.attitude, tracker.sky.at(stamp_ns).observer
    if tracked is None:
        return ()
    return Bodies(observer.bodies).in_image(
        SkyMapping(camera, tracked.attitude.quaternion, observer.vantage))
