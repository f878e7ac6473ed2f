# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Publish the attitude of now: attitude_imu -> attitude_now, 50 times a second.

The newest attitude is propagated by its rate to the time of the message; the covariance grows with
its age. Beyond the parameter `max_age_s` nothing is published.
"""

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu
import startracker_ros as st

# Of the body about x, y and z, 1 sigma: that of your spacecraft, rad/s^2.
ACCELERATION = np.radians([0.005, 0.005, 0.005])


class AttitudeNow(Node):

    def __init__(self) -> None:
        super().__init__('attitude_now')
        self.max_age_s = self.declare_parameter('max_age_s', 1.0).value
        self.newest: st.Attitude | None = None
        self.publisher = self.create_publisher(Imu, 'attitude_now', 10)
        self.create_subscription(Imu, 'attitude_imu', self.on_attitude, 100)
        self.create_timer(0.02, self.on_timer)

    def on_attitude(self, message: Imu) -> None:
        if message.orientation_covariance[0] < 0 or message.angular_velocity_covariance[0] < 0:
            return  # no trusted attitude, or no rate
        q, rate = message.orientation, message.angular_velocity
        quaternion = np.array([q.x, q.y, q.z, q.w])  # q_icrf_from_sensor
        axes = Rotation.from_quat(quaternion).as_matrix()
        self.frame_id = message.header.frame_id
        self.newest = st.Attitude(
            stamp_ns=Time.from_msg(message.header.stamp).nanoseconds, quaternion=quaternion,
            covariance_sensor=axes.T @ np.reshape(message.orientation_covariance, (3, 3)) @ axes,
            rate_rad_s=np.array([rate.x, rate.y, rate.z]),
            rate_covariance=np.reshape(message.angular_velocity_covariance, (3, 3)),
            acceleration_rad_s2=ACCELERATION)

    def on_timer(self) -> None:
        now = self.get_clock().now()
        if self.newest is None or now.nanoseconds - self.newest.stamp_ns > self.max_age_s * 1e9:
            return
        attitude, message = self.newest.at(now.nanoseconds), Imu()
        message.header.stamp, message.header.frame_id = now.to_msg(), self.frame_id
        q, rate = message.orientation, message.angular_velocity
        q.x, q.y, q.z, q.w = attitude.quaternion
        rate.x, rate.y, rate.z = attitude.rate_rad_s
        message.orientation_covariance = attitude.covariance_icrf.ravel()
        message.angular_velocity_covariance = attitude.rate_covariance.ravel()
        message.linear_acceleration_covariance[0] = -1.0
        self.publisher.publish(message)


if __name__ == '__main__':
    rclpy.init()
    try:
        rclpy.spin(AttitudeNow())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:
        if rclpy.ok():  # not stopped just before it publishes
            raise
