"""
Star tracker for a camera: image_raw and camera_info of its namespace -> attitude.

For your own camera copy the parameter files, change them and pass their folder as
`config:=...`. Focal length and distortion come from the camera_info of the camera.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from startracker_ros.executables import STAGES
from startracker_ros.harness.processes import node_environment


def generate_launch_description() -> LaunchDescription:
    """Return the four stages of the star tracker and, on request, the recorder."""
    share = get_package_share_directory('startracker_ros')
    arguments = [
        DeclareLaunchArgument(
            'namespace', default_value='', description='namespace of all topics and nodes'),
        DeclareLaunchArgument(
            'config', default_value=os.path.join(share, 'config'),
            description='folder with one parameter file <node>.yaml for each node'),
        DeclareLaunchArgument(
            'composed', default_value='false',
            description='run the four stages in one process: faster, but a crash ends all'),
        DeclareLaunchArgument(
            'record', default_value='false', description='record all topics into a bag'),
    ]

    def parameter_file(name: str) -> PathJoinSubstitution:
        return PathJoinSubstitution([LaunchConfiguration('config'), f'{name}.yaml'])

    def node(name: str, condition: IfCondition | UnlessCondition) -> Node:
        return Node(
            package='startracker_ros', executable=name, name=name, output='screen',
            namespace=LaunchConfiguration('namespace'), parameters=[parameter_file(name)],
            additional_env=node_environment(), condition=condition)

    composed = LaunchConfiguration('composed')
    return LaunchDescription([
        *arguments,
        node('bag_recorder', IfCondition(LaunchConfiguration('record'))),
        *(node(name, UnlessCondition(composed)) for name in STAGES),
        # Without a name: it would rename all nodes of the process.
        Node(package='startracker_ros', executable='composed_pipeline', output='screen',
             namespace=LaunchConfiguration('namespace'),
             parameters=[parameter_file(name) for name in STAGES],
             additional_env=node_environment(), condition=IfCondition(composed)),
    ])
