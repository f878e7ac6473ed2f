# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Listen to the attitude of a star tracker: python listen_attitude.py."""

from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Imu


class AttitudeListener(Node):

    def __init__(self) -> None:
        super().__init__('attitude_listener')
        self.create_subscription(Imu, 'attitude_imu', self.on_attitude, 10)

    def on_attitude(self, message: Imu) -> None:
        if message.orientation_covariance[0] < 0:
            print('no trusted attitude', flush=True)
            return
        q, stamp = message.orientation, message.header.stamp  # q_icrf_from_sensor
        sigma_rad = max(message.orientation_covariance[::4]) ** 0.5
        print(f'{stamp.sec}.{stamp.nanosec:09d} x {q.x:+.6f} y {q.y:+.6f} z {q.z:+.6f} '
              f'w {q.w:+.6f}, worst axis {sigma_rad * 206265:.1f} arcsec', flush=True)


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):  # Ctrl-C
    rclpy.spin(AttitudeListener())
