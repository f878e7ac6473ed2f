# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Star tracker with a simulated camera and recorder: pipeline.launch.py and sky_simulator."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from startracker_ros.ros.launching import declared, node, pipeline, shared_arguments


def generate_launch_description() -> LaunchDescription:
    """Return the pipeline with the recorder, and the simulator."""
    arguments = [*shared_arguments(), DeclareLaunchArgument(
        'record', default_value='true', description='record all topics into a bag')]
    return LaunchDescription([
        *declared(arguments), pipeline(arguments), node('sky_simulator', name='sky_simulator')])
