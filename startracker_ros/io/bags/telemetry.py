# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Rates and positions out of messages, free of ROS.

Every function reads attributes only: of messages of rclpy as of those that a bag was decoded to.
"""

import math
from typing import Any

import numpy as np
from startracker_ros.core.astro.state import State
from startracker_ros.core.maths.rotation import rotate
from startracker_ros.io.bags.layouts import MessageError


def rate_from_imu(message: Any) -> np.ndarray:
    """Return the rate (3,) in rad/s of `imu`; MessageError when it says that it has none."""
    if message.angular_velocity_covariance[0] == -1:
        raise MessageError('angular_velocity_covariance[0] is -1: imu has no angular velocity')
    rate = message.angular_velocity
    return np.array([rate.x, rate.y, rate.z])


def unit_quaternion(q: Any) -> np.ndarray:
    """Return a rotation (4,); MessageError where the norm is not 1."""
    if not abs(math.hypot(q.x, q.y, q.z, q.w) - 1) < 1e-6:
        raise MessageError(f'orientation {[q.x, q.y, q.z, q.w]} is no attitude')
    return np.array([q.x, q.y, q.z, q.w])


def state_from_odometry(message: Any, inertial_frame_id: str) -> State:
    """
    Return position and velocity on inertial axes; MessageError names what is wrong.

    The twist is in child_frame_id: turned by the orientation, unless that is the inertial
    frame itself.
    """
    if message.header.frame_id != inertial_frame_id:
        raise MessageError(f'frame {message.header.frame_id!r} is not {inertial_frame_id!r}')
    position, twist = message.pose.pose.position, message.twist.twist.linear
    velocity_m_s = np.array([twist.x, twist.y, twist.z])
    if not np.any(velocity_m_s):
        raise MessageError('twist without a velocity')
    if message.child_frame_id != inertial_frame_id:
        velocity_m_s = rotate(
            unit_quaternion(message.pose.pose.orientation), velocity_m_s)
    state = State(np.array([position.x, position.y, position.z]), velocity_m_s,
                  np.reshape(message.pose.covariance, (6, 6))[:3, :3])
    if not all(np.isfinite(part).all() for part in state):
        raise MessageError('position, velocity or their covariance is not finite')
    return state
