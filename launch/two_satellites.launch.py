# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Two star trackers, each with its own camera, and the locator of a target that both see.

Each camera publishes image_raw and camera_info in the namespace of its tracker. The navigation
of each satellite publishes nav_msgs/Odometry on odometry in the same namespace. `namespace:=...`
goes before the namespaces of both.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from startracker_ros.ros.launching import declared, node, pipeline, shared_arguments

OBSERVERS = {'observer_1': 'tracker_1', 'observer_2': 'tracker_2'}


def generate_launch_description() -> LaunchDescription:
    """Return both pipelines and the locator."""
    shared = shared_arguments()
    return LaunchDescription([
        *declared([*shared, *(
            DeclareLaunchArgument(name, default_value=namespace,
                                  description=f'namespace of tracker {number}')
            for number, (name, namespace) in enumerate(OBSERVERS.items(), start=1))]),
        *(pipeline(shared, namespace=PathJoinSubstitution(
            [LaunchConfiguration('namespace'), LaunchConfiguration(name)]))
          for name in OBSERVERS),
        node('target_locator', name='target_locator',
             arguments={name: (name, str) for name in OBSERVERS}),
    ])
