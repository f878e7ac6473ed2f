"""
Star tracker on a recording: pipeline.launch.py, and bag_player with images and rates.

`bag:=folder` names the bag. Only images, camera_info and imu are played: the pipeline publishes
the other topics again.
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
    """Return the pipeline and the bag player."""
    share = get_package_share_directory('startracker_ros')
    config = DeclareLaunchArgument(
        'config', default_value=os.path.join(share, 'config'),
        description='folder with one parameter file <node>.yaml for each node')
    bag = DeclareLaunchArgument('bag', default_value='bag', description='bag folder or .mcap file')
    pipeline = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(os.path.join(share, 'launch', 'pipeline.launch.py')),
        launch_arguments=[('config', LaunchConfiguration('config'))])
    player = Node(
        package='startracker_ros', executable='bag_player', name='bag_player', output='screen',
        parameters=[PathJoinSubstitution([LaunchConfiguration('config'), 'bag_player.yaml']),
                    {'path': LaunchConfiguration('bag'),
                     'topics': ['*/image_raw', '*/camera_info', '*/imu']}],
        additional_env=node_environment())
    return LaunchDescription([config, bag, pipeline, player])
