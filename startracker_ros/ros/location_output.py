# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The located target on its topics."""

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from startracker_ros.core.locate.locator import Located, Rejected
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.target import lines_to_markers, location_to_pose
from startracker_ros.ros.node import PipelineNode
from visualization_msgs.msg import MarkerArray


class LocationOutput:
    """Publishes target/position and target/line_of_sight."""

    def __init__(self, node: PipelineNode) -> None:
        self._diagnostics = node.diagnostics
        self._position = node.advertise(PoseWithCovarianceStamped, 'target/position', qos.LIST)
        self._lines = node.advertise(MarkerArray, 'target/line_of_sight', qos.LIST)

    def publish(self, result: Located | Rejected, inertial_frame_id: str) -> None:
        """Publish a position, or report why there is none."""
        if isinstance(result, Rejected):
            self._diagnostics.counts['rejected'] += 1
            self._diagnostics.report(WARN, f'no position: {result.reason}')
            return
        header = make_header(result.stamp_ns, inertial_frame_id)
        location = result.location
        self._position.publish(location_to_pose(location, header))
        self._lines.publish(lines_to_markers(result, header))
        self._diagnostics.counts['located'] += 1
        self._diagnostics.values.update({
            'sigma_m': f'{np.sqrt(np.trace(location.covariance_m2)):.1f}',
            'range_1_km': f'{location.range_m[0] / 1e3:.3f}',
            'range_2_km': f'{location.range_m[1] / 1e3:.3f}',
            'angle_deg': f'{np.degrees(location.angle_rad):.2f}',
            'miss_m': f'{location.miss_m:.1f}', 'miss_sigma_m': f'{location.miss_sigma_m:.1f}'})
        self._diagnostics.report(OK, 'locating the target')
