# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Two star trackers on one body, and the fusion of their attitudes.

Each camera publishes image_raw and camera_info in the namespace of its tracker. The mounts of the
heads stand in `mounts_file`; the gyro of the body publishes imu. `namespace:=...` goes before the
namespaces of both.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from startracker_ros.ros.launching import declared, node, pipeline, shared_arguments

HEADS = ('tracker_1', 'tracker_2')


def generate_launch_description() -> LaunchDescription:
    """Return the pipelines of the heads and the fusion."""
    shared = shared_arguments()
    return LaunchDescription([
        *declared([*shared, DeclareLaunchArgument(
            'mounts_file', default_value='',
            description='YAML file with the mounts of the heads')]),
        *(pipeline(shared, namespace=PathJoinSubstitution(
            [LaunchConfiguration('namespace'), name])) for name in HEADS),
        node('attitude_fusion', name='attitude_fusion',
             arguments={'mounts_file': ('mounts_file', str)}),
    ])
