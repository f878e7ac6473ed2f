# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude on its topics, in ICRF and with respect to J2000, the Earth and the orbit."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from geometry_msgs.msg import (
    PoseWithCovarianceStamped, QuaternionStamped, TransformStamped, Vector3Stamped)
import numpy as np
from sensor_msgs.msg import Imu
from startracker_ros.core.astro.earth import gcrs_from_itrf, gcrs_from_j2000
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.astro.orbit import orbit_frame
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.integrity.validation import TrustedAttitude
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, multiply, quaternion_from_matrix, sign_continuous)
from startracker_ros.core.options import option, Options
from startracker_ros.core.track.tracks import TrackedAttitude
from startracker_ros.io.bags import cdr
from startracker_ros.ros import qos
from startracker_ros.ros.body_output import BodyOutput
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.frames import AttitudeFrameOptions, ExtraFrameOptions
from startracker_ros.ros.messages.attitude import (
    attitude_to_imu, attitude_to_pose, quaternion_to_message, rotation_to_transform,
    tracked_attitude_to_imu)
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.node import PipelineNode, publish_if_subscribed
from startracker_ros.ros.odometry_input import OdometryInput


@dataclass(frozen=True)
class AttitudeImuOptions(Options):
    """Which frames attitude_imu has."""

    attitude_imu_valid_only: bool = option(
        False, 'publish attitude_imu only for frames with an attitude, for filters that fuse a '
        'message without looking at orientation_covariance[0] = -1, as robot_localization does',
        live=True)


class AttitudeOutput:
    """Publishes trusted attitudes in four message types, and those of body and other frames."""

    def __init__(self, node: CameraNode, observer: OdometryInput) -> None:
        self._node = node
        self._observer = observer
        self._diagnostics = node.diagnostics
        self._quaternion = node.advertise(QuaternionStamped, 'attitude', qos.LIST)
        self._pose = node.advertise(PoseWithCovarianceStamped, 'attitude_cov', qos.LIST)
        self._protection = node.advertise(Vector3Stamped, 'protection_level', qos.LIST)
        self._imu = node.advertise(Imu, 'attitude_imu', qos.LIST)
        self._transform = node.advertise(TransformStamped, 'attitude_transform', qos.LIST)
        self._frames = FramesOutput(node)
        self._body = BodyOutput(node)

    def rebuild(self) -> None:
        """Publish what does not change with the frames."""
        self._body.rebuild()

    def follow_frame(self, sensor_frame_id: str) -> None:
        """Use a frame of the sensor; MessageError for the name of another frame."""
        self._body.follow_frame(sensor_frame_id)

    def publish(self, stamp_ns: int, result: TrustedAttitude, tracked: TrackedAttitude | None
                ) -> None:
        """
        Publish the attitude of a frame, with the body rate where a tracker knows it.

        Without a trusted attitude only attitude_imu is published, marked as invalid, or nothing.
        """
        self._node.defer(partial(self._observer.report, stamp_ns))
        attitude, sensor_frame_id = result.attitude, self._node.sensor_frame_id
        header = make_header(
            stamp_ns, self._node.options(AttitudeFrameOptions).inertial_frame_id)
        sensor_header = make_header(stamp_ns, sensor_frame_id)
        if attitude is None:
            if not self._node.options(AttitudeImuOptions).attitude_imu_valid_only:
                self._imu.publish(attitude_to_imu(None, sensor_header))
            self._diagnostics.counts['frames without attitude'] += 1
            self._diagnostics.report(WARN, f'no attitude: {result.reason}',
                                     expected=not self._diagnostics.counts['attitudes'])
            return
        # First, as a control loop may depend on it.
        publish_if_subscribed(self._quaternion, lambda: quaternion_to_message(
            attitude.quaternion, header))
        publish_if_subscribed(self._pose, lambda: attitude_to_pose(attitude, header))
        publish_if_subscribed(self._protection, lambda: cdr.vector_stamped(
            stamp_ns, sensor_frame_id, result.protection_rad))
        publish_if_subscribed(self._transform, lambda: rotation_to_transform(
            attitude.quaternion, header, sensor_frame_id))
        publish_if_subscribed(self._imu, lambda: (
            attitude_to_imu(attitude, sensor_header) if tracked is None else
            tracked_attitude_to_imu(replace(tracked, attitude=attitude), sensor_header)))
        self._body.publish(stamp_ns, attitude.quaternion)
        self._frames.publish(stamp_ns, attitude.quaternion, self._observer.motion)
        self._diagnostics.counts['attitudes'] += 1
        self._diagnostics.describe = partial(_describe, attitude, result)
        self._diagnostics.report(OK, 'publishing attitude')


def _describe(attitude: AttitudeEstimate, result: TrustedAttitude) -> dict[str, object]:
    sigma = np.sqrt(np.diag(attitude.covariance_sensor)) / ARCSEC
    return {'stars': str(attitude.stars),
            'cross_boresight_sigma_arcsec': f'{np.hypot(*sigma[:2]) / np.sqrt(2):.2f}',
            'roll_sigma_arcsec': f'{sigma[2]:.2f}',
            'protection_level_arcsec': ' '.join(
                f'{x:.2f}' for x in result.protection_rad / ARCSEC)}


class FramesOutput:
    """Publishes attitude_j2000, attitude_itrf and attitude_orbit where publish_frames is set."""

    def __init__(self, node: PipelineNode) -> None:
        self._node = node
        self._publishers: dict[str, Any] = {}
        self._previous: dict[str, np.ndarray] = {}
        if node.options(ExtraFrameOptions).publish_frames:
            self._advertise()

    def _advertise(self) -> None:
        self._publishers = {
            frame: self._node.advertise(QuaternionStamped, f'attitude_{frame}', qos.LIST)
            for frame in ('j2000', 'itrf', 'orbit')}

    def publish(self, stamp_ns: int, q_icrf_from_sensor: np.ndarray, motion: ObserverMotion
                ) -> None:
        """Publish an attitude (4,), in a frame that turns with the Earth where it has a date."""
        options = self._node.options(ExtraFrameOptions)
        if not options.publish_frames:
            return
        if not self._publishers:
            # The parameter is live.
            self._advertise()
        frames = {'j2000': gcrs_from_j2000()}
        if no_date := motion.why_no_date(stamp_ns):
            self._node.diagnostics.report_event(f'no attitude_itrf: {no_date}')
        else:
            frames['itrf'] = gcrs_from_itrf(epoch_year_from_stamp(stamp_ns), options.ut1_utc_s)
        if (state := motion.geocentric(stamp_ns)) is not None:
            frames['orbit'] = orbit_frame(state.position_m, state.velocity_m_s)
        for frame, icrf_from_frame in frames.items():
            q = multiply(conjugate(quaternion_from_matrix(icrf_from_frame)), q_icrf_from_sensor)
            self._previous[frame] = sign_continuous(q, self._previous.get(frame))
            self._publishers[frame].publish(quaternion_to_message(
                self._previous[frame], make_header(stamp_ns, frame)))
