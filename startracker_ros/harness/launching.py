"""What the launch files share: their arguments, nodes with the environment of DDS, inclusion."""

from collections.abc import Sequence
import os
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import (
    IfElseSubstitution, LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution)
from launch_ros.actions import Node
from startracker_ros.harness.processes import node_environment

PACKAGE = 'startracker_ros'

RESPAWN = {'respawn': True, 'respawn_delay': 1.0}
"""Options of a node that is started again when its process ends."""


def shared_arguments() -> list[DeclareLaunchArgument]:
    """Return the arguments of every launch file, which it passes to those that it includes."""
    share = get_package_share_directory(PACKAGE)
    defaults = {
        'namespace': ('', 'namespace of all topics and nodes'),
        'config': (os.path.join(share, 'config'),
                   'folder with one parameter file <node>.yaml for each node'),
        'params_file': ('', 'one more parameter file for all nodes; its values replace those of '
                        'the folder'),
        'log_level': ('info', 'debug, info, warn, error or fatal'),
        'use_sim_time': ('false', 'use /clock, for example that of a bag'),
        'composed': ('false', 'run the four stages in one process: faster, but a crash ends all'),
        'manager': ('true', 'start pipeline_manager, which configures and activates the stages; '
                    'false: another lifecycle manager does'),
    }
    return [DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in defaults.items()]


def node(executable: str, *, name: str | None = None, files: Sequence[str] = (),
         parameters: Sequence[dict[Any, Any]] = (), **options: Any) -> Node:
    """
    Return a node with the shared arguments.

    files names the nodes whose parameter files it reads, by default its own. parameters replace
    those of the files.
    """
    params_file = LaunchConfiguration('params_file')
    paths = [PathJoinSubstitution([LaunchConfiguration('config'), f'{file}.yaml'])
             for file in files or (executable,)]
    # Without a params_file the last file is read again: a path to nothing would be a warning.
    last = IfElseSubstitution(NotEqualsSubstitution(params_file, ''), params_file, paths[-1])
    return Node(
        package=PACKAGE, executable=executable, name=name, output='screen',
        namespace=LaunchConfiguration('namespace'),
        # First, so that a file may replace it.
        parameters=[{'use_sim_time': LaunchConfiguration('use_sim_time')}, *paths, last,
                    *parameters],
        ros_arguments=['--log-level', LaunchConfiguration('log_level')],
        additional_env=node_environment(), **options)


def pipeline(arguments: Sequence[DeclareLaunchArgument], **replaced: Any) -> GroupAction:
    """Return pipeline.launch.py with the values of the arguments, some of them replaced."""
    values = {argument.name: LaunchConfiguration(argument.name) for argument in arguments}
    path = os.path.join(get_package_share_directory(PACKAGE), 'launch', 'pipeline.launch.py')
    # Without the group the replaced values would apply to all that comes after.
    return GroupAction([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path), launch_arguments=[*{**values, **replaced}.items()])])
