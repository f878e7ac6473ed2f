# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Star tracker for a camera: image_raw and camera_info of its namespace -> attitude.

pipeline_manager configures and activates the stages. A stage whose process has ended is started
again, and the manager brings it up again.

For your own camera copy the parameter files, change them and pass their folder as
`config:=...`, or write what differs into one file and pass it as `params_file:=...`. Focal length
and distortion come from the camera_info of the camera.
"""

from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.launching import declared, node, RESPAWN, shared_arguments


def generate_launch_description() -> LaunchDescription:
    """Return the four stages of the star tracker and, on request, the recorder."""
    composed = LaunchConfiguration('composed')
    # The name of the parameter contains that of the topic. PushRosNamespace of a parent launch
    # file goes before the namespace.
    images = PathJoinSubstitution(['/', LaunchConfiguration('ros_namespace', default=''),
                                   LaunchConfiguration('namespace'), 'image_raw'])
    managed: dict[str, Any] = {
        'parameters': {'autostart': False},
        'arguments': {('qos_overrides.', images, '.subscription.depth'): ('image_depth', int)}}
    return LaunchDescription([
        *declared([
            *shared_arguments(),
            DeclareLaunchArgument(
                'record', default_value='false', description='record all topics into a bag'),
            DeclareLaunchArgument(
                'image_depth', default_value='', description='images that centroid_extractor may '
                f'have in its queue; empty: as the files say, else {qos.IMAGE.depth}')]),
        node('bag_recorder', name='bag_recorder',
             condition=IfCondition(LaunchConfiguration('record'))),
        *(node(name, name=name, condition=UnlessCondition(composed), **RESPAWN, **managed)
          for name in STAGES),
        # Without a name: it would rename all nodes of the process.
        node('composed_pipeline', files=STAGES, condition=IfCondition(composed), **RESPAWN,
             **managed),
        node('pipeline_manager', name='pipeline_manager', **RESPAWN,
             condition=IfCondition(LaunchConfiguration('manager'))),
    ])
