# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Fuse a star tracker and a gyro on its axes: frame_attitude, imu -> attitude_filtered.

Multiplicative extended Kalman filter (Lefferts, Markley, Shuster 1982). The error state is a
rotation vector about sensor axes and the bias of the gyro: no attitude is singular. The output
(sensor_msgs/Imu) has the attitude, its covariance about ICRF axes, and the rate without bias.
Parameters: `gyro_noise_deg_sqrt_h`, `gyro_bias_walk_deg_h_sqrt_h` and `gyro_bias_deg_h` (1 sigma).
"""

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu

GATE = 30.0  # chi-square of three axes: one right attitude in a million is above


class MultiplicativeFilter(Node):

    def __init__(self) -> None:
        super().__init__('mekf')

        def parameter(name: str, default: float) -> float:
            return float(np.radians(self.declare_parameter(name, default).value))
        self.noise = parameter('gyro_noise_deg_sqrt_h', 0.15) / 60  # rad / sqrt(s)
        self.walk = parameter('gyro_bias_walk_deg_h_sqrt_h', 0.1) / 3600 / 60  # rad / s / sqrt(s)
        self.bias_sigma = parameter('gyro_bias_deg_h', 10.0) / 3600  # rad / s
        self.stamp_ns = 0  # of the state; 0 before the first attitude
        self.rates: list[tuple[int, np.ndarray]] = []  # newer than the state
        self.publisher = self.create_publisher(Imu, 'attitude_filtered', 100)
        self.create_subscription(Imu, 'imu', self.on_rate, 1000)
        self.create_subscription(Imu, 'frame_attitude', self.on_attitude, 100)

    def on_rate(self, message: Imu) -> None:
        stamp_ns, rate = Time.from_msg(message.header.stamp).nanoseconds, message.angular_velocity
        self.rates.append((stamp_ns, np.array([rate.x, rate.y, rate.z])))
        # An attitude comes later than the rates of its time: the state itself waits for it.
        if self.stamp_ns and stamp_ns > self.stamp_ns:
            self.publish(message.header, *self.propagated(stamp_ns))

    def on_attitude(self, message: Imu) -> None:
        if message.orientation_covariance[0] < 0:
            return  # no trusted attitude
        stamp_ns, q = Time.from_msg(message.header.stamp).nanoseconds, message.orientation
        measured = Rotation.from_quat([q.x, q.y, q.z, q.w])  # q_icrf_from_sensor
        axes = measured.as_matrix()
        noise = axes.T @ np.reshape(message.orientation_covariance, (3, 3)) @ axes
        if not self.stamp_ns:
            self.attitude, self.bias = measured, np.zeros(3)
            self.covariance = np.diag([0.0] * 3 + [self.bias_sigma ** 2] * 3)
            self.covariance[:3, :3] = noise
        elif stamp_ns > self.stamp_ns:
            attitude, covariance = self.propagated(stamp_ns)
            innovation = (attitude.inv() * measured).as_rotvec()
            weight = np.linalg.inv(covariance[:3, :3] + noise)
            if innovation @ weight @ innovation > GATE:
                self.get_logger().warning('attitude rejected: it contradicts the gyro')
                return
            gain = covariance[:, :3] @ weight
            error = gain @ innovation
            self.attitude = attitude * Rotation.from_rotvec(error[:3])
            self.bias = self.bias + error[3:]
            kept = np.eye(6) - np.pad(gain, ((0, 0), (0, 3)))
            self.covariance = kept @ covariance @ kept.T + gain @ noise @ gain.T
        else:
            return
        self.stamp_ns = stamp_ns
        self.publish(message.header, self.attitude, self.covariance)
        self.rates = [rate for rate in self.rates if rate[0] > stamp_ns] or self.rates[-1:]

    def propagated(self, stamp_ns: int) -> tuple[Rotation, np.ndarray]:
        """Return attitude and covariance (6, 6) at a time; a rate is the mean since the last."""
        attitude, covariance, begin_ns = self.attitude, self.covariance, self.stamp_ns
        later = [rate for rate in self.rates if rate[0] > begin_ns] or self.rates[-1:]
        for index, (end_ns, rate) in enumerate(later):
            # The newest one holds up to the end.
            end_ns = stamp_ns if index == len(later) - 1 else min(end_ns, stamp_ns)
            dt = (end_ns - begin_ns) * 1e-9
            if dt <= 0:
                break
            turn = Rotation.from_rotvec((rate - self.bias) * dt)
            transition = np.eye(6)
            transition[:3, :3] = turn.as_matrix().T
            transition[:3, 3:] = -np.eye(3) * dt
            added = np.kron([[self.noise ** 2 * dt + self.walk ** 2 * dt ** 3 / 3,
                              -self.walk ** 2 * dt ** 2 / 2],
                             [-self.walk ** 2 * dt ** 2 / 2, self.walk ** 2 * dt]], np.eye(3))
            attitude, begin_ns = attitude * turn, end_ns
            covariance = transition @ covariance @ transition.T + added
        return attitude, covariance

    def publish(self, header, attitude: Rotation, covariance: np.ndarray) -> None:
        message, axes = Imu(header=header), attitude.as_matrix()
        q = message.orientation
        q.x, q.y, q.z, q.w = attitude.as_quat()
        message.orientation_covariance = (axes @ covariance[:3, :3] @ axes.T).ravel()
        if self.rates:
            rate = message.angular_velocity
            rate.x, rate.y, rate.z = self.rates[-1][1] - self.bias
        message.linear_acceleration_covariance[0] = -1.0
        self.publisher.publish(message)


if __name__ == '__main__':
    rclpy.init()
    try:
        rclpy.spin(MultiplicativeFilter())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:
        if rclpy.ok():  # not stopped just before it publishes
            raise
