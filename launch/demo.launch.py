"""Star tracker with a simulated camera and recorder: pipeline.launch.py and sky_simulator."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from startracker_ros.harness.processes import node_environment


def generate_launch_description() -> LaunchDescription:
    """Return the pipeline with the recorder, and the simulator."""
    share = get_package_share_directory('startracker_ros')
    arguments = [
        DeclareLaunchArgument(
            'namespace', default_value='', description='namespace of all topics and nodes'),
        DeclareLaunchArgument(
            'config', default_value=os.path.join(share, 'config'),
            description='folder with one parameter file <node>.yaml for each node'),
        DeclareLaunchArgument(
            'record', default_value='true', description='record all topics into a bag'),
    ]
    pipeline = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(os.path.join(share, 'launch', 'pipeline.launch.py')),
        launch_arguments=[(argument.name, LaunchConfiguration(argument.name))
                          for argument in arguments])
    simulator = Node(
        package='startracker_ros', executable='sky_simulator', name='sky_simulator',
        output='screen', namespace=LaunchConfiguration('namespace'),
        parameters=[PathJoinSubstitution([LaunchConfiguration('config'), 'sky_simulator.yaml'])],
        additional_env=node_environment())
    return LaunchDescription([*arguments, pipeline, simulator])
