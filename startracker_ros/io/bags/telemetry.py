# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Rates, positions and exposures out of messages, free of ROS.

Every function reads attributes only: of messages of rclpy as of those that a bag was decoded to.
"""

from collections import deque
import math
from typing import Any

import numpy as np
from startracker_ros.core.astro.state import State
from startracker_ros.core.maths.rotation import rotate
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp

_LONGEST_EXPOSURE = 1.1
"""Of the longest of the last intervals between frames: stamps scatter, periods are rounded."""

_STAMPS, _EXPOSURES = 5, 128


def rate_from_imu(message: Any) -> np.ndarray:
    """Return the rate (3,) in rad/s of `imu`; MessageError when it says that it has none."""
    if message.angular_velocity_covariance[0] == -1:
        raise MessageError('angular_velocity_covariance[0] is -1: imu has no angular velocity')
    rate = message.angular_velocity
    return np.array([rate.x, rate.y, rate.z])


def unit_quaternion(q: Any) -> np.ndarray:
    """Return a rotation (4,); MessageError where the norm is not 1."""
    if not abs(math.hypot(q.x, q.y, q.z, q.w) - 1) < 1e-6:
        raise MessageError(f'orientation {[q.x, q.y, q.z, q.w]} is not an attitude')
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


class ExposureTimes:
    """The exposure times of the images, from messages of `exposure_start`."""

    def __init__(self) -> None:
        self._stamps_ns: deque[int] = deque(maxlen=_STAMPS)
        self._exposures: deque[tuple[int, float]] = deque(maxlen=_EXPOSURES)

    def add(self, message: Any) -> None:
        """Add the exposure of an image; MessageError for one that cannot be right."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        exposure_s = 2e-9 * (stamp_ns - ns_from_stamp(message.time_ref))
        if exposure_s <= 0:
            raise MessageError('time_ref, the start of the exposure, is not before header.stamp, '
                               'its middle')
        self._stamps_ns.append(stamp_ns)
        interval_s = 1e-9 * float(np.diff(np.sort(self._stamps_ns)).max(initial=0))
        if interval_s and exposure_s > _LONGEST_EXPOSURE * interval_s:
            raise MessageError(f'exposure of {exposure_s:.4g} s is longer than the '
                               f'{interval_s:.4g} s from frame to frame')
        self._exposures.append((stamp_ns, exposure_s))

    def at(self, stamp_ns: int) -> float:
        """Return the newest exposure in s not later than an image, else the newest, else 0."""
        not_later = [known for known in self._exposures if known[0] <= stamp_ns]
        return max(not_later or self._exposures, default=(0, 0.0))[1]
