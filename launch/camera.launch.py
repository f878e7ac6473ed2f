# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Star tracker with a camera of Video4Linux: pipeline.launch.py and camera_source.

Device, exposure and camera file are in camera_source.yaml of the folder `config:=...`, or in one
file `params_file:=...`.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from startracker_ros.ros.launching import declared, node, pipeline, shared_arguments


def generate_launch_description() -> LaunchDescription:
    """Return the pipeline, with the recorder on request, and the camera."""
    arguments = [*shared_arguments(), DeclareLaunchArgument(
        'record', default_value='false', description='record all topics into a bag')]
    return LaunchDescription([
        *declared(arguments), pipeline(arguments), node('camera_source', name='camera_source')])
