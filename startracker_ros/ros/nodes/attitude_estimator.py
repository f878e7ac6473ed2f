"""attitude_estimator: tracks or stars, camera_info -> attitude in four message types."""

from dataclasses import dataclass

from geometry_msgs.msg import PoseWithCovarianceStamped, QuaternionStamped, TransformStamped
import numpy as np
from sensor_msgs.msg import Imu, PointCloud2

from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.attitude.trusted import AttitudeTrust, TrustOptions
from startracker_ros.catalog.places import camera_places
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.options import option, Options
from startracker_ros.ros import messages, qos
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.node import CameraNode, main_of
from startracker_ros.rotation import ARCSEC


@dataclass(frozen=True)
class SourceOptions(Options):
    """Where the stars come from."""

    source: str = option(
        'tracks', 'tracks of the star tracker, or stars of single frames identified lost-in-space',
        choices=('tracks', 'stars'), read_only=True)


class AttitudeEstimatorNode(CameraNode):
    """Publishes the attitude of each frame that has a trusted one, and nothing otherwise."""

    option_classes = (SourceOptions, TrustOptions, FrameOptions)
    task = 'attitude'

    def __init__(self) -> None:
        super().__init__('attitude_estimator')
        self._attitude = self.give(QuaternionStamped, 'attitude', qos.LIST)
        self._attitude_cov = self.give(PoseWithCovarianceStamped, 'attitude_cov', qos.LIST)
        self._attitude_imu = self.give(Imu, 'attitude_imu', qos.LIST)
        self._attitude_transform = self.give(TransformStamped, 'attitude_transform', qos.LIST)
        self._source = self.options(SourceOptions).source
        self.take(PointCloud2, self._source, self._take_frame, qos.LIST)
        self.offer_reset()

    def configure(self) -> None:
        if self.camera is not None:
            places = camera_places(load_catalog(), self.camera, self.epoch_year)
            self._trust = AttitudeTrust(self.camera, places, self.options(TrustOptions))

    def _take_frame(self, message: PointCloud2) -> None:
        if self._source == 'tracks':
            tracks = messages.tracks_from_message(message)
            used = tracks.usable
            uv, hip, sigma_px = tracks.uv[used], tracks.hip[used], tracks.position_sigma_px[used]
        else:
            rows = messages.read_cloud(message, messages.STAR_DTYPE)
            centroids = messages.centroids_from_rows(rows)
            uv, hip, sigma_px = centroids.uv, rows['hip'].astype(np.int32), centroids.sigma_px
        if not self.has_camera() or not self.in_order(self._source, message.header.stamp):
            return
        result = self._trust.solve(uv, hip, sigma_px)
        frames = self.options(FrameOptions)
        stamp_ns = messages.ns_from_stamp(message.header.stamp)
        self._attitude_imu.publish(messages.attitude_to_imu(
            result.attitude, messages.make_header(stamp_ns, frames.sensor_frame_id)))
        if result.attitude is None:
            self.diagnostics.counts['frames without attitude'] += 1
            self.diagnostics.report(WARN, f'no attitude: {result.reason}')
            return
        header = messages.make_header(stamp_ns, frames.inertial_frame_id)
        self._attitude.publish(messages.quaternion_to_message(
            result.attitude.quaternion, header))
        self._attitude_cov.publish(messages.attitude_to_pose(result.attitude, header))
        self._attitude_transform.publish(messages.attitude_to_transform(
            result.attitude, header, frames.sensor_frame_id))
        self.diagnostics.counts['attitudes'] += 1
        self.diagnostics.values.update(_describe(result.attitude))
        self.diagnostics.report(OK, 'publishing attitude')


def _describe(attitude: AttitudeEstimate) -> dict[str, str]:
    sigma = np.sqrt(np.diag(attitude.covariance_sensor)) / ARCSEC
    return {'stars': str(attitude.stars),
            'cross_boresight_sigma_arcsec': f'{np.hypot(*sigma[:2]) / np.sqrt(2):.2f}',
            'roll_sigma_arcsec': f'{sigma[2]:.2f}'}


main = main_of(AttitudeEstimatorNode)

if __name__ == '__main__':
    main()
