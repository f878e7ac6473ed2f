"""
Two star trackers, each with its own camera, and the locator of a target that both see.

Each camera publishes image_raw and camera_info in the namespace of its tracker. The navigation
of each satellite publishes nav_msgs/Odometry on odometry in the same namespace.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from startracker_ros.harness.processes import node_environment


def generate_launch_description() -> LaunchDescription:
    """Return both pipelines and the locator."""
    share = get_package_share_directory('startracker_ros')
    arguments = [
        DeclareLaunchArgument(
            'observer_1', default_value='tracker_1', description='namespace of tracker 1'),
        DeclareLaunchArgument(
            'observer_2', default_value='tracker_2', description='namespace of tracker 2'),
        DeclareLaunchArgument(
            'config', default_value=os.path.join(share, 'config'),
            description='folder with one parameter file <node>.yaml for each node'),
    ]
    pipeline = os.path.join(share, 'launch', 'pipeline.launch.py')
    pipelines = [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(pipeline),
            launch_arguments=[('namespace', LaunchConfiguration(name)),
                              ('config', LaunchConfiguration('config'))])
        for name in ('observer_1', 'observer_2')]
    locator = Node(
        package='startracker_ros', executable='target_locator', name='target_locator',
        output='screen', namespace='',
        parameters=[PathJoinSubstitution([LaunchConfiguration('config'), 'target_locator.yaml']),
                    {name: LaunchConfiguration(name) for name in ('observer_1', 'observer_2')}],
        additional_env=node_environment())
    return LaunchDescription([*arguments, *pipelines, locator])
