# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
A camera driver that knows nothing of this package: python foreign_driver.py integer|double.

Its exposure is a parameter in units of 100 us or of 1 us, and it refuses more than half a second.
"""

from pathlib import Path
import signal
import sys
from threading import Event

from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_system_default
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image

sys.path.insert(0, str(Path(__file__).parents[1] / 'core' / 'exposure'))

from changing_sky import LATENCY, photograph, Setting, Sky  # noqa: E402, I100

PERIOD_S, LONGEST_MS = 0.25, 500.0


class Driver(Node):
    """Publishes images of a sky, with the setting of some images before."""

    def __init__(self, kind: str) -> None:
        super().__init__('foreign_driver')
        number, self._unit_us = (int, 100.0) if kind == 'integer' else (float, 1.0)
        self.declare_parameter('exposure', number(2000 / self._unit_us))
        self.declare_parameter('gain', number(3))
        self.add_on_set_parameters_callback(self._on_set)
        self._settings = [self._setting()] * LATENCY
        self._count = 0
        self._publisher = self.create_publisher(Image, 'image_raw', qos_profile_system_default)
        self.create_timer(PERIOD_S, self._publish)

    def _setting(self) -> Setting:
        return Setting(max(self.get_parameter('exposure').value * self._unit_us / 1e3, 0.1),
                       float(self.get_parameter('gain').value))

    def _on_set(self, parameters: list) -> SetParametersResult:
        if any(one.name == 'exposure' and one.value * self._unit_us / 1e3 > LONGEST_MS
               for one in parameters):
            return SetParametersResult(successful=False, reason='too long for the sensor')
        return SetParametersResult(successful=True)

    def _publish(self) -> None:
        self._settings.append(self._setting())
        image = photograph(Sky(), self._settings.pop(0), self._count).image
        self._count += 1
        message = Image(height=image.shape[0], width=image.shape[1], encoding='mono16',
                        step=2 * image.shape[1])
        message.header.stamp = self.get_clock().now().to_msg()
        message.data.frombytes(memoryview(image).cast('B'))
        self._publisher.publish(message)


if __name__ == '__main__':
    ended = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    driver = Driver(sys.argv[1])
    while not ended.is_set():
        rclpy.spin_once(driver, timeout_sec=0.1)
