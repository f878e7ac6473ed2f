# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""demo.launch.py under launch_testing: it publishes attitudes, and all processes end cleanly."""

import time
import unittest

from ament_index_python.packages import get_package_share_path
from geometry_msgs.msg import QuaternionStamped
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
import launch_testing
from launch_testing.actions import ReadyToTest
from launch_testing.asserts import assertExitCodes
import rclpy

LIMIT_S = 500.0


def generate_test_description() -> LaunchDescription:
    """Return the demo without its bag."""
    path = get_package_share_path('startracker_ros') / 'launch' / 'demo.launch.py'
    return LaunchDescription([
        IncludeLaunchDescription(PythonLaunchDescriptionSource(str(path)), launch_arguments=[
            ('record', 'false'), ('namespace', 'tested')]), ReadyToTest()])


class Running(unittest.TestCase):

    def test_attitudes_are_published(self) -> None:
        rclpy.init()
        node, received = rclpy.create_node('launch_demo'), []
        node.create_subscription(QuaternionStamped, '/tested/attitude', received.append, 10)
        end_s = time.monotonic() + LIMIT_S
        while not received and time.monotonic() < end_s:
            rclpy.spin_once(node, timeout_sec=1.0)
        node.destroy_node()
        rclpy.shutdown()
        self.assertTrue(received)


@launch_testing.post_shutdown_test()
class Ended(unittest.TestCase):

    def test_all_ended_cleanly(self, proc_info) -> None:
        assertExitCodes(proc_info)
