# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude as quaternion, pose with covariance, Imu and transform."""

from geometry_msgs.msg import (
    AccelWithCovarianceStamped, PoseWithCovarianceStamped, QuaternionStamped, TransformStamped)
import numpy as np
from sensor_msgs.msg import Imu
from startracker_ros.core.attitude.result import AttitudeEstimate, covariance_icrf
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.core.track.tracks import Acceleration, Hint, TrackedAttitude
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp, rotation_covariance
from startracker_ros.io.bags.telemetry import unit_quaternion
from startracker_ros.ros.messages.header import quaternion_to_geometry, vector_to_geometry
from startracker_ros.ros.messages.serialized import PassedMessage
from std_msgs.msg import Header


def quaternion_to_message(quaternion: np.ndarray, header: Header) -> bytes:
    """Return the serialized `attitude` or `truth/attitude` of q_icrf_from_sensor (4,)."""
    return cdr.quaternion_stamped(ns_from_stamp(header.stamp), header.frame_id, quaternion)


def quaternion_from_message(message: QuaternionStamped) -> np.ndarray:
    """Return q_icrf_from_sensor (4,)."""
    q = message.quaternion
    return np.array([q.x, q.y, q.z, q.w])


def attitude_to_pose(attitude: AttitudeEstimate, header: Header) -> bytes:
    """Return the serialized `attitude_cov`: position zero, covariance about ICRF axes, rad^2."""
    return _rotation_to_pose(attitude.quaternion, covariance_icrf(
        attitude.quaternion, attitude.covariance_sensor), header)


def mount_to_pose(q_body_from_sensor: np.ndarray, covariance: np.ndarray, header: Header) -> bytes:
    """Return the serialized `mount` (4,), covariance (3, 3) rad^2 about axes of the header."""
    return _rotation_to_pose(q_body_from_sensor, covariance, header)


def _rotation_to_pose(quaternion: np.ndarray, covariance: np.ndarray, header: Header) -> bytes:
    return cdr.pose_stamped(
        ns_from_stamp(header.stamp), header.frame_id, quaternion, covariance)


