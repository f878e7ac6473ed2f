# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Position and velocity of satellites: nav_msgs/Odometry."""

from nav_msgs.msg import Odometry
import numpy as np
from startracker_ros.core.astro.state import State
from startracker_ros.core.maths.rotation import conjugate, rotate
from startracker_ros.io.bags.layouts import MessageError
from startracker_ros.io.bags.telemetry import unit_quaternion
from startracker_ros.ros.messages.header import quaternion_to_geometry, vector_to_geometry
from startracker_ros.sim.sky.motion_state import MotionState
from std_msgs.msg import Header


def motion_to_odometry(position_m: np.ndarray, velocity_m_s: np.ndarray, quaternion: np.ndarray,
                       rate_rad_s: np.ndarray, header: Header,
                       sensor_frame_id: str) -> Odometry:
    """
    Return `truth/odometry`: pose in the inertial frame, twist in the sensor frame.

    nav_msgs/Odometry has its twist in child_frame_id, so the ICRF velocity is turned
    into the sensor frame.
    """
    message = Odometry(header=header, child_frame_id=sensor_frame_id)
    position = message.pose.pose.position
    position.x, position.y, position.z = map(float, position_m)
    message.pose.pose.orientation = quaternion_to_geometry(quaternion)
    message.twist.twist.linear = vector_to_geometry(rotate(conjugate(quaternion), velocity_m_s))
    message.twist.twist.angular = vector_to_geometry(rate_rad_s)
    return message


def motion_from_odometry(message: Odometry, inertial_frame_id: str, sensor_frame_id: str
                         ) -> MotionState:
    """
    Return the motion of `motion/odometry`, as `truth/odometry` has it; MessageError names faults.

    The pose is that of the sensor in the inertial frame, the twist is on sensor axes.
    """
    for what, frame, wanted in (('frame', message.header.frame_id, inertial_frame_id),
                                ('child frame', message.child_frame_id, sensor_frame_id)):
        if frame != wanted:
            raise MessageError(f'{what} {frame!r} is not {wanted!r}')
    q = unit_quaternion(message.pose.pose.orientation)
    position, twist = message.pose.pose.position, message.twist.twist
    rate, velocity, position_m = (np.array([vector.x, vector.y, vector.z])
                                  for vector in (twist.angular, twist.linear, position))
    if not np.isfinite([rate, velocity, position_m]).all():
        raise MessageError('position, velocity or rate is not finite')
    return MotionState(q, rate, position_m, rotate(q, velocity))


def state_to_odometry(state: State, velocity_variance: float, header: Header,
                      child_frame_id: str) -> Odometry:
    """
    Return `odometry` or `truth/target`: all on inertial axes.

    The axes of the child frame are parallel to the inertial ones: no rotation.
    """
    message = Odometry(header=header, child_frame_id=child_frame_id)
    position = message.pose.pose.position
    position.x, position.y, position.z = map(float, state.position_m)
    message.twist.twist.linear = vector_to_geometry(state.velocity_m_s)
    pose, twist = np.zeros((6, 6)), np.zeros((6, 6))
    pose[:3, :3], twist[:3, :3] = state.covariance_m2, velocity_variance * np.eye(3)
    message.pose.covariance, message.twist.covariance = pose.ravel(), twist.ravel()
    return message
