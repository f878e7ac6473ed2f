# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Stand-ins of the few classes of launch that the launch files use: its wheels have no launch.

Parameters get into files, and these into the arguments of a node, as launch_ros does it: first
ros_arguments, then what SetParameter and SetParametersFromFile of a parent launch file set, then
the parameters of the node, a dict of which is keyed by the full name of the node, or by /** where
it has no name.
"""

import os
from pathlib import Path
import runpy
import sys
from types import MappingProxyType, ModuleType, SimpleNamespace

from startracker_ros.ros.memory import PROFILE_VARIABLES
import yaml

SOURCE = Path(__file__).parents[1]
SHARED = {'namespace', 'config', 'params_file', 'log_level', 'use_sim_time', 'composed', 'manager'}
CLASSES = {
    'launch': ['LaunchDescription'],
    'launch.actions': ['DeclareLaunchArgument', 'EmitEvent', 'GroupAction',
                       'IncludeLaunchDescription', 'LogInfo', 'OpaqueFunction', 'Shutdown',
                       'TimerAction'],
    'launch.conditions': ['IfCondition', 'UnlessCondition'],
    'launch.events': ['matches_action'],
    'launch.events.process': ['ShutdownProcess'],
    'launch.launch_description_sources': ['PythonLaunchDescriptionSource'],
    'launch.substitutions': ['LaunchConfiguration', 'PathJoinSubstitution'],
    'launch_ros': [],
    'launch_ros.actions': ['Node'],
    'launch_ros.parameter_descriptions': ['ParameterValue'],
}


class Record:
    """What a launch class was made with."""

    def __init__(self, *values, **options):
        self.values, self.options = values, options

    @property
    def value(self):
        return self.values[0]

    @property
    def name(self):
        return self.value


class Launched:
    """A launch file, executed: its arguments, its nodes, its inclusions."""

    undeclared: dict[str, str] = {}
    """What is given in addition to the arguments of the launch file."""

    def __init__(self, path, given, inherited=MappingProxyType({})):
        actions = runpy.run_path(str(path))['generate_launch_description']().value
        of_kind = {kind: [action for action in actions if type(action).__name__ == kind]
                   for kind in ('DeclareLaunchArgument', 'OpaqueFunction', 'GroupAction')}
        assert sum(map(len, of_kind.values())) == len(actions)
        self.arguments = {action.name: action.options['default_value']
                          for action in of_kind['DeclareLaunchArgument']}
        assert given.keys() <= self.arguments.keys()
        self.arguments |= given
        assert self.arguments.keys() >= SHARED
        context = SimpleNamespace(
            launch_configurations={**inherited, **self.undeclared, **self.arguments})
        made = [each for action in of_kind['OpaqueFunction']
                for each in action.options['function'](context)]
        self.nodes = [each.options for each in made if type(each).__name__ == 'Node']
        self.messages = [each.options['msg'] for each in made if type(each).__name__ == 'LogInfo']
        # Each in a group of its own: its arguments would remain for what comes after.
        includes = [action.value[0] for action in of_kind['GroupAction']]
        self.included = [
            Launched(include.value.value, {
                name: self.text(value) for name, value in include.options['launch_arguments']},
                context.launch_configurations)
            for include in includes]

    def text(self, value):
        """Return what a substitution stands for with these arguments."""
        kind = type(value).__name__
        if kind == 'LaunchConfiguration':
            return self.arguments.get(value.value, value.options.get('default'))
        if kind == 'PathJoinSubstitution':
            return os.path.join(*map(self.text, value.value))
        if isinstance(value, tuple):
            return ''.join(map(self.text, value))
        return value

    def typed(self, value):
        """Return the value of a parameter as launch_ros writes it: a list as a tuple."""
        if type(value).__name__ != 'ParameterValue':
            return tuple(value) if isinstance(value, list) else value
        text, kind = self.text(value.value), value.options['value_type']
        return yaml.safe_load(text) if kind is bool else kind(text)

    def ros_arguments(self, node, folder, set_parameters=()):
        """Return the arguments that a node is started with, its files written into a folder."""
        namespace = self.text(node['namespace'])
        namespace = namespace if namespace.startswith('/') else f'/{namespace}'
        words = ['--ros-args', *node['ros_arguments'], '--ros-args', '-r', f'__ns:={namespace}']
        if node['name'] is not None:
            words += ['-r', f"__node:={node['name']}"]
        for given in set_parameters:
            words += ['--params-file', str(given)] if isinstance(given, Path) else [
                '-p', '{}:={}'.format(*given)]
        key = '/**' if node['name'] is None else f"{namespace.rstrip('/')}/{node['name']}"
        for number, given in enumerate(node['parameters']):
            if isinstance(given, dict):
                path = Path(folder) / f"launch_params_{node['executable']}_{number}"
                path.write_text(yaml.dump({key: {'ros__parameters': {
                    self.text(name): self.typed(value) for name, value in given.items()}}}))
                given = path
            words += ['--params-file', str(given)]
        return words


def install(monkeypatch, folder):
    """Put the stand-ins in the place of launch, the source tree in that of an install."""
    for module_name, class_names in CLASSES.items():
        module = ModuleType(module_name)
        for class_name in class_names:
            setattr(module, class_name, type(class_name, (Record,), {}))
        monkeypatch.setitem(sys.modules, module_name, module)
    # An ament prefix whose share folder of the package is the source tree.
    index = folder / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'startracker_ros').touch()
    (folder / 'share' / 'startracker_ros').symlink_to(SOURCE)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(folder))
    for variable in PROFILE_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
