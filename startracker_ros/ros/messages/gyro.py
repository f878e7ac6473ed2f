# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gyro on `imu`, and its drift."""

from geometry_msgs.msg import TwistWithCovarianceStamped
import numpy as np
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import ns_from_stamp, rotation_covariance
from startracker_ros.ros.messages.header import vector_to_geometry
from std_msgs.msg import Header


def gyro_to_imu(rate_rad_s: np.ndarray, sigma_rad_s: float, header: Header) -> bytes:
    """Return the serialized `imu` of a gyro (3,) in the sensor frame: no orientation."""
    return cdr.gyro_imu(ns_from_stamp(header.stamp), header.frame_id, rate_rad_s, sigma_rad_s)


def drift_to_twist(drift_rad_s: np.ndarray, covariance: np.ndarray, header: Header
                   ) -> TwistWithCovarianceStamped:
    """Return `gyro_drift` (3,) rad/s with its covariance (3, 3): linear zero."""
    message = TwistWithCovarianceStamped(header=header)
    message.twist.twist.angular = vector_to_geometry(drift_rad_s)
    message.twist.covariance = rotation_covariance(covariance).ravel()
    return message
