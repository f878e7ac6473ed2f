# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the launch files share: their arguments, nodes with the environment of DDS, inclusion."""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
import os
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import (
    DeclareLaunchArgument, EmitEvent, GroupAction, IncludeLaunchDescription, LogInfo,
    OpaqueFunction)
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from startracker_ros.ros.executables import EXECUTABLES, WRONG_USE
from startracker_ros.ros.given_parameters import LAUNCHED, sections
from startracker_ros.ros.processes import node_environment
import yaml

PACKAGE = 'startracker_ros'

_CHECKED = 'startracker_ros_arguments_checked'
# Of similar words, so that arguments of other launch files are hardly ever taken for ours.
_MISSPELT = 0.85


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
        'use_sim_time': ('', 'true: use /clock, for example that of a bag; empty: as the files or '
                         'SetParameter of a parent launch file say, else false'),
        'composed': ('false', 'run the four stages in one process: faster, but a crash ends all'),
        'manager': ('true', 'start pipeline_manager, which configures and activates the stages; '
                    'false: another lifecycle manager does'),
    }
    return [DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in defaults.items()]


def declared(arguments: Sequence[DeclareLaunchArgument]) -> list[Any]:
    """Return the arguments of a launch file, and what names those that are misspelt."""
    return [*arguments, OpaqueFunction(function=partial(
        _name_mistakes, {argument.name for argument in arguments}))]


def _name_mistakes(names: set[str], context: Any) -> list[LogInfo]:
    """Name what launch would ignore: in the outermost of the launch files of this package."""
    given = context.launch_configurations
    if _CHECKED in given:
        return []
    given[_CHECKED] = 'true'
    mistakes = [f'{name}:= is not an argument of this launch file; did you mean {near}:=?'
                for name, near in _misspelt(given, names)]
    if params_file := given['params_file']:
        if not os.path.isfile(params_file):
            raise FileNotFoundError(f'params_file:={params_file}: no such file')
        try:
            keys = {key for key, _ in sections(Path(params_file))}
        except yaml.YAMLError as error:
            raise ValueError(f'params_file:={params_file} is not YAML: {error}') from error
        mistakes += [f'params_file:={params_file}: no node {name}; did you mean {near}?'
                     for name, near in _misspelt(
                         {key.rpartition('/')[2] for key in keys}, EXECUTABLES)]
    return [LogInfo(msg=f'startracker_ros: {mistake}') for mistake in mistakes]


def _misspelt(names: Any, known: Any) -> Iterator[tuple[str, str]]:
    """Yield the names that are like a known one, with that one."""
    for name in sorted(set(names) - set(known)):
        for near in get_close_matches(name, known, 1, _MISSPELT):
            yield name, near


def node(executable: str, *, name: str | None = None, files: Sequence[str] = (),
         arguments: Mapping[Any, tuple[str, type]] | None = None,
         parameters: Mapping[str, Any] | None = None, **options: Any) -> OpaqueFunction:
    """
    Return a node with the shared arguments.

    files names the nodes whose parameter files it reads, by default its own. arguments maps
    parameters to the launch argument that sets each and its type: where it is not empty it
    replaces the value of the files, as parameters do in any case. FileNotFoundError names a
    folder or file of the arguments that is not there: launch itself would leave it out.
    """
    from_arguments = {'use_sim_time': ('use_sim_time', bool), **(arguments or {})}

    def make(context: Any) -> list[Node]:
        given = context.launch_configurations
        config, params_file = given['config'], given['params_file']
        if not os.path.isdir(config):
            raise FileNotFoundError(f'config:={config}: no such folder')
        defaults = [path for file in files or (executable,)
                    if os.path.isfile(path := os.path.join(config, f'{file}.yaml'))]
        last = {**{parameter: ParameterValue(LaunchConfiguration(argument), value_type=kind)
                   for parameter, (argument, kind) in from_arguments.items() if given[argument]},
                **(parameters or {})}
        return [Node(
            package=PACKAGE, executable=executable, name=name, output='screen',
            namespace=LaunchConfiguration('namespace'),
            # Of two keys that match a node, rclpy lets the one win that comes later for the first
            # time. Among these arguments our wildcards come before the key of SetParameter in a
            # parent launch file, and both before those of the user.
            ros_arguments=['--log-level', given['log_level'],
                           *(word for path in defaults for word in ('--params-file', path))],
            parameters=[*([params_file] if params_file else []), *([last] if last else [])],
            additional_env={**node_environment(), LAUNCHED: '1'}, **options)]
    return OpaqueFunction(function=make)


def _end_after_wrong_use(event: Any, context: Any) -> list[Any] | None:
    """Start a process no more that cannot run as requested: it would end again each time."""
    if event.returncode != WRONG_USE:
        return None
    # Within respawn_delay this ends the wait of launch for the next start.
    return [LogInfo(msg=f'startracker_ros: {event.process_name} ended with status {WRONG_USE} and '
                        'is not started again: its last line says what to correct'),
            EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action)))]


RESPAWN = {'respawn': True, 'respawn_delay': 1.0, 'on_exit': _end_after_wrong_use}
"""Options of a node that is started again when its process ends, but not after wrong use."""


def pipeline(arguments: Sequence[DeclareLaunchArgument], **replaced: Any) -> GroupAction:
    """Return pipeline.launch.py with the values of the arguments, some of them replaced."""
    values = {argument.name: LaunchConfiguration(argument.name) for argument in arguments}
    path = os.path.join(get_package_share_directory(PACKAGE), 'launch', 'pipeline.launch.py')
    # Without the group the replaced values would apply to all that comes after.
    return GroupAction([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path), launch_arguments=[*{**values, **replaced}.items()])])
