"""attitude_estimator: tracks and tracked_attitude, or stars -> attitude in four message types."""

from dataclasses import dataclass, replace

from geometry_msgs.msg import PoseWithCovarianceStamped, QuaternionStamped, TransformStamped
import numpy as np
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.attitude.result import AttitudeEstimate
from startracker_ros.attitude.validation import (
    AttitudeValidator, TrustedAttitude, ValidationOptions)
from startracker_ros.bag.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import camera_places
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.maths.rotation import ARCSEC
from startracker_ros.options import option, Options
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.messages.attitude import (
    attitude_to_imu, attitude_to_pose, attitude_to_transform, quaternion_to_message,
    tracked_attitude_from_imu, tracked_attitude_to_imu)
from startracker_ros.ros.messages.clouds import centroids_from_rows, tracks_from_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.node import main_of
from startracker_ros.track.tracks import TrackedAttitude

_TRACKED = 'tracked_attitude'
_KEPT_FRAMES = 64


@dataclass(frozen=True)
class SourceOptions(Options):
    """Where the stars come from."""

    source: str = option(
        'tracks', 'tracks of the star tracker, whose own attitude is taken where it tells one, or '
        'stars of single frames identified lost-in-space',
        choices=('tracks', 'stars'), read_only=True)


class AttitudeEstimatorNode(CameraNode):
    """Publishes the attitude of each frame that has a trusted one, and nothing otherwise."""

    option_classes = (SourceOptions, ValidationOptions, FrameOptions)
    task = 'attitude'

    def __init__(self) -> None:
        super().__init__('attitude_estimator')
        self._attitude = self.give(QuaternionStamped, 'attitude', qos.LIST)
        self._attitude_cov = self.give(PoseWithCovarianceStamped, 'attitude_cov', qos.LIST)
        self._attitude_imu = self.give(Imu, 'attitude_imu', qos.LIST)
        self._attitude_transform = self.give(TransformStamped, 'attitude_transform', qos.LIST)
        self._source = self.options(SourceOptions).source
        self._tracked: dict[int, TrackedAttitude | None] = {}
        self._waiting: PointCloud2 | None = None
        if self._source == 'tracks':
            self.steady_topic = 'tracks'
            self.take(Imu, _TRACKED, self._take_tracked, qos.LIST)
            self.take(PointCloud2, 'tracks', self._take_tracks, qos.LIST)
        else:
            self.take(PointCloud2, 'stars', self._take_stars, qos.LIST)
        self.offer_reset()

    def configure(self) -> None:
        if self.camera is not None:
            places = camera_places(load_catalog(), self.camera, self.epoch_year)
            self._tracked.clear()
            self._waiting = None
            self._trust = AttitudeValidator(self.camera, places, self.options(ValidationOptions))

    def prepare(self, camera: Camera) -> None:
        if self._source == 'stars':
            self.tell_of_compiling()
            self._trust.warm_up()

    def _take_tracked(self, message: Imu) -> None:
        """Keep the attitude of a frame until its tracks come, or use it if they are here."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._tracked[stamp_ns] = tracked_attitude_from_imu(message)
        while len(self._tracked) > _KEPT_FRAMES:
            del self._tracked[next(iter(self._tracked))]
        waiting = self._waiting
        if waiting is not None and ns_from_stamp(waiting.header.stamp) == stamp_ns:
            self._waiting = None
            self._solve_tracks(waiting)

    def _take_tracks(self, message: PointCloud2) -> None:
        if self.known_camera() is None or not self.in_order('tracks', message.header.stamp):
            return
        if self._waiting is not None:
            self.diagnostics.counts['tracks without tracked_attitude'] += 1
            self._waiting = None
        stamp_ns = ns_from_stamp(message.header.stamp)
        if stamp_ns not in self._tracked and self.count_publishers(_TRACKED):
            # Two topics may overtake each other.
            self._waiting = message
        else:
            self._solve_tracks(message)

    def _solve_tracks(self, message: PointCloud2) -> None:
        tracks = tracks_from_message(message)
        stamp_ns = ns_from_stamp(message.header.stamp)
        used = tracks.usable
        uv, hip = tracks.uv[used], tracks.hip[used]
        tracked = self._tracked.get(stamp_ns)
        if tracked is not None:
            self._publish(stamp_ns, self._trust.check(tracked.attitude, uv, hip), tracked)
        elif stamp_ns in self._tracked:
            self._publish(stamp_ns, TrustedAttitude(None, 'the star tracker has none'))
        else:
            self._publish(stamp_ns, self._trust.solve(uv, hip, tracks.position_sigma_px[used]))

    def _take_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        centroids = centroids_from_rows(rows)
        if self.known_camera() is not None and self.in_order('stars', message.header.stamp):
            self._publish(ns_from_stamp(message.header.stamp), self._trust.solve(
                centroids.uv, rows['hip'].astype(np.int32), centroids.sigma_px))

    def _publish(self, stamp_ns: int, result: TrustedAttitude,
                 tracked: TrackedAttitude | None = None) -> None:
        """Publish the attitude of a frame, with the body rate where a tracker knows it."""
        frames = self.options(FrameOptions)
        attitude, header = result.attitude, make_header(
            stamp_ns, frames.inertial_frame_id)
        if attitude is not None:
            # First, as a control loop may wait for it.
            self._attitude.publish(quaternion_to_message(attitude.quaternion, header))
            self._attitude_cov.publish(attitude_to_pose(attitude, header))
            self._attitude_transform.publish(attitude_to_transform(
                attitude, header, frames.sensor_frame_id))
        sensor_header = make_header(stamp_ns, frames.sensor_frame_id)
        self._attitude_imu.publish(
            attitude_to_imu(attitude, sensor_header)
            if tracked is None or attitude is None
            else tracked_attitude_to_imu(
                replace(tracked, attitude=attitude), sensor_header))
        if attitude is None:
            self.diagnostics.counts['frames without attitude'] += 1
            self.diagnostics.report(WARN, f'no attitude: {result.reason}')
            return
        self.diagnostics.counts['attitudes'] += 1
        self.diagnostics.values.update(_describe(attitude))
        self.diagnostics.report(OK, 'publishing attitude')


def _describe(attitude: AttitudeEstimate) -> dict[str, str]:
    sigma = np.sqrt(np.diag(attitude.covariance_sensor)) / ARCSEC
    return {'stars': str(attitude.stars),
            'cross_boresight_sigma_arcsec': f'{np.hypot(*sigma[:2]) / np.sqrt(2):.2f}',
            'roll_sigma_arcsec': f'{sigma[2]:.2f}'}


main = main_of(AttitudeEstimatorNode)

if __name__ == '__main__':
    main()