def attitude_from_pose(message: PoseWithCovarianceStamped, inertial_frame_id: str
                       ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return q_icrf_from_sensor (4,) and its covariance (3, 3) about ICRF axes.

    MessageError where that is not an attitude.
    """
    if message.header.frame_id != inertial_frame_id:
        raise MessageError(f'frame {message.header.frame_id!r} is not {inertial_frame_id!r}')
    covariance = np.reshape(message.pose.covariance, (6, 6))[3:, 3:]
    if not (np.isfinite(covariance).all() and (np.diag(covariance) > 0).all()):
        raise MessageError(f'rotation covariance of diagonal {np.diag(covariance).tolist()} '
                           'is not positive')
    return unit_quaternion(message.pose.pose.orientation), covariance


def attitude_to_imu(attitude: AttitudeEstimate | None, header: Header) -> bytes:
    """
    Return the serialized `attitude_imu`; without an attitude covariance -1, quaternion zero.

    A quaternion of zeros is not a rotation, so that a reader who forgets to look at the
    covariance cannot take it for one.
    """
    return _imu(attitude, None, None, header)


def tracked_attitude_to_imu(tracked: TrackedAttitude | None, header: Header) -> bytes:
    """Return `tracked_attitude` or `attitude_imu`, serialized, with the rate on sensor axes."""
    if tracked is None:
        return attitude_to_imu(None, header)
    return _imu(tracked.attitude, tracked.rate_rad_s, tracked.rate_covariance, header)


def _imu(attitude: AttitudeEstimate | None, rate_rad_s: np.ndarray | None,
         rate_covariance: np.ndarray | None, header: Header) -> bytes:
    quaternion = None if attitude is None else attitude.quaternion
    covariance = None if attitude is None else covariance_icrf(
        attitude.quaternion, attitude.covariance_sensor)
    return cdr.imu(ns_from_stamp(header.stamp), header.frame_id, quaternion, covariance,
                   rate_rad_s, rate_covariance)


def tracked_attitude_from_imu(message: Imu) -> TrackedAttitude | None:
    """Return what `tracked_attitude` says, None where it has no attitude; without its stars."""
    if isinstance(message, PassedMessage):
        return message.value
    if message.orientation_covariance[0] == -1:
        return None
    q, rate = message.orientation, message.angular_velocity
    quaternion = np.array([q.x, q.y, q.z, q.w])
    covariance_about_icrf = np.reshape(message.orientation_covariance, (3, 3))
    if not (np.isfinite(covariance_about_icrf).all()
            and abs(np.linalg.norm(quaternion) - 1) < 1e-6):
        raise MessageError(f'orientation {quaternion.tolist()} with covariance '
                           f'{covariance_about_icrf.tolist()} is not an attitude')
    matrix = matrix_from_quaternion(quaternion)
    return TrackedAttitude(
        AttitudeEstimate(quaternion, matrix.T @ covariance_about_icrf @ matrix, 0, np.empty(0),
                         np.nan),
        np.array([rate.x, rate.y, rate.z]),
        np.reshape(message.angular_velocity_covariance, (3, 3)))


def acceleration_to_message(acceleration: Acceleration, header: Header
                            ) -> AccelWithCovarianceStamped:
    """Return `tracked_acceleration`, angular in rad/s^2 about sensor axes: linear zero."""
    message = AccelWithCovarianceStamped(header=header)
    message.accel.accel.angular = vector_to_geometry(acceleration.mean)
    message.accel.covariance = rotation_covariance(np.diag(acceleration.sigma ** 2)).ravel()
    return message


def acceleration_from_message(message: AccelWithCovarianceStamped
                              ) -> tuple[np.ndarray, np.ndarray]:
    """Return the angular acceleration (3,) and its 1 sigma (3,); MessageError for none."""
    a = message.accel.accel.angular
    mean = np.array([a.x, a.y, a.z])
    variance = np.diag(np.reshape(message.accel.covariance, (6, 6)))[3:]
    if not (np.isfinite(mean).all() and np.isfinite(variance).all() and (variance >= 0).all()):
        raise MessageError(f'angular acceleration {mean.tolist()} with variances '
                           f'{variance.tolist()} is invalid')
    return mean, np.sqrt(variance)


def hint_to_imu(hint: Hint, header: Header) -> bytes:
    """Return the serialized `hint`: attitude and rate on sensor axes."""
    return tracked_attitude_to_imu(TrackedAttitude(
        AttitudeEstimate(hint.quaternion, hint.covariance, 0, np.empty(0), np.nan),
        hint.rate, hint.rate_covariance), header)


def hint_from_imu(message: Imu) -> Hint:
    """Return `hint`; MessageError where it has no attitude, no rate, or no covariances."""
    tracked = tracked_attitude_from_imu(message)
    if tracked is None or message.angular_velocity_covariance[0] == -1:
        raise MessageError('a hint needs orientation and angular velocity with covariances')
    hint = Hint(ns_from_stamp(message.header.stamp), tracked.attitude.quaternion,
                tracked.attitude.covariance_sensor, tracked.rate_rad_s, tracked.rate_covariance)
    if not (np.isfinite(hint.rate).all() and all(
            np.isfinite(P).all() and np.linalg.eigvalsh(P)[0] > 0
            for P in (hint.covariance, hint.rate_covariance))):
        raise MessageError('rate or covariances of the hint are not finite and positive definite')
    return hint


def rotation_to_transform(q_parent_from_child: np.ndarray, header: Header,
                          child_frame_id: str) -> TransformStamped:
    """Return the transform of a child frame, (4,) without translation, in that of the header."""
    message = TransformStamped(header=header, child_frame_id=child_frame_id)
    message.transform.rotation = quaternion_to_geometry(q_parent_from_child)
    return message
