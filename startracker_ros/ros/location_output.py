# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The located target on its topics: its position, and markers for 3D viewers."""

from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Vector3
import numpy as np
from startracker_ros.core.locate.location import Location
from startracker_ros.core.locate.locator import Located, Rejected
from startracker_ros.core.maths.rotation import quaternion_from_matrix
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages.header import make_header, quaternion_to_geometry
from startracker_ros.ros.node import PipelineNode
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

ELLIPSOID_SIGMAS = 3.0
_LINE_WIDTH_M = 500.0
_COLOURS = ((1.0, 0.75, 0.25), (0.35, 0.75, 1.0))


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


def location_to_pose(location: Location, header: Header) -> PoseWithCovarianceStamped:
    """Return `target/position`: position filled, no rotation and no rotation block."""
    message = PoseWithCovarianceStamped(header=header)
    position = message.pose.pose.position
    position.x, position.y, position.z = map(float, location.position_m)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = location.covariance_m2
    message.pose.covariance = covariance.ravel()
    return message


def lines_to_markers(located: Located, header: Header) -> MarkerArray:
    """Return `target/line_of_sight`: a line from each observer, and the 3-sigma ellipsoid."""
    location = located.location
    target = _point(location.position_m)
    lines = [Marker(
        header=header, ns='line_of_sight', id=number, type=Marker.LINE_STRIP, action=Marker.ADD,
        scale=Vector3(x=_LINE_WIDTH_M), color=ColorRGBA(r=r, g=g, b=b, a=1.0),
        points=[_point(place), target])
        for number, (place, (r, g, b)) in enumerate(zip(located.observers_m, _COLOURS))]
    variance, axes = np.linalg.eigh(location.covariance_m2)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    ellipsoid = Marker(
        header=header, ns='target', type=Marker.SPHERE, action=Marker.ADD,
        color=ColorRGBA(r=1.0, g=0.3, b=0.3, a=0.6))
    ellipsoid.pose.position = target
    ellipsoid.pose.orientation = quaternion_to_geometry(quaternion_from_matrix(axes))
    width_x, width_y, width_z = map(float, 2 * ELLIPSOID_SIGMAS * np.sqrt(np.maximum(variance, 0)))
    ellipsoid.scale = Vector3(x=width_x, y=width_y, z=width_z)
    return MarkerArray(markers=[*lines, ellipsoid])


def _point(place: np.ndarray) -> Point:
    x, y, z = map(float, place)
    return Point(x=x, y=y, z=z)
